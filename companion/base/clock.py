"""Time: the only module that reads a clock.

Everything runs on an asyncio loop and takes its time from it. On the vehicle that is the monotonic
clock. In tests and in `companion --sitl --fast` it is `VirtualTimeLoop`: where a real loop would sleep
until the next timer, the virtual one jumps there, so that a minute's landing takes seconds and gives
the same result for the same seed.
"""

import asyncio
import gc
import os
import selectors
import sys
import time
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Final, ParamSpec, TypeVar

from companion.base.signals import run_until_stopped

T = TypeVar("T")
P = ParamSpec("P")
ALLOCATIONS_BETWEEN_COLLECTIONS: Final = 50_000  # CPython's own: 700
# of the youngest objects, after so many more than have died; of those that outlived it, after so many such;
# of all, practically never (CPython's own: 700, 10, 10)
IN_FLIGHT: Final = (5_000, 3, 1_000_000)
LOOK_OUTSIDE_EVERY: Final = 64  # turns of the virtual loop: a few milliseconds
BESIDE: Final = 2  # threads: a picture is drawn while the one before is searched
# how long a thread that wants the interpreter waits for the one that has it; CPython's own: 5 ms
HAND_OVER_S: Final = 1e-4


class NothingScheduled(RuntimeError):  # noqa: N818 - it reads as what happened
    """The virtual loop has no timer and no ready task: every task waits for something that never comes."""


class _JumpingSelector(selectors.SelectSelector):
    """A selector that moves the loop's clock on instead of waiting.

    All that can come from outside is a signal, or a thread's call; it looks for one now and then.
    """

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0
        self._turns = 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self._turns += 1
        if timeout is None or self._turns % LOOK_OUTSIDE_EVERY == 0:
            ready = super().select(0)
            if ready:
                return ready
        if timeout is None:
            raise NothingScheduled("every task waits and no timer is set")
        if timeout > 0.0:
            self.now_s += timeout
        return []


class _AtOnce(Executor):
    """Computes on the calling thread, before `submit` returns."""

    def submit(self, function: Callable[P, T], /, *arguments: P.args, **named: P.kwargs) -> Future[T]:
        future = Future[T]()
        try:
            future.set_result(function(*arguments, **named))
        except Exception as error:
            future.set_exception(error)
        return future


AT_ONCE: Final = _AtOnce()


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """An event loop whose time() starts at 0 and jumps to the next timer. No real input or output in it.

    `beside` computes while its time goes on: in threads, or at once where this process has one core, or is
    told to take no more by OMP_NUM_THREADS=1, as where flights share the cores. No fork takes threads along.
    """

    def __init__(self) -> None:
        self._jumping = _JumpingSelector()
        super().__init__(self._jumping)
        # a timer within the clock's resolution counts as due: keep it small, so that none is early
        self._clock_resolution = 1e-9
        alone = os.environ.get("OMP_NUM_THREADS") == "1" or os.cpu_count() == 1
        self.beside: Executor = AT_ONCE if alone else ThreadPoolExecutor(BESIDE, "beside the loop")

    def time(self) -> float:
        return self._jumping.now_s

    def close(self) -> None:
        self.beside.shutdown()
        super().close()


class Clock:
    """The running loop's time, and what depends on whether that time is real.

    Make it inside the loop whose time it tells.
    """

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.virtual = isinstance(self._loop, VirtualTimeLoop)

    def now_s(self) -> float:
        """Seconds of the loop's monotonic clock; CLOCK_MONOTONIC on the vehicle, from 0 in virtual time."""
        return self._loop.time()

    def suspended_s(self) -> float:
        """How long (s) the machine has been suspended since it booted: `now_s` does not count that time."""
        return 0.0 if self.virtual else boot_clock_ahead_s()

    async def sleep_until(self, time_s: float) -> None:
        """Return at time_s, or at the loop's next turn when that has passed."""
        await asyncio.sleep(max(0.0, time_s - self.now_s()))

    async def run(self, function: Callable[..., T], *arguments: Any, modelled_s: float) -> T:
        """Run a heavy pure function off the loop and return its result.

        In real time it takes a worker thread and as long as it takes. In virtual time, where computing
        takes no time, the result is held back for `modelled_s`, so that its latency is not hidden.
        What is given no time is computed on the loop: it may read what changes.
        """
        if not self.virtual:
            return await asyncio.to_thread(function, *arguments)
        if modelled_s <= 0.0:
            try:
                return function(*arguments)
            finally:
                await asyncio.sleep(0.0)
        result = self.begin(function, *arguments)
        await asyncio.sleep(modelled_s)
        return result.result()

    def begin(self, function: Callable[..., T], *arguments: Any) -> Future[T]:
        """Compute a heavy pure function beside the virtual loop, or in real time at once.

        Whoever needs the result waits for it, and virtual time with him: so it is the same to the bit.
        """
        beside = self._loop.beside if isinstance(self._loop, VirtualTimeLoop) else AT_ONCE
        return beside.submit(function, *arguments)

    async def spend(self, modelled_s: float) -> None:
        """In virtual time let `modelled_s` pass, for what was just computed on the loop; else nothing."""
        if self.virtual:
            await asyncio.sleep(modelled_s)


def wall_clock_s() -> float:
    """Seconds of real time, whatever the loop says: for reporting how fast a simulation ran."""
    return time.perf_counter()


def sleep_s(duration_s: float) -> None:
    """Let real time pass, with everything on this thread standing still; not at all for what is past."""
    time.sleep(max(0.0, duration_s))


def thread_processor_s() -> float:
    """How long (s) the calling thread has had the processor."""
    return time.thread_time()


def boot_clock_ahead_s() -> float:
    """How far (s) CLOCK_BOOTTIME is ahead of CLOCK_MONOTONIC: as long as the machine has been suspended.

    0 where there is no such clock (it is Linux').
    """
    boot_clock = getattr(time, "CLOCK_BOOTTIME", None)
    return 0.0 if boot_clock is None else time.clock_gettime(boot_clock) - time.monotonic()


def up_s() -> float:
    """How long (s) the machine has been up, suspensions included, by a clock that nobody sets."""
    return time.monotonic() + boot_clock_ahead_s()


def unix_time_s() -> float:
    """Seconds since 1970 now, for signed frames and the magnetic model; never for estimation or control."""
    return time.time()


def start_unix_s(*, virtual: bool) -> float:
    """Seconds since 1970 at loop time 0, for the stamps in logs; never for estimation or control."""
    return time.time() if virtual else time.time() - time.monotonic()


def run_in_virtual_time(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to its end on a fresh virtual-time loop.

    Raises:
        NothingScheduled: all tasks wait for something that nothing will ever bring.
    """
    with _collecting_seldom(), handing_over_soon():
        return run_until_stopped(main, VirtualTimeLoop)


@contextmanager
def _collecting_seldom() -> Iterator[None]:
    """A flight makes millions of tuples that die at once: looking for cycles so often costs it a tenth."""
    before = gc.get_threshold()
    gc.set_threshold(ALLOCATIONS_BETWEEN_COLLECTIONS, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


@contextmanager
def infrequent_collection() -> Iterator[None]:
    """While inside, what is there already is passed over, and a collection takes a millisecond or two.

    A full one walks every object of the program and its libraries: it stops the control loop for a tenth of a
    second on a desktop, longer on a small board. Nearly all that a flight makes dies at once without it.
    """
    before = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(*IN_FLIGHT)
    try:
        yield
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()


@contextmanager
def handing_over_soon() -> Iterator[None]:
    """While inside, no thread has the interpreter for long while another wants it.

    The loop gives it up at each system call, and gets it back from a thread that computes (vision, the log)
    after `HAND_OVER_S`; in virtual time it is the thread that wants it, after each step of OpenCV's.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(HAND_OVER_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
