"""What both firmwares have in common, as the simulation sees them."""

import math
from typing import Final, NamedTuple, Protocol

import numpy as np

from companion.base.geometry import Vector3
from sitl.scenario.scenario import AirframeConfig
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.vehicle.rotors import RotorValues

# an answer takes a fraction of a millisecond; a machine too busy for this one is hopeless
ANSWER_S: Final = 5.0


class Moment(NamedTuple):
    """The vehicle at one step, as its sensors have it; `clock_s` is the firmware's time."""

    clock_s: float
    sensors: SimulatedAutopilotSensors
    state: QuadrotorState


class Setup(NamedTuple):
    """What the firmware needs to know of the vehicle, set by parameters."""

    airframe: AirframeConfig  # as its builder believes it
    home: Vector3  # latitude (deg), longitude (deg), altitude (m AMSL) of the world's origin
    gps_delay_s: float
    parameters: dict[str, float]  # over all others
    rate_scale: float = 1.0  # what tuning has multiplied the rate loops' gains by


class Firmware(Protocol):
    """A running firmware in lockstep: time passes for it in `step` alone."""

    def step(self, moment: Moment) -> RotorValues:
        """The motors' shares of full thrust (front, right, rear, left) until the next step.

        Raises:
            FirmwareError: it has ended or does not answer.
        """
        ...

    def read(self) -> list[bytes]:
        """Datagrams of MAVLink that it has sent since the last call."""
        ...

    def write(self, data: bytes) -> None:
        """A datagram of MAVLink for it."""
        ...

    def close(self) -> None:
        """End it."""
        ...


# ---------------------------------------------------------------- barometer
# The autopilot's barometer: the standard atmosphere at the true height, with noise and wander.

# ISO 2533 at sea level, and how pressure thins with height
_SEA_LEVEL_HPA: Final = 1013.25
_THINS_PER_M: Final = 2.25577e-5
_THINS_POWER: Final = 5.25588
# a MS5611 or BMP388 behind foam: 10 cm of noise, and slow turns of the weather and the airframe's own wash
NOISE_M: Final = 0.1
WANDER_M: Final = 0.3
WANDER_S: Final = 60.0
PERIOD_S: Final = 0.02


class Barometer:
    """Step it at any rate; it has a new reading every `PERIOD_S`."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._wander_m = WANDER_M * float(rng.standard_normal())
        self._due_s = -math.inf

    def read(self, now_s: float, altitude_m: float) -> float | None:
        """Pressure altitude (m) when a reading is due, else None; `altitude_m` is the true one."""
        if now_s < self._due_s - 1e-6:
            return None
        in_time = now_s - self._due_s < PERIOD_S
        self._due_s = (self._due_s if in_time else now_s) + PERIOD_S
        kept = math.exp(-PERIOD_S / WANDER_S)
        step, noise = self._rng.standard_normal(2).tolist()
        self._wander_m = kept * self._wander_m + WANDER_M * math.sqrt(1.0 - kept * kept) * step
        return altitude_m + self._wander_m + NOISE_M * float(noise)


def pressure_hpa(altitude_m: float) -> float:
    """Pressure (hPa) of the standard atmosphere at an altitude (m AMSL)."""
    return float(_SEA_LEVEL_HPA * (1.0 - _THINS_PER_M * altitude_m) ** _THINS_POWER)
