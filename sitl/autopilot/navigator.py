"""From a task to a motion setpoint: hold, climb, go, land, return.

NED in the autopilot's own frame, SI units. Targets are kept here; which task is on is the commander's.
"""

from __future__ import annotations

import math
from math import nan

from companion.geometry import ZERO3, Vector3
from sitl.autopilot.manners import Manner
from sitl.autopilot.modes import Task
from sitl.autopilot.setpoints import MotionSetpoint
from sitl.parameters import Parameters

TAKE_OFF_SPEED_M_S = 1.5
FINAL_LANDING_SPEED_M_S = 0.5
_FINAL_HEIGHT_M = 2.0
_HEIGHT_REACHED_M = 0.2
_HOME_REACHED_M = 0.8
_HOME_SPEED_M_S = 0.4
_STOPPED_M_S = 0.25


class Navigator:
    """Targets of the tasks, and the setpoint of each outer step."""

    def __init__(self, manner: Manner, parameters: Parameters) -> None:
        self._settings = manner.settings
        self._parameters = parameters
        self._held: Vector3 | None = None
        self._task = Task.HOLD
        self.home_ned_m = ZERO3
        self.climb_to_m = 0.0
        self.target_ned_m = ZERO3
        self.target_yaw_rad = nan
        self.target_speed_m_s: float | None = None

    def let_go(self) -> None:
        """Forget the held place: the next hold brakes and stays where it comes to rest."""
        self._held = None

    def step(self, task: Task, position: Vector3, velocity: Vector3) -> tuple[MotionSetpoint, Task | None]:
        """The setpoint for a task, and the task to go on with when this one is done."""
        if task is not self._task:
            self._task, self._held = task, None
        if task is Task.TAKE_OFF:
            return self._take_off(position)
        if task is Task.GO_TO:
            return self._go(self.target_ned_m), None
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
        return MotionSetpoint(position_ned_m=self._held, horizontal_speed_m_s=self._cruise())

    def _take_off(self, position: Vector3) -> tuple[MotionSetpoint, Task | None]:
        if self._held is None:
            self._held = position
        north, east, _ = self._held
        down = self.home_ned_m[2] - self.climb_to_m
        if abs(position[2] - down) < _HEIGHT_REACHED_M:
            self._held, self._task = (north, east, down), Task.HOLD
            return MotionSetpoint(position_ned_m=self._held, climb_speed_m_s=TAKE_OFF_SPEED_M_S), Task.HOLD
        return MotionSetpoint((north, east, down), climb_speed_m_s=TAKE_OFF_SPEED_M_S), None

    def _go(self, target: Vector3) -> MotionSetpoint:
        speed = self._cruise() if self.target_speed_m_s is None else self.target_speed_m_s
        return MotionSetpoint(target, yaw_rad=self.target_yaw_rad, horizontal_speed_m_s=speed)

    def _land(self, position: Vector3, velocity: Vector3) -> MotionSetpoint:
        if self._held is None and math.hypot(velocity[0], velocity[1]) < _STOPPED_M_S:
            self._held = position
        height = self.home_ned_m[2] - position[2]
        speed = self._parameters.si(self._settings.landing_speed)
        if height < _FINAL_HEIGHT_M:
            speed = min(speed, FINAL_LANDING_SPEED_M_S)
        if self._held is None:
            return MotionSetpoint(velocity_ned_m_s=(0.0, 0.0, speed))
        north, east, _ = self._held
        return MotionSetpoint((north, east, nan), (nan, nan, speed))

    def _descend(self) -> MotionSetpoint:
        """Level, without holding a place, down at the landing speed: nobody is at the sticks."""
        speed = self._parameters.si(self._settings.landing_speed)
        return MotionSetpoint(velocity_ned_m_s=(nan, nan, speed), acceleration_ned_m_s2=(0.0, 0.0, nan))

    def _return(self, position: Vector3, velocity: Vector3) -> tuple[MotionSetpoint, Task | None]:
        north, east, ground = self.home_ned_m
        if self._held is None:
            height = self._parameters.si(self._settings.return_height)
            self._held = (position[0], position[1], min(position[2], ground - height))
        away = math.hypot(north - position[0], east - position[1])
        if away < _HOME_REACHED_M and math.hypot(velocity[0], velocity[1]) < _HOME_SPEED_M_S:
            return self._go((north, east, self._held[2])), Task.LAND
        if position[2] - self._held[2] > 0.5:
            return MotionSetpoint(self._held), None
        return MotionSetpoint((north, east, self._held[2]), horizontal_speed_m_s=self._cruise()), None

    def _cruise(self) -> float:
        return self._parameters.si(self._settings.cruise_speed)
