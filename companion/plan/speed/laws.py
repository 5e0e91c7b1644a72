"""The choice of the speed law behind T = |Δ| / V + T_min (eq. 37): `plan.speed_law`.

`fuzzy` is the paper's and the default. The two others are baselines (`python -m experiments profiles`): a
`fixed` speed, and a `log_polynomial` of the distance, the kind of profile that the paper cites of Alvika et
al. [11] without coefficients:

    V(d) = c0 + c1 L + c2 L² + c3 L³,  L = ln(1 + d / 1 m).

Its coefficients are a least-squares fit to the fuzzy speed controller at rest, over the distances that the
fuzzy table resolves. So both laws begin and end at the same speeds, and differ in the closing velocity and
acceleration, which only the fuzzy speed controller uses. m, m/s, m/s²; closing is positive towards the
target.
"""

from typing import Final, NamedTuple

import numpy as np

from companion.config import PlanConfig
from companion.plan.speed.conditions import PaceLaw, constant_pace
from companion.plan.speed.speed_table import SpeedTable, load_table
from companion.plan.trajectory.reference_generator import SpeedLaw

DEGREE: Final = 3
FITTED_POINTS: Final = 200


class LogPolynomial:
    """V over distance alone; beyond the fitted distances their ends hold."""

    def __init__(self, table: SpeedTable) -> None:
        self._low_m, self._high_m = table.distance_m[0], table.distance_m[-1]
        distances = np.linspace(self._low_m, self._high_m, FITTED_POINTS)
        speeds = [table(d, 0.0, 0.0) for d in distances.tolist()]
        self._slowest_m_s = min(speeds)
        self.coefficients: tuple[float, ...] = tuple(
            np.polynomial.polynomial.polyfit(np.log1p(distances), speeds, DEGREE).tolist()
        )

    def __call__(self, distance_m: float, _velocity_m_s: float, _acceleration_m_s2: float) -> float:
        """Average speed V (m/s) for a way to go."""
        length = float(np.log1p(min(max(distance_m, self._low_m), self._high_m)))
        speed = 0.0
        for coefficient in reversed(self.coefficients):
            speed = speed * length + coefficient
        return max(speed, self._slowest_m_s)  # a cubic may undershoot, and eq. 37 divides by it


class SpeedController(NamedTuple):
    """V by the way to go, and the factor on it by the conditions."""

    law: SpeedLaw
    pace: PaceLaw


def load_speed_controller(config: PlanConfig) -> SpeedController:
    """The law that the settings choose, and its pace; only the fuzzy speed controller knows conditions.

    Raises:
        ConfigError: it needs the fuzzy rules, and they cannot be read or break a rule.
    """
    if config.speed_law == "fixed":
        speed_m_s = config.fixed_speed_m_s
        return SpeedController(lambda _distance, _velocity, _acceleration: speed_m_s, constant_pace)
    table = load_table(config.fuzzy)[0]
    if config.speed_law == "log_polynomial":
        return SpeedController(LogPolynomial(table), constant_pace)
    return SpeedController(table, by_conditions(table) if config.pace else constant_pace)


def by_conditions(table: SpeedTable) -> PaceLaw:
    """The pace of a table; rules without one come in alike in all conditions."""
    pace = table.pace
    if pace is None:
        return constant_pace
    return lambda c: pace(c.sight_rad, c.relative_speed_m_s, c.gust_m_s2)
