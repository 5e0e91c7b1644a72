"""The verdict: every outcome, and both sides of each bound."""

from __future__ import annotations

import dataclasses
from math import nan
from typing import Any

import pytest

from companion.base.messages import Outcome, Phase
from sitl.scenario.scenario import PassBounds
from sitl.world.score import TouchdownResult, TouchdownState, Verdict, judge

GOOD = TouchdownState(
    time_s=40.0,
    lateral_error_m=0.04,
    vertical_speed_m_s=0.3,
    horizontal_speed_m_s=0.1,
    tilt_deg=2.0,
    yaw_error_deg=-5.0,
    pad_speed_m_s=1.0,
    impact_speed_m_s=0.32,
    on_pad=True,
    offset_pad_m=(0.04, 0.0),
)


def judged(touchdown: TouchdownState | None = GOOD, **values: Any) -> Verdict:
    flight = {"crashed": False, "at_rest_on_pad": True, "disarmed": True, "final_phase": Phase.LANDED}
    return judge(touchdown, PassBounds(), **{**flight, **values})


def test_a_good_landing_is_landed_and_reported() -> None:
    verdict = judged()
    assert verdict.outcome is Outcome.LANDED
    assert verdict.outcome is Outcome.LANDED
    assert verdict.failures == ()
    assert verdict.touchdown == TouchdownResult(0.04, 0.3, 0.1, 2.0, -5.0)


@pytest.mark.parametrize(
    ("field", "bound"),
    [
        ("lateral_error_m", 0.15),
        ("vertical_speed_m_s", 0.4),
        ("horizontal_speed_m_s", 0.3),
        ("tilt_deg", 10.0),
    ],
)
def test_each_bound_holds_up_to_itself_and_no_further(field: str, bound: float) -> None:
    assert judged(dataclasses.replace(GOOD, **{field: bound})).outcome is Outcome.LANDED  # type: ignore[arg-type]
    over = judged(dataclasses.replace(GOOD, **{field: bound * 1.01}))  # type: ignore[arg-type]
    assert over.outcome is Outcome.MISSED
    assert len(over.failures) == 1
    assert f"expected at most {bound:g}" in over.failures[0]
    unknown = judged(dataclasses.replace(GOOD, **{field: nan}))  # type: ignore[arg-type]
    assert unknown.outcome is Outcome.MISSED


@pytest.mark.parametrize(
    ("touchdown", "values", "outcome"),
    [
        (GOOD, {"crashed": True}, Outcome.CRASHED),
        (None, {"crashed": True}, Outcome.CRASHED),
        (None, {"final_phase": Phase.ABORT}, Outcome.ABORTED),
        (dataclasses.replace(GOOD, on_pad=False), {"final_phase": Phase.ABORT}, Outcome.ABORTED),
        (None, {"final_phase": Phase.SEARCH}, Outcome.TIMEOUT),
        (GOOD, {"disarmed": False}, Outcome.TIMEOUT),
        (GOOD, {"at_rest_on_pad": False}, Outcome.MISSED),
        (dataclasses.replace(GOOD, on_pad=False), {}, Outcome.MISSED),
    ],
)
def test_each_ending_has_its_outcome_and_a_reason(
    touchdown: TouchdownState | None, values: dict[str, Any], outcome: Outcome
) -> None:
    verdict = judged(touchdown, **values)
    assert verdict.outcome is outcome
    assert verdict.outcome is not Outcome.LANDED
    assert verdict.failures
    assert (verdict.touchdown is None) == (touchdown is None)
