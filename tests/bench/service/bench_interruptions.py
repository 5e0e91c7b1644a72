"""Kills, stalls and stops at random moments of a flight: what the vehicle and the next start make of it.

    python -m tests.bench.service.bench_interruptions --trials 20

Real time, app and simulator as two processes, a relay between them as witness. Each trial orders the whole
flight and at a random moment of it kills the service (and starts it again, as systemd does), stops it for
5 s, or asks it to end. Unsafe is: a setpoint or a command that is no answer to a new order after the restart;
an order against a mode that is not ours when a stopped process goes on; setpoints after the end; a crash; a
log that cannot be read, or that misses more than the last second.

Prints a table, and ends in one line that says whether all are safe; the exit status matches.
"""

from __future__ import annotations

import argparse
import random
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mcap.stream_reader import StreamReader
from rich.console import Console
from rich.table import Table

from tests.bench.service.running import OFFBOARD, Stage, stage

KINDS: Final = ("kill", "stop", "term")
LATEST_S: Final = 45.0  # a static pad is landed on by then
STOPPED_S: Final = 5.0
WATCHED_S: Final = 25.0
MISSING_S: Final = 1.0
ENDS_WITHIN_S: Final = 15.0
# a command in flight, and what the kernel still held
GRACE_S: Final = 0.3


@dataclass(frozen=True)
class Trial:
    """One trial and what was found."""

    kind: str
    seed: int
    moment_s: float
    phase: str
    found: tuple[str, ...]


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--trials", type=int, default=20, help="of each kind")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--scenario", default="static")
    chosen = parser.parse_args(arguments)
    seeds = range(chosen.first, chosen.first + chosen.trials)
    trials = []
    for seed in seeds:
        for kind in KINDS:
            trials.append(fly(kind, seed, chosen.scenario))
            print(f"{trials[-1]}", file=sys.stderr, flush=True)
    table = Table("kind", "seed", "at, s", "phase", "found")
    for trial in trials:
        words = "; ".join(trial.found) or "safe"
        table.add_row(trial.kind, str(trial.seed), f"{trial.moment_s:.1f}", trial.phase, words)
    Console(width=150).print(table)
    unsafe = sum(bool(trial.found) for trial in trials)
    print(f"interruptions: {len(trials)} flown, {unsafe} unsafe: {'FAILED' if unsafe else 'holds'}")
    return 1 if unsafe else 0


def fly(kind: str, seed: int, scenario: str) -> Trial:
    """One flight, interrupted."""
    moment_s = random.Random(f"{kind} {seed}").uniform(0.0, LATEST_S)
    with (
        tempfile.TemporaryDirectory(prefix="interruptions-") as folder,
        stage(Path(folder), scenario, seed) as on,
    ):
        on.start_service()
        on.wait_until(None, healthy=True)
        on.ask({"request": "order", "kind": "fly"})
        time.sleep(moment_s)
        phase = on.ask({"request": "status"})["phase"]
        found = {"kill": _kill, "stop": _stop, "term": _term}[kind](on)
        if on.report()["outcome"] == "crashed":
            found.append("the vehicle crashed")
        return Trial(kind, seed, moment_s, phase, tuple(found))


def _kill(on: Stage) -> list[str]:
    """kill -9, and the start that follows a second later."""
    assert on.service is not None
    killed_unix_s = time.time()
    on.service.kill()
    on.service.wait()
    killed_s = time.monotonic()
    time.sleep(1.0)
    on.start_service()
    time.sleep(WATCHED_S)
    return _nothing_after(on, killed_s + GRACE_S) + _log_missing(on.folder / "flights", killed_unix_s)


def _stop(on: Stage) -> list[str]:
    """SIGSTOP for 5 s: what it orders then may not be against the mode that holds."""
    assert on.service is not None
    on.service.send_signal(signal.SIGSTOP)
    stopped_s = time.monotonic()
    time.sleep(STOPPED_S)
    mode, armed = on.witness.seen.beats[-1][1:]
    on.service.send_signal(signal.SIGCONT)
    resumed_s = time.monotonic()
    time.sleep(WATCHED_S)
    seen = on.witness.seen
    found = [
        "setpoints while it was stopped" for at_s in seen.setpoints if stopped_s + GRACE_S < at_s < resumed_s
    ][:1]
    flew = any(at_s < stopped_s for at_s in seen.setpoints)
    if flew and armed and mode != OFFBOARD:
        # the failsafe, or a pilot, has it: setpoints would do nothing, and a command would take it back
        found += _nothing_after(on, resumed_s)
    return found


def _term(on: Stage) -> list[str]:
    """SIGTERM: it hands back and ends."""
    assert on.service is not None
    on.service.send_signal(signal.SIGTERM)
    asked_s = time.monotonic()
    while on.service.poll() is None and time.monotonic() - asked_s < 4.0 * ENDS_WITHIN_S:
        time.sleep(0.05)
    ended_s = time.monotonic()
    found = [] if ended_s - asked_s < ENDS_WITHIN_S else [f"ended after {ended_s - asked_s:.0f} s"]
    if on.service.returncode not in (0, 4):
        found.append(f"ended with {on.service.returncode}")
    time.sleep(5.0)
    return found + _nothing_after(on, ended_s)


def _nothing_after(on: Stage, after_s: float) -> list[str]:
    """What was ordered after a moment after which nothing may be."""
    seen = on.witness.seen
    late = sum(at_s > after_s for at_s in seen.setpoints)
    commands = sorted({number for at_s, number in seen.commands if at_s > after_s})
    found = [f"{late} setpoints"] if late else []
    return found + ([f"commands {commands}"] if commands else [])


def _log_missing(flights: Path, killed_unix_s: float) -> list[str]:
    """Whether the killed flight's log can be read up to a second before the kill."""
    logs = sorted(flights.glob("flight-*/flight.mcap"))
    if not logs:
        return ["no log"]
    newest_s = 0.0
    try:
        with logs[0].open("rb") as stream:
            for record in StreamReader(stream).records:
                newest_s = max(newest_s, 1e-9 * getattr(record, "log_time", 0))
    except Exception as error:
        # the last record is cut; what came before it is read
        if not newest_s:
            return [f"log cannot be read: {type(error).__name__}"]
    missing_s = killed_unix_s - newest_s
    return [f"log misses {missing_s:.1f} s"] if missing_s > MISSING_S else []


if __name__ == "__main__":
    sys.exit(main())
