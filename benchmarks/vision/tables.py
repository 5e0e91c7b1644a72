"""The bench's tables beside the paper's and the bars, and which bars hold.

Paper: table 2 (recall, %) and table 3 (precision, cm) by a marker's side (cm) and height (m); cells that it
calls not applicable, or leaves out, are not here.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from rich.table import Table

from benchmarks.report import figures_table
from benchmarks.state.consistency import band
from benchmarks.vision.cases import MOST_TILT_RAD, CaseOutcome, VisionCase, clutter_shots, mean_nees, rmse_m
from benchmarks.vision.judge import JudgedShot
from benchmarks.vision.speed import Times
from sitl.camera.textures import GreyImage

PAPER_RECALL: Final = {
    (5.0, 0.3): 100.0,
    (5.0, 0.6): 99.2,
    (5.0, 1.0): 91.1,
    (10.0, 0.3): 95.2,
    (10.0, 0.6): 99.2,
    (10.0, 1.0): 97.4,
    (10.0, 3.0): 88.9,
    (18.0, 0.6): 87.7,
    (18.0, 1.0): 97.9,
    (18.0, 3.0): 99.8,
    (18.0, 9.0): 88.6,
}
PAPER_RMSE_CM: Final = {
    (5.0, 0.3): 3.35,
    (5.0, 0.6): 5.11,
    (5.0, 1.0): 9.41,
    (10.0, 0.6): 3.46,
    (10.0, 1.0): 6.99,
    (10.0, 3.0): 19.66,
    (18.0, 1.0): 4.97,
    (18.0, 3.0): 12.93,
    (18.0, 9.0): 28.9,
}
PAPER_HEIGHTS_M: Final = (0.3, 0.6, 1.0, 3.0, 9.0)
PAD_HEIGHTS_M: Final = (0.15, 0.3, 0.6, 1.0, 3.0, 6.0, 9.0, 12.0)
PAD_RECALL: Final = {height_m: 0.99 if height_m > 9.0 else 0.999 for height_m in PAD_HEIGHTS_M}
PAD_RMSE_CM: Final = {1.0: 1.0, 3.0: 2.0, 9.0: 6.0}
PAPER_SIZE: Final = "1280x720"
BETTER_EACH, BETTER_MEDIAN = 3.0, 5.0
OVER_BOUND: Final = 1.5
FASTER: Final = {"640x480": 3.0, "1280x720": 5.0}
# shots of a case by which its consistency is judged: their band is then as wide in every run
NEES_SHOTS: Final = 100
Outcomes = dict[VisionCase, CaseOutcome]
Bars = dict[str, bool]


def single_cases() -> list[VisionCase]:
    """Of tables 2 and 3."""
    return [VisionCase(PAPER_SIZE, *cell) for cell in PAPER_RECALL]


def pad_cases() -> list[VisionCase]:
    """The shipped pad at both resolutions."""
    return [VisionCase(size, 0.0, height_m) for size in FASTER for height_m in PAD_HEIGHTS_M]


def _mark(holds: bool) -> str:
    return "" if holds else " ✗"


# ---------------------------------------------------------------- table 2


def recall_tables(outcomes: Outcomes) -> tuple[list[Table], Bars]:
    """Single markers and the pad."""
    single = figures_table(
        f"Table 2: recall % of single markers at {PAPER_SIZE} (the paper's), missed of all",
        *("side", *(f"{h:g} m" for h in PAPER_HEIGHTS_M)),
    )
    held = []
    for side_cm in (5.0, 10.0, 18.0):
        row = []
        for height_m in PAPER_HEIGHTS_M:
            paper, outcome = (
                PAPER_RECALL.get((side_cm, height_m)),
                outcomes.get(VisionCase(PAPER_SIZE, side_cm, height_m)),
            )
            if paper is None or outcome is None:
                row.append("NA")
                continue
            held.append(100.0 * outcome.recall >= paper)
            row.append(
                f"{100.0 * outcome.recall:.2f} ({paper:g}) {outcome.missed}/{outcome.shots}{_mark(held[-1])}"
            )
        single.add_row(f"{side_cm:g} cm", *row)
    pad = figures_table(
        "The shipped pad: recall % (bar), missed of all; of those seen, found by a search of the whole frame",
        *("camera", *(f"{h:g} m" for h in PAD_HEIGHTS_M)),
    )
    pad_held = []
    for size in FASTER:
        row = []
        for height_m, bar in PAD_RECALL.items():
            outcome = outcomes[VisionCase(size, 0.0, height_m)]
            pad_held.append(outcome.recall >= bar)
            wide = sum(shot.seen and shot.whole_frame for shot in outcome.calibrated)
            row.append(
                f"{100.0 * outcome.recall:.2f} (≥{100.0 * bar:g}) {outcome.missed}/{outcome.shots} w{wide}"
                f"{_mark(pad_held[-1])}"
            )
        pad.add_row(size, *row)
    return [single, pad], {"recall of markers": all(held), "recall of the pad": all(pad_held)}


# ---------------------------------------------------------------- table 3


def error_tables(outcomes: Outcomes) -> tuple[list[Table], Bars]:
    """Errors beside the paper's and the bound, and consistency."""
    rows = [
        ErrorRow(outcome)
        for case, outcome in outcomes.items()
        if case.side_cm == 0.0 or (case.side_cm, case.height_m) in PAPER_RMSE_CM
    ]
    low, high = nees_band(NEES_SHOTS, 2 * len(rows))
    grid = figures_table(
        f"Table 3: the position, all axes together. NEES of {NEES_SHOTS} shots / of all; the former is in "
        f"{low:.2f}..{high:.2f} in every row at once in 95 runs of 100. * not a bar",
        *("pad", "height", "RMSE cm", "paper's or bar", "times better", "Cramér-Rao cm"),
        *("RMSE / bound", "corner noise px", "NEES, lens exact", "NEES, lens drawn", "eq. 1 RMSE cm"),
    )
    for row in rows:
        grid.add_row(*row.cells(len(rows)))
    ratios = [row.better for row in rows if row.single]
    return [grid], {
        "RMSE of markers": min(ratios) >= BETTER_EACH and float(np.median(ratios)) >= BETTER_MEDIAN,
        "RMSE of the pad": all(row.close_enough for row in rows if row.judged and not row.single),
        "Cramér-Rao": all(row.over_bound <= OVER_BOUND for row in rows if row.judged),
        "NEES": all(row.honest(row.outcome.exact, len(rows)) for row in rows if row.judged),
        "NEES with calibration": all(row.honest(row.outcome.calibrated, len(rows)) for row in rows),
    }


class ErrorRow:
    """One case's errors. `judged`: the paper's cells, and the pad by the same camera where it has a bar."""

    def __init__(self, outcome: CaseOutcome) -> None:
        case = outcome.case
        self.outcome, self.single = outcome, case.side_cm > 0.0
        bars = {(0.0, height_m): bar for height_m, bar in PAD_RMSE_CM.items()}
        self.bar_cm = (PAPER_RMSE_CM if self.single else bars).get((case.side_cm, case.height_m))
        self.judged = self.bar_cm is not None and case.size == PAPER_SIZE
        self.rmse_cm, self.bound_cm = 100.0 * outcome.rmse_m, 100.0 * outcome.bound_m
        self.over_bound = self.rmse_cm / self.bound_cm
        self.better = math.nan if self.bar_cm is None else self.bar_cm / self.rmse_cm

    @property
    def close_enough(self) -> bool:
        """Whether the error is as small as it has to be, for its own row."""
        return self.better >= (BETTER_EACH if self.single else 1.0)

    def honest(self, shots: Sequence[JudgedShot], rows: int) -> bool:
        """Whether the mean NEES is in its band."""
        mean, count = mean_nees(shots[:NEES_SHOTS])
        if count == 0:
            return False
        low, high = nees_band(count, 2 * rows)
        return low <= mean <= high

    def cells(self, rows: int) -> tuple[str, ...]:
        """The row of the table, of so many."""
        case, star = self.outcome.case, "" if self.judged else " *"
        exact, drawn = self.outcome.exact, self.outcome.calibrated
        return (
            f"{case.side_cm:g} cm" if self.single else f"pad {case.size}",
            f"{case.height_m:g}",
            f"{self.rmse_cm:.3f}",
            "-" if self.bar_cm is None else f"{self.bar_cm:g}",
            "-" if self.bar_cm is None else f"{self.better:.1f}{_mark(self.close_enough)}",
            f"{self.bound_cm:.3f}",
            f"{self.over_bound:.2f}{_mark(self.over_bound <= OVER_BOUND)}{star}",
            self.outcome.noise,
            f"{_nees(exact)}{_mark(self.honest(exact, rows))}{star}",
            f"{_nees(drawn)}{_mark(self.honest(drawn, rows))}",
            f"{100.0 * rmse_m(self.outcome.paper):.3f}" if self.outcome.paper else "-",
        )


def _nees(shots: Sequence[JudgedShot]) -> str:
    return f"{mean_nees(shots[:NEES_SHOTS])[0]:.2f} / {mean_nees(shots)[0]:.2f}"


def nees_band(shots: int, rows: int) -> tuple[float, float]:
    """Bounds of a row's mean NEES that all of so many rows keep together in 95 runs of 100."""
    low, high = band(3, shots, 0.95 ** (1.0 / rows))
    return float(low), float(high)


# ---------------------------------------------------------------- the rest


def flips_table(outcomes: Outcomes) -> tuple[Table, Bars]:
    """By pad and height."""
    grid = figures_table(
        "Flips at tilts of 0..10° (off by more than 10° or tilting to the other side)",
        *("pad", "flips", "sightings", "shots", "turn error p50, p99, worst °"),
    )
    total = 0
    for name, single in (("one marker, 1280x720", True), ("whole pad, 640x480", False)):
        shots = [
            shot
            for case, outcome in outcomes.items()
            if bool(case.side_cm) == single
            for shot in outcome.calibrated
        ]
        turns = np.degrees([shot.turn_error_rad for shot in shots if shot.seen])
        flips = sum(shot.flipped for shot in shots)
        total += flips
        spread = ", ".join(f"{v:.2f}" for v in np.percentile(turns, (50, 99, 100))) if len(turns) else "-"
        grid.add_row(name, f"{flips}", f"{len(turns)}", f"{len(shots)}", spread)
    return grid, {"flips": total == 0}


def speed_table(all_times: Sequence[Times]) -> tuple[Table, Bars]:
    """By camera and height, and over all heights."""
    grid = figures_table(
        "Frame time while tracking beside cv2.aruco.ArucoDetector (CORNER_REFINE_SUBPIX), one thread",
        *("camera", "height", "ours ms", "peer ms", "times less", "our recall %", "peer's %"),
    )
    bars: Bars = {}
    for size, bar in FASTER.items():
        rows = [times for times in all_times if times.size == size]
        whole = Times(size, math.nan)
        for times in rows:
            whole.ours_s += times.ours_s
            whole.peers_s += times.peers_s
            whole.ours_seen += times.ours_seen
            whole.peers_seen += times.peers_seen
        for times in (*rows, whole):
            n, last = len(times.ours_s), times is whole
            grid.add_row(
                size,
                f"all (≥{bar:g})" if last else f"{times.height_m:g}",
                *(f"{1e3 * float(np.median(values)):.2f}" for values in (times.ours_s, times.peers_s)),
                f"{times.ratio:.1f}{_mark(times.ratio >= bar)}",
                *(f"{100.0 * seen / n:.1f}" for seen in (times.ours_seen, times.peers_seen)),
                end_section=last,
            )
        bars[f"speed at {size}"] = whole.ratio >= bar
        bars[f"recall at speed, {size}"] = whole.ours_seen >= whole.peers_seen
    return grid, bars


# ---------------------------------------------------------------- pictures
# A contact sheet of the bench's frames, for the eye: is that what a camera would give?
#
# Each row is a kind of shot, each cell a whole frame and, below it, what is about the pad's centre in the
# sensor's own pixels.

CELL_PX: Final = (320, 240)
# a chunk that no table uses
SHEET_CHUNK: Final = 10**6
CLUTTER_SHEET_CHUNKS: Final = (0, 2, 3, 5)
CASES: Final = (
    [VisionCase("1280x720", 0.0, height_m) for height_m in (0.15, 0.6, 3.0, 12.0)],
    [VisionCase("640x480", 0.0, height_m) for height_m in (0.15, 0.6, 3.0, 12.0)],
    [VisionCase("1280x720", *of) for of in ((5.0, 0.3), (10.0, 1.0), (18.0, 3.0), (18.0, 9.0))],
    [
        VisionCase("1280x720", 0.0, 1.0, tilted=True),
        *(VisionCase("640x480", 0.0, h, tilted=True) for h in (0.3, 3.0, 9.0)),
    ],
)


def contact_sheet(path: Path) -> None:
    """Write it as PNG; the folder is made."""
    rows = [
        np.hstack(
            [_cell(*_frame(case), f"{case.side_cm or 'pad'} {case.height_m:g} m {case.size}") for case in row]
        )
        for row in CASES
    ]
    clutter = []
    for chunk in CLUTTER_SHEET_CHUNKS:
        stage, shot, _ = clutter_shots(chunk, 1)[0]
        rows_px, columns_px = shot.frame.image.shape
        middle = (0.5 * columns_px, 0.5 * rows_px)
        clutter.append(_cell(shot.frame.image, middle, f"clutter {stage.camera.width_px} px"))
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.vstack([*rows, np.hstack(clutter)]))


def _frame(case: VisionCase) -> tuple[GreyImage, tuple[float, float]]:
    """A frame, and where the pad's centre is in it."""
    rng = case.rng(SHEET_CHUNK)
    stage = case.stage(rng)
    shot = stage.shoot(case.height_m, MOST_TILT_RAD if case.tilted else None)
    u, v = stage.pixels(shot.scene, np.zeros((1, 3)))[0][0].tolist()
    return shot.frame.image, (u, v)


def _cell(image: GreyImage, about: tuple[float, float], title: str) -> GreyImage:
    width, height = CELL_PX
    rows, columns = image.shape
    scaled = cv2.resize(image, (width, round(width * rows / columns)), interpolation=cv2.INTER_AREA)
    cell = np.full((2 * height, width), 128, np.uint8)
    cell[: min(height, scaled.shape[0])] = scaled[:height]
    left = min(max(round(about[0]) - width // 2, 0), columns - width)
    top = min(max(round(about[1]) - height // 2, 0), rows - height)
    cell[height:] = image[top : top + height, left : left + width]
    cv2.putText(cell, title, (4, height - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255,), 3)
    cv2.putText(cell, title, (4, height - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0,), 1)
    return cell
