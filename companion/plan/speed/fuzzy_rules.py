"""The rules of the fuzzy controller behind eq. 37 (Figs. 7-9), evaluated by scikit-fuzzy (Mamdani).

Inputs: distance (m) to the reference's end, closing velocity (m/s) and closing acceleration (m/s²), both
positive towards it. Output: the average speed V (m/s). A second set of rules, `pace`, gives a factor on V
by the conditions of the approach (`companion.plan.speed.conditions`).

The rules in configs/fuzzy/NAME.yaml use triangles and trapezoids, clipped output sets, their union, and its
centroid. Min-max inference is neither smooth nor monotone. Two choices make the surface both (never faster
when closer at the same speed): AND is the product, and rules with the same conclusion add up.
"""

import hashlib
import json
import warnings
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import model_validator

from companion.base.geometry import FloatArray
from companion.config import StrictModel, find_file, load_model

Corners = tuple[float, float, float] | tuple[float, float, float, float]
Terms = dict[str, Corners]

INPUTS = ("distance_m", "velocity_m_s", "acceleration_m_s2")
OUTPUT = "speed_m_s"


class RuleSet(StrictModel):
    """Membership functions of three inputs and an output, and rules.

    `rules[third][first]` lists an output for each term of the second input, from the lowest on, in whatever
    order the file has its terms.
    """

    inputs: ClassVar[tuple[str, str, str]]
    output: ClassVar[str]

    rules: dict[str, dict[str, tuple[str, ...]]]

    def terms(self, variable: str) -> Terms:
        terms: Terms = getattr(self, variable)
        return terms

    @model_validator(mode="after")
    def _corners_rise(self) -> Self:
        for variable in (*self.inputs, self.output):
            terms = self.terms(variable)
            if len(terms) < 2:
                raise ValueError(f"{variable}: expected at least two terms")
            for term, corners in terms.items():
                if list(corners) != sorted(corners) or corners[0] == corners[-1]:
                    raise ValueError(f"{variable}.{term}: expected corners that rise, found {list(corners)}")
        return self

    @model_validator(mode="after")
    def _a_rule_everywhere(self) -> Self:
        # scikit-fuzzy answers with nothing at all where no rule fires
        first, second, third = (self.terms(variable) for variable in self.inputs)
        for variable in self.inputs:
            _no_gap(variable, self.terms(variable))
        if set(self.rules) != set(third):
            raise ValueError(f"rules: expected one block for each of {', '.join(in_order(third))}")
        for block, rows in self.rules.items():
            if set(rows) != set(first):
                raise ValueError(f"rules.{block}: expected a row for each of {', '.join(in_order(first))}")
            for row, outputs in rows.items():
                if len(outputs) != len(second) or not set(outputs) <= set(self.terms(self.output)):
                    raise ValueError(
                        f"rules.{block}.{row}: expected {len(second)} of "
                        f"{', '.join(in_order(self.terms(self.output)))}, found {list(outputs)}"
                    )
        return self


class PaceRules(RuleSet):
    """How quickly to come in by the conditions: a factor on V."""

    inputs = ("sight_rad", "relative_speed_m_s", "gust_m_s2")
    output = "factor"

    sight_rad: Terms
    relative_speed_m_s: Terms
    gust_m_s2: Terms
    factor: Terms


class FuzzyRules(RuleSet):
    """The average speed V by the way to go; without `pace` it is the same in all conditions."""

    inputs = INPUTS
    output = OUTPUT

    name: str
    distance_m: Terms
    velocity_m_s: Terms
    acceleration_m_s2: Terms
    speed_m_s: Terms
    pace: PaceRules | None = None

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


def mamdani(rules: RuleSet, inputs: FloatArray) -> FloatArray:
    """Outputs (n,) at inputs (n, 3) by scikit-fuzzy; inputs beyond the outermost corners count as those."""
    from skfuzzy import control  # noqa: PLC0415 - two seconds that a flight need not spend

    first, second, third = (_variable(control.Antecedent, rules, name, 0.025) for name in rules.inputs)
    output = _variable(control.Consequent, rules, rules.output, 0.01)
    output.accumulation_method = np.add
    columns = in_order(rules.terms(rules.inputs[1]))
    cells = [
        control.Rule(first[row] & second[column] & third[block], output[out], and_func=np.multiply)
        for block, rows in rules.rules.items()
        for row, outputs in rows.items()
        for column, out in zip(columns, outputs, strict=True)
    ]
    simulation = control.ControlSystemSimulation(control.ControlSystem(cells))
    for column, name in enumerate(rules.inputs):
        simulation.input[name] = np.ascontiguousarray(inputs[:, column])
    with warnings.catch_warnings():
        # it passes np.maximum its output by position; numpy is capped below the version that removes that
        warnings.simplefilter("ignore", DeprecationWarning)
        simulation.compute()
    return np.asarray(simulation.output[rules.output], dtype=np.float64)


def _variable(kind: Any, rules: RuleSet, name: str, step: float) -> Any:
    from skfuzzy import trapmf, trimf  # noqa: PLC0415

    terms = rules.terms(name)
    corners = sorted({corner for term in terms.values() for corner in term})
    count = round((corners[-1] - corners[0]) / step) + 1
    # the corners themselves belong to the universe, else scikit-fuzzy rounds the triangles' tips
    universe = np.union1d(np.linspace(corners[0], corners[-1], count), corners)
    variable = kind(universe, name)
    for term, points in terms.items():
        variable[term] = (trimf if len(points) == 3 else trapmf)(universe, list(points))
    return variable
