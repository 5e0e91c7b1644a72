"""Where the time goes in virtual time: CPU milliseconds for one simulated second, app and simulator apart.

    python -m benchmarks time --scenario circle --seed 0 --json now.json
    python -m benchmarks time --against now.json
    python -m benchmarks time --beside OTHER_TREE --rounds 3

One flight in this process, each part's CPU time without that of the parts within it; what the tasks of
either side do between the parts is theirs. `--against` puts an earlier run's figures beside; a machine that
is busy, or another one, makes them differ by more than the code does. `--beside` flies the code of another
checkout in turn with this one's, and the least of each counts: only such ratios tell two trees apart.

Prints a table and ends in one line that says whether the bar holds (3x real time with rendering on); the
exit status matches.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Coroutine, Generator, Sequence
from pathlib import Path
from typing import Any, Final

from rich.table import Table

from benchmarks.cpu.cpu_watch import (
    GARBAGE,
    LOOP,
    LOOP_METHODS,
    METHODS,
    SITL_METHODS,
    TASKS,
    CpuWatch,
    Methods,
)
from benchmarks.report import BenchReport
from companion.app.app import App
from companion.base.clock import VirtualTimeLoop
from companion.config import CONFIG_FOLDER
from companion.flightlog.record import FlightLog
from companion.sense.vision.opencv import prepare_opencv
from companion.sim.runner import fly
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.run.in_process import InProcess

SMOKE: Final = ("--scenario", "static", "--time-limit", "5")
REAL_TIME_FACTOR: Final = 3.0
ROOT: Final = Path(__file__).parents[2]
START: Final = "app: made"
APP_TASKS: Final = "app: tasks between the stages"
SITL_TASKS: Final = "SITL: tasks, ticks"
PARTS: Final[Methods] = {
    **METHODS,
    **LOOP_METHODS,
    START: ((App, ("__init__",)),),
    "SITL: made": ((InProcess, ("__init__",)),),
    **SITL_METHODS,
}
ONCE: Final = (START, "SITL: made")  # for a flight, however long
IMPORTS: Final = {
    "start: companion --help": ("-m", "companion.cli", "--help"),
    "start: imports of a flight": ("-c", "import companion.sim.runner"),
}


class TimedCoroutine(Coroutine[Any, Any, Any]):
    """A task's coroutine, every step of which counts for one side."""

    def __init__(self, inner: Coroutine[Any, Any, Any], part: str, watch: CpuWatch) -> None:
        self._inner = inner
        self._send, self._throw = watch.timed(part, inner.send), watch.timed(part, inner.throw)

    def __await__(self) -> Generator[Any, Any, Any]:
        return self._inner.__await__()

    def send(self, value: Any) -> Any:
        """One step."""
        return self._send(value)

    def throw(self, *error: Any) -> Any:
        """One step, that begins with an exception."""
        return self._throw(*error)

    def close(self) -> None:
        """It ends."""
        self._inner.close()


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="circle")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time-limit", type=float, help="end the flight after so many simulated seconds")
    parser.add_argument("--against", type=Path, help="JSON of an earlier run, to be put beside")
    parser.add_argument("--beside", type=Path, help="another checkout, to be flown in turn with this one")
    parser.add_argument("--rounds", type=int, default=3, help="flights of either checkout")
    chosen = parser.parse_args(arguments)
    report = BenchReport()
    if chosen.beside is None:
        found = measure(chosen.scenario, chosen.seed, chosen.time_limit)
        before = None if chosen.against is None else json.loads(chosen.against.read_text("utf-8"))["figures"]
    else:
        runs: dict[Path, list[dict[str, Any]]] = {chosen.beside: [], ROOT: []}
        for _ in range(chosen.rounds):
            for tree, flown in runs.items():
                flown.append(_fly_tree(tree, chosen))
        before, found = (_least(flown) for flown in runs.values())
    report.figures = found
    report.show(table_of(found, before))
    factor = found["real_time_factor"]
    name = f"{factor:.1f}x real time, at least {REAL_TIME_FACTOR:g}x:"
    return report.judge({name: factor >= REAL_TIME_FACTOR})


def measure(scenario: str, seed: int, time_limit_s: float | None = None) -> dict[str, Any]:
    """One flight: what it cost by part and by thread (CPU ms for a simulated second), and the start (ms)."""
    prepare_opencv()
    once_ms = {name: _cpu_ms_of(words) for name, words in IMPORTS.items()}
    trial = Trial.load(scenario, seed)
    if time_limit_s is not None:
        flown = trial.scenario.model_copy(update={"time_limit_s": time_limit_s})
        trial = Trial(trial.path, flown, seed)
    settings = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    watch = CpuWatch(PARTS)
    make_task = VirtualTimeLoop.create_task

    def create_task(self: VirtualTimeLoop, coro: Any, **named: Any) -> Any:
        ours = f"{os.sep}sitl{os.sep}" not in coro.cr_code.co_filename
        return make_task(self, TimedCoroutine(coro, APP_TASKS if ours else SITL_TASKS, watch), **named)

    VirtualTimeLoop.create_task = create_task  # type: ignore[method-assign,assignment]
    began_s = time.process_time()
    try:
        with watch.watching():
            flight = fly(settings, trial, FlightLog(None, start_unix_s=0.0), lambda _status: None, fast=True)
    finally:
        VirtualTimeLoop.create_task = make_task  # type: ignore[method-assign]
    cpu_s, simulated_s = time.process_time() - began_s, flight.report.duration_s
    made_s = {part: watch.spent_s.pop(part, 0.0) for part in ONCE}
    watch.by_thread_s[threading.current_thread().name] -= sum(made_s.values())
    once_ms |= {part: 1e3 * spent_s for part, spent_s in made_s.items()}
    each = {_row(part): 1e3 * spent_s / simulated_s for part, spent_s in watch.spent_s.items()}
    rest_ms = (1e3 * cpu_s - sum(once_ms[part] for part in ONCE)) / simulated_s - sum(each.values())
    return {
        "scenario": scenario,
        "seed": seed,
        "simulated_s": simulated_s,
        "real_time_factor": flight.real_time_factor,
        "parts_ms_per_s": {**each, "loop: not watched": rest_ms},
        "threads_ms_per_s": {
            name: 1e3 * spent_s / simulated_s for name, spent_s in watch.by_thread_s.items()
        },
        "once_ms": once_ms,
    }


def _row(part: str) -> str:
    """A part's name with the side that it is of."""
    if part in METHODS:
        return f"app: {part}"
    return f"loop: {part}" if part in (TASKS, LOOP, GARBAGE) else part


def _cpu_ms_of(words: Sequence[str]) -> float:
    """CPU (ms) of an interpreter with these words, its start included; of three the least."""
    spent = []
    for _ in range(3):
        before = os.times()
        subprocess.run([sys.executable, *words], check=True, capture_output=True)
        after = os.times()
        children = (after.children_user, after.children_system)
        spent.append(sum(children) - before.children_user - before.children_system)
    return 1e3 * min(spent)


def _fly_tree(tree: Path, chosen: argparse.Namespace) -> dict[str, Any]:
    """One flight of a checkout's code, by this bench."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "benchmarks").symlink_to(ROOT / "benchmarks")
        out = Path(folder) / "found.json"
        command = [sys.executable, "-m", "benchmarks", "time", "--scenario", chosen.scenario]
        command += ["--seed", str(chosen.seed), "--json", str(out)]
        if chosen.time_limit is not None:
            command += ["--time-limit", str(chosen.time_limit)]
        path = f"{folder}{os.pathsep}{tree.resolve()}"
        flown = subprocess.run(
            command,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        if not out.exists():
            raise SystemExit(f"{tree}: {flown.stderr.strip()[-300:]}")
        found: dict[str, Any] = json.loads(out.read_text("utf-8"))["figures"]
        return found


def _least(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The least of each figure: what else the machine did only added to it."""
    least = dict(runs[0])
    least["real_time_factor"] = max(run["real_time_factor"] for run in runs)
    for group in ("parts_ms_per_s", "threads_ms_per_s", "once_ms"):
        names = {name for run in runs for name in run[group]}
        least[group] = {name: min(run[group].get(name, 0.0) for run in runs) for name in names}
    return least


def totals(found: dict[str, Any]) -> dict[str, float]:
    """CPU ms for a simulated second of each side."""
    parts: dict[str, float] = found["parts_ms_per_s"]
    sides = ("app", "SITL", "loop")
    summed = {
        side: sum(value for name, value in parts.items() if name.startswith(f"{side}:")) for side in sides
    }
    return {**summed, "all": sum(summed.values())}


def table_of(found: dict[str, Any], before: dict[str, Any] | None) -> Table:
    """Now, and beside it what was before."""
    table = Table(title=f"{found['scenario']}, seed {found['seed']}: {found['simulated_s']:.0f} s simulated")
    table.add_column("CPU, ms a simulated second")
    for name in ("now",) if before is None else ("before", "now", "ratio"):
        table.add_column(name, justify="right")

    def rows(now: dict[str, float], then: dict[str, float] | None, *, ordered: bool = True) -> None:
        for name in sorted(now, key=lambda part: -now[part]) if ordered else now:
            figures = [f"{now[name]:.1f}"]
            if then is not None:
                old = then.get(name, 0.0)
                figures = [f"{old:.1f}", *figures, f"{now[name] / old:.2f}" if old else ""]
            table.add_row(name, *figures)
        table.add_section()

    rows(found["parts_ms_per_s"], None if before is None else before["parts_ms_per_s"])
    rows(totals(found), None if before is None else totals(before), ordered=False)
    for group, title in (("threads_ms_per_s", "by thread"), ("once_ms", "once, ms")):
        table.add_row(f"[bold]{title}")
        rows(found[group], None if before is None else before[group])
    return table
