"""Logs of flights and of autopilots as recordings: .tlog, DataFlash, ULog, and our own flight.mcap.

What is in them has been through a calibration as often as not:

    ArduPilot   MAG of a .bin, RAW_IMU and SCALED_IMU of a .tlog: offsets, matrix and motor compensation are
                in. Taken off again by MAG's own OfsX.. and MOX.., and by the parameters in the log
    PX4         sensor_mag of a .ulg is raw, in the compass's axes; vehicle_magnetometer, sensor_combined and
                HIGHRES_IMU are calibrated, in body axes; the magnetometer in RAW_IMU and SCALED_IMU is raw
    ours        body axes, by the flight's own settings; turned back into the sensor's axes, and a calibration
                that was applied, as the log holds it, is taken off again
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyulog import ULog

from calibration.magnetometer.recording import MagnetometerRecording, onboard_of, paired
from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import vector3
from companion.base.messages import GpsFix, ImuSample, MagSample
from companion.config import CompanionConfig, ConfigError, validate_recorded
from companion.config.magnetometer import MagnetometerCalibration
from companion.flightlog.replay.dataflash import KIND as DATAFLASH
from companion.flightlog.replay.dataflash import hand_out
from companion.flightlog.replay.flight_record import (
    SECONDS_PER_YEAR,
    UT_PER,
    FlightRecord,
    RecordingPlace,
    damage_reported,
)
from companion.flightlog.replay.mcap_log import read_mcap
from companion.flightlog.replay.ulog import KIND as ULOG
from companion.flightlog.replay.ulog import parse_ulog, read_ulog
from companion.link.codec import Codec, Message, is_autopilot_heartbeat, mavlink
from companion.link.commands import reported_value
from companion.link.telemetry.autopilot_sensors import IMU_MESSAGES, imu_sample, mag_sample, stamp_s
from companion.link.telemetry.telemetry import AUTOPILOT_KINDS
from companion.sense.imu.mounting import mounting_matrix

# ---------------------------------------------------------------- telemetry
# An autopilot's compass by its MAVLink messages, live or of a .tlog.
#
# Of the messages that carry a magnetometer the app's own choice is taken
# (`companion.link.telemetry.autopilot_sensors`): RAW_IMU of ArduPilot, HIGHRES_IMU of PX4. Both hold the
# field as the autopilot has calibrated it, in its body axes; its parameters, where they are heard, say how,
# and that is taken off again. PX4's RAW_IMU and SCALED_IMU hold the raw field in the compass's own axes.

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
                self._year = 1970.0 + 1e-6 * message.time_unix_usec / SECONDS_PER_YEAR
        else:
            self._take_imu(number, message)

    def _take_imu(self, number: int, message: Message) -> None:
        time_s = stamp_s(message)
        if (mag := mag_sample(message, time_s)) is not None:
            self._mags.setdefault(number, []).append(mag)
        if (imu := imu_sample(message, time_s)) is not None:
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
            recording.onboard = onboard_of(self.autopilot_kind, self.parameters)
            if recording.onboard is None:
                recording.notes.append(
                    "the autopilot's compass parameters are not known (or its compass is turned): the "
                    "calibration goes on top of whatever they are"
                )
            else:
                recording.raw = recording.onboard.undo(recording.raw)
        return recording


def read_tlog(path: Path) -> MagnetometerRecording:
    """Read a .tlog: frames with a time before each, which the codec passes over like any stray bytes.

    Raises:
        ConfigError: no magnetometer in it.
    """
    telemetry = Telemetry(str(path))
    for message in Codec(0, wanted=HEARD).decode(path.read_bytes()):
        telemetry.take(message)
    return telemetry.recording()


# ---------------------------------------------------------------- DataFlash

_FIRST_YEAR: Final = 2000.0


def read_dataflash_compass(path: Path) -> MagnetometerRecording:
    """Read the first compass and IMU of an ArduPilot log.

    Raises:
        ConfigError: not one, or no MAG in it.
    """
    messages: dict[str, list[Any]] = {kind: [] for kind in ("MAG", "IMU", "PARM", "GPS")}
    hand_out(path, [*messages], lambda message: messages[message.get_type()].append(message))
    with damage_reported(path, DATAFLASH):
        return _compass_of(str(path), messages)


def _compass_of(source: str, messages: Mapping[str, list[Any]]) -> MagnetometerRecording:
    mags = [m for m in messages["MAG"] if getattr(m, "Health", 1)]
    if not mags:
        raise ConfigError("no MAG messages in it; expected those of a compass")
    parameters = {m.Name: float(m.Value) for m in messages["PARM"]}
    heard = [MagSample(m._timestamp, vector3(_mgauss(m, "Mag"))) for m in mags]
    imus = [ImuSample(m._timestamp, (0.0,) * 3, (m.AccX, m.AccY, m.AccZ), 0.0) for m in messages["IMU"]]
    raw, force = paired(heard, imus)
    place = next((_place(m) for m in messages["GPS"] if m.Status >= 3), None)
    recording = MagnetometerRecording(source, "autopilot", raw, force=force, place=place)
    recording.onboard = onboard_of("ardupilot", parameters)
    if recording.onboard is None:
        recording.notes.append("no compass parameters in the log: its own offsets alone were taken off")
    matrix = np.eye(3) if recording.onboard is None else recording.onboard.matrix
    # offsets may have been learnt as it flew: each message has its own
    motors = np.array([_mgauss(m, "MO") for m in mags])
    offsets = np.array([_mgauss(m, "Ofs") for m in mags])
    recording.raw = (raw - motors) @ np.linalg.inv(matrix).T - offsets
    return recording


def _mgauss(message: Any, name: str) -> list[float]:
    return [UT_PER["mG"] * float(getattr(message, f"{name}{axis}", 0.0)) for axis in "XYZ"]


def _place(fix: Any) -> RecordingPlace:
    year = 1970.0 + fix._timestamp / SECONDS_PER_YEAR
    # without the receiver's time the log counts from its start
    return RecordingPlace(fix.Lat, fix.Lng, fix.Alt, year if year > _FIRST_YEAR else None)


# ---------------------------------------------------------------- ULog


def read_ulog_compass(path: Path) -> MagnetometerRecording:
    """Read PX4's compass: raw where it was logged, else calibrated.

    Raises:
        ConfigError: not a ULog, or no magnetometer in it.
    """
    record = read_ulog(path)
    with damage_reported(path, ULOG):
        return _raw_compass(str(path), record, parse_ulog(path.read_bytes(), ["sensor_mag"]))


def _raw_compass(source: str, record: FlightRecord, log: ULog) -> MagnetometerRecording:
    imus = [event.item for event in record.events if isinstance(event.item, ImuSample)]
    topic = next((topic for topic in log.data_list if topic.multi_id == 0), None)
    onboard = onboard_of("px4", dict(log.initial_parameters))
    if topic is not None and len(topic.data["timestamp"]):
        fields = UT_PER["G"] * np.stack([np.asarray(topic.data[a], dtype=float) for a in "xyz"], axis=1)
        times = (1e-6 * np.asarray(topic.data["timestamp"], dtype=float)).tolist()
        mags = [MagSample(t, vector3(f)) for t, f in zip(times, fields.tolist(), strict=True)]
        raw, force = paired(mags, imus)
        recording = MagnetometerRecording(source, "autopilot", raw, force=force, onboard=onboard)
        if onboard is None:
            recording.sensor, recording.force = "other", None
            recording.notes.append("the compass is turned, or its parameters are not logged: in its own axes")
    else:
        mags = [event.item for event in record.events if isinstance(event.item, MagSample)]
        if not mags:
            raise ConfigError("no magnetometer in it; expected sensor_mag or vehicle_magnetometer")
        raw, force = paired(mags, imus)
        recording = MagnetometerRecording(source, "autopilot", raw, force=force)
        recording.notes.append(
            "no raw readings in the log: the calibration goes on top of the autopilot's own"
        )
    recording.place = record.place
    return recording


# ---------------------------------------------------------------- our own


def read_own_log(path: Path) -> MagnetometerRecording:
    """Read a flight of ours.

    Raises:
        ConfigError: unreadable, no magnetometer in it, or not the calibration that it was flown with.
    """
    record = read_mcap(path)
    items = [event.item for event in record.events]
    mags = [item for item in items if isinstance(item, MagSample)]
    if not mags:
        raise ConfigError(f"{path}: no magnetometer samples in the log")
    body, force = paired(mags, [item for item in items if isinstance(item, ImuSample)])
    if record.rig is None:
        notes = ["the log holds no settings: in body axes, of a sensor that is not known"]
        return MagnetometerRecording(str(path), "other", body, force=force, notes=notes)
    config = record.rig.config
    fixes = (item for item in items if isinstance(item, GpsFix))
    place = next((RecordingPlace(f.latitude_deg, f.longitude_deg, f.altitude_m, None) for f in fixes), None)
    recording = MagnetometerRecording(str(path), "mpu9250", body, force=force, place=place)
    if config.sense.source == "autopilot":
        recording.sensor = "autopilot"
    else:
        recording.body_from_sensor = body_from_sensor = mounting_matrix(config.sense.imu.body_from_sensor_deg)
        recording.raw = body @ body_from_sensor
        recording.force = None if force is None else force @ body_from_sensor
    return _uncalibrated(recording, config, record.settings)


def _uncalibrated(
    recording: MagnetometerRecording, config: CompanionConfig, recorded: Mapping[str, Any]
) -> MagnetometerRecording:
    """Without the calibration that was applied: the log's own copy, for the file may be another by now."""
    settings = config.sense.imu if recording.sensor == "mpu9250" else config.sense.autopilot
    name = settings.magnetometer_calibration
    if name is not None:
        if "magnetometer" not in recorded:
            raise ConfigError(
                f"{recording.source}: flown with the calibration {name}, which is not in the log; expected a "
                "flight without one, or the log of a version that records it"
            )
        applied = validate_recorded(
            MagnetometerCalibration,
            recorded["magnetometer"],
            f"{recording.source}: settings: magnetometer",
            recording.notes,
        )
        recording.raw = applied.undo(recording.raw)
        recording.notes.append(f"{name}, as it was flown with, was taken off")
    return recording
