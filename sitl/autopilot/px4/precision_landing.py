"""PX4's precision landing (precland of 1.16): approach, sink above the target, final approach, search.

It takes the target's position in LOCAL_NED only, unfiltered, and flies to it as to any position: no velocity
of the target is known, so that a moving one is followed at a lag and never met within PLD_HACC_RAD. SI units.
"""

import math
from enum import Enum
from math import nan

from companion.base.geometry import Vector3
from sitl.autopilot.control.setpoints import MotionSetpoint
from sitl.autopilot.flight.modes import Severity
from sitl.autopilot.flight.profile import LandingTargetFrame, Parameters, PrecisionLanding, VehicleEstimate

_ABOVE_FOR_S = 2.0
_FRESH_NEAR_GROUND_S = 0.5


class PrecLandState(Enum):
    """States of a precision landing."""

    START = "start"
    APPROACH = "horizontal approach"
    DESCEND = "descend above target"
    FINAL = "final approach"
    SEARCH = "search"
    FALLBACK = "fallback"


class Px4PrecisionLanding(PrecisionLanding):
    """The state machine, with its present `state`."""

    def __init__(self, parameters: Parameters) -> None:
        super().__init__()
        self._parameters = parameters
        self._target: Vector3 | None = None
        self.begin(required=True)

    def begin(self, *, required: bool) -> None:
        self.state = PrecLandState.START
        self._required = required
        self._searches = 0
        self._since_s: float | None = None
        self._height_ned_m = 0.0

    def watch(self, estimate: VehicleEstimate, dt_s: float) -> None:
        target, self._pending = self._pending, None
        if target is None:
            return
        if target.position_m is None or target.frame != LandingTargetFrame.LOCAL_NED:
            text = f"landing target: coordinate frame {target.frame} unsupported"
            self._report_frame(Severity.CRITICAL, text)
            return
        self._target, self._seen_s = target.position_m, estimate.now_s

    def fly(self, estimate: VehicleEstimate, dt_s: float) -> MotionSetpoint | None:
        steps = {
            PrecLandState.START: self._start,
            PrecLandState.APPROACH: self._approach,
            PrecLandState.DESCEND: self._descend,
            PrecLandState.FINAL: self._final,
            PrecLandState.SEARCH: self._search,
        }
        step = steps.get(self.state)
        return None if step is None else step(estimate)

    # ------------------------------------------------------------ stages

    def _start(self, estimate: VehicleEstimate) -> MotionSetpoint | None:
        if self._visible(estimate) is not None:
            return self._begin_approach(estimate)
        return self._begin_search(estimate) if self._required else self._give_up()

    def _approach(self, estimate: VehicleEstimate) -> MotionSetpoint | None:
        target = self._visible(estimate)
        if target is None:
            self._say("Lost landing target while landing (horizontal approach).")
            return self._begin_search(estimate) if self._required else self._give_up()
        if self._away(target, estimate) < self._value("PLD_HACC_RAD"):
            self._since_s = estimate.now_s if self._since_s is None else self._since_s
            # counted from the first time above it: leaving it does not restart the wait
            if estimate.now_s - self._since_s > _ABOVE_FOR_S:
                self.state = PrecLandState.DESCEND
        return MotionSetpoint((target[0], target[1], self._height_ned_m))

    def _descend(self, estimate: VehicleEstimate) -> MotionSetpoint | None:
        target = self._visible(estimate)
        close = self._target is not None and self._is_close(self._target, estimate)
        if close and estimate.now_s - self._seen_s > _FRESH_NEAR_GROUND_S:
            self.state = PrecLandState.FINAL
            return self._final(estimate)
        if target is None:
            self._say("Lost landing target while landing (descending).")
            return self._begin_search(estimate) if self._required else self._give_up()
        return MotionSetpoint((target[0], target[1], nan), (nan, nan, estimate.landing_speed_m_s))

    def _final(self, estimate: VehicleEstimate) -> MotionSetpoint | None:
        north, east, _ = self._target or estimate.position_ned_m
        return MotionSetpoint((north, east, nan), (nan, nan, estimate.landing_speed_m_s))

    def _search(self, estimate: VehicleEstimate) -> MotionSetpoint | None:
        if self._visible(estimate) is not None:
            return self._begin_approach(estimate)
        if self._since_s is not None and estimate.now_s - self._since_s > self._value("PLD_SRCH_TOUT"):
            self._say("Search timed out, landing here")
            return self._give_up()
        return MotionSetpoint((self._place[0], self._place[1], self._height_ned_m))

    # ------------------------------------------------------------ parts

    def _begin_approach(self, estimate: VehicleEstimate) -> MotionSetpoint | None:
        self.state, self._since_s = PrecLandState.APPROACH, None
        self._height_ned_m = estimate.position_ned_m[2]
        return self._approach(estimate)

    def _begin_search(self, estimate: VehicleEstimate) -> MotionSetpoint | None:
        self._searches += 1
        if self._searches > self._value("PLD_MAX_SRCH"):
            return self._give_up()
        self.state, self._since_s = PrecLandState.SEARCH, estimate.now_s
        self._place = estimate.position_ned_m
        higher = max(0.0, self._value("PLD_SRCH_ALT") - estimate.height_m)
        self._height_ned_m = estimate.position_ned_m[2] - higher
        return self._search(estimate)

    def _give_up(self) -> MotionSetpoint | None:
        self.state = PrecLandState.FALLBACK
        return None

    def _visible(self, estimate: VehicleEstimate) -> Vector3 | None:
        return self._target if estimate.now_s - self._seen_s < self._value("PLD_BTOUT") else None

    def _is_close(self, target: Vector3, estimate: VehicleEstimate) -> bool:
        return target[2] - estimate.position_ned_m[2] < self._value("PLD_FAPPR_ALT")

    def _away(self, target: Vector3, estimate: VehicleEstimate) -> float:
        return math.hypot(target[0] - estimate.position_ned_m[0], target[1] - estimate.position_ned_m[1])

    def _value(self, name: str) -> float:
        return self._parameters[name]

    def _say(self, text: str) -> None:
        self.texts.append((Severity.WARNING, text))
