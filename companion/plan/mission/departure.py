"""From the ground to the waypoint: the part that the autopilot flies itself.

What is asked of it is in its own terms, latitude, longitude and height over its home, since its estimate
is not ours; whether the vehicle has arrived is judged by our own. Metres, seconds, degrees.
"""

from __future__ import annotations

import math

from companion.base.geometry import Vector3, geodetic_from_ned, ned_from_geodetic
from companion.base.messages import Action, ActionKind, AutopilotState, LandedState, Phase, VehicleState
from companion.config import MissionConfig
from companion.plan.landing.touchdown import Finding, Held
from companion.plan.mission.table import Event

_REMIND_S = 10.0
_NEARLY_UP_M = 0.5
_SETTLED_SHARE = 0.7
_SETTLED_M_S = 0.2
_SETTLED_S = 1.5


class Departure:
    """Connect, arm, take off and go to the waypoint."""

    def __init__(self, config: MissionConfig) -> None:
        self._config = config
        self._settled = Held()
        self._reminded_s = -math.inf
        self._waypoint: tuple[Vector3, Vector3, Vector3] | None = None

    def action(self, kind: ActionKind, autopilot: AutopilotState) -> Action:
        """A request of some kind with the mission's numbers in it."""
        if kind is ActionKind.TAKE_OFF:
            return Action(kind, height_m=self._config.take_off_height_m)
        if kind is ActionKind.GO_TO and autopilot.home is not None:
            latitude, longitude, _ = self._waypoint_geodetic(autopilot.home)
            return Action(kind, position=(latitude, longitude, self._config.take_off_height_m))
        return Action(kind)

    def lift_off(self) -> None:
        """Begin to watch the climb."""
        self._settled = Held()

    def step(
        self,
        phase: Phase,
        vehicle: VehicleState | None,
        autopilot: AutopilotState,
        height_m: float | None,
        now_s: float,
    ) -> tuple[Finding, str]:
        """What is found in one of these phases, and what to tell of the waiting; height over home."""
        if phase is Phase.CONNECT:
            return self._connect(vehicle, autopilot, now_s)
        if phase is Phase.ARM:
            if vehicle is None or not vehicle.aligned:
                return (Event.ESTIMATE_LOST, "before the autopilot would arm"), ""
            return ((Event.ARMED, "motors turn") if autopilot.armed else None), ""
        if phase is Phase.TAKE_OFF:
            return self._take_off(vehicle, autopilot, height_m, now_s), ""
        return self._to_waypoint(vehicle, autopilot), ""

    def _connect(
        self, vehicle: VehicleState | None, autopilot: AutopilotState, now_s: float
    ) -> tuple[Finding, str]:
        if autopilot.connected and autopilot.armed:
            # after a restart in the air too: whoever flies it, or lands it next, asked for no take-off
            return (Event.PILOT_TOOK_OVER, "armed already, and not by us"), ""
        missing = [text for text, there in _needs(vehicle, autopilot) if not there]
        if not missing:
            return (Event.READY, "the autopilot may be armed"), ""
        if now_s - self._reminded_s < _REMIND_S:
            return None, ""
        self._reminded_s = now_s
        return None, f"waiting for {', '.join(missing)}"

    def _take_off(
        self, vehicle: VehicleState | None, autopilot: AutopilotState, height_m: float | None, now_s: float
    ) -> Finding:
        wanted_m = self._config.take_off_height_m
        if height_m is None or autopilot.landed is LandedState.ON_GROUND:
            return None
        climb_m_s = 0.0 if vehicle is None else -vehicle.velocity_ned_m_s[2]
        calm = abs(climb_m_s) <= _SETTLED_M_S and height_m >= _SETTLED_SHARE * wanted_m
        settled = self._settled.for_s(calm, now_s) >= _SETTLED_S
        if height_m >= wanted_m - min(_NEARLY_UP_M, 0.1 * wanted_m) or settled:
            return Event.AIRBORNE, f"{height_m:.1f} m up"
        return None

    def _to_waypoint(self, vehicle: VehicleState | None, autopilot: AutopilotState) -> Finding:
        if vehicle is None or vehicle.origin is None or autopilot.home is None:
            return None
        waypoint = self._waypoint_local(autopilot.home, vehicle.origin)
        p, v = vehicle.position_ned_m, vehicle.velocity_ned_m_s
        distance_m = math.hypot(p[0] - waypoint[0], p[1] - waypoint[1])
        slow = math.hypot(v[0], v[1]) <= self._config.arrival_speed_m_s
        if distance_m <= self._config.arrival_radius_m and slow:
            return Event.ARRIVED, f"{distance_m:.1f} m from the waypoint"
        return None

    def _waypoint_geodetic(self, home: Vector3) -> Vector3:
        north, east = self._config.waypoint_ned_m
        return geodetic_from_ned((north, east, 0.0), home)

    def _waypoint_local(self, home: Vector3, origin: Vector3) -> Vector3:
        """The waypoint in the EKF's NED; worked out once for a home and an origin."""
        if self._waypoint is None or self._waypoint[:2] != (home, origin):
            self._waypoint = (home, origin, ned_from_geodetic(*self._waypoint_geodetic(home), origin))
        return self._waypoint[2]


def _needs(vehicle: VehicleState | None, autopilot: AutopilotState) -> tuple[tuple[str, bool], ...]:
    return (
        ("the autopilot", autopilot.connected),
        ("its home position", autopilot.home is not None),
        ("it to be ready to arm", autopilot.ready_to_arm),
        ("its filter to know where it is", autopilot.ekf_ready is not False),
        ("our own alignment", vehicle is not None and vehicle.aligned),
        ("GPS", vehicle is not None and vehicle.has_gps and vehicle.origin is not None),
    )
