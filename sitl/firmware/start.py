"""Starts a firmware and lets it boot, at rest before the world's time 0, until it is ready to arm."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from typing import Any, Final

from companion.base.clock import sleep_s, wall_clock_s
from companion.config import ConfigError
from sitl.firmware.ardupilot import ArduPilot
from sitl.firmware.barometer import Barometer
from sitl.firmware.base import Firmware, Moment, Setup
from sitl.firmware.errors import FirmwareError
from sitl.firmware.px4 import Px4
from sitl.firmware.spec import FirmwareSpec
from sitl.mavlink.framing import FrameReader, MavFrame, dialect
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.quadrotor import QuadrotorState

mavlink: Any = dialect

MOST_BOOT_S: Final = 90.0
SETTLE_S: Final = 5.0  # ready, it stands so much longer: its biases go on settling
STEPS_PER_LOOK: Final = 20
OUT_OF_RANGE_M: Final = 99.0
GROUND_STATION: Final = (255, 190)
# what ArduCopter wants for flying by setpoints: velocity, and a position on the globe
_EKF_NEEDS: Final = (
    mavlink.EKF_ATTITUDE | mavlink.EKF_VELOCITY_HORIZ | mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_POS_VERT_ABS
)


def start_firmware(spec: FirmwareSpec, setup: Setup, barometer: Barometer) -> Firmware:
    """A running firmware, which has not booted.

    Raises:
        ConfigError: it cannot be started.
    """
    return Px4(spec, setup, barometer) if spec.kind == "px4" else ArduPilot(spec, setup)


def boot(
    firmware: Firmware, sensors: SimulatedAutopilotSensors, state: QuadrotorState, step_s: float
) -> float:
    """Boot it with the vehicle at rest until it is ready to arm; returns its clock (s) then.

    Before its first heartbeat it is given real time: its start-up script runs by the wall's clock.

    Raises:
        ConfigError: it ends, or is not ready to arm within `MOST_BOOT_S`.
    """
    readiness = _Readiness(firmware)
    # the flight's own sensors begin at the world's time 0; these have the same flaws
    sensors = copy.deepcopy(sensors)
    sensors.enable()
    began_s, ready_s = wall_clock_s(), math.inf
    try:
        for count in range(1, math.ceil(MOST_BOOT_S / step_s)):
            clock_s = count * step_s
            sensors.step(clock_s, state, 0.0, lambda: OUT_OF_RANGE_M)
            firmware.step(Moment(clock_s, sensors, state))
            if count % STEPS_PER_LOOK == 0:
                readiness.look()
                ready_s = min(ready_s, clock_s) if readiness.ready else math.inf
                if clock_s >= ready_s + SETTLE_S:
                    return clock_s
                if not readiness.heard:
                    sleep_s(began_s + clock_s - wall_clock_s())
    except FirmwareError as error:
        raise ConfigError(str(error)) from error
    raise ConfigError(f"the firmware is not ready to arm after {MOST_BOOT_S:g} s: {readiness.reason}")


class _Readiness:
    """Listens as a ground station does, until the autopilot may be armed."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._mav = mavlink.MAVLink(None, *GROUND_STATION)
        self._reader = FrameReader()
        self._looks = 0
        self.ready = self.heard = False
        self.reason = "no output"
        self._healthy = self._located = False

    def look(self) -> None:
        for frame in self._frames():
            self._take(frame)
        if self._looks % 20 == 0:
            self._ask()
        self._looks += 1
        self.ready = self._healthy and self._located

    def _frames(self) -> Iterator[MavFrame]:
        for data in self._firmware.read():
            yield from self._reader.read(data, 0.0)

    def _take(self, frame: MavFrame) -> None:
        match frame.message_id:
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self.heard = True
            case mavlink.MAVLINK_MSG_ID_SYS_STATUS:
                health = self._mav.decode(bytearray(frame.data)).onboard_control_sensors_health
                self._healthy = bool(health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
            case mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT:
                self._located = self._mav.decode(bytearray(frame.data)).flags & _EKF_NEEDS == _EKF_NEEDS
            case mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS:  # PX4's: sufficient for readiness
                self._located = True
            case mavlink.MAVLINK_MSG_ID_STATUSTEXT:
                self.reason = " ".join(str(self._mav.decode(bytearray(frame.data)).text).split())

    def _ask(self) -> None:
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3
        )
        interval_us = 500_000
        wants = mavlink.MAVLink_command_long_message(
            0, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, interval_us, 0, 0, 0, 0, 0,
        )  # fmt: skip
        for message in (beat, wants):
            self._firmware.write(bytes(message.pack(self._mav)))
