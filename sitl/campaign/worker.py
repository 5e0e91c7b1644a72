"""A process of the app that flies one run after another, with handling of its death or hang.

It is `companion flights`, a process of its own, so that the simulator's side knows nothing of the app's but
its command line. The start of Python and the libraries (two seconds) is paid once for many flights; each
flight is the one that the command line flies, to the bit.
"""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from queue import SimpleQueue
from typing import IO, Any, Final

from companion.base.clock import wall_clock_s
from companion.config import ConfigError
from sitl.campaign.manifest import CampaignRun

COMMAND: Final = (sys.executable, "-m", "companion.cli", "flights")
# slower than a tenth of real time counts as hung; starting Python comes on top
SLOWEST_FACTOR: Final = 0.1
START_S: Final = 60.0
# a process is replaced after so many runs, so that leaks do not grow over a long campaign
FLIGHTS_PER_PROCESS: Final = 50
# side by side each job has one core: libraries that start threads of their own only get in one another's way
ONE_THREAD: Final = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_WORDS_BYTES: Final = 4096


@dataclass(frozen=True, slots=True)
class RunResult:
    """A run that has ended: its result (as `--json` has it), or the last output of its process.

    `touchdown_pad_m` is where on the pad it came down: along the pad's heading and to its right.
    """

    flight: CampaignRun
    wall_s: float
    result: dict[str, Any] | None = None
    reason: str = ""
    touchdown_pad_m: Sequence[float] | None = None
    error: str = ""


class _DiedError(Exception):
    """The process has ended or does not answer; the text has the reason."""


class Worker:
    """Flies runs one at a time. `fly` belongs to one thread; `stop` may come from any."""

    def __init__(
        self, command: Sequence[str] = COMMAND, *, flights_per_process: int = FLIGHTS_PER_PROCESS
    ) -> None:
        """Take the command of the process; it is started with the first run."""
        self._command = tuple(command)
        self._flights_per_process = flights_per_process
        self._process: subprocess.Popen[bytes] | None = None
        self._words: IO[bytes] | None = None
        self._flown = 0
        self._said_before = 0
        self._stopped = False
        self._lock = threading.Lock()

    def fly(self, flight: CampaignRun, timeout_s: float | None = None) -> RunResult:
        """Fly a run; by default it may take ten times as long as the scenario's own limit.

        Raises:
            ConfigError: the app refuses the scenario or the settings.
        """
        started_s = wall_clock_s()
        patience_s = START_S + flight.time_limit_s / SLOWEST_FACTOR if timeout_s is None else timeout_s
        try:
            answer = self._ask(flight, started_s + patience_s, patience_s)
        except _DiedError as error:
            self._end()
            return RunResult(flight, wall_clock_s() - started_s, error=str(error))
        wall_s = wall_clock_s() - started_s
        if answer["refused"] is not None:
            raise ConfigError(answer["refused"])
        if answer["fault"] is not None:
            # its state is unknown
            self._end()
            return RunResult(flight, wall_s, error=answer["fault"])
        return RunResult(flight, wall_s, answer["result"], answer["reason"], answer["touchdown_pad_m"])

    def stop(self) -> None:
        """End the process, whatever it does, for good; a run that is being flown ends as failed."""
        with self._lock:
            self._stopped = True
            if self._process is not None:
                self._process.kill()

    def close(self) -> None:
        """Stop and clear up, from the thread that flies or when it has ended."""
        self.stop()
        self._end()

    # ------------------------------------------------------------ the process

    def _ask(self, flight: CampaignRun, deadline_s: float, patience_s: float) -> dict[str, Any]:
        if self._flown >= self._flights_per_process:
            self._end()
        process = self._process or self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        self._said_before = self._said()
        request = {"scenario": flight.source, "seed": flight.seed, "config": flight.config}
        if flight.firmware is not None:
            request["firmware"] = flight.firmware.as_json()
        # the death of the process is handled when the answer is read
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(json.dumps(request).encode() + b"\n")
        line = b""
        while not line.endswith(b"\n"):
            left_s = deadline_s - wall_clock_s()
            if left_s <= 0.0 or not select.select([process.stdout], [], [], left_s)[0]:
                raise _DiedError(f"no answer within {patience_s:.0f} s: {self._last_words()}")
            part = process.stdout.read(65536)
            if not part:
                raise _DiedError(f"{_ending(process.wait())}: {self._last_words()}")
            line += part
        self._flown += 1
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _start(self) -> subprocess.Popen[bytes]:
        with self._lock:
            if self._stopped:
                raise _DiedError("stopped")
            self._words = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the process runs
            self._process = subprocess.Popen(
                self._command,
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._words,
                env={**os.environ, **ONE_THREAD},
                # Ctrl-C ends the campaign, not the flight in the middle of its score
                start_new_session=True,
            )
            self._flown = 0
            return self._process

    def _end(self) -> None:
        with self._lock:
            process, self._process = self._process, None
            words, self._words = self._words, None
        if process is not None:
            process.kill()
            with process:
                pass
        if words is not None:
            words.close()

    def _last_words(self) -> str:
        """The last line of standard error since the run was started."""
        said = self._said()
        # the process writes through the same file: reading must not move where it does
        begin = max(self._said_before, said - _WORDS_BYTES)
        words = (
            os.pread(self._words.fileno(), said - begin, begin).decode(errors="replace")
            if self._words
            else ""
        )
        lines = words.strip().splitlines()
        return lines[-1] if lines else "no output"

    def _said(self) -> int:
        return os.fstat(self._words.fileno()).st_size if self._words else 0


def _ending(code: int) -> str:
    """How a process ended, in words."""
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit status {code}"


# ---------------------------------------------------------------- pool


def fly_locally(
    flights: Sequence[CampaignRun], jobs: int, make_worker: Callable[[], Worker] = Worker
) -> Generator[RunResult, None, None]:
    """Fly runs, `jobs` at a time; they come as they end. Close it early and nothing is left running."""
    workers = [make_worker() for _ in range(min(jobs, len(flights)))]
    idle: SimpleQueue[Worker] = SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def fly(flight: CampaignRun) -> RunResult:
        worker = idle.get()
        try:
            return worker.fly(flight)
        finally:
            idle.put(worker)

    threads = ThreadPoolExecutor(max(1, len(workers)), thread_name_prefix="campaign")
    try:
        for future in as_completed([threads.submit(fly, flight) for flight in flights]):
            yield future.result()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        # what is in the air falls, its thread comes back, and only then can its pipes be closed
        for worker in workers:
            worker.stop()
        threads.shutdown()
        for worker in workers:
            worker.close()
