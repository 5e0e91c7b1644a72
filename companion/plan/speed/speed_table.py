"""The approach speed V of T = |Δ| / V + T_min (eq. 37) from a table of the fuzzy rules.

One evaluation by scikit-fuzzy takes milliseconds. So the rules' surface (`fuzzy_rules.mamdani`) is sampled
once into NAME.table.json beside the rules and interpolated in flight (`SpeedTable`, microseconds). The
table contains a hash of the rules. After an edit of the rules it is computed at each start, until
`companion fuzzy NAME --write-table` stores it again.

The rules of the pace, a factor on V by the conditions, are sampled and interpolated in the same way
(`PaceTable`).

Distances in m, closing velocity in m/s and acceleration in m/s², positive towards the target.
"""

import json
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from companion.base.files import write_atomically
from companion.config import ConfigError, StrictModel, find_file, load_model
from companion.plan.speed.fuzzy_rules import FuzzyRules, RuleSet, Terms, mamdani

Grid = tuple[tuple[tuple[float, ...], ...], ...]
Axes = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]

# Between two neighbouring corners of membership functions the surface bends gently: sampled at these
# fractions, linear interpolation stays within 1 % of it.
_DISTANCE_FRACTIONS = (0.0, 0.06, 0.15, 0.3, 0.5, 0.7, 0.85, 0.94)
_RATE_FRACTIONS = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9)
_SAMPLING = (_DISTANCE_FRACTIONS, _RATE_FRACTIONS)
MONOTONE_TOLERANCE_M_S = 0.005
SLOWEST_M_S = 0.05  # eq. 37 divides by it


# ---------------------------------------------------------------- what flies: the table


class PaceTable(StrictModel):
    """The factor on V by the conditions, interpolated as `SpeedTable`."""

    sight_rad: tuple[float, ...]
    relative_speed_m_s: tuple[float, ...]
    gust_m_s2: tuple[float, ...]
    factor: Grid

    def __call__(self, sight_rad: float, relative_speed_m_s: float, gust_m_s2: float) -> float:
        """The factor for how well the pad is seen, how well it is followed, and the gusts."""
        axes = (self.sight_rad, self.relative_speed_m_s, self.gust_m_s2)
        return _trilinear(axes, self.factor, (sight_rad, relative_speed_m_s, gust_m_s2))


class SpeedTable(StrictModel):
    """The surface on a grid, with trilinear interpolation; beyond the grid the nearest edge holds.

    It is stored beside its rules as it is; `fingerprint` is theirs.
    """

    fingerprint: str
    distance_m: tuple[float, ...]
    velocity_m_s: tuple[float, ...]
    acceleration_m_s2: tuple[float, ...]
    speed_m_s: Grid
    pace: PaceTable | None = None  # without it the same in all conditions

    def __call__(self, distance_m: float, velocity_m_s: float, acceleration_m_s2: float) -> float:
        """Average speed V (m/s) for a way to go, closing velocity and closing acceleration (eq. 37)."""
        axes = (self.distance_m, self.velocity_m_s, self.acceleration_m_s2)
        return _trilinear(axes, self.speed_m_s, (distance_m, velocity_m_s, acceleration_m_s2))


def _trilinear(axes: Axes, values: Grid, at: tuple[float, float, float]) -> float:
    (i, u), (j, v), (k, w) = (_cell(axis, value) for axis, value in zip(axes, at, strict=True))
    near, far = values[i], values[i + 1]
    a, b, c, d = near[j], near[j + 1], far[j], far[j + 1]
    n = 1.0 - w
    low = (a[k] * n + a[k + 1] * w) * (1.0 - v) + (b[k] * n + b[k + 1] * w) * v
    high = (c[k] * n + c[k + 1] * w) * (1.0 - v) + (d[k] * n + d[k + 1] * w) * v
    return low * (1.0 - u) + high * u


def _cell(axis: tuple[float, ...], value: float) -> tuple[int, float]:
    if value <= axis[0]:
        return 0, 0.0
    if value >= axis[-1]:
        return len(axis) - 2, 1.0
    index = bisect_right(axis, value) - 1
    return index, (value - axis[index]) / (axis[index + 1] - axis[index])


def build_table(rules: FuzzyRules) -> SpeedTable:
    """Sample scikit-fuzzy's surfaces between the outermost corners that matter (about 4 s)."""
    surface = _sampled(rules, (_DISTANCE_FRACTIONS, _RATE_FRACTIONS, _RATE_FRACTIONS))
    pace = None if rules.pace is None else PaceTable(**_sampled(rules.pace, (_RATE_FRACTIONS,) * 3))
    return SpeedTable(fingerprint=rules.fingerprint(_SAMPLING), **surface, pace=pace)


def _sampled(rules: RuleSet, fractions: Sequence[tuple[float, ...]]) -> dict[str, Any]:
    """Its axes and its outputs, by their names."""
    x, y, z = (_axis(rules.terms(name), shares) for name, shares in zip(rules.inputs, fractions, strict=True))
    points = np.stack([grid.ravel() for grid in np.meshgrid(x, y, z, indexing="ij")], axis=1)
    outputs = mamdani(rules, points).reshape(len(x), len(y), len(z))
    return {**dict(zip(rules.inputs, (x, y, z), strict=True)), rules.output: np.round(outputs, 4).tolist()}


def _axis(terms: Terms, fractions: tuple[float, ...]) -> tuple[float, ...]:
    """Sample points from the first term's last full membership to the last term's first."""
    ordered = sorted(terms.values())
    low, high = ordered[0][-2], ordered[-1][1]
    corners = sorted({corner for term in ordered for corner in term if low <= corner <= high})
    samples = [a + f * (b - a) for a, b in pairwise(corners) for f in fractions]
    return tuple(round(sample, 6) for sample in (*samples, corners[-1]))


# ---------------------------------------------------------------- the file


def load_table(name: str | Path) -> tuple[SpeedTable, Literal["stored", "computed"]]:
    """The speed table of some rules, from its file when that belongs to them, else computed.

    Raises:
        ConfigError: the rules cannot be read, break a rule, stand still, or are faster when closer.
    """
    path = find_file("fuzzy", name)
    rules = load_model(FuzzyRules, path)
    stored = _read_table(_table_path(path), rules.fingerprint(_SAMPLING))
    table = stored if stored is not None else build_table(rules)
    _flyable(table, path)
    return table, "computed" if stored is None else "stored"


def write_table(name: str | Path) -> Path:
    """Compute the table of some rules and store it beside them.

    Raises:
        ConfigError: the rules cannot be read, break a rule, stand still, are faster when closer, or the table
            cannot be written.
    """
    path = find_file("fuzzy", name)
    rules = load_model(FuzzyRules, path)
    table = build_table(rules)
    _flyable(table, path)
    target = _table_path(path)
    text = json.dumps(table.model_dump(), separators=(",", ":"))
    write_atomically(target, text.replace("]],[[", "]],\n[[") + "\n")
    return target


def _flyable(table: SpeedTable, source: Path) -> None:
    """Refuse rules that would not arrive, or would come in ever faster."""
    slowest_m_s = float(np.min(table.speed_m_s))
    if table.pace is not None and slowest_m_s > 0.0:
        slowest_m_s *= float(np.min(table.pace.factor))
    if not slowest_m_s >= SLOWEST_M_S:
        raise ConfigError(f"{source}: rules: expected at least {SLOWEST_M_S:g} m/s, found {slowest_m_s:.2f}")
    gain = np.diff(np.array(table.speed_m_s), axis=0)
    if gain.min() < -MONOTONE_TOLERANCE_M_S:
        i, j, k = (int(n) for n in np.unravel_index(gain.argmin(), gain.shape))
        raise ConfigError(
            f"{source}: rules: expected no more speed when closer; at velocity {table.velocity_m_s[j]} m/s "
            f"and acceleration {table.acceleration_m_s2[k]} m/s2, {table.distance_m[i]} m is faster than "
            f"{table.distance_m[i + 1]} m by {-gain[i, j, k]:.2f} m/s"
        )


def _table_path(rules: Path) -> Path:
    return rules.with_suffix(".table.json")


def _read_table(path: Path, fingerprint: str) -> SpeedTable | None:
    """The stored table, or None when there is none, it is damaged, or it is another rule base's."""
    try:
        stored = SpeedTable.model_validate_json(path.read_bytes())
    except (OSError, ValidationError):
        return None
    return stored if stored.fingerprint == fingerprint else None
