"""Frames without a time of their own: which of them came in time, and which were held up."""

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.sense.camera.rhythm import LATE_S, SURE_S, FrameRhythm

DELAY_S = 0.1


def exposures_s(rate_hz: float, count: int = 600) -> FloatArray:
    return np.arange(count) / rate_hz


def arrivals_s(exposed_s: FloatArray, jitter_s: float, seed: int = 0) -> FloatArray:
    """After the usual delay and some more, in order."""
    more_s = np.random.default_rng(seed).exponential(jitter_s, len(exposed_s))
    return np.maximum.accumulate(exposed_s + DELAY_S + more_s)


def held_up_s(arrivals: FloatArray, from_s: float, stall_s: float, line_s: float) -> FloatArray:
    """As a link that stalls hands them on: what was queued follows, each so long after the one before."""
    held = arrivals.copy()
    held[(held >= from_s) & (held < from_s + stall_s)] = from_s + stall_s
    for k in range(1, len(held)):
        held[k] = max(held[k], held[k - 1] + line_s) if held[k] < held[k - 1] + line_s else held[k]
    return held


def taken(rate_hz: float, arrivals: FloatArray, numbers: FloatArray | None = None) -> NDArray[np.bool_]:
    """Which frames count as in time, of a camera whose settings say `rate_hz`."""
    rhythm = FrameRhythm(rate_hz)
    counted = range(len(arrivals)) if numbers is None else numbers
    return np.array(
        [rhythm.in_time(int(n), float(a)) for n, a in zip(counted, arrivals, strict=True)], dtype=bool
    )


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 30.0, 60.0])
@pytest.mark.parametrize("setting_hz", [1.0, 0.8, 2.0])
def test_frames_that_come_as_ever_are_in_time_at_whatever_rate(rate_hz: float, setting_hz: float) -> None:
    good = taken(setting_hz * rate_hz, arrivals_s(exposures_s(rate_hz), 0.004))
    assert good[60:].mean() > 0.99


@pytest.mark.parametrize("setting_hz", [1.0, 0.8, 2.0])
@pytest.mark.parametrize("stall_s", [0.1, 0.3, 0.8, 0.95])
@pytest.mark.parametrize(("rate_hz", "line_s"), [(10.0, 0.012), (30.0, 0.001), (30.0, 0.026), (60.0, 0.012)])
def test_what_a_stall_held_up_is_not_taken_for_new(
    rate_hz: float, line_s: float, stall_s: float, setting_hz: float
) -> None:
    exposed = exposures_s(rate_hz)
    arrivals = held_up_s(arrivals_s(exposed, 0.003), exposed[300], stall_s, line_s)
    late_s = arrivals - exposed - DELAY_S
    assert late_s.max() > stall_s - 1.0 / rate_hz
    good = taken(setting_hz * rate_hz, arrivals)
    # a slow line catches up over a hundred frames: the rhythm is known to 0.5 % of a period
    assert late_s[100:][good[100:]].max() < LATE_S + 0.005 * 100 / rate_hz + 0.003
    assert good[-30:].mean() > 0.95


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 30.0])
@pytest.mark.parametrize("lost", [1, 2, 20])
def test_after_frames_were_lost_the_next_ones_are_taken_after_a_fifth_of_a_second(
    rate_hz: float, lost: int
) -> None:
    exposed = np.delete(exposures_s(rate_hz), slice(300, 300 + lost))
    good = taken(rate_hz, arrivals_s(exposed, 0.002))
    assert np.count_nonzero(~good[100:]) <= SURE_S * rate_hz + 1


def test_frames_that_their_sender_counts_as_lost_cost_no_others() -> None:
    numbers = np.delete(np.arange(600.0), slice(300, 320))
    assert taken(30.0, arrivals_s(numbers / 30.0, 0.002), numbers).all()


@pytest.mark.parametrize("numbers", [np.zeros(600), np.arange(600.0) % 7, 33.0 * np.arange(600.0)])
def test_a_sender_that_does_not_count_is_read_all_the_same(numbers: FloatArray) -> None:
    assert taken(30.0, arrivals_s(exposures_s(30.0), 0.002), numbers)[60:].mean() > 0.8


def test_a_camera_that_halves_its_rate_and_doubles_it_again_is_followed() -> None:
    steps = np.repeat([1 / 30, 1 / 15, 1 / 30], 200)
    good = taken(30.0, arrivals_s(np.cumsum(steps), 0.004))
    assert np.count_nonzero(~good) <= 10


def test_a_heap_at_the_beginning_is_no_rhythm() -> None:
    arrivals = np.concatenate([np.linspace(0.0, 0.05, 50), 0.05 + exposures_s(30.0)[1:]])
    assert taken(30.0, arrivals)[80:].all()
