"""The autopilot's clock: one that drifts, stands still, starts anew, and a line that delays."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.link.timesync import SLOWEST
from tests.unit.link.timing.far_clock import IMU_S, FarClock, StampedSample, usable

ONE_STEP = 1.5 * IMU_S


def refused(heard: list[StampedSample]) -> int:
    return sum(sample.instant is None for sample in heard)


def steps_s(heard: list[StampedSample]) -> list[float]:
    """From each used sample's time to the next one's."""
    times = [sample.instant.time_s for sample in heard if sample.instant is not None]
    return [b - a for a, b in pairwise(times)]


def stalled(ours_s: float) -> float:
    """2 % slow, and standing still from 5.0 to 5.3 s."""
    return 50.0 + 0.98 * (ours_s - min(max(ours_s - 5.0, 0.0), 0.3))


def worst_s(heard: list[StampedSample]) -> float:
    return max(abs(sample.error_s) for sample in heard)


@pytest.mark.parametrize("rate", [-0.03, -1e-4, 0.0, 0.03])
def test_a_clock_that_runs_fast_or_slow_is_followed_to_the_millisecond(rate: float) -> None:
    far = FarClock(lambda ours_s: 700.0 + (1.0 + rate) * ours_s)
    heard = usable(far.run(20.0))
    assert refused(heard) == 0
    assert worst_s(heard) < 0.002
    assert max(steps_s(heard)) < ONE_STEP
    assert min(steps_s(heard)) > 0.8 * IMU_S


def test_after_a_stall_of_that_clock_the_times_jump_ahead_once_and_no_sample_is_lost() -> None:
    far = FarClock(stalled)
    heard = usable(far.run(10.0))
    fresh = [sample for sample in heard if not 5.0 < sample.measured_s < 5.301]
    assert refused(fresh) == 0
    steps = steps_s(fresh)
    assert min(steps) > 0.0
    assert sum(step > 0.02 for step in steps) <= 3
    assert worst_s([sample for sample in heard if sample.measured_s > 5.7]) < 0.005


def test_an_interval_is_the_stamps_own_whatever_the_mapping_does_meanwhile() -> None:
    far = FarClock(stalled)
    heard = [sample for sample in usable(far.run(10.0)) if sample.instant is not None]
    for before, after in pairwise(heard):
        assert after.instant is not None
        assert after.instant.interval_s == pytest.approx(after.stamp_s - before.stamp_s, abs=1e-9)


def test_a_stall_of_our_own_receiving_changes_no_time() -> None:
    # what arrives between 5.0 and 5.3 s is heard at 5.3 s
    far = FarClock(lambda ours_s: 50.0 + ours_s, back=lambda t: max(0.001, 5.3 - t) if t > 5.0 else 0.001)
    heard = usable(far.run(10.0))
    assert refused(heard) == 0
    assert worst_s(heard) < 0.002
    assert max(steps_s(heard)) < ONE_STEP


@pytest.mark.parametrize("way", ["there", "back"])
def test_a_round_trip_of_half_a_second_moves_nothing(way: str) -> None:
    far = FarClock(lambda ours_s: 50.0 + 0.97 * ours_s)

    def slow(time_s: float) -> float:
        return 0.5 if 4.95 < time_s < 5.05 else 0.001

    if way == "there":
        far.there = slow
    else:
        far.back = slow
    heard = usable(far.run(10.0))
    assert refused(heard) == 0
    assert worst_s(heard) < 0.003


def test_jittered_delays_leave_the_times_smooth() -> None:
    rng = np.random.default_rng(1)

    def jitter(_: float) -> float:
        return 0.002 + float(rng.exponential(0.005))

    far = FarClock(lambda ours_s: 50.0 + 1.00005 * ours_s, there=jitter, back=jitter)
    heard = usable(far.run(30.0), from_s=3.0)
    assert refused(heard) == 0
    assert worst_s(heard) < 0.004
    errors = np.array([sample.error_s for sample in heard])
    assert errors.std() < 0.001
    assert max(steps_s(heard)) < ONE_STEP


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rate=st.floats(-0.04, 0.04),
    jitter_s=st.floats(0.0, 0.05),
    stall_s=st.floats(0.0, 0.5),
    pause_s=st.floats(0.0, 0.5),
)
def test_whatever_the_clock_and_the_line_do_later_stamps_have_later_times(
    seed: int, rate: float, jitter_s: float, stall_s: float, pause_s: float
) -> None:
    rng = np.random.default_rng(seed)

    def delay(time_s: float) -> float:
        return max(
            0.0005 + jitter_s * float(rng.exponential()), 2.0 + pause_s - time_s if time_s > 2.0 else 0.0
        )

    def theirs(time_s: float) -> float:
        return 50.0 + (1.0 + rate) * (time_s - min(max(time_s - 3.0, 0.0), stall_s))

    heard = usable(FarClock(theirs, there=delay, back=delay).run(5.0))
    used = [sample for sample in heard if sample.instant is not None]
    assert min(steps_s(heard)) > 0.0
    # what a pause lets come at once stays apart by a tenth of its own intervals
    beyond_s = 0.01 + SLOWEST * pause_s
    assert all(
        sample.instant is not None and sample.instant.time_s <= sample.heard_s + beyond_s for sample in used
    )


def test_a_reboot_starts_the_mapping_anew_and_no_old_time_is_given_meanwhile() -> None:
    # up for a minute; restarts at 5 s and is back 2 s later
    far = FarClock(lambda t: 60.0 + t if t < 5.0 else t - 6.9 if t >= 7.0 else math.nan)
    heard = usable(far.run(12.0))
    assert not any(abs(sample.error_s) > 0.003 for sample in heard if sample.measured_s > 7.0)
    again = [sample for sample in heard if sample.measured_s > 8.0]
    assert refused(again) == 0
    assert min(steps_s(heard)) > 0.0


def test_the_time_across_a_reboot_is_no_interval() -> None:
    far = FarClock(lambda ours_s: 60.0 + ours_s if ours_s < 5.0 else ours_s - 4.9)
    back = [sample for sample in far.run(8.0) if sample.measured_s > 5.0 and sample.instant is not None]
    first = back[0].instant
    assert first is not None
    assert first.interval_s is None


def test_what_is_known_to_come_later_than_it_goes_is_dated_anew_in_order() -> None:
    far = FarClock(lambda ours_s: 700.0 + ours_s, back=lambda _: 0.081)
    far.run(4.0)
    assert far.heard[-1].error_s == pytest.approx(0.04, abs=1e-3)
    far = FarClock(lambda ours_s: 700.0 + ours_s, back=lambda _: 0.081)

    def slew(told_s: float) -> float:
        far.clock.late_s = min(0.04, max(0.0, 0.01 * (told_s - 1.0)))
        return 700.0 + told_s

    far.theirs = slew
    heard = usable(far.run(8.0), 6.0)
    assert max(abs(sample.error_s) for sample in heard) < 1e-3
    times_s = [sample.instant.time_s for sample in usable(far.heard) if sample.instant is not None]
    assert all(later_s > time_s for time_s, later_s in pairwise(times_s))
