"""Logs of flights and of autopilots as recordings: .tlog, DataFlash, ULog, and our own flight.mcap.

What is in them has been through a calibration as often as not:

    ArduPilot   MAG of a .bin, RAW_IMU and SCALED_IMU of a .tlog: offsets, matrix and motor compensation are
                in. Taken off again by MAG's own OfsX.. and MOX.., and by the parameters in the log
    PX4         sensor_mag of a .ulg is raw, in the compass's axes; vehicle_magnetometer, sensor_combined and
                HIGHRES_IMU are calibrated, in body axes; the magnetometer in RAW_IMU and SCALED_IMU is raw
    ours        body axes, by the flight's own settings; turned back into the sensor's axes, and a calibration
                that was applied is taken off again
"""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyulog import ULog

from calibration.magnetometer.read.onboard import UT_PER_GAUSS, UT_PER_MGAUSS, onboard_of
from calibration.magnetometer.read.recording import MagnetometerRecording, mounting, paired
from calibration.magnetometer.read.telemetry import HEARD, Telemetry
from companion.base.geometry import vector3
from companion.base.messages import GpsFix, ImuSample, MagSample
from companion.config import CompanionConfig, ConfigError
from companion.config.magnetometer import load_magnetometer_calibration
from companion.flightlog.replay.dataflash import DataFlashLog
from companion.flightlog.replay.flight_record import RecordingPlace
from companion.flightlog.replay.mcap_log import read_mcap
from companion.flightlog.replay.ulog import read_ulog
from companion.link.codec import Codec

_SECONDS_PER_YEAR: Final = 365.2425 * 86_400.0
_FIRST_YEAR: Final = 2000.0


# ---------------------------------------------------------------- MAVLink


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


def read_dataflash_compass(path: Path) -> MagnetometerRecording:
    """Read the first compass and IMU of an ArduPilot log.

    Raises:
        ConfigError: not one, or no MAG in it.
    """
    log = None
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            log = DataFlashLog(str(path))
            messages = _messages(log, ["MAG", "IMU", "PARM", "GPS"])
        except Exception as error:
            # the library meets garbage with whatever Python raises there
            raise ConfigError(f"{path}: not a DataFlash log that can be read: {error}") from error
        finally:
            if log is not None:
                log.close()
    mags = [m for m in messages["MAG"] if getattr(m, "Health", 1)]
    if not mags:
        raise ConfigError(f"{path}: no MAG messages in it; expected those of a compass")
    parameters = {m.Name: float(m.Value) for m in messages["PARM"]}
    heard = [MagSample(m._timestamp, vector3(_mgauss(m, "Mag"))) for m in mags]
    imus = [ImuSample(m._timestamp, (0.0,) * 3, (m.AccX, m.AccY, m.AccZ), 0.0) for m in messages["IMU"]]
    raw, force = paired(heard, imus)
    place = next((_place(m) for m in messages["GPS"] if m.Status >= 3), None)
    recording = MagnetometerRecording(str(path), "autopilot", raw, force=force, place=place)
    recording.onboard = onboard_of("ardupilot", parameters)
    if recording.onboard is None:
        recording.notes.append("no compass parameters in the log: its own offsets alone were taken off")
    matrix = np.eye(3) if recording.onboard is None else recording.onboard.matrix
    # offsets may have been learnt as it flew: each message has its own
    motors = np.array([_mgauss(m, "MO") for m in mags])
    offsets = np.array([_mgauss(m, "Ofs") for m in mags])
    recording.raw = (raw - motors) @ np.linalg.inv(matrix).T - offsets
    return recording


def _messages(log: Any, kinds: list[str]) -> dict[str, list[Any]]:
    """All messages of those kinds, of the first instance."""
    found: dict[str, list[Any]] = {kind: [] for kind in kinds}
    while (message := log.recv_match(type=kinds)) is not None:
        if getattr(message, "I", getattr(message, "Instance", 0)) == 0:
            found[message.get_type()].append(message)
    return found


def _mgauss(message: Any, name: str) -> list[float]:
    return [UT_PER_MGAUSS * float(getattr(message, f"{name}{axis}", 0.0)) for axis in "XYZ"]


def _place(fix: Any) -> RecordingPlace:
    year = 1970.0 + fix._timestamp / _SECONDS_PER_YEAR
    # without the receiver's time the log counts from its start
    return RecordingPlace(fix.Lat, fix.Lng, fix.Alt, year if year > _FIRST_YEAR else None)


# ---------------------------------------------------------------- ULog


def read_ulog_compass(path: Path) -> MagnetometerRecording:
    """Read PX4's compass: raw where it was logged, else calibrated.

    Raises:
        ConfigError: not a ULog, or no magnetometer in it.
    """
    record = read_ulog(path)
    with contextlib.redirect_stdout(io.StringIO()):
        log = ULog(str(path), ["sensor_mag"])
    imus = [event.item for event in record.events if isinstance(event.item, ImuSample)]
    topic = next((topic for topic in log.data_list if topic.multi_id == 0), None)
    onboard = onboard_of("px4", dict(log.initial_parameters))
    if topic is not None and len(topic.data["timestamp"]):
        fields = UT_PER_GAUSS * np.stack([np.asarray(topic.data[a], dtype=float) for a in "xyz"], axis=1)
        times = (1e-6 * np.asarray(topic.data["timestamp"], dtype=float)).tolist()
        mags = [MagSample(t, vector3(f)) for t, f in zip(times, fields.tolist(), strict=True)]
        raw, force = paired(mags, imus)
        recording = MagnetometerRecording(str(path), "autopilot", raw, force=force, onboard=onboard)
        if onboard is None:
            recording.sensor, recording.force = "other", None
            recording.notes.append("the compass is turned, or its parameters are not logged: in its own axes")
    else:
        mags = [event.item for event in record.events if isinstance(event.item, MagSample)]
        if not mags:
            raise ConfigError(f"{path}: no magnetometer in it; expected sensor_mag or vehicle_magnetometer")
        raw, force = paired(mags, imus)
        recording = MagnetometerRecording(str(path), "autopilot", raw, force=force)
        recording.notes.append(
            "no raw readings in the log: the calibration goes on top of the autopilot's own"
        )
    recording.place = record.place
    return recording


# ---------------------------------------------------------------- our own


def read_own_log(path: Path) -> MagnetometerRecording:
    """Read a flight of ours.

    Raises:
        ConfigError: unreadable, no magnetometer in it, or its calibration is not at hand.
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
        recording.body_from_sensor = body_from_sensor = mounting(config.sense.imu.body_from_sensor_deg)
        recording.raw = body @ body_from_sensor
        recording.force = None if force is None else force @ body_from_sensor
    return _uncalibrated(recording, config)


def _uncalibrated(recording: MagnetometerRecording, config: CompanionConfig) -> MagnetometerRecording:
    """Take off what the flight's settings had applied."""
    settings = config.sense.imu if recording.sensor == "mpu9250" else config.sense.autopilot
    if settings.magnetometer_calibration is not None:
        key = f"{recording.source}: flown with a calibration"
        applied = load_magnetometer_calibration(settings.magnetometer_calibration, recording.sensor, key)
        recording.raw = applied.undo(recording.raw)
        recording.notes.append(f"{settings.magnetometer_calibration}, which it was flown with, was taken off")
    return recording
