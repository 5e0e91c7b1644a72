"""A contact sheet of the bench's frames, for the eye: is that what a camera would give?

Each row is a kind of shot, each cell a whole frame and, below it, its middle in the sensor's own pixels.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from sitl.textures import GreyImage
from tests.bench.vision_cases import Case
from tests.bench.vision_clutter import clutter_shots
from tests.bench.vision_shots import Stage

CELL_PX: Final = (320, 240)
CLUTTER_SHEET_CHUNKS: Final = (0, 2, 3, 5)
CASES: Final = (
    [Case("1280x720", 0.0, height_m) for height_m in (0.15, 0.6, 3.0, 12.0)],
    [Case("640x480", 0.0, height_m) for height_m in (0.15, 0.6, 3.0, 12.0)],
    [Case("1280x720", *of) for of in ((5.0, 0.3), (10.0, 1.0), (18.0, 3.0), (18.0, 9.0))],
    [
        Case("1280x720", 0.0, 1.0, tilted=True),
        *(Case("640x480", 0.0, h, tilted=True) for h in (0.3, 3.0, 9.0)),
    ],
)


def contact_sheet(path: Path) -> None:
    """Write it as PNG; the folder is made."""
    rows = [
        np.hstack(
            [_cell(_frame(case), f"{case.side_cm or 'pad'} {case.height_m:g} m {case.size}") for case in row]
        )
        for row in CASES
    ]
    clutter = []
    for chunk in CLUTTER_SHEET_CHUNKS:
        stage, shot, _ = clutter_shots(chunk, 1)[0]
        clutter.append(_cell(shot.frame.image, f"clutter {stage.camera.width_px}x{stage.camera.height_px}"))
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.vstack([*rows, np.hstack(clutter)]))


def _frame(case: Case) -> GreyImage:
    rng = case.rng(-1 % 2**31)
    shot = Stage(case.size, case.side_cm, rng).shoot(case.height_m, 0.17 if case.tilted else None)
    return shot.frame.image


def _cell(image: GreyImage, title: str) -> GreyImage:
    width, height = CELL_PX
    rows, columns = image.shape
    scaled = cv2.resize(image, (width, round(width * rows / columns)), interpolation=cv2.INTER_AREA)
    cell = np.full((2 * height, width), 128, np.uint8)
    cell[: min(height, scaled.shape[0])] = scaled[:height]
    top, left = (rows - height) // 2, (columns - width) // 2
    cell[height:] = image[top : top + height, left : left + width]
    cv2.putText(cell, title, (4, height - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255,), 3)
    cv2.putText(cell, title, (4, height - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0,), 1)
    return cell
