"""What lasts between command and thrust is found, slowly; a biased accelerometer is not taken for it."""

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    FloatArray,
    Quaternion,
    Vector3,
    add,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
)
from companion.base.messages import Setpoint, VehicleState
from companion.config import ControlConfig
from companion.control.adaptive_feedforward import (
    FASTEST_TURN_SHARE,
    LARGEST_EFFORT_M_S2,
    LARGEST_SHARE,
    AdaptiveFeedforward,
    learning_s,
)
from companion.control.attitude import attitude_from_acceleration
from companion.control.disturbance_observer import SlowDisturbanceObserver, WindObserver
from companion.control.response.fitting import loop_rad_s
from companion.control.response.flight_model import advance_axis
from tests.unit.control.control_plants import Loop, Motion3, controller, line, still
from tests.unit.control.control_vehicles import PointMass, SwayingAutopilot
from tests.unit.control.controller_inputs import vehicle_state

PERIOD_S = 1.0 / 30.0
TAU_S = 0.11
LAGS_S = (TAU_S, TAU_S, 0.04)
SENSOR_LAG_S = 0.035
BANDWIDTHS_RAD_S = (0.5, 0.5, 2.0)


def _observe(lasting: Vector3, bias: float, seconds: float, bound: float = 3.0) -> SlowDisturbanceObserver:
    """Fly the model itself with something on top, and measure its acceleration late and with a bias."""
    observer = SlowDisturbanceObserver(LAGS_S, SENSOR_LAG_S, bound, BANDWIDTHS_RAD_S)
    axes, shown = [(0.0, 0.0, 0.0)] * 3, [0.0, 0.0, 0.0]
    for k in range(round(seconds / PERIOD_S)):
        u = (math.sin(0.2 * k), 0.5, 0.0)
        for _ in range(20):
            axes = [advance_axis(axes[i], u[i] + lasting[i], PERIOD_S / 20, LAGS_S[i]) for i in range(3)]
            shown = [
                s + (axis[2] - s) * PERIOD_S / 20 / SENSOR_LAG_S for s, axis in zip(shown, axes, strict=True)
            ]
        observer.predict(u, PERIOD_S)
        measured = (shown[0] + bias, shown[1] + bias, shown[2] + bias)
        observer.correct((axes[0][1], axes[1][1], axes[2][1]), measured, measured, PERIOD_S)
    return observer


def test_finds_what_lasts_on_each_axis() -> None:
    assert _observe((1.0, -0.5, 0.2), 0.0, 20.0).lasting_ned_m_s2 == pytest.approx((1.0, -0.5, 0.2), abs=0.03)


def test_it_is_believed_as_fast_as_reported_and_no_faster() -> None:
    x, _, z = _observe((1.0, 0.0, 1.0), 0.0, 1.0).lasting_ned_m_s2
    assert x == pytest.approx(1.0 - math.exp(-0.5), abs=0.1)
    assert z == pytest.approx(1.0 - math.exp(-2.0), abs=0.1)


def test_a_biased_acceleration_is_reported_by_the_velocity() -> None:
    observer = _observe((0.4, 0.4, 0.4), 0.15, 25.0)
    assert observer.lasting_ned_m_s2 == pytest.approx((0.4, 0.4, 0.4), abs=0.03)
    assert observer.bias_ned_m_s2 == pytest.approx((0.15, 0.15, 0.15), abs=0.01)


def test_stays_within_its_bound() -> None:
    assert _observe((5.0, -5.0, 0.0), 0.0, 20.0, bound=2.0).lasting_ned_m_s2[:2] == (2.0, -2.0)


def test_a_jump_of_the_estimate_hardly_disturbs() -> None:
    observer = SlowDisturbanceObserver(LAGS_S, SENSOR_LAG_S, 3.0, BANDWIDTHS_RAD_S)
    still = (0.0, 0.0, 0.0)
    for _ in range(30):
        observer.correct((5.0, 0.0, 0.0), still, still, PERIOD_S)
    assert abs(observer.lasting_ned_m_s2[0]) < 0.05


@pytest.mark.parametrize(("pushes_m_s2", "known_m_s2"), [(-3.0, -0.2), (3.0, 3.0)])
def test_what_may_be_the_surface_under_the_feet_is_not_learnt(pushes_m_s2: float, known_m_s2: float) -> None:
    """It is gone as soon as the vehicle rises; what presses it down, or was known before, is not."""
    observer = SlowDisturbanceObserver(LAGS_S, SENSOR_LAG_S, 5.0, BANDWIDTHS_RAD_S)
    observer.start(ZERO3, ZERO3, (0.0, 0.0, -0.2))
    thrust = (0.0, 0.0, pushes_m_s2)
    for _ in range(300):
        observer.correct(ZERO3, thrust, thrust, PERIOD_S, feet_near=True, may_stand=True)
        observer.keep(ZERO3)
    assert observer.lasting_ned_m_s2[2] == pytest.approx(known_m_s2, abs=0.6)


def test_what_lifts_it_near_the_surface_is_met_until_it_may_stand_and_forgotten_once_it_leaves() -> None:
    observer = SlowDisturbanceObserver(LAGS_S, SENSOR_LAG_S, 5.0, BANDWIDTHS_RAD_S)
    lifts = (0.0, 0.0, -2.0)
    for _ in range(30):
        observer.correct(ZERO3, lifts, lifts, PERIOD_S, feet_near=True)
        observer.keep(ZERO3)
    met_m_s2 = observer.lasting_ned_m_s2[2]
    assert met_m_s2 < -0.5
    for _ in range(30):
        observer.correct(ZERO3, lifts, lifts, PERIOD_S, feet_near=True, may_stand=True)
    assert observer.lasting_ned_m_s2[2] == met_m_s2
    observer.leave_surface()
    assert observer.lasting_ned_m_s2[2] == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_passes_over_a_measurement_that_is_not_finite(bad: float) -> None:
    observer = SlowDisturbanceObserver(LAGS_S, SENSOR_LAG_S, 3.0, BANDWIDTHS_RAD_S)
    observer.start((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.0))
    still = (0.0, 0.0, 0.0)
    observer.correct((bad, 0.0, 0.0), still, still, PERIOD_S)
    observer.correct(still, (0.0, bad, 0.0), still, PERIOD_S)
    observer.correct(still, still, (0.0, bad, 0.0), PERIOD_S)
    assert observer.lasting_ned_m_s2 == (0.3, 0.0, 0.0)


def test_what_thrust_makes_is_known_anew_once_thrust_is_worth_more() -> None:
    observer = SlowDisturbanceObserver(LAGS_S, SENSOR_LAG_S, 3.0, BANDWIDTHS_RAD_S)
    observer.start((0.0, 0.0, 0.0), (1.0, 0.0, -GRAVITY_M_S2))  # twice the weight, tilted
    observer.scale_thrust(1.1)
    assert observer.made_ned_m_s2 == pytest.approx((1.1, 0.0, -1.2 * GRAVITY_M_S2))
    assert observer.delayed_response_down_m_s2 == pytest.approx(-1.2 * GRAVITY_M_S2)


# ----------------
# What the vehicle does not fly of the pad's acceleration is learnt from the feedback; nothing else is.

WEIGHTS = ControlConfig().horizontal
SPEED_M_S, RATE_RAD_S, STEP_S = 1.5, 0.7, 1.0 / 30.0
GAIN = 1.25


@dataclass
class TooKeen(SwayingAutopilot):
    """Tilts further than it is asked to, as ArduCopter does."""

    def force(self, vehicle: PointMass, setpoint: Setpoint, time_s: float, dt_s: float) -> Vector3:
        x, y, down = super().force(vehicle, setpoint, time_s, dt_s)
        vehicle.attitude = attitude_from_acceleration((GAIN * x, GAIN * y, 0.0), 0.0)
        return (GAIN * x, GAIN * y, down)


def turning(time_s: float, rate_rad_s: float = RATE_RAD_S) -> tuple[Vector3, Vector3]:
    """Velocity and acceleration of a pad on a circle."""
    v = SPEED_M_S * cmath.exp(1j * rate_rad_s * time_s)
    a = 1j * rate_rad_s * v
    return (v.real, v.imag, 0.0), (a.real, a.imag, 0.0)


def tight_circle(time_s: float) -> Motion3:
    """The same with its place."""
    radius_m = SPEED_M_S / RATE_RAD_S
    c, s = math.cos(RATE_RAD_S * time_s), math.sin(RATE_RAD_S * time_s)
    return (radius_m * s, radius_m * (1.0 - c), 0.0), *turning(time_s)


def taught(
    missing: Callable[[complex], complex], *, rate_rad_s: float = RATE_RAD_S, duration_s: float = 30.0
) -> AdaptiveFeedforward:
    """After feedback that makes up for what is missing of the pad's acceleration and is not fed forward."""
    learner = AdaptiveFeedforward(WEIGHTS)
    for k in range(round(duration_s / STEP_S)):
        velocity, acceleration = turning(k * STEP_S, rate_rad_s)
        fed = learner.missing_m_s2(acceleration)
        left = missing(complex(*acceleration[:2])) - complex(*fed[:2])
        learner.learn((left.real, left.imag, 0.3), velocity, acceleration, STEP_S)
    return learner


@pytest.mark.parametrize("share", [0.1, -0.15, 0.12j, 0.1 - 0.1j])
def test_a_scale_and_a_lag_are_learnt_to_the_full(share: complex) -> None:
    assert taught(lambda a: share * a).share == pytest.approx(share, abs=2e-3)


def test_it_takes_as_long_as_the_margins_are_computed_with() -> None:
    noise_costs = 1.0 / (1.0 + (0.3 / (SPEED_M_S * RATE_RAD_S)) ** 2)
    after = taught(lambda a: 0.1 * a, duration_s=learning_s(WEIGHTS)).share
    assert after.real == pytest.approx(0.1 * (1.0 - math.exp(-noise_costs)), rel=0.02)


def test_it_learns_no_more_than_a_quarter() -> None:
    assert abs(taught(lambda a: 0.5 * a).share) == pytest.approx(LARGEST_SHARE)


def test_a_pad_that_turns_too_fast_for_the_loop_teaches_nothing() -> None:
    fastest_rad_s = FASTEST_TURN_SHARE * loop_rad_s(WEIGHTS)
    assert taught(lambda a: 0.1 * a, rate_rad_s=1.01 * fastest_rad_s).share == 0j
    assert taught(lambda a: 0.1 * a, rate_rad_s=0.99 * fastest_rad_s).share != 0j


@pytest.mark.parametrize("effort", [(1.01 * LARGEST_EFFORT_M_S2, 0.0, 0.0), (math.nan, 0.0, 0.0)])
def test_the_way_back_to_the_reference_teaches_nothing(effort: Vector3) -> None:
    learner = AdaptiveFeedforward(WEIGHTS)
    learner.learn(effort, *turning(0.0), STEP_S)
    assert learner.share == 0j


def test_a_pad_that_does_not_accelerate_teaches_nothing() -> None:
    learner = AdaptiveFeedforward(WEIGHTS)
    learner.learn((0.5, -0.3, 0.0), (2.0, 0.0, 0.0), ZERO3, STEP_S)
    assert learner.share == 0j
    assert learner.missing_m_s2((1.0, 2.0, 3.0)) == ZERO3


def test_a_vehicle_that_tilts_too_far_stays_over_a_pad_on_a_circle() -> None:
    loop = Loop(controller(setpoint="attitude"), TooKeen(), tight_circle, still, noise=0.0)
    loop.velocity_bias = loop.acceleration_bias = ZERO3
    flight = loop.fly(25.0)
    assert flight.lateral_error_m(1.5) > 0.015
    assert flight.lateral_error_m(20.0) < 0.008


def test_a_wind_that_takes_all_of_the_tilt_teaches_nothing() -> None:
    flying = controller(limits={"tilt_deg": 20.0})
    loop = Loop(flying, SwayingAutopilot(), tight_circle, still, wind=lambda _t: (3.0, 0.0, 0.0))
    assert any(report.short_of == "tilt" for report in loop.fly(20.0).reports)
    assert abs(flying._feedforward.share) < 0.04


def test_over_a_pad_that_drives_straight_on_it_is_as_ever() -> None:
    flying = controller(setpoint="attitude")
    Loop(flying, TooKeen(), line, still, noise=0.0).fly(4.0)
    assert flying._feedforward.share == 0j


# ---------------- The wind's push is told from the tilt at once, on every course and heading

LEVEL = quat_from_euler(0.0, 0.0, 0.0)


def feeling(attitude: Quaternion, acceleration: Vector3) -> VehicleState:
    return vehicle_state(0.0, attitude=attitude, acceleration_ned_m_s2=acceleration)


def feel(wind: WindObserver, attitude: Quaternion, acceleration: Vector3, seconds: float) -> Vector3:
    for _ in range(round(seconds / PERIOD_S)):
        wind.step(feeling(attitude, acceleration), PERIOD_S)
    return wind.wind_ned_m_s2


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0, 270.0])
def test_a_push_beyond_the_tilt_is_found_within_a_fifth_of_a_second(heading_deg: float) -> None:
    tilt = attitude_from_acceleration((0.8, -0.4, 0.0), math.radians(heading_deg))
    wind = WindObserver(SENSOR_LAG_S, 5.0)
    assert feel(wind, tilt, (0.8, -0.4, 0.0), 1.0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert feel(wind, tilt, (1.8, -1.4, 0.0), 0.2) == pytest.approx((1.0, -1.0, 0.0), abs=0.15)


def test_a_wind_that_lasts_is_reported_all_the_time() -> None:
    tilt = attitude_from_acceleration((2.0, 0.0, 0.0), 0.3)
    assert feel(WindObserver(SENSOR_LAG_S, 5.0), tilt, (0.0, 0.0, 0.0), 30.0) == pytest.approx(
        (-2.0, 0.0, 0.0)
    )


def test_an_attitude_that_is_off_is_no_wind() -> None:
    truth = attitude_from_acceleration((0.5, 0.5, 0.0), 1.0)
    off = quat_multiply(quat_from_euler(0.03, -0.02, 0.0), truth)
    # an accelerometer that feels thrust alone, turned by the attitude that is off
    flown = add(quat_rotate(off, (0.0, 0.0, -GRAVITY_M_S2)), (0.0, 0.0, GRAVITY_M_S2))
    assert feel(WindObserver(SENSOR_LAG_S, 5.0), off, flown, 0.5) == pytest.approx(ZERO3, abs=1e-6)


def test_a_climbing_vehicle_gets_more_from_the_same_tilt() -> None:
    up = -2.0
    tilt = attitude_from_acceleration((1.0, 0.0, up), 0.0)
    push = feel(WindObserver(SENSOR_LAG_S, 5.0), tilt, (1.0, 0.0, up), 2.0)
    assert push == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_what_is_no_number_is_passed_over() -> None:
    wind = WindObserver(SENSOR_LAG_S, 5.0)
    feel(wind, LEVEL, (0.3, 0.0, 0.0), 1.0)
    good = feeling(LEVEL, (1.0, 0.0, 0.0))
    for bad in (
        replace(good, acceleration_ned_m_s2=(math.nan, 0.0, 0.0)),
        replace(good, side_force_ned_m_s2=(0.0, math.nan, 0.0)),
        replace(good, attitude=(math.nan, 0.0, 0.0, 0.0)),
    ):
        wind.step(bad, PERIOD_S)
    assert wind.wind_ned_m_s2 == pytest.approx((0.3, 0.0, 0.0), abs=1e-6)


def test_it_stays_within_its_bound() -> None:
    assert feel(WindObserver(SENSOR_LAG_S, 3.0), LEVEL, (9.0, -9.0, 0.0), 1.0) == pytest.approx(
        (3.0, -3.0, 0.0)
    )


def test_a_gust_that_grows_is_known_for_when_it_is_met() -> None:
    slope_m_s3, ahead_s = 0.8, 0.15
    wind, felt = WindObserver(SENSOR_LAG_S, 5.0), 0.0
    for k in range(75):
        blows = slope_m_s3 * k * PERIOD_S
        felt = blows - slope_m_s3 * SENSOR_LAG_S if blows > slope_m_s3 * SENSOR_LAG_S else 0.0
        wind.step(feeling(LEVEL, (felt, 0.0, 0.0)), PERIOD_S)
    met = slope_m_s3 * (74 * PERIOD_S + ahead_s)
    assert wind.ahead_ned_m_s2(ahead_s)[0] == pytest.approx(met, abs=0.04)
    assert wind.wind_ned_m_s2[0] < met - 0.15


def test_a_jolt_is_not_carried_on_for_long() -> None:
    wind = WindObserver(SENSOR_LAG_S, 5.0)
    feel(wind, LEVEL, (0.0, 0.0, 0.0), 1.0)
    wind.step(feeling(LEVEL, (5.0, 0.0, 0.0)), PERIOD_S)
    assert wind.ahead_ned_m_s2(0.15)[0] <= wind.wind_ned_m_s2[0] + WindObserver.MOST_CHANGE_M_S2


@pytest.mark.parametrize("late_s", [0.0, 0.03, 0.1])
def test_a_tilt_that_the_loop_itself_makes_is_no_wind(late_s: float) -> None:
    """Swinging at the loop's own ringing, measured late: a thrust is along body up all the same."""
    rate_rad_s = 10.0
    wind, most = WindObserver(SENSOR_LAG_S, 5.0), 0.0
    for k in range(1, 120):
        now, then = (math.sin(rate_rad_s * (k * PERIOD_S - age_s)) for age_s in (0.0, late_s))
        felt = feeling(attitude_from_acceleration((then, 0.0, 0.0), 0.0), (then, 0.0, 0.0))
        wind.step(replace(felt, attitude=attitude_from_acceleration((now, 0.0, 0.0), 0.0)), PERIOD_S)
        most = max(most, abs(wind.wind_ned_m_s2[0]))
    assert most < 1e-9


def felt(wind: WindObserver, forces: FloatArray, density: float) -> FloatArray:
    """What the observer makes of these side forces, the last half of them: the wind, and ahead of it."""
    state = replace(feeling(LEVEL, ZERO3), acceleration_density_m2_s3=density)
    rows = []
    for x in forces:
        wind.step(replace(state, side_force_ned_m_s2=(float(x), 0.0, 0.0)), PERIOD_S)
        rows.append((wind.wind_ned_m_s2[0], wind.ahead_ned_m_s2(0.15)[0]))
    return np.array(rows[len(rows) // 2 :])


def test_in_calm_air_a_noisy_accelerometer_moves_nothing() -> None:
    """SIH's accelerometer errs by 1 m/s2."""
    noise = np.random.default_rng(5).normal(0.0, 0.5, 1800)
    told, untold = (felt(WindObserver(SENSOR_LAG_S, 5.0), noise, d) for d in (0.25 * PERIOD_S, 0.0))
    assert told[:, 1].std() < 0.4 * untold[:, 1].std()


def test_in_turbulence_a_noisy_accelerometer_is_followed_nearly_as_quickly_as_a_quiet_one() -> None:
    rng = np.random.default_rng(6)
    walk = np.cumsum(rng.normal(0.0, math.sqrt(0.3 * PERIOD_S), 1800))
    walk *= min(1.0, 8.0 / float(np.abs(walk).max()))
    noisy = walk + rng.normal(0.0, 0.2, 1800)
    off = felt(WindObserver(SENSOR_LAG_S, 9.0), noisy, 0.04 * PERIOD_S)[:, 0] - walk[900:]
    assert off.std() < 0.25


def test_a_blow_is_no_noise() -> None:
    wind = WindObserver(SENSOR_LAG_S, 5.0)
    felt(wind, np.zeros(300), 1e-4)
    felt(wind, np.zeros(15), 0.5)
    assert felt(wind, np.full(10, 2.0), 0.2)[-1, 0] > 1.8


def test_a_start_anew_begins_with_the_wind_of_late() -> None:
    wind = WindObserver(SENSOR_LAG_S, 5.0)
    felt(wind, np.full(200, 1.5), 0.0)
    wind.reset()
    wind.step(replace(feeling(LEVEL, ZERO3), side_force_ned_m_s2=(9.0, 0.0, 0.0)), 0.0)
    assert wind.wind_ned_m_s2[0] == pytest.approx(1.5, abs=0.01)


def test_a_drag_that_turns_with_the_vehicle_is_known_ahead() -> None:
    """PX4's SIH: drag of 1 1/s, an accelerometer that errs by 0.5 m/s2; over a pad that drives a circle."""
    drag_per_s, turn_rad_s, ahead_s, speed_m_s = 1.0, 0.28, 0.2, 1.5
    wind, rng, off = WindObserver(SENSOR_LAG_S, 5.0), np.random.default_rng(7), list[complex]()
    for k in range(round(24.0 / PERIOD_S)):
        time_s = k * PERIOD_S

        def velocity(at_s: float) -> complex:
            # at rest, then along a line, then around
            speed = speed_m_s * min(max(0.0, at_s - 2.0) / 1.5, 1.0)
            return speed * complex(np.exp(1j * turn_rad_s * max(0.0, at_s - 8.0)))

        late_m_s = velocity(time_s - SENSOR_LAG_S)
        force = -drag_per_s * late_m_s + complex(*rng.normal(0.0, 0.5, 2))
        flown = (velocity(time_s + 0.01) - velocity(time_s - 0.01)) / 0.02
        tilted = flown + drag_per_s * velocity(time_s)
        now_m_s = velocity(time_s)
        state = replace(
            feeling(attitude_from_acceleration((tilted.real, tilted.imag, 0.0), 0.0), ZERO3),
            velocity_ned_m_s=(now_m_s.real, now_m_s.imag, 0.0),
            side_force_ned_m_s2=(force.real, force.imag, 0.0),
            acceleration_density_m2_s3=0.25 * PERIOD_S,
        )
        wind.step(state, PERIOD_S)
        north, east, _ = wind.ahead_ned_m_s2(ahead_s)
        if time_s > 14.0:
            off.append(complex(north, east) + drag_per_s * velocity(time_s + ahead_s))
    assert wind.drag_per_s == pytest.approx(drag_per_s, abs=0.15)
    # what a smoothed force is late by turned to one side: 0.1 m/s2, and 5 cm beside the pad
    aside = np.array(off) * np.exp(-1j * turn_rad_s * (np.arange(len(off)) * PERIOD_S + 6.0))
    assert abs(aside.imag.mean()) < 0.04


def test_gusts_that_push_the_vehicle_are_no_drag() -> None:
    rng, wind, velocity_m_s, push = np.random.default_rng(8), WindObserver(SENSOR_LAG_S, 5.0), 0.0, 0.0
    drags = list[float]()
    for _ in range(round(60.0 / PERIOD_S)):
        push += float(rng.normal(0.0, math.sqrt(0.3 * PERIOD_S))) - 0.3 * push * PERIOD_S
        velocity_m_s += (0.3 * push - 1.5 * velocity_m_s) * PERIOD_S
        state = replace(
            feeling(LEVEL, ZERO3),
            velocity_ned_m_s=(velocity_m_s, 0.0, 0.0),
            side_force_ned_m_s2=(push, 0.0, 0.0),
            acceleration_density_m2_s3=1e-4,
        )
        wind.step(state, PERIOD_S)
        drags.append(wind.drag_per_s)
    assert max(drags[len(drags) // 2 :]) < 0.15


def test_a_velocity_that_jumps_at_a_fix_is_no_drag() -> None:
    wind = WindObserver(SENSOR_LAG_S, 5.0)
    wind.drag_per_s = 1.0
    for velocity_m_s, steps in ((1.0, 60), (2.5, 1)):
        tilted = attitude_from_acceleration((1.0, 0.0, 0.0), 0.0)
        state = replace(feeling(tilted, ZERO3), velocity_ned_m_s=(velocity_m_s, 0.0, 0.0))
        for _ in range(steps):
            wind.step(replace(state, side_force_ned_m_s2=(-1.0, 0.0, 0.0)), PERIOD_S)
            assert wind.ahead_ned_m_s2(0.2)[0] == pytest.approx(-1.0, abs=0.05)
