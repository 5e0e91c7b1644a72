"""The vehicle is level when its feet touch: the bound goes from the plan through the target into the MPC."""

import math

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.base.messages import LevelOff, Reference
from companion.base.motion import Motion
from companion.config import ControlConfig
from companion.control.mpc.mpc import Mpc
from companion.control.mpc.target import make_target
from companion.control.pad_prediction import origin_at_rest
from companion.control.tracking import Target

CONFIG = ControlConfig()
N, DT = CONFIG.horizon_steps, CONFIG.step_s
LEVEL_M_S2 = GRAVITY_M_S2 * math.tan(math.radians(6.0))


def turning(horizontal_bound_m_s2: FloatArray | None) -> Target:
    """A pad that accelerates eastwards at 2 m/s2, flown along with."""
    t = DT * np.arange(N + 1)[:, None]
    push = np.array([0.0, 2.0, 0.0])
    return Target(
        0.5 * push * t * t, push * t, np.tile(push, (N + 1, 1)), horizontal_bound_m_s2=horizontal_bound_m_s2
    )


def window(first: int, last: int) -> FloatArray:
    bound = np.full(N, np.inf)
    bound[first:last] = LEVEL_M_S2
    return bound


def sideways(mpc: Mpc, target: Target) -> FloatArray:
    solution = mpc.solve(
        Motion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)), target, (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)
    )
    assert solution.solved
    return np.hypot(solution.inputs_m_s2[:, 0], solution.inputs_m_s2[:, 1])


def test_the_reference_tells_the_steps_within_the_time() -> None:
    still = np.zeros((2, 3))
    reference = Reference(
        5.0, "pad", 0.1, still, still, still, 0.0, level_off=LevelOff(5.3, 5.6, math.radians(6.0))
    )
    target = make_target(reference, 5.0 + 0.1 * np.arange(11, dtype=np.float64), origin_at_rest(11))
    assert target.horizontal_bound_m_s2 is not None
    level = np.flatnonzero(np.isfinite(target.horizontal_bound_m_s2)).tolist()
    assert level == [3, 4, 5]
    assert target.horizontal_bound_m_s2[3] == pytest.approx(LEVEL_M_S2)


def test_it_levels_off_in_time_and_tilts_again_afterwards() -> None:
    mpc = Mpc(CONFIG, (0.11, 0.11, 0.04))
    free = sideways(mpc, turning(None))
    assert free.min() > 1.5
    levelled = sideways(mpc, turning(window(5, 9)))
    assert levelled[5:9].max() <= LEVEL_M_S2 + 0.02
    assert levelled[12] > 1.5
    for _ in range(5):  # from a solution so different the first ones are as exact as they need to be
        again = sideways(mpc, turning(None))
    np.testing.assert_allclose(again, free, atol=0.05)


def test_a_bound_that_comes_at_once_is_met_as_fast_as_the_command_may_change() -> None:
    levelled = sideways(Mpc(CONFIG, (0.11, 0.11, 0.04)), turning(window(0, 6)))
    assert levelled[0] < 2.0
    assert levelled[3:6].max() <= LEVEL_M_S2 + 0.02
