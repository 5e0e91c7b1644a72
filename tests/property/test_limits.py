"""Whatever goes into the last gate, what leaves is within every bound."""

import math

from hypothesis import example, given, settings
from hypothesis import strategies as st

from companion.base.geometry import (
    GRAVITY_M_S2,
    Vector3,
    horizontal_acceleration,
    norm,
    subtract,
    tilt_from_quat,
)
from companion.base.messages import Setpoint
from companion.config import LimitsConfig
from companion.control.limits import LONGEST_STEP_S, LimitsGate

CONFIG = LimitsConfig()
HOVER_THRUST = 0.5
TOLERANCE = 1e-6

anything = st.floats(width=64)


def _near(*bounds: float) -> st.SearchStrategy[float]:
    """Numbers densely on both sides of each bound, and anything at all."""
    close = [
        st.floats(sign * bound * (1 - 1e-3), sign * bound * (1 + 1e-3))
        if sign > 0
        else st.floats(-bound * (1 + 1e-3), -bound * (1 - 1e-3))
        for bound in bounds
        for sign in (1.0, -1.0)
    ]
    return st.one_of(*close, st.floats(-2.0 * max(bounds), 2.0 * max(bounds)), anything)


velocities = st.tuples(_near(6.0, 4.24264), _near(6.0, 4.24264), _near(1.5))
accelerations = st.tuples(_near(5.5, 3.88909), _near(5.5, 3.88909), _near(3.0))
thrusts = _near(0.05, 0.9)
attitudes = st.tuples(*[st.one_of(st.floats(-1.0, 1.0), anything)] * 4)


@st.composite
def setpoints(draw: st.DrawFn) -> Setpoint:
    """A setpoint of either kind, sane or not."""
    by_attitude = draw(st.booleans())
    return Setpoint(
        time_s=draw(anything),
        velocity_ned_m_s=draw(velocities),
        acceleration_ned_m_s2=draw(accelerations),
        heading_rad=draw(_near(math.pi)),
        heading_rate_rad_s=draw(_near(math.radians(45.0))),
        attitude=draw(attitudes) if by_attitude else None,
        thrust=draw(thrusts) if by_attitude else None,
        holds_horizontal_velocity=draw(st.booleans()),
    )


steps = st.lists(st.tuples(setpoints(), st.floats(-0.1, 0.5)), min_size=1, max_size=6)


def _assert_sizes(setpoint: Setpoint) -> None:
    v, a = setpoint.velocity_ned_m_s, setpoint.acceleration_ned_m_s2
    assert math.hypot(v[0], v[1]) <= CONFIG.horizontal_speed_m_s + TOLERANCE
    assert -CONFIG.climb_speed_m_s - TOLERANCE <= v[2] <= CONFIG.descent_speed_m_s + TOLERANCE
    assert math.hypot(a[0], a[1]) <= CONFIG.horizontal_acceleration_m_s2 + TOLERANCE
    assert abs(a[2]) <= CONFIG.vertical_acceleration_m_s2 + TOLERANCE
    assert abs(setpoint.heading_rate_rad_s) <= math.radians(CONFIG.heading_rate_deg_s) + TOLERANCE
    assert -math.pi <= setpoint.heading_rad <= math.pi
    if setpoint.attitude is not None:
        assert tilt_from_quat(setpoint.attitude) <= math.radians(CONFIG.tilt_deg) + TOLERANCE
    if setpoint.thrust is not None:
        assert CONFIG.minimum_thrust - TOLERANCE <= setpoint.thrust <= CONFIG.maximum_thrust + TOLERANCE


def _numbers(setpoint: Setpoint) -> tuple[object, ...]:
    """What the gate hands on as it is, unless it names a bound: an attitude it builds anew."""
    return (
        setpoint.velocity_ned_m_s,
        setpoint.acceleration_ned_m_s2,
        setpoint.heading_rate_rad_s,
        setpoint.thrust,
        setpoint.holds_horizontal_velocity,
    )


def _tilt(setpoint: Setpoint) -> Vector3 | None:
    return (*horizontal_acceleration(setpoint.attitude), 0.0) if setpoint.attitude is not None else None


def _assert_change(before: Setpoint, after: Setpoint) -> None:
    elapsed_s = min(after.time_s - before.time_s, LONGEST_STEP_S)
    assert elapsed_s >= 0.0
    most = CONFIG.jerk_m_s3 * elapsed_s + TOLERANCE
    assert norm(subtract(after.acceleration_ned_m_s2, before.acceleration_ned_m_s2)) <= most
    first, second = _tilt(before), _tilt(after)
    if first is not None and second is not None:
        assert norm(subtract(second, first)) <= most
    turned = abs(math.remainder(after.heading_rad - before.heading_rad, math.tau))
    assert turned <= math.radians(CONFIG.heading_rate_deg_s) * elapsed_s + TOLERANCE


@settings(max_examples=200, deadline=None)
@given(steps)
def test_every_setpoint_that_leaves_is_within_all_bounds(sequence: list[tuple[Setpoint, float]]) -> None:
    gate, now_s, last = LimitsGate(CONFIG), 100.0, None
    for setpoint, elapsed_s in sequence:
        now_s += elapsed_s
        limited, broken = gate.apply(setpoint, now_s)
        _assert_sizes(limited)
        if last is not None:
            _assert_change(last, limited)
        if not broken:
            assert _numbers(limited) == _numbers(setpoint)
        last = limited


@settings(max_examples=100, deadline=None)
@given(setpoints())
def test_what_has_passed_the_gate_passes_another_unchanged(setpoint: Setpoint) -> None:
    once, _ = LimitsGate(CONFIG).apply(setpoint, 1.0)
    twice, broken = LimitsGate(CONFIG).apply(once, 1.0)
    assert broken == ()
    assert twice.velocity_ned_m_s == once.velocity_ned_m_s
    assert twice.acceleration_ned_m_s2 == once.acceleration_ned_m_s2
    assert twice.holds_horizontal_velocity == once.holds_horizontal_velocity


inside = st.floats(-0.999, 0.999)


@settings(max_examples=100, deadline=None)
@given(st.tuples(inside, inside), inside, st.tuples(inside, inside), inside, st.floats(-3.1, 3.1))
@example((0.7, 0.7), 0.999, (0.7, 0.7), -0.999, 0.0)
def test_a_sane_first_setpoint_is_not_touched(
    v: tuple[float, float], vz: float, a: tuple[float, float], az: float, heading_rad: float
) -> None:
    inscribed = 1.0 / math.sqrt(2.0)
    velocity = (6.0 * inscribed * v[0], 6.0 * inscribed * v[1], 1.5 * vz)
    acceleration = (5.5 * inscribed * a[0], 5.5 * inscribed * a[1], 3.0 * az)
    wanted = Setpoint(1.0, velocity, acceleration, heading_rad)
    limited, broken = LimitsGate(CONFIG).apply(wanted, 1.0)
    assert broken == ()
    assert limited.velocity_ned_m_s == velocity
    assert limited.acceleration_ned_m_s2 == acceleration
    assert math.remainder(limited.heading_rad - heading_rad, math.tau) == 0.0


def test_the_bounds_of_this_file_are_the_settings_own() -> None:
    assert (CONFIG.horizontal_speed_m_s, CONFIG.climb_speed_m_s, CONFIG.descent_speed_m_s) == (6.0, 1.5, 1.5)
    assert (CONFIG.horizontal_acceleration_m_s2, CONFIG.vertical_acceleration_m_s2) == (5.5, 3.0)
    assert (CONFIG.minimum_thrust, CONFIG.maximum_thrust, CONFIG.heading_rate_deg_s) == (0.05, 1.0, 90.0)
    assert GRAVITY_M_S2 * math.tan(math.radians(CONFIG.tilt_deg)) > CONFIG.horizontal_acceleration_m_s2
