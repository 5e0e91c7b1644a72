"""Control cycles that follow the camera: at once after a frame, and steady without one."""

import asyncio
import sys
from collections.abc import Callable, Iterable
from itertools import accumulate, pairwise, repeat
from statistics import mean
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.app.app import App
from companion.app.pacing import (
    BUFFER_S,
    CALM_CYCLES,
    CYCLES,
    EARLIEST,
    FRAMES,
    INTERVALS,
    JUDGED_CYCLES,
    LATEST,
    ControlTimer,
    LoopMonitor,
    VisionPace,
)
from companion.app.stages import EstimateWatch
from companion.base.clock import HAND_OVER_S, Clock
from companion.base.messages import (
    UNKNOWN_TIMEOUT_S,
    AutopilotSetup,
    AutopilotState,
    EstimatorInputs,
    LandedState,
    Phase,
)
from companion.config import LinkConfig
from companion.estimate.input_tally import InputTally
from companion.link.session import Session
from companion.plan.inputs import ComputerLoad
from tests.virtual_time import in_virtual_time

PERIOD_S = 1.0 / 30.0
LONGEST_S = (1.0 + EARLIEST + LATEST) * PERIOD_S
SHORTEST_S = (1.0 - EARLIEST - LATEST) * PERIOD_S
WARM = 3 * INTERVALS  # cycles until frames are followed


@in_virtual_time
async def cycles(
    frames_s: Iterable[float], until_s: float = 5.0, work_s: float = 0.003
) -> tuple[list[float], list[float], list[float]]:
    """When cycles began, how old the newest frame was then, and how late they were (s)."""
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
def test_whatever_frames_do_a_cycle_comes_within_bounds(make: Callable[[np.random.Generator], float]) -> None:
    rng = np.random.default_rng(0)
    came = accumulate(make(rng) for _ in repeat(None, 3000))
    began_s, _, _ = cycles(came)
    assert min(periods(began_s)) >= SHORTEST_S - 1e-6
    assert max(periods(began_s)) <= LONGEST_S + 1e-6


@in_virtual_time
async def test_a_cycle_that_took_too_long_says_how_late_the_next_one_is() -> None:
    clock = Clock()
    timer = ControlTimer(clock, PERIOD_S)
    await asyncio.sleep(1.0)
    await timer.next_cycle()
    assert timer.late_s == pytest.approx(1.0 - PERIOD_S)
    timer.restart()
    assert timer.late_s == 0.0


# ---------------- The estimate starts again on the ground alone, and what became of its inputs is logged


class KnownSession:
    def __init__(self, state: AutopilotState) -> None:
        self.state = state


class StarvedEstimator:
    """One that would start again at once."""

    def __init__(self) -> None:
        self.tally, self.recovered = InputTally(), 0

    def recover(self, _: float) -> str:
        self.recovered += 1
        return "GPS refused for 10 s: estimate restarted"


class KeptLog:
    def __init__(self) -> None:
        self.written: list[object] = []

    def write(self, topic: str, message: object, _: float) -> None:
        assert topic == "estimator_inputs"
        self.written.append(message)


class WatchedEstimate:
    def __init__(self, state: AutopilotState) -> None:
        self.said: list[str] = []
        self.estimator, self.log = StarvedEstimator(), KeptLog()
        self.watch = EstimateWatch(
            self.estimator,  # type: ignore[arg-type]
            KnownSession(state),  # type: ignore[arg-type]
            self.log,  # type: ignore[arg-type]
            Clock(),
            lambda kind, text, severity: self.said.append(f"{kind}: {text}"),
        )


@pytest.mark.parametrize(
    ("armed", "landed", "starts"),
    [
        (False, LandedState.ON_GROUND, 1),
        (True, LandedState.ON_GROUND, 0),
        (False, LandedState.UNDEFINED, 0),
        (True, LandedState.IN_AIR, 0),
    ],
)
async def test_the_estimate_starts_again_only_where_nothing_flies_by_it(
    armed: bool, landed: LandedState, starts: int
) -> None:
    watched = WatchedEstimate(AutopilotState(0.0, armed=armed, landed=landed))
    watched.watch.look(1.0)
    assert watched.estimator.recovered == starts
    assert len(watched.said) == starts
    assert [type(message) for message in watched.log.written] == [EstimatorInputs]


# ----------------
# The control loop's share of the interpreter, beside threads that compute: vision, and the flight log's.


def test_in_real_time_too_a_thread_that_computes_hands_the_interpreter_over_soon() -> None:
    # each system call of the loop would else wait for 5 ms: the minute that an order writes made cycles late
    async def nothing() -> None:
        pass

    async def fly() -> tuple[Phase, float]:
        app: Any = object.__new__(App)
        app._clock = Clock()
        app._actions = SimpleNamespace(start=nothing, close=nothing)
        app._service = SimpleNamespace(stopping=lambda: None)
        during_s = list[float]()

        async def run_tasks() -> Phase:
            during_s.append(sys.getswitchinterval())
            return Phase.LANDED

        app._run_tasks = run_tasks
        return await app.run(), during_s[0]

    before_s = sys.getswitchinterval()
    phase, interval_s = asyncio.run(fly())
    assert (phase, round(interval_s, 6)) == (Phase.LANDED, HAND_OVER_S)
    assert sys.getswitchinterval() == before_s > HAND_OVER_S


# ----------------
# A loop that stood still: silent until it turns again, and then it waits for the autopilot's next word.


class ToldSession(Session):
    """Of an autopilot that keeps setpoints for so long."""

    def __init__(self, keeps_setpoint_s: float | None = 1.0) -> None:
        super().__init__(LinkConfig())
        self._told = AutopilotSetup(setpoint_timeout_s=keeps_setpoint_s)

    @property
    def setup(self) -> AutopilotSetup:
        return self._told


@in_virtual_time
async def test_before_it_turns_and_after_its_end_nothing_is_held_back() -> None:
    monitor = LoopMonitor(ToldSession(), Clock())
    said = []
    steps: tuple[Callable[[], None], ...] = (
        lambda: None,
        lambda: monitor.turn(0.0, PERIOD_S),
        monitor.end,
    )
    for step in steps:
        step()
        await asyncio.sleep(2.0 * BUFFER_S)
        said.append(monitor.silent)
    assert said == [False, True, False]


@in_virtual_time
async def test_late_cycles_are_counted_from_half_a_period_on() -> None:
    monitor = LoopMonitor(ToldSession(), Clock())
    for late_s in (0.0, 0.4 * PERIOD_S, 0.6 * PERIOD_S, 3.0):
        monitor.turn(late_s, PERIOD_S)
    assert monitor.late_share == 0.5
    for _ in range(CYCLES):
        monitor.turn(0.0, PERIOD_S)
    assert monitor.late_share == 0.0  # what was late long ago says nothing of now


@pytest.mark.parametrize(
    ("keeps_s", "stall_s"),
    [(1.0, 1.0), (0.4, 0.4), (None, UNKNOWN_TIMEOUT_S), (3.0, BUFFER_S)],  # the buffer holds no more
)
@pytest.mark.parametrize(("share", "stalled"), [(0.9, False), (1.1, True)])
@in_virtual_time
async def test_a_stall_waits_for_a_heartbeat_that_comes_now(
    keeps_s: float | None, stall_s: float, share: float, stalled: bool
) -> None:
    session, clock = ToldSession(keeps_s), Clock()
    monitor = LoopMonitor(session, clock)
    session.heartbeats = 7
    kept_alive = 0

    def alive() -> None:
        nonlocal kept_alive
        kept_alive += 1

    async def later() -> None:
        await asyncio.sleep(0.6)
        session.heartbeats += 1

    heartbeat = asyncio.create_task(later())
    monitor.turn(0.0, PERIOD_S)
    begun_s = clock.now_s()
    assert await monitor.catch_up(share * stall_s, alive) is stalled
    waited_s = clock.now_s() - begun_s
    assert waited_s == (pytest.approx(0.6, abs=0.05) if stalled else 0.0)
    assert (kept_alive > 20) is stalled  # the watchdog is fed meanwhile
    assert not monitor.silent
    await heartbeat


@in_virtual_time
async def test_without_a_heartbeat_it_goes_on_after_the_link_s_time_out() -> None:
    session, clock = ToldSession(), Clock()
    monitor = LoopMonitor(session, clock)
    begun_s = clock.now_s()
    assert await monitor.catch_up(5.0, lambda: None)
    assert clock.now_s() - begun_s == pytest.approx(session.heartbeat_timeout_s, abs=0.05)


@in_virtual_time
async def test_a_suspension_of_the_machine_counts_though_the_loop_s_clock_stood_still(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    suspended_s = 50.0  # before the app was started: no matter
    monkeypatch.setattr(Clock, "suspended_s", lambda _clock: suspended_s)
    monitor = LoopMonitor(ToldSession(), Clock())
    monitor.turn(0.0, PERIOD_S)
    found = []
    # once it is held up between the two clocks: one reads early
    for slept_s in (0.0, 3600.0, 0.0, -1.2, 1.2):
        suspended_s += slept_s
        silent = monitor.silent
        found.append((silent, monitor.slept_s(), monitor.woke))
        monitor.turn(0.0, PERIOD_S)
    assert found == [(False, 0.0, False), (True, 3600.0, True), *[(False, 0.0, False)] * 3]


@pytest.mark.parametrize(
    ("late_s", "vision_s", "words"),
    [
        ((0.09,), 0.19, None),
        ((0.12,), 0.05, "computer too slow: control 120 ms late, limit 100"),
        ((0.0,), 0.25, "computer too slow: vision 250 ms a frame, limit 200"),
        # one stall, however long, is not slowness; one cycle in five that stands still for a second is
        ((0.0,) * 29 + (9.0,), 0.05, None),
        ((0.0,) * 4 + (9.0,), 0.05, "computer too slow: control 200 ms late, limit 100"),
    ],
)
@in_virtual_time
async def test_a_computer_that_is_too_slow_says_so(
    late_s: tuple[float, ...], vision_s: float, words: str | None
) -> None:
    pace = VisionPace(lambda *_said: None)
    monitor = LoopMonitor(ToldSession(), Clock(), pace)
    assert monitor.load == ComputerLoad()
    for _k in range(FRAMES):
        await pace.rest(vision_s)
    for k in range(30):
        monitor.turn(late_s[k % len(late_s)], PERIOD_S)
    assert monitor.load == ComputerLoad(words, max(late_s), late_s[29 % len(late_s)])


# ---------------- Vision takes fewer frames before control is late, in announced steps


@in_virtual_time
async def frames_taken(pace: VisionPace, took_s: float, count: int = FRAMES) -> float:
    """Let vision take so many frames; returns how long it rested after each (s)."""
    clock = Clock()
    began_s = clock.now_s()
    for _ in range(count):
        await pace.rest(took_s)
    await asyncio.sleep(0.0)
    return (clock.now_s() - began_s) / count


def late_cycles(pace: VisionPace, late_s: float, count: int = JUDGED_CYCLES) -> None:
    for _ in range(count):
        pace.judge(late_s, PERIOD_S)


def test_late_control_takes_frames_from_vision_step_by_step_and_says_each_once() -> None:
    said: list[str] = []
    pace = VisionPace(lambda _kind, text, _severity: said.append(text))
    assert frames_taken(pace, 0.05) == 0.0
    late_cycles(pace, 0.02, 2 * JUDGED_CYCLES)
    assert not said
    late_cycles(pace, 0.04, 3 * JUDGED_CYCLES)
    assert said[0] == "control 34 ms late: vision takes 1 of 2 frames"  # as soon as they are late on average
    assert said[1:] == [f"control 40 ms late: vision takes 1 of {n} frames" for n in (3, 4)]
    # four of its times are as long as a pad may be unseen: no fewer, however late control is
    late_cycles(pace, 0.04, 5 * JUDGED_CYCLES)
    assert said[3:] == ["control 40 ms late, vision already at its lowest rate"]
    assert abs(frames_taken(pace, 0.05) - 0.15) < 1e-9


def test_control_in_time_for_long_gives_them_back() -> None:
    said: list[str] = []
    pace = VisionPace(lambda _kind, text, _severity: said.append(text))
    frames_taken(pace, 0.05)
    late_cycles(pace, 0.04)
    late_cycles(pace, 0.0, CALM_CYCLES - 1)
    assert len(said) == 1
    late_cycles(pace, 0.0, 1)
    assert said[1] == "control in time: vision takes every frame"
    assert frames_taken(pace, 0.05) == 0.0


def test_a_vision_that_is_slow_by_itself_is_not_slowed_any_more_and_late_control_is_told_once() -> None:
    said: list[str] = []
    pace = VisionPace(lambda _kind, text, _severity: said.append(text))
    frames_taken(pace, 0.21)
    told = ["control 50 ms late, vision already at its lowest rate"]
    late_cycles(pace, 0.05, 5 * JUDGED_CYCLES)
    assert said == told
    assert pace.rests == 0
    late_cycles(pace, 0.0, CALM_CYCLES)  # in time for long, it is told anew
    late_cycles(pace, 0.05)
    assert len(said) == 2
