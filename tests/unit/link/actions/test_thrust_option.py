"""Parameters without which nothing begins: ArduPilot's meaning of thrust, PX4's failsafe of setpoints."""

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import Action, ActionKind, ActionResult, AutopilotSetup
from companion.config import LinkConfig
from companion.link.actions.actions import PymavlinkActions
from companion.link.session import Session
from tests.unit.link.actions.action_flight import autopilot_of, cancel_after, fly, perform
from tests.unit.link.fake_autopilot import FakeAutopilot


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


@pytest.mark.parametrize(
    ("behaviour", "words"),
    [
        ({"keeps_parameters": True}, "GUID_OPTIONS is 0:"),
        ({"deaf_to_parameters": 99}, "the autopilot does not report its GUID_OPTIONS"),
    ],
)
def test_a_parameter_that_is_not_reported_or_cannot_be_set_is_a_refusal(
    behaviour: dict[str, Any], words: str
) -> None:
    autopilot = replace(autopilot_of("ardupilot"), **behaviour)
    result = take_control_by_attitude(autopilot, set_parameters=True)
    assert (result.accepted, result.text[: len(words)]) == (False, words)


def test_a_lost_question_for_a_parameter_is_repeated() -> None:
    autopilot = autopilot_of("ardupilot")
    autopilot.parameters["GUID_OPTIONS"] = 8
    autopilot.deaf_to_parameters = 2
    assert take_control_by_attitude(autopilot).accepted
    assert len(sent(autopilot, "PARAM_REQUEST_READ")) == 3


def test_cancelling_ends_the_question_for_a_parameter() -> None:
    autopilot = autopilot_of("ardupilot")
    autopilot.deaf_to_parameters = 99
    [result] = cancel_after(autopilot, 0.1, Action(ActionKind.TAKE_CONTROL), attitude_setpoints=True)
    assert result.text == "withdrawn"
    assert len(sent(autopilot, "PARAM_REQUEST_READ")) == 1


@pytest.mark.parametrize(("autopilot_kind", "attitude_setpoints"), [("px4", True), ("ardupilot", False)])
def test_where_thrust_is_thrust_or_is_not_sent_no_parameter_is_asked_for(
    autopilot_kind: AutopilotKind, attitude_setpoints: bool
) -> None:
    autopilot = autopilot_of(autopilot_kind)
    [result] = perform(autopilot, Action(ActionKind.TAKE_CONTROL), attitude_setpoints=attitude_setpoints)
    assert result.accepted
    assert sent(autopilot, "PARAM_REQUEST_READ") == []


@pytest.mark.parametrize("kind", [ActionKind.ARM, ActionKind.TAKE_CONTROL])
@pytest.mark.parametrize(
    ("setup", "why"),
    [
        (
            AutopilotSetup(setpoints_lost_action=6),
            "COM_OBL_RC_ACT is 6 (Terminate): the motors stop in the air",
        ),
        (
            AutopilotSetup(setpoint_timeout_s=0.3, setpoints_lost_action=5),
            "COM_OF_LOSS_T is 0.3: its Hold would drag",
        ),
    ],
    ids=["motors stop", "short time-out"],
)
def test_what_is_unsafe_without_setpoints_lets_nothing_begin(
    kind: ActionKind, setup: AutopilotSetup, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Session, "setup", property(lambda _session: setup))
    autopilot = autopilot_of("px4")
    before = (autopilot.mode, autopilot.armed)
    [result] = perform(autopilot, Action(kind), attitude_setpoints=False)
    assert not result.accepted
    assert result.text.startswith(why)
    assert (autopilot.mode, autopilot.armed) == before


@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("kind", [ActionKind.ARM, ActionKind.TAKE_CONTROL])
def test_before_the_parameters_are_read_nothing_begins(
    kind: ActionKind, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN parameters that are read a second after the request, or never
    known: list[AutopilotSetup] = []
    monkeypatch.setattr(Session, "setup", property(lambda _session: known[0] if known else None))
    autopilot = autopilot_of("px4")
    before = (autopilot.mode, autopilot.armed)

    async def story(actions: PymavlinkActions, session: Session) -> list[ActionResult]:
        session.reads_setup = True
        asked = asyncio.ensure_future(actions.perform(Action(kind)))
        await asyncio.sleep(1.0)
        assert (autopilot.mode, autopilot.armed) == before
        known.extend([AutopilotSetup(setpoint_timeout_s=1.0, setpoints_lost_action=5)] * told)
        return [await asked]

    [result] = fly(autopilot, story)
    assert result.accepted is told
    assert told or "not read yet" in result.text
