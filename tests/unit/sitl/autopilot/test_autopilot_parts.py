"""The flight controller's parts one by one: mixer, attitude control, setpoints, landed detector, tables."""

import itertools
import math
from dataclasses import replace
from math import nan
from typing import Any

import numpy as np
import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import ZERO3, Vector3, quat_from_euler, quat_multiply, quat_rotate, yaw_from_quat
from sitl.autopilot.ardupilot.profile import ARDUPILOT
from sitl.autopilot.control.attitude_control import (
    AttitudeControl,
    AttitudeReference,
    RateFilters,
    RateGains,
    turn_about_down,
)
from sitl.autopilot.control.cascade import LandedDetector, MotorMixer
from sitl.autopilot.control.estimator import EstimatorErrors, SimulatedEstimator
from sitl.autopilot.control.setpoints import MotionSetpoint
from sitl.autopilot.flight.autopilot import PROFILES
from sitl.autopilot.flight.modes import Task
from sitl.autopilot.flight.profile import Parameter, ParameterRef, Parameters
from sitl.autopilot.px4.control import Px4Control
from sitl.autopilot.px4.profile import PX4
from sitl.vehicle.quadrotor import LAYOUTS, LayoutName, QuadrotorState, RotorValues
from tests.unit.sitl.autopilot.autopilot_flight import frame_450


def produced(motors: RotorValues, rotors: LayoutName = "quad_plus") -> tuple[float, Vector3]:
    """Thrust (share) and torques (N m) that motor commands make in the end: places times forces."""
    a, layout = frame_450(rotors=rotors), LAYOUTS[rotors]
    up = a.max_thrust_n * np.array(motors)
    places = a.arm_length_m * np.stack((layout.forward, layout.right, np.zeros(len(up))), axis=1)
    forces = np.stack((np.zeros(len(up)), np.zeros(len(up)), -up), axis=1)
    roll, pitch, _ = np.cross(places, forces).sum(axis=0).tolist()
    return sum(motors) / len(motors), (roll, pitch, a.torque_to_thrust_m * float(up @ layout.turns))


# ---------------------------------------------------------------- mixer


@pytest.mark.parametrize("rotors", LAYOUTS)
def test_motors_make_the_thrust_and_torques_asked_for(rotors: LayoutName) -> None:
    thrust, torque = produced(MotorMixer(frame_450(rotors=rotors), 0.04).mix(0.5, (0.3, -0.2, 0.05)), rotors)
    assert thrust == pytest.approx(0.5)
    assert torque == pytest.approx((0.3, -0.2, 0.05))


def test_commands_stay_within_the_motors_range_whatever_is_asked() -> None:
    mixer = MotorMixer(frame_450(), 0.04)
    for thrust, *torque in itertools.product((0.0, 0.1, 0.5, 0.9, 1.0), *[(-9.0, -0.5, 0.0, 0.5, 9.0)] * 3):
        motors = mixer.mix(thrust, (torque[0], torque[1], torque[2]))
        assert all(0.04 - 1e-12 <= motor <= 1.0 + 1e-12 for motor in motors)


def test_roll_and_pitch_outrank_thrust_and_thrust_outranks_yaw() -> None:
    thrust, torque = produced(MotorMixer(frame_450(), 0.04).mix(0.95, (1.5, 0.0, 0.3)))
    assert torque[0] == pytest.approx(1.5)
    assert thrust < 0.95
    assert 0.0 < torque[2] < 0.1
    thrust, torque = produced(MotorMixer(frame_450(), 0.04).mix(0.5, (0.0, 0.0, 5.0)))
    assert thrust == pytest.approx(0.5)
    assert torque[2] > 0.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_at_full_thrust_yaw_keeps_a_margin_for_which_the_collective_gives_way(sign: float) -> None:
    # GIVEN all the thrust there is, as in a storm, and a turn to be stopped
    frame, margin = frame_450(), 0.15 * (1.0 - 0.04)
    thrust, torque = produced(MotorMixer(frame, 0.04).mix(1.0, (0.0, 0.0, 5.0 * sign)))
    # THEN the turn is stopped by the margin, and no more of the thrust is given up than that
    assert torque[2] == pytest.approx(sign * 4.0 * frame.torque_to_thrust_m * frame.max_thrust_n * margin)
    assert thrust == pytest.approx(1.0 - margin)


# ---------------------------------------------------------------- attitude


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_torque_turns_the_body_towards_the_setpoint_by_the_shorter_way(yaw_deg: float, axis: int) -> None:
    attitude = quat_from_euler(0.1, -0.15, math.radians(yaw_deg))
    small = [0.0, 0.0, 0.0]
    small[axis] = 0.2
    wanted = quat_multiply(attitude, quat_from_euler(small[0], small[1], small[2]))
    for sign in (1.0, -1.0):
        w, x, y, z = wanted
        control = AttitudeControl((1.0, 1.0, 1.0), PX4.attitude_gains, RateGains())
        torque = control.step(
            attitude, ZERO3, (sign * w, sign * x, sign * y, sign * z), ZERO3, 0.0025, frozen=True
        )
        others = [abs(t) for i, t in enumerate(torque) if i != axis]
        assert torque[axis] > 10.0 * max(others)


def test_a_yaw_rate_is_a_turn_about_the_worlds_down_axis_at_any_tilt() -> None:
    attitude = quat_from_euler(0.3, 0.2, 1.0)
    rates = RateGains(proportional=(1.0, 1.0, 1.0))
    unfiltered = replace(PX4.attitude_gains, filters=RateFilters(40.0, 30.0))
    control = AttitudeControl((1.0, 1.0, 1.0), unfiltered, rates)
    feed = turn_about_down(attitude, 0.5)
    wanted_rate = control.step(attitude, ZERO3, attitude, feed, 0.0025, frozen=True)
    assert quat_rotate(attitude, wanted_rate) == pytest.approx((0.0, 0.0, 0.5), abs=1e-9)
    alone = AttitudeControl((1.0, 1.0, 1.0), unfiltered, rates)
    assert alone.step(attitude, ZERO3, None, (0.1, -0.2, 0.3), 0.0025, frozen=True) == (0.1, -0.2, 0.3)


def test_ardupilots_reference_turns_within_its_limits_and_arrives_without_overshoot() -> None:
    limits = ARDUPILOT.attitude_gains.reference
    assert limits is not None
    reference = AttitudeReference(limits)
    wanted, fastest, largest = quat_from_euler(0.0, 0.0, math.radians(90.0)), 0.0, 0.0
    for _ in range(400):
        reference.step(wanted, ZERO3, 0.01)
        fastest = max(fastest, reference.rate[2])
        largest = max(largest, yaw_from_quat(reference.attitude))
    assert fastest == pytest.approx(limits.yaw_rate_rad_s, rel=1e-6)
    assert largest < math.radians(90.5)
    assert yaw_from_quat(reference.attitude) == pytest.approx(math.radians(90.0), abs=1e-3)


# ---------------------------------------------------------------- position


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0])
def test_thrust_points_where_the_acceleration_asks_in_every_heading(yaw_deg: float) -> None:
    yaw = math.radians(yaw_deg)
    control = Px4Control(0.5)
    control.reset(yaw, ZERO3)
    setpoint = MotionSetpoint(acceleration_ned_m_s2=(1.0, -2.0, -0.5))
    control.step((ZERO3, ZERO3, ZERO3), setpoint, 0.01)
    force = quat_rotate(control.attitude, (0.0, 0.0, -control.thrust / 0.5 * 9.80665))
    # the tilt is the one of level flight, as both autopilots have it; the vertical share is exact
    share = 1.0 + 0.5 / 9.80665
    wanted = (share, -2.0 * share, -0.5)
    assert (force[0], force[1], force[2] + 9.80665) == pytest.approx(wanted, abs=1e-6)


def test_tilt_is_limited_and_height_comes_first() -> None:
    control = Px4Control(0.5)
    control.step((ZERO3, ZERO3, ZERO3), MotionSetpoint(acceleration_ned_m_s2=(50.0, 0.0, 0.0)), 0.01)
    force = quat_rotate(control.attitude, (0.0, 0.0, -control.thrust / 0.5 * 9.80665))
    assert force[2] == pytest.approx(-9.80665, abs=1e-6)
    assert math.atan2(force[0], -force[2]) == pytest.approx(math.radians(45.0), abs=1e-6)


# ---------------------------------------------------------------- landed


@pytest.fixture
def detector() -> LandedDetector:
    made = LandedDetector(1.5)
    made.lift_off()
    return made


def standing(detector: LandedDetector, seconds: float, **changes: Any) -> None:
    signs: dict[str, Any] = {"descending": True, "share": 0.7, "speed": 0.0, **changes}
    for _ in range(round(seconds * 100)):
        detector.update(signs["descending"], signs["share"], signs["speed"], 0.25, 0.01)


def test_low_thrust_in_a_commanded_descent_without_motion_is_the_ground(detector: LandedDetector) -> None:
    standing(detector, 1.0)
    standing(detector, 0.05, speed=0.5)  # motion ends the suspicion
    assert not detector.contact
    standing(detector, 1.4)
    assert (detector.contact, detector.landed) == (True, False)
    standing(detector, 0.2)
    assert detector.landed


@pytest.mark.parametrize("change", [{"descending": False}, {"share": 0.95}, {"speed": 0.4}])
def test_each_missing_sign_keeps_it_in_the_air(detector: LandedDetector, change: dict[str, Any]) -> None:
    standing(detector, 5.0, **change)
    assert not detector.landed


# ---------------------------------------------------------------- estimator, parameters, tables


def test_its_errors_have_the_sizes_they_should() -> None:
    truth = QuadrotorState(ZERO3)
    wanders, speeds = [], []
    for seed in range(40):
        estimator = SimulatedEstimator(
            EstimatorErrors(position_offset_std_m=0.0), np.random.default_rng(seed)
        )
        for _ in range(600):
            estimator.update_position(truth, 0.1)
        wanders.append(estimator.position_ned_m[0])
        speeds.append(estimator.velocity_ned_m_s[0])
    assert float(np.std(wanders)) == pytest.approx(0.29, abs=0.1)
    assert float(np.std(speeds)) == pytest.approx(0.04, abs=0.015)


def test_parameters_keep_their_bounds_and_integers() -> None:
    parameters = Parameters([Parameter("SPEED_CM", 500.0, 20.0, 2000.0), Parameter("BITS", 0, 0, 255, True)])
    assert parameters.set("SPEED_CM", 150.0)
    assert parameters.si(ParameterRef("SPEED_CM", 0.01)) == pytest.approx(1.5)
    assert parameters.set("BITS", 7.6)
    assert parameters["BITS"] == 8.0
    for name, value in (("SPEED_CM", 19.9), ("SPEED_CM", 2000.1), ("SPEED_CM", nan), ("OTHER", 1.0)):
        assert not parameters.set(name, value)
    assert parameters["SPEED_CM"] == 150.0


def test_every_name_in_a_profiles_table_leads_somewhere(autopilot_kind: AutopilotKind) -> None:
    table = PROFILES[autopilot_kind]
    names = [table.boot_mode, table.take_off_mode, table.after_take_off_mode, table.hold_mode]
    names += [table.land_mode, table.return_mode]
    names += [failsafe.mode for failsafe in table.failsafes if failsafe.mode]
    for name in names:
        assert table.mode(name).name == name
    assert len({mode.custom_mode for mode in table.modes}) == len(table.modes)
    known = {parameter.name for parameter in table.parameters}
    assert all(len(name) <= 16 for name in known)
    settings = table.parameter_map
    for setting in (settings.setpoint_timeout, settings.cruise_speed, settings.top_speed):
        assert setting.name in known
    for setting in (settings.landing_speed, settings.return_height):
        assert setting.name in known
    for parameter in table.parameters:
        assert parameter.minimum <= parameter.default <= parameter.maximum
    assert {mode.task for mode in table.modes} >= {Task.HOLD, Task.LAND, Task.RETURN}
    with pytest.raises(KeyError):
        table.mode("NONE")
