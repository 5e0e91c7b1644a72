"""The shape that a printed board really has: what the calibration solves for beside the camera. Pure.

No board is flat. One of A4 that is bowed by half a millimetre makes the focal length wrong by 0.5 %, in the
same way in every view, so that nothing in the residuals tells. Its bend is therefore solved for: depth
z = b0 (1 - u²) + b1 (1 - v²) + b2 u v with u, v from -1 to 1 across the board, b in metres.

The markers of a grid are never as large as specified: ink runs, light bleeds into black, the gap
was measured with a ruler. How much larger each is about its own middle is solved for as well (`spread`, a
share of its side; the middles stay where they are). Where four squares meet, nothing of the kind can happen.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray

BEND_COUNT: Final = 3


@dataclass(frozen=True, slots=True)
class Surface:
    """A pattern's size (m), the side and pitch of a grid's markers (m), and how it differs from that.

    `numbers` are the bend's three (m), and for a grid the spread.
    """

    size_m: tuple[float, float]
    marker_m: tuple[float, float] | None = None  # side, and from one marker to the next
    numbers: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not len(self.numbers):
            object.__setattr__(self, "numbers", np.zeros(self.count))

    @property
    def count(self) -> int:
        """How many numbers describe it."""
        return BEND_COUNT + (self.marker_m is not None)

    def flat(self) -> Surface:
        """The board as specified."""
        return replace(self, numbers=np.zeros(self.count))

    def stepped(self, step: FloatArray) -> Surface:
        """The surface after a step (count,) of its numbers."""
        return replace(self, numbers=self.numbers + step)

    def of(self, points_m: FloatArray) -> FloatArray:
        """Where points (n, 3) of the board as specified really are."""
        return np.asarray(points_m + self.shapes(points_m) @ self.numbers)

    def shapes(self, points_m: FloatArray) -> FloatArray:
        """How points (n, 3) move for each of the numbers being one: (n, 3, count)."""
        shapes = np.zeros((len(points_m), 3, self.count))
        u, v = (2.0 * points_m[:, k] / self.size_m[k] - 1.0 for k in (0, 1))
        shapes[:, 2, :BEND_COUNT] = _bends(u, v)
        if self.marker_m is not None:
            side, pitch = self.marker_m
            # corners lie on the ends of [k pitch, k pitch + side]: half a gap more is safely within the cell
            cell = np.floor((points_m[:, :2] + 0.5 * (pitch - side)) / pitch)
            shapes[:, :2, BEND_COUNT] = points_m[:, :2] - (cell * pitch + 0.5 * side)
        return shapes

    @property
    def bend_m(self) -> FloatArray:
        """The bend's numbers (3,)."""
        return self.numbers[:BEND_COUNT]

    @property
    def spread(self) -> float | None:
        """By what share of their side a grid's markers are larger than specified; None on other boards."""
        return None if self.marker_m is None else float(self.numbers[BEND_COUNT])

    @property
    def gap_m(self) -> float | None:
        """Between markers, if these have the side that was specified: what a ruler should have shown."""
        if self.marker_m is None or self.spread is None:
            return None
        side, pitch = self.marker_m
        return pitch / (1.0 + self.spread) - side

    @property
    def bow_m(self) -> float:
        """How far the surface is from its mean plane at most."""
        line = np.linspace(-1.0, 1.0, 9)
        u, v = (grid.ravel() for grid in np.meshgrid(line, line))
        depth = _bends(u, v) @ self.bend_m
        plane = np.column_stack((u, v, np.ones_like(u)))
        return float(np.abs(depth - plane @ np.linalg.lstsq(plane, depth, rcond=None)[0]).max())


def _bends(u: FloatArray, v: FloatArray) -> FloatArray:
    return np.column_stack((1.0 - u * u, 1.0 - v * v, u * v))
