"""The thread that writes the flight log: a card that stalls must not stall the control loop.

`put` never waits in flight. What does not fit is dropped, counted and reported: bulky data (samples, frames,
MAVLink) first, while there is still room for what explains a flight. In virtual time the flight waits for the
disk instead, so that nothing is lost. In flight the thread rests between slices of work: Python runs one
thread at a time, and one that computes for long delays every cycle of the control loop. An error of the card
ends the log, not the flight; what cannot be written for any other reason is left out, counted and reported.
However the log ends, its files are closed.
"""

import queue
import threading
from collections.abc import Callable
from typing import Any, Final

from companion.base.clock import sleep_s, thread_processor_s

# half a minute of everything, and no more memory than a Raspberry Pi can spare
QUEUE_SIZE: Final = 20_000
BULKY_SHARE: Final = 0.75
QUEUE_BYTES: Final = 64 * 1024 * 1024
# A backlog gets a quarter of the processor; the control loop waits for no more than one slice.
SLICE_S: Final = 0.002
REST_S: Final = 3.0 * SLICE_S

_Job = tuple[Callable[..., None], tuple[Any, ...], int]


class DiskWriter:
    """Calls what it is given, in order, in a thread of its own; `waits` is for virtual time."""

    def __init__(self, *, waits: bool = False) -> None:
        self._waits = self._hurries = waits
        self._worked_s = 0.0  # the thread's processor time at the last rest
        self._failure: str | None = None
        self._queue: queue.Queue[_Job | None] = queue.Queue(QUEUE_SIZE)
        self._lock = threading.Lock()
        self._bytes = 0
        self.lost = 0
        self.failed = 0
        self._first_failed = ""
        self._closers: tuple[Callable[[], None], ...] = ()
        self._thread = threading.Thread(target=self._work, name="flight-log", daemon=True)
        self._thread.start()

    @property
    def problem(self) -> str | None:
        if self._failure is not None:
            return f"the flight log on disk ends here: {self._failure}"
        if self.failed:
            return f"{self.failed} messages could not be written to the log: {self._first_failed}"
        return f"the disk does not keep up: {self.lost} messages lost from the log" if self.lost else None

    def put(
        self, write: Callable[..., None], *arguments: Any, bulky: bool = False, size_bytes: int = 0
    ) -> None:
        """Have `write` called with these arguments; `size_bytes`: the memory they hold, where it is much."""
        if self._waits:
            self._queue.put((write, arguments, 0))
            return
        full = bulky and self._queue.qsize() > BULKY_SHARE * QUEUE_SIZE
        if full or self._bytes + size_bytes > QUEUE_BYTES:
            self.lost += 1
            return
        try:
            self._queue.put_nowait((write, arguments, size_bytes))
        except queue.Full:
            self.lost += 1
            return
        self._count(size_bytes)

    def finish(self, *closers: Callable[[], None], wait: bool = True) -> None:
        """Write what is left, call `closers` whatever has failed, and end.

        Without `wait` call `join` before the process ends.
        """
        self._closers = closers
        self._queue.put(None)
        if wait:
            self.join(hurries=True)

    def join(self, *, hurries: bool = False) -> None:
        """Wait until all is written, after `finish`; `hurries` without rests, once nothing flies."""
        self._hurries |= hurries
        self._thread.join()

    def rest(self) -> None:
        """In the writer's thread, between two pieces of work: leave the processor after each slice."""
        if self._hurries or thread_processor_s() - self._worked_s < SLICE_S:
            return
        sleep_s(REST_S)
        self._worked_s = thread_processor_s()

    def _count(self, size_bytes: int) -> None:
        if size_bytes:
            with self._lock:
                self._bytes += size_bytes

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            write, arguments, size_bytes = item
            self._count(-size_bytes)
            if self._failure is None:
                self._call(write, arguments)
                self.rest()
        for close in self._closers:
            self._call(close, ())

    def _call(self, write: Callable[..., None], arguments: tuple[Any, ...]) -> None:
        try:
            write(*arguments)
        except OSError as error:
            self._failure = self._failure or error.strerror or str(error)
        except Exception as error:
            # whatever it is: this thread is the only one that would tell, and the flight goes on
            self._first_failed = self._first_failed or f"{type(error).__name__}: {error}"
            self.failed += 1
