"""What the app asks for when control has failed, and what whoever ordered a landing is told at its end."""

import pytest

from companion.app.missions import Announcer, Missions
from companion.base.clock import Clock
from companion.base.messages import (
    Action,
    ActionKind,
    AutopilotState,
    LandedState,
    Notice,
    Order,
    OrderKind,
    OrderReply,
    Phase,
    PlanStep,
)
from companion.config import LinkConfig
from companion.flightlog.record import FlightLog
from companion.link.session import Session
from companion.plan.mission.states import Authority, State
from companion.plan.planner import PlanInputs, Planner
from tests.unit.plan.mission.planner_world import world
from tests.virtual_time import in_virtual_time


def last_request(
    state: State,
    authority: Authority,
    landed: LandedState = LandedState.IN_AIR,
    *,
    offboard: bool = True,
    asked: ActionKind | None = None,
) -> ActionKind | None:
    planner = world().planner
    planner._machine.state, planner._machine.authority = state, authority
    if asked is not None:
        planner._requests.ask(Action(asked), 0.0)
    word = planner.last_request(AutopilotState(0.0, landed=landed, offboard=offboard))
    return None if word is None else word.kind


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
    assert last_request(state, Authority.OURS, landed) is asked


@pytest.mark.parametrize(
    ("state", "authority", "offboard"),
    [
        # in GUIDED by somebody else, before an order and before control is ours
        (State.STANDBY, Authority.NONE, True),
        (State.SEARCH, Authority.NONE, True),
        (State.ABORT, Authority.RELEASED, True),  # and after a pilot took over
        (State.APPROACH, Authority.OURS, False),
    ],
)
def test_a_vehicle_that_somebody_else_flies_is_ordered_nothing(
    state: State, authority: Authority, offboard: bool
) -> None:
    assert last_request(state, authority, offboard=offboard) is None


@pytest.mark.parametrize("authority", [Authority.NONE, Authority.PILOT])
@pytest.mark.parametrize("offboard", [True, False])
def test_control_that_was_asked_for_and_not_answered_is_returned_if_it_was_obeyed(
    authority: Authority, offboard: bool
) -> None:
    asked = last_request(State.SEARCH, authority, offboard=offboard, asked=ActionKind.TAKE_CONTROL)
    assert asked is ActionKind.HOLD_IF_OBEYED


def test_a_hold_that_was_asked_for_and_not_answered_is_asked_for_once_more() -> None:
    assert last_request(State.ABORT, Authority.RELEASED, asked=ActionKind.HOLD) is ActionKind.HOLD


class Scripted(Planner):
    """A planner whose phases are given, each with its notice."""

    phase, refused, waiting = Phase.STANDBY, None, False

    def __init__(self, *steps: tuple[Phase, str]) -> None:
        self._steps = iter(steps)

    def step(self, inputs: PlanInputs, now_s: float) -> PlanStep:
        phase, text = next(self._steps)
        return PlanStep(now_s, phase, notices=(Notice(now_s, "phase", text),) if text else ())


@pytest.mark.parametrize(
    ("steps", "told"),
    [
        (
            [(Phase.HOLD, "hold: stop requested"), (Phase.HOLD, ""), (Phase.ABORT, "abort: clear: at rest")],
            "hold: stop requested; abort: clear: at rest",
        ),
        ([(Phase.ABORT, "abort: taken over")], "abort: taken over"),
        (
            [(Phase.HOLD, "hold: link lost"), (Phase.SEARCH, "search: again"), (Phase.LANDED, "landed")],
            "landed",
        ),
    ],
)
@in_virtual_time
async def test_who_ordered_a_landing_is_told_why_it_held_and_how_it_ended(
    steps: list[tuple[Phase, str]], told: str
) -> None:
    replies = list[OrderReply]()
    clock, session, log = Clock(), Session(LinkConfig()), FlightLog(None, 0.0)
    planner = Scripted((Phase.SEARCH, "search: land ordered"), *steps)
    announcer = Announcer(clock, log, lambda _notice: None)
    missions = Missions(lambda _why: planner, session, log, announcer, clock, standby=None, stays=True)
    missions.give(Order(0.0, OrderKind.LAND, "a test"), replies.append)
    for _ in range(1 + len(steps)):
        missions.step(PlanInputs(None, None, AutopilotState(0.0)), clock.now_s())
    await clock.sleep_until(clock.now_s() + 2.0)
    assert missions.finished(busy=False)
    assert [reply.text for reply in replies] == ["", told]
