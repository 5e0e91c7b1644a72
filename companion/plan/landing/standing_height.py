"""The leg height's second source: what echo and pad measure while the vehicle stands, before take-off.

Heights are of the vehicle's reference point over what its feet stand on. m, s, rad.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median, stdev
from typing import Final

from companion.base.geometry import norm, tilt_from_quat
from companion.base.messages import Quantity, SourceComparison, VehicleState
from companion.config import VehicleConfig
from companion.plan.debounce import Debounce
from companion.plan.inputs import PlanInputs
from companion.plan.landing.contact import UNSEEN_S, echo_height_m, imu_fresh

# So still for so long it is not in somebody's hands; further aslant an echo is not from below.
_STILL_S: Final = 2.0
_STILL_M_S2: Final = 0.3
_STILL_RAD_S: Final = 0.05
_LEVEL_RAD: Final = math.radians(10.0)
_COUNT: Final = 10  # echoes, and sightings, that have to agree
_ECHO_NOISE_M: Final = 0.01  # of one that comes from near
# What a builder measures by a ruler, and grass below a rangefinder: 3 cm each; a pad has none.
_TOLD_STD_M: Final = 0.03
_BELOW_STD_M: Final = {"the rangefinder": 0.03, "the pad": 0.01}
_MEDIAN_STD: Final = math.sqrt(0.5 * math.pi / _COUNT)  # of the median of so many, in theirs


class StandingHeight:
    """`update` every cycle, from the app's start on; what it has learnt outlives a mission."""

    def __init__(self, vehicle: VehicleConfig) -> None:
        self._vehicle = vehicle
        self._held = Debounce()
        # by their source: when the newest was measured, and the last heights in a row
        self._newest_s = dict.fromkeys(_BELOW_STD_M, -math.inf)
        self._recent_m: dict[str, deque[float]] = {source: deque(maxlen=_COUNT) for source in _BELOW_STD_M}
        self.measured_m: dict[str, tuple[float, float]] = {}  # by its source, with the standard deviation
        self._measured_s = -math.inf

    def update(self, inputs: PlanInputs, now_s: float) -> None:
        """Take in a cycle's echo and estimates; flying says nothing."""
        vehicle = inputs.vehicle
        still = inputs.autopilot.connected and not inputs.autopilot.armed and _still(vehicle, now_s)
        still_s = self._held.held_s("still", still, now_s)
        if not still:
            for recent_m in self._recent_m.values():
                recent_m.clear()
            return
        if still_s >= _STILL_S and self._measured_s < now_s - still_s:
            self.measured_m.clear()  # it stood elsewhere: on a bench, say
        echo, sight = inputs.range, inputs.pad
        echo_m = echo_height_m(echo, self._vehicle, now_s)
        if echo is not None and echo_m is not None:
            self._learn("the rangefinder", echo.time_s, echo_m, still_s, now_s)
        stands_on_m = self._vehicle.foot_reach_m
        if sight is not None and sight.unseen_s <= UNSEEN_S and sight.lateral_m <= stands_on_m:
            self._learn("the pad", sight.seen_time_s, sight.height_m, still_s, now_s)

    @property
    def vehicle(self) -> VehicleConfig:
        """The vehicle with the leg height of file and measurements together, by their variances."""
        leg_m = sum(m * weight for m, weight in self._weighted()) * self.std_m**2
        return self._vehicle.model_copy(update={"leg_height_m": leg_m})

    @property
    def std_m(self) -> float:
        return 1.0 / math.sqrt(sum(weight for _, weight in self._weighted()))

    def _weighted(self) -> list[tuple[float, float]]:
        heights = [(self._vehicle.leg_height_m, _TOLD_STD_M**-2)]
        for source, (measured_m, std_m) in self.measured_m.items():
            heights.append((measured_m, 1.0 / (std_m**2 + _BELOW_STD_M[source] ** 2)))
        return heights

    @property
    def comparisons(self) -> tuple[SourceComparison, ...]:
        """The file's leg height (cm) against what differs most of what was measured; none before that."""
        told_m = self._vehicle.leg_height_m
        found = sorted(self.measured_m.items(), key=lambda measured: abs(measured[1][0] - told_m))
        return tuple(
            SourceComparison(
                self._measured_s,
                Quantity.LEG_HEIGHT,
                f"{100.0 * told_m:.0f} cm",
                f"{100.0 * measured_m:.0f} cm by {source}",
                difference=100.0 * abs(measured_m - told_m),
                std=100.0 * std_m,
            )
            for source, (measured_m, std_m) in found[-1:]
        )

    def _learn(self, source: str, measured_s: float, height_m: float, still_s: float, now_s: float) -> None:
        if measured_s <= self._newest_s[source]:
            return
        self._newest_s[source] = measured_s
        recent_m = self._recent_m[source]
        recent_m.append(height_m)
        agree = len(recent_m) == _COUNT and max(recent_m) - min(recent_m) <= 3.0 * _ECHO_NOISE_M
        if agree and still_s >= _STILL_S:
            self.measured_m[source] = median(recent_m), _MEDIAN_STD * stdev(recent_m)
            self._measured_s = now_s


def _still(vehicle: VehicleState | None, now_s: float) -> bool:
    return (
        vehicle is not None
        and vehicle.aligned
        and imu_fresh(vehicle, now_s)
        and norm(vehicle.acceleration_ned_m_s2) <= _STILL_M_S2
        and norm(vehicle.rate_body_rad_s) <= _STILL_RAD_S
        and tilt_from_quat(vehicle.attitude) <= _LEVEL_RAD
    )
