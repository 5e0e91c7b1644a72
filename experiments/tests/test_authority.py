"""Which cycles the speed law decides, from ways whose end and time are known."""

import pytest

from companion.base.messages import Phase, PlanStep, Reference
from companion.base.motion import Motion
from companion.plan.trajectory.min_jerk import plan
from experiments.profiles import RuleAuthority, authority, way_to_go_m

START = Motion((3.0, -1.0, -6.0), (-0.4, 0.2, 0.5), (0.1, 0.3, -0.2))
END = Motion((0.0, 0.0, -0.6))
WAY_M = (3.0**2 + 1.0 + 5.4**2) ** 0.5
T_MIN_S = 1.0


def step(time_s: float, speed_m_s: float, phase: Phase = Phase.DESCEND) -> PlanStep:
    """A cycle that begins a way of so many seconds."""
    position, velocity, acceleration = plan(START, END, 0.0, time_s).rows(0.0, 21, 0.1)
    reference = Reference(0.0, "pad", 0.1, position, velocity, acceleration, 0.0)
    return PlanStep(0.0, phase, reference, speed_m_s=speed_m_s, time_to_go_s=time_s)


@pytest.mark.parametrize("time_s", [0.9, 2.0, 7.0, 20.0])
def test_the_way_follows_from_the_beginning_of_it(time_s: float) -> None:
    reference = step(time_s, 1.0).reference
    assert reference is not None
    assert way_to_go_m(reference, time_s) == pytest.approx(WAY_M, rel=1e-9)


def test_a_cycle_is_the_law_s_when_the_time_is() -> None:
    law_s = WAY_M / 0.9 + T_MIN_S
    plans = [step(law_s, 0.9), step(1.2 * law_s, 0.9), step(0.9 * law_s, 0.9), step(law_s, 0.8)]
    assert authority(plans, T_MIN_S) == RuleAuthority(4, 1)
    assert authority(plans, 0.5) == RuleAuthority(4, 0)


def test_cycles_without_a_way_to_the_pad_do_not_count() -> None:
    searching, resting = step(5.0, 0.9, Phase.SEARCH), step(5.0, 0.0)
    assert authority([searching, resting, PlanStep(0.0, Phase.DESCEND)], T_MIN_S) == RuleAuthority()
