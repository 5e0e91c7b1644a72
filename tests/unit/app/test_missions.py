"""What the app asks for when control has failed."""

from dataclasses import replace

import pytest

from companion.app.announcer import Announcer
from companion.app.missions import Missions
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.messages import ActionKind, LandedState
from companion.config import LinkConfig
from companion.flightlog.record import FlightLog
from companion.link.session import Session
from companion.plan.mission.states import State
from tests.unit.plan.mission.planner_world import world


@pytest.mark.parametrize(
    ("state", "landed", "asked"),
    [
        (State.APPROACH, LandedState.IN_AIR, ActionKind.HOLD),
        (State.WAIT, LandedState.IN_AIR, ActionKind.HOLD),
        # a few centimetres over a pad that heaves, and on it
        (State.SINK, LandedState.IN_AIR, ActionKind.LAND),
        (State.STAND, LandedState.IN_AIR, ActionKind.LAND),
        (State.SEARCH, LandedState.ON_GROUND, ActionKind.LAND),
    ],
)
def test_a_vehicle_that_stands_or_is_about_to_is_not_ordered_to_hold(
    state: State, landed: LandedState, asked: ActionKind
) -> None:
    async def word() -> ActionKind:
        clock, session, planner = Clock(), Session(LinkConfig()), world().planner
        log = FlightLog(None, 0.0)
        announcer = Announcer(clock, log, lambda _notice: None)
        missions = Missions(
            lambda _standby: planner, session, log, announcer, clock, standby=None, stays=False
        )
        planner._machine.state = state
        session.state = replace(session.state, landed=landed)
        return missions.last_word.kind

    assert run_in_virtual_time(word()) is asked
