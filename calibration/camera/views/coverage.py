"""What of the image and of the board's tilts has been seen, and what to show next, in words. Pure.

The image is a mesh of `COLUMNS` x `ROWS` cells; a cell counts once `PER_CELL` corners were seen in it. The
board's tilt is the angle between its normal and the line of sight along the optical axis, in four directions
named by the edge of the board, as seen in the image, that is farther away.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.views.detection import BoardView
from companion.base.geometry import FloatArray

COLUMNS: Final = 6
ROWS: Final = 4
PER_CELL: Final = 3
ENOUGH_CELLS: Final = 0.85
TILT_DEG: Final = 20.0
VIEWS_A_TILT: Final = 2
ENOUGH_VIEWS: Final = 15
# before the camera is known its focal length is taken as this many image widths (53 degrees across)
USUAL_FOCAL: Final = 1.0
TILTS: Final = ("top", "bottom", "left", "right")
CORNERS: Final = {
    "upper left": (0, 0),
    "upper right": (0, COLUMNS - 1),
    "lower left": (ROWS - 1, 0),
    "lower right": (ROWS - 1, COLUMNS - 1),
}


@dataclass(frozen=True, slots=True)
class Tilt:
    """A board's tilt: how far off square, and how much of that has its right and its lower edge away."""

    angle_deg: float
    right_away_deg: float
    bottom_away_deg: float

    @property
    def directions(self) -> tuple[str, ...]:
        """The edges that are clearly away."""
        amounts = {
            "top": -self.bottom_away_deg,
            "bottom": self.bottom_away_deg,
            "left": -self.right_away_deg,
            "right": self.right_away_deg,
        }
        return tuple(name for name in TILTS if amounts[name] >= TILT_DEG)


def tilt_of(turn: FloatArray) -> Tilt:
    """The tilt of a board with a rotation vector (3,) from the board's axes to the camera's."""
    rotation, _ = cv2.Rodrigues(turn)
    x, y, z = rotation[:, 2].tolist()
    if z < 0.0:
        x, y, z = -x, -y, -z
    angle = math.acos(min(z, 1.0))
    across = math.hypot(x, y)
    # the normal tilts to where the board comes nearer: that edge's opposite is away
    share = math.degrees(angle) / across if across > 1e-9 else 0.0
    return Tilt(math.degrees(angle), -x * share, -y * share)


def rough_turn(view: BoardView, size_px: tuple[int, int]) -> FloatArray:
    """The board's rotation vector (3,) with a camera of the usual angle: good enough to tell a tilt."""
    focal = USUAL_FOCAL * max(size_px)
    matrix = np.array([[focal, 0.0, 0.5 * size_px[0]], [0.0, focal, 0.5 * size_px[1]], [0.0, 0.0, 1.0]])
    corners = view.corners_px.reshape(-1, 1, 2)
    _, turn, _ = cv2.solvePnP(view.points_m, corners, matrix, np.zeros(5), flags=cv2.SOLVEPNP_IPPE)
    return np.asarray(turn, dtype=np.float64).ravel()


class ImageCoverage:
    """What has been seen so far."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.size_px = size_px
        self.corner_count: NDArray[np.int64] = np.zeros((ROWS, COLUMNS), dtype=np.int64)
        self.tilts: list[Tilt] = []

    @classmethod
    def of(
        cls, views: Iterable[BoardView], turns: Sequence[FloatArray], size_px: tuple[int, int]
    ) -> ImageCoverage:
        """Of views with known rotation vectors."""
        made = cls(size_px)
        for view, turn in zip(views, turns, strict=True):
            made.add(view, turn)
        return made

    def add(self, view: BoardView, turn: FloatArray | None = None) -> None:
        """Take in a view; without its rotation vector that is worked out roughly."""
        np.add.at(self.corner_count, self._cells(view), 1)
        self.tilts.append(tilt_of(rough_turn(view, self.size_px) if turn is None else turn))

    def brings_something(self, view: BoardView) -> bool:
        """Whether a view shows what is still missing: cells, or a tilt."""
        if (self.corner_count[self._cells(view)] < PER_CELL).any():
            return True
        directions = tilt_of(rough_turn(view, self.size_px)).directions
        return any(self.tilt_count(name) < VIEWS_A_TILT for name in directions)

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Which cells (rows, columns) have been seen."""
        return np.asarray(self.corner_count >= PER_CELL)

    @property
    def share(self) -> float:
        """Of the image's cells that have been seen."""
        return float(self.covered.mean())

    @property
    def largest_tilt_deg(self) -> float:
        """Of all views."""
        return max((tilt.angle_deg for tilt in self.tilts), default=0.0)

    @property
    def missing_corners(self) -> list[str]:
        """The corners of the image where the board has not been enough."""
        return [name for name, cell in CORNERS.items() if not self.covered[cell]]

    @property
    def unseen_corners(self) -> list[str]:
        """The corners of the image where not one corner of a board has been."""
        return [name for name, cell in CORNERS.items() if not self.corner_count[cell]]

    @property
    def missing_tilts(self) -> list[str]:
        """The edges that have not been away often enough."""
        return [name for name in TILTS if self.tilt_count(name) < VIEWS_A_TILT]

    def tilt_count(self, direction: str) -> int:
        """How many views had that edge away."""
        return sum(direction in tilt.directions for tilt in self.tilts)

    @property
    def complete(self) -> bool:
        """Whether nothing is missing."""
        return not self.hints()

    def hints(self) -> list[str]:
        """What to do next, the most useful first; empty when all has been seen."""
        hints = [f"show it at the {name} of the image" for name in self.missing_corners]
        if not hints and self.share < ENOUGH_CELLS:
            hints.append(f"show it {self._emptiest()}")
        hints += [f"tilt its {name} edge away from the camera" for name in self.missing_tilts]
        if not hints and len(self.tilts) < ENOUGH_VIEWS:
            hints.append("show it from nearer, from farther off, and turned")
        return hints

    def _cells(self, view: BoardView) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The cell (rows, columns) of each corner."""
        places = view.corners_px * (COLUMNS, ROWS) / np.array(self.size_px)
        column, row = np.floor(places).astype(np.int64).T
        return row.clip(0, ROWS - 1), column.clip(0, COLUMNS - 1)

    def _emptiest(self) -> str:
        """Where most of what is missing lies, in words."""
        row, column = np.argwhere(~self.covered).mean(axis=0)
        down, right = (row + 0.5) / ROWS - 0.5, (column + 0.5) / COLUMNS - 0.5
        if max(abs(down), abs(right)) < 0.15:
            return "in the middle of the image"
        if abs(down) > abs(right):
            return f"near the {'lower' if down > 0 else 'upper'} edge of the image"
        return f"near the {'right' if right > 0 else 'left'} edge of the image"
