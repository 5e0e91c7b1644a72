"""The leg height's second source: what echo and pad measure while the vehicle stands, before take-off.

Heights are of the vehicle's reference point over what its feet stand on. m, s, rad.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import Final

from companion.base.geometry import norm, tilt_from_quat
from companion.base.messages import PadState, VehicleState
from companion.config import VehicleConfig
from companion.plan.debounce import Debounce
from companion.plan.landing.contact import UNSEEN_S, echo_height_m, felt
from companion.plan.landing.relative_state import predicted
from companion.plan.mission.inputs import PlanInputs

# So still for so long it is not in somebody's hands; further aslant an echo is not from below.
_STILL_S: Final = 2.0
_STILL_M_S2: Final = 0.3
_STILL_RAD_S: Final = 0.05
_LEVEL_RAD: Final = math.radians(10.0)
_COUNT: Final = 10  # echoes, and sightings, that have to agree
_SPREAD_M: Final = 0.03
# Grass, a place measured by a ruler: 3 cm each. A vehicle that falls from there lands at 1 m/s.
BOUND_M: Final = 0.05


class StandingHeight:
    """`update` every cycle, from the app's start on; what it has learnt outlives a mission."""

    def __init__(self, vehicle: VehicleConfig) -> None:
        self._vehicle = vehicle
        self._still = Debounce()
        self._echo_s = self._seen_s = -math.inf
        self._by_echo: deque[float] = deque(maxlen=_COUNT)
        self._by_pad: deque[float] = deque(maxlen=_COUNT)
        self._moved = False  # since the last was learnt
        self.measured_m: dict[str, float] = {}  # by its source

    def update(self, inputs: PlanInputs, now_s: float) -> None:
        """Take in a cycle's echo and estimates; flying says nothing."""
        vehicle = inputs.vehicle
        still = inputs.autopilot.connected and not inputs.autopilot.armed and _still(vehicle, now_s)
        if self._still.held_s(still, now_s) < _STILL_S or vehicle is None:
            self._by_echo.clear()
            self._by_pad.clear()
            self._moved = True
            return
        echo_m = echo_height_m(inputs.range, self._vehicle, now_s)
        if inputs.range is not None and echo_m is not None and inputs.range.time_s > self._echo_s:
            self._echo_s = inputs.range.time_s
            self._learn("the rangefinder", self._by_echo, echo_m)
        sight = predicted(inputs.pad, now_s)
        if sight is not None and self._stands_on(sight) and sight.seen_time_s > self._seen_s:
            self._seen_s = sight.seen_time_s
            self._learn("the pad", self._by_pad, sight.height_m)

    @property
    def problem(self) -> str | None:
        """Why the file's leg height is not flown with; None: it agrees, or nothing has measured it."""
        told_m = self._vehicle.leg_height_m
        for source, measured_m in self.measured_m.items():
            if abs(measured_m - told_m) > BOUND_M:
                return (
                    f"leg_height_m is {told_m:.2f} in the vehicle's file, and {source} measured "
                    f"{measured_m:.2f} standing: expected within {BOUND_M:g} m"
                )
        return None

    def _learn(self, source: str, recent_m: deque[float], height_m: float) -> None:
        recent_m.append(height_m)
        if len(recent_m) == _COUNT and max(recent_m) - min(recent_m) <= _SPREAD_M:
            if self._moved:
                self.measured_m.clear()  # it stood elsewhere: on a bench, say
                self._moved = False
            self.measured_m[source] = median(recent_m)

    def _stands_on(self, sight: PadState) -> bool:
        return sight.unseen_s <= UNSEEN_S and sight.lateral_m <= self._vehicle.foot_reach_m


def _still(vehicle: VehicleState | None, now_s: float) -> bool:
    return (
        vehicle is not None
        and vehicle.aligned
        and felt(vehicle, now_s)
        and norm(vehicle.acceleration_ned_m_s2) <= _STILL_M_S2
        and norm(vehicle.rate_body_rad_s) <= _STILL_RAD_S
        and tilt_from_quat(vehicle.attitude) <= _LEVEL_RAD
    )
