"""Control cycles that follow the camera: at once after a frame, and steady without one."""

import asyncio
from collections.abc import Callable, Iterable
from itertools import accumulate, pairwise, repeat
from statistics import mean

import numpy as np
import pytest

from companion.app.timing.control_timer import EARLIEST, INTERVALS, LATEST, ControlTimer
from companion.base.clock import Clock, run_in_virtual_time

PERIOD_S = 1.0 / 30.0
LONGEST_S = (1.0 + EARLIEST + LATEST) * PERIOD_S
SHORTEST_S = (1.0 - EARLIEST - LATEST) * PERIOD_S
WARM = 3 * INTERVALS  # cycles until frames are followed


def cycles(
    frames_s: Iterable[float], until_s: float = 5.0, work_s: float = 0.003
) -> tuple[list[float], list[float], list[float]]:
    """When cycles began, how old the newest frame was then, and how late they were (s)."""

    async def main() -> tuple[list[float], list[float], list[float]]:
        clock = Clock()
        timer = ControlTimer(clock, PERIOD_S)
        fused_s = float("nan")

        async def camera() -> None:
            nonlocal fused_s
            for frame_s in frames_s:
                await clock.sleep_until(frame_s)
                fused_s = clock.now_s()
                timer.frame_fused()

        sees = asyncio.create_task(camera())
        began_s, ages_s, late_s = [], [], []
        timer.restart()
        while clock.now_s() < until_s:
            began_s.append(clock.now_s())
            ages_s.append(clock.now_s() - fused_s)
            late_s.append(timer.late_s)
            await asyncio.sleep(work_s)
            await timer.next_cycle()
        sees.cancel()
        return began_s, ages_s, late_s

    return run_in_virtual_time(main())


def frames(interval_s: float, first_s: float = 0.0, count: int = 1000) -> list[float]:
    return [first_s + n * interval_s for n in range(count)]


def periods(began_s: list[float]) -> list[float]:
    return [b - a for a, b in pairwise(began_s)]


@pytest.mark.parametrize("phase", [0.05, 0.25, 0.45, 0.55, 0.75, 0.95])
@pytest.mark.parametrize("rate_hz", [29.7, 29.97, 30.0, 30.3, 60.0, 90.0])
def test_a_cycle_begins_as_soon_as_a_frame_is_fused(rate_hz: float, phase: float) -> None:
    began_s, ages_s, late_s = cycles(frames(1.0 / rate_hz, phase * PERIOD_S))
    assert max(ages_s[WARM:]) < 1e-6
    assert max(late_s) < 1e-6
    assert mean(periods(began_s[WARM:])) == pytest.approx(PERIOD_S, rel=0.02)


@pytest.mark.parametrize("rate_hz", [5.0, 15.0, 20.0, 25.0, 40.0, 50.0])
def test_a_camera_whose_rate_does_not_fit_leaves_the_timer_alone(rate_hz: float) -> None:
    began_s, _, _ = cycles(frames(1.0 / rate_hz))
    assert periods(began_s) == pytest.approx([PERIOD_S] * (len(began_s) - 1), abs=1e-6)


def test_without_frames_the_timer_is_steady() -> None:
    began_s, _, late_s = cycles([])
    assert periods(began_s) == pytest.approx([PERIOD_S] * (len(began_s) - 1), abs=1e-6)
    assert max(late_s) < 1e-6


def test_a_lost_camera_stops_no_cycle_and_one_that_is_back_is_followed() -> None:
    seen = [*frames(PERIOD_S, 0.01, 60), *frames(PERIOD_S, 3.02)]
    began_s, ages_s, _ = cycles(seen, until_s=6.0)
    assert max(periods(began_s)) <= LONGEST_S + 1e-6
    blind = [period for began, period in zip(began_s[1:], periods(began_s), strict=True) if 2.2 < began < 3.0]
    assert blind == pytest.approx([PERIOD_S] * len(blind), abs=1e-6)
    assert max(age for began, age in zip(began_s, ages_s, strict=True) if began > 3.3) < 1e-6


def test_a_frame_that_is_lost_is_waited_for_once_and_no_other_is_late() -> None:
    whole = frames(PERIOD_S, 0.01)
    began_s, ages_s, _ = cycles([*whole[:100], *whole[101:]])
    assert max(periods(began_s[WARM:])) == pytest.approx((1.0 + LATEST) * PERIOD_S)
    assert sum(age > 0.1 * PERIOD_S for age in ages_s[WARM:]) == 1


@pytest.mark.parametrize(("spread", "oldest"), [(0.05, 0.03), (0.1, 0.1), (0.2, 0.3), (0.3, 0.5)])
@pytest.mark.parametrize("seed", range(3))
def test_frames_that_come_unevenly_are_waited_for(spread: float, oldest: float, seed: int) -> None:
    spread_s = np.random.default_rng(seed).uniform(-spread, spread, 1000) * PERIOD_S
    began_s, ages_s, _ = cycles((np.array(frames(PERIOD_S, 0.01)) + spread_s).tolist(), until_s=30.0)
    assert np.percentile(ages_s[WARM:], 99) < oldest * PERIOD_S
    assert mean(periods(began_s[WARM:])) == pytest.approx(PERIOD_S, rel=0.01)
    # no less steady than the frames themselves
    assert np.std(periods(began_s[WARM:])) < 0.9 * spread * PERIOD_S


@pytest.mark.parametrize(
    "make", [lambda rng: rng.exponential(PERIOD_S), lambda rng: rng.choice([1e-6, 0.08])]
)
def test_whatever_frames_do_a_cycle_comes_within_bounds(
    make: Callable[[np.random.Generator], float],
) -> None:
    rng = np.random.default_rng(0)
    came = accumulate(make(rng) for _ in repeat(None, 3000))
    began_s, _, _ = cycles(came)
    assert min(periods(began_s)) >= SHORTEST_S - 1e-6
    assert max(periods(began_s)) <= LONGEST_S + 1e-6


def test_a_cycle_that_took_too_long_says_how_late_the_next_one_is() -> None:
    async def main() -> None:
        clock = Clock()
        timer = ControlTimer(clock, PERIOD_S)
        await asyncio.sleep(1.0)
        await timer.next_cycle()
        assert timer.late_s == pytest.approx(1.0 - PERIOD_S)
        timer.restart()
        assert timer.late_s == 0.0

    run_in_virtual_time(main())
