"""How surely a marker that is wholly in view is read: P_i of P_ND = prod(1 - P_i) (section 2.2).

What counts is the cell of the code: how many pixels wide its image is, and what blur leaves of it. The
probability is a constant times two logistic curves in logarithms, one of the cell's width and one of the
blur's share of it. Blur is one standard deviation: of the lens and its focus as a Gauss bell, of motion as a
stroke (its length over sqrt(12)). The numbers are fitted, not assumed: `python -m experiments pad-recall`
shows single markers to vision through the simulated camera, and prints them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class RecallModel:
    """The two curves: where each is at one half, and how steep it is there (in logarithms)."""

    cell_px: float  # width of a cell that is read half of the time, when sharp
    cell_steepness: float
    blur_cells: float  # blur, in widths of a cell, at which a large one is read half of the time
    blur_steepness: float
    most: float  # of markers that are large and sharp

    def __call__(self, cell_px: FloatArray, blur_px: FloatArray | float) -> FloatArray:
        """Probability (...) that a marker wholly in view is read, by its cell's width and the blur (px)."""
        large = _logistic(self.cell_steepness * np.log(cell_px / self.cell_px))
        sharp = _logistic(self.blur_steepness * np.log(self.blur_cells * cell_px / blur_px))
        return np.asarray(self.most * large * sharp)


@dataclass(frozen=True, slots=True)
class Optics:
    """What blurs an image; by default a small f/2 lens of 3 mm, as a Raspberry Pi's."""

    lens_blur_px: float = 0.45  # standard deviation, in focus
    aperture_m: float = 0.0015
    focus_m: float = 1.5

    def blur_px(self, focal_px: float, distance_m: float, stroke_px: float) -> float:
        """Standard deviation of lens, focus and motion together.

        That of focus is a quarter of the circle of confusion's diameter.
        """
        circle_px = focal_px * self.aperture_m * abs(1.0 / distance_m - 1.0 / self.focus_m)
        return math.hypot(self.lens_blur_px, 0.25 * circle_px, stroke_px / math.sqrt(12.0))


def _logistic(x: FloatArray) -> FloatArray:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0))))


# `python -m experiments pad-recall` with its defaults
FITTED: Final = RecallModel(2.151, 15.59, 0.4071, 7.009, 0.9943)
