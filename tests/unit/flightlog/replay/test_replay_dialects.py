"""One second as ArduPilot of 2014 to 2025 and PX4 1.11 to 1.16 name it: the same samples come out."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import ConfigError
from companion.flightlog.replay.dataflash import read_dataflash
from companion.flightlog.replay.flight_record import FlightRecord
from companion.flightlog.replay.ulog import read_ulog
from tests.unit.flightlog.replay.log_files import BOOT_S, DataFlash, Ulog

RATE, FORCE = (0.1, 0.2, 0.3), (1.0, 2.0, -9.0)
FIELD_UT = (21.7, 0.4, -58.6)
PLACE = (-35.36, 149.16, 590.08)
VELOCITY = (0.0, 2.0, 0.5)
ACCURACY = (1.5, 2.5, 0.25)


def item(record: FlightRecord, kind: type[Any]) -> Any:
    """The only sample of its kind: what another instance measured is not taken for it."""
    (found,) = [event.item for event in record.events if isinstance(event.item, kind)]
    return found


# ---------------------------------------------------------------- ArduPilot

_IMU = "GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
_EKF = "Roll,Pitch,Yaw,VN,VE,VD"
DataFlashNames = Mapping[str, tuple[str, str]]
DATAFLASH: dict[str, DataFlashNames] = {
    "3.2, 2014": {
        "IMU": ("Iffffff", f"TimeMS,{_IMU}"),
        "IMU2": ("Iffffff", f"TimeMS,{_IMU}"),
        "MAG": ("Ihhhhhhhhh", "TimeMS,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOfsX,MOfsY,MOfsZ"),
        "GPS": ("BIHBcLLeeEefI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"),
        "UBX3": ("IBfff", "TimeMS,Instance,hAcc,vAcc,sAcc"),
        "ATT": ("IccccCCCC", "TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw"),
        "EKF1": ("IccCfffffffccc", f"TimeMS,{_EKF},dPD,PN,PE,PD,GX,GY,GZ"),
    },
    "3.4, 2016": {
        "IMU": ("QffffffIIfBB", f"TimeUS,{_IMU},ErrG,ErrA,Temp,GyHlt,AcHlt"),
        "IMU2": ("QffffffIIfBB", f"TimeUS,{_IMU},ErrG,ErrA,Temp,GyHlt,AcHlt"),
        "MAG": ("QhhhhhhhhhB", "TimeUS,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOfsX,MOfsY,MOfsZ,Health"),
        "GPS": ("QBIHBcLLeeEefB", "TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,RAlt,Alt,Spd,GCrs,VZ,U"),
        "GPA": ("QCCCC", "TimeUS,VDop,HAcc,VAcc,SAcc"),
        "RFND": ("QCC", "TimeUS,Dist1,Dist2"),
        "ATT": ("QccccCCCC", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw"),
        "NKF1": ("QccCfffffffccc", f"TimeUS,{_EKF},dPD,PN,PE,PD,GX,GY,GZ"),
    },
    "3.6, 2018": {
        "IMU": ("QffffffIIfBBHH", f"TimeUS,{_IMU},EG,EA,T,GH,AH,GHz,AHz"),
        "MAG": ("QhhhhhhhhhBI", "TimeUS,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S"),
        "GPS": ("QBIHBcLLefffB", "TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,U"),
        "GPA": ("QCCCCBI", "TimeUS,VDop,HAcc,VAcc,SAcc,VV,SMS"),
        "RFND": ("QCBCB", "TimeUS,Dist1,Orient1,Dist2,Orient2"),
        "ATT": ("QccccCCCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF"),
        "NKF1": ("QccCfffffffccce", f"TimeUS,{_EKF},dPD,PN,PE,PD,GX,GY,GZ,OH"),
        "NKF6": ("QccCfffffffccce", f"TimeUS,{_EKF},dPD,PN,PE,PD,GX,GY,GZ,OH"),
    },
    "4.1 to 4.6, 2021 to 2025": {
        "IMU": ("QBffffffIIfBBHH", f"TimeUS,I,{_IMU},EG,EA,T,GH,AH,GHz,AHz"),
        "MAG": ("QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S"),
        "GPS": ("QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"),
        "GPA": ("QBCCCCfBIHfHH", "TimeUS,I,VDop,HAcc,VAcc,SAcc,YAcc,VV,SMS,Delta,Und,RTCMFU,RTCMFD"),
        "RFND": ("QBCBBb", "TimeUS,Instance,Dist,Stat,Orient,Quality"),
        "ATT": ("Qfffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF"),
        "XKF1": ("QBccCfffffffccce", f"TimeUS,C,{_EKF},dPD,PN,PE,PD,GX,GY,GZ,OH"),
    },
}
VALUES: dict[str, float] = {
    **dict(zip(_IMU.split(","), (*RATE, *FORCE), strict=True)),
    **{"Temp": 25.5, "T": 25.5, "MagX": 217, "MagY": 4, "MagZ": -586, "Health": 1},
    **{"Status": 3, "Week": 1871, "GWk": 1871, "NSats": 9, "HDop": 1.59},
    **{"Lat": PLACE[0], "Lng": PLACE[1], "Alt": PLACE[2], "Spd": 2.0, "GCrs": 90.0, "VZ": 0.5},
    **dict(zip(("HAcc", "VAcc", "SAcc"), ACCURACY, strict=True)),
    **dict(zip(("hAcc", "vAcc", "sAcc"), ACCURACY, strict=True)),
    **{"Dist1": 1.5, "Orient1": 25, "Dist": 1.5, "Stat": 4, "Orient": 25},
    **{"Roll": 1.0, "Pitch": 2.0, "Yaw": 3.0, "VN": 4.0, "VE": 5.0, "VD": 6.0},
}


def add_row(log: DataFlash, names: DataFlashNames, name: str, time_s: float, **instead: float) -> None:
    """A message with the values by its columns' names, zero where there is none."""
    times = {"TimeUS": round(1e6 * time_s), "TimeMS": round(1e3 * time_s)}
    if name == "GPS":
        times |= {"TimeMS": 603_882_400, "GMS": 603_882_400, "T": round(1e3 * time_s)}
    values = VALUES | times | instead
    layout, columns = names[name]
    row = [values.get(column, 0) for column in columns.split(",")]
    log.add(name, *(v if code in "fcCeEL" else int(v) for code, v in zip(layout, row, strict=True)))


def write(path: Path, names: DataFlashNames) -> Path:
    """Every message once, and once more what a second instance measured; the EKF's twice."""
    log = DataFlash()
    for name, (layout, columns) in names.items():
        log.define(name, layout, columns)
    for name in ("GPA", "UBX3", *(name for name in names if name not in ("GPA", "UBX3"))):
        if name in names:
            other = name in ("IMU2", "NKF6")
            add_row(log, names, name, 1.0, **({"GyrX": 9.0, "VN": 9.0} if other else {}))
    for name in set(names) & {"EKF1", "NKF1", "XKF1", "ATT"}:
        add_row(log, names, name, 1.1)
    for name, (_, columns) in names.items():
        if instance := {"I", "Instance", "C"} & set(columns.split(",")):
            add_row(log, names, name, 1.2, **dict.fromkeys(instance, 1), GyrX=9.0, MagX=9, VN=9.0, Dist=9.0)
    path.write_bytes(log.data)
    return path


@pytest.mark.parametrize("names", DATAFLASH.values(), ids=DATAFLASH)
def test_ardupilots_names_of_every_year_are_understood(tmp_path: Path, names: DataFlashNames) -> None:
    record = read_dataflash(write(tmp_path / "a.bin", names))
    imu, fix = item(record, ImuSample), item(record, GpsFix)
    assert (imu.rate_body_rad_s, imu.specific_force_body_m_s2) == (
        pytest.approx(RATE),
        pytest.approx(FORCE),
    )
    assert imu.time_s == 1.0
    columns = names["IMU"][1].split(",")
    warm = 25.5 if {"T", "Temp"} & set(columns) else math.nan
    assert imu.temperature_c == pytest.approx(warm, nan_ok=True)
    assert item(record, MagSample).field_body_ut == pytest.approx(FIELD_UT)
    assert (fix.latitude_deg, fix.longitude_deg, fix.altitude_m) == pytest.approx(PLACE)
    assert fix.velocity_ned_m_s == pytest.approx(VELOCITY)
    assert (fix.horizontal_accuracy_m, fix.vertical_accuracy_m, fix.speed_accuracy_m_s) == ACCURACY
    assert fix.time_s == pytest.approx(1.0 - 0.2)
    if "RFND" in names:
        assert item(record, RangeSample).distance_m == pytest.approx(1.5)
    tracks = record.references["recorded"].tracks
    assert tracks["velocity"].values.tolist() == [[4.0, 5.0, 6.0]] * 2
    assert len(tracks["attitude"]) == 2
    assert record.place is not None
    assert record.place.year == pytest.approx(2015.89, abs=0.01)


def test_an_imu_without_time_is_said_to_be_too_old(tmp_path: Path) -> None:
    log = DataFlash()
    log.define("IMU", "ffffff", _IMU)
    log.add("IMU", *RATE, *FORCE)
    path = tmp_path / "2013.bin"
    path.write_bytes(log.data)
    with pytest.raises(ConfigError, match=r"2013\.bin: IMU has no time; expected a log of ArduPilot 3\.2"):
        read_dataflash(path)


# ---------------------------------------------------------------- PX4

INTEGERS = {"lat": "int32_t", "lon": "int32_t", "alt": "int32_t", "alt_ellipsoid": "int32_t"}
DOUBLES = dict.fromkeys(("latitude_deg", "longitude_deg", "altitude_msl_m", "altitude_ellipsoid_m"), "double")
ULOG: dict[str, tuple[dict[str, str], tuple[str, ...], dict[str, float]]] = {
    "1.11": (INTEGERS, ("vehicle_gps_position",), {"EKF2_GPS_DELAY": 150.0, "EKF2_GPS_POS_X": 0.1}),
    "1.13": (INTEGERS, ("sensor_gps", "vehicle_gps_position"), {"EKF2_GPS_DELAY": 150.0}),
    "1.13, no voting": (INTEGERS, ("sensor_gps",), {"EKF2_GPS_DELAY": 150.0}),
    "1.14 to 1.16": (DOUBLES, ("vehicle_gps_position", "sensor_gps"), {"EKF2_GPS_DELAY": 150.0}),
    "since 2026": (DOUBLES, ("vehicle_gps_position",), {"SENS_GPS0_DELAY": 150, "SENS_GPS0_OFFX": 0.1}),
}


@pytest.mark.parametrize(("place", "topics", "parameters"), ULOG.values(), ids=ULOG)
def test_px4s_names_of_every_version_are_understood(
    tmp_path: Path, place: dict[str, str], topics: tuple[str, ...], parameters: dict[str, float]
) -> None:
    antenna = next((key for key in parameters if key.endswith("X")), None)
    if antenna is not None:
        parameters = parameters | {antenna[:-1] + "Y": 0.0, antenna[:-1] + "Z": -0.2}
    log = Ulog(parameters)
    log.define(
        "sensor_combined",
        gyro_rad="float[3]",
        gyro_integral_dt="uint32_t",
        accelerometer_timestamp_relative="int32_t",
        accelerometer_m_s2="float[3]",
        accelerometer_integral_dt="uint32_t",
        accelerometer_clipping="uint8_t",
    )
    log.define("vehicle_magnetometer", device_id="uint32_t", magnetometer_ga="float[3]")
    speed = dict.fromkeys(("vel_m_s", "vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "cog_rad"), "float")
    accuracy = dict.fromkeys(("s_variance_m_s", "c_variance_rad", "eph", "epv", "hdop"), "float")
    for topic in topics:
        log.define(
            topic,
            time_utc_usec="uint64_t",
            **place,
            **accuracy,
            **speed,
            fix_type="uint8_t",
            satellites_used="uint8_t",
        )
    log.add("sensor_combined", 0.0, *RATE, 5000, 0, *FORCE, 5000, 0)
    log.add("vehicle_magnetometer", 0.0, 1, *(0.01 * u for u in FIELD_UT))
    scale = (1e7, 1e7, 1e3) if place is INTEGERS else (1.0, 1.0, 1.0)
    where = [round(p * s) if s != 1.0 else p for p, s in zip(PLACE, scale, strict=True)]
    h, v, s = ACCURACY
    for topic in topics:
        row = (s, 0.1, h, v, 1.0, 2.06, *VELOCITY, 1.57)
        log.add(topic, 0.0, 1_707_350_400_000_000, *where, where[2], *row, 3, 9)
    path = tmp_path / "a.ulg"
    path.write_bytes(log.data)
    record = read_ulog(path)
    imu, fix = item(record, ImuSample), item(record, GpsFix)
    assert imu.rate_body_rad_s == pytest.approx(RATE)
    assert imu.specific_force_body_m_s2 == pytest.approx(FORCE)
    assert item(record, MagSample).field_body_ut == pytest.approx(FIELD_UT)
    assert (fix.latitude_deg, fix.longitude_deg, fix.altitude_m) == pytest.approx(PLACE)
    assert fix.velocity_ned_m_s == pytest.approx(VELOCITY)
    assert (fix.horizontal_accuracy_m, fix.vertical_accuracy_m, fix.speed_accuracy_m_s) == ACCURACY
    assert fix.time_s == pytest.approx(BOOT_S - 0.15)
    assert record.antenna_position_body_m == (None if antenna is None else pytest.approx((0.1, 0.0, -0.2)))
