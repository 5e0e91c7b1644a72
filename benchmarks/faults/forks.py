"""Child processes that go on with a flight, each with another fault: what came before is flown once.

POSIX alone. A child is the whole process again, in the middle of its flight and on the same event loop.
"""

import asyncio
import os
import pickle
import select
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, NoReturn, TypeVar

from benchmarks.faults.cases import FaultRun

Answer = TypeVar("Answer")


class Forks(Generic[Answer]):
    """The children, each with a run of its own; so many processes fly at a time."""

    def __init__(self, jobs: int, take: Callable[[FaultRun, Answer | None], None]) -> None:
        """`take` is called with each child's answer; None: the bench failed there."""
        self.mine: FaultRun | None = None  # what this process flies; None in the first
        self._jobs, self._take = jobs, take
        self._to_parent = -1
        self._flying: dict[
            int, tuple[int, FaultRun]
        ] = {}  # by the pipe from it: its process, and what it flies

    def begin(self, run: FaultRun) -> bool:
        """Fork for a run: True in the child, which ends in `deliver`, and False in the parent."""
        loop = asyncio._get_running_loop()
        sys.stdout.flush()
        sys.stderr.flush()
        from_child, to_parent = os.pipe()
        process = os.fork()
        if process == 0:
            for pipe in (from_child, *self._flying):
                os.close(pipe)
            self._flying, self._to_parent, self.mine = {}, to_parent, run
            asyncio._set_running_loop(loop)
            return True
        os.close(to_parent)
        self._flying[from_child] = (process, run)
        while len(self._flying) >= self._jobs:
            self._reap()
        return False

    def deliver(self, answer: Answer | None) -> NoReturn:
        """End this child with its answer, which is pickled."""
        try:
            with os.fdopen(self._to_parent, "wb") as pipe:
                pickle.dump(answer, pipe)
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(0)

    def wait(self) -> None:
        """Take what is still flying."""
        while self._flying:
            self._reap()

    def stop(self) -> None:
        """End those that fly."""
        for process, _ in self._flying.values():
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
        self._flying.clear()

    def _reap(self) -> None:
        ready, _, _ = select.select(list(self._flying), [], [])
        for pipe in ready:
            process, run = self._flying.pop(pipe)
            with os.fdopen(pipe, "rb") as file:
                data = file.read()
            os.waitpid(process, 0)
            self._take(run, pickle.loads(data) if data else None)
