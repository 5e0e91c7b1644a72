"""The covered sphere as a map: characters for a terminal, an image for a file or a browser.

Two discs, equal areas (Lambert's azimuthal projection): left the half of the field's directions that point
to the vehicle's belly, right those to its top, nose up in both, both as seen from above.
"""

from __future__ import annotations

import math
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.magnetometer.collect.guidance import CoverageProgress
from calibration.magnetometer.ellipsoid.coverage import BoolArray, cells_of
from companion.base.geometry import FloatArray

_DISC_PX: Final = 300
_MARGIN_PX: Final = 30
_TEXT_PX: Final = 70
_BACK, _COVERED, _MISSING = (34, 34, 34), (90, 170, 60), (60, 60, 150)
_INK, _NOW = (230, 230, 230), (0, 220, 255)
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_ROWS: Final = 11


def _cells_by_pixel(width: int, height: int, sign: float) -> NDArray[np.int64]:
    """The cell under each place of a disc (height, width), -1 outside; z of the field is of this sign."""
    right = (np.arange(width) + 0.5) / width * 2.0 - 1.0
    forward = 1.0 - (np.arange(height) + 0.5) / height * 2.0
    y, x = np.meshgrid(right, forward)
    square = x * x + y * y
    stretch = np.sqrt(np.maximum(2.0 - square, 0.0))
    directions = np.stack([x * stretch, y * stretch, sign * (1.0 - square)], axis=-1)
    cells: NDArray[np.int64] = cells_of(directions.reshape(-1, 3)).reshape(height, width)
    cells[square > 1.0] = -1
    return cells


def text_map(covered: BoolArray) -> list[str]:
    """Lines of characters: # covered, . missing."""
    discs = [_cells_by_pixel(2 * _ROWS, _ROWS, sign) for sign in (1.0, -1.0)]
    lines = [f"{'to the belly':^{2 * _ROWS}}   {'to the top':^{2 * _ROWS}}"]
    lines += [
        "   ".join("".join(_character(cell, covered) for cell in row) for row in rows)
        for rows in zip(*discs, strict=True)
    ]
    return lines


def _character(cell: int, covered: BoolArray) -> str:
    if cell < 0:
        return " "
    return "#" if covered[cell] else "."


def picture(now: CoverageProgress) -> NDArray[np.uint8]:
    """The map as an image, blue, green, red."""
    side = _DISC_PX + 2 * _MARGIN_PX
    image: Any = np.full((side + _TEXT_PX, 2 * side, 3), _BACK, dtype=np.uint8)
    for k, (sign, title) in enumerate(((1.0, "field to the belly"), (-1.0, "field to the top"))):
        cells = _cells_by_pixel(_DISC_PX, _DISC_PX, sign)
        disc = image[_MARGIN_PX : _MARGIN_PX + _DISC_PX, k * side + _MARGIN_PX :][:, :_DISC_PX]
        disc[cells >= 0] = np.where(now.covered[cells[cells >= 0], None], _COVERED, _MISSING)
        _write(image, title, k * side + _MARGIN_PX, 20)
        _write(image, "nose", k * side + side // 2 - 18, _MARGIN_PX + 16)
        if now.direction is not None and sign * now.direction[2] >= 0.0:
            cv2.circle(image, _place(now.direction, k * side), 8, _NOW, 2, cv2.LINE_AA)
    _write(image, f"{now.share:.0%} covered, {now.samples} samples", _MARGIN_PX, side + 15)
    _write(image, now.hint.replace("°", " deg"), _MARGIN_PX, side + 45)
    return np.asarray(image, dtype=np.uint8)


def _place(direction: FloatArray, left: int) -> tuple[int, int]:
    """The pixel of a unit vector on its disc."""
    x, y, z = direction.tolist()
    radius = math.sqrt(max(1.0 - abs(z), 0.0))
    across = max(math.hypot(x, y), 1e-9)
    middle = _MARGIN_PX + 0.5 * _DISC_PX
    half = 0.5 * _DISC_PX * radius / across
    return round(left + middle + half * y), round(middle - half * x)


def _write(image: Any, text: str, x: int, y: int) -> None:
    cv2.putText(image, text, (x, y), _FONT, 0.5, _INK, 1, cv2.LINE_AA)
