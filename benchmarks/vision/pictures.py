"""A contact sheet of the bench's frames, for the eye: is that what a camera would give?

Each row is a kind of shot, each cell a whole frame and, below it, what is about the pad's centre in the
sensor's own pixels.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from benchmarks.vision.cases import MOST_TILT_RAD, VisionCase
from benchmarks.vision.clutter import clutter_shots
from benchmarks.vision.shots import PadBeforeCamera
from sitl.camera.textures import GreyImage

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
    stage = PadBeforeCamera(case.size, case.side_cm, rng)
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
