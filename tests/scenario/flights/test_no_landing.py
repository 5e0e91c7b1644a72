"""Flights that cannot end in a landing end by time, in order, and say so in one line."""

from pathlib import Path

from tests.scenario.flying import fly, scenario_file

ENDS = {4: "aborted", 5: "timeout"}


def test_a_pad_that_drives_away_for_good_is_given_up(tmp_path: Path) -> None:
    changes = {
        "beacon": {"available": False},
        # seen when it passes the waypoint, never to be caught up with
        "pad": {"motion": {"speed_m_s": 6.0, "meet": {"spread_m": 0.5}}},
        "companion": {"plan": {"mission": {"total_timeout_s": 50.0}}},
    }
    flown = fly(scenario_file(tmp_path, "line", changes), 0, tmp_path)
    assert flown.result is not None, flown
    assert flown.result["outcome"] == ENDS.get(flown.code), flown
    assert flown.result["time"]["total_s"] < 75.0, flown
    assert len(flown.stderr.strip().splitlines()) == 1, flown


def test_time_that_is_up_ends_the_flight(tmp_path: Path) -> None:
    flown = fly(scenario_file(tmp_path, "static", {"time_limit_s": 12.0}), 0, tmp_path)
    assert flown.code == 5, flown
    assert flown.result is not None
    assert flown.result["outcome"] == "timeout"
    assert flown.result["touchdown"] is None
    assert flown.stderr == "companion: timeout: never touched down\n"


def test_a_bound_that_is_broken_is_named(tmp_path: Path) -> None:
    flown = fly(scenario_file(tmp_path, "static", {"pass": {"lateral_error_m": 0.0001}}), 0, tmp_path)
    assert flown.code == 3, flown
    assert flown.result is not None
    assert flown.result["outcome"] == "missed"
    assert flown.stderr.startswith("companion: missed: lateral error 0.0")
