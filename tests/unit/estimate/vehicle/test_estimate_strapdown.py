"""Samples summed up to one step: against a fine reference where sums of samples err (coning, sculling)."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from companion.base.geometry import (
    IDENTITY,
    Quaternion,
    Vector3,
    add,
    norm,
    quat_integrate,
    quat_rotate,
    scale,
    subtract,
    vector3,
)
from companion.estimate.vehicle.strapdown import Increment, Strapdown
from tests.attitudes import between_rad

Signal = Callable[[float], Vector3]

SAMPLE_S = 0.002
SAMPLES = 10  # of a step
STEP_S = SAMPLE_S * SAMPLES
FINE = 40  # reference steps to a sample


def coning(t: float) -> Vector3:
    """Roll and pitch a quarter of a period apart: the axis goes round a cone at 25 Hz."""
    return (4.0 * math.cos(157.0 * t), 4.0 * math.sin(157.0 * t), 0.0)


def sculling_force(t: float) -> Vector3:
    """To and fro with the roll, as a vibrating mount does."""
    return (0.0, 20.0 * math.sin(157.0 * t), -9.8)


def rolling(t: float) -> Vector3:
    return (6.0 * math.cos(157.0 * t), 0.0, 0.0)


def steady(t: float) -> Vector3:
    return (2.0, -1.0, 3.0)


def rest(t: float) -> Vector3:
    return (0.0, 0.0, -9.8)


def reference(rate: Signal, force: Signal, seconds: float) -> tuple[Quaternion, Vector3]:
    """Turn and change of velocity in the axes of the start, by many small steps."""
    q, push, n = IDENTITY, (0.0, 0.0, 0.0), round(seconds / SAMPLE_S) * FINE
    dt = seconds / n
    for k in range(n):
        middle_s = (k + 0.5) * dt
        push = add(push, scale(quat_rotate(quat_integrate(q, rate(middle_s), 0.5 * dt), force(middle_s)), dt))
        q = quat_integrate(q, rate(middle_s), dt)
    return q, push


def increments(rate: Signal, force: Signal, seconds: float) -> list[Increment]:
    """The trapezoid's means of samples, taken every SAMPLES."""
    strapdown, taken = Strapdown(), []
    for k in range(1, round(seconds / SAMPLE_S) + 1):
        before, now = (k - 1) * SAMPLE_S, k * SAMPLE_S
        strapdown.add(
            SAMPLE_S, scale(add(rate(before), rate(now)), 0.5), scale(add(force(before), force(now)), 0.5)
        )
        if k % SAMPLES == 0:
            taken.append(strapdown.take())
    return taken


def plain_means(rate: Signal, force: Signal, seconds: float) -> list[Increment]:
    """The same without compensation."""
    taken = []
    for j in range(round(seconds / STEP_S)):
        times = [j * STEP_S + k * SAMPLE_S for k in range(SAMPLES + 1)]
        weights = [0.5, *[1.0] * (SAMPLES - 1), 0.5]
        means = [vector3(np.average([f(t) for t in times], axis=0, weights=weights)) for f in (rate, force)]
        taken.append(Increment(STEP_S, SAMPLES, means[0], means[1]))
    return taken


def integrated(steps: list[Increment]) -> tuple[Quaternion, Vector3]:
    """What a filter makes of them: the force acts in the axes of the middle of each step."""
    q, push = IDENTITY, (0.0, 0.0, 0.0)
    for step in steps:
        middle = quat_integrate(q, step.rate_body_rad_s, 0.5 * step.span_s)
        push = add(push, scale(quat_rotate(middle, step.specific_force_body_m_s2), step.span_s))
        q = quat_integrate(q, step.rate_body_rad_s, step.span_s)
    return q, push


def test_coning_is_compensated_twenty_times_better_than_by_a_mean() -> None:
    truth, _ = reference(coning, rest, 1.0)
    compensated, _ = integrated(increments(coning, rest, 1.0))
    averaged, _ = integrated(plain_means(coning, rest, 1.0))
    assert between_rad(averaged, truth) > 0.02, "the motion would not tell"
    assert between_rad(compensated, truth) < between_rad(averaged, truth) / 20.0


def test_sculling_is_compensated_twenty_times_better_than_by_a_mean() -> None:
    _, truth = reference(rolling, sculling_force, 1.0)
    _, compensated = integrated(increments(rolling, sculling_force, 1.0))
    _, averaged = integrated(plain_means(rolling, sculling_force, 1.0))
    assert norm(subtract(averaged, truth)) > 0.1, "the motion would not tell"
    assert norm(subtract(compensated, truth)) < norm(subtract(averaged, truth)) / 20.0


def test_constant_rate_is_returned_as_it_is() -> None:
    for step in increments(steady, rest, 0.1):
        assert step.rate_body_rad_s == pytest.approx(steady(0.0), abs=1e-12)
        assert step.span_s == pytest.approx(STEP_S)
        assert step.samples == SAMPLES


def test_constant_force_without_turning_is_returned_as_it_is() -> None:
    for step in increments(lambda t: (0.0, 0.0, 0.0), lambda t: (1.0, -2.0, -9.0), 0.1):
        assert step.specific_force_body_m_s2 == pytest.approx((1.0, -2.0, -9.0), abs=1e-12)
        assert step.rate_body_rad_s == pytest.approx((0.0, 0.0, 0.0), abs=1e-15)


def test_accelerating_in_a_steady_turn_agrees_with_the_reference() -> None:
    def force(t: float) -> Vector3:
        return (1.0 + 5.0 * t, -2.0, -9.8)

    turn, push = reference(steady, force, 0.5)
    q, compensated = integrated(increments(steady, force, 0.5))
    assert between_rad(q, turn) < 1e-9
    assert compensated == pytest.approx(push, abs=1e-3)


def test_a_gap_counts_with_its_length() -> None:
    strapdown = Strapdown()
    for dt_s in (0.005, 0.1, 0.005):
        strapdown.add(dt_s, (0.0, 0.0, 2.0), (0.0, 0.0, -9.8))
    step = strapdown.take()
    assert step.span_s == pytest.approx(0.11)
    assert step.samples == 3
    assert step.rate_body_rad_s == pytest.approx((0.0, 0.0, 2.0))
    assert step.specific_force_body_m_s2 == pytest.approx((0.0, 0.0, -9.8))


def test_samples_weigh_by_the_time_they_stand_for() -> None:
    strapdown = Strapdown()
    strapdown.add(0.03, (0.4, 0.0, 0.0), (0.0, 0.0, -8.0))
    strapdown.add(0.01, (0.0, 0.0, 0.0), (0.0, 0.0, -12.0))
    step = strapdown.take()
    assert step.rate_body_rad_s == pytest.approx((0.3, 0.0, 0.0))
    assert step.specific_force_body_m_s2[2] == pytest.approx(-9.0, abs=0.01)


def test_taking_begins_anew() -> None:
    strapdown = Strapdown()
    strapdown.add(0.01, (3.0, 1.0, 0.0), (5.0, 0.0, -9.8))
    strapdown.take()
    assert strapdown.samples == 0
    with pytest.raises(ZeroDivisionError):
        strapdown.take()
    strapdown.add(0.01, (0.0, 0.0, 1.0), (0.0, 0.0, -9.8))
    step = strapdown.take()
    assert (step.span_s, step.samples) == (0.01, 1)
    assert step.rate_body_rad_s == pytest.approx((0.0, 0.0, 1.0))
