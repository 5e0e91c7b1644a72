"""Actions by our own session against a fake PX4 and a fake ArduPilot, in virtual time."""

from __future__ import annotations

import asyncio
import math

import pytest

from companion.base.clock import Clock
from companion.base.messages import Action, ActionKind, ActionResult, Manner, PadBeacon
from companion.config import LinkConfig
from companion.link.actions.actions import PymavlinkActions
from companion.link.beacon import follow_target
from companion.link.codec import Codec, mavlink
from companion.link.session import Session
from tests.unit.link.actions.acting import autopilot_of, cancel_after, fly, perform
from tests.unit.link.fake_autopilot import FakeAutopilot

MODES: dict[Manner, dict[ActionKind, str]] = {
    "px4": {
        ActionKind.TAKE_CONTROL: "OFFBOARD",
        ActionKind.HOLD: "AUTO.LOITER",
        ActionKind.LAND: "AUTO.LAND",
    },
    "ardupilot": {
        ActionKind.TAKE_CONTROL: "GUIDED",
        ActionKind.HOLD: "BRAKE",
        ActionKind.LAND: "LAND",
    },
}


MANNERS: list[Manner] = ["px4", "ardupilot"]


@pytest.mark.parametrize("manner", MANNERS)
def test_a_whole_flight_is_accepted(manner: Manner) -> None:
    autopilot = autopilot_of(manner)
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


@pytest.mark.parametrize("manner", MANNERS)
@pytest.mark.parametrize("kind", [ActionKind.TAKE_CONTROL, ActionKind.HOLD, ActionKind.LAND])
def test_modes_are_each_autopilots_own(manner: Manner, kind: ActionKind) -> None:
    autopilot = autopilot_of(manner)
    [result] = perform(autopilot, Action(kind))
    assert result.accepted
    assert autopilot.mode == MODES[manner][kind]


def test_ardupilot_is_armed_and_takes_off_in_guided_mode() -> None:
    autopilot = autopilot_of("ardupilot")
    perform(autopilot, Action(ActionKind.ARM))
    assert (autopilot.mode, autopilot.armed) == ("GUIDED", True)


def test_px4_takes_off_to_an_altitude_over_the_sea_and_ardupilot_to_one_over_home() -> None:
    altitudes = {}
    for manner in MANNERS:
        autopilot = autopilot_of(manner)
        [result] = perform(autopilot, Action(ActionKind.TAKE_OFF, height_m=7.0))
        assert result.accepted
        [command] = autopilot.commands(mavlink.MAV_CMD_NAV_TAKEOFF)
        altitudes[manner] = command.param7
    assert altitudes == pytest.approx({"px4": 407.0, "ardupilot": 7.0})


@pytest.mark.parametrize("manner", MANNERS)
def test_going_somewhere_names_the_place_the_altitude_and_the_heading(manner: Manner) -> None:
    autopilot = autopilot_of(manner)
    perform(autopilot, Action(ActionKind.GO_TO, position=(47.0001, 8.0002, 7.0), heading_rad=0.5))
    [command] = autopilot.commands(mavlink.MAV_CMD_DO_REPOSITION)
    assert command.get_type() == "COMMAND_INT"
    assert (command.x, command.y) == (470001000, 80002000)
    assert command.z == pytest.approx(407.0)
    assert command.frame == mavlink.MAV_FRAME_GLOBAL
    assert (command.param2, command.param4) == pytest.approx((1.0, 0.5))


def test_without_a_heading_px4_is_told_none() -> None:
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


def test_an_accepted_mode_that_does_not_come_is_a_refusal() -> None:
    class Stubborn(FakeAutopilot):
        def _mode(self, main: int, sub: int) -> str:
            return "AUTO.LOITER"

    [result] = perform(Stubborn(), Action(ActionKind.TAKE_CONTROL))
    assert (result.accepted, result.text) == (False, "accepted, but not OFFBOARD")


def test_before_any_heartbeat_everything_is_refused() -> None:
    autopilot = FakeAutopilot(system_id=5)
    kinds = [ActionKind.ARM, ActionKind.TAKE_OFF, ActionKind.HOLD, ActionKind.TAKE_CONTROL]
    results = perform(autopilot, *(Action(kind) for kind in kinds))
    assert {(r.accepted, r.text) for r in results} == {(False, "no autopilot is heard")}


def test_without_home_nobody_goes_anywhere() -> None:
    autopilot = FakeAutopilot(deaf_to={mavlink.MAV_CMD_REQUEST_MESSAGE: 99})
    [result] = perform(autopilot, Action(ActionKind.GO_TO, position=(47.0, 8.0, 7.0)))
    assert (result.accepted, result.text) == (False, "the autopilot has not told its home position")


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

    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        asking = asyncio.ensure_future(actions.perform(Action(ActionKind.DISARM, force=True)))
        await asyncio.sleep(0.1)
        autopilot.mode = "AUTO.RTL"
        session.receive(autopilot.codec.encode(autopilot.message(0, 0.0)), Clock().now_s())
        return [await asking]

    [result] = fly(autopilot, story, LinkConfig(force_disarm=True))
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
                return ground.encode(follow_target(beacon))
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


# ---------------------------------------------------------------- what thrust means to ArduPilot


def take_control_by_attitude(
    autopilot: FakeAutopilot, kind: ActionKind = ActionKind.TAKE_CONTROL, set_parameters: bool = False
) -> ActionResult:
    config = LinkConfig(set_parameters=set_parameters)
    [result] = perform(autopilot, Action(kind), config=config, attitude_setpoints=True)
    return result


def sent(autopilot: FakeAutopilot, kind: str) -> list[str]:
    return [m.param_id for m in autopilot.heard if m.get_type() == kind]


@pytest.mark.parametrize("kind", [ActionKind.ARM, ActionKind.TAKE_CONTROL])
@pytest.mark.parametrize("options", [0, 1, 16])
def test_without_the_thrust_bit_attitude_setpoints_are_refused_before_anything_happens(
    options: int, kind: ActionKind
) -> None:
    autopilot = autopilot_of("ardupilot")
    autopilot.parameters["GUID_OPTIONS"] = options
    result = take_control_by_attitude(autopilot, kind)
    assert not result.accepted
    assert result.text == (
        f"GUID_OPTIONS is {options}: thrust is read as climb rate; expected {options + 8}, "
        "which link.set_parameters lets us set, or control.setpoint velocity"
    )
    assert (autopilot.mode, autopilot.armed) == ("STABILIZE", False)
    assert sent(autopilot, "PARAM_SET") == []


@pytest.mark.parametrize("options", [8, 9, 255])
def test_with_the_thrust_bit_control_is_taken(options: int) -> None:
    autopilot = autopilot_of("ardupilot")
    autopilot.parameters["GUID_OPTIONS"] = options
    assert take_control_by_attitude(autopilot, set_parameters=True).accepted
    assert sent(autopilot, "PARAM_SET") == []


def test_the_thrust_bit_is_set_beside_the_others_where_allowed() -> None:
    autopilot = autopilot_of("ardupilot")
    autopilot.parameters["GUID_OPTIONS"] = 1
    assert take_control_by_attitude(autopilot, set_parameters=True).accepted
    assert autopilot.parameters["GUID_OPTIONS"] == 9
    assert autopilot.mode == "GUIDED"


def test_a_parameter_that_cannot_be_set_is_a_refusal() -> None:
    autopilot = autopilot_of("ardupilot")
    autopilot.keeps_parameters = True
    result = take_control_by_attitude(autopilot, set_parameters=True)
    assert (result.accepted, result.text[:18]) == (False, "GUID_OPTIONS is 0:")


def test_a_lost_question_for_a_parameter_is_repeated() -> None:
    autopilot = autopilot_of("ardupilot")
    autopilot.parameters["GUID_OPTIONS"] = 8
    autopilot.deaf_to_parameters = 2
    assert take_control_by_attitude(autopilot).accepted
    assert len(sent(autopilot, "PARAM_REQUEST_READ")) == 3


def test_a_parameter_that_is_not_told_is_a_refusal() -> None:
    autopilot = autopilot_of("ardupilot")
    autopilot.deaf_to_parameters = 99
    result = take_control_by_attitude(autopilot)
    assert (result.accepted, result.text) == (False, "the autopilot does not tell its GUID_OPTIONS")


def test_cancelling_ends_the_question_for_a_parameter() -> None:
    autopilot = autopilot_of("ardupilot")
    autopilot.deaf_to_parameters = 99
    [result] = cancel_after(autopilot, 0.1, Action(ActionKind.TAKE_CONTROL), attitude_setpoints=True)
    assert result.text == "withdrawn"
    assert len(sent(autopilot, "PARAM_REQUEST_READ")) == 1


@pytest.mark.parametrize(("manner", "attitude_setpoints"), [("px4", True), ("ardupilot", False)])
def test_where_thrust_is_thrust_or_is_not_sent_no_parameter_is_asked_for(
    manner: Manner, attitude_setpoints: bool
) -> None:
    autopilot = autopilot_of(manner)
    [result] = perform(autopilot, Action(ActionKind.TAKE_CONTROL), attitude_setpoints=attitude_setpoints)
    assert result.accepted
    assert sent(autopilot, "PARAM_REQUEST_READ") == []
