"""Flights that cannot end in a landing end by time, in order, and say so in one line."""

import math
from pathlib import Path

from companion.base.messages import Outcome
from tests.scenario.flying import FEW_PICTURES, fly, fly_logged, notices, scenario_file

ENDS = {4: "aborted", 5: "timeout"}


def test_a_pad_that_drives_away_for_good_is_given_up(tmp_path: Path) -> None:
    changes = {
        **FEW_PICTURES,
        "beacon": {"available": False},
        # seen when it passes the waypoint, never to be caught up with
        "pad": {"motion": {"speed_m_s": 6.0, "meet": {"spread_m": 0.5}}},
        "companion": {"plan": {"mission": {"total_timeout_s": 35.0}}},
    }
    flown = fly(scenario_file(tmp_path, "line", changes), 0, tmp_path)
    assert flown.result is not None, flown
    assert flown.result["outcome"] == ENDS.get(flown.code), flown
    assert flown.result["time"]["total_s"] < 60.0, flown
    assert len(flown.stderr.strip().splitlines()) == 1, flown


def test_time_that_is_up_ends_the_flight(tmp_path: Path) -> None:
    flown = fly(scenario_file(tmp_path, "static", {"time_limit_s": 12.0}), 0, tmp_path)
    assert flown.code == 5, flown
    assert flown.result is not None
    assert flown.result["outcome"] == "timeout"
    assert flown.result["touchdown"] is None
    assert flown.stderr == "companion: timeout: never touched down\n"


def test_a_bound_that_is_broken_is_named(tmp_path: Path) -> None:
    changes = {**FEW_PICTURES, "pass": {"lateral_error_m": 0.0001}}
    flown = fly(scenario_file(tmp_path, "static", changes), 0, tmp_path)
    assert flown.code == 3, flown
    assert flown.result is not None
    assert flown.result["outcome"] == "missed"
    assert flown.stderr.startswith("companion: missed: lateral error 0.0")


def test_no_landing_begins_that_would_end_outside_the_fence(tmp_path: Path) -> None:
    """Without a fence it commits 14 m from home by its own estimate, and the pad takes it to 17 m."""
    fence_m = 16.5
    changes = {**FEW_PICTURES, "companion": {"plan": {"mission": {"fence_m": fence_m}}}}
    flight, log = fly_logged(scenario_file(tmp_path, "line", changes))
    report = flight.report
    assert report.outcome is Outcome.ABORTED, report.failures
    assert report.touchdown is None
    assert [notice.text for notice in log.kept["notice"] if notice.kind == "commit"] == []
    assert f"waiting: the pad leaves the fence ({fence_m:.0f} m) before contact" in notices(log)
    farthest_m = max(math.hypot(*truth.vehicle_position_ned_m[:2]) for truth in report.truth)
    assert farthest_m < fence_m + 1.0  # the autopilot's own position is off by its GPS
