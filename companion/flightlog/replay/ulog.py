"""PX4's ULog (.ulg): sensor_combined, magnetometer, GPS and distance; held against PX4's own estimates.

sensor_combined and vehicle_magnetometer are calibrated and in body axes. Old logs keep the magnetometer
within sensor_combined; a log that has only sensor_mag is calibrated here by its own CAL_MAG parameters.
Topics that PX4's simulators add (`..._groundtruth`) are the truth.
"""

import contextlib
import io
import math
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyulog import ULog

from companion.base.geometry import FloatArray, Vector3, quat_from_euler, vector3
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.flightlog.replay.flight_record import (
    SECONDS_PER_YEAR,
    UT_PER,
    FlightRecord,
    RecordedEvent,
    RecordedReference,
    RecordingPlace,
    antenna_by,
    damage_reported,
    known_references,
    known_tracks,
)

# PX4's RELATIVE_TIMESTAMP_INVALID
NO_TIMESTAMP: Final = 0x7FFFFFFF
GPS_DELAY_MS: Final = 110.0  # the default of either name
# renamed in 2026, the newest first
GPS_DELAYS: Final = ("SENS_GPS0_DELAY", "EKF2_GPS_DELAY")
ANTENNAS: Final = ("SENS_GPS0_OFF", "EKF2_GPS_POS_")
DOWNWARD: Final = 25  # MAV_SENSOR_ROTATION_PITCH_270
HEADER_BYTES: Final = 16
KIND: Final = "ULog"

Columns = Mapping[str, Any]


def read_ulog(path: Path) -> FlightRecord:
    data = path.read_bytes()
    with damage_reported(path, KIND):
        log = parse_ulog(data)
        reading = _Reading(log)
        return FlightRecord(
            kind="px4",
            events=reading.events(),
            references=known_references(reading.reference(""), reading.reference("_groundtruth")),
            place=reading.place(),
            antenna_position_body_m=antenna_by(log.initial_parameters, *ANTENNAS),
            cut=None if _is_whole(data) else "the log is cut within a message: read up to there",
            notes=["damaged places in the log passed over"] if log.file_corruption else [],
        )


def parse_ulog(data: bytes, topics: list[str] | None = None) -> ULog:
    """Parse a log's bytes, of all topics or of some; garbage raises whatever Python raises there."""
    with contextlib.redirect_stdout(io.StringIO()):
        return ULog(_ParsedBytes(data), topics)


class _ParsedBytes(io.BytesIO):
    """What the library reads from.

    Where a message's type is unknown it steps back by the message's stated length, to look one byte further
    on. From a message that the file's end cuts that leads before it: to before the file, or round for ever.
    """

    _missing = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self._missing = max((size or 0) - len(data), 0)
        return data

    def seek(self, offset: int, whence: int = 0, /) -> int:
        return super().seek(offset + (self._missing if whence == 1 else 0), whence)


def _is_whole(data: bytes) -> bool:
    """Whether the last message ends with the file: each starts with its length (2 bytes) and type (1)."""
    at = HEADER_BYTES
    while at + 3 <= len(data):
        at += 3 + struct.unpack_from("<H", data, at)[0]
    return at == len(data)


class _Reading:
    def __init__(self, log: ULog) -> None:
        self._topics: dict[str, Columns] = {}
        for topic in log.data_list:
            # the first instance is the one in use, or as good as any other
            if topic.multi_id == 0 and len(topic.data["timestamp"]):
                self._topics[topic.name] = topic.data
        self._parameters: dict[str, float] = dict(log.initial_parameters)

    # ------------------------------------------------------------ sensors

    def events(self) -> list[RecordedEvent]:
        events = [*self._imu(), *self._mag(), *self._gps(), *self._range()]
        # a stable sort: of what came at one time the IMU is first
        return sorted(events, key=lambda event: event.arrival_s)

    def _imu(self) -> Iterator[RecordedEvent]:
        if (data := self._topics.get("sensor_combined")) is not None:
            rates, forces = _rows(data, "gyro_rad"), _rows(data, "accelerometer_m_s2")
        elif (data := self._topics.get("vehicle_imu")) is not None:
            # increments over their own span, µs
            rates = _rows(data, "delta_angle") / (1e-6 * np.asarray(data["delta_angle_dt"], float))[:, None]
            forces = (
                _rows(data, "delta_velocity") / (1e-6 * np.asarray(data["delta_velocity_dt"], float))[:, None]
            )
        else:
            return
        for time_s, rate, force in zip(_times(data), rates.tolist(), forces.tolist(), strict=True):
            yield RecordedEvent(time_s, ImuSample(time_s, vector3(rate), vector3(force), math.nan))

    def _mag(self) -> Iterator[RecordedEvent]:
        if (data := self._topics.get("vehicle_magnetometer")) is not None:
            yield from _mag_events(_times(data), _rows(data, "magnetometer_ga") - self._learned_bias_ga())
        elif "magnetometer_ga[0]" in (data := self._topics.get("sensor_combined", {})):
            yield from self._combined_mag(data)
        elif (data := self._topics.get("sensor_mag")) is not None:
            rows = np.stack([np.asarray(data[axis], dtype=float) for axis in "xyz"], axis=1)
            yield from _mag_events(_times(data), self._calibrated(rows, int(data["device_id"][0])))

    def _combined_mag(self, data: Columns) -> Iterator[RecordedEvent]:
        """A field is repeated with every IMU sample until a new one comes; its age distinguishes them."""
        ages = np.asarray(data["magnetometer_timestamp_relative"], dtype=np.int64)
        measured = np.asarray(data["timestamp"], dtype=np.int64) + ages
        known = np.flatnonzero(ages != NO_TIMESTAMP)
        fresh = known[np.diff(measured[known], prepend=-1) > 0]
        arrivals = np.asarray(data["timestamp"])[fresh].tolist()
        fields = (UT_PER["G"] * _rows(data, "magnetometer_ga")[fresh]).tolist()
        for arrival, time, field in zip(arrivals, measured[fresh].tolist(), fields, strict=True):
            yield RecordedEvent(1e-6 * arrival, MagSample(1e-6 * time, vector3(field)))

    def _learned_bias_ga(self) -> list[float]:
        """What versions 1.8 to 1.11 had learnt in flight and took off within their EKF."""
        return [self._parameters.get(f"EKF2_MAGBIAS_{axis}", 0.0) for axis in "XYZ"]

    def _calibrated(self, field_ga: FloatArray, device: int) -> FloatArray:
        """By the CAL_MAG parameters of the device: (raw - offset) through the scale matrix."""
        slots = [n for n in range(4) if self._parameters.get(f"CAL_MAG{n}_ID") == device]
        if not slots:
            return field_ga

        def values(name: str, default: float) -> list[float]:
            return [self._parameters.get(f"CAL_MAG{slots[0]}_{a}{name}", default) for a in "XYZ"]

        x, y, z = values("ODIAG", 0.0)
        matrix = np.diag(values("SCALE", 1.0)) + np.array([[0.0, x, y], [x, 0.0, z], [y, z, 0.0]])
        return np.asarray((field_ga - np.array(values("OFF", 0.0))) @ matrix.T)

    def _gps(self) -> Iterator[RecordedEvent]:
        data = self._gps_data()
        if data is None:
            return
        known = (self._parameters[name] for name in GPS_DELAYS if name in self._parameters)
        latency_s = 1e-3 * next(known, GPS_DELAY_MS)
        places, velocities = _places(data), _columns(data, "vel_n_m_s", "vel_e_m_s", "vel_d_m_s")
        accuracies = _columns(data, "eph", "epv", "s_variance_m_s")
        rows = zip(_times(data), places.tolist(), velocities.tolist(), accuracies.tolist(), strict=True)
        for k, (arrival_s, place, velocity, accuracy) in enumerate(rows):
            if data["fix_type"][k] >= 3:
                fix = GpsFix(
                    arrival_s - latency_s,
                    *vector3(place),
                    vector3(velocity),
                    *vector3(accuracy),
                    int(data["satellites_used"][k]),
                )
                yield RecordedEvent(arrival_s, fix)

    def _gps_data(self) -> Columns | None:
        return self._topics.get("vehicle_gps_position", self._topics.get("sensor_gps"))

    def _range(self) -> Iterator[RecordedEvent]:
        data = self._topics.get("distance_sensor")
        if data is None:
            return
        pointing = data.get("orientation", np.full(len(data["timestamp"]), DOWNWARD))
        rows = zip(_times(data), np.asarray(data["current_distance"]).tolist(), pointing, strict=True)
        for time_s, distance_m, orientation in rows:
            if orientation == DOWNWARD:
                yield RecordedEvent(time_s, RangeSample(time_s, distance_m))

    # ------------------------------------------------------------ what the log knows of itself

    def place(self) -> RecordingPlace | None:
        """Where and when, by the first fix; without GPS by the local frame's origin."""
        data = self._gps_data()
        if data is not None and (fixed := np.flatnonzero(np.asarray(data["fix_type"]) >= 3)).size:
            first = int(fixed[0])
            utc_s = 1e-6 * float(data.get("time_utc_usec", np.zeros(first + 1))[first])
            latitude, longitude, altitude = _places(data)[first].tolist()
            return RecordingPlace(
                latitude, longitude, altitude, 1970.0 + utc_s / SECONDS_PER_YEAR if utc_s else None
            )
        return None

    def reference(self, suffix: str) -> RecordedReference:
        """By PX4's estimates; with the suffix of its simulators by the truth."""
        samples: dict[str, Any] = {}
        origin = None
        if (data := self._topics.get(f"vehicle_attitude{suffix}")) is not None:
            samples["attitude"] = zip(_times(data), _attitudes(data), strict=True)
        if (data := self._topics.get(f"vehicle_local_position{suffix}")) is not None:
            velocity, position = _columns(data, "vx", "vy", "vz"), _columns(data, "x", "y", "z")
            velocity[~_flags(data, "v_xy_valid", "v_z_valid")] = math.nan
            position[~_flags(data, "xy_valid", "z_valid")] = math.nan
            samples["velocity"] = zip(_times(data), velocity.tolist(), strict=True)
            samples["position"] = zip(_times(data), position.tolist(), strict=True)
            origin = _origin(data)
        return RecordedReference(known_tracks(**samples), origin)


def _times(data: Columns) -> list[float]:
    return [1e-6 * t for t in np.asarray(data["timestamp"]).tolist()]


def _columns(data: Columns, *names: str) -> FloatArray:
    return np.stack([np.asarray(data[name], dtype=float) for name in names], axis=1)


def _rows(data: Columns, name: str) -> FloatArray:
    return _columns(data, *(f"{name}[{k}]" for k in range(3)))


def _flags(data: Columns, *names: str) -> Any:
    return np.logical_and.reduce([np.asarray(data[name]) > 0 for name in names])


def _mag_events(times_s: list[float], field_ga: FloatArray) -> Iterator[RecordedEvent]:
    for time_s, field in zip(times_s, (UT_PER["G"] * field_ga).tolist(), strict=True):
        yield RecordedEvent(time_s, MagSample(time_s, vector3(field)))


def _places(data: Columns) -> FloatArray:
    """Latitude, longitude (deg) and altitude over the sea (m); integers until PX4 1.14, doubles since."""
    if "latitude_deg" in data:
        return _columns(data, "latitude_deg", "longitude_deg", "altitude_msl_m")
    return _columns(data, "lat", "lon", "alt") * (1e-7, 1e-7, 1e-3)


def _attitudes(data: Columns) -> list[tuple[float, ...]]:
    if "q[0]" in data:
        return [tuple(row) for row in _columns(data, *(f"q[{k}]" for k in range(4))).tolist()]
    return [quat_from_euler(*row) for row in _columns(data, "roll", "pitch", "yaw").tolist()]


def _origin(data: Columns) -> Vector3 | None:
    """Where the local frame has its origin, at the end of the log; None when it hangs on no place."""
    if "ref_lat" not in data or not (known := np.flatnonzero(_flags(data, "xy_global", "z_global"))).size:
        return None
    return vector3(_columns(data, "ref_lat", "ref_lon", "ref_alt")[int(known[-1])].tolist())
