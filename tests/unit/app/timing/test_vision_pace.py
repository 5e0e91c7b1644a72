"""Vision takes fewer frames before control is late, in announced steps."""

import asyncio

from companion.app.timing.vision_pace import CALM_CYCLES, CYCLES, FRAMES, VisionPace
from companion.base.clock import Clock, run_in_virtual_time

PERIOD_S = 1.0 / 30.0


def frames(pace: VisionPace, took_s: float, count: int = FRAMES) -> float:
    """Let vision take so many frames; returns how long it rested after each (s)."""

    async def work() -> float:
        clock = Clock()
        began_s = clock.now_s()
        for _ in range(count):
            await pace.rest(took_s)
        await asyncio.sleep(0.0)
        return (clock.now_s() - began_s) / count

    return run_in_virtual_time(work())


def cycles(pace: VisionPace, late_s: float, count: int = CYCLES) -> None:
    for _ in range(count):
        pace.judge(late_s, PERIOD_S)


def test_late_control_takes_frames_from_vision_step_by_step_and_says_each_once() -> None:
    said: list[str] = []
    pace = VisionPace(lambda _kind, text, _severity: said.append(text))
    assert frames(pace, 0.05) == 0.0
    cycles(pace, 0.004, 2 * CYCLES)
    assert not said
    cycles(pace, 0.02, 3 * CYCLES)
    assert said[0] == "control 17 ms late: vision takes 1 of 2 frames"  # as soon as they are late on average
    assert said[1:] == [f"control 20 ms late: vision takes 1 of {n} frames" for n in (3, 4)]
    # four of its times are as long as a pad may be unseen: no fewer, however late control is
    cycles(pace, 0.02, 5 * CYCLES)
    assert said[3:] == ["control 20 ms late, vision already at its lowest rate"]
    assert abs(frames(pace, 0.05) - 0.15) < 1e-9


def test_control_in_time_for_long_gives_them_back() -> None:
    said: list[str] = []
    pace = VisionPace(lambda _kind, text, _severity: said.append(text))
    frames(pace, 0.05)
    cycles(pace, 0.02)
    cycles(pace, 0.0, CALM_CYCLES - 1)
    assert len(said) == 1
    cycles(pace, 0.0, 1)
    assert said[1] == "control in time: vision takes every frame"
    assert frames(pace, 0.05) == 0.0


def test_a_vision_that_is_slow_by_itself_is_not_slowed_any_more_and_late_control_is_told_once() -> None:
    said: list[str] = []
    pace = VisionPace(lambda _kind, text, _severity: said.append(text))
    frames(pace, 0.21)
    told = ["control 50 ms late, vision already at its lowest rate"]
    cycles(pace, 0.05, 5 * CYCLES)
    assert said == told
    assert pace.rests == 0
    cycles(pace, 0.0, CALM_CYCLES)  # in time for long, it is told anew
    cycles(pace, 0.05)
    assert len(said) == 2
