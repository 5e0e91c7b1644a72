"""Truth to what the elements feel: statistics against the data sheets' figures."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, FloatArray, Vector3, ned_from_geodetic
from sitl.sensors.inertial import ACCEL_FILTER, GYRO_FILTER, NO_IMU_ERRORS, ImuErrors, ImuLowPass, ImuSensor
from sitl.sensors.sensors import GpsErrors, GpsSensor, MagErrors, MagSensor, RangeErrors, RangeSensor
from tests.unit.sitl.sensors.flawless import NO_GPS_ERRORS, NO_MAG_ERRORS, NO_RANGE_ERRORS

DT_S = 1.0 / 400.0
HOME: Vector3 = (47.0, 8.0, 400.0)
REST: Vector3 = (0.0, 0.0, -GRAVITY_M_S2)
STILL: Vector3 = (0.0, 0.0, 0.0)


def imu_run(errors: ImuErrors, steps: int, throttle: float, seed: int = 1) -> tuple[FloatArray, FloatArray]:
    sensor = ImuSensor(errors, np.random.default_rng(seed), DT_S, np.eye(3))
    samples = [sensor.sample(REST, STILL, throttle) for _ in range(steps)]
    return np.array([s[0] for s in samples]), np.array([s[1] for s in samples])


def test_without_errors_the_imu_feels_the_truth_in_its_own_axes() -> None:
    mount = np.diag((1.0, -1.0, -1.0))
    sensor = ImuSensor(NO_IMU_ERRORS, np.random.default_rng(1), DT_S, mount)
    force, rate = sensor.sample((1.0, 2.0, 3.0), (0.1, 0.2, 0.3), 0.8)
    assert force == pytest.approx((1.0, -2.0, -3.0))
    assert rate == pytest.approx((0.1, -0.2, -0.3))


def test_noise_has_the_data_sheets_density_behind_the_filter() -> None:
    """300 µg/√Hz behind 99 Hz is some 3 mg, 0.01 dps/√Hz behind 92 Hz is 0.1 dps (the data sheet's rms)."""
    quiet = replace(ImuErrors(), gyro_wander_rad_s=0.0, accel_wander_m_s2=0.0)
    force, rate = imu_run(quiet, 8000, 0.0)
    assert force.std(axis=0) == pytest.approx(np.full(3, 3.0e-3 * GRAVITY_M_S2), rel=0.2)
    assert rate.std(axis=0) == pytest.approx(np.full(3, math.radians(0.10)), rel=0.2)


def test_bias_is_drawn_once_a_flight_and_differs_between_seeds() -> None:
    means = np.array([imu_run(ImuErrors(), 1500, 0.0, seed)[1].mean(axis=0) for seed in range(25)])
    assert means.std() == pytest.approx(math.radians(0.3), rel=0.25)
    assert abs(means).max() < math.radians(1.5)


def test_vibration_comes_with_the_throttle_and_is_damped_by_the_filter() -> None:
    only = replace(NO_IMU_ERRORS, vibration_m_s2=1.5, vibration_rad_s=0.04)
    still, _ = imu_run(only, 2000, 0.0)
    hover, _ = imu_run(only, 2000, 0.5)
    full, _ = imu_run(only, 2000, 1.0)
    assert still.std(axis=0).max() < 1e-9
    assert 0.2 < hover[:, 0].std() < 0.75
    # at full throttle it is twice as strong, and at 130 Hz well beyond the corner of the filter
    assert 0.1 < full[:, 0].std() < 0.75
    assert hover.mean(axis=0) == pytest.approx(REST, abs=0.05)


def test_vibration_is_lines_of_four_rotors_that_beat_and_move_with_the_throttle() -> None:
    only = replace(NO_IMU_ERRORS, vibration_m_s2=1.5, vibration_rad_s=0.04)
    for throttle in (0.4, 0.6):
        force, _ = imu_run(only, 8000, throttle)
        power = np.abs(np.fft.rfft(force[:, 0] * np.hanning(8000))) ** 2
        hertz = np.fft.rfftfreq(8000, DT_S)
        expected_hz = 130.0 * math.sqrt(throttle)
        near = np.abs(hertz - expected_hz) < 0.08 * expected_hz
        assert power[near].sum() > 0.99 * power[hertz > 5.0].sum()
        # four lines, not one: the strongest has less than all
        lone = np.abs(hertz - hertz[power.argmax()]) < 0.3
        assert power[lone].sum() < 0.7 * power[near].sum()


def test_an_accelerometer_rectifies_by_the_square_of_the_vibration() -> None:
    def shift_m_s2(factor: float) -> float:
        errors = replace(NO_IMU_ERRORS, vibration_m_s2=1.5 * factor, accel_rectification_g_g2=0.005)
        plain = replace(errors, accel_rectification_g_g2=0.0)
        bent, straight = imu_run(errors, 4000, 0.5)[0], imu_run(plain, 4000, 0.5)[0]
        return float(np.linalg.norm((bent - straight).mean(axis=0)))

    assert shift_m_s2(20.0) == pytest.approx(4.0 * shift_m_s2(10.0), rel=0.05)
    assert 0.01 < shift_m_s2(20.0) < 0.5


@pytest.mark.parametrize("table", [GYRO_FILTER, ACCEL_FILTER])
@pytest.mark.parametrize("dlpf", [2, 3, 4])
def test_the_filter_delays_a_ramp_by_the_data_sheets_time(
    dlpf: int, table: dict[int, tuple[float, float]]
) -> None:
    bandwidth_hz, delay_s = table[dlpf]
    filter_ = ImuLowPass(bandwidth_hz, delay_s, DT_S)
    for k in range(2000):
        out = filter_.step(k * DT_S, 0.0, 0.0)
    assert 1999 * DT_S - out[0] == pytest.approx(delay_s, abs=0.0018)


def test_the_filter_passes_the_corner_frequency_at_minus_three_decibels_and_settled_it_makes_no_step() -> (
    None
):
    filter_ = ImuLowPass(41.0, 0.0, DT_S)
    wave = [filter_.step(math.sin(math.tau * 41.0 * k * DT_S), 0.0, 0.0)[0] for k in range(4000)]
    assert np.std(wave[1000:]) * math.sqrt(2.0) == pytest.approx(math.sqrt(0.5), rel=0.02)
    filter_ = ImuLowPass(41.0, 0.0059, DT_S)
    filter_.settle((1.0, -2.0, 3.0))
    for _ in range(50):
        assert filter_.step(1.0, -2.0, 3.0) == pytest.approx((1.0, -2.0, 3.0))


def test_the_same_seed_gives_the_same_flight() -> None:
    first, second = imu_run(ImuErrors(), 600, 0.5, 3), imu_run(ImuErrors(), 600, 0.5, 3)
    other = imu_run(ImuErrors(), 600, 0.5, 4)
    assert np.array_equal(first[0], second[0])
    assert not np.array_equal(first[0], other[0])


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, 270])
def test_the_magnetometer_feels_the_field_in_the_accelerometers_axes(yaw_deg: int) -> None:
    turned = math.radians(yaw_deg)
    c, s = math.cos(turned), math.sin(turned)
    mount = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    sensor = MagSensor(NO_MAG_ERRORS, np.random.default_rng(1), mount)
    north_in_sensor = sensor.sample((20.0, 0.0, 40.0), 0.5)
    assert north_in_sensor == pytest.approx((20.0 * c, -20.0 * s, 40.0), abs=1e-9)


def test_magnetometer_noise_and_the_motors_current() -> None:
    sensor = MagSensor(MagErrors(), np.random.default_rng(2), np.eye(3))
    idle = np.array([sensor.sample((20.0, 0.0, 40.0), 0.0) for _ in range(3000)])
    full = np.array([sensor.sample((20.0, 0.0, 40.0), 1.0) for _ in range(3000)])
    assert idle.std(axis=0) == pytest.approx(np.full(3, 0.6), rel=0.1)
    assert np.linalg.norm(full.mean(axis=0) - idle.mean(axis=0)) == pytest.approx(1.0, abs=0.1)


def test_without_errors_gps_is_the_truth() -> None:
    sensor = GpsSensor(NO_GPS_ERRORS, np.random.default_rng(1), HOME)
    reading = sensor.sample(0.0, (30.0, -40.0, -7.0), (1.0, 2.0, -0.5))
    where = ned_from_geodetic(reading.latitude_deg, reading.longitude_deg, reading.altitude_m, HOME)
    assert where == pytest.approx((30.0, -40.0, -7.0), abs=1e-3)
    assert reading.velocity_ned_m_s == (1.0, 2.0, -0.5)


def test_gps_wanders_slowly_and_hisses_little() -> None:
    sensor = GpsSensor(GpsErrors(), np.random.default_rng(6), HOME)
    read = [sensor.sample(0.2 * k, STILL, STILL) for k in range(20000)]
    shown = np.array([(r.latitude_deg, r.longitude_deg, r.altitude_m) for r in read])
    wander = (shown - HOME) * (111_174.0, 76_056.0, 1.0)
    assert wander.std(axis=0) == pytest.approx((1.0, 1.0, 1.5), rel=0.3)
    # from one fix to the next: white noise and 0.2 s of the wander
    expected = math.sqrt(2 * 0.1**2 + 2 * (1.0 - math.exp(-0.2 / 60.0)))
    assert np.diff(wander[:, 0]).std() == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("height_m", "tilt_deg", "heard_m"),
    [
        (1.5, 0.0, 1.5),
        (0.01, 0.0, 0.03),  # near and far ends of the range
        (4.49, 0.0, 4.49),
        (4.51, 0.0, None),
        (2.0, 10.0, 2.0),  # the nearest point in the beam
        (2.0, 15.0, 2.0),
        (2.0, 35.0, 2.0 / math.cos(math.radians(20))),
    ],
)
def test_without_errors_the_echo_is_of_the_nearest_point_in_its_beam(
    height_m: float, tilt_deg: float, heard_m: float | None
) -> None:
    sensor = RangeSensor(NO_RANGE_ERRORS, np.random.default_rng(1))
    heard = sensor.sample(height_m, math.radians(tilt_deg))
    assert heard == (heard_m if heard_m is None else pytest.approx(heard_m))


def test_shares_of_lost_and_wrong_echoes_and_the_noise_of_the_rest() -> None:
    sensor = RangeSensor(RangeErrors(), np.random.default_rng(3))
    echoes = [sensor.sample(2.0) for _ in range(8000)]
    heard = np.array([e for e in echoes if e is not None])
    good = heard[abs(heard - 2.0) < 0.15]
    assert 1.0 - len(heard) / len(echoes) == pytest.approx(0.03, abs=0.008)
    assert 1.0 - len(good) / len(heard) == pytest.approx(0.01, abs=0.004)
    assert good.std() == pytest.approx(0.023, rel=0.05)
