"""The rules of the fuzzy controller behind eq. 37 (Figs. 7-9), and what they mean: Mamdani's by scikit-fuzzy.

Inputs: distance (m) to where the reference is going, closing velocity (m/s) and closing acceleration
(m/s²), both positive towards it. Output: the average speed V (m/s) for the way.

The rules in configs/fuzzy/NAME.yaml are triangles and trapezoids, clipped output sets, their union, its
centroid. Two choices make the surface smooth and monotone (never faster when closer at the same speed),
which min-max inference is not: AND is the product, and rules with the same conclusion add up.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import model_validator

from companion.base.geometry import FloatArray
from companion.config import StrictModel, find_file, load_model

Corners = tuple[float, float, float] | tuple[float, float, float, float]
Terms = dict[str, Corners]

INPUTS = ("distance_m", "velocity_m_s", "acceleration_m_s2")
OUTPUT = "speed_m_s"


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
                f"rules: expected one block for each of {', '.join(in_order(self.acceleration_m_s2))}"
            )
        for acceleration, rows in self.rules.items():
            if set(rows) != set(self.distance_m):
                expected = ", ".join(in_order(self.distance_m))
                raise ValueError(f"rules.{acceleration}: expected a row for each of {expected}")
            for distance, speeds in rows.items():
                if len(speeds) != len(self.velocity_m_s) or not set(speeds) <= set(self.speed_m_s):
                    raise ValueError(
                        f"rules.{acceleration}.{distance}: expected {len(self.velocity_m_s)} of "
                        f"{', '.join(in_order(self.speed_m_s))}, found {list(speeds)}"
                    )
        return self

    def fingerprint(self, sampling: Sequence[object]) -> str:
        """Hash of everything that shapes the surface, and of how a table samples it."""
        parts = [self.model_dump(mode="json", exclude={"name"}), *sampling]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def in_order(terms: Terms) -> list[str]:
    """Names of the terms, the lowest first."""
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


# ---------------------------------------------------------------- what they mean


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
        for v, s in zip(in_order(rules.velocity_m_s), speeds, strict=True)
    ]
    simulation = control.ControlSystemSimulation(control.ControlSystem(cells))
    for column, name in enumerate(INPUTS):
        simulation.input[name] = np.ascontiguousarray(inputs[:, column])
    with warnings.catch_warnings():
        # it passes np.maximum its output by position; numpy is capped below the version that removes that
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
