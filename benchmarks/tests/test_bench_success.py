"""How the bench of P(success) judges: by tenths, with what chance alone makes of so few."""

import pytest

from benchmarks.control.bench_success import FEWEST, SHARES, Watched, judge_tenths
from companion.config import TouchdownConfig

CONFIG = TouchdownConfig()


@pytest.mark.parametrize(("came_true", "holds"), [(0.85, True), (0.75, True), (0.7, False)])
def test_a_tenth_holds_when_what_was_said_comes_true(came_true: float, holds: bool) -> None:
    pairs = [(0.85, k < 100 * came_true) for k in range(100)]
    _, (bar,) = judge_tenths(pairs)
    assert bar.holds is holds


def test_a_tenth_with_few_answers_is_shown_and_not_judged() -> None:
    shown, bars = judge_tenths([(1.0, False)] * (FEWEST - 1) + [(0.05, False)] * FEWEST)
    assert shown.row_count == 2
    assert [bar.name for bar in bars] == ["said 0 to 10 %"]


def test_a_contact_is_within_the_wider_limits_and_not_within_the_tighter() -> None:
    offset_m = 0.5 * CONFIG.break_off_lateral_m
    contact = {"lateral_error_m": offset_m, "horizontal_speed_m_s": 0.0, "vertical_speed_m_s": 0.1}
    assert Watched(CONFIG).true(contact) == [share >= 0.5 for share in SHARES]
    fast = {**contact, "lateral_error_m": 0.0, "vertical_speed_m_s": CONFIG.fastest_contact_m_s + 0.01}
    assert not any(Watched(CONFIG).true(fast))
