"""The wind's push is told from the tilt at once, on every course and heading."""

import math
from dataclasses import replace

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
from companion.base.messages import VehicleState
from companion.control.attitude import attitude_from_acceleration
from companion.control.disturbance_observer import WindObserver
from tests.unit.control.controller_inputs import vehicle_state

PERIOD_S = 1.0 / 30.0
SENSOR_LAG_S = 0.035


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
