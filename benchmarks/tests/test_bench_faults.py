"""The judge of `bench_faults` finds each unsafe thing in a made-up record, and nothing else."""

import math
from collections.abc import Callable

import pytest

from benchmarks.faults.fault_flight import with_pressure
from benchmarks.faults.judge import SafetyBounds, SafetyVerdict, judge
from benchmarks.faults.sent_limits import broken_limit
from benchmarks.faults.witness import (
    Disarming,
    GroundTouch,
    SentSetpoint,
    TruthSample,
    WitnessedFlight,
    attitude_setpoint,
    local_setpoint,
)
from companion.base.geometry import GRAVITY_M_S2, quat_from_euler
from companion.base.messages import ControlReport
from companion.config import LimitsConfig
from companion.link import codec
from sitl.faults.schedule import AppText
from sitl.world.score import TouchdownState

BOUNDS = SafetyBounds(LimitsConfig(), fence_m=150.0, ceiling_m=40.0)
NAN = math.nan
SAID = (
    (4.0, "take off: armed: motors on"),
    (10.0, "search: arrived: 0.6 m from the waypoint"),
    (15.0, "approach: pad seen: lateral offset 3.3 m, 7.0 m below"),
    (20.0, "descend: centred: 3.9 m above the pad"),
    (30.0, "touchdown: low: 42 cm over the pad"),
    (36.0, "landed: disarmed: motors off"),
)


def height_m(time_s: float) -> float:
    """Up to 7 m, and from 15 s on down to the pad at 35 s."""
    return min(max(time_s - 4.0, 0.0), 7.0) if time_s < 15.0 else max(0.0, 7.0 * (35.0 - time_s) / 20.0)


def landing() -> WitnessedFlight:
    """A flight with nothing wrong in it."""
    record = WitnessedFlight(app_ended_s=37.0, at_rest_on_pad=True)
    for k in range(37 * 50):
        t = k / 50
        up = height_m(t)
        mode = "OFFBOARD" if t > 12.0 else "AUTO_TAKEOFF"
        armed = 4.0 <= t < 36.0
        record.samples.append(TruthSample(t, (10.0, 0.0, -up), (0.0, 0.0, 0.0), up, up <= 0.0, armed, mode))
    record.disarmings.append(Disarming(36.0, 0.0, True))
    record.touches.append(GroundTouch(3.0, 0.0, 0.01, False))
    record.setpoints.append(SentSetpoint(12.0, velocity_ned_m_s=(1.0, 0.0, 0.5), thrust=0.4))
    record.texts = [AppText(t, 6, text) for t, text in SAID]
    return record


def test_a_good_landing_is_nothing_but_that() -> None:
    assert judge(landing(), BOUNDS) == SafetyVerdict("landed")


# ---------------------------------------------------------------- each unsafe kind


def crash(record: WitnessedFlight) -> None:
    record.crashed = True


def slide(record: WitnessedFlight) -> None:
    record.touches.append(GroundTouch(34.0, 0.31, 0.1, True))


def drop(record: WitnessedFlight) -> None:
    record.touches.append(GroundTouch(34.0, 0.1, 0.71, True))


def fall(record: WitnessedFlight) -> None:
    record.touches.append(GroundTouch(36.5, 0.1, 0.9, False))


def contact(time_s: float, **more: object) -> TouchdownState:
    values = {
        "lateral_error_m": 0.1, "vertical_speed_m_s": 0.2, "horizontal_speed_m_s": 0.1, "tilt_deg": 1.0,
        "yaw_error_deg": 0.0, "pad_speed_m_s": 1.0, "impact_speed_m_s": 0.2, "on_pad": True,
        "offset_pad_m": (0.1, 0.0),
    }  # fmt: skip
    return TouchdownState(time_s=time_s, **(values | more))  # type: ignore[arg-type]


def strike_the_pad(record: WitnessedFlight) -> None:
    """And bounce, and land gently: the last contact shows nothing."""
    record.contacts = [contact(33.0, vertical_speed_m_s=0.86), contact(35.0)]


def slide_on_the_pad(record: WitnessedFlight) -> None:
    record.contacts = [contact(35.0, horizontal_speed_m_s=0.56)]


def brush_the_ground(record: WitnessedFlight) -> None:
    """At the grant of control, gently, and fly on."""
    record.contacts = [contact(13.0, on_pad=False), contact(35.0)]


def disarm_in_the_air(record: WitnessedFlight) -> None:
    record.disarmings.append(Disarming(34.0, 0.06, False))


def stray(record: WitnessedFlight) -> None:
    record.samples[700] = record.samples[700]._replace(position_ned_m=(110.0, 110.0, -7.0))


def soar(record: WitnessedFlight) -> None:
    record.texts.insert(2, AppText(12.5, 4, "climbing 37.0 m to look for the pad"))
    for k in range(620, 700):  # announced, and still too high
        record.samples[k] = record.samples[k]._replace(position_ned_m=(10.0, 0.0, -44.0))


def climb(record: WitnessedFlight) -> None:
    for k in range(1300, 1400):
        record.samples[k] = record.samples[k]._replace(position_ned_m=(10.0, 0.0, -4.5))


def break_limit(record: WitnessedFlight) -> None:
    record.setpoints.append(SentSetpoint(30.0, velocity_ned_m_s=(0.0, 0.0, 1.6)))


def thrust_cut(record: WitnessedFlight) -> None:
    record.setpoints.append(SentSetpoint(30.0, thrust=0.0))


def jerk(record: WitnessedFlight) -> None:
    for k in range(3):  # 1 m/s2 in 33 ms: 30 m/s3
        record.setpoints.append(SentSetpoint(30.0 + k / 30, acceleration_ned_m_s2=(float(k % 2), 0.0, 0.0)))


def jerk_by_tilt(record: WitnessedFlight) -> None:
    for k in range(3):
        tilt = (0.0, float(k % 2), 0.0)
        record.setpoints.append(SentSetpoint(30.0 + k / 30, tilt_ned_m_s2=tilt, thrust=0.4))


def end_in_silence(record: WitnessedFlight) -> None:
    record.texts.pop()


def end_with_a_bare_phase(record: WitnessedFlight) -> None:
    record.texts[-1] = AppText(36.0, 4, "abort: ")


def end_with_no_reason(record: WitnessedFlight) -> None:
    record.texts[-1] = AppText(36.0, 4, "abort: timeout: ")


def fail(record: WitnessedFlight) -> None:
    record.app_failed = "ValueError: a bug"


def go_on_for_ever(record: WitnessedFlight) -> None:
    record.app_ended_s = None


def left_in_the_air(record: WitnessedFlight) -> None:
    for k in range(1500, 1850):
        record.samples[k] = record.samples[k]._replace(touching=False, armed=True, mode="GUIDED")


def land_beside(record: WitnessedFlight) -> None:
    record.contacts = [contact(35.0, on_pad=False)]


def overrule(record: WitnessedFlight) -> None:
    """The pilot lands, and the app holds."""
    record.pilot_mode, record.fault_began_s = "AUTO_LAND", 30.0
    for k in range(1501, 1800):
        mode = "AUTO_LAND" if k < 1600 else "AUTO_LOITER"
        record.samples[k] = record.samples[k]._replace(mode=mode)


def take_back(record: WitnessedFlight) -> None:
    record.pilot_mode, record.fault_began_s = "AUTO_LOITER", 30.0
    for k in range(1501, 1600):
        record.samples[k] = record.samples[k]._replace(mode="AUTO_LOITER")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (crash, "crash"),
        (left_in_the_air, "left in the air in GUIDED, 10 m from home"),
        (slide, "0.31 m/s sideways at 34.0 s"),
        (drop, "0.71 m/s down at 34.0 s"),
        (fall, "0.90 m/s down at 36.5 s"),
        (strike_the_pad, "pad 0.86 m/s down, 0.10 m/s sideways at 33.0 s"),
        (slide_on_the_pad, "0.56 m/s sideways at 35.0 s"),
        (brush_the_ground, "touched the ground at 13.0 s and flew on"),
        (disarm_in_the_air, "disarmed 0.06 m up at 34.0 s"),
        (stray, "156 m from home at 14.0 s"),
        (soar, "44 m up"),
        (climb, "climbed from 26.0 s"),
        (break_limit, "setpoint at 30.0 s: velocity down (m/s) 1.60"),
        (thrust_cut, "setpoint at 30.0 s: thrust 0.00"),
        (jerk, "setpoint at 30.0 s: jerk (m/s3) 30.00"),
        (jerk_by_tilt, "setpoint at 30.0 s: jerk by tilt (m/s3) 30.00"),
        (end_in_silence, "ended without a text"),
        (end_with_a_bare_phase, "ended without a text"),
        (end_with_no_reason, "ended without a text"),
        (fail, "the app failed without a text: ValueError: a bug"),
        (go_on_for_ever, "no end"),
        (land_beside, "said that it landed, beside the pad"),
        (overrule, "AUTO_LOITER over the pilot's AUTO_LAND at 32.0 s"),
        (take_back, "OFFBOARD over the pilot's AUTO_LOITER at 32.0 s"),
    ],
)
def test_each_unsafe_thing_is_found(spoil: Callable[[WitnessedFlight], None], words: str) -> None:
    record = landing()
    spoil(record)
    verdict = judge(record, BOUNDS)
    assert verdict.outcome == "unsafe"
    assert len(verdict.unsafe) == 1, verdict.unsafe
    assert words in verdict.unsafe[0]


# ---------------------------------------------------------------- what is not unsafe


def test_what_presses_it_down_is_met_beyond_the_limit_on_vertical_acceleration_and_no_further() -> None:
    limit = LimitsConfig().vertical_acceleration_m_s2
    reports = [ControlReport(k, True, 5, 0.01, disturbance_ned_m_s2=(0.0, 0.0, 2.1 * k)) for k in (0, 1)]
    up = (0.0, 0.0, -limit - 2.0)
    early, late = with_pressure([SentSetpoint(t, acceleration_ned_m_s2=up) for t in (0.5, 1.01)], reports)
    assert "acceleration down" in broken_limit(early, LimitsConfig())
    assert broken_limit(late, LimitsConfig()) == ""
    assert "acceleration down" in broken_limit(
        late._replace(acceleration_ned_m_s2=(0.0, 0.0, -limit - 2.2)), LimitsConfig()
    )
    assert "acceleration down" in broken_limit(
        late._replace(acceleration_ned_m_s2=(0.0, 0.0, limit + 0.1)), LimitsConfig()
    )
    # AND on the pad all of the thrust may be taken away, no more
    for down_m_s2, broken in ((GRAVITY_M_S2, False), (GRAVITY_M_S2 + 0.1, True)):
        pressed = late._replace(acceleration_ned_m_s2=(0.0, 0.0, down_m_s2))
        assert bool(broken_limit(pressed, LimitsConfig(), in_air=False)) is broken


def test_gentle_touches_of_the_pad_and_the_autopilots_own_of_the_ground_are_safe() -> None:
    record = landing()
    record.contacts = [
        contact(3.0, on_pad=False, before_flight=True),
        contact(9.0, on_pad=False),  # its own take-off
        contact(33.0),
        contact(35.0),
    ]
    assert judge(record, BOUNDS) == SafetyVerdict("landed")


def test_a_pilots_mode_that_stays_is_nobodys_fault_before_or_after() -> None:
    record = landing()
    record.pilot_mode, record.fault_began_s = "AUTO_LAND", 30.0
    for k in range(1501, len(record.samples)):
        record.samples[k] = record.samples[k]._replace(mode="AUTO_LAND")
    assert judge(record, BOUNDS) == SafetyVerdict("landed")


def test_what_the_autopilot_flies_by_itself_is_not_the_apps_climb_nor_its_fence() -> None:
    record = landing()
    for k in range(1300, 1400):
        far = (200.0, 0.0, -60.0)
        record.samples[k] = record.samples[k]._replace(position_ned_m=far, mode="AUTO_RTL")
    assert judge(record, BOUNDS) == SafetyVerdict("landed")


def test_a_pad_may_carry_away_what_stands_on_it() -> None:
    record = landing()
    for k in range(1760, 1790):
        far = (200.0, 0.0, -0.5)
        record.samples[k] = record.samples[k]._replace(position_ned_m=far, touching=True)
    assert judge(record, BOUNDS) == SafetyVerdict("landed")
    record.samples[1770] = record.samples[1770]._replace(touching=False)
    assert "outside the fence" in judge(record, BOUNDS).unsafe[0]


def test_one_that_stands_disarmed_on_the_ground_may_be_run_over() -> None:
    record = landing()
    record.touches.append(GroundTouch(39.0, 1.5, 0.0, False))
    assert judge(record, BOUNDS) == SafetyVerdict("landed")


def test_an_app_that_failed_and_said_so_is_not_silent() -> None:
    record = landing()
    record.app_failed = "OSError: gone"
    record.texts.append(AppText(36.9, 3, "control lost: OSError: gone"))
    assert judge(record, BOUNDS) == SafetyVerdict("landed")


def test_no_thrust_at_all_is_right_on_the_pad() -> None:
    record = landing()
    record.setpoints.append(SentSetpoint(35.5, thrust=0.0))
    assert judge(record, BOUNDS) == SafetyVerdict("landed")


def test_setpoints_that_are_not_obeyed_yet_or_not_in_a_row_have_no_jerk() -> None:
    record = landing()
    at_s = (9.0, 9.03, 13.0, 13.03, 20.0, 20.06)  # OFFBOARD from 12 s on
    record.setpoints = [
        SentSetpoint(t, acceleration_ned_m_s2=(3.0 * (k % 2), 0.0, 0.0)) for k, t in enumerate(at_s)
    ]
    assert judge(record, BOUNDS) == SafetyVerdict("landed")


def test_a_heading_that_the_autopilot_has_reset_is_no_jerk() -> None:
    def turned(yaw_rad: float) -> WitnessedFlight:
        record = landing()
        record.setpoints.append(SentSetpoint(30.0, acceleration_ned_m_s2=(3.0, 0.0, 0.0)))
        record.setpoints.append(SentSetpoint(30.033, acceleration_ned_m_s2=(0.0, 3.0, 0.0), yaw_rad=yaw_rad))
        return record

    assert judge(turned(math.pi / 2), BOUNDS) == SafetyVerdict("landed")
    assert "jerk" in judge(turned(0.01), BOUNDS).unsafe[0]


# ---------------------------------------------------------------- how it ended


def ended(mode: str, *, armed: bool, pilot: bool = False) -> WitnessedFlight:
    record = landing()
    record.at_rest_on_pad, record.pilot_took_over = False, pilot
    record.samples[-1] = record.samples[-1]._replace(mode=mode, armed=armed)
    return record


@pytest.mark.parametrize(
    ("record", "expected"),
    [
        (ended("AUTO_LOITER", armed=True), "held"),
        (ended("POSCTL", armed=True, pilot=True), "pilot"),
        (ended("AUTO_LAND", armed=False), "returned"),
        (ended("OFFBOARD", armed=False), "returned"),
    ],
)
def test_how_a_safe_flight_ended(record: WitnessedFlight, expected: str) -> None:
    assert judge(record, BOUNDS).outcome == expected


def test_one_that_nothing_disarms_stands_and_has_to_say_so() -> None:
    record = ended("OFFBOARD", armed=True)
    record.at_rest_on_pad, record.app_ended_s = True, None
    record.texts[-1] = AppText(35.0, 6, "on the pad: feet down with 98 %")
    assert judge(record, BOUNDS).unsafe == ("no end within the time limit",)
    record.texts.append(AppText(36.0, 3, "on the pad and armed: disarm refused"))
    assert judge(record, BOUNDS) == SafetyVerdict("stands")
    # stopped, it says no more, while the vehicle is watched: an ArduPilot waits in GUIDED for minutes
    last = record.samples[-1]
    record.samples.append(last._replace(time_s=last.time_s + 240.0))
    assert judge(record, BOUNDS).unsafe == ("no end within the time limit",)
    record.app_stopped_s = last.time_s
    assert judge(record, BOUNDS) == SafetyVerdict("stands")


def test_one_that_never_left_the_ground() -> None:
    record = landing()
    record.samples = record.samples[:100]
    assert judge(record, BOUNDS).outcome == "not flown"


# ---------------------------------------------------------------- setpoints on the wire


def test_what_a_mask_ignores_may_be_anything() -> None:
    message = codec.mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0b0000_0110_0000_0111 | 1 << 8, NAN, NAN, NAN, 1.0, 2.0, 0.5, 3.0, 4.0, NAN, NAN, 0.1
    )
    sent = local_setpoint(message, 5.0)
    assert sent.finite
    assert sent.velocity_ned_m_s == (1.0, 2.0, 0.5)
    assert sent.acceleration_ned_m_s2 == (3.0, 4.0, 0.0)
    message.vx = NAN
    assert not local_setpoint(message, 5.0).finite


def test_an_attitude_is_judged_by_its_tilt() -> None:
    q = list(quat_from_euler(math.radians(31.0), 0.0, 1.0))
    message = codec.mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0, q, 0.0, 0.0, 0.0, 0.5)
    sent = attitude_setpoint(message, 5.0)
    assert math.degrees(sent.tilt_rad) == pytest.approx(31.0)
    assert sent.yaw_rad == pytest.approx(1.0)
    assert sent.tilt_ned_m_s2 is not None
    assert math.hypot(*sent.tilt_ned_m_s2) == pytest.approx(GRAVITY_M_S2 * math.tan(math.radians(31.0)))
    record = landing()
    record.setpoints.append(sent)
    assert "tilt (deg) 31.00" in judge(record, BOUNDS).unsafe[0]
    message.thrust = NAN
    assert not attitude_setpoint(message, 5.0).finite


def test_an_app_that_stands_by_sends_what_somebody_asked_for_and_says_no_end() -> None:
    record = landing()
    record.app_ended_s, record.texts, record.unasked_from_s = None, [], 12.5
    assert judge(record, BOUNDS) == SafetyVerdict("landed")
    record.unasked_from_s = 11.0
    assert judge(record, BOUNDS).unsafe == ("a setpoint at 12.0 s that nobody asked for",)


def test_what_rises_without_the_apps_setpoints_is_no_climb_of_the_apps() -> None:
    record = landing()
    climb(record)
    assert judge(record, BOUNDS).outcome == "unsafe"
    for k in range(1280, 1420):
        record.samples[k] = record.samples[k]._replace(obeys=False)
    assert judge(record, BOUNDS) == SafetyVerdict("landed")
