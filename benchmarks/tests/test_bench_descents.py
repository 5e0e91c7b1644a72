"""How the descents' bench judges: against the quickest fixed speed, of those that touch down as well."""

import json
from pathlib import Path

import pytest

from benchmarks.control.bench_descents import FUZZY, PACED, Row, Switch, bars, figure, read_rows, table
from companion.base.messages import Conditions
from companion.plan.speed.laws import SpeedController


def rows(law: str, down_s: float, lateral_m: float = 0.05, contact_m_s: float = 0.2) -> list[Row]:
    return [
        {
            "number": number,
            "law": law,
            "landed": True,
            "down_s": down_s,
            "seconds": down_s + 3.0,
            "jerk_m_s3": 8.0,
            "contact_m_s": contact_m_s,
            "lateral_contact_m": lateral_m,
        }
        for number in range(5)
    ]


@pytest.mark.parametrize(("mine_s", "holds"), [(7.2, True), (7.3, False)])
def test_a_fifth_quicker_than_the_best_fixed_speed_holds(mine_s: float, holds: bool) -> None:
    groups = {FUZZY: rows(FUZZY, mine_s), "fixed 1": rows("fixed 1", 12.0), "fixed 2": rows("fixed 2", 9.0)}
    (bar,) = bars(groups)
    assert bar.holds is holds
    assert "0.8 x fixed 2" in str(bar)


@pytest.mark.parametrize(
    ("name", "down_s", "worse"),
    [
        ("fixed 2", 5.0, {"lateral_m": 0.06}),
        ("fixed 2", 5.0, {"contact_m_s": 0.25}),
        (PACED, 2.0, {}),  # the same rules at another pace
    ],
)
def test_what_touches_down_worse_or_is_no_fixed_speed_is_no_measure(
    name: str, down_s: float, worse: dict[str, float]
) -> None:
    (bar,) = bars(
        {FUZZY: rows(FUZZY, 7.2), "fixed 1": rows("fixed 1", 9.0), name: rows(name, down_s, **worse)}
    )
    assert bar.holds
    assert "0.8 x fixed 1" in str(bar)


def test_without_a_fixed_speed_to_compare_with_nothing_is_proven() -> None:
    (bar,) = bars({FUZZY: rows(FUZZY, 7.2), "rash": rows("rash", 9.0, lateral_m=0.06)})
    assert not bar.holds


def test_what_was_not_measured_is_infinitely_bad_and_is_shown() -> None:
    none = [{**row, "down_s": float("nan"), "landed": False} for row in rows(FUZZY, 1.0)]
    assert figure(none, "down_s", 50) == float("inf")
    (bar,) = bars({FUZZY: none, "fixed 1": rows("fixed 1", 9.0)})
    assert not bar.holds
    assert table({FUZZY: none}).row_count == 1


def test_a_switch_flies_by_the_law_that_was_put() -> None:
    one = SpeedController(lambda *_: 1.0, lambda _: 1.0)
    two = SpeedController(lambda *_: 2.0, lambda _: 0.5)
    switch, conditions = Switch({"one": one, "two": two}), Conditions(0.01, 0.0, 0.0)
    assert (switch(1.0, 0.0, 0.0), switch.pace(conditions)) == (1.0, 1.0)
    switch.name = "two"
    assert (switch(1.0, 0.0, 0.0), switch.pace(conditions)) == (2.0, 0.5)


def test_rows_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    assert read_rows(path) == []
    path.write_text("".join(json.dumps(row) + "\n" for row in rows(FUZZY, 7.0)))
    assert read_rows(path) == rows(FUZZY, 7.0)
