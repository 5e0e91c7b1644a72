"""The magnetometer's delay, learnt from turns."""

import math

import numpy as np
import pytest

from companion.base.geometry import IDENTITY, ZERO3, Vector3, quat_integrate, quat_rotate_inverse, vector3
from companion.config import EkfConfig
from companion.estimate.vehicle.field_mean import DELAY_STD_S, FieldMean

FIELD: Vector3 = (18.0, 3.0, 42.0)
STEP_S = 0.01


def turned(delay_s: float, seconds: float, swing_rad_s: float, seed: int) -> FieldMean:
    """Samples every 10 ms, late by delay_s, of a body that turns this way and that; taken at 10 Hz."""
    rng, mean, attitude = np.random.default_rng(seed), FieldMean(EkfConfig()), IDENTITY
    for k in range(1, round(seconds / STEP_S)):
        t = k * STEP_S
        rate = (swing_rad_s * math.sin(3.0 * t), swing_rad_s * math.cos(2.0 * t), 0.6 * swing_rad_s)
        attitude = quat_integrate(attitude, rate, STEP_S)
        then = quat_integrate(attitude, rate, -delay_s)
        late = vector3(np.array(quat_rotate_inverse(then, FIELD)) + 0.5 * rng.normal(size=3))
        mean.add(attitude, mean.on_time(late, rate), rate)
        if k % 10 == 0:
            mean.take(0.1)
    return mean


@pytest.mark.parametrize("delay_s", [-0.005, 0.0, 0.013, 0.06])
def test_turns_show_by_how_much_the_field_is_late(delay_s: float) -> None:
    mean = turned(delay_s, 20.0, 3.0, seed=0)
    assert mean.delay_std_s < 0.004
    assert abs(mean.delay_s - delay_s) < 3.0 * mean.delay_std_s


def test_a_field_that_was_late_is_put_right() -> None:
    mean, rate = turned(0.03, 20.0, 3.0, seed=1), (0.0, 0.0, 3.0)
    late = quat_rotate_inverse(quat_integrate(IDENTITY, rate, -0.03), FIELD)
    assert late != pytest.approx(FIELD, abs=1.0)
    assert mean.on_time(late, rate) == pytest.approx(FIELD, abs=0.3)


def test_without_turns_nothing_is_learnt() -> None:
    mean = turned(0.03, 20.0, 0.0, seed=2)
    assert mean.delay_s == 0.0
    assert mean.delay_std_s == pytest.approx(DELAY_STD_S)


def test_another_attitude_is_no_turn() -> None:
    mean = turned(0.013, 20.0, 3.0, seed=3)
    learnt = mean.delay_s
    mean.start_over()
    assert mean.count == 0
    mean.add(quat_integrate(IDENTITY, (0.0, 0.0, 1.0), 1.0), FIELD, ZERO3)
    mean.take(0.1)
    assert mean.delay_s == learnt
