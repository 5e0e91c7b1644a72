"""Messages of the autopilot's sensors, packed and unpacked, to samples in SI units."""

import math

import pytest

from companion.base.geometry import GRAVITY_M_S2, Vector3
from companion.base.messages import RangeSample
from companion.config import RangeConfig
from companion.link.telemetry.autopilot_sensors import gps_fix, imu_sample, mag_sample, range_sample, stamp_s
from tests.unit.link.telemetry.autopilot_readings import distance, gps, highres, raw, scaled

T = 3.0


# ---------------------------------------------------------------- IMU


def test_highres_imu_is_in_si_units_already() -> None:
    message = highres(T, xacc=1.5, yacc=-2.5, zacc=-9.0, xgyro=0.1, ygyro=-0.2, zgyro=0.3)
    sample = imu_sample(message, T)
    assert sample is not None
    assert sample.specific_force_body_m_s2 == pytest.approx((1.5, -2.5, -9.0))
    assert sample.rate_body_rad_s == pytest.approx((0.1, -0.2, 0.3))
    assert sample.temperature_c == 31.0
    assert stamp_s(message) == T


@pytest.mark.parametrize("build", [raw, scaled])
def test_raw_and_scaled_imu_are_in_thousandths_of_g_rad_and_gauss(build: type) -> None:
    message = build(T, 100, -200, -1000, 10, -20, 3000, 209, -6, 429)
    sample, field = imu_sample(message, T), mag_sample(message, T)
    assert sample is not None
    assert field is not None
    g = GRAVITY_M_S2
    assert sample.specific_force_body_m_s2 == pytest.approx((0.1 * g, -0.2 * g, -g))
    assert sample.rate_body_rad_s == pytest.approx((0.01, -0.02, 3.0))
    assert field.field_body_ut == pytest.approx((20.9, -0.6, 42.9))
    assert sample.temperature_c == pytest.approx(31.0)
    assert stamp_s(message) == T


@pytest.mark.parametrize(
    ("sent", "field_ut"),
    [
        pytest.param((0.209, -0.006, 0.429), (20.9, -0.6, 42.9), id="gauss"),
        pytest.param(
            (59868.1, -230040.2, -529062.7), (5.98681, -23.00402, -52.90627), id="ArduPilot's: 1e6 too large"
        ),
    ],
)
def test_the_field_of_highres_imu_becomes_microtesla(sent: Vector3, field_ut: Vector3) -> None:
    field = mag_sample(highres(T, **dict(zip(("xmag", "ymag", "zmag"), sent, strict=True))), T)
    assert field is not None
    assert field.field_body_ut == pytest.approx(field_ut)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro"])
def test_a_value_that_is_not_finite_costs_the_sample(name: str, value: float) -> None:
    assert imu_sample(highres(T, **{name: value}), T) is None
    assert mag_sample(highres(T, xmag=value), T) is None


def test_only_what_highres_imu_says_is_new_counts() -> None:
    assert mag_sample(highres(T, fields_updated=0b111_111), T) is None
    assert imu_sample(highres(T, fields_updated=0b111_111), T) is not None
    assert imu_sample(highres(T, fields_updated=0b111_000_000), T) is None
    assert mag_sample(highres(T, fields_updated=0b111_000_000), T) is not None
    assert mag_sample(highres(T, fields_updated=0b011_111_111), T) is None


def test_a_saturated_or_another_imu_and_a_compass_that_is_missing_are_refused() -> None:
    assert imu_sample(raw(T, 32767, 0, -1000, 0, 0, 0, 209, 6, 429), T) is None
    assert imu_sample(raw(T, 0, 0, -1000, 0, -32768, 0, 209, 6, 429), T) is None
    assert imu_sample(raw(T, identity=1), T) is None
    assert mag_sample(raw(T, 0, 0, -1000, 0, 0, 0, 0, 0, 0), T) is None
    assert mag_sample(highres(T, xmag=0.0, ymag=0.0, zmag=0.0), T) is None


# ---------------------------------------------------------------- GPS


@pytest.mark.parametrize(
    ("course_deg", "north", "east"),
    [(0.0, 2.0, 0.0), (90.0, 0.0, 2.0), (180.0, -2.0, 0.0), (270.0, 0.0, -2.0), (135.0, -1.4142, 1.4142)],
)
def test_the_course_over_ground_turns_speed_into_north_and_east(
    course_deg: float, north: float, east: float
) -> None:
    fix = gps_fix(gps(T, vel=200, cog=round(100 * course_deg)), T)
    assert fix is not None
    assert fix.velocity_ned_m_s == pytest.approx((north, east, 0.0), abs=1e-4)
    assert fix.speed_accuracy_m_s == pytest.approx(0.3)


def test_a_fix_has_the_place_and_doubts_its_climb_rate() -> None:
    fix = gps_fix(gps(T, lat=470001234, lon=-80004321, alt=401_234), T)
    assert fix is not None
    assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx((47.0001234, -8.0004321))
    assert fix.altitude_m == pytest.approx(401.234)
    assert (fix.horizontal_accuracy_m, fix.vertical_accuracy_m) == pytest.approx((2.5, 3.8))
    assert fix.satellites == 9
    assert fix.vertical_speed_accuracy_m_s is not None
    assert fix.vertical_speed_accuracy_m_s >= 10.0


def test_what_a_receiver_does_not_tell_is_doubted() -> None:
    fix = gps_fix(gps(T, h_acc=0, v_acc=0, vel_acc=0, eph=121, epv=65535, satellites_visible=255), T)
    assert fix is not None
    assert fix.horizontal_accuracy_m == pytest.approx(3.025)
    assert fix.vertical_accuracy_m >= 5.0
    assert fix.speed_accuracy_m_s == 0.5
    assert fix.satellites == 0
    no_speed = gps_fix(gps(T, vel=65535, cog=9000), T)
    no_course = gps_fix(gps(T, vel=900, cog=65535), T)
    assert no_speed is not None
    assert no_course is not None
    assert no_speed.speed_accuracy_m_s >= 10.0
    assert no_course.velocity_ned_m_s == (0.0, 0.0, 0.0)
    assert no_course.speed_accuracy_m_s > 9.0


@pytest.mark.parametrize("changes", [{"fix_type": 0}, {"fix_type": 1}, {"fix_type": 2}, {"lat": 0, "lon": 0}])
def test_no_fix_is_no_fix(changes: dict[str, int]) -> None:
    assert gps_fix(gps(T, **changes), T) is None


# ---------------------------------------------------------------- range


def ranged(**changes: int) -> RangeSample | None:
    return range_sample(distance(T, **changes), T, RangeConfig())


def test_a_rangefinder_that_looks_down_gives_metres() -> None:
    assert ranged() == RangeSample(T, 1.5)


@pytest.mark.parametrize(
    "changes",
    [
        {"orientation": 0},
        {"orientation": 24},
        {"current_distance": 19},
        {"current_distance": 20},  # or anything nearer
        {"current_distance": 401},
        {"current_distance": 0, "min_distance": 0},
        {"current_distance": 500, "max_distance": 1000},
        {"current_distance": 3, "min_distance": 0},
        {"signal_quality": 1},
        {"covariance": 37},
        {"covariance": 254},
    ],
)
def test_a_range_that_means_nothing_is_refused(changes: dict[str, int]) -> None:
    assert ranged(**changes) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"current_distance": 21},
        {"current_distance": 4, "min_distance": 0},
        {"current_distance": 400},
        {"signal_quality": 0},
        {"signal_quality": 2},
        {"signal_quality": 100},
        {"covariance": 36},
        {"covariance": 255},
    ],
)
def test_a_range_at_its_bounds_or_of_unknown_quality_counts(changes: dict[str, int]) -> None:
    assert ranged(**changes) is not None
