"""Kills, stalls and stops at random moments of a flight: what the vehicle and the next start make of it.

    python -m benchmarks interruptions --trials 20 --out flights/bench-interruptions

Real time, app and simulator as two processes, a relay between them as witness. Each trial orders the whole
flight and at a moment drawn for it, from standby to disarmed, kills the service (and starts it again, as
systemd does), stops it for 5 s, or asks it to end. Unsafe is: a setpoint or a command that is no answer to a
new order after the restart; an order against the mode that the autopilot's failsafe chose, when a stopped
process goes on; setpoints after the end; a failsafe that does not act; a vehicle that arms; a crash; a log
that does not read back to the last second before the kill.

Each trial is written down when it ends; give the same command again after an interruption, and it goes on.
`--minutes` ends after so long. Trials of another state of the code or of the bench are not counted.

Prints a table, and ends in one line that says whether all are safe; the exit status matches.
"""

import argparse
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Final

from rich.table import Table

from benchmarks.report import BenchReport
from benchmarks.rows_file import RowsFile, flights_key
from benchmarks.service import judging
from benchmarks.service.judging import KINDS, InterruptedTrial, Kind, moment, reached
from benchmarks.service.running import NEAR, Stage, stage
from sitl.run.process_control import read_report

SMOKE: Final = ("--trials", "1")
NEEDS: Final = "the machine to itself"
OUT: Final = Path("flights/bench-interruptions")
TRIALS: Final = 20
STOPPED_S: Final = 5.0
RESTART_S: Final = 1.0  # RestartSec of the unit
WATCHED_S: Final = 12.0
ENDED_WATCHED_S: Final = 5.0
LOOK_S: Final = 0.05
COMES_WITHIN_S: Final = 90.0
# the simulation fell behind the clock so far: the machine was too busy, and nothing is shown
LATE_S: Final = 1.0


class NotFlown(Exception):  # noqa: N818 - it reads as what happened
    """The bench could not fly a trial, which judges nothing."""


def main(
    arguments: Sequence[str] | None = None, fly: Callable[[Kind, int, str], InterruptedTrial] | None = None
) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--trials", type=int, default=TRIALS, help="of each kind")
    parser.add_argument("--jobs", type=int, default=1, help="so many at once; each takes a core")
    parser.add_argument("--minutes", type=float, help="begin no trial after so long")
    parser.add_argument("--out", type=Path, default=OUT)
    chosen = parser.parse_args(arguments)
    report = BenchReport()
    file = RowsFile(chosen.out / "trials.jsonl", InterruptedTrial)
    code = flights_key(Path(__file__).parent)
    asked = [(kind, seed) for seed in range(chosen.trials) for kind in KINDS]
    done = {(trial.kind, trial.seed): trial for trial in file.read(code)}
    by_s = time.monotonic() + 60.0 * (chosen.minutes or 1e6)

    def flown(key: tuple[Kind, int]) -> InterruptedTrial | None:
        if time.monotonic() > by_s:
            return None
        try:
            return (fly or fly_trial)(*key, code)
        except (NotFlown, OSError, RuntimeError) as error:
            print(f"not flown: {key[0]} {key[1]}: {error}", file=sys.stderr, flush=True)
            return None

    with ThreadPoolExecutor(chosen.jobs) as pool:
        trials = [pool.submit(flown, key) for key in asked if key not in done]
        for future in as_completed(trials):
            if (trial := future.result()) is not None:
                file.append(trial)
                done[trial.kind, trial.seed] = trial
                report.progress(f"{trial.kind} {trial.seed}, {trial.phase}: {_words(trial)}")
    return shown(report, [done[key] for key in asked if key in done], len(asked))


def shown(report: BenchReport, trials: Sequence[InterruptedTrial], asked: int) -> BenchReport:
    """Show the table and judge."""
    table = Table("kind", "seed", "phase", "after the order, s", "failsafe, s", "found")
    for trial in trials:
        failsafe = "" if trial.failsafe_s is None else f"{trial.failsafe_s:.1f}"
        cells = (trial.kind, str(trial.seed), trial.phase, f"{trial.ordered_s:.1f}", failsafe)
        table.add_row(*cells, _words(trial))
    report.show(table)
    unsafe = sum(bool(trial.found) for trial in trials)
    flown = ", ".join(f"{kind} {sum(trial.kind == kind for trial in trials)}" for kind in KINDS)
    missing = f", {asked - len(trials)} not flown" if len(trials) < asked else ""
    holds = not unsafe and not missing
    return report.judge({f"interruptions: {flown}{missing}; {unsafe} unsafe": holds})


def _words(trial: InterruptedTrial) -> str:
    return "; ".join(trial.found) or "safe"


# ---------------------------------------------------------------- one trial


def fly_trial(kind: Kind, seed: int, code: str) -> InterruptedTrial:
    """One flight, interrupted.

    Raises:
        NotFlown: the moment never came, or this machine was too busy.
    """
    wanted = moment(kind, seed)
    with (
        tempfile.TemporaryDirectory(prefix="interruptions-") as folder,
        stage(Path(folder), NEAR, seed) as on,
    ):
        on.start_service()
        on.wait_until(None, healthy=True)
        ordered_s, ordered_unix_s = time.monotonic(), time.time()
        if wanted.phase != "standby":
            on.ask({"request": "order", "kind": "fly"})
        _wait_for(on, wanted.phase)
        time.sleep(wanted.delay_s)
        phase = on.ask({"request": "status"})["phase"]
        interrupts = {"kill": _kill, "stop": _stop, "term": _term}[kind]
        interrupted_unix_s, interrupted_s = time.time(), time.monotonic()
        found = interrupts(on, interrupted_s, standby=phase == "standby")
        if phase != "standby":
            found += judging.log_missing(on.folder / "flights", ordered_unix_s, interrupted_unix_s)
        flown = judging.ours(on.witness.seen.at(interrupted_s))
        left_s = judging.left_after_s(on.witness.seen, interrupted_s) if flown else None
        told = read_report(on.finish())
        if told.latest_tick_s > LATE_S:
            raise NotFlown(f"the simulator was {told.latest_tick_s:.1f} s late")
        if told.outcome == "crashed":
            found.append("the vehicle crashed")
        return InterruptedTrial(
            kind, seed, code, phase, round(interrupted_s - ordered_s, 2), left_s, tuple(found)
        )


def _wait_for(on: Stage, phase: str) -> None:
    by_s = time.monotonic() + COMES_WITHIN_S
    while not reached(on.ask({"request": "status"})["phase"], phase):
        if time.monotonic() > by_s:
            raise NotFlown(f"never came to {phase}")
        time.sleep(LOOK_S)


def _kill(on: Stage, killed_s: float, *, standby: bool) -> list[str]:
    """kill -9, and the start that follows as systemd has it."""
    assert on.service is not None
    on.service.kill()
    on.service.wait()
    time.sleep(RESTART_S)
    on.start_service()
    time.sleep(WATCHED_S)
    return judging.killed(on.witness.seen, killed_s)


def _stop(on: Stage, stopped_s: float, *, standby: bool) -> list[str]:
    """SIGSTOP for 5 s: what it orders then may not be against the mode that holds."""
    assert on.service is not None
    on.service.send_signal(signal.SIGSTOP)
    time.sleep(STOPPED_S)
    resumed_s = time.monotonic()
    on.service.send_signal(signal.SIGCONT)
    time.sleep(WATCHED_S)
    return judging.stopped(on.witness.seen, stopped_s, resumed_s)


def _term(on: Stage, asked_s: float, *, standby: bool) -> list[str]:
    """SIGTERM: it hands back and ends."""
    assert on.service is not None
    on.service.send_signal(signal.SIGTERM)
    code = on.service.wait(timeout=2.0 * judging.ENDS_WITHIN_S)
    ended_s = time.monotonic()
    time.sleep(ENDED_WATCHED_S)
    return judging.terminated(on.witness.seen, asked_s, ended_s, code, standby=standby)
