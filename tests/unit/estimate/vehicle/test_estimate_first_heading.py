"""The first attitude: biases of the sensors turn it, and the autopilot's is heard beside it."""

import math

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    euler_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate_inverse,
    rotation_vector_from_quat,
    scale,
    vector3,
    yaw_from_quat,
)
from companion.base.messages import AutopilotAttitude, ImuSample, MagSample
from companion.config import EkfConfig
from companion.estimate.estimator import StateEstimator
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.ekf import VehicleEkf
from companion.estimate.vehicle.ekf_inputs import SecondAttitudeStep
from companion.estimate.vehicle.ekf_start import InitialState
from tests.attitudes import DEGREE
from tests.unit.estimate.estimate_flight import FIELD_NED_UT, new_estimator

YAW = 70.0 * DEGREE
HORIZONTAL_UT = math.hypot(FIELD_NED_UT[0], FIELD_NED_UT[1])
# horizontal and square to the field: of a bias only this turns the heading
EAST = np.array((-FIELD_NED_UT[1], FIELD_NED_UT[0], 0.0)) / HORIZONTAL_UT


def standing() -> VehicleEkf:
    attitude = quat_from_euler(0.0, 0.0, YAW)
    start = InitialState(0.0, attitude, ZERO3, FIELD_NED_UT, 2 * DEGREE, 1.5 * DEGREE, 5e-4)
    return VehicleEkf(EkfConfig(), ZERO3, start)


def bias_to_the_east(ekf: VehicleEkf) -> float:
    body = np.array(quat_rotate_inverse(ekf.attitude, vector3(EAST)))
    return float(body @ ekf.x[model.MAG_BIAS])


def test_the_first_headings_error_is_the_magnetometers_bias_and_its_own() -> None:
    config, ekf = EkfConfig(), standing()
    of_field = (config.mag_bias_std_ut**2 + config.field_std_ut**2) / HORIZONTAL_UT**2
    assert ekf.rotation_covariance()[2, 2] == pytest.approx(of_field + (1.5 * DEGREE) ** 2, rel=1e-3)


def told(turn_deg: Vector3, tilt_std_deg: float, heading_std_deg: float) -> VehicleEkf:
    """Of an attitude turned that far about NED axes."""
    ekf = standing()
    turn = scale(turn_deg, DEGREE)
    ekf.apply(0.0, SecondAttitudeStep(turn, tilt_std_deg * DEGREE, heading_std_deg * DEGREE))
    return ekf


def turned_deg(ekf: VehicleEkf) -> Vector3:
    start = quat_from_euler(0.0, 0.0, YAW)
    turn = rotation_vector_from_quat(quat_multiply(ekf.attitude, quat_conjugate(start)))
    return scale(turn, 1.0 / DEGREE)


def test_a_heading_from_elsewhere_shows_the_magnetometers_bias_too() -> None:
    """Truth is ahead of the estimate by b / B of a bias b to the east."""
    ekf = told((0.0, 0.0, 4.0), 0.8, 0.1)
    assert turned_deg(ekf)[2] == pytest.approx(4.0, rel=0.02)
    whole = 4.0 * DEGREE * HORIZONTAL_UT
    assert 0.6 * whole < bias_to_the_east(ekf) < whole


def test_a_horizon_from_elsewhere_shows_no_heading() -> None:
    assert turned_deg(told((1.0, -2.0, 0.0), 0.1, 3.0)) == pytest.approx((1.0, -2.0, 0.0), abs=0.03)


@pytest.mark.parametrize("turn_deg", [(0.0, 0.0, 40.0), (15.0, 0.0, 0.0)])
def test_an_attitude_that_cannot_be_is_refused(turn_deg: Vector3) -> None:
    ekf = told(turn_deg, 0.8, 3.0)
    assert turned_deg(ekf) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert ekf.gates["second_attitude"].refused == 1


def heard(
    their_yaw: float,
    same_imu: bool = False,
    turning: bool = False,
    their_roll: float = 0.0,
    their_alignment_s: float = 0.0,
) -> StateEstimator:
    """After four seconds of sensors that are right, and of an autopilot that says `their_yaw`; before its own
    alignment it is off by 90 deg.
    """
    estimator, attitude = new_estimator(), quat_from_euler(0.0, 0.0, YAW)
    theirs = quat_from_euler(their_roll, 0.0, their_yaw)
    unaligned = quat_from_euler(their_roll, 0.0, their_yaw + math.radians(90.0))
    field = quat_rotate_inverse(attitude, FIELD_NED_UT)
    for k in range(800):
        t = 0.005 * k
        rocking = 0.3 * math.sin(20.0 * t) if turning and t > 2.3 else 0.0
        estimator.add_imu(ImuSample(t, (rocking, 0.0, 0.0), (0.0, 0.0, -GRAVITY_M_S2), 20.0))
        if k % 2 == 0:
            estimator.add_mag(MagSample(t, field))
        if k % 8 == 0 and (not turning or t > 2.6):
            said = theirs if t >= their_alignment_s else unaligned
            estimator.add_autopilot_attitude(AutopilotAttitude(t - 0.01, said, same_imu))
    return estimator


def ahead_deg(estimator: StateEstimator) -> float:
    state = estimator.vehicle(3.995)
    assert state is not None
    return (yaw_from_quat(state.attitude) - YAW) / DEGREE


def test_two_compasses_meet_about_halfway() -> None:
    assert 1.2 < ahead_deg(heard(YAW + 5.0 * DEGREE)) < 3.5


def test_an_autopilot_that_was_not_aligned_yet_is_asked_again() -> None:
    assert ahead_deg(heard(YAW + 5.0 * DEGREE, their_alignment_s=9.0)) == pytest.approx(0.0, abs=0.1)
    assert 1.2 < ahead_deg(heard(YAW + 5.0 * DEGREE, their_alignment_s=2.5)) < 3.5


def roll_deg(estimator: StateEstimator) -> float:
    state = estimator.vehicle(3.995)
    assert state is not None
    return euler_from_quat(state.attitude)[0] / DEGREE


def test_two_horizons_meet_about_halfway() -> None:
    assert 0.25 < roll_deg(heard(YAW, their_roll=1.0 * DEGREE)) < 0.6


def test_of_a_board_that_lies_askew_the_heading_alone_counts() -> None:
    askew = heard(YAW + 5.0 * DEGREE, their_roll=6.0 * DEGREE)
    assert abs(roll_deg(askew)) < 0.1
    assert 1.2 < ahead_deg(askew) < 3.5
    fallen = heard(YAW + 5.0 * DEGREE, their_roll=15.0 * DEGREE)
    assert abs(roll_deg(fallen)) < 0.05
    assert abs(ahead_deg(fallen)) < 0.3


def test_their_horizon_by_our_own_imu_is_no_second_one() -> None:
    assert abs(roll_deg(heard(YAW, same_imu=True, their_roll=1.0 * DEGREE))) < 0.05


def test_their_horizon_is_not_heard_in_motion() -> None:
    level, askew = heard(YAW, turning=True), heard(YAW, turning=True, their_roll=DEGREE)
    assert roll_deg(askew) == pytest.approx(roll_deg(level), abs=0.05)


def test_their_heading_by_our_own_imu_is_no_second_compass() -> None:
    assert abs(ahead_deg(heard(YAW + 5.0 * DEGREE, same_imu=True))) < 0.3


def test_their_heading_is_not_heard_in_motion() -> None:
    assert abs(ahead_deg(heard(YAW + 5.0 * DEGREE, turning=True))) < 0.5
