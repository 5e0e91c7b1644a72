"""Every fault in every phase in which it can happen: what becomes of the flight, and is it safe?

    python -m benchmarks faults --jobs 2 --out flights/bench-faults

Flies the scenarios `line` and `circle` under five seeds with the behaviours of PX4 and ArduPilot, rendered,
in virtual time; `--each 1` takes one flight of each fault in each phase by each autopilot, with scenarios and
seeds in turn. What flights have in common before their fault is flown once. Each flight is written down when
it ends; give the same command again after an interruption, and it goes on. Flights of another state of the
code, the settings, the cases or the judge are not counted.
"""

import argparse
import os
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, get_args

from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.faults.cases import CASES, PHASES, FaultRow, FaultRun, all_runs, one_each
from benchmarks.faults.fault_flight import fly_run, fly_together
from benchmarks.faults.forks import Forks
from benchmarks.faults.judge import OUTCOMES, SafetyVerdict
from benchmarks.faults.witness import WitnessedFlight
from benchmarks.report import BenchReport
from benchmarks.rows_file import RowsFile, flights_key
from companion.base.autopilot_kind import AutopilotKind
from sitl.campaign.tables import Bar
from sitl.run.process_control import terminated_as_interrupted

SMOKE: Final = (
    *("--faults", "GPS lost", "--phases", "descend", "--autopilots", "px4"),
    *("--scenarios", "line", "--seeds", "1", "--jobs", "1"),
)
SCENARIOS: Final = ("line", "circle")
SEEDS: Final = 5
LANDED_SHARE: Final = 0.95
NAMED_SHARE: Final = 0.9


Take = Callable[[FaultRun, FaultRow | None], None]


def row_of(run: FaultRun, code: str, verdict: SafetyVerdict, record: WitnessedFlight) -> FaultRow:
    """What is written down of a flight."""
    texts = [text.text for text in record.texts]
    named = (text for text in reversed(texts) if names_it(run.fault, text))
    said = next(named, texts[-1] if texts else "")
    ended_s = round(record.app_ended_s or record.samples[-1].time_s, 1)
    unsafe = "; ".join(verdict.unsafe)
    return FaultRow(*run, code, record.fault_began, verdict.outcome, unsafe, ended_s, said)


def names_it(fault: str, text: str) -> bool:
    """Whether a text of the app names the quantity that is wrong."""
    return any(name in text for name in CASES[fault].names)


def print_failure(run: FaultRun) -> None:
    """The bench's own fault, the exception that is being handled."""
    traceback.print_exc()
    print(f"not flown: {', '.join(map(str, run))}", file=sys.stderr)


def fly_group(runs: Sequence[FaultRun], code: str, forks: Forks[FaultRow], take: Take) -> None:
    """Fly runs of one scenario and seed; what the bench itself fails at judges no flight."""
    try:
        flown = [
            (run, row_of(run, code, verdict, record)) for run, verdict, record in fly_together(runs, forks)
        ]
    except Exception:
        print_failure(forks.mine or runs[0])
        flown = []
    if forks.mine is not None:
        forks.deliver(flown[0][1] if flown else None)
    for run, row in flown:
        take(run, row)


def fly_alone(run: FaultRun, code: str) -> FaultRow | None:
    """Fly one from its start; None, with the fault printed, when the bench itself failed."""
    try:
        return row_of(run, code, *fly_run(run))
    except Exception:
        print_failure(run)
        return None


def fly_all(runs: Sequence[FaultRun], code: str, jobs: int, take: Take) -> None:
    """Fly, so many at a time; `take` gets each as it ends."""
    forks = Forks[FaultRow](jobs, take)
    try:
        for kind in dict.fromkeys(run[2:] for run in runs):
            group = [run for run in runs if run[2:] == kind]
            alone = [run for run in group if CASES[run.fault].flown_alone]
            if together := [run for run in group if run not in alone]:
                fly_group(together, code, forks, take)
            for run in alone:
                if forks.begin(run):
                    forks.deliver(fly_alone(run, code))
        forks.wait()
    except BaseException:
        if forks.mine is not None:
            os._exit(1)  # a child that was interrupted: the first process tells
        raise
    finally:
        forks.stop()


def fly_left(
    left: Sequence[FaultRun], code: str, jobs: int, file: RowsFile[FaultRow], report: BenchReport
) -> dict[FaultRun, FaultRow]:
    """Fly and write down; what the bench could not fly is flown once more."""
    rows: dict[FaultRun, FaultRow] = {}

    def take(run: FaultRun, row: FaultRow | None) -> None:
        if row is None:
            return
        file.append(row)
        rows[run] = row
        where = place_of(row)
        report.progress(f"{len(rows)}/{len(left)} {where}: {row.outcome} {row.unsafe}")

    for _ in range(2):
        fly_all([run for run in left if run not in rows], code, jobs, take)
    return rows


# ---------------------------------------------------------------- what is shown


def place_of(row: FaultRow) -> str:
    """Which flight it was."""
    return f"{row.fault}, {row.phase}, {row.autopilot}, {row.scenario} {row.seed}"


def cell(rows: Sequence[FaultRow]) -> str:
    """How the flights of one fault in one phase ended."""
    count = Counter(row.outcome for row in rows)
    words = [f"{name} {count[name]}" for name in OUTCOMES if count[name]]
    idle = sum(not row.began for row in rows)
    return ", ".join(words) + (f" ({idle} before the fault)" if idle else "")


def table(rows: Sequence[FaultRow]) -> Table:
    """Fault x phase: how it ended."""
    shown = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    phases = [phase for phase in PHASES if any(row.phase == phase for row in rows)]
    shown.add_column("fault", no_wrap=True)
    for phase in phases:
        shown.add_column(phase.replace("_", " "))
    for fault in CASES:
        mine = [row for row in rows if row.fault == fault]
        if mine:
            cells = (cell([row for row in mine if row.phase == phase]) for phase in phases)
            shown.add_row(fault, *cells)
    return shown


def bars(rows: Sequence[FaultRow]) -> list[Bar]:
    """No unsafe end, landings where the fault leaves one possible, and the wrong quantity by its name."""
    unsafe = sum(row.outcome == "unsafe" for row in rows)
    found = [Bar("unsafe ends", f"{unsafe} of {len(rows)}", unsafe == 0)]
    gentle = [row for row in rows if CASES[row.fault].lands]
    if gentle:
        landed = sum(row.outcome == "landed" for row in gentle) / len(gentle)
        found.append(Bar("landed where possible", f"{100 * landed:.1f} %", landed >= LANDED_SHARE))
    kept_off = [row for row in rows if CASES[row.fault].names and row.outcome != "landed"]
    if kept_off:
        named = sum(names_it(row.fault, row.said) for row in kept_off)
        words = f"{named} of {len(kept_off)} (>= {100 * NAMED_SHARE:g} %)"
        found.append(Bar("wrong quantity named", words, named >= NAMED_SHARE * len(kept_off)))
    return found


def print_unsafe(report: BenchReport, rows: Sequence[FaultRow]) -> None:
    """Each unsafe flight in a line, with what was unsafe and what the app said last."""
    for row in rows:
        if row.outcome == "unsafe":
            report.show(f"unsafe: {place_of(row)}: {row.unsafe} ({row.said})")


def _names(text: str, known: Sequence[str]) -> list[str]:
    names = [name.strip() for name in text.split(";") if name.strip()]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise argparse.ArgumentTypeError(f"'{unknown[0]}': expected some of {'; '.join(known)}")
    return names


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, print the table, and say which bars hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    faults, phases = list(CASES), list(PHASES)
    parser.add_argument("--faults", type=lambda text: _names(text, faults), default=faults, help="'a;b'")
    parser.add_argument("--phases", type=lambda text: _names(text, phases), default=phases, help="'a;b'")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS)
    parser.add_argument(
        "--autopilots", nargs="+", choices=get_args(AutopilotKind), default=get_args(AutopilotKind)
    )
    parser.add_argument(
        "--each",
        type=int,
        metavar="N",
        help="N flights of each fault in each phase, over seeds and scenarios",
    )
    parser.add_argument("--out", type=Path, default=Path("flights/bench-faults"))
    options = parser.parse_args(arguments)
    report = BenchReport()
    file, code = RowsFile(options.out / "runs.jsonl", FaultRow), flights_key(Path(__file__).parent)
    choice = (options.faults, options.phases, options.scenarios, options.seeds)
    whole = list(all_runs(*choice, options.autopilots))
    asked = whole if options.each is None else one_each(*choice, options.each, options.autopilots)
    done = {row.run: row for row in file.read(code)}
    left = [run for run in asked if run not in done]
    report.show(f"{len(asked)} flights, {len(left)} to fly")
    try:
        with terminated_as_interrupted():
            done.update(fly_left(left, code, options.jobs, file, report))
    except KeyboardInterrupt:
        print("stopped: the same command goes on with what is left", file=sys.stderr)
        os._exit(130)  # the flight's loop was broken off, and would tell of each of its tasks
    rows = [done[run] for run in asked if run in done]
    for autopilot in options.autopilots:
        report.show(f"{autopilot}:")
        report.show(table([row for row in rows if row.autopilot == autopilot]))
    print_unsafe(report, rows)
    found = bars(rows)
    report.show(f"flown: {len(rows)} of the whole {len(whole)}")
    if len(rows) < len(asked):
        found.append(Bar("not flown", f"{len(asked) - len(rows)} of {len(asked)}", holds=False))
    return report.judge(found)
