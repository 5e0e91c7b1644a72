import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.motion import Motion
from companion.plan.trajectory.min_jerk import plan, quintic

place = st.floats(-50.0, 50.0)
speed = st.floats(-5.0, 5.0)
push = st.floats(-3.0, 3.0)
axis = st.tuples(place, speed, push)
duration = st.floats(0.3, 20.0)


def derivatives(c: tuple[float, ...], tau: float, t: float) -> tuple[float, float, float]:
    x = sum(k * tau**n for n, k in enumerate(c))
    v = sum(n * k * tau ** (n - 1) for n, k in enumerate(c) if n > 0) / t
    a = sum(n * (n - 1) * k * tau ** (n - 2) for n, k in enumerate(c) if n > 1) / (t * t)
    return x, v, a


@settings(max_examples=60, deadline=None)
@given(start=axis, final=axis, t=duration)
def test_every_quintic_meets_both_its_ends(
    start: tuple[float, float, float], final: tuple[float, float, float], t: float
) -> None:
    c = quintic(start, final, t)
    assert derivatives(c, 0.0, t) == pytest.approx(start, abs=1e-8)
    assert derivatives(c, 1.0, t) == pytest.approx(final, rel=1e-6, abs=1e-5)


@settings(max_examples=40, deadline=None)
@given(start=axis, final=place, t=duration, share=st.floats(0.05, 0.9))
def test_replanning_midway_with_the_time_left_gives_the_same_way(
    start: tuple[float, float, float], final: float, t: float, share: float
) -> None:
    # Bellman: the rest of an optimal way is the optimal way of the rest
    first = plan(
        Motion((start[0], 0.0, 0.0), (start[1], 0.0, 0.0), (start[2], 0.0, 0.0)),
        Motion((final, 0.0, 0.0)),
        0.0,
        t,
    )
    now = share * t
    second = plan(first.at(now), Motion((final, 0.0, 0.0)), now, t - now)
    for later in (now + 0.3 * (t - now), now + 0.8 * (t - now)):
        assert second.at(later).position_m[0] == pytest.approx(
            first.at(later).position_m[0], rel=1e-6, abs=1e-6
        )


@settings(max_examples=40, deadline=None)
@given(start=axis, shift=place, t=duration, drift=speed)
def test_a_steady_motion_of_the_frame_only_adds_itself(
    start: tuple[float, float, float], shift: float, t: float, drift: float
) -> None:
    # so that planning in the pad's moving frame is planning, whatever the pad's velocity
    at_rest = quintic(start, (0.0, 0.0, 0.0), t)
    moving = quintic((start[0] + shift, start[1] + drift, start[2]), (shift + drift * t, drift, 0.0), t)
    for tau in (0.2, 0.5, 0.9):
        expected = derivatives(at_rest, tau, t)[0] + shift + drift * tau * t
        assert derivatives(moving, tau, t)[0] == pytest.approx(expected, rel=1e-7, abs=1e-6)
        assert math.isfinite(expected)
