"""The airframe against what Newton and Euler say."""

import math
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    Quaternion,
    Vector3,
    matrix_from_quat,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    rotate_yaw,
    tilt_from_quat,
)
from companion.config import validate
from sitl.mavlink.telemetry import battery_status, sys_status
from sitl.scenario.scenario import Scenario, load_airframe
from sitl.vehicle.battery import CAPACITY_MAH, CELLS, Battery
from sitl.vehicle.quadrotor import (
    AIR_DENSITY_KG_M3,
    Motors,
    Quadrotor,
    QuadrotorParameters,
    QuadrotorState,
    RotorValues,
    resting_state,
)
from sitl.world.world import World
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight

DT = 0.0025
X500 = load_airframe("x500").body
HOVER = X500.hover_share()
ALL_HOVER: RotorValues = (HOVER, HOVER, HOVER, HOVER)
OFF: RotorValues = (0.0, 0.0, 0.0, 0.0)
HALF: RotorValues = (0.5, 0.5, 0.5, 0.5)


def changed(**values: Any) -> QuadrotorParameters:
    return X500.model_copy(update=values)


def without_drag() -> QuadrotorParameters:
    return changed(rotor_drag_plane_n_s2_m_rad=0.0, rotor_inflow_loss_n_s2_m_rad=0.0, body_drag_area_m2=0.0)


def hovering(**values: Any) -> QuadrotorState:
    return QuadrotorState(**{"position_ned_m": (0.0, 0.0, -10.0), "thrust_share": ALL_HOVER, **values})


def test_hovers_at_half_throttle() -> None:
    assert X500.hover_share() == pytest.approx(0.5, abs=0.01)
    state = hovering()
    for _ in range(400):
        state = Quadrotor(X500).step(state, ALL_HOVER, DT)
    assert state.position_ned_m == pytest.approx((0.0, 0.0, -10.0), abs=1e-9)
    assert state.specific_force_body_m_s2 == pytest.approx((0.0, 0.0, -GRAVITY_M_S2), abs=1e-9)


def test_free_fall_is_weightless_and_follows_half_g_t_squared() -> None:
    vehicle = Quadrotor(without_drag())
    state = resting_state((0.0, 0.0, -100.0), 0.7)
    for _ in range(400):
        state = vehicle.step(state, OFF, DT)
    assert state.position_ned_m[2] == pytest.approx(-100.0 + 0.5 * GRAVITY_M_S2, abs=1e-9)
    assert state.specific_force_body_m_s2 == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    ("more", "axis", "sign"),
    [
        ((3,), 0, 1.0),  # left: rolls right
        ((1,), 0, -1.0),
        ((0,), 1, 1.0),  # front: nose up
        ((2,), 1, -1.0),
        ((0, 2), 2, 1.0),  # front and rear turn anticlockwise, their reaction is clockwise
        ((1, 3), 2, -1.0),
    ],
)
def test_each_motor_turns_the_body_its_way(more: tuple[int, ...], axis: int, sign: float) -> None:
    one, two, three, four = (HOVER + (0.1 if i in more else -0.1 / 3) for i in range(4))
    state = hovering()
    for _ in range(20):
        state = Quadrotor(X500).step(state, (one, two, three, four), DT)
    assert sign * state.rate_body_rad_s[axis] > 0.01


def test_torques_have_the_agreed_arms() -> None:
    share: RotorValues = (0.5, 0.4, 0.42, 0.6)
    accelerations = (
        Quadrotor(X500).step(hovering(thrust_share=share), share, 1e-5).angular_acceleration_body_rad_s2
    )
    thrust = [value * X500.max_thrust_n for value in share]
    arm, k = X500.arm_length_m, X500.torque_to_thrust_m
    torque = (
        arm * (thrust[3] - thrust[1]),
        arm * (thrust[0] - thrust[2]),
        k * (thrust[0] - thrust[1] + thrust[2] - thrust[3]),
    )
    expected = [t / i for t, i in zip(torque, X500.inertia_kg_m2, strict=True)]
    assert accelerations == pytest.approx(expected, rel=1e-3)


def test_gyroscopics_equal_the_vector_form_with_opposite_signs_in_roll_and_pitch() -> None:
    parameters = changed(inertia_kg_m2=(0.015, 0.02, 0.03), rotor_inertia_kg_m2=2e-3)
    share: RotorValues = (0.2, 0.6, 0.2, 0.6)
    rate = (0.8, -1.1, 0.5)
    state = hovering(thrust_share=share, rate_body_rad_s=rate)
    got = Quadrotor(parameters).step(state, share, 1e-6).angular_acceleration_body_rad_s2
    speeds = [parameters.max_rotor_speed_rad_s * math.sqrt(value) for value in share]
    momentum = np.array(
        [0.0, 0.0, parameters.rotor_inertia_kg_m2 * (speeds[1] + speeds[3] - speeds[0] - speeds[2])]
    )
    inertia = np.array(parameters.inertia_kg_m2)
    w = np.array(rate)
    reaction = parameters.torque_to_thrust_m * parameters.max_thrust_n * (0.2 - 0.6 + 0.2 - 0.6)
    torque = np.array([0.0, 0.0, reaction])
    expected = (torque - np.cross(w, inertia * w + momentum)) / inertia
    np.testing.assert_allclose(got, expected, rtol=1e-4)
    # eq. (6): the same rate in roll and pitch gives torques of opposite sign
    gyroscopic = -np.cross(np.array([1.0, 1.0, 0.0]), momentum)
    assert gyroscopic[0] == pytest.approx(-gyroscopic[1])
    assert gyroscopic[0] != 0.0


def test_spinning_a_rotor_up_turns_the_body_against_it() -> None:
    parameters = changed(torque_to_thrust_m=1e-9, rotor_inertia_kg_m2=1e-3)
    up: RotorValues = (1.0, HOVER, 1.0, HOVER)
    state = Quadrotor(parameters).step(hovering(), up, DT)
    # front and rear turn anticlockwise: speeding up pushes the body clockwise
    assert state.rate_body_rad_s[2] > 0.0


def test_motors_lag_by_their_time_constants_in_steps_of_any_length() -> None:
    vehicle = Quadrotor(changed(motor_rise_s=0.05, motor_fall_s=0.1))
    rise, fall = 1.0 - 0.5 * math.exp(-1.0), 0.5 * math.exp(-0.5)
    for steps in (5, 20, 50):
        state = hovering(thrust_share=HALF)
        for _ in range(steps):
            state = vehicle.step(state, (1.0, 1.0, 0.0, 7.0), 0.05 / steps)
        assert state.thrust_share == pytest.approx((rise, rise, fall, rise), rel=1e-9)


def test_integration_is_of_fourth_order() -> None:
    # thrust is held over a step, and with it what the air through the rotors takes of it
    vehicle = Quadrotor(changed(rotor_inflow_loss_n_s2_m_rad=0.0))
    share: RotorValues = (0.45, 0.55, 0.47, 0.5)

    def flown(dt: float) -> np.ndarray[Any, Any]:
        state = hovering(
            thrust_share=share,
            velocity_ned_m_s=(6.0, -3.0, 1.0),
            attitude=quat_from_euler(0.3, -0.2, 1.0),
            rate_body_rad_s=(2.0, -1.5, 1.0),
        )
        for _ in range(round(0.16 / dt)):
            state = vehicle.step(state, share, dt, wind_ned_m_s=(3.0, 1.0, 0.5))
        return np.array(state.position_ned_m + state.velocity_ned_m_s + state.rate_body_rad_s)

    exact = flown(0.00125)
    coarse = np.linalg.norm(flown(0.04) - exact)
    fine = np.linalg.norm(flown(0.02) - exact)
    assert 12.0 < coarse / fine < 20.0


def specific_thrust(velocity_ned_m_s: Vector3, pitch_deg: float = 0.0) -> float:
    """Acceleration along the shaft at the throttle of hover, without any drag."""
    vehicle = Quadrotor(changed(rotor_drag_plane_n_s2_m_rad=0.0, body_drag_area_m2=0.0))
    attitude = quat_from_euler(0.0, math.radians(pitch_deg), 0.0)
    state = hovering(velocity_ned_m_s=velocity_ned_m_s, attitude=attitude)
    return -vehicle.step(state, ALL_HOVER, 1e-6).specific_force_body_m_s2[2]


def test_thrust_by_momentum_and_blade_element_theory() -> None:
    """Glauert's equation solved by halving, for flow from every side."""
    disc = 2.0 * AIR_DENSITY_KG_M3 * math.pi * X500.rotor_radius_m**2
    slope = X500.rotor_inflow_loss_n_s2_m_rad * X500.max_rotor_speed_rad_s * math.sqrt(HOVER)
    weight = X500.mass_kg * GRAVITY_M_S2 / 4.0
    hover = math.sqrt(weight / disc)
    for speed in (1.0, 5.0, 10.0, 15.0):
        for pitch_deg in (-30.0, -10.0, 0.0, 10.0):
            climb, edge = (
                -speed * math.sin(math.radians(pitch_deg)),
                speed * math.cos(math.radians(pitch_deg)),
            )
            low, high = 0.0, 30.0
            for _ in range(60):
                wake = 0.5 * (low + high)
                short = weight - slope * (climb + wake - hover) - disc * wake * math.hypot(edge, climb + wake)
                low, high = (wake, high) if short > 0.0 else (low, wake)
            expected = (weight - slope * (climb + low - hover)) * 4.0 / X500.mass_kg
            assert specific_thrust((speed, 0.0, 0.0), pitch_deg) == pytest.approx(expected, abs=2e-3)


def test_edgewise_flow_lifts_and_a_climb_costs() -> None:
    """Known of every helicopter: translational lift, and damping of vertical motion."""
    level = [specific_thrust((speed, 0.0, 0.0)) for speed in (0.0, 3.0, 6.0, 9.0)]
    assert level == sorted(level)
    assert 1.2 < level[3] / level[0] < 1.5
    climbing = [specific_thrust((0.0, 0.0, down)) for down in (2.0, 1.0, 0.0, -1.0, -2.0)]
    assert climbing == sorted(climbing, reverse=True)
    assert 0.5 < climbing[1] - climbing[2] < 1.0
    # deeper than hover's own wake nothing more is gained
    assert specific_thrust((0.0, 0.0, 8.0)) == pytest.approx(specific_thrust((0.0, 0.0, 20.0)), abs=1e-6)


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, 270])
def test_motion_does_not_depend_on_where_north_is(yaw_deg: int) -> None:
    yaw = math.radians(yaw_deg)
    vehicle = Quadrotor(X500)
    share: RotorValues = (0.52, 0.5, 0.48, 0.53)
    tilted = quat_from_euler(0.3, -0.25, 0.4)

    def flown(turn: float) -> QuadrotorState:
        state = hovering(
            velocity_ned_m_s=rotate_yaw((3.0, 1.0, -0.5), turn),
            attitude=quat_multiply(quat_from_euler(0.0, 0.0, turn), tilted),
        )
        for _ in range(100):
            state = vehicle.step(state, share, DT, wind_ned_m_s=rotate_yaw((-4.0, 2.0, 0.3), turn))
        return state

    north, turned = flown(0.0), flown(yaw)
    assert turned.velocity_ned_m_s == pytest.approx(rotate_yaw(north.velocity_ned_m_s, yaw), abs=1e-9)
    assert turned.rate_body_rad_s == pytest.approx(north.rate_body_rad_s, abs=1e-9)
    assert turned.specific_force_body_m_s2 == pytest.approx(north.specific_force_body_m_s2, abs=1e-9)


@pytest.mark.parametrize(
    ("roll", "pitch", "way"),
    [(0.1, 0.0, (0.0, 1.0, 0.0)), (0.0, 0.1, (-1.0, 0.0, 0.0)), (0.0, -0.1, (1.0, 0.0, 0.0))],
)
def test_tilting_accelerates_where_it_tilts(roll: float, pitch: float, way: Vector3) -> None:
    state = Quadrotor(X500).step(hovering(attitude=quat_from_euler(roll, pitch, 0.0)), ALL_HOVER, DT)
    along = sum(v * w for v, w in zip(state.velocity_ned_m_s, way, strict=True)) / DT
    assert along == pytest.approx(GRAVITY_M_S2 * math.sin(0.1), rel=0.01)


def test_wind_tilts_by_about_six_degrees_at_five_metres_a_second_and_carries_along_in_the_end() -> None:
    vehicle, state = Quadrotor(X500), hovering()
    force = vehicle.step(state, ALL_HOVER, DT, wind_ned_m_s=(5.0, 0.0, 0.0)).specific_force_body_m_s2
    assert 5.0 < math.degrees(math.atan2(force[0], GRAVITY_M_S2)) < 7.0
    for _ in range(20000):
        state = vehicle.step(state, ALL_HOVER, DT, wind_ned_m_s=(4.0, -2.0, 0.0))
    assert state.velocity_ned_m_s == pytest.approx((4.0, -2.0, 0.0), abs=0.05)


def test_climbing_costs_thrust_and_an_unknown_load_makes_it_sink() -> None:
    state = Quadrotor(X500).step(hovering(velocity_ned_m_s=(0.0, 0.0, -2.0)), ALL_HOVER, DT)
    assert -GRAVITY_M_S2 < state.specific_force_body_m_s2[2] < -GRAVITY_M_S2 + 4.0
    state = Quadrotor(X500, mass_factor=1.1).step(hovering(), ALL_HOVER, DT)
    assert state.velocity_ned_m_s[2] / DT == pytest.approx(GRAVITY_M_S2 * (1.0 - 1.0 / 1.1), rel=1e-3)


@pytest.mark.parametrize("attitude", [quat_from_euler(0.0, 0.0, 0.0), quat_from_euler(0.2, -0.1, 2.0)])
def test_an_outer_force_is_felt_by_the_accelerometer_and_gravity_is_not(attitude: Quaternion) -> None:
    state = Quadrotor(without_drag()).step(
        QuadrotorState((0.0, 0.0, -5.0), attitude=attitude), OFF, DT, force_ned_n=(1.5, 0.0, 0.0)
    )
    expected = matrix_from_quat(attitude).T @ np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(state.specific_force_body_m_s2, expected, atol=1e-9)


def test_the_rates_it_reports_are_those_it_turns_by() -> None:
    """GIVEN a constant rate WHEN it flies for a second THEN its axis has gone round by that much."""
    vehicle = Quadrotor(changed(inertia_kg_m2=(0.02, 0.02, 0.02), rotor_inertia_kg_m2=0.0))
    state = QuadrotorState((0.0, 0.0, 0.0), rate_body_rad_s=(1.0, 0.0, 0.0))
    for _ in range(400):
        state = vehicle.step(state, OFF, DT)
    assert tilt_from_quat(state.attitude) == pytest.approx(1.0, abs=1e-6)
    assert quat_rotate(state.attitude, (0.0, 1.0, 0.0))[2] > 0.0  # right side down


# ---------------- Weak motors: what is left of each command, and that the vehicle feels it


def test_one_is_weak_or_all_are_and_sound_ones_give_what_is_asked() -> None:
    motors = Motors()
    assert motors.given(HALF) is HALF
    motors.weaken(2, 0.85)
    assert motors.given((0.2, 0.4, 0.6, 0.8)) == pytest.approx((0.2, 0.34, 0.6, 0.8))
    motors.weaken(None, 0.5)
    assert motors.given((0.2, 0.4, 0.6, 0.8)) == pytest.approx((0.1, 0.17, 0.3, 0.4))
    motors.clear_faults()
    assert motors.given(HALF) is HALF


def rates_after(motor: int | None, share: float) -> tuple[float, float, float, float]:
    """Body rates and climb speed after a fifth of a second in the air with equal commands."""
    world = World(validate(Scenario, {"name": "x", "description": "x"}, "x"), 0)
    world.place(QuadrotorState((0.0, 0.0, -20.0), thrust_share=HALF))
    world.motors.weaken(motor, share)
    for _ in range(80):
        world.step(HALF, 0.0025)
    return (*world.state.rate_body_rad_s, world.state.velocity_ned_m_s[2])


@pytest.mark.parametrize(
    ("motor", "axis", "sign"),
    [(1, 1, -1.0), (2, 0, -1.0), (3, 1, 1.0), (4, 0, 1.0)],  # front: nose down; right: right side down...
)
def test_the_vehicle_sinks_on_the_side_of_a_weak_motor(motor: int, axis: int, sign: float) -> None:
    # negative pitch rate is nose down, positive roll rate right side down
    rates = rates_after(motor, 0.85)
    expected = sign if axis == 1 else -sign
    assert rates[axis] * expected > 0.3
    assert abs(rates[1 - axis]) < 0.1


def test_a_sagging_battery_costs_lift_and_turns_nothing() -> None:
    sound, sagging = rates_after(None, 1.0), rates_after(None, 0.9)
    # a tenth of g for a fifth of a second, less the motors' lag
    assert 0.12 < sagging[3] - sound[3] < 0.19
    assert max(abs(rate) for rate in sagging[:3]) < 1e-6


# ---------------- The battery: full at first, drained by thrust, sagging under load


def drained(motors: tuple[float, ...], seconds: int) -> Battery:
    battery = Battery(max_thrust_n=7.36)
    for _ in range(seconds):
        battery.step(motors, 1.0)
    return battery


def test_it_is_full_at_first_and_a_hover_lasts_about_twenty_minutes() -> None:
    full = drained(HALF, 0)
    assert full.share == 1.0
    assert full.voltage_v == pytest.approx(4.2 * CELLS)
    assert drained(HALF, 600).share == pytest.approx(0.5, abs=0.1)
    assert drained(HALF, 1500).share < 0.1


def test_what_has_flowed_is_what_is_missing() -> None:
    battery = drained(HALF, 120)
    assert battery.share == pytest.approx(1.0 - battery.consumed_mah / CAPACITY_MAH)
    assert battery.consumed_mah == pytest.approx(battery.current_a * 120.0 / 3.6, rel=0.03)


def test_more_thrust_takes_more_and_sags_deeper() -> None:
    off, hover, full = (drained(motors, 1) for motors in ((0.0,) * 4, HALF, (1.0,) * 4))
    assert off.current_a < 1.0 < hover.current_a
    # power goes with thrust to the power of 1.5
    assert full.current_a / hover.current_a == pytest.approx(2.0**1.5, rel=0.1)
    assert off.voltage_v > hover.voltage_v > full.voltage_v


def test_empty_it_stays_at_its_lowest_voltage() -> None:
    battery = drained((1.0,) * 4, 3600)
    assert battery.share == 0.0
    assert 2.8 * CELLS < battery.voltage_v < 3.3 * CELLS


def test_a_flight_drains_what_is_reported_in_both_messages() -> None:
    flight = AutopilotFlight("px4")
    flight.run(4.0)
    resting = sys_status(flight.autopilot, 4.0)
    flight.autopilot.arm()
    flight.autopilot.take_off(405.0)
    flight.run(40.0)
    status, battery = sys_status(flight.autopilot, 44.0), battery_status(flight.autopilot, 44.0)
    assert resting.battery_remaining == 100
    assert status.battery_remaining == battery.battery_remaining < 100
    assert status.voltage_battery < resting.voltage_battery
    assert status.current_battery == battery.current_battery > 10 * resting.current_battery
    assert sum(battery.voltages[:CELLS]) == pytest.approx(status.voltage_battery, abs=CELLS)
    assert battery.current_consumed > 50
    assert battery.energy_consumed > 10
