"""An autopilot's compass by its MAVLink messages, live or of a .tlog.

Of the messages that carry a magnetometer the app's own choice is taken
(`companion.link.telemetry.autopilot_sensors`): RAW_IMU of ArduPilot, HIGHRES_IMU of PX4. Both hold the field
as the autopilot has calibrated it, in its body axes; its parameters, where they are heard, say how, and that
is taken off again. PX4's RAW_IMU and SCALED_IMU hold the raw field in the compass's own axes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from calibration.magnetometer.read.onboard import onboard_of
from calibration.magnetometer.read.recording import MagnetometerRecording, paired
from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import ImuSample, MagSample
from companion.config import ConfigError
from companion.flightlog.replay.flight_record import RecordingPlace
from companion.link.codec import Message, is_autopilot_heartbeat, mavlink
from companion.link.parameters import reported_value
from companion.link.telemetry import readings
from companion.link.telemetry.autopilot_sensors import IMU_MESSAGES
from companion.link.telemetry.telemetry import AUTOPILOT_KINDS

_HEARTBEAT: Final = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_PARAMETER: Final = mavlink.MAVLINK_MSG_ID_PARAM_VALUE
_POSITION: Final = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_TIME: Final = mavlink.MAVLINK_MSG_ID_SYSTEM_TIME
_COMPASS: Final = frozenset(number for order in IMU_MESSAGES.values() for number in order)
# PX4's raw ones stand last: without the better one
_ORDERS: Final = {
    "ardupilot": IMU_MESSAGES["ardupilot"],
    "px4": (*IMU_MESSAGES["px4"], mavlink.MAVLINK_MSG_ID_SCALED_IMU, mavlink.MAVLINK_MSG_ID_RAW_IMU),
}
HEARD: Final = frozenset({_HEARTBEAT, _PARAMETER, _POSITION, _TIME, *_COMPASS})
_SECONDS_PER_YEAR: Final = 365.2425 * 86_400.0


class Telemetry:
    """What the messages of one autopilot say, live or of a .tlog."""

    def __init__(self, source: str) -> None:
        self._source = source
        self.autopilot_kind: AutopilotKind | None = None
        self.system_id = 0
        self.parameters: dict[str, float] = {}
        self._mags: dict[int, list[MagSample]] = {}
        self._imus: dict[int, list[ImuSample]] = {}
        self._place: tuple[float, float, float] | None = None
        self._year: float | None = None

    def take(self, message: Message) -> None:
        """Take one of HEARD."""
        number = message.get_msgId()
        if number == _HEARTBEAT:
            if self.autopilot_kind is None and is_autopilot_heartbeat(message):
                self.autopilot_kind = AUTOPILOT_KINDS.get(message.autopilot)
                self.system_id = message.get_srcSystem()
        elif self.system_id and message.get_srcSystem() != self.system_id:
            return
        elif number == _PARAMETER:
            self.parameters[message.param_id] = reported_value(message, self.autopilot_kind)
        elif number == _POSITION:
            if message.lat or message.lon:
                self._place = (message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
        elif number == _TIME:
            if message.time_unix_usec:
                self._year = 1970.0 + 1e-6 * message.time_unix_usec / _SECONDS_PER_YEAR
        else:
            self._take_imu(number, message)

    def _take_imu(self, number: int, message: Message) -> None:
        time_s = readings.stamp_s(message)
        if (mag := readings.mag_sample(message, time_s)) is not None:
            self._mags.setdefault(number, []).append(mag)
        if (imu := readings.imu_sample(message, time_s)) is not None:
            self._imus.setdefault(number, []).append(imu)

    @property
    def number(self) -> int | None:
        """The message whose magnetometer is used: the best that has come; None: none has."""
        order = _ORDERS[self.autopilot_kind or "ardupilot"]
        return next((number for number in order if self._mags.get(number)), None)

    @property
    def newest(self) -> tuple[list[MagSample], list[ImuSample]]:
        """All samples so far of the message that is used."""
        number = self.number
        return ([], []) if number is None else (self._mags[number], self._imus.get(number, []))

    def recording(self) -> MagnetometerRecording:
        """What has come.

        Raises:
            ConfigError: no magnetometer has.
        """
        number = self.number
        if number is None:
            kinds = "RAW_IMU, SCALED_IMU or HIGHRES_IMU"
            raise ConfigError(f"{self._source}: no magnetometer in it; expected {kinds} of an autopilot")
        raw, force = paired(self._mags[number], self._imus.get(number, []))
        name = mavlink.mavlink_map[number].msgname
        recording = MagnetometerRecording(f"{self._source} ({name})", "autopilot", raw, force=force)
        if self._place is not None:
            recording.place = RecordingPlace(*self._place, self._year)
        if self.autopilot_kind == "px4" and number not in IMU_MESSAGES["px4"]:
            recording.sensor = "other"
            recording.notes.append(
                f"PX4's {name} has the raw compass in its own axes, which the app never uses"
            )
        elif self.autopilot_kind is not None:
            _undo(recording, self.autopilot_kind, self.parameters)
        return recording


def _undo(
    recording: MagnetometerRecording, autopilot_kind: AutopilotKind, parameters: Mapping[str, float]
) -> None:
    """Turn what was heard into what the compass measured, where the parameters are known."""
    recording.onboard = onboard_of(autopilot_kind, parameters)
    if recording.onboard is None:
        recording.notes.append(
            "the autopilot's compass parameters are not known (or its compass is turned): the calibration "
            "goes on top of whatever they are"
        )
        return
    recording.raw = recording.onboard.undo(recording.raw)
