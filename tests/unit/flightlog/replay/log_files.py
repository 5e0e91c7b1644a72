"""Small logs as ArduPilot, PX4 and we write them, of the estimators' test flight, byte by byte."""

import math
import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from companion.base.geometry import (
    Quaternion,
    Vector3,
    euler_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_rotate,
    scale,
    vector3,
)
from companion.base.messages import GpsFix, ImuSample, MagSample, Phase, PlanStep, RangeSample, Truth
from companion.config import CONFIG_FOLDER, load_config
from companion.flightlog.record import FlightLog
from companion.flightlog.replay.flight_record import ReplaySetup
from companion.flightlog.replay.run import new_estimator
from companion.pad import load_pad
from tests.unit.estimate.estimate_flight import (
    ANTENNA,
    FIELD_NED_UT,
    HOME,
    VEHICLE,
    EstimateFlight,
    feed,
    hover,
    pad_circle,
    velocity,
)

FLIGHT = EstimateFlight(hover, pad_circle, seed=3, duration_s=16.0)
GPS_WEEK, GPS_WEEK_MS = 2300, 345_600_000  # 8 February 2024
BOOT_S = 10.0  # the autopilots' clocks started before the flight


# ---------------------------------------------------------------- ours


def own_rig() -> ReplaySetup:
    """The settings that the flight of ours was flown with."""
    flown = {
        "sense": {"gps": {"antenna_position_body_m": list(ANTENNA)}},
        "estimate": {"magnetic_field_ned_ut": list(FIELD_NED_UT)},
    }
    config = load_config(CONFIG_FOLDER / "companion.yaml", flown)
    return ReplaySetup(config, VEHICLE, load_pad(config.pad))


def write_own(folder: Path, flight: EstimateFlight = FLIGHT, *, settings: bool = True) -> Path:
    """A flight of ours: samples as they arrive, a control cycle at 30 Hz, the truth at the end."""
    rig = own_rig()
    log, estimator = FlightLog(folder, start_unix_s=1.7e9), new_estimator(rig)
    if settings:
        log.write_settings(config=rig.config, vehicle=rig.vehicle, pad=rig.pad)
    topics = {"ImuSample": "imu", "MagSample": "mag", "GpsFix": "gps", "RangeSample": "range"}
    next_s, truth = 0.0, []
    for arrival_s, sample in flight.samples:
        while next_s < arrival_s:
            # a cycle comes when the loop gets to it, not on a grid
            now_s = next_s + 0.0013 * math.sin(next_s)
            vehicle, pad = estimator.vehicle(now_s), estimator.pad(now_s)
            log.write("plan", PlanStep(now_s, Phase.SEARCH), now_s)
            if vehicle is not None:
                log.write("vehicle", vehicle, now_s)
                if pad is not None:
                    log.write("pad", pad, now_s)
            truth.append(_truth(flight, now_s))
            next_s += 1.0 / 30.0
        feed(estimator, sample)
        log.write(topics.get(type(sample).__name__, "sighting"), sample, arrival_s)
    for record in truth:
        log.write("truth", record, record.time_s)
    log.close()
    return folder / "flight.mcap"


def _truth(flight: EstimateFlight, t: float) -> Truth:
    return Truth(
        t,
        flight.path(t),
        velocity(flight.path, t),
        flight.attitude(t),
        flight.pad_path(t),
        velocity(flight.pad_path, t),
        flight.pad_heading(t),
        in_contact=t < 5.0,
    )


# ---------------------------------------------------------------- ArduPilot


_CODES = {"b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "Q": "Q", "f": "f", "d": "d"}
_CODES |= {"n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B"}
_SCALES = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}


class DataFlash:
    """Writes messages after the FMT message that defines them."""

    def __init__(self) -> None:
        self.data = bytearray()
        self._formats: dict[str, tuple[int, str]] = {}
        self.define("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", number=0x80)

    def define(self, name: str, layout: str, columns: str, number: int | None = None) -> None:
        number = 0x81 + len(self._formats) if number is None else number
        self._formats[name] = (number, layout)
        length = 3 + struct.calcsize("<" + "".join(_CODES[code] for code in layout))
        self.add("FMT", number, length, name.encode(), layout.encode(), columns.encode())

    def add(self, name: str, *values: Any) -> None:
        number, layout = self._formats[name]
        plain = [
            round(value * _SCALES[code]) if code in _SCALES else value
            for code, value in zip(layout, values, strict=True)
        ]
        codes = "<" + "".join(_CODES[code] for code in layout)
        self.data += struct.pack("<BBB", 0xA3, 0x95, number) + struct.pack(codes, *plain)


def degrees_of(attitude: Quaternion) -> Vector3:
    roll, pitch, yaw = euler_from_quat(attitude)
    return (math.degrees(roll), math.degrees(pitch), math.degrees(yaw) % 360.0)


def write_dataflash(
    path: Path,
    flight: EstimateFlight = FLIGHT,
    *,
    parameters: dict[str, float] | None = None,
    trim_rad: tuple[float, float] = (0.0, 0.0),
    leave_out: Iterable[str] = (),
) -> Path:
    """As ArduPilot 4 writes it, by a board that tilts by the trim."""
    log, out = DataFlash(), set(leave_out)
    log.define("PARM", "QNff", "TimeUS,Name,Value,Default")
    log.define("IMU", "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz")
    log.define("MAG", "QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S")
    log.define("GPS", "QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U")
    log.define("GPA", "QBCCCCfBIHfHH", "TimeUS,I,VDop,HAcc,VAcc,SAcc,YAcc,VV,SMS,Delta,Und,RTCMFU,RTCMFD")
    log.define("RFND", "QBCBBb", "TimeUS,Instance,Dist,Stat,Orient,Quality")
    log.define("ATT", "QccccCCCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF")
    log.define("XKF1", "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH")
    for name, value in {
        "AHRS_TRIM_X": trim_rad[0],
        "AHRS_TRIM_Y": trim_rad[1],
        "GPS1_DELAY_MS": 150.0,
        **dict(zip(("GPS1_POS_X", "GPS1_POS_Y", "GPS1_POS_Z"), ANTENNA, strict=True)),
        **(parameters or {}),
    }.items():
        log.add("PARM", 0, name.encode(), value, value)
    board = quat_conjugate(quat_from_euler(*trim_rad, 0.0))
    next_s = 0.0
    for arrival_s, sample in flight.samples:
        us = round(1e6 * (BOOT_S + arrival_s))
        if isinstance(sample, ImuSample) and "IMU" not in out:
            rate = quat_rotate(board, sample.rate_body_rad_s)
            force = quat_rotate(board, sample.specific_force_body_m_s2)
            log.add("IMU", us, 0, *rate, *force, 0, 0, 35.0, 1, 1, 1000, 1000)
            # a second IMU that must not be mistaken for the first
            log.add("IMU", us, 1, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 0, 0, 35.0, 1, 1, 1000, 1000)
        elif isinstance(sample, MagSample) and "MAG" not in out:
            field = [round(10.0 * value) for value in quat_rotate(board, sample.field_body_ut)]
            log.add("MAG", us, 0, *field, 0, 0, 0, 0, 0, 0, 1, us)
            log.add("MAG", us + 1, 0, 5000, 5000, 5000, 0, 0, 0, 0, 0, 0, 0, us)  # not healthy
        elif isinstance(sample, GpsFix) and "GPS" not in out:
            _add_gps(log, us, sample)
        elif isinstance(sample, RangeSample):
            log.add("RFND", us, 0, sample.distance_m, 4, 25, 100)
        if arrival_s >= next_s:
            next_s += 0.1
            _add_states(log, us, flight, arrival_s)
    path.write_bytes(log.data)
    return path


def _add_gps(log: DataFlash, us: int, fix: GpsFix) -> None:
    north, east, down = fix.velocity_ned_m_s
    course = math.degrees(math.atan2(east, north)) % 360.0
    place = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
    h, v, s = fix.horizontal_accuracy_m, fix.vertical_accuracy_m, fix.speed_accuracy_m_s
    log.add("GPA", us, 0, 1.2, h, v, s, 0.0, 1, 0, 0, 0.0, 0, 0)
    time = (GPS_WEEK_MS + us // 1000, GPS_WEEK)
    log.add("GPS", us, 0, 3, *time, 9, 1.1, *place, math.hypot(north, east), course, down, 0.0, 1)


def _add_states(log: DataFlash, us: int, flight: EstimateFlight, t: float) -> None:
    roll, pitch, yaw = degrees_of(flight.attitude(t))
    log.add("ATT", us, 0.0, roll, 0.0, pitch, 0.0, yaw, 0.0, 0.0, 3)
    speed, place = velocity(flight.path, t), flight.path(t)
    log.add("XKF1", us, 0, roll, pitch, yaw, *speed, 0.0, *place, 0.0, 0.0, 0.0, 400.0)
    log.add("XKF1", us, 1, 90.0, 45.0, 10.0, 9.0, 9.0, 9.0, 0.0, 9.0, 9.0, 9.0, 0.0, 0.0, 0.0, 400.0)


# ---------------------------------------------------------------- PX4


_ULOG_CODES = {"uint64_t": "Q", "int64_t": "q", "uint32_t": "I", "int32_t": "i", "uint8_t": "B", "bool": "?"}
_ULOG_CODES |= {"float": "f", "double": "d"}


class Ulog:
    """Writes the header, formats and parameters, then data by topic."""

    def __init__(self, parameters: dict[str, float] | None = None) -> None:
        self.data = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", round(1e6 * BOOT_S)))
        self._message(b"B", bytes(40))
        self._topics: dict[str, tuple[int, str]] = {}
        self._parameters = parameters or {}
        self._started = False

    def define(self, name: str, **fields: str) -> None:
        """Fields in order: name and type; arrays as type[n]."""
        text = f"{name}:uint64_t timestamp;" + "".join(f"{kind} {key};" for key, kind in fields.items())
        self._message(b"F", text.encode())
        layout = "<Q"
        for kind in fields.values():
            base, _, count = kind.partition("[")
            layout += (count.removesuffix("]") or "1") + _ULOG_CODES[base]
        self._topics[name] = (len(self._topics), layout)

    def add(self, name: str, time_s: float, *values: Any) -> None:
        if not self._started:
            self._start()
        number, layout = self._topics[name]
        row = struct.pack(layout, round(1e6 * (BOOT_S + time_s)), *values)
        self._message(b"D", struct.pack("<H", number) + row)

    def _start(self) -> None:
        self._started = True
        for key, value in self._parameters.items():
            kind = "int32_t" if isinstance(value, int) else "float"
            text = f"{kind} {key}".encode()
            packed = struct.pack("<i" if isinstance(value, int) else "<f", value)
            self._message(b"P", struct.pack("<B", len(text)) + text + packed)
        for name, (number, _) in self._topics.items():
            self._message(b"A", struct.pack("<BH", 0, number) + name.encode())

    def _message(self, kind: bytes, body: bytes) -> None:
        self.data += struct.pack("<H", len(body)) + kind + body


def write_ulog(
    path: Path,
    flight: EstimateFlight = FLIGHT,
    *,
    old: bool = False,
    parameters: dict[str, float] | None = None,
    start_s: float = 0.0,
) -> Path:
    """As PX4 1.14 writes it; `old`: the magnetometer within sensor_combined, places as integers."""
    log = Ulog({"EKF2_GPS_DELAY": 150.0, **(parameters or {})})
    combined = {"gyro_rad": "float[3]", "accelerometer_m_s2": "float[3]"}
    if old:
        combined |= {"magnetometer_timestamp_relative": "int32_t", "magnetometer_ga": "float[3]"}
    log.define("sensor_combined", **combined)
    if not old:
        log.define("vehicle_magnetometer", magnetometer_ga="float[3]")
    place = {"lat": "int32_t", "lon": "int32_t", "alt": "int32_t"}
    if not old:
        place = dict.fromkeys(("latitude_deg", "longitude_deg", "altitude_msl_m"), "double")
    accuracy = dict.fromkeys(("eph", "epv", "s_variance_m_s"), "float")
    speed = dict.fromkeys(("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"), "float")
    fix = {"fix_type": "uint8_t", "satellites_used": "uint8_t"}
    log.define("vehicle_gps_position", time_utc_usec="uint64_t", **place, **accuracy, **speed, **fix)
    log.define("distance_sensor", current_distance="float", orientation="uint8_t")
    log.define("vehicle_attitude", q="float[4]")
    log.define("vehicle_attitude_groundtruth", q="float[4]")
    log.define(
        "vehicle_local_position",
        **dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), "float"),
        **dict.fromkeys(("ref_lat", "ref_lon"), "double"),
        ref_alt="float",
        **dict.fromkeys(("xy_valid", "z_valid", "v_xy_valid", "v_z_valid", "xy_global", "z_global"), "bool"),
    )
    _add_flight(log, flight, old=old, start_s=start_s)
    path.write_bytes(log.data)
    return path


def _add_flight(log: Ulog, flight: EstimateFlight, *, old: bool, start_s: float) -> None:
    field, field_s, next_s = (0.2, 0.0, 0.4), -1.0, 0.0
    for arrival_s, sample in flight.samples:
        if arrival_s < start_s:
            continue
        if isinstance(sample, ImuSample):
            age = (0x7FFFFFFF if field_s < 0.0 else round(1e6 * (field_s - arrival_s)), *field)
            log.add(
                "sensor_combined",
                arrival_s,
                *sample.rate_body_rad_s,
                *sample.specific_force_body_m_s2,
                *(age if old else ()),
            )
        elif isinstance(sample, MagSample):
            field, field_s = scale(sample.field_body_ut, 0.01), arrival_s
            if not old:
                log.add("vehicle_magnetometer", arrival_s, *field)
        elif isinstance(sample, GpsFix):
            log.add("vehicle_gps_position", arrival_s, *_gps_row(sample, old=old))
        elif isinstance(sample, RangeSample):
            log.add("distance_sensor", arrival_s, sample.distance_m, 25)
        if arrival_s >= next_s:
            next_s += 0.05
            log.add("vehicle_attitude", arrival_s, *flight.attitude(arrival_s))
            log.add("vehicle_attitude_groundtruth", arrival_s, *flight.attitude(arrival_s))
            _add_local(log, flight, arrival_s)


def _gps_row(fix: GpsFix, *, old: bool) -> Sequence[Any]:
    place: tuple[float, ...] = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
    if old:
        place = (round(1e7 * place[0]), round(1e7 * place[1]), round(1e3 * place[2]))
    accuracy = (fix.horizontal_accuracy_m, fix.vertical_accuracy_m, fix.speed_accuracy_m_s)
    return (1_707_350_400_000_000, *place, *accuracy, *fix.velocity_ned_m_s, 3, fix.satellites)


def _add_local(log: Ulog, flight: EstimateFlight, t: float) -> None:
    # for the first two seconds PX4 knows nothing, and says so beside numbers that mean nothing
    valid = t > 2.0
    place = vector3(np.array(flight.path(t))) if valid else (1e6, 1e6, 1e6)
    log.add("vehicle_local_position", t, *place, *velocity(flight.path, t), *HOME, *[valid] * 6)
