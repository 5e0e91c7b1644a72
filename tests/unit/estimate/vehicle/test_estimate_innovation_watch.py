"""An EKF that no longer fits its pre-filter: doubted, started again, and said so."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    quat_from_euler,
    quat_multiply,
    quat_normalise,
    quat_rotate_inverse,
    vector3,
)
from companion.base.messages import ImuSample, MagSample
from companion.config import EkfConfig
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.ekf import VehicleEkf
from companion.estimate.vehicle.ekf_inputs import GpsStep, ImuStep
from companion.estimate.vehicle.ekf_start import InitialState
from companion.estimate.vehicle.innovation_watch import InnovationWatch, TroubleReport
from tests.attitudes import DEGREE, between_deg
from tests.unit.estimate.at_rest import DOWN_FORCE, FIELD
from tests.unit.estimate.estimate_flight import FIELD_NED_UT, new_estimator

TILT_NOISE, HEADING_NOISE = 12 * DEGREE, 20 * DEGREE


def sure_ekf(attitude: Quaternion = IDENTITY) -> VehicleEkf:
    """One that claims to know its attitude and its gyroscope's bias very well."""
    return VehicleEkf(
        EkfConfig(), ZERO3, InitialState(0.0, attitude, ZERO3, FIELD, 0.3 * DEGREE, 0.5 * DEGREE, 1e-4)
    )


def run(
    ekf: VehicleEkf, seconds: float, prefilter: Quaternion, rate: Vector3 = ZERO3, fixes: bool = False
) -> None:
    """IMU at 100 Hz, the pre-filter at 10 Hz at the noise it flies with, fixes at 5 Hz."""
    start_s = ekf.time_s
    for k in range(1, round(100 * seconds) + 1):
        attitude = prefilter if k % 10 == 0 else None
        step = ImuStep(rate, DOWN_FORCE, 2, None, attitude, TILT_NOISE, HEADING_NOISE)
        ekf.apply(start_s + 0.01 * k, step)
        if fixes and k % 20 == 0:
            ekf.apply(ekf.time_s, GpsStep(ZERO3, ZERO3, (3.0, 3.0, 4.5), (0.15, 0.15, 0.2)))


@pytest.mark.parametrize("seed", range(5))
def test_white_innovations_hardly_ever_misfit(seed: int) -> None:
    rng, watch, misfits = np.random.default_rng(seed), InnovationWatch(), 0
    for k in range(1, 6001):
        watch = watch.after(0.1 * k, vector3(rng.normal(size=3)))
        misfits += watch.misfits
    assert misfits <= 30


@pytest.mark.parametrize("seed", range(5))
def test_innovations_that_keep_to_one_side_misfit_though_each_is_small(seed: int) -> None:
    rng, watch = np.random.default_rng(seed), InnovationWatch()
    for k in range(1, 101):
        watch = watch.after(0.1 * k, vector3((1.2, 0.0, 0.0) + 0.5 * rng.normal(size=3)))
        assert not (watch.misfits and k < 30), "not before a whole window"
    assert watch.misfits
    assert not watch.renewed().misfits


def test_a_heading_that_has_run_away_is_doubted_and_comes_back_though_no_gate_refuses() -> None:
    truth = quat_from_euler(0.0, 0.0, 40 * DEGREE)
    ekf = sure_ekf()
    run(ekf, 8.0, truth)
    assert ekf.gates["orientation"].refused == 0
    assert math.isfinite(ekf.watch.doubted_s)
    assert between_deg(ekf.attitude, truth) < 4.0


def test_a_gyroscope_that_leads_away_again_has_the_filter_start_from_the_pre_filter() -> None:
    ekf = sure_ekf()
    run(ekf, 25.0, IDENTITY, rate=(0.0, 0.0, 8 * DEGREE))
    assert math.isfinite(ekf.watch.restarted_s)
    assert ekf.watch.restarted_s > ekf.watch.doubted_s
    assert between_deg(ekf.attitude, IDENTITY) < 5.0
    assert ekf.x[model.GYRO_BIAS][2] / DEGREE > 4.0, "and finds what has led it away"


def test_while_fixes_fit_it_is_not_started_again() -> None:
    ekf, wrong = sure_ekf(), quat_from_euler(15 * DEGREE, 0.0, 0.0)
    run(ekf, 2.0, IDENTITY, fixes=True)
    run(ekf, 20.0, wrong, fixes=True)
    assert math.isfinite(ekf.watch.doubted_s)
    assert ekf.watch.restarted_s == -math.inf
    assert between_deg(ekf.attitude, IDENTITY) < 5.0


@pytest.mark.parametrize("wrong", ["compass", "ours"])
def test_fixes_of_a_vehicle_that_turns_say_which_heading_is_wrong(wrong: str) -> None:
    """A circle at 2 m/s, heading north: a steel deck turns the compass by 30 deg, or ours has run away."""
    ekf, field = sure_ekf(), quat_from_euler(0.0, 0.0, -30 * DEGREE)
    truth = IDENTITY if wrong == "compass" else field
    speed, rate = 2.0, 0.9
    for k in range(1, 2001):
        t = 0.01 * k
        force = (-speed * rate * math.sin(rate * t), speed * rate * math.cos(rate * t), -GRAVITY_M_S2)
        step = ImuStep(quat_rotate_inverse(truth, ZERO3), quat_rotate_inverse(truth, force), 2)
        attitude = IDENTITY if t < 8.0 and wrong == "compass" else field
        step = replace(step, attitude=attitude if k % 10 == 0 else None)
        step = replace(step, tilt_noise_rad=TILT_NOISE, heading_noise_rad=HEADING_NOISE)
        ekf.apply(t, step)
        if k % 20 == 0:
            velocity = (speed * math.cos(rate * t), speed * math.sin(rate * t), 0.0)
            place = (speed / rate * math.sin(rate * t), -speed / rate * math.cos(rate * t), 0.0)
            ekf.apply(t, GpsStep(place, velocity, (3.0, 3.0, 4.5), (0.15, 0.15, 0.2)))
    assert between_deg(ekf.attitude, truth) < 5.0
    assert math.isfinite(ekf.watch.doubted_s) == (wrong == "ours")


@pytest.mark.parametrize("fixes", [True, False])
def test_a_deck_that_turns_the_compass_turns_no_heading_that_fixes_hold(fixes: bool) -> None:
    """Hovering, no turn of velocity to show the heading: the compass has its own test, the fixes hold it."""
    ekf, deck = sure_ekf(), quat_from_euler(0.0, 0.0, 35 * DEGREE)
    for k in range(1, 1501):
        turned = deck if k > 500 else IDENTITY
        field = quat_rotate_inverse(turned, FIELD) if k % 10 == 5 else None
        step = ImuStep(
            ZERO3, DOWN_FORCE, 2, field, turned if k % 10 == 0 else None, TILT_NOISE, HEADING_NOISE
        )
        ekf.apply(0.01 * k, step)
        if fixes and k % 20 == 0:
            ekf.apply(ekf.time_s, GpsStep(ZERO3, ZERO3, (3.0, 3.0, 4.5), (0.15, 0.15, 0.2)))
    assert math.isfinite(ekf.watch.doubted_s) != fixes
    assert (between_deg(ekf.attitude, IDENTITY) < 10.0) == fixes


def test_an_attitude_that_fits_is_left_alone() -> None:
    ekf = sure_ekf()
    run(ekf, 20.0, quat_from_euler(3 * DEGREE, -3 * DEGREE, 5 * DEGREE))
    assert ekf.watch.doubted_s == ekf.watch.restarted_s == -math.inf


def test_what_was_done_is_said_once() -> None:
    report, never = TroubleReport(), -math.inf
    assert report.news(never, never, never) == ()
    assert len(report.news(5.0, never, never)) == 1
    assert report.news(5.0, never, never) == ()
    words = report.news(5.0, 8.0, 9.0)
    assert len(words) == 2
    assert any("attitude reset" in line for line in words)
    assert any("GPS" in line for line in words)


def test_the_estimator_says_that_it_doubts_its_attitude() -> None:
    estimator = new_estimator()
    told: list[str] = []
    for k in range(1, 2400):
        now_s = 0.005 * k
        estimator.add_imu(ImuSample(now_s, ZERO3, DOWN_FORCE, 35.0))
        estimator.add_mag(MagSample(now_s, FIELD_NED_UT))
        ekf = estimator._vehicle._ekf
        if k == 800:
            assert ekf is not None
            x = ekf.x.copy()
            x[model.QUATERNION] = quat_normalise(quat_multiply(quat_from_euler(0.0, 0.0, 0.7), ekf.attitude))
            ekf.x = x
        told += (words for _, words in estimator.take_notices())
    assert any("attitude uncertain" in words for words in told)
    assert len(told) <= 2
