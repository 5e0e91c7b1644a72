"""Manual control in the flight loop: RC availability, RC loss, and the setpoints of the sticks."""

from __future__ import annotations

from math import inf

from sitl.autopilot.control.setpoints import AttitudeSetpoint, MotionSetpoint
from sitl.autopilot.flight.modes import Mode, StickMode, Task, VehicleStatus
from sitl.autopilot.flight.parameters import Parameters
from sitl.autopilot.flight.profile import AutopilotProfile
from sitl.autopilot.flight.sticks import RcInput, StickMapper, Sticks, StickScales

# bits of the parameter that excepts tasks from the RC loss failsafe, and tasks that are always excepted
_EXCEPTIONS = {Task.MISSION: 1, Task.HOLD: 2, Task.GO_TO: 2, Task.SETPOINT: 4}
_NOT_NEEDED = (Task.LAND, Task.PRECISION_LAND, Task.RETURN)


class ManualControl:
    """RC input and stick mapping; `stick_mode` is what the sticks mean at present, None when they fly
    nothing."""

    def __init__(self, profile: AutopilotProfile, parameters: Parameters, hover_thrust: float) -> None:
        self.rc_input = RcInput(profile.pitch_channel_reversed)
        self.stick_mode: StickMode | None = None
        self._parameter_map = profile.parameter_map
        self._parameters = parameters
        self._hover = hover_thrust
        self._pilot = StickMapper()

    def watch(self, now: VehicleStatus, task: Task, now_s: float) -> None:
        """Update the RC fields of the vehicle status."""
        sticks = self._sticks(now_s)
        now.rc_available = sticks is not None
        now.throttle_up = sticks is not None and sticks.throttle_is_up
        parameter_map, si = self._parameter_map, self._parameters.si
        kept = 0 if parameter_map.rc_loss_exceptions is None else int(si(parameter_map.rc_loss_exceptions))
        excepted = task in _NOT_NEEDED or bool(kept & _EXCEPTIONS.get(task, 0))
        watched = parameter_map.rc_loss_enabled is None or si(parameter_map.rc_loss_enabled) > 0.0
        now.rc_lost = watched and not excepted and self.rc_input.lost(now_s, self._timeout_s())

    def setpoint(
        self, mode: Mode, heading_rad: float, now_s: float, dt_s: float
    ) -> MotionSetpoint | AttitudeSetpoint | None:
        """The sticks' setpoint in a manual mode; None: hold."""
        self.stick_mode = None
        sticks = None if mode.sticks is None else self._sticks(now_s)
        if mode.sticks is None or sticks is None:
            self._pilot.rest()
            return None
        setpoint = self._pilot.setpoint(mode.sticks, sticks, self._scales(), heading_rad, dt_s)
        if setpoint is not None:
            self.stick_mode = mode.sticks
        return setpoint

    def _sticks(self, now_s: float) -> Sticks | None:
        return self.rc_input.sticks(now_s, self._timeout_s())

    def _timeout_s(self) -> float:
        """RC loss time-out; a negative one is none."""
        timeout_s = self._parameters.si(self._parameter_map.rc_timeout)
        return timeout_s if timeout_s >= 0.0 else inf

    def _scales(self) -> StickScales:
        parameter_map, si = self._parameter_map, self._parameters.si
        return StickScales(
            speed_m_s=si(parameter_map.stick_speed),
            climb_m_s=si(parameter_map.stick_climb),
            descent_m_s=si(parameter_map.stick_descent),
            tilt_rad=si(parameter_map.stick_tilt),
            yaw_rate_rad_s=si(parameter_map.stick_yaw_rate),
            hover=self._hover,
        )
