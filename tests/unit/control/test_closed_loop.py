"""The controller flown on vehicles that differ from its model: does it stay over the pad?"""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import ZERO3, Vector3, tilt_from_quat
from tests.unit.control.control_plants import (
    LINK_DELAY_S,
    Loop,
    PadMotion,
    circle,
    controller,
    figure_eight,
    heave,
    line,
    min_jerk_offset,
    still,
)
from tests.unit.control.control_vehicles import AttitudeAutopilot, VelocityAutopilot

APPROACH = min_jerk_offset((2.0, -1.0, -5.0), (0.0, 0.0, -2.0), 6.0)
SETTLED_S = 10.0


def _steady_wind(_time_s: float) -> Vector3:
    return (0.8, -0.6, 0.0)


def _gusts(time_s: float) -> Vector3:
    return (
        0.8 + 0.4 * math.sin(1.1 * time_s),
        -0.5 + 0.3 * math.cos(0.8 * time_s),
        0.1 * math.sin(2 * time_s),
    )


@pytest.mark.parametrize(
    ("pad", "bound_m"), [(still, 0.025), (line, 0.025), (circle, 0.04), (figure_eight, 0.055), (heave, 0.025)]
)
@pytest.mark.parametrize("kind", ["velocity", "acceleration"])
def test_they_stay_over_the_pad_despite_biased_velocity(kind: str, pad: PadMotion, bound_m: float) -> None:
    flight = Loop(controller(setpoint=kind), VelocityAutopilot(), pad, APPROACH).fly(20.0)
    assert flight.lateral_error_m(SETTLED_S) < bound_m
    assert np.abs(flight.error_m(SETTLED_S)[:, 2]).max() < 0.04
    assert all(report.solved for report in flight.reports)


@pytest.mark.parametrize(("pad", "bound_m"), [(line, 0.02), (circle, 0.04), (figure_eight, 0.05)])
@pytest.mark.parametrize("thrust_scale", [0.9, 1.1])
def test_attitude_setpoints_reject_wind_and_a_wrong_thrust_scale(
    pad: PadMotion, bound_m: float, thrust_scale: float
) -> None:
    autopilot = AttitudeAutopilot(thrust_scale=thrust_scale)
    flight = Loop(controller(setpoint="attitude"), autopilot, pad, APPROACH, wind=_steady_wind).fly(20.0)
    assert flight.lateral_error_m(SETTLED_S) < bound_m
    assert np.abs(flight.error_m(SETTLED_S)[:, 2]).max() < 0.02
    assert flight.reports[-1].disturbance_ned_m_s2[0] == pytest.approx(0.8, abs=0.2)


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "attitude"])
def test_gusts_are_held_to_a_few_centimetres(kind: str) -> None:
    autopilot = VelocityAutopilot() if kind != "attitude" else AttitudeAutopilot()
    flight = Loop(controller(setpoint=kind), autopilot, figure_eight, APPROACH, wind=_gusts).fly(20.0)
    error = np.hypot(*flight.error_m(SETTLED_S)[:, :2].T)
    assert np.median(error) < 0.04
    assert error.max() < 0.07


def _sinking_gust(time_s: float) -> Vector3:
    return (0.0, 0.0, 3.0 * min(1.0, max(0.0, (time_s - 3.0) / 0.5)))


@pytest.mark.parametrize(
    ("link_delay_s", "sensor_delay_s"), [(LINK_DELAY_S, 0.0), (0.08, 0.0), (LINK_DELAY_S, 0.05)]
)
def test_a_gust_that_sinks_is_met_and_leaves_no_swing(link_delay_s: float, sensor_delay_s: float) -> None:
    flight = Loop(
        controller(setpoint="attitude"),
        AttitudeAutopilot(),
        still,
        min_jerk_offset((0.0, 0.0, -3.0), (0.0, 0.0, -3.0), 1.0),
        wind=_sinking_gust,
        link_delay_s=link_delay_s,
        sensor_delay_s=sensor_delay_s,
    ).fly(8.0)
    late = np.array(flight.time_s) > 6.0
    assert flight.error_m(3.0)[:, 2].max() < 0.24
    assert np.abs(np.array(flight.relative_velocity_m_s)[late, 2]).max() < 0.05
    assert not any(report.failure for report in flight.reports)


@pytest.mark.parametrize(
    "autopilot",
    [
        VelocityAutopilot(gain=(1.8, 1.8, 4.0), integral_gain=(0.4, 0.4, 2.0)),
        VelocityAutopilot(gain=(4.0, 4.0, 5.0), integral_gain=(1.0, 1.0, 1.0), lag_s=0.22),
        VelocityAutopilot(integral_gain=(0.0, 0.0, 0.0), lag_s=0.1),
    ],
)
@pytest.mark.parametrize("kind", ["velocity", "acceleration"])
def test_other_autopilots_than_the_assumed_one_are_flown_well(
    kind: str, autopilot: VelocityAutopilot
) -> None:
    flight = Loop(controller(setpoint=kind), replace(autopilot), circle, APPROACH, wind=_steady_wind).fly(
        20.0
    )
    assert flight.lateral_error_m(SETTLED_S) < 0.04


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "attitude"])
@pytest.mark.parametrize("goal", [(0.0, 0.0, -4.0), (1.0, 0.0, -5.0)])
def test_a_step_of_a_metre_is_taken_without_overshoot(kind: str, goal: Vector3) -> None:
    autopilot = VelocityAutopilot() if kind != "attitude" else AttitudeAutopilot(thrust_scale=1.0)
    start = (0.0, 0.0, -5.0)

    def step(time_s: float) -> tuple[Vector3, Vector3, Vector3]:
        return (start if time_s < 4.0 else goal), ZERO3, ZERO3

    flight = Loop(controller(setpoint=kind), autopilot, still, step, noise=0.0).fly(9.0)
    axis = 0 if goal[0] else 2
    travelled = np.array([place[axis] - start[axis] for place in flight.offset_m])
    assert travelled.max() < 1.05
    assert travelled[-1] == pytest.approx(1.0, abs=0.02)


def test_a_descent_to_the_pad_arrives_slowly_and_never_below_the_floor() -> None:
    descent = min_jerk_offset((0.0, 0.0, -3.0), (0.0, 0.0, -0.2), 8.0)
    loop = Loop(controller(), VelocityAutopilot(), heave, descent, minimum_height_m=0.5)
    flight = loop.fly(12.0)
    assert max(place[2] for place in flight.offset_m) < -0.45


def test_everything_that_leaves_is_within_the_limits_even_from_far_away() -> None:
    far = min_jerk_offset((30.0, -40.0, -15.0), (30.0, -40.0, -15.0), 1.0)

    def jump(time_s: float) -> tuple[Vector3, Vector3, Vector3]:
        return far(0.0) if time_s < 1.0 else ((0.0, 0.0, -2.0), ZERO3, ZERO3)

    for kind in ("velocity", "acceleration", "attitude"):
        autopilot = VelocityAutopilot() if kind != "attitude" else AttitudeAutopilot()
        flight = Loop(controller(setpoint=kind), autopilot, still, jump).fly(14.0)
        for setpoint in flight.setpoints:
            assert math.hypot(*setpoint.velocity_ned_m_s[:2]) <= 6.0 + 1e-9
            assert abs(setpoint.velocity_ned_m_s[2]) <= 1.5 + 1e-9
            assert math.hypot(*setpoint.acceleration_ned_m_s2[:2]) <= 5.5 + 1e-9
            if setpoint.attitude is not None:
                assert tilt_from_quat(setpoint.attitude) <= math.radians(30.0) + 1e-9
        gone = np.linalg.norm(np.array(flight.offset_m[-1]) - np.array(flight.offset_m[0]))
        assert gone > 15.0


def test_setpoints_that_leave_every_20_or_60_ms_do_as_well() -> None:
    for period_s in (0.02, 0.06):
        loop = Loop(controller(), VelocityAutopilot(), circle, APPROACH, control_period_s=period_s)
        assert loop.fly(16.0).lateral_error_m(SETTLED_S) < 0.04


@pytest.mark.parametrize(("delay_s", "assumed_s"), [(0.0, 0.0), (0.06, 0.06), (0.15, 0.15), (0.1, 0.04)])
@pytest.mark.parametrize("kind", ["velocity", "acceleration", "attitude"])
def test_a_late_link_is_made_up_for(kind: str, delay_s: float, assumed_s: float) -> None:
    autopilot = VelocityAutopilot() if kind != "attitude" else AttitudeAutopilot(thrust_scale=1.0)
    fly = controller(setpoint=kind, command_delay_s=assumed_s)
    flight = Loop(fly, autopilot, circle, APPROACH, link_delay_s=delay_s).fly(13.0)
    assert flight.lateral_error_m(SETTLED_S) < 0.05


def test_a_delay_that_nobody_knows_of_makes_nothing_sway() -> None:
    fly = controller(setpoint="attitude", command_delay_s=0.0)
    loop = Loop(fly, AttitudeAutopilot(thrust_scale=1.0), circle, APPROACH, link_delay_s=0.15)
    assert np.std(loop.fly(13.0).error_m(SETTLED_S)[:, :2], axis=0).max() < 0.01


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "attitude"])
def test_estimates_of_an_age_that_changes_are_carried_to_the_moment(kind: str) -> None:
    autopilot = VelocityAutopilot() if kind != "attitude" else AttitudeAutopilot(thrust_scale=1.0)
    loop = Loop(controller(setpoint=kind), autopilot, circle, APPROACH, pad_age_s=(0.04, 0.15))
    assert loop.fly(13.0).lateral_error_m(SETTLED_S) < 0.05


def test_the_same_flight_twice_is_bit_identical() -> None:
    def fly() -> list[Vector3]:
        flight = Loop(controller(), VelocityAutopilot(), circle, APPROACH, wind=_gusts).fly(4.0)
        return flight.offset_m

    assert fly() == fly()


def test_tilting_over_and_back_neither_sinks_nor_climbs() -> None:
    autopilot = AttitudeAutopilot(thrust_scale=1.0)
    kick = Loop(controller(setpoint="attitude"), autopilot, still, _kicked, noise=0.0).fly(7.0)
    after = np.array(kick.time_s) >= 1.0  # it is seen coming
    tilt = np.array(kick.acceleration_m_s2)[after, 0]
    climb = np.array(kick.relative_velocity_m_s)[after, 2]
    assert np.abs(tilt).max() > 1.5
    assert np.abs(climb - np.median(climb)).max() < 0.006


def _kicked(time_s: float) -> tuple[Vector3, Vector3, Vector3]:
    return (0.0 if time_s < 3.0 else 2.0, 0.0, -3.0), ZERO3, ZERO3
