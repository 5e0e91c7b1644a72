"""The autopilot's attitude as a reset of ours, and what is told when the IMU's stream has a gap."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from companion.base.geometry import (
    ZERO3,
    Quaternion,
    Vector3,
    euler_from_quat,
    norm,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    rotation_vector_from_quat,
)
from companion.base.messages import AutopilotAttitude, ImuSample, PadSighting
from companion.config import EstimateConfig
from companion.config.estimate import PadFilterConfig
from companion.estimate.estimator import StateEstimator
from companion.estimate.motion import MotionHistory, unseen_turn_rad2
from companion.estimate.vehicle.autopilot_attitudes import (
    AttitudeReset,
    AutopilotAttitudes,
    OwnAttitude,
    apart,
)
from companion.estimate.vehicle.ekf_inputs import AttitudeStep
from tests.attitudes import DEGREE
from tests.unit.estimate.estimate_flight import (
    FIELD_NED_UT,
    EstimateFlight,
    circle,
    feed,
    new_estimator,
    slow_turns,
    smooth,
)


def swing(t: float) -> Vector3:
    """7 m up, and from side to side with up to 17 degrees of tilt, once a second."""
    side = 0.08 * smooth(t, 10.0, 12.0) * math.sin(math.tau * t)
    return (side, 0.0, -7.0 * smooth(t, 5.0, 10.0))


def kick(t: float) -> float:
    """A turn by 34 degrees that begins and ends within the gap."""
    return slow_turns(t) + 0.6 * smooth(t, 19.07, 19.38)


GAP = (19.05, 19.4)
FLIGHT = EstimateFlight(
    swing, heading=kick, seed=31, duration_s=24.0, sensors=frozenset({"imu", "mag", "gps"})
)
NORTH_OF_THEIRS = quat_from_euler(0.0, 0.0, 0.4)  # their heading is their own
AHEAD_RAD = 0.4  # of theirs is our heading, as a rule
OURS = quat_from_euler(0.0, 0.0, AHEAD_RAD)
STARTED_S = 0.99  # of the alignment
SURE, STEADY = 0.5 * DEGREE, 0.0  # our horizon's deviation, and how fast we turn


@dataclass(frozen=True)
class AnchorRun:
    time_s: list[float]
    error_deg: list[float]
    told: list[str]

    def worst_deg(self, from_s: float, until_s: float = math.inf) -> float:
        errors = zip(self.time_s, self.error_deg, strict=True)
        return max(e for t, e in errors if from_s <= t < until_s)


def fly(*, anchored: bool, gap: tuple[float, float] = GAP, theirs_off: Quaternion | None = None) -> AnchorRun:
    """The estimate's attitude errors where the IMU's stream has a gap; stamps tell how long it was."""
    estimator, run, last_s = new_estimator(), AnchorRun([], [], []), None
    for k, (arrival_s, sample) in enumerate(FLIGHT.samples):
        if isinstance(sample, ImuSample):
            if gap[0] < sample.time_s < gap[1]:
                continue
            interval_s = None if last_s is None else sample.time_s - last_s
            last_s = sample.time_s
            sample = replace(sample, interval_s=interval_s)  # noqa: PLW2901
        feed(estimator, sample)
        if k % 10 == 0:
            said_s = arrival_s - 0.02
            attitude = quat_multiply(NORTH_OF_THEIRS, FLIGHT.attitude(said_s))
            if theirs_off is not None and said_s > GAP[0]:
                attitude = quat_multiply(theirs_off, attitude)
            estimator.add_autopilot_attitude(AutopilotAttitude(said_s, attitude, same_imu=anchored))
            judge(run, estimator, arrival_s)
    return run


def judge(run: AnchorRun, estimator: StateEstimator, now_s: float) -> None:
    run.told.extend(words for _, words in estimator.take_notices())
    state = estimator.vehicle(now_s)
    if state is not None and now_s > 12.0:
        turn = quat_multiply(quat_conjugate(FLIGHT.attitude(now_s)), state.attitude)
        run.time_s.append(now_s)
        run.error_deg.append(math.degrees(norm(rotation_vector_from_quat(turn))))


def test_after_a_gap_in_the_imus_stream_the_attitude_is_the_autopilots() -> None:
    anchored, alone = fly(anchored=True), fly(anchored=False)
    assert anchored.worst_deg(GAP[1] + 0.1) < 3.5
    assert alone.worst_deg(GAP[1] + 0.1) > 15.0
    [told] = anchored.told
    assert told.startswith("attitude corrected by")
    assert told.endswith("350 ms of IMU data missing")


def test_without_a_gap_nothing_is_set_right() -> None:
    run = fly(anchored=True, gap=(99.0, 99.0))
    assert run.told == []
    assert run.worst_deg(14.0) < 2.5


def test_an_autopilot_that_finds_north_elsewhere_turns_nothing() -> None:
    gap = (99.0, 99.0)
    run = fly(anchored=True, gap=gap, theirs_off=quat_from_euler(0.0, 0.0, 20.0 * DEGREE))
    assert run.told == []
    assert run.error_deg == fly(anchored=True, gap=gap).error_deg


# ---------------------------------------------------------------- the comparison


def ours(tilt_std_rad: float = SURE, rate: float = STEADY) -> OwnAttitude:
    covariance = np.diag([0.5 * tilt_std_rad**2] * 2 + [(2.0 * DEGREE) ** 2])
    return OwnAttitude(OURS, covariance, ZERO3, rate)


def words(
    reset: AttitudeReset, theirs: Quaternion, seconds: float, std_rad: float = SURE, rate: float = STEADY
) -> list[float]:
    """When ours is set right, of words at 30 Hz."""
    own = ours(std_rad, rate)
    found = [
        reset.compare(AutopilotAttitude(k / 30.0, theirs), own, AHEAD_RAD) for k in range(round(30 * seconds))
    ]
    return [correction.time_s for correction in found if correction is not None]


def tilted(roll_deg: float) -> Quaternion:
    return quat_from_euler(roll_deg * DEGREE, 0.0, 0.0)


def test_horizons_a_little_apart_are_left_alone() -> None:
    assert words(AttitudeReset(MotionHistory(1.0)), tilted(4.0), 10.0) == []


def test_horizons_far_apart_are_set_right_once_that_lasts() -> None:
    [first, *_] = words(AttitudeReset(MotionHistory(1.0)), tilted(8.0), 1.0)
    assert 0.2 <= first < 0.3


def test_a_single_word_that_is_off_changes_nothing() -> None:
    reset = AttitudeReset(MotionHistory(1.0))
    for k in range(60):
        theirs = tilted(30.0) if k % 10 == 0 else tilted(0.0)
        assert reset.compare(AutopilotAttitude(k / 30.0, theirs), ours(), AHEAD_RAD) is None


def test_a_fast_turn_may_hide_as_much_as_it_makes_in_the_time_that_may_be_off() -> None:
    assert words(AttitudeReset(MotionHistory(1.0)), tilted(8.0), 2.0, rate=5.0) == []


def test_what_is_set_right_keeps_our_own_heading() -> None:
    reset = AttitudeReset(MotionHistory(1.0))
    assert words(reset, tilted(0.0), 2.0) == []
    found = [
        reset.compare(AutopilotAttitude(3.0 + k / 30.0, tilted(10.0)), ours(), AHEAD_RAD) for k in range(30)
    ]
    step = next(found.step for found in found if found is not None)
    assert isinstance(step, AttitudeStep)
    tilt_rad, heading_rad = apart(quat_multiply(step.turn, OURS), tilted(10.0))
    assert tilt_rad == pytest.approx(0.0, abs=1e-6)
    assert heading_rad == pytest.approx(0.4, abs=1e-6)


def test_an_attitude_that_is_poorly_known_is_taken_from_the_autopilot_at_once() -> None:
    assert words(AttitudeReset(MotionHistory(1.0)), tilted(10.0), 0.1, std_rad=15.0 * DEGREE)[0] == 0.0


def test_words_wait_until_our_own_samples_have_come_as_far() -> None:
    motion = MotionHistory(3.0)
    attitudes = AutopilotAttitudes(motion, STARTED_S)
    first, second = AutopilotAttitude(1.0, tilted(0.0)), AutopilotAttitude(1.5, tilted(1.0))
    assert list(attitudes.due(first)) == []
    motion.add(0.99, tilted(0.0), ZERO3)
    assert list(attitudes.due(second)) == []
    motion.add(1.01, tilted(4.0), ZERO3)
    [(report, own)] = attitudes.due(second)
    assert report == first
    assert own == pytest.approx(tilted(2.0)), "ours at its time"


LONG, SHORT = (1.0, 1.35), (1.6, 1.7)  # two gaps, s


def known_after(reports: tuple[float, ...], hidden_deg: tuple[float, float]) -> tuple[float, float]:
    """Our roll (deg) between both gaps and after them, each of which has hidden so much."""
    motion = MotionHistory(5.0)
    for k in range(400):
        if not any(start_s < k / 200 < end_s for start_s, end_s in (LONG, SHORT)):
            motion.add(k / 200, OURS, ZERO3)
    attitudes = AutopilotAttitudes(motion, -1.0)
    for time_s in reports:
        ends = zip((LONG[1], SHORT[1]), hidden_deg, strict=True)
        roll_rad = sum(hidden for end_s, hidden in ends if time_s >= end_s) * DEGREE
        sent = AutopilotAttitude(time_s, quat_from_euler(roll_rad, 0.0, AHEAD_RAD), same_imu=True)
        for report, attitude in attitudes.due(sent):
            found = attitudes.shown_by(report, ours()._replace(attitude=attitude))
            if found is not None:
                assert isinstance(found.step, AttitudeStep)
                motion.turn(found.since_s, found.time_s, found.step.turn)
    between, after = motion.attitude(1.5), motion.attitude(1.9)
    assert between is not None
    assert after is not None
    return euler_from_quat(between)[0] / DEGREE, euler_from_quat(after)[0] / DEGREE


def test_of_two_gaps_each_has_hidden_its_own_turn() -> None:
    """Whatever comes late: a report from between the gaps tells what the first has hidden."""
    assert known_after((0.99, 1.5, 1.9), (10.0, 0.0)) == pytest.approx((10.0, 10.0))
    assert known_after((0.99, 1.5, 1.9), (0.0, 10.0)) == pytest.approx((0.0, 10.0))


@pytest.mark.parametrize("reports", [(0.99, 1.9), (0.99, 1.2, 1.9)], ids=["none between", "one in a gap"])
def test_two_gaps_before_one_report_share_the_turn_by_what_each_may_have_hidden(
    reports: tuple[float, ...],
) -> None:
    between, after = known_after(reports, (10.0, 0.0))
    long, short = (unseen_turn_rad2(end_s - start_s) for start_s, end_s in (LONG, SHORT))
    assert between == pytest.approx(10.0 * long / (long + short), rel=1e-3)
    assert between > 9.9
    assert after == pytest.approx(10.0)


def test_a_report_is_not_compared_with_ours_of_another_alignment() -> None:
    motion = MotionHistory(3.0)
    motion.add(0.99, tilted(5.0), ZERO3)
    attitudes = AutopilotAttitudes(motion, STARTED_S)
    motion.add(1.0, tilted(0.0), ZERO3)
    assert list(attitudes.due(AutopilotAttitude(0.98, tilted(0.0)))) == []
    assert len(list(attitudes.due(AutopilotAttitude(1.0, tilted(0.0))))) == 1


# ---------------------------------------------------------------- late, and silent


def test_a_sighting_waits_for_the_imu_to_come_up_to_its_exposure() -> None:
    # GIVEN an IMU whose samples come 60 ms late, on a vehicle that turns; the stamps are known to be right:
    # learnt, their delay would be off by 9 ms, and by another 9 ms in the other order of arrival
    flight = EstimateFlight(circle(3.0, 2.5), seed=32, duration_s=20.0)
    known = EstimateConfig(magnetic_field_ned_ut=FIELD_NED_UT, pad=PadFilterConfig(camera_delay_std_s=0.0))
    late, prompt = new_estimator(known), new_estimator(known)
    arrivals = [
        (arrival_s + (0.06 if isinstance(sample, ImuSample) else 0.0), sample)
        for arrival_s, sample in flight.samples
    ]
    quick = [(s.time_s + 0.01 if isinstance(s, PadSighting) else t, s) for t, s in arrivals]
    for _, sample in sorted(quick, key=lambda item: item[0]):
        feed(late, sample)
    for _, sample in flight.samples:
        feed(prompt, sample)
    told, expected = late.pad(20.0), prompt.pad(20.0)
    assert told is not None
    assert expected is not None
    assert told.relative_position_ned_m == pytest.approx(expected.relative_position_ned_m, abs=0.02)


def test_when_the_imu_falls_silent_only_a_tenth_of_a_second_is_predicted() -> None:
    estimator = new_estimator()
    for _, sample in FLIGHT.samples:
        feed(estimator, sample)
    end_s = FLIGHT.duration_s
    now, soon, later = (estimator.vehicle(end_s + age_s) for age_s in (0.0, 0.1, 0.4))
    assert now is not None
    assert soon is not None
    assert later is not None
    assert norm(rotation_vector_from_quat(quat_multiply(quat_conjugate(now.attitude), soon.attitude))) > 0.05
    assert later.attitude == pytest.approx(soon.attitude, abs=0.01)
    assert later.rate_body_rad_s == ZERO3
    assert later.imu_age_s == pytest.approx(0.405, abs=0.002)
    assert np.subtract(later.velocity_ned_m_s, soon.velocity_ned_m_s) == pytest.approx(0.0, abs=0.02)
    assert estimator.vehicle(end_s + 1.6) is None
