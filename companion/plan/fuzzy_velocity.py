"""How fast to come in: the fuzzy controller behind T = |Δ| / V + T_min (eq. 37, Figs. 7-9).

Inputs: distance (m) to where the reference is going, closing velocity (m/s) and closing acceleration
(m/s²), both positive towards it. Output: the average speed V (m/s) for the way.

The rules in configs/fuzzy/NAME.yaml are Mamdani's, and scikit-fuzzy is their definition: triangles and
trapezoids, clipped output sets, their union, its centroid. Two choices make the surface smooth and
monotone (never faster when closer at the same speed), which min-max inference is not: AND is the product,
and rules with the same conclusion add up.

One compute of scikit-fuzzy takes milliseconds, so its surface is sampled once into NAME.table.json beside
the rules and interpolated in flight (`SpeedTable`, microseconds). The table carries a hash of the rules;
when they have been edited since, it is computed afresh at the start, and
`python -m companion.plan.fuzzy_velocity NAME` writes it again.
"""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError, model_validator

from companion.config import ConfigError, StrictModel, find_file, load_model
from companion.geometry import FloatArray

Corners = tuple[float, float, float] | tuple[float, float, float, float]
Terms = dict[str, Corners]
Grid = tuple[tuple[tuple[float, ...], ...], ...]

INPUTS = ("distance_m", "velocity_m_s", "acceleration_m_s2")
OUTPUT = "speed_m_s"
# Between two neighbouring corners of membership functions the surface bends gently: sampled at these
# fractions, linear interpolation stays within 1 % of it.
_DISTANCE_FRACTIONS = (0.0, 0.06, 0.15, 0.3, 0.5, 0.7, 0.85, 0.94)
_RATE_FRACTIONS = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9)
_MONOTONE_TOLERANCE_M_S = 0.005


class FuzzyRules(StrictModel):
    """Membership functions and rules.

    `rules[acceleration][distance]` lists a speed for each velocity, from the most negative on, in whatever
    order the file has its terms.
    """

    name: str
    distance_m: Terms
    velocity_m_s: Terms
    acceleration_m_s2: Terms
    speed_m_s: Terms
    rules: dict[str, dict[str, tuple[str, ...]]]

    @model_validator(mode="after")
    def _corners_rise(self) -> FuzzyRules:
        for variable in (*INPUTS, OUTPUT):
            terms: Terms = getattr(self, variable)
            if len(terms) < 2:
                raise ValueError(f"{variable}: expected at least two terms")
            for term, corners in terms.items():
                if list(corners) != sorted(corners) or corners[0] == corners[-1]:
                    raise ValueError(f"{variable}.{term}: expected corners that rise, found {list(corners)}")
        return self

    @model_validator(mode="after")
    def _a_rule_everywhere(self) -> FuzzyRules:
        # scikit-fuzzy answers with nothing at all where no rule fires
        for variable in INPUTS:
            _no_gap(variable, getattr(self, variable))
        if set(self.rules) != set(self.acceleration_m_s2):
            raise ValueError(
                f"rules: expected one block for each of {', '.join(_in_order(self.acceleration_m_s2))}"
            )
        for acceleration, rows in self.rules.items():
            if set(rows) != set(self.distance_m):
                distances = ", ".join(_in_order(self.distance_m))
                raise ValueError(f"rules.{acceleration}: expected a row for each of {distances}")
            for distance, speeds in rows.items():
                if len(speeds) != len(self.velocity_m_s) or not set(speeds) <= set(self.speed_m_s):
                    raise ValueError(
                        f"rules.{acceleration}.{distance}: expected {len(self.velocity_m_s)} of "
                        f"{', '.join(_in_order(self.speed_m_s))}, found {list(speeds)}"
                    )
        return self

    def fingerprint(self) -> str:
        """Hash of everything that shapes the surface."""
        parts = [self.model_dump(mode="json", exclude={"name"}), _DISTANCE_FRACTIONS, _RATE_FRACTIONS]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _in_order(terms: Terms) -> list[str]:
    return sorted(terms, key=lambda term: terms[term])


def _no_gap(variable: str, terms: Terms) -> None:
    ordered = sorted(terms.values())
    for left, right in pairwise(ordered):
        if right[0] >= left[-1]:
            raise ValueError(f"{variable}: no term covers {left[-1]} to {right[0]}")


def load_rules(name: str | Path) -> FuzzyRules:
    """Read rules by name (from configs/fuzzy) or path.

    Raises:
        ConfigError: the file is missing, not YAML, or breaks a rule.
    """
    return load_model(FuzzyRules, find_file("fuzzy", name))


# ---------------------------------------------------------------- the definition: scikit-fuzzy


def mamdani(rules: FuzzyRules, inputs: FloatArray) -> FloatArray:
    """Speeds (m/s) at inputs (n, 3) by scikit-fuzzy; inputs beyond the outermost corners count as those."""
    from skfuzzy import control  # noqa: PLC0415 - two seconds that a flight need not spend

    distance, velocity, acceleration = (_variable(control.Antecedent, rules, name, 0.025) for name in INPUTS)
    speed = _variable(control.Consequent, rules, OUTPUT, 0.01)
    speed.accumulation_method = np.add
    cells = [
        control.Rule(distance[d] & velocity[v] & acceleration[a], speed[s], and_func=np.multiply)
        for a, rows in rules.rules.items()
        for d, speeds in rows.items()
        for v, s in zip(_in_order(rules.velocity_m_s), speeds, strict=True)
    ]
    simulation = control.ControlSystemSimulation(control.ControlSystem(cells))
    for column, name in enumerate(INPUTS):
        simulation.input[name] = np.ascontiguousarray(inputs[:, column])
    with warnings.catch_warnings():
        # scikit-fuzzy 0.5 passes np.maximum its output by position; numpy is capped below its removal
        warnings.simplefilter("ignore", DeprecationWarning)
        simulation.compute()
    return np.asarray(simulation.output[OUTPUT], dtype=np.float64)


def _variable(kind: Any, rules: FuzzyRules, name: str, step: float) -> Any:
    from skfuzzy import trapmf, trimf  # noqa: PLC0415

    terms: Terms = getattr(rules, name)
    corners = sorted({corner for term in terms.values() for corner in term})
    count = round((corners[-1] - corners[0]) / step) + 1
    # the corners themselves belong to the universe, else scikit-fuzzy rounds the triangles' tips
    universe = np.union1d(np.linspace(corners[0], corners[-1], count), corners)
    variable = kind(universe, name)
    for term, points in terms.items():
        variable[term] = (trimf if len(points) == 3 else trapmf)(universe, list(points))
    return variable


# ---------------------------------------------------------------- what flies: the table


@dataclass(frozen=True, slots=True)
class SpeedTable:
    """The surface on a grid, with trilinear interpolation; beyond the grid the nearest edge holds."""

    distance_m: tuple[float, ...]
    velocity_m_s: tuple[float, ...]
    acceleration_m_s2: tuple[float, ...]
    speed_m_s: Grid

    def __call__(self, distance_m: float, velocity_m_s: float, acceleration_m_s2: float) -> float:
        """Average speed V (m/s) for a way to go, closing velocity and closing acceleration (eq. 37)."""
        i, u = _cell(self.distance_m, distance_m)
        j, v = _cell(self.velocity_m_s, velocity_m_s)
        k, w = _cell(self.acceleration_m_s2, acceleration_m_s2)
        near, far = self.speed_m_s[i], self.speed_m_s[i + 1]
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
    """Sample scikit-fuzzy's surface between the outermost corners that matter (about 3 s)."""
    axes = (
        _axis(rules.distance_m, _DISTANCE_FRACTIONS),
        _axis(rules.velocity_m_s, _RATE_FRACTIONS),
        _axis(rules.acceleration_m_s2, _RATE_FRACTIONS),
    )
    points = np.stack([grid.ravel() for grid in np.meshgrid(*axes, indexing="ij")], axis=1)
    speeds = mamdani(rules, points).reshape([len(axis) for axis in axes])
    return SpeedTable(*axes, speed_m_s=_as_grid(np.round(speeds, 4).tolist()))


def _axis(terms: Terms, fractions: tuple[float, ...]) -> tuple[float, ...]:
    """Sample points from the first term's last full membership to the last term's first."""
    ordered = sorted(terms.values())
    low, high = ordered[0][-2], ordered[-1][1]
    corners = sorted({corner for term in ordered for corner in term if low <= corner <= high})
    samples = [a + f * (b - a) for a, b in pairwise(corners) for f in fractions]
    return tuple(round(sample, 6) for sample in (*samples, corners[-1]))


def _as_grid(values: list[list[list[float]]]) -> Grid:
    return tuple(tuple(tuple(row) for row in plane) for plane in values)


# ---------------------------------------------------------------- the file


class TableFile(StrictModel):
    """The table as stored beside its rules."""

    fingerprint: str
    distance_m: tuple[float, ...]
    velocity_m_s: tuple[float, ...]
    acceleration_m_s2: tuple[float, ...]
    speed_m_s: Grid


def load_table(name: str | Path) -> tuple[SpeedTable, Literal["stored", "computed"]]:
    """The speed table of some rules, from its file when that belongs to them, else computed.

    Raises:
        ConfigError: the rules cannot be read, break a rule, or are faster when closer.
    """
    path = find_file("fuzzy", name)
    rules = load_model(FuzzyRules, path)
    stored = _read_table(_table_path(path), rules.fingerprint())
    table = stored if stored is not None else build_table(rules)
    _never_faster_when_closer(table, path)
    return table, "computed" if stored is None else "stored"


def write_table(name: str | Path) -> Path:
    """Compute the table of some rules and store it beside them.

    Raises:
        ConfigError: the rules cannot be read, break a rule, are faster when closer, or the table cannot be
            written.
    """
    path = find_file("fuzzy", name)
    rules = load_model(FuzzyRules, path)
    table = build_table(rules)
    _never_faster_when_closer(table, path)
    rows = {axis: getattr(table, axis) for axis in (*INPUTS, OUTPUT)}
    target = _table_path(path)
    text = json.dumps({"fingerprint": rules.fingerprint(), **rows}, separators=(",", ":"))
    try:
        scratch = target.with_suffix(".part")
        scratch.write_text(text.replace("]],[[", "]],\n[[") + "\n", encoding="utf-8")
        scratch.replace(target)
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror}") from error
    return target


def _never_faster_when_closer(table: SpeedTable, source: Path) -> None:
    gain = np.diff(np.array(table.speed_m_s), axis=0)
    if gain.min() < -_MONOTONE_TOLERANCE_M_S:
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
        stored = TableFile.model_validate_json(path.read_bytes())
    except (OSError, ValidationError):
        return None
    if stored.fingerprint != fingerprint:
        return None
    return SpeedTable(stored.distance_m, stored.velocity_m_s, stored.acceleration_m_s2, stored.speed_m_s)


if __name__ == "__main__":
    try:
        print(write_table(sys.argv[1] if len(sys.argv) > 1 else "landing"))
    except ConfigError as problem:
        sys.exit(str(problem))
