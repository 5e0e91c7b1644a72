"""Logs of ArduPilot and PX4, made byte by byte of a flight whose truth is known."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import ConfigError
from companion.flightlog.replay.compare import Comparison, ReplayErrors
from companion.flightlog.replay.dataflash import read_dataflash
from companion.flightlog.replay.flight_record import FlightRecord, RecordedEvent, Sample
from companion.flightlog.replay.run import replay
from companion.flightlog.replay.settings import choose
from companion.flightlog.replay.ulog import read_ulog
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
