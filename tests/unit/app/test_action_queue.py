"""The actions that wait: what is asked for is carried out in the mode in which it was asked for, or not."""

import asyncio

import pytest

from companion.app.app import ActionQueue
from companion.base.clock import Clock
from companion.base.messages import Action, ActionKind, ActionResult
from companion.link.actions.actions import PymavlinkActions
from companion.link.codec import mavlink
from companion.link.session import Session
from tests.unit.link.actions.action_flight import fly
from tests.unit.link.fake_autopilot import FakeAutopilot

LAND_THEN_DISARM = (Action(ActionKind.LAND), Action(ActionKind.DISARM))  # a take-off that was refused


def queued(autopilot: FakeAutopilot, *asked: Action, pilot: str = "", clears: bool = False) -> list[str]:
    """Ask for it all at once, then a pilot takes the vehicle; how each ends: "" is accepted."""
    results: list[ActionResult] = []

    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        queue = ActionQueue(actions, results.append)
        running = asyncio.ensure_future(queue.run())
        for action in asked:
            queue.add(action)
        await asyncio.sleep(0.3)
        if pilot:
            autopilot.mode = pilot
            session.receive(autopilot.codec.encode(autopilot.message(0, 0.0)), Clock().now_s())
        if clears:
            queue.clear()
        await asyncio.sleep(4.0)
        running.cancel()
        return results

    return [result.text for result in fly(autopilot, story)]


def test_what_waits_behind_a_landing_of_ours_is_carried_out_in_its_mode() -> None:
    autopilot = FakeAutopilot(mode="AUTO.TAKEOFF", armed=True)
    assert queued(autopilot, *LAND_THEN_DISARM) == ["", ""]
    assert (autopilot.mode, autopilot.armed) == ("AUTO.LAND", False)


@pytest.mark.parametrize("waits", [ActionKind.DISARM, ActionKind.HOLD])
def test_what_waits_is_not_begun_in_a_mode_that_a_pilot_chose_meanwhile(waits: ActionKind) -> None:
    autopilot = FakeAutopilot(mode="AUTO.TAKEOFF", armed=True)
    autopilot.deaf_to[mavlink.MAV_CMD_DO_SET_MODE] = 1
    ends = queued(autopilot, Action(ActionKind.LAND), Action(waits, force=True), pilot="POSCTL")
    assert [end.rsplit(" ", 1)[-1] for end in ends] == ["POSCTL", "POSCTL"]
    assert autopilot.commands(mavlink.MAV_CMD_COMPONENT_ARM_DISARM) == []
    assert len(autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE)) == 1
    assert (autopilot.mode, autopilot.armed) == ("POSCTL", True)


def test_what_is_withdrawn_while_it_waits_or_is_under_way_is_not_sent() -> None:
    autopilot = FakeAutopilot(mode="AUTO.TAKEOFF", armed=True)
    autopilot.deaf_to[mavlink.MAV_CMD_DO_SET_MODE] = 99
    assert queued(autopilot, *LAND_THEN_DISARM, clears=True) == ["withdrawn"]
    assert autopilot.commands(mavlink.MAV_CMD_COMPONENT_ARM_DISARM) == []
    assert len(autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE)) == 1


def test_an_action_whose_result_cannot_be_taken_leaves_the_queue_free() -> None:
    """A log that cannot be written raises there: the mission's end would wait for the queue for good."""

    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        def fail(result: ActionResult) -> None:
            raise OSError("no space left on device")

        queue = ActionQueue(actions, fail)
        queue.add(Action(ActionKind.LAND))
        with pytest.raises(OSError, match="no space"):
            await queue.run()
        assert not queue.busy
        return []

    fly(FakeAutopilot(mode="OFFBOARD", armed=True), story)
