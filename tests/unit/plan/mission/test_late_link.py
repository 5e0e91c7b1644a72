"""A link whose answers come late: nothing begins by it, and what flies by it is handed back and said."""

import pytest

from companion.base.messages import ActionKind, Phase
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import still


def test_nobody_takes_off_by_a_late_link() -> None:
    w = world(still())
    w.autopilot.round_trip_s = 0.5
    flight = w.fly(20.0)
    assert flight.phase is Phase.CONNECT
    assert any(
        "a quicker link: answers after 0.50 s, at most 0.3 are flown by" in text
        for text in flight.told("waiting")
    )


@pytest.mark.parametrize("phase", [Phase.SEARCH, Phase.APPROACH, Phase.DESCEND])
def test_late_on_the_way_it_is_handed_back_and_said(phase: Phase) -> None:
    w = world(still())
    w.fly(60.0, until=lambda w: w.flight.phase is phase)
    w.autopilot.round_trip_s = 1.0
    w.fly(2.0)
    assert w.flight.phase is Phase.ABORT
    assert [kind for _, kind in w.autopilot.heard][-1] is ActionKind.HOLD
    assert w.flight.told("phase")[-1] == "abort: link late: answers after 1.00 s, at most 0.3 are flown by"


def test_the_autopilot_goes_on_to_the_waypoint_and_what_is_committed_lands() -> None:
    w = world(still())
    w.fly(60.0, until=lambda w: w.flight.phase is Phase.TAKE_OFF)
    w.autopilot.round_trip_s = 1.0
    w.fly(60.0, until=lambda w: w.flight.phase is Phase.WAYPOINT)
    assert w.flight.phase is Phase.WAYPOINT

    w = world(still())
    w.fly(60.0, until=lambda w: bool(w.flight.told("commit")))
    w.autopilot.round_trip_s = 1.0
    w.fly(20.0)
    assert w.flight.phase is Phase.LANDED
