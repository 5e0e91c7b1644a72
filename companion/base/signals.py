"""Signals that end a program: Ctrl-C, a service manager's SIGTERM, a terminal that has gone.

What a program opens it closes whenever a signal comes: they are held back from before anything is opened
until the event loop hears them. Between two lines of Python, as KeyboardInterrupt or as the process's end,
they would leave behind whatever was just being opened.
"""

import asyncio
import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import Any, Final, TypeVar

T = TypeVar("T")
STOPPING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
DRIVER_THREAD: Final = "camera"  # one that may be left behind in a driver that hangs
_stop: ContextVar[Callable[[], object] | None] = ContextVar("_stop", default=None)


@contextmanager
def signals_held_back() -> Iterator[None]:
    """While inside, what ends a program waits: until `run_until_stopped` hears it, or for the end of this."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def stopping_on_signals(stop: Callable[[], object]) -> Iterator[None]:
    """While inside, SIGINT, SIGTERM and SIGHUP call `stop` on the running loop; then what they did before."""
    loop, outer = asyncio.get_running_loop(), _stop.get()
    before = {number: signal.getsignal(number) for number in STOPPING}
    token = _stop.set(stop)
    for number in STOPPING:
        loop.add_signal_handler(number, stop)
    try:
        yield
    finally:
        _stop.reset(token)
        for number in STOPPING:
            if outer is not None:  # a loop forgets which handler was there before
                loop.add_signal_handler(number, outer)
            else:
                loop.remove_signal_handler(number)
                signal.signal(number, before[number] or signal.SIG_DFL)


def run_until_stopped(
    main: Coroutine[Any, Any, T], loop_factory: Callable[[], asyncio.AbstractEventLoop] | None = None
) -> T:
    """As `asyncio.run`, but SIGINT, SIGTERM and SIGHUP cancel `main` whenever they come; two break it off.

    Raises:
        KeyboardInterrupt: one came, and nothing inside took it by `stopping_on_signals`.
    """
    if threading.current_thread() is not threading.main_thread():  # only that one hears signals
        with asyncio.Runner(loop_factory=loop_factory) as runner:
            return runner.run(main)
    stopped = False
    # asyncio asks who handles SIGINT, for which Python puts the task in words, with what it has returned
    returned: list[T] = []

    async def heard() -> None:
        task = asyncio.current_task()
        assert task is not None

        def stop() -> None:
            nonlocal stopped
            if stopped:
                raise KeyboardInterrupt
            stopped = True
            task.cancel()

        with stopping_on_signals(stop):
            signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPPING)
            returned.append(await main)

    try:
        with signals_held_back(), asyncio.Runner(loop_factory=loop_factory) as runner:
            runner.run(heard())
            return returned[0]
    except asyncio.CancelledError:
        if stopped:
            raise KeyboardInterrupt from None
        raise


def leave_drivers(code: int) -> None:
    """End the process where a thread hangs in a driver: if it came back meanwhile, it would abort us."""
    if any(thread.name == DRIVER_THREAD for thread in threading.enumerate()):
        atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)
