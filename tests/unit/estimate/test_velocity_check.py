"""Our velocity beside the autopilot's: what agrees, a loose board, and what no fix has corrected."""

import math

import numpy as np
import pytest

from companion.base.messages import Quantity, SourceComparison
from companion.base.second_sources import TABLE
from companion.estimate.velocity_check import VelocityCheck

ROW = TABLE[Quantity.VELOCITY]
REPORT_S = 0.2
LOOSE_M_S2 = 9.81 * math.sin(math.radians(20.0))


def compared(
    drift_m_s2: float, lasts_s: float, std_m_s: float = 0.15, noise_m_s: float = 0.1
) -> SourceComparison:
    """After a drift of ours to the east, from 5 s on; both filters are noisy."""
    check, rng = VelocityCheck(), np.random.default_rng(5)
    for k in range(round((5.0 + lasts_s) / REPORT_S) + 1):
        time_s = k * REPORT_S
        east = 2.0 * math.sin(time_s)
        ours, theirs = rng.normal((0.5, east, -0.3), noise_m_s, (2, 3)).tolist()
        ours[1] += drift_m_s2 * max(0.0, time_s - 5.0)
        check.take(time_s, tuple(ours), tuple(theirs), std_m_s)
    [found] = check.comparisons(5.0 + lasts_s)
    return found


def test_before_a_report_nothing_is_compared() -> None:
    assert VelocityCheck().comparisons(1.0) == ()


def test_two_filters_that_agree_are_not_announced() -> None:
    assert not ROW.announces(compared(0.0, 30.0))


@pytest.mark.parametrize("drift_m_s2", [LOOSE_M_S2, -LOOSE_M_S2])
def test_a_board_that_comes_loose_is_refused_within_a_second_with_both_figures(drift_m_s2: float) -> None:
    found = compared(drift_m_s2, 1.0)
    assert ROW.refuses(found)
    assert found.first in ROW.words(found)
    assert found.second in ROW.words(found)


def test_a_velocity_that_no_fix_has_corrected_is_believed_as_far_as_it_claims() -> None:
    drifted = compared(0.3, 10.0, std_m_s=1.5)
    assert drifted.difference > 2.0
    assert not ROW.announces(drifted)
    assert ROW.refuses(compared(0.3, 10.0))


def test_climbs_are_not_compared() -> None:
    check = VelocityCheck()
    for k in range(20):
        check.take(REPORT_S * k, (1.0, 2.0, 5.0), (1.0, 2.0, -5.0), 0.1)
    assert check.comparisons(4.0)[0].difference == pytest.approx(0.0)


def test_what_it_began_with_is_forgotten() -> None:
    check = VelocityCheck()
    check.take(1.0, (9.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.1)
    check.forget()
    check.take(1.2, (0.1, 0.0, 0.0), (0.0, 0.0, 0.0), 0.1)
    assert check.comparisons(1.3)[0].difference == pytest.approx(0.1)
    # no report for long: nothing is compared, and the mean begins anew
    assert check.comparisons(8.9) == ()
    check.take(9.0, (3.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.1)
    assert check.comparisons(9.1)[0].difference == pytest.approx(3.0)
