"""Which directions of the field the samples cover, which are missing, and how to turn the vehicle there.

The sphere is cut into cells of equal area about the points of a Fibonacci lattice; a cell is covered when a
sample lies in it. Directions are those of the calibrated field in the sensor's axes.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray

BoolArray = NDArray[np.bool_]

CELLS: Final = 100
WHOLE: Final = 0.80  # of the cells: no hole is left that is worth a turn


def lattice(count: int) -> FloatArray:
    """Unit vectors (count, 3), spread evenly (the golden angle from one to the next)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    longitude = math.pi * (1.0 + math.sqrt(5.0)) * k
    radius = np.sqrt(1.0 - z * z)
    points: FloatArray = np.stack([radius * np.cos(longitude), radius * np.sin(longitude), z], axis=1)
    return points


_CENTRES: Final = lattice(CELLS)


def cells_of(directions: FloatArray) -> NDArray[np.intp]:
    """The cell of each unit vector (n, 3)."""
    cells: NDArray[np.intp] = np.argmax(directions @ _CENTRES.T, axis=1)
    return cells


def covered_cells(directions: FloatArray) -> BoolArray:
    """Mask (CELLS,) of the cells that unit vectors (n, 3) lie in."""
    covered = np.zeros(CELLS, dtype=bool)
    covered[cells_of(directions)] = True
    return covered


def covered_share(directions: FloatArray) -> float:
    """Share of the sphere that unit vectors (n, 3) cover, 0 to 1."""
    return float(covered_cells(directions).mean()) if len(directions) else 0.0
