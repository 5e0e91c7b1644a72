"""Flying by hand within the flight loop: who is at the sticks, when they are lost, and what they ask for."""

from __future__ import annotations

from math import inf

from sitl.autopilot.control.setpoints import AttitudeSetpoint, MotionSetpoint
from sitl.autopilot.flight.modes import Mode, StickMode, Task, VehicleStatus
from sitl.autopilot.flight.parameters import Parameters
from sitl.autopilot.flight.profile import AutopilotProfile
from sitl.autopilot.flight.sticks import RcInput, StickMapper, Sticks, StickScales

# bits of the parameter that says in which tasks a lost radio is of no matter, and tasks where it never is
_EXCEPTIONS = {Task.MISSION: 1, Task.HOLD: 2, Task.GO_TO: 2, Task.SETPOINT: 4}
_NOT_NEEDED = (Task.LAND, Task.PRECISION_LAND, Task.RETURN)


class ManualControl:
    """The radio and the pilot; `law` is what the sticks mean at present, None when they fly nothing."""

    def __init__(self, manner: AutopilotProfile, parameters: Parameters, hover_thrust: float) -> None:
        self.radio = RcInput(manner.forward_is_low)
        self.law: StickMode | None = None
        self._settings = manner.settings
        self._parameters = parameters
        self._hover = hover_thrust
        self._pilot = StickMapper()

    def watch(self, now: VehicleStatus, task: Task, now_s: float) -> None:
        """Tell the situation who is at the sticks."""
        sticks = self._sticks(now_s)
        now.radio = sticks is not None
        now.throttle_up = sticks is not None and sticks.throttle_is_up
        settings, si = self._settings, self._parameters.si
        kept = 0 if settings.radio_exceptions is None else int(si(settings.radio_exceptions))
        excepted = task in _NOT_NEEDED or bool(kept & _EXCEPTIONS.get(task, 0))
        watched = settings.radio_watched is None or si(settings.radio_watched) > 0.0
        now.radio_lost = watched and not excepted and self.radio.lost(now_s, self._timeout_s())

    def setpoint(
        self, mode: Mode, heading_rad: float, now_s: float, dt_s: float
    ) -> MotionSetpoint | AttitudeSetpoint | None:
        """What the sticks ask for in a mode that is flown by them; None: nothing, hold."""
        self.law = None
        sticks = None if mode.sticks is None else self._sticks(now_s)
        if mode.sticks is None or sticks is None:
            self._pilot.rest()
            return None
        setpoint = self._pilot.setpoint(mode.sticks, sticks, self._scales(), heading_rad, dt_s)
        if setpoint is not None:
            self.law = mode.sticks
        return setpoint

    def _sticks(self, now_s: float) -> Sticks | None:
        return self.radio.sticks(now_s, self._timeout_s())

    def _timeout_s(self) -> float:
        """How long sticks are good for; a negative time-out is none."""
        timeout_s = self._parameters.si(self._settings.radio_timeout)
        return timeout_s if timeout_s >= 0.0 else inf

    def _scales(self) -> StickScales:
        settings, si = self._settings, self._parameters.si
        return StickScales(
            speed_m_s=si(settings.stick_speed),
            climb_m_s=si(settings.stick_climb),
            descent_m_s=si(settings.stick_descent),
            tilt_rad=si(settings.stick_tilt),
            yaw_rate_rad_s=si(settings.stick_yaw_rate),
            hover=self._hover,
        )
