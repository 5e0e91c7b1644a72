"""Logs of ArduPilot and PX4, made byte by byte of a flight whose truth is known."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, IDENTITY, ZERO3, Vector3, vector3
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample, VehicleState
from companion.config import AlignmentConfig, ConfigError
from companion.flightlog.replay.compare import Comparison, ReplayErrors
from companion.flightlog.replay.dataflash import read_dataflash
from companion.flightlog.replay.flight_record import (
    FlightRecord,
    RecordedEvent,
    RecordedReference,
    Sample,
    Source,
)
from companion.flightlog.replay.plausible import implausible, shortcomings, why_unaligned
from companion.flightlog.replay.run import replay
from companion.flightlog.replay.settings import choose
from companion.flightlog.replay.ulog import read_ulog
from tests.programs import ProgramHere
from tests.unit.estimate.estimate_flight import ANTENNA, EstimateFlight, hover, pad_at_rest
from tests.unit.flightlog.replay.log_files import BOOT_S, FLIGHT, DataFlash, Ulog, write_dataflash, write_ulog

WRITERS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], FlightRecord]]] = {
    "ArduPilot": (write_dataflash, read_dataflash),
    "PX4": (write_ulog, read_ulog),
    "old PX4": (lambda path: write_ulog(path, old=True), read_ulog),
}


@pytest.fixture(scope="module", params=WRITERS)
def record(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> FlightRecord:
    write, read = WRITERS[request.param]
    return read(write(tmp_path_factory.mktemp("logs") / "a.log"))


def of_kind(record: FlightRecord, kind: type[Sample]) -> list[RecordedEvent]:
    return [event for event in record.events if isinstance(event.item, kind)]


def flown(kind: type[Sample]) -> list[tuple[float, Sample]]:
    return [(arrival_s, sample) for arrival_s, sample in FLIGHT.samples if isinstance(sample, kind)]


def errors_of(record: FlightRecord) -> ReplayErrors:
    return Comparison(replay(record.events, choose(record, None).rig), record.references["recorded"]).errors()


def rms(errors: ReplayErrors, name: str) -> float:
    figures = getattr(errors, name)
    assert figures is not None, name
    return float(figures.rms)


# ---------------------------------------------------------------- all of them


def test_the_samples_are_those_of_the_flight(record: FlightRecord) -> None:
    for kind, field, resolution in (
        (ImuSample, "rate_body_rad_s", 1e-6),
        (ImuSample, "specific_force_body_m_s2", 1e-5),
        (MagSample, "field_body_ut", 0.06),
        (GpsFix, "velocity_ned_m_s", 1e-5),
    ):
        read = np.array([getattr(event.item, field) for event in of_kind(record, kind)])
        told = np.array([getattr(sample, field) for _, sample in flown(kind)])
        # the old PX4 log shows a field with the next IMU sample: the last one may be missing
        assert len(told) - len(read) in (0, 1)
        assert np.abs(read - told[: len(read)]).max() < resolution
    assert len(of_kind(record, RangeSample)) == len(flown(RangeSample))


def test_a_fix_was_measured_before_it_arrived(record: FlightRecord) -> None:
    for event, (arrival_s, sample) in zip(of_kind(record, GpsFix), flown(GpsFix), strict=True):
        assert isinstance(event.item, GpsFix)
        assert isinstance(sample, GpsFix)
        assert event.arrival_s == pytest.approx(BOOT_S + arrival_s, abs=2e-6)
        assert event.item.time_s == pytest.approx(event.arrival_s - 0.15, abs=1e-6)
        assert event.item.latitude_deg == pytest.approx(sample.latitude_deg, abs=1e-7)
        assert event.item.altitude_m == pytest.approx(sample.altitude_m, abs=0.006)
        assert event.item.horizontal_accuracy_m == pytest.approx(2.5, abs=0.01)
        assert event.item.speed_accuracy_m_s == pytest.approx(0.15, abs=0.001)


def test_everything_arrives_in_order(record: FlightRecord) -> None:
    arrivals = [event.arrival_s for event in record.events]
    assert arrivals == sorted(arrivals)


def test_the_estimators_find_what_the_autopilot_found(record: FlightRecord) -> None:
    errors = errors_of(record)
    # the world model's declination is 1.6° off the one that the flight was made with
    assert rms(errors, "inclination_deg") < 1.0
    assert rms(errors, "heading_deg") < 3.5
    assert rms(errors, "velocity_m_s") < 0.4
    assert rms(errors, "position_m") < 3.0


def test_the_field_is_that_of_the_place_and_date(record: FlightRecord) -> None:
    field = choose(record, None).field
    assert field.source == "World Magnetic Model at 47.000, 8.000, 2024.1"
    assert field.ned_ut == pytest.approx((21.6, 1.2, 42.9), abs=0.3)


def test_a_settings_file_goes_before_what_the_log_says(record: FlightRecord, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "estimate: {magnetic_field_ned_ut: [20.9, 0.6, 42.9]}\n"
        "sense: {gps: {antenna_position_body_m: [0.0, 0.0, 0.0]}}\n"
    )
    choice = choose(record, path)
    assert choice.field.source == "settings"
    assert choice.rig.config.estimate.magnetic_field_ned_ut == (20.9, 0.6, 42.9)
    assert choice.rig.config.sense.gps.antenna_position_body_m == (0.0, 0.0, 0.0)
    errors = Comparison(replay(record.events, choice.rig), record.references["recorded"]).errors()
    assert rms(errors, "heading_deg") < 2.0


# ---------------------------------------------------------------- ArduPilot


def test_ardupilots_antenna_is_used(tmp_path: Path) -> None:
    record = read_dataflash(write_dataflash(tmp_path / "a.bin"))
    antenna = choose(record, None).rig.config.sense.gps.antenna_position_body_m
    assert antenna == pytest.approx(ANTENNA)


@pytest.mark.parametrize("trim_deg", [(8.0, 0.0), (0.0, -6.0)])
def test_a_board_that_tilts_shows_the_airframes_attitude(
    tmp_path: Path, trim_deg: tuple[float, float]
) -> None:
    roll, pitch = trim_deg
    trim = (math.radians(roll), math.radians(pitch))
    record = read_dataflash(write_dataflash(tmp_path / "a.bin", trim_rad=trim))
    assert rms(errors_of(record), "inclination_deg") < 1.0


def test_the_old_names_of_ardupilot_3_are_understood(tmp_path: Path) -> None:
    log = DataFlash()
    log.define("IMU", "IffffffIIf", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,ErrG,ErrA,Temp")
    log.define("MAG", "IhhhhhhhhhB", "TimeMS,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOfsX,MOfsY,MOfsZ,Health")
    log.define("GPS", "BIHBcLLeeEefI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T")
    log.define("EKF1", "IccCffffffccc", "TimeMS,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD,GX,GY,GZ")
    log.define("UBX3", "IBfff", "TimeMS,Instance,hAcc,vAcc,sAcc")
    for k in range(3):
        log.add("IMU", 1000 + 20 * k, 0.1, 0.2, 0.3, 1.0, 2.0, -9.0, 0, 0, 25.5)
        log.add("MAG", 1001 + 20 * k, 217, 4, -586, 0, 0, 0, 0, 0, 0, 1)
        log.add("EKF1", 1000 + 20 * k, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 0.0, 0.0, 0.0)
    log.add("GPS", 1, 0, 0, 0, 99.99, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1050)
    log.add("UBX3", 1050, 0, 1.5, 2.5, 0.2)
    log.add("GPS", 3, 603_882_400, 1871, 9, 1.59, -35.36, 149.16, -2.0, 590.08, 2.0, 90.0, 0.5, 1100)
    path = tmp_path / "old.bin"
    path.write_bytes(log.data)
    record = read_dataflash(path)
    imu, mag, fix = (of_kind(record, kind)[0].item for kind in (ImuSample, MagSample, GpsFix))
    assert imu.time_s == 1.0
    assert isinstance(mag, MagSample)
    assert mag.field_body_ut == pytest.approx((21.7, 0.4, -58.6))
    assert len(of_kind(record, GpsFix)) == 1
    assert isinstance(fix, GpsFix)
    assert fix.time_s == pytest.approx(1.1 - 0.2)
    assert fix.velocity_ned_m_s == pytest.approx((0.0, 2.0, 0.5))
    assert (fix.horizontal_accuracy_m, fix.vertical_accuracy_m) == (1.5, 2.5)
    assert record.place is not None
    assert record.place.year == pytest.approx(2015.89, abs=0.01)
    assert record.references["recorded"].tracks["velocity"].values[0].tolist() == [4.0, 5.0, 6.0]


def test_a_dataflash_log_with_garbage_in_it_is_read_around_it(tmp_path: Path) -> None:
    path = write_dataflash(tmp_path / "a.bin")
    data = path.read_bytes()
    whole = len(read_dataflash(path).events)
    path.write_bytes(data[:200_000] + bytes(700) + data[200_000:])
    record = read_dataflash(path)
    assert whole - 50 < len(record.events) <= whole
    assert any("damaged" in note for note in record.notes)


def test_a_dataflash_log_cut_within_a_message_is_read_up_to_there(tmp_path: Path) -> None:
    path = write_dataflash(tmp_path / "a.bin")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    record = read_dataflash(path)
    assert record.events[-1].arrival_s == pytest.approx(BOOT_S + 8.0, abs=1.0)


# ---------------------------------------------------------------- PX4


def test_what_px4_does_not_know_is_not_compared_with(tmp_path: Path) -> None:
    record = read_ulog(write_ulog(tmp_path / "a.ulg"))
    position = record.references["recorded"].tracks["position"]
    assert position.time_s[0] > BOOT_S + 2.0
    assert np.abs(position.values).max() < 100.0


def test_a_simulators_groundtruth_is_the_truth(tmp_path: Path) -> None:
    record = read_ulog(write_ulog(tmp_path / "a.ulg"))
    assert record.references["truth"].tracks.keys() == {"attitude"}


def test_a_ulog_cut_within_a_message_is_read_up_to_there(tmp_path: Path) -> None:
    path = write_ulog(tmp_path / "a.ulg")
    data = path.read_bytes()
    assert read_ulog(path).cut is None
    path.write_bytes(data[: len(data) // 2 + 1])
    record = read_ulog(path)
    assert record.cut == "the log is cut within a message: read up to there"
    assert record.events[-1].arrival_s == pytest.approx(BOOT_S + 8.0, abs=1.0)


def test_px4s_learned_magnetometer_bias_is_taken_off(tmp_path: Path) -> None:
    path = write_ulog(tmp_path / "a.ulg", parameters={"EKF2_MAGBIAS_Y": 0.05})
    field = of_kind(read_ulog(path), MagSample)[0].item
    told = flown(MagSample)[0][1]
    assert isinstance(field, MagSample)
    assert isinstance(told, MagSample)
    assert np.subtract(field.field_body_ut, told.field_body_ut) == pytest.approx((0.0, -5.0, 0.0), abs=1e-3)


def test_a_raw_magnetometer_is_calibrated_by_the_logs_own_parameters(tmp_path: Path) -> None:
    device = 592905
    parameters = {"CAL_MAG0_ID": 1, "CAL_MAG1_ID": device, "CAL_MAG1_XOFF": 0.1, "CAL_MAG1_YSCALE": 2.0}
    log = Ulog({**parameters, "CAL_MAG1_XODIAG": 0.5})
    log.define("sensor_mag", device_id="uint32_t", x="float", y="float", z="float")
    log.add("sensor_mag", 0.0, device, 0.3, 0.1, -0.2)
    path = tmp_path / "raw.ulg"
    path.write_bytes(log.data)
    (event,) = read_ulog(path).events
    assert isinstance(event.item, MagSample)
    # off the offset (0.2, 0.1, -0.2); scaled and mixed: x + y/2, x/2 + 2y, z
    assert event.item.field_body_ut == pytest.approx((25.0, 30.0, -20.0), abs=1e-4)


def test_vehicle_imu_serves_where_sensor_combined_is_missing(tmp_path: Path) -> None:
    log = Ulog()
    fields = {"delta_angle": "float[3]", "delta_velocity": "float[3]"}
    log.define("vehicle_imu", **fields, delta_angle_dt="uint32_t", delta_velocity_dt="uint32_t")
    log.add("vehicle_imu", 0.0, 0.001, 0.002, 0.0, 0.0, 0.0, -0.049, 5000, 5000)
    path = tmp_path / "imu.ulg"
    path.write_bytes(log.data)
    (event,) = read_ulog(path).events
    assert isinstance(event.item, ImuSample)
    assert event.item.rate_body_rad_s == pytest.approx((0.2, 0.4, 0.0))
    assert event.item.specific_force_body_m_s2 == pytest.approx((0.0, 0.0, -9.8), abs=1e-5)


def test_without_gps_north_is_magnetic_and_the_dip_is_the_logs_own(tmp_path: Path) -> None:
    flight = EstimateFlight(hover, pad_at_rest, duration_s=16.0, sensors=frozenset({"imu", "mag"}))
    record = read_ulog(write_ulog(tmp_path / "a.ulg", flight))
    choice = choose(record, None)
    assert choice.field.source.startswith("the log's magnetometer (no GPS in it)")
    assert choice.field.ned_ut == pytest.approx((20.9, 0.0, 42.9), abs=1.0)
    assert rms(errors_of(record), "heading_deg") < 4.0


# ---------------------------------------------------------------- neither


@pytest.mark.parametrize("read", [read_dataflash, read_ulog])
def test_garbage_is_refused_in_one_line(
    tmp_path: Path, read: Callable[[Path], FlightRecord], capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "garbage"
    path.write_bytes(b"")
    with pytest.raises(ConfigError, match="that can be read"):
        read(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("head", "tail"), [(16, 4_000), (64, 4_000), (400, 30_000), (16, 100_000)])
def test_a_ulog_that_goes_over_into_garbage_is_read_to_its_end(
    head: int, tail: int, tmp_path: Path, program: ProgramHere
) -> None:
    path = write_ulog(tmp_path / "a.ulg", EstimateFlight(hover, pad_at_rest, duration_s=1.0))
    path.write_bytes(path.read_bytes()[:head] + Random(0).randbytes(tail))
    assert f"{path}: no IMU samples in the log" in program("companion", "replay", path).refusal


def test_a_log_whose_formats_are_damaged_is_refused_in_one_line(tmp_path: Path, program: ProgramHere) -> None:
    flight = EstimateFlight(hover, pad_at_rest, duration_s=1.0)
    ulog = write_ulog(tmp_path / "a.ulg", flight)
    ulog.write_bytes(ulog.read_bytes().replace(b"float vel_d_m_s", b"float vel_d_m?s"))
    dataflash = write_dataflash(tmp_path / "a.bin", flight)
    dataflash.write_bytes(dataflash.read_bytes().replace(b"GyrZ,AccX,", b"GyrZ,Acc?,"))
    for path in (ulog, dataflash):
        assert "that can be read: " in program("companion", "replay", path).refusal
        assert "that can be read: " in program("calibrate-magnetometer", path).refusal


# ----------------
# One second as ArduPilot of 2014 to 2025 and PX4 1.11 to 1.16 name it: the same samples come out.

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
    assert (imu.rate_body_rad_s, imu.specific_force_body_m_s2) == (pytest.approx(RATE), pytest.approx(FORCE))
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


# ---------------- What no vehicle can have is named in the notes of a replay; what it can have is not

HERE: Vector3 = (47.3, 8.5, 488.0)
WELL = VehicleState(
    time_s=9.0,
    attitude=IDENTITY,
    rate_body_rad_s=ZERO3,
    position_ned_m=ZERO3,
    velocity_ned_m_s=ZERO3,
    acceleration_ned_m_s2=ZERO3,
    gyro_bias_rad_s=(0.01, 0.0, -0.02),
    accel_bias_m_s2=(0.2, -0.1, 0.3),
    attitude_std_rad=0.02,
    velocity_std_m_s=0.1,
    position_std_m=1.0,
    aligned=True,
    has_gps=True,
    origin=HERE,
)


def notes(
    state: VehicleState = WELL,
    fastest_m_s: float = 15.0,
    refused: dict[str, int] | None = None,
    truth: Vector3 = HERE,
) -> list[str]:
    references: dict[Source, RecordedReference] = {"truth": RecordedReference({}, truth)}
    return implausible(state, fastest_m_s, {"mag": 1000}, refused or {"field_gate": 100}, references, HERE)


def test_a_flight_as_flights_are_has_no_note() -> None:
    assert notes() == []


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (notes(replace(WELL, accel_bias_m_s2=(2.0, 0.0, 0.0))), "accelerometer bias 2.0 m/s²"),
        (notes(replace(WELL, gyro_bias_rad_s=(0.0, 0.4, 0.0))), "gyroscope bias 22.9°/s"),
        (notes(fastest_m_s=240.0), "speed 240 m/s"),
        (notes(refused={"field_gate": 570, "mag_gate": 300}), "87% of the magnetometer's samples"),
        (notes(truth=(47.3, 8.5, 0.0)), "the origin of the log's truth is at 0 m, the GPS's at 488 m"),
    ],
)
def test_what_cannot_be_is_said_once(found: list[str], words: str) -> None:
    (line,) = found
    assert words in line


def test_a_log_without_gps_or_magnetometer_is_judged_by_the_rest() -> None:
    assert implausible(None, 0.0, {}, {}, {}, None) == []


# ---------------- Why the estimators never aligned over a log

FIELD = (20.9, 0.6, 42.9)


def log(times: np.ndarray, shaking_rad_s: float = 0.0, field: bool = True) -> list[RecordedEvent]:
    rng = np.random.default_rng(1)
    events = []
    for t in times.tolist():
        rate = vector3(shaking_rad_s * rng.standard_normal(3))
        events.append(RecordedEvent(t, ImuSample(t, rate, (0.0, 0.0, -GRAVITY_M_S2), 20.0)))
        if field:
            events.append(RecordedEvent(t, MagSample(t, FIELD)))
    return events


SECONDS = np.arange(0.0, 10.0, 0.01)


@pytest.mark.parametrize(
    ("events", "words"),
    [
        (log(SECONDS[::10]), "the IMU comes at 10 Hz; expected at least 30"),
        (log(SECONDS, 0.5), "at rest for 0.0 s at most and 10.0 s long; expected 2 s at rest"),
        (
            log(np.concatenate((SECONDS[:100], 4.0 + SECONDS[:100]))),
            "silent for 3.0 s, 1.0 s after its start; expected no gap beyond 2 s",
        ),
        (log(SECONDS, field=False), "1000 samples of the IMU and 0 of the magnetometer"),
    ],
)
def test_the_reason_is_named(events: list[RecordedEvent], words: str) -> None:
    assert words in why_unaligned(events, AlignmentConfig())


def test_each_reason_that_holds_is_named() -> None:
    words = why_unaligned(log(SECONDS[::20], 0.5), AlignmentConfig())
    assert words.count(";") >= 2


def test_a_log_that_falls_short_of_what_is_documented_is_told_in_what() -> None:
    assert shortcomings(log(SECONDS[::2])) == []
    assert shortcomings(log(SECONDS[::4])) == ["the IMU comes at 25 Hz; expected at least 30"]
    gaps = np.concatenate((SECONDS, 13.0 + SECONDS, 30.0 + SECONDS))
    (words,) = shortcomings(log(gaps))  # 100 Hz, whatever the mean over its gaps
    assert words.startswith("the IMU is silent for 7.0 s, 23.0 s after its start, and 1 more")
