"""Tasks to motion setpoints: hold, take off, go to, land, return.

NED in the autopilot's own frame, SI units. Targets are stored here; the commander selects the task.
"""

import math
from math import nan

from companion.base.geometry import ZERO3, Vector3
from sitl.autopilot.control.setpoints import MotionSetpoint
from sitl.autopilot.flight.modes import Task
from sitl.autopilot.flight.profile import AutopilotProfile, Parameters

_HEIGHT_REACHED_M = 0.2
_HOME_REACHED_M = 0.8
_HOME_SPEED_M_S = 0.4
_STOPPED_M_S = 0.25
_FASTEST_M_S = 50.0
# less than the controller's limit, so that it stops without overshoot
_BRAKING_M_S2 = 1.0
_SLOWEST_M_S = 0.5
_FARTHEST_HOME_M = 30_000.0  # above or below the origin of the local frame


class SpeedSetpoints:
    """Horizontal, climb and descent speed (m/s): the parameters', until DO_CHANGE_SPEED changes them."""

    def __init__(self, profile: AutopilotProfile, parameters: Parameters) -> None:
        parameter_map = profile.parameter_map
        self._parameters = parameters
        self._parameter_map = (
            parameter_map.cruise_speed,
            parameter_map.climb_speed,
            parameter_map.descent_speed,
        )
        self._changed: list[float | None] = [None, None, None]

    def forget(self) -> None:
        self._changed = [None, None, None]

    def change(self, kind: int, speed_m_s: float) -> bool:
        """DO_CHANGE_SPEED: SPEED_TYPE and m/s (-1: as it is, -2: the default); False when that is none."""
        index = {0: 0, 1: 0, 2: 1, 3: 2}.get(kind)
        if index is None or not (0.0 < speed_m_s <= _FASTEST_M_S or speed_m_s in (-1.0, -2.0)):
            return False
        if speed_m_s != -1.0:
            self._changed[index] = speed_m_s if speed_m_s > 0.0 else None
        return True

    @property
    def horizontal(self) -> float:
        """Horizontal speed (m/s)."""
        return self._value(0)

    @property
    def climb(self) -> float:
        """Climb speed (m/s), upward positive."""
        return self._value(1)

    @property
    def descent(self) -> float:
        """Descent speed (m/s), downward positive."""
        return self._value(2)

    def _value(self, index: int) -> float:
        changed = self._changed[index]
        return self._parameters.si(self._parameter_map[index]) if changed is None else changed


class Navigator:
    """Targets of the tasks, and the setpoint of each outer step."""

    def __init__(self, profile: AutopilotProfile, parameters: Parameters) -> None:
        self._parameter_map = profile.parameter_map
        self._parameters = parameters
        self._held: Vector3 | None = None
        self._task = Task.HOLD
        self.speeds = SpeedSetpoints(profile, parameters)
        self.home_ned_m = ZERO3
        self.home_is_fixed = False
        self.climb_to_m = 0.0
        self.target_ned_m = ZERO3
        self.target_yaw_rad = nan
        self.target_speed_m_s: float | None = None
        self.held_yaw_rad = nan

    def let_go(self) -> None:
        """Release the held position: the next hold brakes and stays where it stops."""
        self._held = None

    def fix_home(self, position_ned_m: Vector3) -> bool:
        """Set home explicitly: it no longer is where the vehicle was armed.

        False, and no change, for one that is too far above or below: a home set relative to home, again and
        again, would climb out of all bounds. (A place beyond the horizon is far below, too.)
        """
        if not abs(position_ned_m[2]) <= _FARTHEST_HOME_M:
            return False
        self.home_ned_m, self.home_is_fixed = position_ned_m, True
        return True

    def towards(
        self, target: Vector3, position: Vector3, speed_m_s: float | None = None, yaw_rad: float = nan
    ) -> MotionSetpoint:
        """Fly to a position at the present speeds, and brake in time to stop there."""
        speeds = self.speeds
        distance = math.hypot(target[0] - position[0], target[1] - position[1])
        braking = max(_SLOWEST_M_S, math.sqrt(2.0 * _BRAKING_M_S2 * distance))
        return MotionSetpoint(
            target,
            yaw_rad=yaw_rad,
            horizontal_speed_m_s=min(speeds.horizontal if speed_m_s is None else speed_m_s, braking),
            climb_speed_m_s=speeds.climb,
            descent_speed_m_s=speeds.descent,
        )

    def landing_speed(self, position: Vector3) -> float:
        """Descent speed (m/s) at a position, by its height over home."""
        height = self.home_ned_m[2] - position[2]
        final = self._parameters.si(self._parameter_map.final_landing_speed)
        if height < self._parameters.si(self._parameter_map.final_landing_height):
            return final
        return max(self._parameters.si(self._parameter_map.landing_speed) or self.speeds.descent, final)

    def step(self, task: Task, position: Vector3, velocity: Vector3) -> tuple[MotionSetpoint, Task | None]:
        """The setpoint of a task, and the next task when this one is done."""
        if task is not self._task:
            self._task, self._held, self.held_yaw_rad = task, None, nan
        if task is Task.TAKE_OFF:
            return self._take_off(position)
        if task is Task.GO_TO:
            return self._go(position), None
        if task is Task.LAND:
            return self._land(position, velocity), None
        if task is Task.RETURN:
            return self._return(position, velocity)
        if task is Task.DESCEND:
            return self._descend(), None
        return self._hold(position, velocity), None

    def _hold(self, position: Vector3, velocity: Vector3) -> MotionSetpoint:
        if self._held is None:
            if math.dist(velocity, ZERO3) > _STOPPED_M_S:
                return MotionSetpoint(velocity_ned_m_s=ZERO3)
            self._held = position
        cruise = self.speeds.horizontal
        return MotionSetpoint(self._held, yaw_rad=self.held_yaw_rad, horizontal_speed_m_s=cruise)

    def _take_off(self, position: Vector3) -> tuple[MotionSetpoint, Task | None]:
        if self._held is None:
            self._held = position
        north, east, _ = self._held
        down = self.home_ned_m[2] - self.climb_to_m
        climb = self._parameters.si(self._parameter_map.take_off_speed)
        if abs(position[2] - down) < _HEIGHT_REACHED_M:
            self._held, self._task = (north, east, down), Task.HOLD
            return MotionSetpoint(position_ned_m=self._held, climb_speed_m_s=climb), Task.HOLD
        return MotionSetpoint((north, east, down), climb_speed_m_s=climb), None

    def _go(self, position: Vector3) -> MotionSetpoint:
        return self.towards(self.target_ned_m, position, self.target_speed_m_s, self.target_yaw_rad)

    def _land(self, position: Vector3, velocity: Vector3) -> MotionSetpoint:
        if self._held is None and math.hypot(velocity[0], velocity[1]) < _STOPPED_M_S:
            self._held = position
        speed = self.landing_speed(position)
        if self._held is None:
            return MotionSetpoint(velocity_ned_m_s=(0.0, 0.0, speed))
        north, east, _ = self._held
        return MotionSetpoint((north, east, nan), (nan, nan, speed))

    def _descend(self) -> MotionSetpoint:
        """Level, without position hold, descending at the landing speed."""
        speed = self._parameters.si(self._parameter_map.landing_speed)
        return MotionSetpoint(velocity_ned_m_s=(nan, nan, speed), acceleration_ned_m_s2=(0.0, 0.0, nan))

    def _return(self, position: Vector3, velocity: Vector3) -> tuple[MotionSetpoint, Task | None]:
        north, east, ground = self.home_ned_m
        if self._held is None:
            height = self._parameters.si(self._parameter_map.return_height)
            self._held = (position[0], position[1], min(position[2], ground - height))
        away = math.hypot(north - position[0], east - position[1])
        if away < _HOME_REACHED_M and math.hypot(velocity[0], velocity[1]) < _HOME_SPEED_M_S:
            return self.towards((north, east, self._held[2]), position), Task.LAND
        if position[2] - self._held[2] > 0.5:
            return MotionSetpoint(self._held), None
        return self.towards((north, east, self._held[2]), position), None
