"""What the autopilot's parameters say of how it obeys: read once it is heard."""

from dataclasses import replace

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.messages import AutopilotSetup
from companion.link.autopilot_setup import UNREAD, SetupReader, loss_refusal, loss_warnings, setup_refusal
from companion.link.codec import mavlink
from companion.link.commands import ParameterRequests

TOLD: dict[str, float] = {
    "ANGLE_MAX": 3000.0, "WPNAV_ACCEL": 250.0, "PSC_JERK_XY": 5.0,
    "MOT_THST_HOVER": 0.36, "MPC_TILTMAX_AIR": 45.0, "MPC_THR_HOVER": 0.5,
    "COM_OF_LOSS_T": 0.5, "GUID_TIMEOUT": 0.6,
    "FENCE_ENABLE": 1.0, "FENCE_TYPE": 7.0, "FENCE_ACTION": 1.0, "FS_GCS_ENABLE": 0.0, "SYSID_MYGCS": 255.0,
}  # fmt: skip


class AnsweredReader(SetupReader):
    """One that has begun, and that the autopilot answers."""

    def __init__(self, kind: AutopilotKind) -> None:
        self.requests, self.kind = ParameterRequests(), kind
        super().__init__(self.requests)
        self.begin(kind)

    def answered(self, told: dict[str, float], during: int = 30) -> "AnsweredReader":
        """Tenths of a second in which the autopilot answers."""
        for k in range(during):
            for message in self.requests.to_send(0.1 * k, 1):
                assert message.get_type() != "PARAM_SET"
                name = str(message.param_id)
                if name in told:
                    reply = mavlink.MAVLink_param_value_message(name.encode(), told[name], 9, 1, 0)
                    reply.param_id = name
                    self.requests.heard(reply, self.kind)
        return self


def read(autopilot_kind: AutopilotKind, told: dict[str, float]) -> AutopilotSetup | None:
    """What a reader knows that has been answered for three seconds."""
    return AnsweredReader(autopilot_kind).answered(told).setup


def test_a_parameter_that_was_corrected_is_known_once_asked_for_afresh() -> None:
    reader = AnsweredReader("ardupilot").answered(TOLD | {"GUID_TIMEOUT": 3.0})
    before = reader.setup
    assert before is not None
    reader.renew()
    assert reader.setup == before  # until it has been answered
    reader.answered(TOLD)
    assert reader.setup == AutopilotSetup(30.0, 0.36, 2.5, 5.0, 0.6, drift_ends=True)
    reader.begin("px4")
    assert reader.setup is None  # nothing of the other one's counts


def test_what_follows_a_silence_is_fresh_once_it_has_been_answered_again() -> None:
    # GIVEN an autopilot that lacks a parameter, which is asked for in vain for two seconds
    told = TOLD | {"GUID_TIMEOUT": 3.0}
    del told["PSC_JERK_XY"]
    reader = AnsweredReader("ardupilot").answered(told)
    fresh = [reader.loss_is_fresh]
    # WHEN it is asked afresh
    reader.renew()
    fresh.append(reader.loss_is_fresh)
    reader.answered(told | {"GUID_TIMEOUT": 0.5}, during=1)
    # THEN what matters is not waited for with the rest
    assert [*fresh, reader.loss_is_fresh] == [True, False, True]
    assert reader.setup is not None
    assert reader.setup.setpoint_timeout_s == 0.5
    assert reader.setup.hover_thrust == TOLD["MOT_THST_HOVER"]


def test_what_a_bad_link_leaves_unanswered_is_known_still() -> None:
    reader = AnsweredReader("px4").answered(TOLD | {"COM_OBL_RC_ACT": 4.0})
    before = reader.setup
    reader.renew()
    reader.answered({})
    assert reader.loss_is_fresh
    assert reader.setup == before


def test_what_nothing_can_change_any_more_is_not_put_together_again() -> None:
    """It is asked for in every control cycle, and by each that it is late."""
    reader = AnsweredReader("px4").answered(TOLD)
    assert reader.setup is not None
    assert reader.setup is reader.setup


def test_arducopter_4_7_s_names_and_units_are_known() -> None:
    told = {
        "ATC_ANGLE_MAX": 25.0,
        "WP_ACC": 1.5,
        "PSC_NE_JERK": 4.0,
        "MOT_THST_HOVER": 0.3,
        "GUID_TIMEOUT": 1.0,
        "FS_GCS_ENABLE": 5.0,
        "MAV_GCS_SYSID": 1.0,
    }
    assert read("ardupilot", told) == AutopilotSetup(25.0, 0.3, 1.5, 4.0, 1.0, drift_ends=True)


def test_nothing_is_known_before_the_answers() -> None:
    reader = SetupReader(ParameterRequests())
    assert reader.setup is None
    reader.begin("px4")
    assert reader.setup is None


@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_an_autopilot_without_these_parameters_is_taken_as_it_is_set(autopilot_kind: AutopilotKind) -> None:
    nothing = {"px4": AutopilotSetup(), "ardupilot": AutopilotSetup(drift_ends=False)}
    assert read(autopilot_kind, {}) == nothing[autopilot_kind]


def test_both_autopilots_say_it_in_si_units() -> None:
    assert read("px4", TOLD) == AutopilotSetup(tilt_deg=45.0, hover_thrust=0.5, setpoint_timeout_s=0.5)
    assert read("ardupilot", TOLD) == AutopilotSetup(30.0, 0.36, 2.5, 5.0, 0.6, drift_ends=True)


def test_every_parameter_has_a_name_that_mavlink_can_carry() -> None:
    assert all(len(name) <= 16 for profile in PROFILES.values() for name in profile.read_parameters)


# ---------------------------------------------------------------- the loss of setpoints


GUIDED = AutopilotSetup(setpoint_timeout_s=1.0, guided_options=1)


def warnings_of(setup: AutopilotSetup, kind: AutopilotKind, *, by_attitude: bool = True) -> list[str]:
    return loss_warnings(setup, kind, by_attitude=by_attitude)


@pytest.mark.parametrize("action", [3, 4, 5])
def test_a_failsafe_that_holds_or_lands_is_no_matter(action: int) -> None:
    setup = AutopilotSetup(setpoint_timeout_s=1.0, setpoints_lost_action=action)
    assert loss_refusal(setup, "px4") == ""
    assert warnings_of(setup, "px4") == []


@pytest.mark.parametrize(
    ("kind", "setup", "names"),
    [
        ("px4", AutopilotSetup(), "COM_OF_LOSS_T and COM_OBL_RC_ACT"),
        ("px4", AutopilotSetup(setpoints_lost_action=5), "COM_OF_LOSS_T"),
        ("px4", AutopilotSetup(setpoint_timeout_s=1.0), "COM_OBL_RC_ACT"),
        ("ardupilot", AutopilotSetup(), "GUID_TIMEOUT"),
    ],
)
def test_what_is_not_reported_is_not_unlimited(
    kind: AutopilotKind, setup: AutopilotSetup, names: str
) -> None:
    why = f"the autopilot does not report {names}: "
    assert loss_refusal(setup, kind).startswith(why)
    assert warnings_of(setup, kind)[0].startswith(f"link loss: {why}")


@pytest.mark.parametrize(
    ("changed", "ends"),
    [
        ({}, True),
        ({"FENCE_ENABLE": 0.0}, False),
        ({"FENCE_TYPE": 5.0}, False),  # no circle
        ({"FENCE_ACTION": 0.0}, False),  # is reported only
        ({"FENCE_ENABLE": 0.0, "FS_GCS_ENABLE": 5.0}, False),  # another's heartbeats
        ({"FENCE_ENABLE": 0.0, "FS_GCS_ENABLE": 5.0, "SYSID_MYGCS": 1.0}, True),
        ({"FENCE_ENABLE": 0.0, "FS_GCS_ENABLE": 0.0, "SYSID_MYGCS": 1.0}, False),
    ],
)
def test_an_ardupilot_that_nothing_stops_drifting_is_warned_of(changed: dict[str, float], ends: bool) -> None:
    setup = read("ardupilot", TOLD | changed)
    assert setup is not None
    assert setup.drift_ends is ends
    assert loss_refusal(setup, "ardupilot") == ""
    found = warnings_of(setup, "ardupilot")
    assert all("FENCE_ENABLE" in text and "FS_GCS_ENABLE" in text for text in found)
    assert bool(found) is not ends
    assert warnings_of(setup, "ardupilot", by_attitude=False) == []  # by velocity it stops


@pytest.mark.parametrize(
    ("setup", "kind", "by_attitude", "may_set", "why"),
    [
        (None, "px4", False, False, UNREAD),
        (None, "ardupilot", True, True, UNREAD),
        (AutopilotSetup(setpoint_timeout_s=3.0), "ardupilot", True, False, "GUID_TIMEOUT is 3: it keeps"),
        (AutopilotSetup(setpoint_timeout_s=3.0), "ardupilot", False, True, "GUID_TIMEOUT is 3: it keeps"),
        (GUIDED, "ardupilot", True, False, "GUID_OPTIONS is 1: thrust is read as climb rate; expected 9, "),
        (GUIDED, "ardupilot", True, True, ""),  # the app sets it
        (GUIDED, "ardupilot", False, False, ""),  # no thrust is sent
        (replace(GUIDED, guided_options=9), "ardupilot", True, False, ""),
        (replace(GUIDED, guided_options=None), "ardupilot", True, True, "the autopilot does not report its"),
        (AutopilotSetup(setpoint_timeout_s=1.0, setpoints_lost_action=5), "px4", True, False, ""),
    ],
)
def test_what_refuses_control_is_known_beforehand(
    setup: AutopilotSetup | None, kind: AutopilotKind, by_attitude: bool, may_set: bool, why: str
) -> None:
    found = setup_refusal(setup, kind, by_attitude=by_attitude, may_set=may_set)
    assert found.startswith(why)
    assert bool(found) is bool(why)


def test_a_failsafe_for_a_pilot_at_the_sticks_is_warned_of() -> None:
    setup = AutopilotSetup(setpoint_timeout_s=1.0, setpoints_lost_action=0)
    (warning,) = warnings_of(setup, "px4")
    assert warning.startswith("link loss: COM_OBL_RC_ACT is 0 (Position)")
    assert loss_refusal(setup, "px4") == ""


@pytest.mark.parametrize("action", [6, 7])
def test_a_failsafe_that_stops_the_motors_is_no_way_to_fly(action: int) -> None:
    assert loss_refusal(AutopilotSetup(setpoints_lost_action=action), "px4").startswith(
        f"COM_OBL_RC_ACT is {action} ("
    )


@pytest.mark.parametrize(
    ("kind", "action", "timeout_s", "refused"),
    [
        ("px4", 5, 0.3, "COM_OF_LOSS_T is 0.3: its Hold would drag the vehicle"),
        ("px4", 5, 0.9, "COM_OF_LOSS_T is 0.9: its Hold would drag the vehicle"),
        ("px4", 5, 1.0, ""),
        ("px4", 4, 0.5, ""),
        ("px4", 4, 0.2, "COM_OF_LOSS_T is 0.2: too short to detect the lost link"),
        ("ardupilot", None, 0.5, ""),
        ("ardupilot", None, 0.1, "GUID_TIMEOUT is 0.1: too short to detect the lost link"),
        ("ardupilot", None, 1.0, ""),
        ("ardupilot", None, 3.0, "GUID_TIMEOUT is 3: it keeps the last tilt this long"),
        ("px4", 5, 1.1, "COM_OF_LOSS_T is 1.1: it keeps the last tilt this long"),
    ],
)
def test_a_time_out_shorter_or_longer_than_a_landing_bears_is_no_way_to_fly(
    kind: AutopilotKind, action: int | None, timeout_s: float, refused: str
) -> None:
    setup = AutopilotSetup(setpoint_timeout_s=timeout_s, setpoints_lost_action=action)
    text = loss_refusal(setup, kind)
    assert text.startswith(refused)
    assert bool(text) == bool(refused)
    assert not text or text.endswith(("expected 1 s", "expected 0.3 to 1 s"))
    about_it = [warning for warning in warnings_of(setup, kind) if f" {timeout_s:g}: " in warning]
    assert len(about_it) == bool(refused)  # once
