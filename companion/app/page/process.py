"""The page's process, as the app sees it: started, talked to, started again when it ends.

It dies with the pipe from us, so it cannot outlive the app. What it says comes from a process that the
network reaches: one short line of JSON at a time, and nothing in it is believed but what is expected.
"""

import asyncio
import fcntl
import json
import os
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Final

from companion.app.page.access import TOKEN_VARIABLE
from companion.app.page.look import Look, Reply, Start, Text
from companion.base.clock import Clock

# ---------------------------------------------------------------- the thread that sends

MOST_REPLIES: Final = 32


class Sender:
    """`put` takes a reference and returns; pickling and writing happen in the thread."""

    def __init__(self, pipe: Connection, start: Start) -> None:
        """Send `start` first. The pipe is closed when the thread ends."""
        self._pipe = pipe
        self._newest: dict[str, Look | Text | Start] = {"": start}
        self._replies: deque[Reply] = deque(maxlen=MOST_REPLIES)
        self._ends = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="live page", daemon=True)
        self._thread.start()

    def put(self, message: Look | Text | Reply) -> None:
        """Hand over; a message of the same kind that still waits is dropped, but no reply."""
        with self._changed:
            if isinstance(message, Reply):
                self._replies.append(message)
            else:
                self._newest[message.kind if isinstance(message, Text) else "look"] = message
            self._changed.notify()

    def end(self) -> None:
        """Stop, without waiting: a process that does not read holds the thread until it is gone."""
        with self._changed:
            self._ends = True
            self._changed.notify()

    def _run(self) -> None:
        with suppress(OSError), self._pipe:
            while (messages := self._wait()) is not None:
                for message in messages:
                    self._pipe.send(message)

    def _wait(self) -> list[Look | Text | Start | Reply] | None:
        with self._changed:
            while not (self._newest or self._replies or self._ends):
                self._changed.wait()
            if self._ends:
                return None
            messages = [*self._newest.values(), *self._replies]
            self._newest.clear()
            self._replies.clear()
            return messages


LONGEST_LINE: Final = 1024
# doubled from failure to failure: starting it costs a second of a core
FIRST_PAUSE_S: Final = 5.0
LONGEST_PAUSE_S: Final = 60.0
# after so long its end is a new failure: reported again, and followed by the first pause
WELL_S: Final = 60.0
END_S: Final = 2.0
# between its lines: however many it writes, the control loop hears few
LINE_PAUSE_S: Final = 0.01
# a frame of 640x480 goes into the pipe at once
PIPE_BYTES: Final = 1 << 20
# what is ours alone: the service manager's socket, and the token, which goes through the pipe
_NOT_ITS_OWN: Final = frozenset({"NOTIFY_SOCKET", TOKEN_VARIABLE})

Line = dict[str, Any]


class PageProcess:
    """One process after another, until the task that runs `run` is cancelled."""

    def __init__(
        self, start: Start, on_line: Callable[[Line], None], on_problem: Callable[[str], None]
    ) -> None:
        """`on_line` takes what it says, `on_problem` why it ended; the same soon again is not reported."""
        self._start, self._on_line, self._on_problem = start, on_line, on_problem
        self._sender: Sender | None = None
        self._reported = ""

    def put(self, message: Look | Text | Reply) -> None:
        """Send the newest; nothing while there is no process."""
        if self._sender is not None:
            self._sender.put(message)

    async def run(self) -> None:
        clock, pause_s = Clock(), FIRST_PAUSE_S
        while True:
            start_s = clock.now_s()
            problem = await self._one_life()
            self._on_line({"viewers": 0})
            if clock.now_s() - start_s >= WELL_S:
                self._reported, pause_s = "", FIRST_PAUSE_S
            if problem != self._reported:
                self._reported = problem
                self._on_problem(problem)
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    async def _one_life(self) -> str:
        """Start it and take what it says until it ends; returns why it did."""
        theirs, ours = Pipe(duplex=False)
        with suppress(OSError):
            fcntl.fcntl(ours.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        try:
            process = await _spawn(theirs)
        except OSError as error:
            ours.close()
            return f"cannot be started: {error.strerror}"
        finally:
            theirs.close()
        self._sender = Sender(ours, self._start)
        try:
            return await self._listen(process)
        finally:
            self._sender.end()
            self._sender = None
            await _end(process)

    async def _listen(self, process: asyncio.subprocess.Process) -> str:
        assert process.stdout is not None
        problem = "ended"
        while True:
            try:
                words = await process.stdout.readline()
                line = json.loads(words) if words else None
            except ValueError:
                return "said what nobody understands"
            if line is None:
                return problem
            if not isinstance(line, dict):
                return "said what nobody understands"
            problem = str(line.get("problem", problem))
            self._on_line(line)
            await asyncio.sleep(LINE_PAUSE_S)


async def _spawn(pipe: Connection) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "companion.app.page.child", str(pipe.fileno())),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        pass_fds=(pipe.fileno(),),
        limit=LONGEST_LINE,
        env={name: value for name, value in os.environ.items() if name not in _NOT_ITS_OWN},
        # Ctrl-C is the app's to handle: who looks sees the vehicle handed back
        start_new_session=True,
    )


async def _end(process: asyncio.subprocess.Process) -> None:
    """It has lost its pipe, or is about to; one that does not end by itself is killed."""
    if process.returncode is None:
        with suppress(ProcessLookupError):
            process.kill()
    with suppress(TimeoutError):
        await asyncio.wait_for(process.wait(), END_S)
