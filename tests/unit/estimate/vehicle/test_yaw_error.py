"""What a gyroscope makes of a yaw, beside the EKF: as one filter with three states more would have it."""

import math

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, FloatArray, quat_from_euler, vector3
from companion.config import EkfConfig
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.ekf_start import InitialState
from companion.estimate.vehicle.ekf_state import EkfState
from companion.estimate.vehicle.imu_noise import StepNoise
from companion.estimate.vehicle.yaw_error import GYRO_SCALE_ERROR, YawError
from tests.attitudes import DEGREE

FIELD_NED_UT = (20.9, 0.6, 42.9)
STEP_S = 0.01
WHOLE = model.STATES + 3


def standing() -> EkfState:
    start = InitialState(0.0, quat_from_euler(0.0, 0.0, 1.0), ZERO3, FIELD_NED_UT, DEGREE, DEGREE, 5e-4)
    ekf = EkfState(EkfConfig(), start)
    ekf.has_position = True
    return ekf


def turning(k: tuple[float, float, float], rate_rad_s: float) -> model.InertialInput:
    """What the IMU shows of a yaw, standing level."""
    measured = (k[0] * rate_rad_s, k[1] * rate_rad_s, (1.0 + k[2]) * rate_rad_s)
    return (measured, (0.0, 0.0, -GRAVITY_M_S2))


def whole(ekf: EkfState) -> FloatArray:
    """Covariance (34, 34) of the state and k."""
    V = ekf.yaw_error.with_state
    return np.block([[ekf.P, V], [V.T, ekf.yaw_error.covariance]])


def test_prediction_and_correction_are_those_of_one_filter_with_34_states() -> None:
    ekf, rng = standing(), np.random.default_rng(1)
    for k in range(1, 101):
        ekf.predict(STEP_S * k, turning((0.004, -0.003, 0.005), 0.5))
    before, x = whole(ekf), np.append(ekf.x, ekf.yaw_error.share)
    u = turning(ZERO3, 0.5)
    r = 0.5 - float(ekf.x[model.GYRO_BIAS][2])
    rate, force = u
    corrected = (vector3(np.array(rate) - r * ekf.yaw_error.share), force)
    _, A = model.transition(ekf.x, corrected, STEP_S)
    F = np.eye(WHOLE)
    F[: model.MOVING, : model.COUPLED] = A
    F[: model.MOVING, model.STATES :] = A[:, model.GYRO_BIAS] * r
    ekf.predict(1.0 + STEP_S, u)
    by_noise = whole(ekf) - F @ before @ F.T
    assert np.abs(by_noise[: model.STATES, model.STATES :]).max() < 1e-12
    assert np.abs(by_noise[model.VELOCITY, model.QUATERNION]).max() < 1e-9
    assert np.linalg.eigvalsh(by_noise).min() > -1e-12

    C, R, y = np.zeros((3, WHOLE)), 0.01 * np.eye(3), 0.01 * rng.normal(size=3)
    C[:, model.QUATERNION] = rng.normal(size=(3, 4))
    before, x = whole(ekf), np.append(ekf.x, ekf.yaw_error.share)
    K = before @ C.T @ np.linalg.inv(C @ before @ C.T + R)
    ekf._correct(y, C[:, : model.STATES], R, by_fix=True)
    assert ekf.yaw_error.share == pytest.approx((x + K @ y)[model.STATES :], abs=1e-12)
    left = (np.eye(WHOLE) - K @ C) @ before
    unscaled = slice(model.EULER.stop, WHOLE)  # but for what brings the quaternion to unit length
    assert whole(ekf)[unscaled, unscaled] == pytest.approx(left[unscaled, unscaled], abs=1e-12)


def test_a_turn_shows_what_it_is_measured_as_once_the_heading_is_known_after_it() -> None:
    """Two turns and a half at 0.5 rad/s, of 0.5 % too much: 4.5 deg; then the heading to 0.1 deg."""
    ekf, count = standing(), int(10.0 * math.pi / STEP_S)
    for k in range(1, count + 1):
        ekf.predict(STEP_S * k, turning((0.0, 0.0, 0.005), 0.5))
    stated = math.degrees(math.sqrt(ekf.rotation_covariance()[2, 2]))
    assert 3.0 < stated < 8.0
    too_far = 0.005 * 0.5 * STEP_S * count
    C = np.zeros((1, model.STATES))
    C[:, model.QUATERNION] = model.rotation_from_quaternion(ekf.attitude)[2]
    ekf._correct(np.array([-too_far]), C, np.array([[(0.1 * DEGREE) ** 2]]), by_fix=True)
    # the start's heading and the gyroscope's bias have their share of it
    assert 0.0025 < ekf.yaw_error.share[2] < 0.005
    assert math.sqrt(ekf.yaw_error.covariance[2, 2]) < 0.7 * GYRO_SCALE_ERROR


def test_a_compass_teaches_nothing_of_it() -> None:
    ekf = standing()
    for k in range(1, 101):
        ekf.predict(STEP_S * k, turning(ZERO3, 0.5))
    before = ekf.yaw_error
    C = np.zeros((1, model.STATES))
    C[:, model.QUATERNION] = model.rotation_from_quaternion(ekf.attitude)[2]
    ekf._correct(np.array([DEGREE]), C, np.array([[DEGREE**2]]))
    assert np.array_equal(ekf.yaw_error.share, before.share)
    assert np.array_equal(ekf.yaw_error.covariance, before.covariance)
    related = np.abs(ekf.yaw_error.with_state[model.QUATERNION]).max()
    assert 0.0 < related < np.abs(before.with_state[model.QUATERNION]).max()


def test_without_a_turn_nothing_is_learnt() -> None:
    ekf = standing()
    for k in range(1, 501):
        ekf.predict(STEP_S * k, turning(ZERO3, 0.0))
    assert np.array_equal(ekf.yaw_error.with_state, YawError.first().with_state)


def test_without_fixes_it_is_noise() -> None:
    ekf = standing()
    ekf.has_position = False
    for k in range(1, 101):
        ekf.predict(STEP_S * k, turning(ZERO3, 0.5), noise=StepNoise(lasting_rate_rad_s=(0.0, 0.0, 0.5)))
    noisy, still = ekf.rotation_covariance()[2, 2], standing().rotation_covariance()[2, 2]
    assert noisy > still + 0.9 * (0.5 * GYRO_SCALE_ERROR) ** 2
    assert np.abs(ekf.yaw_error.with_state).max() == 0.0


def test_what_is_set_anew_is_related_to_nothing() -> None:
    ekf = standing()
    for k in range(1, 101):
        ekf.predict(STEP_S * k, turning(ZERO3, 0.5))
    assert np.abs(ekf.yaw_error.with_state[model.ATTITUDE]).max() > 0.0
    ekf._start_attitude(quat_from_euler(0.0, 0.0, 2.0), DEGREE**2 * np.eye(3))
    assert np.abs(ekf.yaw_error.with_state[model.ATTITUDE]).max() == 0.0
