"""What the autopilot's parameters say of how it obeys: read once it is heard, one written where allowed."""

from __future__ import annotations

import pytest

from companion.link.autopilot_setup import NAMES, SetupReader
from companion.link.codec import mavlink
from companion.link.parameters import ParameterRequests
from companion.messages import AutopilotSetup, Manner

TOLD: dict[str, float] = {
    "GUID_OPTIONS": 1.0, "ANGLE_MAX": 3000.0, "WPNAV_ACCEL": 250.0, "PSC_JERK_XY": 5.0,
    "MOT_THST_HOVER": 0.36, "MPC_TILTMAX_AIR": 45.0, "MPC_THR_HOVER": 0.5,
}  # fmt: skip


def read(manner: Manner, told: dict[str, float], *, may_set: bool = False) -> tuple[SetupReader, list[float]]:
    """A reader that has been answered for three seconds, and what it has set."""
    requests = ParameterRequests()
    reader, written = SetupReader(requests, may_set=may_set), list[float]()
    known = dict(told)
    reader.begin(manner)
    for k in range(30):
        reader.step()
        for message in requests.to_send(0.1 * k, 1):
            name = str(message.param_id)
            if message.get_type() == "PARAM_SET":
                known[name] = message.param_value
                written.append(message.param_value)
            if name in known:
                answer = mavlink.MAVLink_param_value_message(name.encode(), known[name], 9, 1, 0)
                answer.param_id = name
                requests.heard(answer)
    return reader, written


def test_nothing_is_known_before_the_answers() -> None:
    reader = SetupReader(ParameterRequests(), may_set=False)
    assert reader.setup is None
    reader.begin("px4")
    assert reader.setup is None


@pytest.mark.parametrize("manner", ["px4", "ardupilot"])
def test_an_autopilot_without_these_parameters_is_taken_as_it_is_set(manner: Manner) -> None:
    reader, _ = read(manner, {})
    assert reader.setup == AutopilotSetup(takes_thrust=manner == "px4")


def test_both_autopilots_say_it_in_si_units() -> None:
    px4, _ = read("px4", TOLD)
    assert px4.setup == AutopilotSetup(tilt_deg=45.0, hover_thrust=0.5)
    ardupilot, written = read("ardupilot", TOLD)
    assert ardupilot.setup == AutopilotSetup(30.0, 0.36, 2.5, 5.0, takes_thrust=False)
    assert written == []


def test_where_it_may_thrust_is_made_thrust_and_the_other_bits_stay() -> None:
    reader, written = read("ardupilot", TOLD, may_set=True)
    assert written == [9.0]
    assert reader.setup is not None
    assert reader.setup.takes_thrust


def test_thrust_that_is_thrust_already_is_left_alone() -> None:
    reader, written = read("ardupilot", {**TOLD, "GUID_OPTIONS": 8.0}, may_set=True)
    assert written == []
    assert reader.setup is not None
    assert reader.setup.takes_thrust


def test_every_parameter_has_a_name_that_mavlink_can_carry() -> None:
    assert all(len(name) <= 16 for names in NAMES.values() for name in names)
