"""The last gate, each bound on both sides."""

import math
from collections.abc import Callable

import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    Vector3,
    quat_from_euler,
    tilt_from_quat,
    yaw_from_quat,
)
from companion.base.messages import Setpoint
from companion.config import LimitsConfig
from companion.control.attitude import attitude_from_acceleration
from companion.control.limits import LONGEST_STEP_S, LimitsGate

CONFIG = LimitsConfig()
INSIDE, OUTSIDE = 1.0 - 1e-6, 1.0 + 1e-6


def _gate(config: LimitsConfig = CONFIG) -> LimitsGate:
    return LimitsGate(config)


def _velocity(x: float, y: float, z: float) -> Setpoint:
    return Setpoint(0.0, velocity_ned_m_s=(x, y, z))


def _acceleration(x: float, y: float, z: float) -> Setpoint:
    return Setpoint(0.0, acceleration_ned_m_s2=(x, y, z))


def _tilt(tilt_rad: float, direction_rad: float = 0.0) -> Setpoint:
    pull = GRAVITY_M_S2 * math.tan(tilt_rad)
    tilt = (pull * math.cos(direction_rad), pull * math.sin(direction_rad), 0.0)
    return Setpoint(0.0, attitude=attitude_from_acceleration(tilt, 0.3), heading_rad=0.3, thrust=0.5)


BOUNDS: list[tuple[str, Callable[[float], Setpoint]]] = [
    ("horizontal_speed", lambda k: _velocity(6.0 * k, 0.0, 0.0)),
    ("horizontal_speed", lambda k: _velocity(-3.6 * k, 4.8 * k, 0.0)),
    ("vertical_speed", lambda k: _velocity(0.0, 0.0, -1.5 * k)),
    ("vertical_speed", lambda k: _velocity(0.0, 0.0, 1.5 * k)),
    ("horizontal_acceleration", lambda k: _acceleration(0.0, -5.5 * k, 0.0)),
    ("horizontal_acceleration", lambda k: _acceleration(3.3 * k, 4.4 * k, 0.0)),
    ("vertical_acceleration", lambda k: _acceleration(0.0, 0.0, 3.0 * k)),
    ("vertical_acceleration", lambda k: _acceleration(0.0, 0.0, -3.0 * k)),
    ("heading_rate", lambda k: Setpoint(0.0, heading_rate_rad_s=math.radians(90.0) * k)),
    ("heading_rate", lambda k: Setpoint(0.0, heading_rate_rad_s=-math.radians(90.0) * k)),
    ("thrust", lambda k: Setpoint(0.0, attitude=IDENTITY, thrust=1.0 * k)),
    ("thrust", lambda k: Setpoint(0.0, attitude=IDENTITY, thrust=0.05 / k)),
    ("tilt", lambda k: _tilt(math.radians(30.0) * k)),
    ("tilt", lambda k: _tilt(math.radians(30.0) * k, 2.0)),
]


def test_what_presses_it_down_may_be_met_beyond_the_bound_on_vertical_acceleration() -> None:
    wanted = _acceleration(0.0, 0.0, -5.0)
    met, broken = _gate().apply(wanted, 0.0, pressed_m_s2=2.5)
    assert broken == ()
    assert met.acceleration_ned_m_s2 == wanted.acceleration_ned_m_s2
    cut, broken = _gate().apply(wanted, 0.0, pressed_m_s2=1.5)
    assert broken == ("vertical_acceleration",)
    assert cut.acceleration_ned_m_s2[2] == pytest.approx(-4.5)
    assert _gate().apply(_acceleration(0.0, 0.0, 5.0), 0.0, pressed_m_s2=2.5)[1] == ("vertical_acceleration",)


@pytest.mark.parametrize(("name", "make"), BOUNDS)
def test_just_inside_a_bound_nothing_changes(name: str, make: Callable[[float], Setpoint]) -> None:
    wanted = make(INSIDE)
    limited, broken = _gate().apply(wanted, 0.0)
    assert broken == ()
    assert limited.velocity_ned_m_s == wanted.velocity_ned_m_s
    assert limited.acceleration_ned_m_s2 == wanted.acceleration_ned_m_s2
    assert limited.thrust == wanted.thrust
    if wanted.attitude is not None:
        assert limited.attitude == pytest.approx(wanted.attitude, abs=1e-9)


@pytest.mark.parametrize(("name", "make"), BOUNDS)
@pytest.mark.parametrize("factor", [OUTSIDE, 1.5, 1e6])
def test_outside_a_bound_it_is_cut_back_to_it_and_named(
    name: str, make: Callable[[float], Setpoint], factor: float
) -> None:
    wanted = make(min(factor, 2.5) if name == "tilt" else factor)
    limited, broken = _gate().apply(wanted, 0.0)
    assert broken == (name,)
    edge, _ = _gate().apply(make(1.0), 0.0)
    assert limited.velocity_ned_m_s == pytest.approx(edge.velocity_ned_m_s, abs=1e-9)
    assert limited.acceleration_ned_m_s2 == pytest.approx(edge.acceleration_ned_m_s2, abs=1e-9)
    assert limited.heading_rate_rad_s == pytest.approx(edge.heading_rate_rad_s)
    assert limited.thrust == pytest.approx(edge.thrust)
    if limited.attitude is not None:
        assert limited.attitude == pytest.approx(edge.attitude, abs=1e-9)


def test_the_tilt_bounds_the_acceleration_that_needs_it() -> None:
    gate = _gate(LimitsConfig(tilt_deg=10.0))
    limited, broken = gate.apply(_acceleration(3.0, 0.0, 0.0), 0.0)
    assert broken == ("horizontal_acceleration",)
    assert limited.acceleration_ned_m_s2[0] == pytest.approx(GRAVITY_M_S2 * math.tan(math.radians(10.0)))


@pytest.mark.parametrize("factor", [0.5, INSIDE, OUTSIDE, 2.0])
def test_acceleration_changes_no_faster_than_the_jerk(factor: float) -> None:
    gate, step_s = _gate(), 0.05
    gate.apply(_acceleration(0.5, 0.0, 0.0), 1.0)
    wanted = (0.5 + 0.6 * factor, -0.8 * factor, 0.0)
    limited, broken = gate.apply(_acceleration(*wanted), 1.0 + step_s)
    if factor < 1.0:
        assert broken == ()
        assert limited.acceleration_ned_m_s2 == wanted
    else:
        assert broken == ("jerk",)
        assert limited.acceleration_ned_m_s2 == pytest.approx((1.1, -0.8, 0.0))


@pytest.mark.parametrize("factor", [INSIDE, OUTSIDE, 3.0])
def test_tilt_changes_no_faster_than_the_jerk(factor: float) -> None:
    gate, step_s = _gate(), 0.05
    gate.apply(_tilt(0.0), 1.0)
    limited, broken = gate.apply(_tilt(math.atan(factor * 20.0 * step_s / GRAVITY_M_S2), 1.0), 1.0 + step_s)
    assert broken == (() if factor < 1.0 else ("tilt_rate",))
    assert limited.attitude is not None
    assert tilt_from_quat(limited.attitude) == pytest.approx(
        math.atan(min(factor, 1.0) * 20.0 * step_s / GRAVITY_M_S2), rel=1e-5
    )
    assert yaw_from_quat(limited.attitude) == pytest.approx(0.3)


@pytest.mark.parametrize("turn_deg", [8.9999, 9.0001, 90.0, -8.9999, -9.0001, -90.0])
@pytest.mark.parametrize("start_deg", [0.0, 90.0, 178.0, -90.0])
def test_heading_turns_no_faster_than_allowed(turn_deg: float, start_deg: float) -> None:
    gate = _gate()
    gate.apply(Setpoint(0.0, heading_rad=math.radians(start_deg)), 1.0)
    limited, broken = gate.apply(Setpoint(0.0, heading_rad=math.radians(start_deg + turn_deg)), 1.1)
    turned = math.remainder(limited.heading_rad - math.radians(start_deg), math.tau)
    allowed = math.radians(max(-9.0, min(9.0, turn_deg)))
    assert turned == pytest.approx(allowed, abs=1e-9)
    assert broken == (("heading",) if abs(turn_deg) > 9.0 else ())


def test_a_limited_heading_is_the_attitudes_too() -> None:
    gate = _gate()
    gate.apply(_tilt(0.1), 0.0)
    turned = Setpoint(0.0, attitude=quat_from_euler(0.0, 0.0, 2.0), heading_rad=2.0, thrust=0.5)
    limited, broken = gate.apply(turned, 0.1)
    assert "heading" in broken
    assert limited.attitude is not None
    assert yaw_from_quat(limited.attitude) == pytest.approx(limited.heading_rad)


def test_a_long_pause_does_not_allow_a_long_jump() -> None:
    gate = _gate()
    gate.apply(_acceleration(-4.0, 0.0, 0.0), 0.0)
    limited, broken = gate.apply(_acceleration(4.0, 0.0, 0.0), 60.0)
    assert broken == ("jerk",)
    assert limited.acceleration_ned_m_s2[0] == pytest.approx(-4.0 + 20.0 * LONGEST_STEP_S)


def test_the_same_time_again_is_no_time_that_runs_backwards() -> None:
    gate = _gate()
    gate.apply(_acceleration(1.0, 0.0, 0.0), 10.0)
    assert gate.apply(_acceleration(1.0, 0.0, 0.0), 10.0)[1] == ()


@pytest.mark.parametrize("turn_deg", [4.0, -4.0])
def test_a_heading_turns_the_short_way_across_south(turn_deg: float) -> None:
    gate = _gate()
    start = math.copysign(math.radians(178.0), turn_deg)
    gate.apply(Setpoint(0.0, heading_rad=start), 1.0)
    wanted = math.remainder(start + math.radians(turn_deg), math.tau)
    limited, broken = gate.apply(Setpoint(0.0, heading_rad=wanted), 1.1)
    assert broken == ()
    assert limited.heading_rad == pytest.approx(wanted)


def test_an_attitude_after_setpoints_without_one_begins_anew() -> None:
    gate = _gate()
    gate.apply(_tilt(math.radians(-25.0)), 1.0)
    gate.apply(Setpoint(0.0, heading_rad=0.3), 1.03)
    wanted = _tilt(math.radians(25.0))
    limited, broken = gate.apply(wanted, 1.06)
    assert broken == ()
    assert limited.attitude == pytest.approx(wanted.attitude)


@pytest.mark.parametrize("size", [1e-4, 0.5, 1.0, 3.0])
def test_an_attitude_counts_by_its_direction(size: float) -> None:
    wanted = _tilt(math.radians(20.0), 1.0)
    assert wanted.attitude is not None
    w, x, y, z = (size * part for part in wanted.attitude)
    scaled = Setpoint(0.0, attitude=(w, x, y, z), heading_rad=0.3, thrust=0.5)
    limited, broken = _gate().apply(scaled, 0.0)
    assert broken == ()
    assert limited.attitude == pytest.approx(wanted.attitude, abs=1e-9)


def test_an_attitude_without_a_direction_is_none() -> None:
    none = Setpoint(0.0, attitude=(1e-7, 0.0, 0.0, 0.0), thrust=0.5)
    assert _gate().apply(none, 0.0)[1] == ("not_finite",)


BAD = [math.nan, math.inf, -math.inf]


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize(
    "field", ["velocity_ned_m_s", "acceleration_ned_m_s2", "heading_rad", "heading_rate_rad_s"]
)
def test_anything_not_finite_is_a_hold_at_the_last_heading(bad: float, field: str) -> None:
    gate = _gate()
    gate.apply(Setpoint(0.0, (1.0, 0.0, 0.0), (0.2, 0.0, 0.0), heading_rad=0.7), 1.0)
    value: float | Vector3 = bad if field.startswith("heading") else (0.0, bad, 0.0)
    limited, broken = gate.apply(Setpoint(time_s=1.1, **{field: value}), 1.1)  # type: ignore[arg-type]
    assert broken == ("not_finite",)
    assert limited.velocity_ned_m_s == limited.acceleration_ned_m_s2 == ZERO3
    assert limited.heading_rad == 0.7
    assert limited.heading_rate_rad_s == 0.0
    assert (limited.attitude, limited.thrust) == (None, None)


@pytest.mark.parametrize("bad", BAD)
def test_an_attitude_or_thrust_that_is_no_number_is_a_stop_by_the_autopilots_own_loops(bad: float) -> None:
    for setpoint in (
        Setpoint(0.0, attitude=(bad, 0.0, 0.0, 0.0), thrust=0.5, heading_rad=0.4),
        Setpoint(0.0, attitude=(0.0, 0.0, 0.0, 0.0), thrust=0.5, heading_rad=0.4),
        Setpoint(0.0, attitude=IDENTITY, thrust=bad, heading_rad=0.4),
    ):
        limited, broken = _gate().apply(setpoint, 0.0)
        assert broken == ("not_finite",)
        assert limited == Setpoint(0.0, heading_rad=0.4)  # level at hover thrust would keep speed and sink


def test_a_hold_slows_down_as_gently_as_anything_else() -> None:
    gate = _gate()
    gate.apply(_acceleration(4.0, 0.0, 0.0), 1.0)
    limited, broken = gate.apply(_velocity(math.nan, 0.0, 0.0), 1.05)
    assert broken == ("not_finite", "jerk")
    assert limited.acceleration_ned_m_s2 == pytest.approx((3.0, 0.0, 0.0))


def test_a_hold_before_anything_else_looks_north_when_no_heading_is_known() -> None:
    limited, _ = _gate().apply(Setpoint(0.0, heading_rad=math.nan), 0.0)
    assert limited.heading_rad == 0.0


@pytest.mark.parametrize("later_s", [-5.0, -1e-9, math.nan])
def test_time_never_runs_backwards(later_s: float) -> None:
    gate = _gate()
    gate.apply(_acceleration(1.0, 0.0, 0.0), 10.0)
    limited, broken = gate.apply(_acceleration(2.0, 0.0, 0.0), 10.0 + later_s)
    assert "time" in broken
    assert limited.time_s == 10.0
    assert limited.acceleration_ned_m_s2 == (1.0, 0.0, 0.0)


def test_a_first_time_that_is_no_number_is_taken_as_nought() -> None:
    assert _gate().apply(Setpoint(0.0), math.nan)[0].time_s == 0.0


def test_after_a_reset_bounds_on_change_begin_anew() -> None:
    gate = _gate()
    gate.apply(_acceleration(-3.0, 0.0, 0.0), 1.0)
    gate.reset()
    limited, broken = gate.apply(Setpoint(0.0, acceleration_ned_m_s2=(3.0, 0.0, 0.0), heading_rad=3.0), 1.01)
    assert broken == ()
    assert limited.acceleration_ned_m_s2 == (3.0, 0.0, 0.0)


def test_an_attitude_upside_down_is_brought_within_the_tilt() -> None:
    setpoint = Setpoint(0.0, attitude=quat_from_euler(3.0, 0.0, 0.0), thrust=0.5)
    limited, broken = _gate().apply(setpoint, 0.0)
    assert broken == ("tilt",)
    assert limited.attitude is not None
    assert tilt_from_quat(limited.attitude) == pytest.approx(math.radians(CONFIG.tilt_deg))


def test_the_exposure_time_goes_through() -> None:
    assert _gate().apply(Setpoint(0.0, exposure_time_s=0.93), 1.0)[0].exposure_time_s == 0.93


def test_on_the_ground_alone_the_thrust_may_go_to_nothing() -> None:
    none = Setpoint(0.0, attitude=IDENTITY, thrust=0.0)
    assert _gate().apply(none, 0.0, on_ground=True) == (none, ())
    lifted, broken = _gate().apply(none, 0.0)
    assert lifted.thrust == CONFIG.minimum_thrust
    assert broken == ("thrust",)
    full = Setpoint(0.0, attitude=IDENTITY, thrust=1.0)
    assert _gate().apply(full, 0.0, on_ground=True)[0].thrust == CONFIG.maximum_thrust
    pressed = Setpoint(0.0, acceleration_ned_m_s2=(0.0, 0.0, 12.0))
    limited, broken = _gate().apply(pressed, 0.0, on_ground=True)
    assert limited.acceleration_ned_m_s2 == (0.0, 0.0, GRAVITY_M_S2)
    assert broken == ("vertical_acceleration",)
    assert _gate().apply(pressed, 0.0)[0].acceleration_ned_m_s2[2] == CONFIG.vertical_acceleration_m_s2


@pytest.mark.parametrize(("speed_m_s", "sent"), [(5.99, False), (6.01, True)])
def test_a_velocity_that_only_predicts_is_sent_once_it_breaks_the_bound(speed_m_s: float, sent: bool) -> None:
    predicted = Setpoint(0.0, velocity_ned_m_s=(0.0, speed_m_s, 0.0), holds_horizontal_velocity=False)
    limited, _ = _gate().apply(predicted, 0.0)
    assert limited.holds_horizontal_velocity is sent
    assert limited.velocity_ned_m_s[1] <= 6.0
