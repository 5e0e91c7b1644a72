"""Whether a speed table is what its rules say, and what a pilot would do.

Distances in m, closing velocity in m/s and acceleration in m/s², positive towards the target.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray
from companion.plan.speed.fuzzy_rules import INPUTS, FuzzyRules, mamdani
from companion.plan.speed.speed_table import SpeedTable

LARGEST_ERROR: Final = 0.01
# so far beyond the grid on either side, as a share of its width
BEYOND: Final = 0.3
CHUNK: Final = 1000  # scikit-fuzzy holds every point's output sets at once
# the sign of dV / d input that a pilot's speed has: the farther the faster, and never faster when the way
# is already being closed faster, or faster and faster
PILOT: Final = {"distance_m": 1.0, "velocity_m_s": -1.0, "acceleration_m_s2": -1.0}


@dataclass(frozen=True, slots=True)
class TableError:
    """Of a table against scikit-fuzzy, relative to the speed; `worst_at` is that input (3,)."""

    worst: float
    rms: float
    points: int
    worst_at: tuple[float, float, float]

    @property
    def holds(self) -> bool:
        """Within 1 %."""
        return self.worst <= LARGEST_ERROR


def sample_points(table: SpeedTable, count: int, rng: np.random.Generator) -> FloatArray:
    """Uniform inputs (count, 3) in and beyond the grid, on every side that the inputs can reach."""
    axes = [np.array(getattr(table, name)) for name in INPUTS]
    low = np.array([axis[0] - BEYOND * (axis[-1] - axis[0]) for axis in axes])
    high = np.array([axis[-1] + BEYOND * (axis[-1] - axis[0]) for axis in axes])
    low[0] = max(low[0], 0.0)  # there is no distance below 0
    return rng.uniform(low, high, (count, 3))


def table_error(rules: FuzzyRules, table: SpeedTable, count: int, rng: np.random.Generator) -> TableError:
    """The table against scikit-fuzzy at `count` random inputs."""
    points = sample_points(table, count, rng)
    parts = np.array_split(points, max(1, count // CHUNK))
    truth = np.concatenate([mamdani(rules, part) for part in parts])
    flown = np.array([table(*point) for point in points.tolist()])
    errors = np.abs(flown - truth) / truth
    d, v, a = points[int(errors.argmax())].tolist()
    return TableError(float(errors.max()), float(np.sqrt(np.mean(errors**2))), count, (d, v, a))


def worst_slips_m_s(table: SpeedTable) -> dict[str, float]:
    """For each input the most (m/s, 0 for never) by which a step along the grid goes against the pilot."""
    speeds = np.array(table.speed_m_s)
    slips = {}
    for axis, name in enumerate(INPUTS):
        gains = PILOT[name] * np.diff(speeds, axis=axis)
        slips[name] = max(0.0, -float(gains.min()))
    return slips
