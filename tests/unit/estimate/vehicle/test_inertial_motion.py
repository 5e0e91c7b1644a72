"""What an accelerometer beside the centre of mass feels of a turn is neither acceleration nor wind."""

import math

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    Vector3,
    add,
    cross,
    quat_from_euler,
    scale,
    subtract,
    yaw_from_quat,
)
from companion.base.messages import ImuSample
from companion.config import EstimateConfig
from companion.estimate.ahrs.orientation import new_orientation
from companion.estimate.motion import MotionHistory
from companion.estimate.vehicle.inertial_motion import InertialMotion
from companion.estimate.vehicle.lever_arm import LeverArm

FIELD_NED_UT = (20.9, 0.6, 42.9)

STEP_S = 0.005
FASTEST_RAD_S2 = 12.0


def rocked(imu_body_m: Vector3, believed_m: Vector3) -> float:
    """Rolled to and fro at 10 rad/s about the centre of mass, which hovers: the largest side force (m/s2)."""
    motion, arm = InertialMotion(MotionHistory(1.0)), LeverArm(believed_m)
    orientation, largest, w = new_orientation(EstimateConfig(), FIELD_NED_UT, IDENTITY), 0.0, 10.0
    before: Vector3 = (FASTEST_RAD_S2 / w, 0.0, 0.0)
    for k in range(400):
        t = k * STEP_S
        roll = FASTEST_RAD_S2 / w**2 * math.sin(w * t)
        rate: Vector3 = (FASTEST_RAD_S2 / w * math.cos(w * t), 0.0, 0.0)
        alpha: Vector3 = (-FASTEST_RAD_S2 * math.sin(w * t), 0.0, 0.0)
        motion.attitude = quat_from_euler(roll, 0.0, 0.0)
        thrust = (0.0, 0.0, -GRAVITY_M_S2)
        lever = add(cross(alpha, imu_body_m), cross(rate, cross(rate, imu_body_m)))
        force = subtract(add(thrust, lever), arm.felt_m_s2(before, rate, STEP_S))
        sample, before = ImuSample(t, rate, force, 25.0), rate
        motion.add(sample, ZERO3, STEP_S, ZERO3, sample.specific_force_body_m_s2, orientation)
        if k > 20:
            largest = max(largest, math.hypot(*motion.side_force_ned_m_s2[:2]))
    return largest


@pytest.mark.parametrize("imu_body_m", [(0.0, 0.0, 0.05), (0.0, 0.0, -0.1), (0.03, 0.05, 0.02)])
def test_an_imu_beside_the_centre_of_mass_feels_no_wind_where_its_place_is_known(imu_body_m: Vector3) -> None:
    unknown = rocked(imu_body_m, ZERO3)
    assert unknown > 0.2
    # the gyroscope's difference is half a sample early, the low-pass of 20 ms is the same for all
    assert rocked(imu_body_m, imu_body_m) < 0.05 * unknown
    assert rocked(ZERO3, ZERO3) < 1e-9


def test_the_history_is_told_by_what_the_attitude_is_corrected() -> None:
    """A yaw error that the EKF takes off is no correction: the attitude between its steps has it off, too."""
    history = MotionHistory(1.0)
    motion, share, yaw = InertialMotion(history), np.array([0.002, 0.0, 0.005]), 1.0
    orientation = new_orientation(EstimateConfig(), FIELD_NED_UT, IDENTITY)
    force: Vector3 = (0.0, 0.0, -GRAVITY_M_S2)
    rate: Vector3 = (0.002 * yaw, 0.0, 1.005 * yaw)
    motion.follow(IDENTITY, 0.0, share)
    for k in range(1, 201):
        motion.add(ImuSample(k * STEP_S, rate, force, 25.0), ZERO3, STEP_S, rate, force, orientation)
    assert yaw_from_quat(motion.attitude) == pytest.approx(yaw, abs=1e-4)
    motion.follow(quat_from_euler(0.003, 0.0, yaw - 0.01), 0.0, share)
    x, y, z = history.corrected(0.5, 1.1)
    # the roll, about the body's axis, in NED; what is left of the shares is their product with the yaw
    assert (x, y, z) == pytest.approx((0.003 * math.cos(yaw), 0.003 * math.sin(yaw), -0.01), abs=1e-4)


def test_vibration_does_not_go_on_beyond_the_newest_sample() -> None:
    # GIVEN a vehicle at rest whose IMU shakes by 2 m/s² at 90 Hz
    history = MotionHistory(1.0)
    motion, orientation = (InertialMotion(history), new_orientation(EstimateConfig(), FIELD_NED_UT, IDENTITY))
    swings, speeds = [], []
    for k in range(1, 401):
        shaken = 2.0 * math.sin(math.tau * 90.0 * k * STEP_S)
        force: Vector3 = (shaken, 0.0, -GRAVITY_M_S2)
        motion.add(ImuSample(k * STEP_S, ZERO3, force, 25.0), ZERO3, STEP_S, ZERO3, force, orientation)
        _, (north, _, _), _ = history.moved(k * STEP_S, k * STEP_S + 0.012)
        swings.append(north)
        speeds.append(motion.acceleration_ned_m_s2[0] * 0.012)
    # THEN the velocity 12 ms later differs by what lasts of the acceleration alone, not by the last sample's
    assert max(map(abs, swings)) < 0.012 * 0.5
    assert swings == pytest.approx(speeds)


def test_a_blow_is_not_carried_on_while_the_next_samples_are_late() -> None:
    """Feet that are stopped within one sample: 127 m/s2 for 8 ms."""
    history, step_s = MotionHistory(1.0), 0.008
    motion, orientation = (InertialMotion(history), new_orientation(EstimateConfig(), FIELD_NED_UT, IDENTITY))
    for k in range(1, 101):
        force: Vector3 = (-127.0 if k == 100 else 0.0, 0.0, -GRAVITY_M_S2)
        motion.add(ImuSample(k * step_s, ZERO3, force, 25.0), ZERO3, step_s, ZERO3, force, orientation)
    _, (later, _, _), _ = history.moved(100 * step_s, 100 * step_s + 0.08)
    assert abs(later) < 0.25
    assert motion.acceleration_ned_m_s2[0] < -30.0  # it is felt all the same


@pytest.mark.parametrize("tone_hz", [90.0, 97.0])
def test_a_rotors_tone_is_no_wind_with_the_accelerometer_off_its_place(tone_hz: float) -> None:
    """5 m/s2, and 0.14 rad/s of a gyroscope that feels it too; an IMU 8 cm below the centre of mass."""
    motion, arm = InertialMotion(MotionHistory(1.0)), LeverArm((0.0, 0.0, 0.08))
    orientation, largest = new_orientation(EstimateConfig(), FIELD_NED_UT, IDENTITY), 0.0
    last_rate, last_mean, last_force = ZERO3, ZERO3, (0.0, 0.0, -GRAVITY_M_S2)
    for k in range(1, 401):
        angle = math.tau * tone_hz * k * STEP_S
        rate: Vector3 = (0.14 * math.cos(angle), 0.0, 0.0)
        force: Vector3 = (5.0 * math.sin(angle), 0.0, -GRAVITY_M_S2)
        mean_rate = scale(add(last_rate, rate), 0.5)
        turning = arm.felt_m_s2(last_mean, mean_rate, STEP_S)
        mean = subtract(scale(add(last_force, force), 0.5), turning)
        sample = ImuSample(k * STEP_S, rate, subtract(force, turning), 25.0)
        motion.add(sample, ZERO3, STEP_S, mean_rate, mean, orientation)
        last_rate, last_mean, last_force = rate, mean_rate, force
        if k > 50:
            largest = max(largest, math.hypot(*motion.side_force_ned_m_s2[:2]))
    assert largest < 0.15
