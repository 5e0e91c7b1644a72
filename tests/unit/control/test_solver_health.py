"""What a solve comes to, and when no plan is flown any more."""

import numpy as np
import pytest

from companion.control.solver_health import (
    ACCEPTED_DUAL_SHARE,
    ACCEPTED_PRIMAL,
    FAILURES_TO_STOP,
    GUST_S,
    NEARLY_SOLVED,
    SOLVED,
    UNSOLVED,
    SolverHealth,
    outcome,
)
from companion.control.tracking import SolveOutcome, TrackingSolution

RATE_HZ = 30.0
INFEASIBLE = 3  # OSQP's


def answer(what: SolveOutcome, short_of: str = "") -> TrackingSolution:
    return TrackingSolution(np.zeros((1, 3)), np.zeros((1, 9)), what, short_of=short_of)


def after(*counted: tuple[SolveOutcome, int]) -> SolverHealth:
    health = SolverHealth(RATE_HZ)
    for what, count in counted:
        for _ in range(count):
            health.note(answer(what))
    return health


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize(
    ("status", "primal", "dual_share", "in_time", "out_of_time"),
    [
        (SOLVED, 1.0, 1.0, SolveOutcome.SOLVED, SolveOutcome.SOLVED),
        (NEARLY_SOLVED, 1.0, 1.0, SolveOutcome.SOLVED, SolveOutcome.SOLVED),
        (UNSOLVED, ACCEPTED_PRIMAL, ACCEPTED_DUAL_SHARE, SolveOutcome.SOLVED, SolveOutcome.SOLVED),
        (UNSOLVED, 1.01 * ACCEPTED_PRIMAL, 0.0, SolveOutcome.CUT, SolveOutcome.KEPT),
        (UNSOLVED, 0.0, 1.01 * ACCEPTED_DUAL_SHARE, SolveOutcome.CUT, SolveOutcome.KEPT),
        (INFEASIBLE, 0.0, 0.0, SolveOutcome.KEPT, SolveOutcome.KEPT),
    ],
)
def test_a_search_comes_to(
    status: int,
    primal: float,
    dual_share: float,
    in_time: SolveOutcome,
    out_of_time: SolveOutcome,
    late: bool,
) -> None:
    found = outcome(status, primal=primal, dual_share=dual_share, late=late)
    assert found is (out_of_time if late else in_time)


def test_nothing_has_been_solved_at_first() -> None:
    assert SolverHealth(RATE_HZ).stopped
    assert not after((SolveOutcome.SOLVED, 1)).stopped
    begun = after((SolveOutcome.SOLVED, 1))
    begun.begin()
    assert begun.stopped


@pytest.mark.parametrize(("count", "stopped"), [(FAILURES_TO_STOP - 1, False), (FAILURES_TO_STOP, True)])
def test_the_last_plan_is_flown_on_for_a_while(count: int, stopped: bool) -> None:
    health = after((SolveOutcome.CUT, 1), (SolveOutcome.KEPT, count))
    assert health.stopped is stopped
    assert bool(health.failure(())) is stopped


@pytest.mark.parametrize(("lasts_s", "failed"), [(GUST_S - 0.1, False), (GUST_S, True)])
def test_a_wind_that_cuts_the_inputs_for_longer_than_a_gust_leaves_no_plan(
    lasts_s: float, failed: bool
) -> None:
    health = after((SolveOutcome.SOLVED, 1), (SolveOutcome.CUT, round(lasts_s * RATE_HZ)))
    assert health.cut_s == pytest.approx(lasts_s)
    assert bool(health.failure(())) is failed
    health.note(answer(SolveOutcome.SOLVED))
    assert not health.failure(())


def test_what_is_no_number_is_no_plan() -> None:
    assert not after((SolveOutcome.SOLVED, 1)).failure(("jerk",))
    assert after((SolveOutcome.SOLVED, 1)).failure(("jerk", "not_finite"))


@pytest.mark.parametrize(("lasts_s", "short"), [(GUST_S - 0.1, False), (GUST_S, True)])
def test_what_a_gust_takes_is_not_told(lasts_s: float, short: bool) -> None:
    health = SolverHealth(RATE_HZ)
    for _ in range(round(lasts_s * RATE_HZ)):
        health.note(answer(SolveOutcome.SOLVED, short_of="thrust"))
    assert health.short_of == ("thrust" if short else "")


@pytest.mark.parametrize(("share", "short"), [(0.4, False), (0.7, True)])
def test_a_turbulent_wind_that_takes_all_more_often_than_not_is_told(share: float, short: bool) -> None:
    health, told = SolverHealth(RATE_HZ), set[str]()
    for k in range(round(20.0 * RATE_HZ)):
        health.note(answer(SolveOutcome.SOLVED, short_of="tilt" if k % 10 < 10.0 * share else ""))
        told.add(health.short_of)
    assert ("tilt" in told) is short
