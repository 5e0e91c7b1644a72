"""The motion history: interpolated attitude, pre-integrated acceleration."""

import math

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    add,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    rotation_vector_from_quat,
    yaw_from_quat,
)
from companion.estimate.motion import MotionHistory, misled_velocity_m_s, unseen_velocity_m2_s2


def filled(duration_s: float = 2.0, span_s: float = 5.0) -> MotionHistory:
    """Heading rate 0.5 rad/s, acceleration (1 + t, -2, 0)."""
    history = MotionHistory(span_s)
    for k in range(int(duration_s * 200) + 1):
        t = k / 200
        history.add(t, quat_from_euler(0.0, 0.0, 0.5 * t), (1.0 + t, -2.0, 0.0))
    return history


def test_empty_history_knows_nothing() -> None:
    history = MotionHistory(1.0)
    assert history.attitude(0.0) is None
    assert history.newest_s is None
    assert history.moved(0.0, 1.0) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), None)


@pytest.mark.parametrize("time_s", [0.0, 0.3337, 1.0, 1.9999, 2.0])
def test_attitude_is_interpolated(time_s: float) -> None:
    attitude = filled().attitude(time_s)
    assert attitude is not None
    assert yaw_from_quat(attitude) == pytest.approx(0.5 * time_s, abs=1e-9)


def test_attitude_outside_the_history_is_the_nearest() -> None:
    history = filled()
    assert history.attitude(-1.0) == IDENTITY
    assert history.attitude(3.0) == history.attitude(2.0)


@pytest.mark.parametrize("time_s", [0.1, 1.234, 1.995, 2.3])
def test_the_rate_of_turn_is_the_last_that_is_known(time_s: float) -> None:
    assert filled().rate_body_rad_s(time_s, 0.02) == pytest.approx((0.0, 0.0, 0.5), abs=1e-9)
    assert MotionHistory(1.0).rate_body_rad_s(time_s, 0.02) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("start_s", "end_s"), [(0.0, 2.0), (0.5, 1.2034), (0.7513, 0.7514), (1.0, 1.0)])
def test_motion_between_two_times_is_the_integral(start_s: float, end_s: float) -> None:
    dt = end_s - start_s
    place, speed, unseen = filled().moved(start_s, end_s)
    assert unseen is None
    assert speed == pytest.approx((dt + (end_s**2 - start_s**2) / 2, -2.0 * dt, 0.0), abs=1e-5)
    expected = dt * dt / 2 * (1.0 + start_s) + dt**3 / 6
    assert place == pytest.approx((expected, -dt * dt, 0.0), abs=1e-5)


def test_beyond_the_newest_sample_the_acceleration_goes_on() -> None:
    place, speed, _ = filled().moved(2.0, 2.1)
    assert speed == pytest.approx((0.3, -0.2, 0.0))
    assert place == pytest.approx((0.015, -0.01, 0.0))


@pytest.mark.parametrize("arbitrary_m_s", [0.0, 7.0])
def test_a_corrected_clock_moves_nothing_however_fast_the_integral_began(arbitrary_m_s: float) -> None:
    """A sample 10 ms after the last one by the IMU's own clock, 60 ms by ours."""
    history = MotionHistory(5.0)
    history.add(0.0, IDENTITY, (arbitrary_m_s, 0.0, 0.0))
    history.add(1.0, IDENTITY, (arbitrary_m_s, 0.0, 0.0))
    history.add(1.01, IDENTITY, (0.0, 0.0, 0.0))
    history.add(1.02, IDENTITY, (0.0, 0.0, 0.0))
    history.add(1.08, IDENTITY, (0.0, 0.0, 0.0), span_s=0.01)
    history.add(1.09, IDENTITY, (0.0, 0.0, 0.0), span_s=0.01)
    place, speed, _ = history.moved(1.015, 1.09)
    assert place == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert speed == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def gapped(gap_s: float) -> MotionHistory:
    """200 Hz, but for a gap after 1 s."""
    history = MotionHistory(1.0)
    for k in range(300):
        history.add(k / 200 + gap_s * (k > 200), IDENTITY, (0.0, 0.0, 0.0))
    return history


@pytest.mark.parametrize("end_s", [1.2, 1.7, 1.9])
def test_a_motion_in_two_steps_is_as_uncertain_as_in_one(end_s: float) -> None:
    """Wherever they meet: before the gap, in it, at its end or after it."""
    history = gapped(0.5)
    whole = history.moved(0.5, end_s)[2]
    for middle_s in (0.8, 1.1, 1.504, 1.6):
        if middle_s < end_s:
            dt = end_s - middle_s
            F = np.array([[1.0, dt], [0.0, 1.0]])
            first, second = (history.moved(*span)[2] for span in ((0.5, middle_s), (middle_s, end_s)))
            first, second = (np.zeros((2, 2)) if part is None else part for part in (first, second))
            assert F @ first @ F.T + second == pytest.approx(whole)


@pytest.mark.parametrize("gap_s", [0.1, 0.3, 0.8])
def test_a_gap_may_have_missed_what_the_kalman_filter_says(gap_s: float) -> None:
    unseen = gapped(gap_s).moved(0.9, 1.5 + gap_s)[2]
    assert unseen is not None
    assert unseen[1, 1] == pytest.approx(unseen_velocity_m2_s2(gap_s + 0.005))
    assert np.linalg.det(unseen) > 0.0


def test_silence_is_a_gap_that_has_not_ended() -> None:
    silent, over = filled(), filled()
    over.add(2.5, IDENTITY, (0.0, 0.0, 0.0))
    assert silent.moved(1.9, 2.5)[2] == pytest.approx(over.moved(1.9, 2.5)[2])
    assert silent.moved(1.9, 2.04)[2] is None, "no longer than a step"


def test_no_gap_but_a_corrected_clock_leaves_nothing_unseen() -> None:
    history = filled()
    history.add(2.4, IDENTITY, (0.0, 0.0, 0.0), span_s=0.005)
    assert history.moved(1.9, 2.4)[2] is None


def test_a_gap_is_forgotten_with_its_samples() -> None:
    history = gapped(0.3)
    assert history._gaps
    for k in range(500):
        history.add(1.8 + k / 200, IDENTITY, (0.0, 0.0, 0.0))
    assert not history._gaps


@pytest.mark.parametrize("gap_s", [0.0, 0.3])
def test_what_was_measured_with_a_wrong_attitude_is_turned(gap_s: float) -> None:
    """Attitude and motion from then on are those of the right one; what a gap has hidden is no correction."""
    turn, speed_m_s = quat_from_euler(0.08, -0.05, 0.3), 4.0
    wrong, right = MotionHistory(5.0), MotionHistory(5.0)
    for k in range(400):
        t, off = k / 200 + gap_s * (k > 200), k > 200
        attitude = quat_from_euler(0.1 * math.sin(3.0 * t), 0.0, 0.4 * t)
        force = quat_rotate(attitude, (0.3, math.cos(5.0 * t), -10.0))
        before = (speed_m_s, 0.0, 0.0) if k == 0 else (0.0, 0.0, 0.0)  # the integral starts anywhere
        right_force = quat_rotate(turn, force) if off else force
        wrong.add(t, attitude, add(add(force, before), (0.0, 0.0, GRAVITY_M_S2)))
        right.add(
            t,
            quat_multiply(turn, attitude) if off else attitude,
            add(add(right_force, before), (0.0, 0.0, GRAVITY_M_S2)),
        )
    from_s, newest_s = 201 / 200 + gap_s, wrong.newest_s
    assert newest_s is not None
    wrong.turn(1.0 if gap_s else from_s, from_s, turn)
    assert wrong.turned_since_s == pytest.approx(1.0 if gap_s else from_s)
    for start_s, end_s in (
        (from_s, newest_s),
        (from_s + 0.11, from_s + 0.5),
        (newest_s - 0.2, newest_s + 0.05),
    ):
        for ours, expected in zip(
            wrong.moved(start_s, end_s)[:2], right.moved(start_s, end_s)[:2], strict=True
        ):
            assert ours == pytest.approx(expected, abs=1e-9)
        ours_q, expected_q = wrong.attitude(end_s), right.attitude(end_s)
        assert ours_q == pytest.approx(expected_q)
    corrected = rotation_vector_from_quat(turn)
    assert wrong.corrected(0.9, from_s) == pytest.approx((0.0, 0.0, 0.0) if gap_s else corrected)
    assert wrong.corrected(0.9, newest_s + 0.1) == pytest.approx((0.0, 0.0, 0.0) if gap_s else corrected)
    assert wrong.corrected(from_s, newest_s) == (0.0, 0.0, 0.0)
    unknown = wrong.moved(newest_s - 0.1, newest_s)[2]
    if gap_s:
        assert unknown is None
    else:
        assert unknown is not None
        assert unknown[1, 1] == pytest.approx(misled_velocity_m_s(corrected) ** 2)


def test_one_sample_can_be_turned() -> None:
    history = MotionHistory(5.0)
    history.add(0.0, IDENTITY, (0.0, 0.0, 0.0))
    history.turn(0.0, 0.0, quat_from_euler(0.1, 0.0, 0.0))
    assert history.attitude(0.0) == pytest.approx(quat_from_euler(0.1, 0.0, 0.0))
    assert np.isfinite(history.moved(-0.01, 0.01)[0]).all()


def test_old_samples_are_forgotten_and_the_span_kept() -> None:
    history = filled(duration_s=10.0, span_s=1.0)
    attitude = history.attitude(9.0)
    assert attitude is not None
    assert yaw_from_quat(attitude) == pytest.approx(math.remainder(4.5, math.tau), abs=1e-9)
    assert len(history._times_s) <= 401
    assert np.isfinite(history.moved(9.0, 10.0)[0]).all()


def test_a_correction_holds_from_the_next_sample_on() -> None:
    """Between the two it is interpolated, as the attitude is."""
    history = filled(duration_s=1.0)
    history.correct((0.01, -0.02, 0.03))
    assert history.corrected(0.5, 1.0) == (0.0, 0.0, 0.0), "the newest sample was before it"
    assert history.corrected(0.5, 1.001) == (0.01, -0.02, 0.03), "what is predicted comes after it"
    history.add(1.005, IDENTITY, (0.0, 0.0, 0.0))
    history.correct((0.01, 0.0, 0.0))
    history.add(1.010, IDENTITY, (0.0, 0.0, 0.0))
    assert history.corrected(0.5, 1.0) == (0.0, 0.0, 0.0)
    assert history.corrected(0.5, 1.0025) == pytest.approx((0.005, -0.01, 0.015))
    assert history.corrected(0.5, 1.005) == pytest.approx((0.01, -0.02, 0.03))
    assert history.corrected(1.005, 1.010) == pytest.approx((0.01, 0.0, 0.0))
    assert history.corrected(-1.0, 0.5) == (0.0, 0.0, 0.0)
    assert MotionHistory(1.0).corrected(0.0, 1.0) == (0.0, 0.0, 0.0)
