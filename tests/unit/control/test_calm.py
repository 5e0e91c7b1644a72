"""Nothing sways: the loop of controller, autopilot and late estimates dies out, with room to spare.

The vehicle answers like a real one (`SwayingAutopilot`): rate and attitude loops, motors, an outer loop at
100 Hz, and an acceleration that is told late. The controller knows one lag and one delay only.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, FloatArray, Vector3, rotate_yaw
from companion.base.messages import PadState
from companion.control.pad_prediction import origin_at_rest, predict_pad, turn_rate
from tests.unit.control.control_plants import (
    ControlFlight,
    Loop,
    Motion3,
    PadMotion,
    circle,
    controller,
    figure_eight,
    line,
    still,
)
from tests.unit.control.control_vehicles import SwayingAutopilot

LINK_S = 0.01  # what the simulator's link and loops take; the settings assume more
# outer gains (north, east, down) and integral gains, as PX4's and ArduPilot's parameters have them
AUTOPILOT_KINDS = {"px4": ((1.8, 1.8, 4.0), (0.5, 0.5, 2.0)), "ardupilot": ((2.0, 2.0, 5.0), (1.0, 1.0, 2.0))}


def _nudged(time_s: float) -> Motion3:
    """Hold over the pad, and from the third second on half a metre to the north: a kick."""
    return (0.0 if time_s < 3.0 else 0.5, 0.0, -3.0), ZERO3, ZERO3


def _held(_time_s: float) -> Motion3:
    return (0.0, 0.0, -3.0), ZERO3, ZERO3


def _heave(time_s: float) -> Motion3:
    """A quarter of a metre every 5 s."""
    h, w = 0.25, math.tau / 5.0
    return (
        (0.0, 0.0, h * math.sin(w * time_s)),
        (0.0, 0.0, h * w * math.cos(w * time_s)),
        (0.0, 0.0, -h * w * w * math.sin(w * time_s)),
    )


def _fly(
    autopilot: SwayingAutopilot,
    pad: PadMotion = still,
    offset: Callable[[float], Motion3] = _held,
    *,
    kind: str = "velocity",
    link_s: float = LINK_S,
    noise: float = 0.0,
) -> ControlFlight:
    loop = Loop(controller(setpoint=kind), autopilot, pad, offset, noise=noise, link_delay_s=link_s)
    loop.sensor_lag_s, loop.sensor_delay_s = 0.025, 0.01
    return loop.fly(13.0)


def _tilt_deg(flight: ControlFlight, after_s: float) -> FloatArray:
    """Tilt (n, 2) in degrees, by the acceleration that it gives."""
    keep = np.array(flight.time_s) >= after_s
    tilt: FloatArray = np.degrees(np.array(flight.acceleration_m_s2)[keep, :2] / GRAVITY_M_S2)
    return tilt


def _sway_deg(flight: ControlFlight) -> float:
    """Greatest standard deviation of the tilt in the last five seconds."""
    return float(_tilt_deg(flight, 8.0).std(axis=0).max())


@pytest.mark.parametrize("kind", ["velocity", "attitude"])
@pytest.mark.parametrize("pad", [still, line])
@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
def test_holds_level_and_still_over_a_pad_that_does_not_turn(
    autopilot_kind: str, pad: PadMotion, kind: str
) -> None:
    flight = _fly(SwayingAutopilot(*AUTOPILOT_KINDS[autopilot_kind]), pad, kind=kind, noise=1.0)
    tilt = _tilt_deg(flight, 4.0)
    rates = np.radians(np.diff(tilt, axis=0)) * 30.0
    assert tilt.std(axis=0).max() < 1.0
    assert np.sqrt((rates**2).mean(axis=0)).max() < 0.1


@pytest.mark.parametrize("kind", ["velocity", "attitude"])
@pytest.mark.parametrize(
    ("link_s", "slowness"), [(0.0, 1.0), (0.03, 1.0), (0.07, 1.0), (0.03, 0.6), (0.03, 1.4)]
)
def test_a_kick_dies_out_whatever_the_delay_and_the_lag(kind: str, link_s: float, slowness: float) -> None:
    flight = _fly(SwayingAutopilot(slowness=slowness), offset=_nudged, kind=kind, link_s=link_s)
    assert np.abs(_tilt_deg(flight, 3.0)).max() > 1.0  # it was kicked
    assert _sway_deg(flight) < 0.2


@pytest.mark.parametrize("gain_1_s", [1.5, 2.5, 4.0])
@pytest.mark.parametrize("link_s", [0.0, 0.05])
def test_a_kick_dies_out_whatever_the_autopilots_velocity_gain(gain_1_s: float, link_s: float) -> None:
    autopilot = SwayingAutopilot(gain=(gain_1_s, gain_1_s, 2.0 * gain_1_s))
    assert _sway_deg(_fly(autopilot, offset=_nudged, link_s=link_s)) < 0.2


@pytest.mark.parametrize(("pad", "bound_m"), [(circle, 0.04), (figure_eight, 0.06)])
def test_a_turning_pad_is_followed_within_a_few_centimetres(pad: PadMotion, bound_m: float) -> None:
    flight = _fly(SwayingAutopilot(), pad, noise=1.0)
    assert flight.lateral_error_m(5.0) < bound_m


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
@pytest.mark.parametrize("kind", ["velocity", "attitude"])
def test_a_heaving_pad_is_followed_in_height_and_speed(autopilot_kind: str, kind: str) -> None:
    flight = _fly(SwayingAutopilot(*AUTOPILOT_KINDS[autopilot_kind]), _heave, kind=kind)
    speed = np.array(flight.relative_velocity_m_s)[np.array(flight.time_s) >= 5.0, 2]
    assert np.abs(flight.error_m(5.0)[:, 2]).max() < 0.03
    assert np.abs(speed).max() < 0.08


def test_an_attitude_loop_slower_than_the_models_is_not_taken_for_wind() -> None:
    """The tilt itself tells of wind; what lies between command and tilt is hardly believed."""
    flight = _fly(SwayingAutopilot(slowness=1.4), offset=_nudged, kind="attitude")
    push = np.array([report.disturbance_ned_m_s2[0] for report in flight.reports])
    kicked = np.array(flight.time_s) >= 1.0  # it is seen coming
    assert np.abs(_tilt_deg(flight, 1.0)).max() > 1.5
    assert np.abs(push[kicked] - push[kicked][0]).max() < 0.25


# ---------------- The pad's path over the horizon

TIMES_S = np.linspace(0.0, 2.0, 21)


def _pad(velocity: Vector3, acceleration: Vector3, time_s: float = 0.0) -> PadState:
    down = (0.0, 0.0, 2.0)
    return PadState(
        time_s, down, (0.0, 0.0, 0.0), velocity, acceleration, 0.0, 0.0, 0.01, 0.02, seen_time_s=time_s
    )


@pytest.mark.parametrize("motion", [still, line, circle])
@pytest.mark.parametrize("at_s", [0.0, 3.7, 11.0])
def test_follows_a_pad_that_stands_goes_straight_or_turns(motion: PadMotion, at_s: float) -> None:
    place, velocity, acceleration = motion(at_s)
    path = predict_pad(_pad(velocity, acceleration, at_s), at_s + TIMES_S)
    truth = [motion(at_s + t) for t in TIMES_S]
    np.testing.assert_allclose(path.displacement_m, np.array([m[0] for m in truth]) - place, atol=1e-9)
    np.testing.assert_allclose(path.velocity_m_s, np.array([m[1] for m in truth]), atol=1e-9)
    np.testing.assert_allclose(path.acceleration_m_s2, np.array([m[2] for m in truth]), atol=1e-9)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0])
def test_turning_left_and_right_at_every_course(yaw_deg: float) -> None:
    velocity = rotate_yaw((1.5, 0.0, 0.0), math.radians(yaw_deg))
    right = rotate_yaw((0.0, 0.45, 0.0), math.radians(yaw_deg))
    assert turn_rate(velocity, right) == pytest.approx(0.3)
    assert turn_rate(velocity, (-right[0], -right[1], 0.0)) == pytest.approx(-0.3)


def test_a_bend_that_begins_is_carried_on_by_the_jerk_and_a_halt_is_not_driven_on() -> None:
    plain, bending = (
        _pad((2.0, 0.0, 0.0), ZERO3),
        replace(_pad((2.0, 0.0, 0.0), ZERO3), jerk_ned_m_s3=(0.0, 0.8, 0.0)),
    )
    soon = np.array([0.2])
    assert predict_pad(plain, soon).acceleration_m_s2[0] == pytest.approx(ZERO3)
    assert predict_pad(bending, soon).acceleration_m_s2[0] == pytest.approx((0.0, 0.145, 0.0), abs=1e-3)
    braking = replace(_pad((0.5, 0.0, 0.0), (-2.0, 0.0, 0.0)), jerk_ned_m_s3=(-3.0, 0.0, 0.0))
    assert predict_pad(braking, TIMES_S).velocity_m_s[-1] == pytest.approx(ZERO3)


def test_turn_rate_needs_speed_and_a_sensible_value() -> None:
    assert turn_rate((0.2, 0.0, 0.0), (0.0, 0.5, 0.0)) is None
    assert turn_rate((1.0, 0.0, 0.0), (0.5, 0.0, 0.0)) is None
    assert turn_rate((0.5, 0.0, 0.0), (0.0, 5.0, 0.0)) is None


@pytest.mark.parametrize("jerk", [(0.0, 0.0, 0.0), (-0.2, 0.5, 0.0)])
@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.2), (1.5, 0.0, 0.2)])
def test_rows_are_consistent_derivatives_and_unturned_acceleration_dies_away(
    velocity: Vector3, jerk: Vector3
) -> None:
    fine = np.linspace(0.0, 2.0, 2001)
    path = predict_pad(replace(_pad(velocity, (0.3, 0.4, -0.5)), jerk_ned_m_s3=jerk), fine)
    dt = fine[1]
    np.testing.assert_allclose(
        np.gradient(path.displacement_m, dt, axis=0)[1:-1], path.velocity_m_s[1:-1], atol=1e-5
    )
    np.testing.assert_allclose(
        np.gradient(path.velocity_m_s, dt, axis=0)[1:-1], path.acceleration_m_s2[1:-1], atol=1e-5
    )
    np.testing.assert_allclose(path.acceleration_m_s2[0], (0.3, 0.4, -0.5))
    assert path.acceleration_m_s2[-1, 2] == pytest.approx(-0.5 * math.exp(-2.0))


def test_an_origin_at_rest_stays() -> None:
    path = origin_at_rest(5)
    assert path.displacement_m.shape == path.velocity_m_s.shape == path.acceleration_m_s2.shape == (5, 3)
    assert not path.displacement_m.any()


def test_a_pad_that_brakes_halts_and_does_not_drive_backwards() -> None:
    fine = np.linspace(0.0, 2.0, 401)
    path = predict_pad(_pad((1.0, 0.0, 0.0), (-3.0, 0.0, 0.0)), fine)
    assert path.velocity_m_s[:, 0].min() >= 0.0
    assert path.velocity_m_s[-1, 0] == path.acceleration_m_s2[-1, 0] == 0.0
    # 1 - 3 (1 - exp(-t)) = 0 at t = ln 1.5; there 1 t - 3 (t - 1 / 3) = 1 - 2 ln 1.5
    assert path.displacement_m[-1, 0] == pytest.approx(1.0 - 2.0 * math.log(1.5))


@pytest.mark.parametrize("course_deg", [0.0, 70.0, 200.0, 310.0])
@pytest.mark.parametrize("across_m_s2", [0.0, 0.05, 0.4, -0.9])
@pytest.mark.parametrize("speed_m_s", [0.15, 0.6, 2.0])
def test_the_speed_along_the_course_never_turns_round_and_the_rows_stay_derivatives(
    course_deg: float, across_m_s2: float, speed_m_s: float
) -> None:
    yaw = math.radians(course_deg)
    velocity = rotate_yaw((speed_m_s, 0.0, 0.0), yaw)
    braking = rotate_yaw((-3.0, across_m_s2, 0.0), yaw)
    fine = np.linspace(0.0, 2.0, 4001)
    path = predict_pad(_pad(velocity, braking), fine)
    # along the course at the time: in a turn the course turns with the pad
    omega = turn_rate(velocity, braking) or 0.0
    along = [
        v @ np.array(rotate_yaw((1.0, 0.0, 0.0), yaw + omega * t))
        for t, v in zip(fine, path.velocity_m_s, strict=True)
    ]
    assert min(along) >= -1e-12
    smooth = np.abs(np.gradient(path.acceleration_m_s2, fine, axis=0)).max(axis=1) < 20.0  # not at the halt
    speeds = np.gradient(path.displacement_m, fine, axis=0)
    np.testing.assert_allclose(speeds[1:-1], path.velocity_m_s[1:-1], atol=2e-3)
    changes = np.gradient(path.velocity_m_s, fine, axis=0)
    np.testing.assert_allclose(changes[smooth][1:-1], path.acceleration_m_s2[smooth][1:-1], atol=5e-3)


def test_a_pad_that_gently_slows_down_as_before_never_halts() -> None:
    path = predict_pad(_pad((1.5, 0.0, 0.0), (-0.5, 0.0, 0.0)), TIMES_S)
    np.testing.assert_allclose(path.velocity_m_s[:, 0], 1.5 - 0.5 * (1.0 - np.exp(-TIMES_S)))
