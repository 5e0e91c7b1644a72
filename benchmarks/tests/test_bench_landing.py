"""The benches of random landings: those as built are the same flights, by vehicles that are not as told.

P(success) is judged by tenths, with what chance alone makes of so few.
"""

import pytest

from benchmarks.campaign.bench_landing import as_built_bars, random_bars
from benchmarks.campaign.landing_cases import as_built_landings, random_landings
from benchmarks.control.bench_success import FEWEST, SHARES, SuccessWatch, answers, judge_tenths
from companion.config import TouchdownConfig
from sitl.scenario.scenario import Scenario
from tests.unit.sitl.campaign.campaign_parts import row

CONFIG = TouchdownConfig()


def test_as_built_it_is_the_same_landing_by_a_vehicle_that_is_not_as_told() -> None:
    told, built = random_landings(6, 40).flights, as_built_landings(6, 40).flights
    for (believed, number), (wrong, seed) in zip(told, built, strict=True):
        assert seed == number
        usual, other = Scenario.model_validate(believed), Scenario.model_validate(wrong)
        assert (other.pad, other.wind, other.camera) == (usual.pad, usual.wind, usual.camera)
        assert other.companion == usual.companion
        assert usual.as_built is None
        assert (other.as_built is not None, other.mass_factor) == (True, 1.0)
    assert {Scenario.model_validate(content).autopilot for content, _ in built} == {"px4", "ardupilot"}


def test_one_contact_that_was_not_planned_fails_the_bars_though_all_landed() -> None:
    rows = [row("case", seed, lateral_m=0.01) for seed in range(100)]
    rows = [one.model_copy(update={"vertical_speed_m_s": 0.15}) for one in rows]
    touched = [rows[0].model_copy(update={"unplanned_contacts": 1}), *rows[1:]]
    for bars in (random_bars, as_built_bars):
        assert all(bar.holds for bar in bars(rows))
        assert [bar.name for bar in bars(touched) if not bar.holds] == [
            next(bar.name for bar in bars(rows) if "unplanned" in bar.name)
        ]


@pytest.mark.parametrize(("came_true", "holds"), [(0.85, True), (0.75, True), (0.7, False)])
def test_a_tenth_holds_when_what_was_said_comes_true(came_true: float, holds: bool) -> None:
    pairs = [(0.85, k < 100 * came_true) for k in range(100)]
    _, (bar,) = judge_tenths("all", pairs)
    assert bar.holds is holds


def test_a_tenth_with_few_answers_is_shown_and_not_judged() -> None:
    shown, bars = judge_tenths("all", [(1.0, False)] * (FEWEST - 1) + [(0.05, False)] * FEWEST)
    assert shown.row_count == 2
    assert [bar.name for bar in bars] == ["said 0 to 10 %"]


def test_a_contact_is_within_the_wider_limits_and_not_within_the_tighter() -> None:
    offset_m = 0.5 * CONFIG.break_off_lateral_m
    contact = {"lateral_error_m": offset_m, "horizontal_speed_m_s": 0.0, "vertical_speed_m_s": 0.1}
    good = SuccessWatch(CONFIG).true(contact)
    assert good["lateral offset"] == [share >= 0.5 for share in SHARES]
    assert all(good["lateral speed"] + good["sink"])
    fast = {**contact, "vertical_speed_m_s": CONFIG.fastest_contact_m_s + 0.01}
    assert not any(SuccessWatch(CONFIG).true(fast)["sink"])


def test_limits_together_are_met_where_each_is() -> None:
    row = {"said": {"a": [0.5] * 5, "b": [0.5] * 5}, "true": {"a": [True] * 5, "b": [False] * 4 + [True]}}
    assert answers([row, {"said": {}, "true": {}}], ["a", "b"]) == [(0.25, False)] * 4 + [(0.25, True)]
