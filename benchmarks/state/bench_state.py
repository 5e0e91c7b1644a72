"""How well the estimators do in the SITL, beside their bars: errors, consistency, faults, costs.

    python -m benchmarks state --seeds 20 --jobs 2 --pictures pictures

Flies each scenario under many seeds in virtual time with rendering, figure-8 under twice and four times the
vibration, too, then measures from take-off to touchdown
with the truth: attitude, velocity, the pad's velocity while seen for 2 s, and the NEES of both filters with
the 95 % band of its mean over the seeds; then the faults in closed loop; then the costs. Ends in one line
that says which bars hold; the exit status is 0 when all do. `--streams` keeps the flights: those already
there are not flown again, but the estimators run over them again as they are now (in closed loop only the
flights know what an estimator does: empty the folder for that).
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Final

from benchmarks.report import BenchReport, watched
from benchmarks.state.consistency import Consistency
from benchmarks.state.fault_flights import CASES, FaultFlight, trial_of
from benchmarks.state.figures import (
    VIBRATION,
    FlightCase,
    FlightErrors,
    bars,
    cases_of,
    consistencies,
    consistency_table,
    cost_bars,
    cost_table,
    draw_consistency,
    draw_errors,
    draw_faults,
    error_table,
    fault_bars,
    fault_table,
    measure,
)
from benchmarks.state.streams import Stream, fly_stream, load, rerun, save, settings_of, stream_path
from companion.sim.trial import Trial

SMOKE: Final = (
    "--scenarios",
    "static",
    "--vibration",
    "1",
    "--seeds",
    "1",
    "--fault-seeds",
    "0",
    "--jobs",
    "1",
)
SCENARIOS: Final = ("figure_8", "static", "line", "circle", "heave")


# ---------------------------------------------------------------- flying


def obtain(trial: Trial, name: str, folder: Path | None) -> Stream:
    """Fly, or take what is kept under the name."""
    path = None if folder is None else stream_path(folder, name, trial.seed)
    if path is not None and path.exists():
        return load(path)
    stream = fly_stream(trial)
    if path is not None:
        save(stream, path)
    return stream


def flown(case: FlightCase, seed: int, folder: Path | None) -> FlightErrors:
    """One flight, measured."""
    trial = case.trial(seed)
    stream = obtain(trial, case.slug, folder)
    return FlightErrors(case, seed, stream.outcome, rerun(stream, settings_of(trial)))


def flown_with_fault(index: int, seed: int, folder: Path | None) -> FaultFlight:
    """One flight of `CASES`, measured."""
    case = CASES[index]
    trial = trial_of(case, seed)
    stream = obtain(trial, case.slug, folder)
    return FaultFlight(case, seed, stream.outcome, rerun(stream, settings_of(trial)))


def draw(
    folder: Path,
    flights: Sequence[FlightErrors],
    by_case: dict[FlightCase, dict[str, Consistency]],
    faulted: Sequence[FaultFlight],
) -> None:
    """All pictures into a folder."""
    for case, figures in by_case.items():
        first = next(flight for flight in flights if flight.case == case)
        title = f"{case.name}, seed {first.seed}: truth minus estimate"
        draw_errors(first.samples, title, folder / f"errors_{case.slug}.png")
        draw_consistency(figures, case.name, folder / f"nees_{case.slug}.png")
    if faulted:
        curves = [
            (f"{f.case.name}", f.times_s, f.errors()["attitude °"], f.errors()["velocity m/s"])
            for f in faulted
            if f.seed == faulted[0].seed
        ]
        draw_faults(curves, folder / "faults.png")


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    parser.add_argument("--vibration", nargs="+", type=float, default=list(VIBRATION), help="of figure_8")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--fault-seeds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--streams", type=Path, help="folder that keeps the flights")
    parser.add_argument("--pictures", type=Path, help="folder for PNGs")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    chosen, report = parse(arguments), BenchReport()
    cases = cases_of(chosen.scenarios, chosen.vibration)
    with ProcessPoolExecutor(chosen.jobs) as pool:
        waiting = [
            pool.submit(flown, case, seed, chosen.streams) for case in cases for seed in range(chosen.seeds)
        ]
        more = [
            pool.submit(flown_with_fault, index, seed, chosen.streams)
            for index in range(len(CASES))
            for seed in range(chosen.fault_seeds)
        ]
        flights = [f.result() for f in watched(waiting, "flights")]
        faulted = [f.result() for f in watched(more, "faults")]
    by_case = {case: consistencies([flight for flight in flights if flight.case == case]) for case in cases}
    report.show(error_table(flights), consistency_table(by_case))
    held = bars(flights, by_case)
    if faulted:
        report.show(fault_table(faulted))
        held |= fault_bars(faulted)
    trial = cases[0].trial(0)
    costs = measure(obtain(trial, cases[0].slug, chosen.streams), settings_of(trial))
    report.show(cost_table(costs))
    held |= cost_bars(costs)
    if chosen.pictures is not None:
        draw(chosen.pictures, flights, by_case, faulted)
    return report.judge(held)
