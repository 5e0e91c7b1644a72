"""Telemetry: what the autopilot says of itself, as the app sees it."""

import math
from dataclasses import replace

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES, custom_mode, mode_name, mode_parameters
from companion.base.geometry import euler_from_quat, quat_from_euler
from companion.base.messages import AutopilotState, LandedState
from companion.link.codec import CurrentMode, Message, mavlink, status_texts
from companion.link.telemetry.telemetry import StatusTexts, add_text, update_state, without_old
from tests.unit.link.telemetry.autopilot_readings import packed

FRESH = AutopilotState(time_s=0.0)
OUTPUTS = mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS


def after(message: Message, state: AutopilotState = FRESH, time_s: float = 1.0) -> AutopilotState:
    return update_state(state, packed(message), time_s)


def heartbeat(
    autopilot: int, mode: int, base_mode: int = 1, status: int = mavlink.MAV_STATE_ACTIVE
) -> Message:
    return mavlink.MAVLink_heartbeat_message(2, autopilot, base_mode, mode, status, 3)


@pytest.mark.parametrize("mode", PROFILES["px4"].modes)
def test_px4_modes_have_their_names(mode: str) -> None:
    state = after(heartbeat(mavlink.MAV_AUTOPILOT_PX4, custom_mode("px4", mode)))
    assert (state.connected, state.autopilot_kind, state.mode) == (True, "px4", mode)
    assert state.offboard == (mode == "OFFBOARD")


@pytest.mark.parametrize("mode", PROFILES["ardupilot"].modes)
def test_arducopter_modes_have_their_names(mode: str) -> None:
    state = after(heartbeat(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, custom_mode("ardupilot", mode)))
    assert (state.connected, state.autopilot_kind, state.mode) == (True, "ardupilot", mode)
    assert state.offboard == (mode == "GUIDED")


@pytest.mark.parametrize(
    ("vehicle", "kind"),
    [
        (mavlink.MAV_TYPE_HEXAROTOR, "px4"),
        (mavlink.MAV_TYPE_FIXED_WING, None),
        (mavlink.MAV_TYPE_GROUND_ROVER, None),
        (mavlink.MAV_TYPE_VTOL_TILTROTOR, None),
        (mavlink.MAV_TYPE_GENERIC, None),
    ],
)
def test_what_is_no_multirotor_is_not_flown(vehicle: int, kind: str | None) -> None:
    state = after(mavlink.MAVLink_heartbeat_message(vehicle, mavlink.MAV_AUTOPILOT_PX4, 1, 6 << 16, 4, 3))
    assert state.connected
    assert (state.autopilot_kind, state.offboard) == (kind, kind is not None)


def test_well_known_numbers_of_modes() -> None:
    assert custom_mode("px4", "OFFBOARD") == 393216
    assert custom_mode("px4", "AUTO.LAND") == 100925440
    assert mode_parameters("px4", "AUTO.LOITER") == (1.0, 4.0, 3.0)
    assert mode_parameters("ardupilot", "GUIDED") == (1.0, 4.0, 0.0)


@pytest.mark.parametrize(
    ("autopilot_kind", "number", "name"),
    [
        ("px4", (3 << 16) | (2 << 24), "POSCTL"),
        ("px4", 99 << 16, "mode 6488064"),
        ("ardupilot", 77, "mode 77"),
    ],
)
def test_a_mode_that_is_not_known_is_still_shown(
    autopilot_kind: AutopilotKind, number: int, name: str
) -> None:
    assert mode_name(autopilot_kind, number) == name


def test_an_autopilot_of_another_make_is_connected_but_has_no_profile() -> None:
    state = after(heartbeat(mavlink.MAV_AUTOPILOT_GENERIC, 4))
    assert (state.connected, state.autopilot_kind, state.offboard) == (True, None, False)


def test_armed_is_heard_from_the_heartbeat() -> None:
    assert after(heartbeat(12, 0, base_mode=129)).armed
    assert not after(heartbeat(12, 0, base_mode=1)).armed


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, 270])
@pytest.mark.parametrize("tilt_deg", [0.0, 25.0])
def test_both_kinds_of_attitude_say_the_same(yaw_deg: int, tilt_deg: float) -> None:
    angles = (math.radians(tilt_deg), math.radians(-0.5 * tilt_deg), math.radians(yaw_deg))
    q = quat_from_euler(*angles)
    by_angles = after(mavlink.MAVLink_attitude_message(10, *angles, 0.0, 0.0, 0.0))
    by_quaternion = after(mavlink.MAVLink_attitude_quaternion_message(10, *q, 0.0, 0.0, 0.0))
    assert by_angles.attitude == pytest.approx(q, abs=1e-6)
    assert by_quaternion.attitude == pytest.approx(q, abs=1e-6)
    assert by_angles.attitude is not None
    assert math.remainder(euler_from_quat(by_angles.attitude)[2] - angles[2], math.tau) == pytest.approx(
        0.0, abs=1e-6
    )


@pytest.mark.parametrize(
    "message",
    [
        mavlink.MAVLink_attitude_message(10, math.nan, 0.0, 0.0, 0.0, 0.0, 0.0),
        mavlink.MAVLink_attitude_quaternion_message(10, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        mavlink.MAVLink_attitude_quaternion_message(10, math.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        mavlink.MAVLink_global_position_int_message(10, 0, 0, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_home_position_message(0, 0, 0, 0, 0, 0, [1.0, 0, 0, 0], 0, 0, 0),
    ],
)
def test_values_that_are_no_values_change_nothing(message: Message) -> None:
    assert after(message) == FRESH


def test_an_attitude_older_than_the_last_one_is_dropped() -> None:
    newer = after(mavlink.MAVLink_attitude_message(10, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), time_s=2.0)
    assert after(mavlink.MAVLink_attitude_message(9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), newer, 1.9) == newer


def test_a_version_that_has_not_been_flown_is_named_beside_those_that_have() -> None:
    told = mavlink.MAVLink_autopilot_version_message(
        0, 1 << 24 | 18 << 16 | 2 << 8 | 64, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
    )
    version = after(told).version
    assert version == (1, 18, 2)
    assert PROFILES["px4"].unflown(version) == "PX4 1.18.2 has not been flown; flown: 1.16, 1.17"
    assert PROFILES["px4"].unflown((1, 16, 0)) == PROFILES["px4"].unflown(None) == ""


def test_a_position_comes_in_degrees_and_metres() -> None:
    world = after(
        mavlink.MAVLink_global_position_int_message(10, 471234567, -81234567, 412340, 0, 0, 0, 0, 0)
    )
    assert world.global_position == pytest.approx((47.1234567, -8.1234567, 412.34))
    older = mavlink.MAVLink_global_position_int_message(9, 471234567, -81234567, 400000, 0, 0, 0, 0, 0)
    assert after(older, world, world.global_position_time_s - 0.1) is world
    home = after(
        mavlink.MAVLink_home_position_message(470000000, 80000000, 400500, 0, 0, 0, [1.0, 0, 0, 0], 0, 0, 0)
    )
    assert home.home == pytest.approx((47.0, 8.0, 400.5))


def test_a_velocity_comes_in_metres_a_second_of_a_filter_that_knows_it_and_never_an_older_one() -> None:
    message = mavlink.MAVLink_global_position_int_message(10, 471234567, -81234567, 412340, 0, 123, -45, 6, 0)
    known = after(message, time_s=3.0)
    assert known.velocity_ned_m_s == pytest.approx((1.23, -0.45, 0.06))
    assert known.velocity_time_s == 3.0
    assert after(message, known, 2.9).velocity_time_s == 3.0
    assert after(message, replace(FRESH, ekf_ready=False)).velocity_ned_m_s is None


@pytest.mark.parametrize(("number", "landed"), list(enumerate(LandedState)))
def test_landed_state(number: int, landed: LandedState) -> None:
    assert after(mavlink.MAVLink_extended_sys_state_message(0, number)).landed is landed


PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK


@pytest.mark.parametrize(
    ("autopilot_kind", "present", "enabled", "healthy", "ready"),
    [
        # PX4 has the bit in what is healthy alone, whatever else is ill
        ("px4", 3, 3, PREARM | 3, True),
        ("px4", 3, 3, 3, False),
        ("px4", 3, 3, PREARM | 1, True),
        ("ardupilot", PREARM | 3, PREARM | 3, PREARM | 3, True),
        ("ardupilot", PREARM | 3, PREARM | 3, 3, False),
        ("ardupilot", PREARM | 3, PREARM | 3, PREARM | 1, True),
        # an old one has it nowhere
        ("ardupilot", 3, 3, 3, True),
        ("ardupilot", 3, 3, 1, False),
        ("ardupilot", 3, 1, 1, True),
    ],
)
def test_ready_to_arm_is_the_prearm_bit_or_failing_that_every_sensor(
    autopilot_kind: AutopilotKind, present: int, enabled: int, healthy: int, ready: bool
) -> None:
    message = mavlink.MAVLink_sys_status_message(present, enabled, healthy, *[0] * 10)
    assert after(message, replace(FRESH, autopilot_kind=autopilot_kind)).ready_to_arm is ready


@pytest.mark.parametrize(
    ("flags", "ready"),
    [
        (0x400, False),  # ArduCopter 4.6 after its start
        (0x0A7, False),  # aligned, held in place by itself: "Arm: Need Position Estimate"
        (0x33F, True),  # uses GPS, and arms
        (0x33E, False),  # without an attitude
        (0x3BF, False),  # the position is one that it holds by itself
    ],
)
def test_an_ardupilots_filter_is_ready_once_it_knows_where_it_is(flags: int, ready: bool) -> None:
    state = after(heartbeat(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0))
    assert state.ekf_ready is False  # nothing heard of it yet
    report = mavlink.MAVLink_ekf_status_report_message(flags, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert after(report, state).ekf_ready is ready


def test_a_px4s_kill_switch_is_in_its_heartbeat() -> None:
    cut = mavlink.MAVLink_heartbeat_message(
        2, mavlink.MAV_AUTOPILOT_PX4, 129, 0, mavlink.MAV_STATE_FLIGHT_TERMINATION, 3
    )
    state = after(cut)
    assert state.motors_cut
    assert not after(heartbeat(mavlink.MAV_AUTOPILOT_PX4, 0, 129), state).motors_cut


@pytest.mark.parametrize(
    ("present", "enabled", "armed", "cut"),
    [
        (OUTPUTS, 0, True, True),
        (OUTPUTS, OUTPUTS, True, False),
        (OUTPUTS, 0, False, False),  # the safety switch on the ground
        (0, 0, True, False),  # one that does not say
    ],
)
def test_an_ardupilots_emergency_stop_takes_its_outputs_away(
    present: int, enabled: int, armed: bool, cut: bool
) -> None:
    message = mavlink.MAVLink_sys_status_message(present, enabled, present, *[0] * 10)
    flying = replace(FRESH, autopilot_kind="ardupilot", armed=armed)
    state = after(message, flying)
    assert state.motors_cut is cut
    # a heartbeat says nothing of it
    again = after(heartbeat(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 4, 129), state)
    assert again.motors_cut is cut


@pytest.mark.parametrize(("percent", "share"), [(-1, None), (0, 0.0), (37, 0.37), (100, 1.0), (101, None)])
def test_the_batterys_charge_is_a_share_or_not_known(percent: int, share: float | None) -> None:
    message = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, percent, *[0] * 6)
    assert after(message).battery_share == share


def test_what_it_said_of_its_checks_and_its_battery_is_forgotten_when_it_is_not_said_again() -> None:
    prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    message = mavlink.MAVLink_sys_status_message(prearm, prearm, prearm, 0, 0, 0, 80, *[0] * 6)
    state = update_state(FRESH, message, 10.0)
    assert (state.ready_to_arm, state.battery_share) == (True, 0.8)
    assert without_old(state, 12.5) == state
    old = without_old(state, 600.0)
    assert (old.ready_to_arm, old.battery_share, old.status_time_s) == (False, None, 10.0)
    # and known again with the next
    assert update_state(old, message, 600.1).battery_share == 0.8


@pytest.mark.parametrize("mode", PROFILES["px4"].modes)
def test_current_mode_has_the_same_numbers_and_arms_nothing(mode: str) -> None:
    state = after(heartbeat(mavlink.MAV_AUTOPILOT_PX4, 0, 129))
    told = after(CurrentMode(0, custom_mode("px4", mode), 0), state)
    assert (told.mode, told.offboard, told.armed) == (mode, mode == "OFFBOARD", True)
    assert told.intended_mode == ""  # not supplied
    waits = after(CurrentMode(0, custom_mode("px4", mode), custom_mode("px4", "OFFBOARD")), state)
    assert (waits.mode, waits.intended_mode) == (mode, "OFFBOARD")
    # the next heartbeat's other mode is a choice, unless a failsafe flies it
    other = custom_mode("px4", "POSCTL" if mode == "AUTO.LOITER" else "AUTO.LOITER")
    for status, intended in ((mavlink.MAV_STATE_ACTIVE, ""), (mavlink.MAV_STATE_CRITICAL, "OFFBOARD")):
        changed = heartbeat(mavlink.MAV_AUTOPILOT_PX4, other, 129, status)
        assert after(changed, waits).intended_mode == intended
    # before any heartbeat nobody knows whose numbers these are
    assert after(CurrentMode(0, custom_mode("px4", mode), 0)).mode == ""


def test_of_a_px4s_filter_nothing_is_awaited() -> None:
    assert after(heartbeat(mavlink.MAV_AUTOPILOT_PX4, 0)).ekf_ready is None


def test_the_last_texts_are_kept() -> None:
    state = FRESH
    for i in range(12):
        state = add_text(state, f"text {i}", float(i))
    assert state.texts == tuple(f"text {i}" for i in range(2, 12))


LONG = "Preflight Fail: " + "ekf2 missing data, " * 6 + "wait"


def texts_of(messages: list[Message]) -> list[str]:
    texts = StatusTexts()
    return [text for m in messages for text in texts.receive(packed(m))]


def test_short_and_long_texts_come_whole() -> None:
    messages = [
        *status_texts("one", "info", 1),
        *status_texts(LONG, "info", 2),
        *status_texts("two", "info", 3),
    ]
    assert texts_of(messages) == ["one", LONG, "two"]


def test_a_text_of_exactly_two_chunks_ends() -> None:
    assert texts_of(status_texts("x" * 100, "info", 5)) == ["x" * 100]


def test_a_lost_chunk_is_shown_as_a_gap() -> None:
    messages = status_texts(LONG, "info", 2)
    assert texts_of([messages[0], *messages[2:]]) == [LONG[:50] + "..." + LONG[100:]]


def test_a_lost_end_does_not_swallow_the_next_text() -> None:
    messages = status_texts(LONG, "info", 2)[:-1]
    assert texts_of([*messages, *status_texts("next", "info", 3)]) == [LONG[:100] + "...", "next"]
