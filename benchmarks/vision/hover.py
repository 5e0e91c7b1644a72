"""How a hovering vehicle moves while a frame is exposed: flown by the simulator, the rotors' vibration on
top.

The flight: the simulated autopilot holds its place at 6 m in MIL-F-8785C moderate turbulence on a mean wind
of 5 m/s. It tilts by 3.4 degrees, turns at 3.2 deg/s and drifts at 0.19 m/s (rms); an ArduPilot hover that
was recorded in the open (log171.bin of dronekit-la-testdata, 195 to 210 s) turned at 4.3, 2.5 and 1.2 deg/s
rms.

The vibration: what the simulated gyroscope and accelerometer feel of the rotors (`sitl.sensors.inertial`),
integrated to the motion that the camera makes: at half throttle 92 Hz, 0.05 px at a focal length of 1065 px.

World NED and FRD, SI. Places count from where the vehicle was at the moment asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from companion.base.geometry import (
    FloatArray,
    Quaternion,
    Vector3,
    add,
    quat_from_rotation_vector,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    vector3,
)
from companion.config import VehicleConfig
from sitl.autopilot import ESTIMATORS, SimulatedAutopilot
from sitl.run.simulation import PHYSICS_STEP_S
from sitl.scenario.scenario import Scenario, load_scenario
from sitl.sensors.inertial import ImuErrors
from sitl.world.wind import WindSettings
from sitl.world.world import World

WIND: Final = WindSettings(mean_m_s=5.0, turbulence="moderate")
HEIGHT_M: Final = 6.0
ASKED_S: Final = 6.0
STEADY_S: Final = 25.0
FLOWN_S: Final = 40.0
# around a moment, for frames that follow one another
MARGIN_S: Final = 0.1
FLIGHTS: Final = 3


@dataclass(frozen=True)
class HoverFlight:
    """A hover, every physics step of it: places (n, 3) and attitudes (n, 4)."""

    positions_ned_m: FloatArray
    attitudes: FloatArray

    @property
    def length_s(self) -> float:
        """From the first sample to the last."""
        return (len(self.attitudes) - 1) * PHYSICS_STEP_S

    def at(self, time_s: float) -> tuple[Vector3, Quaternion]:
        """Place and attitude since its first sample, straight between samples."""
        steps = time_s / PHYSICS_STEP_S
        k = min(max(int(steps), 0), len(self.attitudes) - 2)
        share = steps - k
        here = (1.0 - share) * self.positions_ned_m[k] + share * self.positions_ned_m[k + 1]
        w, x, y, z = ((1.0 - share) * self.attitudes[k] + share * self.attitudes[k + 1]).tolist()
        return vector3(here.tolist()), quat_normalise((w, x, y, z))

    @property
    def speed_std_m_s(self) -> float:
        """Of each axis."""
        return float(np.std(np.diff(self.positions_ned_m, axis=0) / PHYSICS_STEP_S))

    @property
    def rate_std_rad_s(self) -> float:
        """Of roll and pitch."""
        return float(np.std(2.0 * np.diff(self.attitudes[:, 1:3], axis=0) / PHYSICS_STEP_S))


@lru_cache(maxsize=FLIGHTS)
def flight(seed: int) -> HoverFlight:
    """Fly one.

    Raises:
        RuntimeError: the simulated vehicle does not hover.
    """
    scenario: Scenario = load_scenario("static").model_copy(update={"wind": WIND, "start_heading_deg": 0.0})
    world = World(scenario, seed)
    rng = np.random.default_rng((seed, 1))
    autopilot = SimulatedAutopilot(
        "px4", world.airframe.body, rng, scenario.place, ESTIMATORS["typical"], world.airframe.rates
    )
    asked, samples = False, []
    while world.time_s < STEADY_S + FLOWN_S:
        if world.time_s >= ASKED_S and not asked:
            autopilot.arm()
            autopilot.take_off(scenario.place[2] + HEIGHT_M)
            asked = True
        world.step(autopilot.step(world.truth(), PHYSICS_STEP_S, world.time_s), PHYSICS_STEP_S)
        if world.time_s >= STEADY_S:
            samples.append((*world.state.position_ned_m, *world.state.attitude))
    table = np.array(samples)
    if abs(table[:, 2].mean() + HEIGHT_M) > 1.0:
        raise RuntimeError(f"the vehicle hovers at {-table[:, 2].mean():.1f} m; expected {HEIGHT_M:g} m")
    signs = np.where(table[:, 3:4] < 0.0, -1.0, 1.0)
    return HoverFlight(table[:, :3], table[:, 3:] * signs)


@dataclass(frozen=True)
class HoverMoment:
    """A moment of a hover, and what comes before and after it."""

    flight: HoverFlight
    time_s: float
    rotor_phase_rad: float
    throttle: float

    @classmethod
    def draw(cls, rng: np.random.Generator, vehicle: VehicleConfig, follows_s: float = 0.0) -> HoverMoment:
        """Any moment of any of the flights that goes on for so long."""
        chosen = flight(int(rng.integers(FLIGHTS)))
        time_s = rng.uniform(MARGIN_S, chosen.length_s - MARGIN_S - follows_s)
        return cls(chosen, float(time_s), float(rng.uniform(0.0, math.tau)), vehicle.hover_thrust)

    @property
    def rotor_rate_rad_s(self) -> float:
        """How fast the rotors turn, which is how fast they shake."""
        return math.tau * ImuErrors().full_rotor_hz * math.sqrt(self.throttle)

    @property
    def shaken_rad(self) -> float:
        """How far to either hand they turn the vehicle about roll and pitch."""
        return math.sqrt(2.0) * self.throttle * ImuErrors().vibration_rad_s / self.rotor_rate_rad_s

    def at(self, since_s: float) -> tuple[Vector3, Quaternion]:
        """How far the vehicle is from where it was, and its attitude."""
        here, attitude = self.flight.at(self.time_s + since_s)
        start, _ = self.flight.at(self.time_s)
        shaken, turned = self._vibration(since_s)
        attitude = quat_multiply(attitude, quat_from_rotation_vector(turned))
        x, y, z = (a - b for a, b in zip(here, start, strict=True))
        return add((x, y, z), quat_rotate(attitude, shaken)), attitude

    def _vibration(self, since_s: float) -> tuple[Vector3, Vector3]:
        """Displacement (m) and small turn (rad), body axes, by integrals of `sitl.sensors.inertial`."""
        turn_rate, turn = self.rotor_rate_rad_s, self.shaken_rad
        phase = self.rotor_phase_rad + turn_rate * since_s
        s, c, s2, c2 = math.sin(phase), math.cos(phase), math.sin(2.0 * phase), math.cos(2.0 * phase)
        far = -math.sqrt(2.0) * self.throttle * ImuErrors().vibration_m_s2 / turn_rate**2
        displaced = (far * s, far * c, far * (0.5 * s + 0.1875 * s2))
        return displaced, (turn * s, -turn * c, -0.25 * turn * c2)
