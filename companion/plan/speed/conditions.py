"""The conditions of an approach, which are the inputs of the fuzzy speed controller's pace.

They are three numbers: how well the pad is seen, how well it is followed, and how strong the gusts are. The
planned part of the speed over the pad is subtracted, since the closing velocity is an input of V already.
NED, SI units.
"""

import math
from collections.abc import Callable
from typing import Final

from companion.base.geometry import Vector3
from companion.base.messages import Conditions, PadState, VehicleState
from companion.plan.debounce import StepClock
from companion.plan.inputs import LONGEST_CYCLE_S

# A gust lasts for seconds; over this time the wind's force is averaged, and its spread about that.
GUST_OVER_S: Final = 2.0
RELATIVE_SPEED_OVER_S: Final = 0.5

PaceLaw = Callable[[Conditions], float]


def constant_pace(_conditions: Conditions) -> float:
    """The pace of those that know no conditions."""
    return 1.0


class ConditionMonitor:
    def __init__(self) -> None:
        # complex: north + i east
        self._force_m_s2, self._gust_squared = 0j, 0.0
        self._relative_m_s = 0.0
        self._clock = StepClock()

    def update(
        self, sight: PadState | None, vehicle: VehicleState | None, planned_m_s: Vector3 | None, now_s: float
    ) -> Conditions | None:
        """The conditions, None without a pad; `planned_m_s` is the velocity planned over it, if one is."""
        elapsed_s = self._clock.step_s(now_s)
        if math.isfinite(elapsed_s):
            elapsed_s = min(LONGEST_CYCLE_S, elapsed_s)
        if vehicle is not None:
            self._feel(complex(*vehicle.side_force_ned_m_s2[:2]), _share(elapsed_s, GUST_OVER_S))
        if sight is None:
            return None
        if planned_m_s is not None:
            vx, vy, _ = sight.relative_velocity_ned_m_s
            off_m_s = math.hypot(vx + planned_m_s[0], vy + planned_m_s[1])
            self._relative_m_s += _share(elapsed_s, RELATIVE_SPEED_OVER_S) * (off_m_s - self._relative_m_s)
        sight_rad = math.atan2(sight.position_std_m, math.hypot(*sight.relative_position_ned_m))
        return Conditions(sight_rad, self._relative_m_s, math.sqrt(self._gust_squared))

    def _feel(self, force_m_s2: complex, share: float) -> None:
        """Mean and variance with exponentially falling weights."""
        off = force_m_s2 - self._force_m_s2
        self._force_m_s2 += share * off
        self._gust_squared = (1.0 - share) * (self._gust_squared + share * abs(off) ** 2)


def _share(elapsed_s: float, over_s: float) -> float:
    return -math.expm1(-elapsed_s / over_s)
