"""Mission execution: item by item, each gives a motion setpoint or a task of the navigator.

Items act in their order; a DO item acts when its turn comes, and the next item follows in the same step.
NED in the autopilot's own frame, SI units.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import nan

from companion.base.geometry import Vector3, wrap_angle
from sitl.autopilot.control.setpoints import MotionSetpoint
from sitl.autopilot.flight.mission_items import (
    NAVIGATION,
    ItemFrame,
    MissionCommand,
    MissionItem,
    MissionStore,
    heading_rad,
)
from sitl.autopilot.flight.modes import Severity, Task
from sitl.autopilot.flight.navigator import Navigator
from sitl.autopilot.flight.profile import ParameterMap, Parameters

_MOST_ITEMS_A_STEP = 100
_FROM_THE_GROUND = (MissionCommand.TAKEOFF, MissionCommand.LAND, MissionCommand.RETURN_TO_LAUNCH)
_EMPTY_LOOP_WAIT_S = 1.0  # wait of a backward jump when nothing was flown since the last one
_REQUIRED = 2  # PRECISION_LAND_MODE
_HEIGHT_REACHED_M = 0.8
_FACE_BEYOND_M = 2.0
_HEADING_REACHED_RAD = math.radians(3.0)
_CIRCLE_RATE_RAD_S = math.radians(20.0)
_CIRCLE_RADIUS_M = 10.0
_CIRCLE_TOP_SPEED_M_S = 3.0


@dataclass(frozen=True, slots=True)
class MissionInputs:
    """The vehicle at one outer step."""

    position_ned_m: Vector3
    heading_rad: float
    landed: bool
    dt_s: float


@dataclass(slots=True)
class _Progress:
    """Progress of the present item."""

    target: Vector3 | None = None
    arrived: bool = False
    waited_s: float = 0.0
    turned_rad: float = 0.0
    bearing: float | None = None
    heading_to: float | None = None
    within: Task | None = None
    climbing_first: bool = False
    announced: bool = False
    jump_to: int | None = None


MissionOutput = MotionSetpoint | Task


class MissionRunner:
    """Executes the mission of the store.

    `to_ned` turns latitude (deg), longitude (deg), altitude (m) into local NED; its flag tells whether the
    altitude is over home. `started` is needed on the ground by an autopilot that waits for a start.
    """

    def __init__(
        self,
        store: MissionStore,
        navigator: Navigator,
        parameters: Parameters,
        parameter_map: ParameterMap,
        to_ned: Callable[[Vector3, bool], Vector3],
    ) -> None:
        self._store = store
        self._navigator = navigator
        self._parameters = parameters
        self._parameter_map = parameter_map
        self._to_ned = to_ned
        self._handlers: dict[int, Callable[[MissionItem, MissionInputs], MissionOutput | None]] = {
            MissionCommand.WAYPOINT: self._stay,
            MissionCommand.SPLINE_WAYPOINT: self._stay,
            MissionCommand.LOITER_UNLIM: lambda item, here: self._stay(item, here, math.inf),
            MissionCommand.LOITER_TIME: self._stay,
            MissionCommand.LOITER_TURNS: self._turns,
            MissionCommand.RETURN_TO_LAUNCH: self._return,
            MissionCommand.LAND: self._land,
            MissionCommand.TAKEOFF: self._take_off,
            MissionCommand.DELAY: self._delay,
            MissionCommand.CONDITION_DELAY: self._delay,
            MissionCommand.CONDITION_YAW: self._turn,
            MissionCommand.DO_JUMP: self._jump,
            MissionCommand.DO_CHANGE_SPEED: self._change_speed,
            MissionCommand.DO_SET_HOME: self._set_home,
        }
        self.started = False
        self.paused = False
        self.precision_required = False
        self._jumped: dict[int, int] = {}
        self._flown_since_jump = True
        self._version = store.version
        self._now = _Progress()

    def enter(self) -> None:
        """The mission mode starts: continue with the current item from the present position."""
        self.paused = False
        self._navigator.speeds.forget()
        self._now = _Progress()

    def rest(self) -> None:
        """Disarmed: reset speeds and start flag; a finished mission can be flown again."""
        self.started = self.paused = False
        self._jumped.clear()
        if self._store.finished or self._store.rules.rewinds_on_disarm:
            self._store.rewind()
        self._now = _Progress()

    def step(self, here: MissionInputs) -> MissionOutput:
        """The setpoint or the task of the present item."""
        store = self._store
        if store.version != self._version:
            self._version = store.version
            self._jumped.clear()
            self._now = _Progress()
        if self.paused or (here.landed and not self.started and store.rules.waits_for_start):
            return Task.HOLD
        for _ in range(_MOST_ITEMS_A_STEP):
            store.current = max(store.current, min(store.rules.first, len(store)))
            if store.finished or store.current >= len(store):
                return Task.LAND if here.landed else Task.HOLD
            item = store.items[store.current]
            wanted = self._climb_first(item, here) or self._act(item, here)
            if wanted is not None:
                self._flown_since_jump = self._flown_since_jump or item.command != MissionCommand.DO_JUMP
                return wanted
            self._complete()
        return Task.HOLD  # too many items without motion; continue in the next step

    def task_done(self, following: Task) -> None:
        """The navigator has done the task that the last step returned; `following` is its next one."""
        if self._now.climbing_first:
            self._now.climbing_first = False
        elif following is Task.LAND:
            self._now.within = following
        else:
            self._complete()

    # ------------------------------------------------------------ from item to item

    def _act(self, item: MissionItem, here: MissionInputs) -> MissionOutput | None:
        """Fly an item; None: it is done. An item without effect here is done at once."""
        if not self._now.announced and item.command != MissionCommand.DO_JUMP:
            self._now.announced = True
            text = self._store.rules.item_text
            self._store.send_text(Severity.INFO, text.format(number=self._store.current) if text else "")
        handler = self._handlers.get(item.command)
        return None if handler is None else handler(item, here)

    def _complete(self) -> None:
        store = self._store
        if store.items[store.current].command != MissionCommand.DO_JUMP:  # neither autopilot reports a jump
            store.reach(store.current)
        store.current = store.current + 1 if self._now.jump_to is None else self._now.jump_to
        if store.current >= len(store):
            store.finished, store.current = True, max(0, len(store) - 1)
            store.send_text(Severity.INFO, store.rules.finished_text)
        self._now = _Progress()

    def _climb_first(self, item: MissionItem, here: MissionInputs) -> Task | None:
        """Take off first, where the autopilot does so by itself."""
        if self._now.climbing_first:
            return Task.TAKE_OFF
        goes = item.command in NAVIGATION and item.command not in _FROM_THE_GROUND
        if not (
            here.landed
            and goes
            and self._store.rules.takes_off_before_mission
            and self._parameter_map.take_off_height
        ):
            return None
        self._navigator.climb_to_m = self._parameters.si(self._parameter_map.take_off_height)
        self._now.climbing_first = True
        return Task.TAKE_OFF

    # ------------------------------------------------------------ places

    def _place(self, item: MissionItem, here: MissionInputs) -> Vector3:
        """An item's position in local NED; computed once, when the item starts."""
        if self._now.target is None:
            place = (item.x, item.y) if item.has_place else (nan, nan)
            self._now.target = self._to_ned((*place, item.z), item.frame is ItemFrame.RELATIVE)
        return self._now.target

    def _reached(self, target: Vector3, here: MissionInputs, radius_m: float) -> bool:
        if not self._now.arrived:
            (x, y, z), position = target, here.position_ned_m
            near = math.hypot(x - position[0], y - position[1]) < radius_m
            self._now.arrived = near and abs(z - position[2]) < _HEIGHT_REACHED_M
        return self._now.arrived

    def _heading(self, item: MissionItem, target: Vector3, here: MissionInputs) -> float:
        """The item's heading, or towards the waypoint while it is far."""
        asked = heading_rad(item.parameters[3]) if self._store.rules.uses_yaw_parameter else nan
        if not math.isnan(asked):
            return asked
        north, east = target[0] - here.position_ned_m[0], target[1] - here.position_ned_m[1]
        if math.hypot(north, east) < _FACE_BEYOND_M:
            return nan
        return math.atan2(east, north)

    def _towards(self, item: MissionItem, target: Vector3, here: MissionInputs) -> MotionSetpoint:
        return replace(
            self._navigator.towards(target, here.position_ned_m), yaw_rad=self._heading(item, target, here)
        )

    def _stay(
        self, item: MissionItem, here: MissionInputs, seconds: float | None = None
    ) -> MissionOutput | None:
        """Fly to an item's position and stay there, by default for its parameter 1 (s)."""
        target = self._place(item, here)
        own_radius = item.parameter(2) if item.command == MissionCommand.WAYPOINT else 0.0
        radius = (
            own_radius if own_radius > 0.0 else self._parameters.si(self._parameter_map.acceptance_radius)
        )
        if self._reached(target, here, radius):
            self._now.waited_s += here.dt_s
            if self._now.waited_s >= (item.parameter(1) if seconds is None else seconds):
                return None
        return self._towards(item, target, here)

    def _turns(self, item: MissionItem, here: MissionInputs) -> MissionOutput | None:
        """Circle round a place: parameter 1 turns, parameter 3 the radius (negative: anticlockwise)."""
        x, y, z = centre = self._place(item, here)
        radius = abs(item.parameter(3)) or _CIRCLE_RADIUS_M
        north, east = here.position_ned_m[0] - x, here.position_ned_m[1] - y
        if self._now.bearing is None:
            bearing = math.atan2(east, north)
            start = (x + radius * math.cos(bearing), y + radius * math.sin(bearing), z)
            if not self._reached(start, here, 1.0):
                return self._towards(item, start, here)
            self._now.bearing = bearing
        rate = math.copysign(
            min(_CIRCLE_RATE_RAD_S, _CIRCLE_TOP_SPEED_M_S / radius), item.parameter(3) or 1.0
        )
        self._now.turned_rad += abs(rate) * here.dt_s
        if self._now.turned_rad >= 2.0 * math.pi * item.parameter(1, 1.0):
            return None
        self._now.bearing += rate * here.dt_s
        c, s = math.cos(self._now.bearing), math.sin(self._now.bearing)
        position = (centre[0] + radius * c, centre[1] + radius * s, z)
        return MotionSetpoint(
            position, (-radius * rate * s, radius * rate * c, 0.0), yaw_rad=self._now.bearing + math.pi
        )

    def _take_off(self, item: MissionItem, here: MissionInputs) -> MissionOutput | None:
        ground = self._navigator.home_ned_m[2]
        top = self._to_ned((nan, nan, item.z), item.frame is ItemFrame.RELATIVE)[2]
        begun, self._now.within = self._now.within, Task.TAKE_OFF
        if begun is None and not here.landed and here.position_ned_m[2] - top < _HEIGHT_REACHED_M:
            return None  # already high enough
        self._navigator.climb_to_m = ground - top
        return Task.TAKE_OFF

    def _return(self, item: MissionItem, here: MissionInputs) -> MissionOutput | None:
        """Return; over home the navigator continues with the landing."""
        return None if here.landed else self._now.within or Task.RETURN

    def _land(self, item: MissionItem, here: MissionInputs) -> MissionOutput | None:
        if here.landed:
            return None
        if item.has_place and not self._now.arrived:
            x, y, _ = self._to_ned((item.x, item.y, nan), False)
            if self._now.target is None:
                self._now.target = (x, y, here.position_ned_m[2])
            radius = self._parameters.si(self._parameter_map.acceptance_radius)
            if not self._reached(self._now.target, here, min(radius, 1.0)):
                return self._towards(item, self._now.target, here)
        self.precision_required = item.whole(2) == _REQUIRED
        return Task.PRECISION_LAND if item.whole(2) > 0 else Task.LAND

    # ------------------------------------------------------------ waiting, turning, doing

    def _delay(self, item: MissionItem, here: MissionInputs) -> MissionOutput | None:
        self._now.waited_s += here.dt_s
        return Task.HOLD if self._now.waited_s < item.parameter(1) else None

    def _turn(self, item: MissionItem, here: MissionInputs) -> MissionOutput | None:
        """CONDITION_YAW: parameter 1 degrees, 3 direction and 4 relative to the present heading."""
        if self._now.target is None:
            self._now.target = here.position_ned_m
            self._now.heading_to = heading_from_condition(item.parameters, here.heading_rad)
        heading = self._now.heading_to
        if heading is None or abs(wrap_angle(heading - here.heading_rad)) < _HEADING_REACHED_RAD:
            return None
        return replace(self._navigator.towards(self._now.target, here.position_ned_m), yaw_rad=heading)

    def _jump(self, item: MissionItem, here: MissionInputs) -> MissionOutput | None:
        """Jump to another item; a loop without motion advances slowly, not within one step."""
        number, target, times = self._store.current, item.whole(1), item.whole(2)
        done = self._jumped.get(number, 0)
        if not ((times < 0 or done < times) and 0 <= target < len(self._store)):
            return None
        if target <= number and not self._flown_since_jump:
            self._now.waited_s += here.dt_s
            if self._now.waited_s < _EMPTY_LOOP_WAIT_S:
                return Task.HOLD
        self._jumped[number] = done + 1
        self._now.jump_to = target
        self._flown_since_jump = self._flown_since_jump and target > number
        return None

    def _change_speed(self, item: MissionItem, here: MissionInputs) -> MissionOutput | None:
        self._navigator.speeds.change(item.whole(1), item.parameter(2, -1.0))
        return None

    def _set_home(self, item: MissionItem, here: MissionInputs) -> MissionOutput | None:
        if item.whole(1) == 1 or not item.has_place:
            self._navigator.fix_home(here.position_ned_m)
        else:
            self._navigator.fix_home(self._place(item, here))
        return None


def heading_from_condition(parameters: tuple[float, ...], heading: float) -> float | None:
    """Heading (rad) that CONDITION_YAW's parameters 1, 3 and 4 command; None when they are not finite."""
    angle, _, direction, relative = parameters[:4]
    if not math.isfinite(angle):
        return None
    asked = heading_rad(angle)
    if relative != 1.0:
        return wrap_angle(asked)
    return wrap_angle(heading + (-asked if direction == -1.0 else asked))
