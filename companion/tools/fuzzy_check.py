"""Checks that a speed table agrees with its rules and is monotone as a pilot's speed would be.

Distances in m, closing velocity in m/s and acceleration in m/s², positive towards the target; sight in rad,
relative speed in m/s, gusts in m/s².
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray
from companion.plan.speed.fuzzy_rules import RuleSet, mamdani
from companion.plan.speed.speed_table import PaceTable, SpeedTable

LARGEST_ERROR: Final = 0.01
# so far beyond the grid on either side, as a share of its width
BEYOND: Final = 0.3
CHUNK: Final = 1000  # scikit-fuzzy holds every point's output sets at once
# the sign of d output / d input that a pilot's speed has: the farther the faster, and never faster when the
# way is already being closed faster, or faster and faster, nor where less is seen, followed or calm
PILOT: Final = {
    "distance_m": 1.0,
    "velocity_m_s": -1.0,
    "acceleration_m_s2": -1.0,
    "sight_rad": -1.0,
    "relative_speed_m_s": -1.0,
    "gust_m_s2": -1.0,
}
# these are never below 0
SIZES: Final = frozenset({"distance_m", "sight_rad", "relative_speed_m_s", "gust_m_s2"})

AnyTable = SpeedTable | PaceTable


@dataclass(frozen=True, slots=True)
class TableError:
    """Of a table against scikit-fuzzy, relative to the output; `worst_at` is that input (3,)."""

    worst: float
    rms: float
    points: int
    worst_at: tuple[float, float, float]

    @property
    def holds(self) -> bool:
        """Within 1 %."""
        return self.worst <= LARGEST_ERROR


def sample_points(rules: RuleSet, table: AnyTable, count: int, rng: np.random.Generator) -> FloatArray:
    """Uniform inputs (count, 3) in and beyond the grid, on every side that the inputs can reach."""
    axes = [np.array(getattr(table, name)) for name in rules.inputs]
    low = np.array([axis[0] - BEYOND * (axis[-1] - axis[0]) for axis in axes])
    high = np.array([axis[-1] + BEYOND * (axis[-1] - axis[0]) for axis in axes])
    sizes = np.array([name in SIZES for name in rules.inputs])
    return rng.uniform(np.where(sizes, np.maximum(low, 0.0), low), high, (count, 3))


def table_error(rules: RuleSet, table: AnyTable, count: int, rng: np.random.Generator) -> TableError:
    """The table against scikit-fuzzy at `count` random inputs."""
    points = sample_points(rules, table, count, rng)
    parts = np.array_split(points, max(1, count // CHUNK))
    truth = np.concatenate([mamdani(rules, part) for part in parts])
    flown = np.array([table(*point) for point in points.tolist()])
    errors = np.abs(flown - truth) / truth
    x, y, z = points[int(errors.argmax())].tolist()
    return TableError(float(errors.max()), float(np.sqrt(np.mean(errors**2))), count, (x, y, z))


def worst_slips(rules: RuleSet, table: AnyTable) -> dict[str, float]:
    """For each input the most (of the output, 0 for never) by which a step goes against the pilot."""
    outputs = np.array(getattr(table, rules.output))
    slips = {}
    for axis, name in enumerate(rules.inputs):
        gains = PILOT[name] * np.diff(outputs, axis=axis)
        slips[name] = max(0.0, -float(gains.min()))
    return slips
