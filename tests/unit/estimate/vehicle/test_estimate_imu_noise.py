"""What vibration and turns add to the IMU's noise."""

import math

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, IDENTITY, ZERO3, Vector3, vector3
from companion.base.messages import GpsFix, ImuSample, MagSample
from companion.config import EkfConfig, EstimateConfig
from companion.estimate.motion import MotionHistory
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.ekf import VehicleEkf
from companion.estimate.vehicle.ekf_inputs import GpsStep, ImuStep
from companion.estimate.vehicle.ekf_start import InitialState
from companion.estimate.vehicle.fix_watch import FixWatch, LastFix, VelocityDrift
from companion.estimate.vehicle.imu_noise import ImuNoise, StepNoise
from companion.estimate.vehicle.vehicle_estimator import VehicleEstimator

DT_S = 0.005
RESTING: Vector3 = (0.0, 0.0, -GRAVITY_M_S2)


def density_of(force_m_s2: np.ndarray, dt_s: float = DT_S) -> float:
    """Of forces (n, 3), in (m/s²)² s."""
    noise = ImuNoise(EkfConfig())
    for sample in force_m_s2.tolist():
        noise.add(ZERO3, tuple(sample), dt_s)
    return noise.now.force_density_m2_s3


def turn_density_of(rate_rad_s: np.ndarray) -> float:
    """Of rates (n, 3), in rad²/s."""
    noise = ImuNoise(EkfConfig())
    for sample in rate_rad_s.tolist():
        noise.add(tuple(sample), RESTING, DT_S)
    return noise.now.rate_density_rad2_s


def shaken(tone_hz: float, amplitude_m_s2: float) -> np.ndarray:
    """Forces (4000, 3) at rest, with a tone along one axis."""
    forces = np.tile(RESTING, (4000, 1))
    forces[:, 0] += amplitude_m_s2 * np.sin(math.tau * tone_hz * DT_S * np.arange(4000))
    return forces


@pytest.mark.parametrize("rate_hz", [1000.0, 200.0, 100.0, 50.0, 33.0, 20.0, 10.0])
def test_white_vibration_leaves_its_own_density_at_any_rate(rate_hz: float) -> None:
    count = 100 * max(int(rate_hz), 100)
    forces = RESTING + 0.5 * np.random.default_rng(3).standard_normal((count, 3))
    found = np.mean([density_of(part, 1.0 / rate_hz) for part in np.split(forces, 20)])
    assert found == pytest.approx(0.5**2 / rate_hz, rel=0.2)


@pytest.mark.parametrize("std_rad_s", [0.003, 0.1])
def test_a_gyroscopes_noise_is_measured_as_it_is(std_rad_s: float) -> None:
    """A good element's, and the one that PX4's SIH simulates."""
    rates = std_rad_s * np.random.default_rng(5).standard_normal((40_000, 3))
    found = np.mean([turn_density_of(part) for part in np.split(rates, 20)])
    assert found == pytest.approx(std_rad_s**2 * DT_S, rel=0.2)


def test_a_vehicle_that_tilts_and_levels_makes_no_noise_of_the_gyroscope() -> None:
    rates = np.zeros((4000, 3))
    rates[:, 0] = 0.5 * np.sin(math.tau * 1.5 * DT_S * np.arange(4000))
    assert turn_density_of(rates) < 0.005**2 * DT_S


def test_a_noisy_gyroscope_makes_the_attitude_uncertain_as_fast_as_it_is_noisy() -> None:
    stds = []
    for density in (0.0, 0.1**2 * DT_S):
        level = InitialState(0.0, IDENTITY, ZERO3, (20.9, 0.6, 42.9), 0.01, 0.05, 5e-4)
        ekf = VehicleEkf(EkfConfig(), ZERO3, level)
        for k in range(1, 201):
            step = ImuStep(ZERO3, RESTING, 2, noise=StepNoise(rate_density_rad2_s=density))
            ekf.apply(0.01 * k, step)
        stds.append(ekf.rotation_covariance()[0, 0])
    assert stds[1] - stds[0] == pytest.approx(2.0 * 0.1**2 * DT_S, rel=0.3)


@pytest.mark.parametrize("tone_hz", [55.0, 70.0, 92.0])
def test_a_quick_tone_leaves_little_in_the_velocity(tone_hz: float) -> None:
    white_of_its_power = 2.0**2 / 2.0 / 3.0 * DT_S
    assert density_of(shaken(tone_hz, 2.0)) < 0.03 * white_of_its_power


@pytest.mark.parametrize("tone_hz", [10.0, 15.0, 20.0, 25.0, 28.0, 175.0, 225.0])
def test_what_aliases_to_a_slow_tone_counts(tone_hz: float) -> None:
    white_of_its_power = 2.0**2 / 2.0 / 3.0 * DT_S
    assert density_of(shaken(tone_hz, 2.0)) > 0.5 * white_of_its_power


@pytest.mark.parametrize("motion_hz", [0.5, 1.0, 2.0])
def test_a_vehicle_that_speeds_up_and_brakes_does_not_vibrate(motion_hz: float) -> None:
    assert density_of(shaken(motion_hz, 3.0)) < 0.02**2 * DT_S


def test_uneven_samples_of_a_vehicle_at_rest_are_no_noise() -> None:
    noise, rng = ImuNoise(EkfConfig()), np.random.default_rng(7)
    for _ in range(4000):
        noise.add(ZERO3, RESTING, DT_S * (1.0 + 0.2 * rng.standard_normal()))
    assert noise.now.force_density_m2_s3 < 1e-20


@pytest.mark.parametrize(("period_s", "least", "most"), [(math.inf, 0.95, 1.0), (4.0, 0.0, 0.35)])
def test_only_a_turn_that_lasts_counts(period_s: float, least: float, most: float) -> None:
    noise, largest = ImuNoise(EkfConfig()), 0.0
    for k in range(4000):
        rate = math.cos(math.tau * k * DT_S / period_s)
        noise.add((rate, 0.0, 0.0), RESTING, DT_S)
        largest = max(largest, noise.now.lasting_rate_rad_s[0])
    assert least <= largest <= most


# ------------------------------------------------------------ what fixes say of the force


def watched(innovations: np.ndarray) -> FixWatch:
    """After innovations (n, 3) in m/s."""
    watch = FixWatch()
    for innovation in innovations.tolist():
        watch = watch.after(vector3(innovation), 1.0)
    return watch


def test_fixes_that_scatter_show_no_error_of_the_force() -> None:
    rng = np.random.default_rng(5)
    shown = [watched(0.13 * rng.standard_normal((25, 3))).force_error_m_s2 for _ in range(200)]
    assert np.median(shown) == 0.0
    assert np.percentile(shown, 90) < 0.4


def test_fixes_that_keep_to_one_side_show_it() -> None:
    rng = np.random.default_rng(5)
    assert watched((0.3, 0.0, 0.0) + 0.1 * rng.standard_normal((25, 3))).force_error_m_s2 > 0.8


def drifted(force_error_m_s2: float, seed: int, usual_m_s2: float = 0.4, missed: int = 0) -> VelocityDrift:
    """After 40 s of fixes at 5 Hz, each 0.085 m/s off, with a force off for a second or so at a time.

    Of every `missed` fixes the last did not come.
    """
    rng, dt_s, watch = np.random.default_rng(seed), 0.2, FixWatch()
    force, ours, kept = force_error_m_s2 * rng.standard_normal(3), np.zeros(3), math.exp(-dt_s)
    for k in range(200):
        force = kept * force + force_error_m_s2 * math.sqrt(1.0 - kept**2) * rng.standard_normal(3)
        ours = ours + force * dt_s  # the truth stands still
        if missed and k % missed < 6:
            continue
        predicted, measured = vector3(ours), 0.085 * rng.standard_normal(3)
        ours = ours + 0.4 * (measured - ours)
        fix = LastFix(k * dt_s, vector3(measured), vector3(ours))
        watch = watch.turned(fix, predicted, 0.085**2, usual_m_s2)
    return watch.drift


@pytest.mark.parametrize(
    ("force_error_m_s2", "least", "most"), [(0.0, 0.2, 0.4), (0.2, 0.45, 0.9), (0.4, 0.85, 1.0)]
)
def test_how_velocities_drift_between_fixes_shows_what_vibration_does(
    force_error_m_s2: float, least: float, most: float
) -> None:
    """Of the 0.4 m/s^2 that it usually does."""
    shares = [drifted(force_error_m_s2, seed).share for seed in range(60)]
    assert least < np.median(shares) <= most
    assert np.mean([0.4 * share < force_error_m_s2 / 1.5 for share in shares]) < 0.05


def test_without_vibration_or_with_fixes_missing_nothing_is_known_of_what_it_does() -> None:
    assert FixWatch().drift.share == 1.0
    assert drifted(0.0, 1, usual_m_s2=0.0).share == 1.0
    assert drifted(0.0, 1, missed=10).spans == 0


BEFORE_IT_IS_LOST = FixWatch()
SHOWN_TO_BE_OFF = FixWatch(mean_m_s=(0.3, 0.0, 0.0), mean_square=0.09)


@pytest.mark.parametrize(
    ("fixes", "watch", "least_m_s", "most_m_s"),
    [
        (True, BEFORE_IT_IS_LOST, 0.03, 0.12),
        (False, BEFORE_IT_IS_LOST, 0.7, 1.4),
        (False, SHOWN_TO_BE_OFF, 2.0, 4.0),
    ],
)
def test_without_fixes_vibration_shifts_the_force_as_it_usually_does_or_as_they_have_shown(
    fixes: bool, watch: FixWatch, least_m_s: float, most_m_s: float
) -> None:
    """8 m/s^2 rms, as on a small quadrotor: it may shift the force by 3 m/s^2 and usually does by 0.4."""
    level = InitialState(0.0, IDENTITY, ZERO3, (20.9, 0.6, 42.9), 0.01, 0.05, 5e-4)
    ekf = VehicleEkf(EkfConfig(), ZERO3, level)
    fix = GpsStep(ZERO3, ZERO3, (1.0, 1.0, 1.5), (0.085, 0.085, 0.12))
    ekf.apply(0.0, fix)
    ekf.fix_watch = watch
    noise = StepNoise(0.0, 3.0, usual_force_error_m_s2=0.4)
    for k in range(1, 701):
        ekf.apply(0.01 * k, ImuStep(ZERO3, RESTING, 2, noise=noise))
        if fixes and k % 20 == 0:
            ekf.apply(0.01 * k, fix)
    assert least_m_s < math.sqrt(ekf.P[model.VELOCITY, model.VELOCITY][0, 0]) < most_m_s


def test_what_vibration_usually_does_is_a_share_of_it() -> None:
    noise, rng = ImuNoise(EkfConfig()), np.random.default_rng(3)
    for _ in range(400):
        noise.add(ZERO3, vector3(RESTING + 8.0 / math.sqrt(3.0) * rng.standard_normal(3)), DT_S)
    assert noise.now.usual_force_error_m_s2 == pytest.approx(0.4, rel=0.2)
    assert noise.now.force_error_m_s2 == pytest.approx(3.0, abs=0.4)


def speed_std_after_a_gap(force_error_m_s2: float) -> float:
    """Stated on a level axis 6 s after the last fix of 20 s; the force is off for a second or so at a time.

    It vibrates by 8 m/s^2 rms from sample to sample, of which a sum keeps nothing.
    """
    rng, motion = np.random.default_rng(6), MotionHistory(1.0)
    vehicle = VehicleEstimator(EstimateConfig(), ZERO3, motion, ZERO3)
    force, velocity, kept = np.zeros(3), np.zeros(3), math.exp(-DT_S)
    for k in range(round(26.0 / DT_S)):
        time_s = k * DT_S
        flying = time_s > 4.0
        vehicle.add_mag(MagSample(time_s, (20.9, 0.6, 42.9)))
        pushed = force_error_m_s2 * math.sqrt(1.0 - kept**2) * rng.standard_normal(3)
        force = kept * force + flying * pushed
        shaken = flying * 2.8 * (-1.0) ** k * np.ones(3)
        vehicle.add_imu(ImuSample(time_s, ZERO3, vector3(RESTING + force + shaken), 20.0))
        if k % 40 == 0 and time_s < 20.0:
            seen = vector3(velocity + 0.085 * rng.standard_normal(3))
            vehicle.add_gps(GpsFix(time_s, 47.0, 8.0, 500.0, seen, 1.0, 1.5, 0.1, 12))
    covariance = vehicle.covariance()
    assert covariance is not None
    return math.sqrt(covariance[3, 3])


def test_in_a_gap_vibration_counts_for_what_fixes_have_shown_that_it_does() -> None:
    assert speed_std_after_a_gap(0.0) < 0.5
    assert speed_std_after_a_gap(0.4) > 0.75


def density_for_the_pad(shaking_m_s2: float, fixes_until_s: float = 0.0, gap_s: float = 0.0) -> float:
    """Of the acceleration's noise, as the pad filter is told it, with a vehicle at rest that shakes.

    With `gap_s` the IMU is silent for so long before its last step.
    """
    rng, motion = np.random.default_rng(4), MotionHistory(1.0)
    vehicle, config = VehicleEstimator(EstimateConfig(), ZERO3, motion, ZERO3), EkfConfig()
    for k in range(1600):
        time_s = k * DT_S + gap_s * (k >= 1600 - round(config.imu_step_s / DT_S))
        vehicle.add_mag(MagSample(time_s, (20.9, 0.6, 42.9)))
        shaken = shaking_m_s2 * (k > 1200) * rng.standard_normal(3)
        vehicle.add_imu(ImuSample(time_s, ZERO3, vector3(RESTING + shaken), 20.0))
        if k % 40 == 0 and time_s < fixes_until_s:
            vehicle.add_gps(GpsFix(time_s, 47.0, 8.0, 500.0, ZERO3, 1.0, 1.5, 0.1, 12))
    assert vehicle.aligned
    return motion.noise_density_m2_s3


def test_the_pad_filter_is_told_of_vibration() -> None:
    quiet = EkfConfig().accel_noise_m_s2 ** 2 * DT_S
    assert density_for_the_pad(0.0) == pytest.approx(quiet, rel=0.05)
    assert density_for_the_pad(0.5) == pytest.approx(quiet + 0.5**2 * DT_S, rel=0.6)


def test_a_lost_gps_does_not_tell_the_pad_filter_of_more_vibration() -> None:
    an_axis = 2.0 * EkfConfig().shaking_bound_m_s2 / math.sqrt(3.0)
    with_fixes, lost = (density_for_the_pad(an_axis, until_s) for until_s in (8.0, 5.0))
    assert lost == pytest.approx(with_fixes, rel=1e-6)
    assert lost == pytest.approx(an_axis**2 * DT_S, rel=0.6)


def test_a_gap_of_the_imu_is_no_noise_to_the_pad_filter() -> None:
    quiet = EkfConfig().accel_noise_m_s2 ** 2 * DT_S
    assert density_for_the_pad(0.0, gap_s=0.4) < 10.0 * quiet
