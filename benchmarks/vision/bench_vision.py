"""The eyes by the paper's tables 2 and 3, by clutter, by flips and by OpenCV's own speed.

    python -m benchmarks vision               # the whole of it
    python -m benchmarks vision --quick       # every bar on few frames, under 2 minutes
    python -m benchmarks vision --only speed  # tables, clutter, flips, speed, families or photos
    python -m benchmarks vision DATA          # also photographs, DATA/aruco and apriltag, and DATA/photoreal
    python -m benchmarks vision --only sweep  # every pad, camera and height: twenty minutes

Frames are rendered by the simulator's camera (f = 1065 px at 1280x720, and 640x480) under a vehicle that
hovers in moderate turbulence, its rotors' vibration on it: rolling shutter, blur, defocus, vignette, noise. A
marker alone is whole in its frames, as far from the middle as the hover takes it; the shipped pad may be cut
off. The app is told what it would know: see `shots`. Seeds are fixed and no setting was chosen by them
here.

Prints its tables and ends in one line that says which bars hold; the exit status matches.
"""

import argparse
import itertools
import multiprocessing
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

# each process has one core
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
from rich.table import Table

from benchmarks.report import BenchReport, watched
from benchmarks.vision.cases import SEED, SHOTS_OF_A_BOARD, CaseOutcome, VisionCase, false_pads, run_chunk
from benchmarks.vision.families import FAMILIES, FamilyRun, family_table, run_family
from benchmarks.vision.photos import (
    SETS,
    photo_table,
    photoreal_table,
    read_photos,
    read_set,
    read_tags,
    tag_table,
)
from benchmarks.vision.speed import HEIGHTS_M, Times, measure
from benchmarks.vision.sweep import SweepOutcome, cases, sweep, sweep_table
from benchmarks.vision.tables import (
    FASTER,
    PAD_HEIGHTS_M,
    PAPER_SIZE,
    Bars,
    Outcomes,
    contact_sheet,
    error_tables,
    flips_table,
    pad_cases,
    recall_tables,
    single_cases,
    speed_table,
)

SMOKE: Final = ("--only", "clutter", "--clutter", "10", "--jobs", "1")
PARTS: Final = ("tables", "clutter", "flips", "speed", "families", "photos", "photoreal", "sweep")
SHOTS_OF_A_CHUNK: Final = 100
ARUCO_FOLDER, TAGS_FOLDER, PHOTOREAL_FOLDER = DATA_FOLDERS = ("aruco", "apriltag", "photoreal")


@dataclass(frozen=True)
class Amount:
    """How many frames: of each case of one marker and of the pad, of clutter, of each kind of flip, timed.

    And hovers of each family and height, and frames at each height of the sweep.
    """

    marker: int
    pad: int
    clutter: int
    flips: int
    timed: int
    families: int
    sweep: int


FULL: Final = Amount(marker=1000, pad=1000, clutter=10_000, flips=10_000, timed=150, families=3, sweep=3)
QUICK: Final = Amount(marker=40, pad=60, clutter=200, flips=200, timed=20, families=1, sweep=1)


@dataclass(frozen=True)
class Work:
    """A piece of work for one process; without a case: clutter."""

    case: VisionCase | None
    chunk: int
    shots: int


def do(work: Work) -> CaseOutcome | int:
    """Do it, on one thread; returns an outcome, or how many pads were seen where there was none."""
    cv2.setNumThreads(1)
    if work.case is None:
        return false_pads(work.chunk, work.shots)
    return run_chunk(work.case, work.chunk, work.shots)


def chunks(case: VisionCase | None, shots: int) -> Iterator[Work]:
    """A number of shots in pieces."""
    most = SHOTS_OF_A_BOARD if case is None else SHOTS_OF_A_CHUNK
    for chunk, first in enumerate(range(0, shots, most)):
        yield Work(case, chunk, min(most, shots - first))


def tilted_cases() -> list[VisionCase]:
    """Of one marker wherever the paper uses one, and of the pad at every height."""
    single = [VisionCase(case.size, case.side_cm, case.height_m, tilted=True) for case in single_cases()]
    return [*single, *(VisionCase("640x480", 0.0, height_m, tilted=True) for height_m in PAD_HEIGHTS_M)]


def work_of(parts: Sequence[str], amount: Amount) -> list[Work]:
    """All that is rendered and judged, but for the timing."""
    works: list[Work] = []
    if "tables" in parts:
        for case in (*single_cases(), *pad_cases()):
            works += chunks(case, amount.marker if case.side_cm else amount.pad)
    if "flips" in parts:
        cases = tilted_cases()
        for case in cases:
            alike = sum(bool(case.side_cm) == bool(other.side_cm) for other in cases)
            works += chunks(case, -(-amount.flips // alike))
    if "clutter" in parts:
        works += chunks(None, amount.clutter)
    return works


def run(works: Sequence[Work], jobs: int) -> Iterator[tuple[Work, CaseOutcome | int]]:
    """Results, in the order of the work: the same however many processes share it."""
    found = dict(watched(_results(works, jobs), "rendering and looking", len(works)))
    yield from ((work, found[work]) for work in works)


def _results(works: Sequence[Work], jobs: int) -> Iterator[tuple[Work, CaseOutcome | int]]:
    if jobs == 1:
        yield from ((work, do(work)) for work in works)
        return
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = {pool.submit(do, work): work for work in works}
        for future in as_completed(futures):
            yield futures[future], future.result()


def joined(results: Iterable[tuple[Work, CaseOutcome | int]]) -> tuple[Outcomes, int, int]:
    """Outcomes by case; false pads, and of how many frames of clutter."""
    outcomes: Outcomes = {}
    false = clutter = 0
    for work, result in results:
        if isinstance(result, int):
            false, clutter = false + result, clutter + work.shots
        elif work.case is not None:
            outcomes.setdefault(work.case, CaseOutcome(work.case)).join(result)
    return outcomes, false, clutter


def timed(frames: int) -> list[Times]:
    """Both cameras at every height; nothing else of the bench runs meanwhile."""
    cv2.setNumThreads(1)
    wanted = [(size, height_m) for size in FASTER for height_m in HEIGHTS_M]
    return [measure(*each, frames) for each in watched(wanted, "timing")]


def by_family(hovers: int) -> list[FamilyRun]:
    """Every family; nothing else of the bench runs meanwhile."""
    return [run_family(each, hovers) for each in watched(FAMILIES, "by family")]


def swept(shots: int, jobs: int) -> list[SweepOutcome]:
    """Every pad before every camera."""
    cv2.setNumThreads(1)
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        each = pool.map(sweep, cases(), itertools.repeat(shots))
        return list(watched(each, "sweeping", len(cases())))


def measured(
    parts: Sequence[str], amount: Amount, jobs: int, data: Path | None
) -> Iterator[tuple[Table | str, Bars]]:
    """Run what is asked for: each table, or line, with its bars."""
    outcomes, false, clutter = joined(run(work_of(parts, amount), jobs))
    if "tables" in parts:
        plain = {case: outcome for case, outcome in outcomes.items() if not case.tilted}
        for tables, held in (recall_tables(plain), error_tables(plain)):
            yield from ((grid, held) for grid in tables)
    if "clutter" in parts:
        yield f"false pads in {clutter} frames of clutter: {false} (0)", {"clutter": false == 0}
    if "flips" in parts:
        yield flips_table({case: outcome for case, outcome in outcomes.items() if case.tilted})
    if "speed" in parts:
        yield speed_table(timed(amount.timed))
    if "families" in parts:
        yield family_table(by_family(amount.families))
    if "sweep" in parts:
        yield sweep_table(swept(amount.sweep, jobs))
    yield from from_data(parts, data)


def from_data(parts: Sequence[str], data: Path | None) -> Iterator[tuple[Table, Bars]]:
    """Tables and bars of those pictures that are there."""
    folders = {name: data / name for name in DATA_FOLDERS if data is not None and (data / name).is_dir()}
    if "photoreal" in parts and (folder := folders.get(PHOTOREAL_FOLDER)):
        yield photoreal_table([read_set(folder / name, SETS[name]) for name in SETS])
    if "photos" in parts and (folder := folders.get(ARUCO_FOLDER)):
        yield photo_table(read_photos(folder))
    if "photos" in parts and (folder := folders.get(TAGS_FOLDER)):
        yield tag_table(read_tags(folder))


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "data", nargs="?", type=Path, metavar="DATA", help=f"a folder with {' or '.join(DATA_FOLDERS)} in it"
    )
    parser.add_argument("--quick", action="store_true", help="few frames: under 2 minutes")
    parser.add_argument(
        "--only", nargs="+", choices=PARTS, default=PARTS, metavar="PART", help=", ".join(PARTS)
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    for part, of in (("clutter", "clutter"), ("flips", "one marker, and as many of the pad, for flips")):
        number = getattr(FULL, part)
        parser.add_argument(f"--{part}", type=int, metavar="N", help=f"frames of {of} (default {number})")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write a contact sheet there")
    chosen = parser.parse_args(arguments)
    if chosen.data is not None and not any((chosen.data / name).is_dir() for name in DATA_FOLDERS):
        parser.error(f"{chosen.data}: expected a folder with {' or '.join(DATA_FOLDERS)} in it")
    amount = QUICK if chosen.quick else FULL
    amount = replace(amount, clutter=chosen.clutter or amount.clutter, flips=chosen.flips or amount.flips)
    report = BenchReport(width=200)
    if chosen.pictures is not None:
        contact_sheet(chosen.pictures / "vision_frames.png")
    report.show(f"seed {SEED}, {PAPER_SIZE} f = 1065 px and 640x480, {chosen.jobs} jobs")
    bars: Bars = {}
    for shown, held in measured(chosen.only, amount, chosen.jobs, chosen.data):
        report.show(shown)
        bars |= held
    return report.judge(bars)
