"""What the autopilot's parameters say of how it obeys: read once it is heard."""

from __future__ import annotations

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import AutopilotSetup
from companion.link.autopilot_setup import NAMES, SetupReader
from companion.link.codec import mavlink
from companion.link.parameters import ParameterRequests

TOLD: dict[str, float] = {
    "ANGLE_MAX": 3000.0, "WPNAV_ACCEL": 250.0, "PSC_JERK_XY": 5.0,
    "MOT_THST_HOVER": 0.36, "MPC_TILTMAX_AIR": 45.0, "MPC_THR_HOVER": 0.5,
}  # fmt: skip


def read(autopilot_kind: AutopilotKind, told: dict[str, float]) -> AutopilotSetup | None:
    """What a reader knows that has been answered for three seconds."""
    requests = ParameterRequests()
    reader = SetupReader(requests)
    reader.begin(autopilot_kind)
    for k in range(30):
        for message in requests.to_send(0.1 * k, 1):
            assert message.get_type() != "PARAM_SET"
            name = str(message.param_id)
            if name in told:
                answer = mavlink.MAVLink_param_value_message(name.encode(), told[name], 9, 1, 0)
                answer.param_id = name
                requests.heard(answer, autopilot_kind)
    return reader.setup


def test_nothing_is_known_before_the_answers() -> None:
    reader = SetupReader(ParameterRequests())
    assert reader.setup is None
    reader.begin("px4")
    assert reader.setup is None


@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_an_autopilot_without_these_parameters_is_taken_as_it_is_set(autopilot_kind: AutopilotKind) -> None:
    assert read(autopilot_kind, {}) == AutopilotSetup()


def test_both_autopilots_say_it_in_si_units() -> None:
    assert read("px4", TOLD) == AutopilotSetup(tilt_deg=45.0, hover_thrust=0.5)
    assert read("ardupilot", TOLD) == AutopilotSetup(30.0, 0.36, 2.5, 5.0)


def test_every_parameter_has_a_name_that_mavlink_can_carry() -> None:
    assert all(len(name) <= 16 for names in NAMES.values() for name in names)
