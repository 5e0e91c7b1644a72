"""Actions by our own session against a fake PX4 and a fake ArduPilot, in virtual time."""

import asyncio
import math
from dataclasses import replace

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import Action, ActionKind, ActionResult, PadBeacon
from companion.config import LinkConfig
from companion.link.actions.actions import PymavlinkActions
from companion.link.codec import Codec, mavlink
from companion.link.session import Session
from tests.unit.link.actions.action_flight import autopilot_of, fly, meanwhile, perform, show
from tests.unit.link.fake_autopilot import FakeAutopilot
from tests.unit.link.ground_beacon import follow_target

MODES: dict[AutopilotKind, dict[ActionKind, str]] = {
    "px4": {
        ActionKind.TAKE_CONTROL: "OFFBOARD",
        ActionKind.HOLD: "AUTO.LOITER",
        ActionKind.LAND: "AUTO.LAND",
    },
    "ardupilot": {ActionKind.TAKE_CONTROL: "GUIDED", ActionKind.HOLD: "BRAKE", ActionKind.LAND: "LAND"},
}
AUTOPILOT_KINDS: list[AutopilotKind] = ["px4", "ardupilot"]


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
def test_a_whole_flight_is_accepted(autopilot_kind: AutopilotKind) -> None:
    autopilot = autopilot_of(autopilot_kind)
    results = perform(
        autopilot,
        Action(ActionKind.ARM),
        Action(ActionKind.TAKE_OFF, height_m=7.0),
        Action(ActionKind.GO_TO, position=(47.0001, 8.0, 7.0), heading_rad=0.5),
        Action(ActionKind.TAKE_CONTROL),
        Action(ActionKind.HOLD),
        Action(ActionKind.LAND),
    )
    assert [r.text for r in results if not r.accepted] == []
    assert autopilot.armed
    assert autopilot.setpoints() == []


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
@pytest.mark.parametrize("kind", [ActionKind.TAKE_CONTROL, ActionKind.HOLD, ActionKind.LAND])
def test_modes_are_each_autopilots_own(autopilot_kind: AutopilotKind, kind: ActionKind) -> None:
    autopilot = autopilot_of(autopilot_kind)
    [result] = perform(autopilot, Action(kind))
    assert result.accepted
    assert autopilot.mode == MODES[autopilot_kind][kind]


@pytest.mark.parametrize("rises", [True, False])
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_near_the_ground_the_autopilot_rises_before_it_holds(
    autopilot_kind: AutopilotKind, rises: bool
) -> None:
    autopilot = autopilot_of(autopilot_kind)
    if not rises:
        autopilot.refuses[mavlink.MAV_CMD_DO_REPOSITION] = "no"
    [result] = perform(autopilot, Action(ActionKind.HOLD, height_m=2.0))
    assert (result.accepted, autopilot.mode) == (True, MODES[autopilot_kind][ActionKind.HOLD])
    [asked] = autopilot.commands(mavlink.MAV_CMD_DO_REPOSITION)
    assert (asked.x, asked.y, asked.z) == (470000000, 80000000, 402.0)  # where it is, 2 m up


def test_a_hold_that_is_asked_again_does_not_rise_again_from_where_it_is_then() -> None:
    autopilot = autopilot_of("px4")

    async def story(actions: PymavlinkActions, _: Session) -> list[ActionResult]:
        results = []
        for height_m in (0.3, 1.9, 2.4):
            autopilot.height_m = height_m
            await asyncio.sleep(1.0)
            results.append(await actions.perform(Action(ActionKind.HOLD, height_m=2.3)))
        return results

    assert [result.accepted for result in fly(autopilot, story)] == [True] * 3
    asked = [command.z for command in autopilot.commands(mavlink.MAV_CMD_DO_REPOSITION)]
    assert asked == pytest.approx([402.3, 402.3])


def test_a_disarmed_px4_leaves_offboard_for_hold() -> None:
    autopilot = FakeAutopilot(mode="OFFBOARD")
    [result] = perform(autopilot, Action(ActionKind.LEAVE_OFFBOARD))
    assert (result.accepted, autopilot.mode) == (True, "AUTO.LOITER")


@pytest.mark.parametrize(
    ("mode", "armed", "accepted"),
    [("POSCTL", False, True), ("POSCTL", True, True), ("OFFBOARD", True, False)],
)
def test_another_mode_and_an_armed_vehicle_are_let_be(mode: str, armed: bool, accepted: bool) -> None:
    autopilot = FakeAutopilot(mode=mode, armed=armed)
    [result] = perform(autopilot, Action(ActionKind.LEAVE_OFFBOARD))
    assert (result.accepted, autopilot.mode) == (accepted, mode)
    assert autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE) == []


def test_ardupilot_is_armed_and_takes_off_in_guided_mode() -> None:
    autopilot = autopilot_of("ardupilot")
    perform(autopilot, Action(ActionKind.ARM))
    assert (autopilot.mode, autopilot.armed) == ("GUIDED", True)


def test_px4_takes_off_to_an_altitude_over_the_sea_and_ardupilot_to_one_over_home() -> None:
    altitudes = {}
    for autopilot_kind in AUTOPILOT_KINDS:
        autopilot = autopilot_of(autopilot_kind)
        [result] = perform(autopilot, Action(ActionKind.TAKE_OFF, height_m=7.0))
        assert result.accepted
        [command] = autopilot.commands(mavlink.MAV_CMD_NAV_TAKEOFF)
        altitudes[autopilot_kind] = command.param7
    assert altitudes == pytest.approx({"px4": 407.0, "ardupilot": 7.0})


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
def test_going_somewhere_names_the_place_the_altitude_and_the_heading(autopilot_kind: AutopilotKind) -> None:
    autopilot = autopilot_of(autopilot_kind)
    perform(autopilot, Action(ActionKind.GO_TO, position=(47.0001, 8.0002, 7.0), heading_rad=0.5))
    [command] = autopilot.commands(mavlink.MAV_CMD_DO_REPOSITION)
    assert command.get_type() == "COMMAND_INT"
    assert (command.x, command.y) == (470001000, 80002000)
    assert command.z == pytest.approx(407.0)
    assert command.frame == mavlink.MAV_FRAME_GLOBAL
    assert (command.param2, command.param4) == pytest.approx((1.0, 0.5))


def test_without_a_heading_px4_is_reported_none() -> None:
    autopilot = autopilot_of("px4")
    perform(autopilot, Action(ActionKind.GO_TO, position=(47.0, 8.0, 7.0)))
    assert math.isnan(autopilot.commands(mavlink.MAV_CMD_DO_REPOSITION)[0].param4)


def test_a_refusal_carries_the_autopilots_words() -> None:
    refusal = "Arming denied: resolve system health failures first, then try again"
    autopilot = FakeAutopilot(refuses={mavlink.MAV_CMD_COMPONENT_ARM_DISARM: refusal})
    [result] = perform(autopilot, Action(ActionKind.ARM))
    assert not result.accepted
    assert result.text == f"denied; {refusal}"


def test_an_autopilot_that_does_not_answer_is_a_refusal_in_time() -> None:
    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        started_s = asyncio.get_running_loop().time()
        result = await actions.perform(Action(ActionKind.LAND))
        assert asyncio.get_running_loop().time() - started_s < 2.5
        return [result]

    autopilot = FakeAutopilot(deaf_to={mavlink.MAV_CMD_DO_SET_MODE: 99})
    [result] = fly(autopilot, story)
    assert (result.accepted, result.text) == (False, "the autopilot does not answer")


def test_an_action_that_fails_by_an_exception_has_a_result_and_the_next_is_performed() -> None:
    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        async def fails(_action: Action, _asked_in: str) -> None:
            raise RuntimeError("library")

        actions._handlers[ActionKind.LAND] = fails
        return [await actions.perform(Action(kind)) for kind in (ActionKind.LAND, ActionKind.HOLD)]

    failed, held = fly(FakeAutopilot(), story)
    assert (failed.kind, failed.accepted, failed.text) == (ActionKind.LAND, False, "RuntimeError: library")
    assert failed.in_doubt is None  # nothing had left
    assert held.accepted


def test_an_accepted_mode_that_does_not_come_is_a_refusal() -> None:
    [result] = perform(FakeAutopilot(keeps_mode=True), Action(ActionKind.TAKE_CONTROL))
    assert (result.accepted, result.text) == (False, "accepted, but not OFFBOARD")


def test_before_any_heartbeat_everything_is_refused() -> None:
    autopilot = FakeAutopilot(system_id=5)
    kinds = [ActionKind.ARM, ActionKind.TAKE_OFF, ActionKind.HOLD, ActionKind.TAKE_CONTROL]
    results = perform(autopilot, *(Action(kind) for kind in kinds))
    assert {(r.accepted, r.text) for r in results} == {(False, "no autopilot on the link")}


def test_without_home_nobody_goes_anywhere() -> None:
    autopilot = FakeAutopilot(deaf_to={mavlink.MAV_CMD_REQUEST_MESSAGE: 99})
    [result] = perform(autopilot, Action(ActionKind.GO_TO, position=(47.0, 8.0, 7.0)))
    assert (result.accepted, result.text) == (False, "the autopilot has not reported its home position")


def test_disarming_on_the_ground_needs_no_force() -> None:
    autopilot = FakeAutopilot(armed=True)
    [result] = perform(autopilot, Action(ActionKind.DISARM))
    assert result.accepted
    assert [m.param2 for m in autopilot.commands(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)] == [0.0]


@pytest.mark.parametrize(("asked", "allowed"), [(True, True), (True, False), (False, True)])
def test_an_autopilot_that_misses_the_touchdown_is_disarmed_by_force_where_asked_and_allowed(
    asked: bool, allowed: bool
) -> None:
    autopilot = FakeAutopilot(armed=True, believes_in_air=True)
    [result] = perform(
        autopilot, Action(ActionKind.DISARM, force=asked), config=LinkConfig(force_disarm=allowed)
    )
    assert result.accepted is (asked and allowed)
    assert autopilot.armed is not (asked and allowed)


def forced(autopilot: FakeAutopilot) -> list[float]:
    return [m.param2 for m in autopilot.commands(mavlink.MAV_CMD_COMPONENT_ARM_DISARM) if m.param2 != 0.0]


def test_silence_is_no_refusal_that_force_would_answer() -> None:
    autopilot = FakeAutopilot(armed=True, deaf_to={mavlink.MAV_CMD_COMPONENT_ARM_DISARM: 99})
    [result] = perform(autopilot, Action(ActionKind.DISARM, force=True), config=LinkConfig(force_disarm=True))
    assert (result.accepted, result.text) == (False, "the autopilot does not answer")
    assert forced(autopilot) == []


def test_a_vehicle_that_a_failsafe_has_taken_up_is_not_disarmed_by_force() -> None:
    autopilot = FakeAutopilot(armed=True, believes_in_air=True, mode="OFFBOARD")
    autopilot.deaf_to[mavlink.MAV_CMD_COMPONENT_ARM_DISARM] = 1

    def taken_up(_: PymavlinkActions, session: Session) -> None:
        autopilot.mode = "AUTO.RTL"
        show(autopilot, session)

    disarm = Action(ActionKind.DISARM, force=True)
    result = meanwhile(autopilot, disarm, 0.1, taken_up, LinkConfig(force_disarm=True))
    assert (result.accepted, result.text) == (False, "the autopilot has changed to AUTO.RTL")
    assert autopilot.armed
    assert forced(autopilot) == []


def test_the_pads_position_is_asked_of_the_ground_station() -> None:
    ground, asked = Codec(255, 190), []

    def answer(data: bytes, now_s: float) -> bytes:
        for message in Codec(255, 190).decode(data):
            if message.get_type() == "COMMAND_LONG" and message.target_system == 255:
                asked.append((message.command, message.param1))
                beacon = PadBeacon(now_s, 47.0, 8.0, 400.0, (1.0, 0.0, 0.0), 1.0)
                command = mavlink.MAV_CMD_REQUEST_MESSAGE
                us = message.get_srcSystem(), message.get_srcComponent()
                ack = mavlink.MAVLink_command_ack_message(command, mavlink.MAV_RESULT_ACCEPTED, 0, 0, *us)
                return ground.encode(ack) + ground.encode(follow_target(beacon))
        return b""

    [result] = perform(FakeAutopilot(), Action(ActionKind.REQUEST_PAD_POSITION), ground=answer)
    assert result.accepted
    assert asked == [(mavlink.MAV_CMD_REQUEST_MESSAGE, 144.0)]


def test_a_ground_station_that_is_not_there_is_a_refusal() -> None:
    [result] = perform(FakeAutopilot(), Action(ActionKind.REQUEST_PAD_POSITION))
    assert (result.accepted, result.text) == (False, "the ground station's answer: no answer")


def test_a_cancelled_action_is_not_repeated() -> None:
    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        task = asyncio.ensure_future(actions.perform(Action(ActionKind.LAND)))
        await asyncio.sleep(0.1)
        task.cancel()
        await asyncio.sleep(3.0)
        return []

    autopilot = FakeAutopilot(deaf_to={mavlink.MAV_CMD_DO_SET_MODE: 99})
    fly(autopilot, story)
    assert len(autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE)) == 1


def test_an_armed_ardupilot_is_not_put_into_guided_to_be_armed() -> None:
    autopilot = FakeAutopilot(autopilot_kind="ardupilot", mode="STABILIZE", armed=True)
    [result] = perform(autopilot, Action(ActionKind.ARM))
    assert (result.accepted, autopilot.mode) == (False, "STABILIZE")


@pytest.mark.parametrize("asked_first", [True, False])
def test_what_somebody_else_arms_before_our_request_is_answered_is_no_arming_of_ours(
    asked_first: bool,
) -> None:
    autopilot = FakeAutopilot(mode="POSCTL", armed=not asked_first)
    autopilot.deaf_to[mavlink.MAV_CMD_COMPONENT_ARM_DISARM] = 1

    def arms(_: PymavlinkActions, session: Session) -> None:
        autopilot.armed = True  # and it would accept our repeated request
        show(autopilot, session)

    result = meanwhile(autopilot, Action(ActionKind.ARM), 0.1, arms)
    assert (result.accepted, result.text) == (False, "armed before it has answered")
    assert len(autopilot.commands(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)) == asked_first
    assert result.in_doubt is (True if asked_first else None)  # it may as well have been ours


def test_a_mode_in_doubt_before_it_is_no_arming_that_has_left() -> None:
    # GIVEN an ArduPilot whose answer to GUIDED is lost, WHEN its pilot arms meanwhile
    autopilot = autopilot_of("ardupilot")
    autopilot.deaf_to[mavlink.MAV_CMD_DO_SET_MODE] = 99

    result = meanwhile(autopilot, Action(ActionKind.ARM), 0.8, lambda *_: setattr(autopilot, "armed", True))
    # THEN nothing of the request can have armed it
    assert (result.accepted, result.in_doubt) == (False, None)
    assert autopilot.commands(mavlink.MAV_CMD_COMPONENT_ARM_DISARM) == []


@pytest.mark.parametrize("deaf", [True, False])
def test_a_withdrawn_request_is_in_doubt_where_it_has_left(deaf: bool) -> None:
    autopilot = autopilot_of("px4")
    autopilot.deaf_to[mavlink.MAV_CMD_COMPONENT_ARM_DISARM] = 99 if deaf else 0

    after_s = 0.1 if deaf else 0.0
    result = meanwhile(autopilot, Action(ActionKind.ARM), after_s, lambda actions, _: actions.cancel())
    assert len(autopilot.commands(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)) == deaf
    assert (result.text, result.in_doubt) == ("withdrawn", True if deaf else None)


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
@pytest.mark.parametrize("kind", [ActionKind.ARM, ActionKind.TAKE_CONTROL, ActionKind.LAND])
def test_what_left_is_in_doubt_until_the_autopilot_denies_it_or_shows_it(
    autopilot_kind: AutopilotKind, kind: ActionKind
) -> None:
    number = mavlink.MAV_CMD_COMPONENT_ARM_DISARM if kind is ActionKind.ARM else mavlink.MAV_CMD_DO_SET_MODE
    doubts = {"unanswered": autopilot_of(autopilot_kind), "denied": autopilot_of(autopilot_kind)}
    doubts["unanswered"].deaf_to[number], doubts["denied"].refuses[number] = 99, "not now"
    if kind is ActionKind.TAKE_CONTROL:
        doubts["not shown"] = replace(autopilot_of(autopilot_kind), keeps_mode=True)
    for why, autopilot in doubts.items():
        [result] = perform(autopilot, Action(kind))
        assert (result.accepted, result.in_doubt) == (False, why != "denied"), result.text
