"""Camera calibration on rendered boards whose truth is known, and on real photos.

    python -m benchmarks camera [DATA] --seeds 12

Rendered: 25 views at 1280x720, a board held by hand (tilted by up to 45 degrees, all over the image), noise
of 3 grey values, blur of focus (0.4 to 1.2 px) and of motion (up to 1.5 px each way), on a board that is flat
and on one that is bowed by 0.5 mm. DATA is a folder of real data with the photos in its subfolder aruco.
Prints a table and ends in one line that says which bars hold; the exit status matches.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from rich.table import Table

from benchmarks.report import BenchReport, figures_table, watched
from benchmarks.state.consistency import band
from calibration.camera.board import CalibrationBoard, read_dictionary
from calibration.camera.quality import Assessment, assess
from calibration.camera.solver import UnsolvableError
from calibration.camera.views import BoardFinder, BoardView
from companion.base.geometry import FloatArray
from companion.config import CameraConfig, find_file, load_model
from companion.sense.camera.photos import photo_paths, read_photos
from tests.unit.calibration.camera.board_pictures import BoardPainter, hand_held_poses

SMOKE: Final = ("--seeds", "1")
VIEWS: Final = 25
FOCAL_SHARE: Final = 0.001
CENTRE_PX: Final = 1.0
# a peer's reprojection error on 42 photos of a board
PEER_RMS_PX: Final = 0.462
BOWS_M: Final = (0.0, 0.0005)


@dataclass(frozen=True)
class CalibrationRun:
    """One calibration: errors of the camera's numbers (9,), how large they are said to be, and NEES."""

    errors: FloatArray
    std: FloatArray
    nees: float
    found: Assessment


def calibrated(camera: CameraConfig, board: CalibrationBoard, bow_m: float, seed: int) -> CalibrationRun:
    """Take pictures, find the board, calibrate, and hold it against the truth."""
    rng = np.random.default_rng(seed)
    painter, finder = BoardPainter(board, camera, bow_m), BoardFinder(board)
    views: list[BoardView] = []
    for number, pose in enumerate(hand_held_poses(board, camera, VIEWS, rng)):
        image = painter.take(
            pose,
            rng,
            noise_grey=3.0,
            defocus_px=rng.uniform(0.4, 1.2),
            motion_px=(rng.uniform(-1.5, 1.5), rng.uniform(-1.5, 1.5)),
        )
        view = finder.find(image, f"view {number}")
        views += [] if view is None else [view]
    found = assess(views, (camera.width_px, camera.height_px), board.surface)
    truth = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion])
    errors = found.solution.camera.numbers - truth
    nees = float(errors @ np.linalg.solve(found.uncertainty.covariance, errors))
    return CalibrationRun(errors, found.uncertainty.std, nees, found)


def table(rows: dict[float, list[CalibrationRun]], camera: CameraConfig) -> Table:
    """Errors beside the bars."""
    low, high = band(9, len(next(iter(rows.values()))))
    grid = figures_table(
        f"Camera calibration, {VIEWS} rendered views of 1280x720: errors (worst of the runs)",
        *("bow mm", "runs", f"fx % (<= {100 * FOCAL_SHARE:g})", "fy %", f"cx px (<= {CENTRE_PX:g})", "cy px"),
        *("fx: rms / stated", "cx: rms / stated", f"NEES ({low:.1f}..{high:.1f})"),
        *("reprojection px", "held out px", "bow found mm", "refused"),
    )
    for bow_m, runs in rows.items():
        errors, std = np.array([r.errors for r in runs]), np.array([r.std for r in runs])
        worst = np.abs(errors).max(axis=0)
        ratio = np.sqrt(np.mean((errors / std) ** 2, axis=0))
        held = [r.found.held_out_rms_px or np.nan for r in runs]
        grid.add_row(
            f"{1e3 * bow_m:g}",
            f"{len(runs)}",
            f"{100 * worst[0] / camera.fx_px:.3f}",
            f"{100 * worst[1] / camera.fy_px:.3f}",
            *(f"{value:.2f}" for value in worst[2:4]),
            f"{ratio[0]:.2f}",
            f"{ratio[2]:.2f}",
            f"{np.mean([r.nees for r in runs]):.2f}",
            f"{np.mean([r.found.rms_px for r in runs]):.3f}",
            f"{np.mean(held):.3f}",
            f"{1e3 * np.mean([r.found.solution.surface.bend_m[0] for r in runs]):.3f}",
            f"{sum(bool(r.found.reasons) for r in runs)}",
        )
    return grid


# ---------------------------------------------------------------- real photos


def real_rows(folder: Path) -> list[tuple[str, CalibrationBoard, list[Path]]]:
    """What there is to try of OpenCV's tutorial photos: name, board, photos."""
    grid = CalibrationBoard(
        pattern="grid",
        columns=5,
        rows=7,
        marker_m=0.04,
        gap_m=0.01,
        dictionary=read_dictionary(str(folder / "tutorial_dict.yml")),
    )
    charuco = CalibrationBoard(columns=5, rows=7, square_m=0.04, marker_m=0.02, dictionary="6x6_250")
    return [
        ("ChArUco", charuco, [folder / "choriginal.jpg", folder / "chocclusion_original.jpg"]),
        ("grid", grid, [folder / "gboriginal.jpg", folder / "gbocclusion.jpg"]),
    ]


def real(folder: Path, report: BenchReport) -> bool:
    """Calibrate from the photos as far as they go; whether each was refused, as two photos have to be."""
    refused = []
    for name, board, paths in real_rows(folder):
        finder = BoardFinder(board)
        photos = list(read_photos(photo_paths(paths), print))
        views = [view for photo in photos if (view := finder.find(photo.image, photo.name)) is not None]
        try:
            found = assess(views, photos[0].size_px, board.surface)
        except UnsolvableError as error:
            report.show(f"real photos, {name}: {len(views)} views: refused: {error}")
            refused.append(True)
            continue
        report.show(
            f"real photos, {name}: {len(views)} views, reprojection {found.rms_px:.3f} px "
            f"(<= {PEER_RMS_PX} on 42 photos, which are not here); against it: {len(found.reasons)} reasons"
        )
        refused.append(bool(found.reasons))
    return all(refused)


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", nargs="?", type=Path, metavar="DATA")
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--first-seed", type=int, default=0)
    chosen = parser.parse_args(arguments)
    report = BenchReport(width=200)
    cv2.setNumThreads(1)
    camera = load_model(CameraConfig, find_file("cameras", "hd_1280x720"))
    board = load_model(CalibrationBoard, find_file("boards", "charuco_a4"))
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    rows = {
        bow_m: [calibrated(camera, board, bow_m, seed) for seed in seeds]
        for bow_m in watched(BOWS_M, "boards")
    }
    report.show(table(rows, camera))
    low, high = band(9, chosen.seeds)
    worst = np.abs([run.errors for runs in rows.values() for run in runs]).max(axis=0)
    nees = [float(np.mean([run.nees for run in runs])) for runs in rows.values()]
    bars = {
        "focal length": bool((worst[:2] <= FOCAL_SHARE * np.array((camera.fx_px, camera.fy_px))).all()),
        "principal point": bool((worst[2:4] <= CENTRE_PX).all()),
        "NEES": all(low <= value <= high for value in nees),
        "none refused": not any(run.found.reasons for runs in rows.values() for run in runs),
    }
    folder = None if chosen.data is None else chosen.data / "aruco"
    if folder is not None and folder.is_dir():
        bars["two photos refused"] = real(folder, report)
    else:
        report.show("real photos: not run; expected DATA, a folder with aruco in it")
    return report.judge(bars)
