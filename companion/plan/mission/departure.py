"""The flight from the ground to the waypoint, which the autopilot flies itself.

Requests use latitude, longitude and height over home, since the autopilot's estimate differs from ours.
Metres, seconds, degrees.
"""

import math
from dataclasses import replace

from companion.base.geometry import Vector3, geodetic_from_ned, ned_from_geodetic
from companion.base.messages import Action, ActionKind, AutopilotState, LandedState, VehicleState
from companion.config import MissionConfig
from companion.plan.debounce import Debounce
from companion.plan.events import DetectedEvent, MissionEvent
from companion.plan.inputs import PlanInputs
from companion.plan.mission.readiness import not_ready_to_arm
from companion.plan.mission.shared import Shared
from companion.plan.mission.states import State
from companion.plan.trajectory.waypoints import places_from_home

REMIND_S = 10.0  # of what is waited for
# The autopilots end a take-off somewhat below its height: up is within this of it, or settled for a while at
# this share of it.
_NEARLY_UP_M = 0.5
_SETTLED_SHARE = 0.7
_SETTLED_M_S = 0.2
_SETTLED_S = 1.5


class Departure:
    """Connect, arm, take off and go to the waypoint."""

    def __init__(self, config: MissionConfig, shared: Shared) -> None:
        self._config, self._pad, self._ground = config, shared.pad, shared.ground
        self._avoidance = shared.generator.avoidance
        self._machine, self._requests, self._say = shared.machine, shared.requests, shared.say
        self._held = Debounce()
        self._sent_to: Vector3 | None = None  # latitude, longitude, altitude

    def with_numbers(self, action: Action, autopilot: AutopilotState) -> Action:
        """One of the table's requests with the mission's numbers in it."""
        if action.kind is ActionKind.TAKE_OFF:
            return replace(action, height_m=self._config.take_off_height_m)
        if action.kind is ActionKind.GO_TO and autopilot.home is not None:
            north, east = self._config.waypoint_ned_m
            self._sent_to = geodetic_from_ned((north, east, 0.0), autopilot.home)
            return replace(action, position=(*self._sent_to[:2], self._config.take_off_height_m))
        if action.kind is ActionKind.HOLD and action.height_m != 0.0:
            here_m = self._ground.over_home_m  # asked again, it does not rise again from where it is then
            return replace(action, height_m=0.0 if here_m is None else here_m + action.height_m)
        return action

    def step(self, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        state, vehicle, autopilot = self._machine.state, inputs.vehicle, inputs.autopilot
        if state is State.CONNECT:
            return self._connect(inputs, now_s)
        if state is State.ARM:
            if vehicle is None or not vehicle.aligned:
                return MissionEvent.ALIGNMENT_LOST, "before the autopilot armed"
            return self._armed() if autopilot.armed else None
        if state is State.TAKE_OFF:
            return self._take_off(vehicle, autopilot, now_s)
        if self._pad.steady(now_s):
            return MissionEvent.PAD_SEEN, "on the way to the waypoint"
        return None if vehicle is None else self._on_the_way(vehicle, autopilot)

    def _connect(self, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        autopilot = inputs.autopilot
        if autopilot.connected and autopilot.armed:
            return MissionEvent.ALREADY_ARMED, "not by this app"
        missing = [*not_ready_to_arm(inputs, self._config, now_s)]
        if not missing:
            return MissionEvent.READY, "ready to arm"
        self._say.again("waiting", f"waiting: {', '.join(missing)}", now_s, REMIND_S)
        return None

    def _armed(self) -> DetectedEvent | None:
        """Who has armed it: we, where our request was granted; somebody else, where it was denied."""
        if self._requests.granted(ActionKind.ARM):
            return MissionEvent.ARMED, "motors on"
        if self._requests.awaited(ActionKind.ARM):
            return None
        if self._requests.in_doubt(ActionKind.ARM):
            return MissionEvent.ARMED_IN_DOUBT, "the answer to the request of this app was lost"
        return MissionEvent.ALREADY_ARMED, "no request of this app was granted"

    def _take_off(
        self, vehicle: VehicleState | None, autopilot: AutopilotState, now_s: float
    ) -> DetectedEvent | None:
        height_m, wanted_m = self._ground.over_home_m, self._config.take_off_height_m
        if height_m is None or autopilot.landed is LandedState.ON_GROUND:
            return None
        climb_m_s = 0.0 if vehicle is None else -vehicle.velocity_ned_m_s[2]
        calm = abs(climb_m_s) <= _SETTLED_M_S and height_m >= _SETTLED_SHARE * wanted_m
        settled = self._held.held_s("calm", calm, now_s) >= _SETTLED_S
        if height_m < wanted_m - min(_NEARLY_UP_M, 0.1 * wanted_m) and not settled:
            return None
        if vehicle is None or self._avoidance.lost:
            return (
                MissionEvent.HOME_UNKNOWN,
                "no estimate at take-off: position of the obstacles unknown",
            )
        if not self._avoidance.straight_clear(vehicle.position_ned_m, places_from_home(self._config)[0]):
            return MissionEvent.BLOCKED, "obstacles on the straight path to the waypoint: flying round them"
        return MissionEvent.AIRBORNE, f"{height_m:.1f} m up"

    def _on_the_way(self, vehicle: VehicleState, autopilot: AutopilotState) -> DetectedEvent | None:
        """Whether it is slow at the first waypoint, by our estimate or by the autopilot's, which flies there.

        The two differ by metres, and an autopilot that stands where it was sent comes no nearer.
        """
        if self._sent_to is None:
            return None
        ours_m_s, c = math.hypot(*vehicle.velocity_ned_m_s[:2]), self._config
        found = []  # how far away, and how fast
        if vehicle.origin is not None:
            there = ned_from_geodetic(*self._sent_to, vehicle.origin)
            found.append((math.dist(vehicle.position_ned_m[:2], there[:2]), ours_m_s))
        if autopilot.global_position is not None:
            there = ned_from_geodetic(*self._sent_to, autopilot.global_position)
            theirs_m_s = autopilot.velocity_ned_m_s or vehicle.velocity_ned_m_s
            found.append((math.hypot(*there[:2]), math.hypot(*theirs_m_s[:2])))
        for distance_m, speed_m_s in found:
            if distance_m <= c.arrival_radius_m and speed_m_s <= c.arrival_speed_m_s:
                event = MissionEvent.ONWARD if c.waypoints_ned_m else MissionEvent.ARRIVED
                return event, f"{distance_m:.1f} m from the waypoint"
        return None
