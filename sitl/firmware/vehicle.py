"""A firmware in the place of the bundled autopilot: the simulation steps it and connects its clients."""

from __future__ import annotations

from typing import Final

import numpy as np

from companion.base.geometry import Quaternion, Vector3
from sitl.firmware.barometer import Barometer
from sitl.firmware.base import Moment, Setup
from sitl.firmware.network import FirmwareNetwork
from sitl.firmware.spec import FirmwareSpec
from sitl.firmware.start import boot, start_firmware
from sitl.mavlink.ground_station import GroundStation
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.quadrotor import Four
from sitl.world.world import VehicleMotion, World

# what the chip passes on; the firmware filters by itself
IMU_FILTER: Final = 1


class FirmwareVehicle:
    """One firmware with its sensors about the world's vehicle; made, it has booted."""

    def __init__(
        self,
        spec: FirmwareSpec,
        world: World,
        sensors: SimulatedAutopilotSensors,
        ground_station: GroundStation,
        rng: np.random.Generator,
        *,
        home: Vector3,
        gps_delay_s: float,
        step_s: float,
    ) -> None:
        """Start it and let it boot.

        Raises:
            ConfigError: it cannot be started, or is not ready to arm in time.
        """
        self._world, self._sensors = world, sensors
        airframe = world.believed_airframe
        tuning = world.built.rate_scale(airframe.body)
        setup = Setup(airframe, home, gps_delay_s, dict(spec.parameters), tuning)
        self._firmware = start_firmware(spec, setup, Barometer(rng))
        try:
            # the world's time 0 is its next step: its clock never stands still
            self._clock_at_start_s = boot(self._firmware, sensors, world.state, step_s) + step_s
            sensors.enable()
            sensors.step(0.0, world.state, 0.0, lambda: 0.0)
        except BaseException:
            self._firmware.close()
            raise
        self.network = FirmwareNetwork(self._firmware, ground_station)

    def step(self, _motion: VehicleMotion, _dt_s: float, now_s: float) -> Four:
        """The motors' commands until the next step, by what its sensors have now.

        Raises:
            FirmwareError: it has ended or does not answer.
        """
        return self._firmware.step(Moment(self._clock_at_start_s + now_s, self._sensors, self._world.state))

    @property
    def armed(self) -> bool:
        """From its last heartbeat."""
        return self.network.armed

    @property
    def attitude_setpoint(self) -> Quaternion:
        """Its setpoint is not known: the true attitude is used instead."""
        return self._world.state.attitude

    def close(self) -> None:
        """End it."""
        self._firmware.close()
