"""Actions that are withdrawn, and control that a pilot has taken."""

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import Action, ActionKind, ActionResult, PadBeacon
from companion.link.actions.actions import PymavlinkActions
from companion.link.codec import Codec, mavlink
from companion.link.session import Session
from tests.unit.link.actions.action_flight import autopilot_of, cancel_after, fly, meanwhile, perform, show
from tests.unit.link.fake_autopilot import FakeAutopilot
from tests.unit.link.ground_beacon import follow_target


@pytest.mark.parametrize("kind", [kind for kind in ActionKind if kind is not ActionKind.GO_TO])
def test_cancelling_ends_any_action_at_once_and_nothing_of_it_is_repeated(kind: ActionKind) -> None:
    numbers = (
        mavlink.MAV_CMD_DO_SET_MODE,
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
        mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_DO_REPOSITION,
    )
    leaves = kind in {ActionKind.LEAVE_OFFBOARD, ActionKind.HOLD_IF_OBEYED}
    mode = "OFFBOARD" if leaves else "AUTO.LOITER"
    autopilot = FakeAutopilot(mode=mode, deaf_to=dict.fromkeys(numbers, 99))
    [result] = cancel_after(autopilot, 0.1, Action(kind, height_m=5.0, force=True))
    assert (result.kind, result.accepted, result.text) == (kind, False, "withdrawn")
    asked_of_ground = [m for m in autopilot.commands(512) if m.target_system == 255]
    assert sum(len(autopilot.commands(number)) for number in numbers) + len(asked_of_ground) == 1


def test_after_cancelling_holding_waits_for_nothing() -> None:
    autopilot = FakeAutopilot(mode="POSCTL", deaf_to={mavlink.MAV_CMD_DO_SET_MODE: 1})
    results = cancel_after(autopilot, 0.1, Action(ActionKind.TAKE_CONTROL), Action(ActionKind.HOLD))
    assert [result.accepted for result in results] == [False, True]
    assert autopilot.mode == "AUTO.LOITER"
    modes = [(m.param2, m.param3) for m in autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE)]
    assert modes[0] == (6.0, 0.0)
    assert set(modes[1:]) == {(4.0, 3.0)}


def test_cancelling_while_an_accepted_mode_is_awaited_ends_that_too() -> None:
    [result] = cancel_after(FakeAutopilot(keeps_mode=True), 0.5, Action(ActionKind.TAKE_CONTROL))
    assert result.text == "withdrawn"


def test_cancelling_with_nothing_under_way_changes_nothing() -> None:
    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        actions.cancel()
        return [await actions.perform(Action(ActionKind.LAND))]

    [result] = fly(FakeAutopilot(), story)
    assert result.accepted


@pytest.mark.parametrize(
    ("autopilot_kind", "asked", "chosen"),
    [
        ("px4", ActionKind.TAKE_CONTROL, "POSCTL"),  # a pilot at the sticks
        ("ardupilot", ActionKind.TAKE_CONTROL, "ALT_HOLD"),
        ("px4", ActionKind.HOLD, "AUTO.LAND"),  # a failsafe
        ("px4", ActionKind.HOLD, "AUTO.RTL"),
        ("px4", ActionKind.LAND, "AUTO.RTL"),
        ("px4", ActionKind.TAKE_CONTROL, "AUTO.LAND"),
        ("ardupilot", ActionKind.HOLD, "LAND"),
        ("ardupilot", ActionKind.LAND, "RTL"),
    ],
)
def test_a_mode_that_was_chosen_meanwhile_is_not_asked_away(
    autopilot_kind: AutopilotKind, asked: ActionKind, chosen: str
) -> None:
    autopilot = autopilot_of(autopilot_kind)
    autopilot.deaf_to[mavlink.MAV_CMD_DO_SET_MODE] = 1

    def choose(_: PymavlinkActions, session: Session) -> None:
        autopilot.mode = chosen
        show(autopilot, session)

    result = meanwhile(autopilot, Action(asked), 0.1, choose)
    assert (result.accepted, result.text) == (False, f"the mode was changed to {chosen}")
    assert autopilot.mode == chosen
    assert len(autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE)) == 1


@pytest.mark.parametrize(
    ("kind", "comes_to", "mode", "accepted"),
    [
        ("px4", "OFFBOARD", "AUTO.LOITER", True),
        ("ardupilot", "GUIDED", "BRAKE", True),
        ("px4", "POSCTL", "POSCTL", True),  # its pilot's still
        ("ardupilot", "ALT_HOLD", "ALT_HOLD", True),  # chosen just now
        ("px4", "", "POSCTL", False),  # nobody tells
    ],
)
def test_control_is_returned_out_of_our_mode_alone_even_if_that_is_shown_only_now(
    kind: AutopilotKind, comes_to: str, mode: str, accepted: bool
) -> None:
    autopilot = FakeAutopilot(autopilot_kind=kind, mode="POSCTL" if kind == "px4" else "STABILIZE")

    def comes(_: PymavlinkActions, session: Session) -> None:
        if comes_to:
            autopilot.mode = comes_to
        else:
            session.receive = lambda data, now_s: None  # type: ignore[method-assign]

    result = meanwhile(autopilot, Action(ActionKind.HOLD_IF_OBEYED), 0.5, comes)
    assert (result.accepted, autopilot.mode) == (accepted, mode)
    assert len(autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE)) == (comes_to in {"OFFBOARD", "GUIDED"})


@pytest.mark.parametrize(
    ("sender", "hint"),
    [
        ((254, 190), "system 254 has one; link.ground_system_id is another"),
        ((255, 190), "component 190 sends one unasked: see link.beacon_component_id"),
    ],
)
def test_a_beacon_that_is_no_answer_is_a_hint(sender: tuple[int, int], hint: str) -> None:
    stranger = Codec(*sender)

    def answer(data: bytes, now_s: float) -> bytes:
        return stranger.encode(follow_target(PadBeacon(now_s, 47.0, 8.0, 400.0, (1.0, 0.0, 0.0), 1.0)))

    [result] = perform(FakeAutopilot(), Action(ActionKind.REQUEST_PAD_POSITION), ground=answer)
    assert not result.accepted
    assert f"no answer ({hint})" in result.text
