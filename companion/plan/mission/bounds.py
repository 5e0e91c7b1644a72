"""The limits of a mission: fence, ceiling, and the fastest pad that is followed.

They apply to the vehicle, whatever it follows. A limit counts as reached while the vehicle can still stop
before it: by the autopilot's HOLD, which takes v t + v^2 / (2 a) at the speed v towards it, with the time t
until it is obeyed and the deceleration a that both autopilots reach in it, and by the app's own hold, as
`min_jerk.brake` plans it. m, s; NED.
"""

import math
from collections.abc import Iterator
from functools import partial
from typing import Final

from companion.base.geometry import Vector3, add, ned_from_geodetic, norm, subtract
from companion.base.messages import AutopilotState, PadState, VehicleState
from companion.base.motion import Motion
from companion.base.second_sources import SIGMA_THRESHOLD
from companion.config import PlanConfig
from companion.plan.debounce import Debounce
from companion.plan.events import DetectedEvent, MissionEvent
from companion.plan.trajectory.coordinate_frames import along_arc
from companion.plan.trajectory.min_jerk import stop_s

# A request, its answer and the begin of the braking: 0.2 s each on a slow link, and 0.4 s more to tilt.
_OBEYED_S: Final = 0.8
# PX4 brakes with MPC_ACC_HOR (3 m/s²), ArduCopter's BRAKE with 2.5 m/s²; up and down with less.
_BRAKES_M_S2: Final = 2.0
# An acceleration passes the bound for a moment when the pad is first seen; of a speed its uncertainty tells.
_TOO_HARD_S: Final = 0.5


def stopping_m(towards_m_s: float, speed_m_s: float, deceleration_m_s2: float) -> float:
    """How far (m) the vehicle still gets at a speed towards a bound; 0 when it flies away from it.

    At `speed_m_s` in all its own hold takes as long as `brake` with the plan's deceleration, and by then has
    flown half of what it would have at that speed.
    """
    towards_m_s = max(0.0, towards_m_s)
    by_autopilot_m = towards_m_s * (_OBEYED_S + towards_m_s / (2.0 * _BRAKES_M_S2))
    return max(by_autopilot_m, 0.5 * towards_m_s * stop_s(speed_m_s, deceleration_m_s2))


class Bounds:
    """Looks at every cycle's estimates. Without a home position there is nothing to count from."""

    def __init__(self, config: PlanConfig) -> None:
        self._config = config.mission
        self._brakes_m_s2 = config.guidance.horizontal_acceleration_m_s2
        self._held = Debounce()

    def detect(
        self, vehicle: VehicleState | None, pad: PadState | None, autopilot: AutopilotState, now_s: float
    ) -> Iterator[DetectedEvent]:
        if vehicle is not None and (here := self._from_home(vehicle, autopilot)) is not None:
            yield from self._space(vehicle, here)
        yield from self._pad(pad, now_s)

    def inside_after(
        self,
        duration_s: float,
        pad: Motion | None,
        turn_rate_rad_s: float,
        vehicle: VehicleState | None,
        autopilot: AutopilotState,
    ) -> bool:
        """Whether the pad (EKF's NED) is still inside the fence then, if it drives and turns on as now."""
        here = None if vehicle is None else self._from_home(vehicle, autopilot)
        if pad is None or vehicle is None or here is None:
            return True
        from_home_m = add(here, subtract(pad.position_m, vehicle.position_ned_m))
        north, east = along_arc(from_home_m, pad.velocity_m_s, turn_rate_rad_s, duration_s)
        return math.hypot(north, east) <= self._config.fence_m

    def _from_home(self, vehicle: VehicleState, autopilot: AutopilotState) -> Vector3 | None:
        """The vehicle's place from home (NED, m); without GPS ours drifts: the worse of both."""
        if vehicle.origin is None or autopilot.home is None:
            return None
        ours = subtract(vehicle.position_ned_m, ned_from_geodetic(*autopilot.home, vehicle.origin))
        if vehicle.has_gps or autopilot.global_position is None:
            return ours
        theirs = ned_from_geodetic(*autopilot.global_position, autopilot.home)
        north, east, _ = max(ours, theirs, key=lambda place: math.hypot(*place[:2]))
        return north, east, min(ours[2], theirs[2])

    def _space(self, vehicle: VehicleState, from_home_m: Vector3) -> Iterator[DetectedEvent]:
        c = self._config
        north, east, down = from_home_m
        vn, ve, vd = vehicle.velocity_ned_m_s
        room = partial(
            stopping_m, speed_m_s=norm(vehicle.velocity_ned_m_s), deceleration_m_s2=self._brakes_m_s2
        )
        away_m = math.hypot(north, east)
        outward_m_s = (north * vn + east * ve) / away_m if away_m > 0.0 else 0.0
        if away_m + room(outward_m_s) > c.fence_m:
            yield MissionEvent.OUT_OF_BOUNDS, f"fence: {away_m:.0f} m from home, limit {c.fence_m:.0f} m"
        if -down + room(-vd) > c.ceiling_m:
            yield MissionEvent.OUT_OF_BOUNDS, f"ceiling: {-down:.0f} m over home, limit {c.ceiling_m:.0f} m"

    def _pad(self, pad: PadState | None, now_s: float) -> Iterator[DetectedEvent]:
        c = self._config
        acceleration = 0.0
        if pad is not None:
            speed = math.hypot(*pad.velocity_ned_m_s[:2])
            uncertain_m_s = SIGMA_THRESHOLD * pad.velocity_std_m_s
            if speed - uncertain_m_s > c.pad_speed_m_s:
                words = f"{speed:.1f} ±{uncertain_m_s:.1f} m/s, limit {c.pad_speed_m_s:g}"
                yield MissionEvent.PAD_TOO_FAST, words
            acceleration = math.hypot(*pad.acceleration_ned_m_s2[:2])
        if self._held.held_s("too hard", acceleration > c.pad_acceleration_m_s2, now_s) >= _TOO_HARD_S:
            most = c.pad_acceleration_m_s2
            yield MissionEvent.PAD_TOO_FAST, f"{acceleration:.1f} m/s², limit {most:g}"
