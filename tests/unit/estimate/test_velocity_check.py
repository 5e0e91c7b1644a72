"""Our velocity beside the receiver's and the autopilot's: two of three agree, or ours is in doubt."""

import math

import numpy as np
import pytest

from companion.base.messages import Quantity, SourceComparison
from companion.base.second_sources import TABLE
from companion.estimate.velocity_check import VelocityCheck

ROW = TABLE[Quantity.VELOCITY]
REPORT_S = 0.2
BEGINS_S = 5.0
LOOSE_M_S2 = 9.81 * math.sin(math.radians(20.0))


def compared(
    drift_m_s2: float,
    lasts_s: float,
    *,
    std_m_s: float = 0.15,
    theirs_drift: float = 0.0,
    fixes_drift: float | None = 0.0,
) -> SourceComparison:
    """After a drift to the east of ours, theirs and the receiver's (None: no fixes); all three are noisy."""
    check, rng = VelocityCheck(), np.random.default_rng(5)
    until_s = BEGINS_S + lasts_s
    for k in range(round(until_s / REPORT_S) + 1):
        time_s = k * REPORT_S
        went_s = max(0.0, time_s - BEGINS_S)
        rows = rng.normal((0.5, 2.0 * math.sin(time_s), -0.3), 0.1, (3, 3))
        rows[:, 1] += np.array([drift_m_s2, theirs_drift, fixes_drift or 0.0]) * went_s
        ours, theirs, fix = (tuple(row) for row in rows.tolist())
        if fixes_drift is not None:
            check.take_fix(time_s, ours, fix)
        check.take(time_s, ours, theirs, std_m_s)
    [found] = check.comparisons(until_s)
    return found


def test_velocities_that_agree_are_not_announced() -> None:
    assert not ROW.announces(compared(0.0, 30.0))


@pytest.mark.parametrize("drift_m_s2", [LOOSE_M_S2, -LOOSE_M_S2])
@pytest.mark.parametrize("fixes", [0.0, None])
def test_a_board_that_comes_loose_is_refused_within_a_second_and_a_half_with_both_figures(
    drift_m_s2: float, fixes: float | None
) -> None:
    found = compared(drift_m_s2, 1.4, fixes_drift=fixes)
    assert ROW.refuses(found)
    assert found.first in ROW.words(found)
    assert found.second in ROW.words(found)


@pytest.mark.parametrize(("theirs", "fixes"), [(LOOSE_M_S2, 0.0), (0.0, LOOSE_M_S2)])
def test_one_that_is_wrong_beside_two_that_agree_is_not_ours(theirs: float, fixes: float) -> None:
    assert not ROW.announces(compared(0.0, 5.0, theirs_drift=theirs, fixes_drift=fixes))


def test_a_velocity_that_no_fix_has_corrected_is_believed_as_far_as_it_claims() -> None:
    drifted = compared(0.3, 10.0, std_m_s=1.5, fixes_drift=None)
    assert drifted.difference > 2.0
    assert not ROW.announces(drifted)
    assert ROW.refuses(compared(0.3, 10.0, fixes_drift=None))


@pytest.mark.parametrize("wrong", [1, 3])
def test_a_few_wrong_reports_decide_nothing(wrong: int) -> None:
    check = VelocityCheck()
    for k in range(30):
        theirs = (0.0, 0.0, 0.0) if 20 <= k < 20 + wrong else (4.2, 0.0, 0.0)
        check.take(REPORT_S * k, (4.2, 0.0, 0.0), theirs, 0.1)
        assert not any(map(ROW.announces, check.comparisons(REPORT_S * k)))


def test_after_a_gap_the_oldest_report_of_a_backlog_decides_nothing() -> None:
    check = VelocityCheck()
    for k in range(10):
        check.take(REPORT_S * k, (4.0, 0.0, 0.0), (4.0, 0.0, 0.0), 0.1)
    check.take(6.0, (0.0, 0.0, 0.0), (4.0, 0.0, 0.0), 0.1)
    assert check.comparisons(6.0) == ()


def test_climbs_are_not_compared() -> None:
    check = VelocityCheck()
    for k in range(20):
        check.take(REPORT_S * k, (1.0, 2.0, 5.0), (1.0, 2.0, -5.0), 0.1)
    assert check.comparisons(4.0)[0].difference == pytest.approx(0.0)


def test_what_it_began_with_is_forgotten_and_what_is_old_is_not_compared() -> None:
    check = VelocityCheck()
    for k in range(4):
        check.take(REPORT_S * k, (9.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.1)
    assert check.comparisons(0.7)[0].difference == pytest.approx(9.0)
    assert check.comparisons(1.7) == ()
    check.forget()
    assert check.comparisons(0.7) == ()
