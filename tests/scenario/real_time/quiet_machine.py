"""Real time needs a machine that has time: what other programs use of it, by Linux's own counts.

The load average would count this run's own workers, and remembers for minutes what is over.
"""

import os
import time
from pathlib import Path
from typing import Final

import pytest

# shares of each core that other programs may use
MOST: Final = 0.5
MOST_BESIDE_THREE: Final = 0.25  # beside three processes in real time, which want a core and a half
# for all tests of a process together: how long they wait for other programs to end
PATIENCE_S: Final = 120.0
WINDOW_S: Final = 1.0
SCHED_IDLE: Final = 5
LATE: Final = "too busy a machine for real time"  # how a simulator or a flight says that it came late

_waited_s = 0.0


def beside_lateness(errors: str) -> str:
    """What a program wrote to its standard error, without what it says about a slow machine."""
    return "".join(line for line in errors.splitlines(keepends=True) if LATE not in line)


def wait_for_quiet(most: float = MOST) -> None:
    """Wait until other programs use no more than `most` of each core; skip the test when they go on."""
    global _waited_s  # noqa: PLW0603
    while (busy := used_by_others()) > most:
        if _waited_s >= PATIENCE_S:
            pytest.skip(
                f"too busy for real time: other programs use {busy:.0%} of each core; expected at most "
                f"{most:.0%} within {PATIENCE_S:.0f} s"
            )
        _waited_s += WINDOW_S


def used_by_others() -> float:
    """What other programs use of each core that is ours, measured now: 0 to 1.

    Those that give way do not count: their niceness is above ours, or they run when all else is idle.
    """
    began_s, (all_s, ours_s) = time.monotonic(), _cpu_seconds()
    time.sleep(WINDOW_S)
    passed_s, (all_then_s, ours_then_s) = time.monotonic() - began_s, _cpu_seconds()
    others_s = (all_then_s - all_s) - (ours_then_s - ours_s)
    return max(0.0, others_s / passed_s / len(os.sched_getaffinity(0)))


def _cpu_seconds() -> tuple[float, float]:
    """CPU seconds so far: of all programs on our cores, and of this run and of those that give way to it."""
    cores = {f"cpu{core}" for core in os.sched_getaffinity(0)}
    ticks = 0
    for line in Path("/proc/stat").read_text().splitlines():
        name, *cells = line.split()
        if name in cores:
            user, nice, system, _idle, _waiting, *interrupts_and_stolen = map(int, cells[:8])
            ticks += user + nice + system + sum(interrupts_and_stolen)
    parents, used = dict[int, int](), dict[int, int]()
    run = {os.getppid() if "PYTEST_XDIST_WORKER" in os.environ else os.getpid()}
    giving_way, niceness = set(), os.nice(0)
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = path.read_text().rpartition(")")[2].split()
        except OSError:  # it has just ended
            continue
        process = int(path.parent.name)
        parents[process] = int(words[1])
        used[process] = sum(map(int, words[11:15]))  # in user and system mode, its ended children's too
        if int(words[16]) > niceness or int(words[38]) == SCHED_IDLE:
            giving_way.add(process)
    while children := {process for process, parent in parents.items() if parent in run} - run:
        run |= children
    ours = sum(used.get(process, 0) for process in run | giving_way)
    ticks_in_a_second = os.sysconf("SC_CLK_TCK")
    return ticks / ticks_in_a_second, ours / ticks_in_a_second
