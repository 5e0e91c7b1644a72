"""A loop that stood still: silent until it turns again, and then it waits for the autopilot's next word."""

import asyncio
from collections.abc import Callable

import pytest

from companion.app.timing.loop_monitor import BUFFER_S, CYCLES, LoopMonitor
from companion.app.timing.vision_pace import FRAMES, VisionPace
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.messages import UNKNOWN_TIMEOUT_S, AutopilotSetup
from companion.config import LinkConfig
from companion.link.session import Session
from companion.plan.mission.inputs import ComputerLoad

PERIOD_S = 1.0 / 30.0


class ToldSession(Session):
    """Of an autopilot that keeps setpoints for so long."""

    def __init__(self, keeps_setpoint_s: float | None) -> None:
        super().__init__(LinkConfig())
        self._told = AutopilotSetup(setpoint_timeout_s=keeps_setpoint_s)

    @property
    def setup(self) -> AutopilotSetup:
        return self._told


def monitored(work, keeps_setpoint_s: float | None = 1.0) -> None:  # type: ignore[no-untyped-def]
    """Run a coroutine function of (monitor, session, clock) in virtual time."""

    async def main() -> None:
        session, clock = ToldSession(keeps_setpoint_s), Clock()
        await work(LoopMonitor(session, clock), session, clock)

    run_in_virtual_time(main())


def test_before_it_turns_and_after_its_end_nothing_is_held_back() -> None:
    async def work(monitor: LoopMonitor, _session: Session, _clock: Clock) -> None:
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

    monitored(work)


def test_late_cycles_are_counted_from_half_a_period_on() -> None:
    async def work(monitor: LoopMonitor, _session: Session, _clock: Clock) -> None:
        for late_s in (0.0, 0.4 * PERIOD_S, 0.6 * PERIOD_S, 3.0):
            monitor.turn(late_s, PERIOD_S)
        assert monitor.late_share == 0.5
        for _ in range(CYCLES):
            monitor.turn(0.0, PERIOD_S)
        assert monitor.late_share == 0.0  # what was late long ago says nothing of now

    monitored(work)


@pytest.mark.parametrize(
    ("keeps_s", "stall_s"),
    [(1.0, 1.0), (0.4, 0.4), (None, UNKNOWN_TIMEOUT_S), (3.0, BUFFER_S)],  # the buffer holds no more
)
@pytest.mark.parametrize(("share", "stalled"), [(0.9, False), (1.1, True)])
def test_a_stall_waits_for_a_heartbeat_that_comes_now(
    keeps_s: float | None, stall_s: float, share: float, stalled: bool
) -> None:
    late_s = share * stall_s

    async def work(monitor: LoopMonitor, session: Session, clock: Clock) -> None:
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
        assert await monitor.catch_up(late_s, alive) is stalled
        waited_s = clock.now_s() - begun_s
        assert waited_s == (pytest.approx(0.6, abs=0.05) if stalled else 0.0)
        assert (kept_alive > 20) is stalled  # the watchdog is fed meanwhile
        assert not monitor.silent
        await heartbeat

    monitored(work, keeps_s)


def test_without_a_heartbeat_it_goes_on_after_the_link_s_time_out() -> None:
    async def work(monitor: LoopMonitor, session: Session, clock: Clock) -> None:
        begun_s = clock.now_s()
        assert await monitor.catch_up(5.0, lambda: None)
        assert clock.now_s() - begun_s == pytest.approx(session.heartbeat_timeout_s, abs=0.05)

    monitored(work)


def test_a_suspension_of_the_machine_counts_though_the_loop_s_clock_stood_still(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    suspended_s = 50.0  # before the app was started: no matter
    monkeypatch.setattr(Clock, "suspended_s", lambda _clock: suspended_s)

    async def work(monitor: LoopMonitor, _session: Session, _clock: Clock) -> None:
        nonlocal suspended_s
        monitor.turn(0.0, PERIOD_S)
        found = []
        # once it is held up between the two clocks: one reads early
        for slept_s in (0.0, 3600.0, 0.0, -1.2, 1.2):
            suspended_s += slept_s
            silent = monitor.silent
            found.append((silent, monitor.slept_s(), monitor.woke))
            monitor.turn(0.0, PERIOD_S)
        assert found == [(False, 0.0, False), (True, 3600.0, True), *[(False, 0.0, False)] * 3]

    monitored(work)


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
def test_a_computer_that_is_too_slow_says_so(
    late_s: tuple[float, ...], vision_s: float, words: str | None
) -> None:
    async def work(_: LoopMonitor, session: Session, clock: Clock) -> None:
        pace = VisionPace(lambda *_said: None)
        monitor = LoopMonitor(session, clock, pace)
        assert monitor.load == ComputerLoad()
        for _k in range(FRAMES):
            await pace.rest(vision_s)
        for k in range(30):
            monitor.turn(late_s[k % len(late_s)], PERIOD_S)
        assert monitor.load == ComputerLoad(words, max(late_s))

    monitored(work)
