"""Descent profiles: what is measured of a made-up descent, and which bars hold."""

import math
import re
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from companion.base.messages import Conditions, Outcome, Phase, Truth
from experiments import profiles
from experiments.flown import EndedFlight
from experiments.profiles import Descent
from experiments.tests.experiment_flights import plans, result, truth

SPEED = 0.5


def _descent() -> EndedFlight:
    """From 6 m straight down at 0.5 m/s, swinging sideways with the pad's drive; contact after 12 s."""
    times = np.arange(0.0, 12.0, 0.04).tolist()
    records = [_record(t) for t in times]
    landed = truth(12.0, (0.0, 12.0, 0.0), touching=True)
    kept = {"plan": plans((0.0, Phase.SEARCH), (2.0, Phase.APPROACH), (6.0, Phase.DESCEND))}
    return EndedFlight(result(), [truth(-0.04, (0.0, 0.0, 0.0), touching=True), *records, landed], kept)


def _record(t: float) -> Truth:
    swing, w = 0.1, 2.0
    position = (swing * math.sin(w * t), t, -6.0 + SPEED * t)
    return truth(t, position, (swing * w * math.cos(w * t), 1.0, SPEED))


def test_a_descent_is_measured_from_taking_the_pad_up() -> None:
    measured = profiles.measure(_descent(), "fuzzy")
    assert measured.landed
    assert measured.seconds == pytest.approx(10.0)
    assert measured.down_s == pytest.approx(8.8, abs=0.05)  # 0.6 m over the pad
    assert measured.speed_m_s == pytest.approx(math.hypot(0.5, 0.2), abs=0.01)
    assert measured.acceleration_m_s2 == pytest.approx(0.4, abs=0.02)
    assert measured.jerk_m_s3 == pytest.approx(0.8, abs=0.08)
    assert measured.overshoot_m == pytest.approx(0.1, abs=0.005)
    assert (measured.contact_m_s, measured.lateral_contact_m) == (0.2, 0.03)


def test_a_touch_at_the_take_off_is_not_the_contact() -> None:
    flown = _descent()
    bounced = [*flown.truth[:2], replace(flown.truth[2], in_contact=True), *flown.truth[3:]]
    assert profiles.measure(EndedFlight(flown.result, bounced, flown.kept), "fuzzy").seconds == pytest.approx(
        10.0
    )


def test_a_flight_that_never_saw_the_pad_has_no_figures() -> None:
    flown = _descent()
    lost = EndedFlight(result(Outcome.ABORTED), flown.truth, {"plan": plans((0.0, Phase.SEARCH))})
    measured = profiles.measure(lost, "fixed")
    assert not measured.landed
    assert math.isnan(measured.seconds)
    assert measured.course.shape == (3, 0)


def _three(**fuzzy: float) -> list[Descent]:
    one = profiles.measure(_descent(), "fuzzy")
    return [replace(one, **fuzzy), replace(one, law="fixed"), replace(one, law="log_polynomial")]  # type: ignore[arg-type]


def test_bars_hold_or_fail_one_by_one() -> None:
    assert all(profiles.bars(_three()).values())
    for change, words in (
        ({"landed": False}, "lands always"),
        ({"contact_m_s": 0.31}, "contact <= 0.3 m/s"),
        ({"down_s": 10.0}, "time <= 1.05 x fixed"),
        ({"jerk_m_s3": 2.0}, "jerk <= 1.05 x log polynomial"),
    ):
        assert not profiles.bars(_three(**change))[words]
    assert not profiles.bars(_three(contact_m_s=math.nan))["contact <= 0.3 m/s"]


def test_table_and_picture(tmp_path: Path) -> None:
    flown = _three()
    console = Console(width=80, record=True, file=StringIO())
    console.print(profiles.table(flown))
    shown = console.export_text()
    assert "…" not in shown
    assert re.search(r"landed +│ +1 of 1 │ +1 of 1 │ +1 of 1 │", shown)
    profiles.draw(flown, tmp_path / "profiles.png")
    assert (tmp_path / "profiles.png").read_bytes().startswith(b"\x89PNG")


def test_the_conditions_met_are_shown_by_scenario() -> None:
    one = profiles.measure(_descent(), "fuzzy")
    calm = replace(
        one, law="fuzzy_pace", scenario="static", conditions=(Conditions(0.009, 0.05, 0.2, 1.25),) * 5
    )
    storm = replace(
        one, law="fuzzy_pace", scenario="gusts", conditions=(Conditions(0.011, 0.15, 1.1, 0.75),) * 5
    )
    console = Console(record=True, width=110)
    console.print(profiles.conditions_table([calm, storm, replace(calm, law="fixed")]))
    shown = console.export_text()
    assert [line.split()[1] for line in shown.splitlines() if "(" in line and "to" in line][-2:] == [
        "static",
        "gusts",
    ]
    assert "1.25 (1.25 to 1.25)" in shown
    assert "0.75 (0.75 to 0.75)" in shown
    assert "nan" in str(profiles.conditions_table([replace(one, law="fuzzy_pace")]).columns[1]._cells)
