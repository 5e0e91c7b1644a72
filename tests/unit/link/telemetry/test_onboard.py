"""The autopilot's sensors by telemetry: when each sample was measured, which is taken, what is missing."""

from itertools import pairwise

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.messages import GpsFix, MagSample, RangeSample
from companion.link.codec import mavlink
from companion.link.telemetry.autopilot_sensors import CLIMB_ACCURACY_M_S, UNKNOWN_SPEED_M_S
from companion.link.timesync import WRAP_S, BootClock
from tests.unit.link.telemetry.autopilot_readings import (
    START_S,
    ReadAutopilot,
    distance,
    gps,
    highres,
    packed,
    raw,
    scaled,
)

# ---------------------------------------------------------------- time


@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.3])
def test_a_sample_has_the_instant_of_its_measurement_however_late_it_comes(delay_s: float) -> None:
    onboard = ReadAutopilot()
    measured_s, message = onboard.now_s, highres(onboard.boot_s)
    onboard.now_s += delay_s
    [sample] = onboard.imu(message)
    assert sample.time_s == pytest.approx(measured_s, abs=1e-5)


@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_the_age_of_a_sample_at_its_stamp_is_taken_off(autopilot_kind: AutopilotKind) -> None:
    onboard = ReadAutopilot(autopilot_kind, imu_latency_s=None, gps_latency_s=0.15)
    build = highres if autopilot_kind == "px4" else raw
    [sample] = onboard.imu(build(onboard.boot_s))
    assert onboard.now_s - sample.time_s == pytest.approx(PROFILES[autopilot_kind].imu_latency_s, abs=1e-5)
    [fix] = onboard.hear(gps(onboard.boot_s))
    assert onboard.now_s - fix.time_s == pytest.approx(0.15, abs=1e-5)
    told = ReadAutopilot(autopilot_kind, imu_latency_s=0.03)
    [sample] = told.imu(build(told.boot_s))
    assert told.now_s - sample.time_s == pytest.approx(0.03, abs=1e-5)


def test_until_the_clocks_are_synchronised_nothing_is_used() -> None:
    onboard = ReadAutopilot(settled=False)
    assert onboard.hear(highres(onboard.boot_s)) == []
    onboard.synchronise(answers=4)
    assert onboard.hear(highres(onboard.boot_s)) == []
    onboard.synchronise(answers=1)
    assert len(onboard.imu(highres(onboard.boot_s))) == 1


def test_repeated_and_late_messages_are_refused() -> None:
    onboard = ReadAutopilot()
    first, second = highres(onboard.boot_s), highres(onboard.boot_s + 0.005)
    onboard.now_s += 0.01
    assert len(onboard.imu(second, second, first)) == 1
    assert onboard.sensors.refused["imu_stamp"] == 2
    assert len(onboard.hear(gps(onboard.boot_s), gps(onboard.boot_s))) == 1
    assert len(onboard.hear(distance(onboard.boot_s), distance(onboard.boot_s))) == 1


def test_a_stamp_of_another_clock_is_refused() -> None:
    onboard = ReadAutopilot()
    assert onboard.imu(highres(onboard.boot_s - 1.2), highres(onboard.boot_s + 0.2)) == []
    assert onboard.imu(highres(1.7e9)) == []  # microseconds since 1970
    assert len(onboard.imu(highres(onboard.boot_s))) == 1


def test_after_a_restart_of_the_autopilot_samples_wait_for_the_new_offset() -> None:
    onboard = ReadAutopilot()
    assert len(onboard.imu(highres(onboard.boot_s))) == 1
    onboard.now_s += 5.0
    onboard.offset_s = -onboard.now_s + 2.0  # it has been up for two seconds
    assert onboard.imu(highres(onboard.boot_s)) == []
    onboard.synchronise(answers=1)
    assert onboard.imu(highres(onboard.boot_s)) == []
    onboard.synchronise(answers=9)
    [sample] = onboard.imu(highres(onboard.boot_s))
    assert sample.time_s == pytest.approx(onboard.now_s, abs=1e-5)


def test_milliseconds_since_boot_wrap_after_seven_weeks() -> None:
    onboard = ReadAutopilot("ardupilot", settled=False)
    onboard.offset_s = WRAP_S - START_S - 1.0  # a second before
    onboard.synchronise()
    before = onboard.imu(scaled(onboard.boot_s))
    onboard.now_s += 1.5
    assert onboard.boot_s > WRAP_S
    after = onboard.imu(scaled(onboard.boot_s))
    assert after[0].time_s - before[0].time_s == pytest.approx(1.5, abs=2e-3)


def test_a_better_offset_is_followed_without_samples_out_of_order() -> None:
    onboard = ReadAutopilot(settled=False)
    onboard.synchronise(trip_s=0.04)
    clock, times = BootClock(onboard.timesync), []
    for k in range(400):
        if k == 100:
            # shorter trips, and 8 ms more of offset: within what the long ones could be wrong by
            onboard.offset_s += 0.008
        if k >= 100 and k % 20 == 0:
            onboard.synchronise(answers=1, trip_s=0.001)
        onboard.now_s += 0.005
        times.append(clock.time_s(onboard.boot_s, onboard.now_s))
    steps = [b - a for a, b in pairwise(times) if a is not None and b is not None]
    assert len(steps) == 399
    assert min(steps) > 0.004
    assert times[-1] == pytest.approx(onboard.now_s, abs=1e-3)


def test_a_clock_that_runs_slow_is_followed() -> None:
    # PX4's simulator in lockstep on a busy machine: 1.4 % in the recording
    onboard = ReadAutopilot()
    ages = []
    for k in range(2000):
        onboard.now_s += 0.01
        onboard.offset_s -= 0.014 * 0.01
        if k % 100 == 0:
            onboard.synchronise(answers=1)
        ages += [onboard.now_s - sample.time_s for sample in onboard.imu(highres(onboard.boot_s))]
    assert len(ages) > 1950
    assert max(map(abs, ages)) < 0.035


# ---------------------------------------------------------------- which message


def test_px4_is_asked_for_highres_imu_and_ardupilot_for_raw_imu() -> None:
    common = {
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
        mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: 20.0,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    }
    assert ReadAutopilot("px4").sensors.rates_hz() == {mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: 200.0, **common}
    ardupilot = ReadAutopilot("ardupilot", imu_rate_hz=100.0)
    assert ardupilot.sensors.rates_hz() == {mavlink.MAVLINK_MSG_ID_RAW_IMU: 100.0, **common}
    ours = ReadAutopilot(range_source="boards")
    assert mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR not in ours.sensors.rates_hz()
    assert ours.hear(distance(ours.boot_s)) == []


def test_raw_counts_of_px4_are_not_believed() -> None:
    onboard = ReadAutopilot("px4")
    assert onboard.hear(raw(onboard.boot_s), scaled(onboard.boot_s + 0.01)) == []


def test_of_ardupilots_messages_the_best_that_comes_is_taken() -> None:
    onboard = ReadAutopilot("ardupilot")
    assert len(onboard.imu(scaled(onboard.boot_s))) == 1
    onboard.now_s += 0.01
    assert len(onboard.imu(raw(onboard.boot_s))) == 1
    onboard.now_s += 0.01
    assert onboard.imu(scaled(onboard.boot_s), highres(onboard.boot_s)) == []
    onboard.now_s += 0.6
    assert len(onboard.imu(scaled(onboard.boot_s))) == 1


def test_the_field_comes_with_the_imu_when_it_is_new() -> None:
    onboard = ReadAutopilot()
    kinds = [type(sample) for sample in onboard.hear(highres(onboard.boot_s))]
    assert MagSample in kinds
    onboard.now_s += 0.01
    assert len(onboard.hear(highres(onboard.boot_s, fields_updated=0b111_111))) == 1


def test_a_second_rangefinder_is_not_mixed_in() -> None:
    onboard = ReadAutopilot()
    heard = onboard.hear(distance(onboard.boot_s), distance(onboard.boot_s + 0.02, id=1, current_distance=90))
    assert [sample.distance_m for sample in heard if isinstance(sample, RangeSample)] == [1.5]
    onboard.now_s += 3.0
    [sample] = onboard.hear(distance(onboard.boot_s, id=1, current_distance=90))
    assert isinstance(sample, RangeSample)


def test_a_forward_rangefinder_does_not_hide_the_one_that_looks_down() -> None:
    onboard = ReadAutopilot()
    heard = onboard.hear(distance(onboard.boot_s, id=4, orientation=0), distance(onboard.boot_s, id=0))
    assert len(heard) == 1


# ---------------------------------------------------------------- what is missing


def test_all_is_well_with_everything_there() -> None:
    onboard = ReadAutopilot()
    for _ in range(10):
        onboard.run(0.99, highres)
        assert len([s for s in onboard.hear(gps(onboard.boot_s)) if isinstance(s, GpsFix)]) == 1
        onboard.hear(distance(onboard.boot_s))
    assert onboard.sensors.watch(onboard.now_s) is None


def problem(onboard: ReadAutopilot, after_s: float = 8.0) -> str:
    for _ in range(round(after_s)):
        onboard.now_s += 1.0
        onboard.sensors.heartbeat("px4", onboard.now_s)
        found = onboard.sensors.watch(onboard.now_s)
    assert found is not None
    return found


def test_what_never_comes_is_named_with_what_was_expected() -> None:
    text = problem(ReadAutopilot(imu_rate_hz=100.0))
    assert text.startswith("autopilot's sensors: no HIGHRES_IMU received; expected 100 Hz (PX4: MAV_x_MODE")
    assert "no answer to TIMESYNC" in problem(ReadAutopilot(settled=False))


def test_nothing_is_said_before_there_was_time_or_when_the_link_is_gone() -> None:
    onboard = ReadAutopilot()
    assert onboard.sensors.watch(onboard.now_s + 3.0) is None
    assert onboard.sensors.watch(onboard.now_s + 60.0) is None


def test_what_comes_and_cannot_be_used_says_why() -> None:
    onboard = ReadAutopilot()
    onboard.run(8.0, lambda boot_s: highres(boot_s + 100.0))
    assert "HIGHRES_IMU received but unusable" in str(onboard.sensors.watch(onboard.now_s))


def test_an_imu_that_is_too_slow_gps_and_rangefinder_that_are_missing_are_reported() -> None:
    slow = ReadAutopilot("ardupilot")
    slow.run(10.0, raw, rate_hz=10.0)
    assert "RAW_IMU at about 10 Hz; expected 50 Hz or more (ArduPilot: SRx" in str(
        slow.sensors.watch(slow.now_s)
    )
    onboard = ReadAutopilot()
    onboard.run(10.0, highres)
    assert "no GPS_RAW_INT received; expected 5 Hz" in str(onboard.sensors.watch(onboard.now_s))
    onboard.hear(gps(onboard.boot_s, fix_type=1))  # waiting for satellites is nothing wrong
    assert "no DISTANCE_SENSOR of a rangefinder that looks down" in str(onboard.sensors.watch(onboard.now_s))


@pytest.mark.parametrize(
    ("since_s", "vertical"), [(0.12, (-1.5, CLIMB_ACCURACY_M_S)), (1.0, (0.0, UNKNOWN_SPEED_M_S))]
)
def test_a_fix_has_the_autopilots_climb_rate_of_its_own_time(
    since_s: float, vertical: tuple[float, float]
) -> None:
    onboard = ReadAutopilot(gps_latency_s=0.12)
    boot_s = onboard.boot_s
    for at_s, down_m_s in ((boot_s - since_s, -1.5), (boot_s - since_s - 0.3, 9.0)):
        message = mavlink.MAVLink_local_position_ned_message(round(at_s * 1e3), 0, 0, 0, 0, 0, down_m_s)
        onboard.sensors.hear(packed(message), at_s)
    [fix] = onboard.hear(gps(boot_s))
    assert isinstance(fix, GpsFix)
    assert (fix.velocity_ned_m_s[2], fix.vertical_speed_accuracy_m_s) == vertical
