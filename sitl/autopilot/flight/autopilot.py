"""The simulated flight controller's interface for its MAVLink endpoint: commands and streamed setpoints.

Commands are method calls that return a MAV_RESULT; texts for the ground are in `take_texts`. SI units.
"""

from __future__ import annotations

import dataclasses
from math import inf, isfinite, isnan, nan

from companion.base.geometry import Vector3, yaw_from_quat
from sitl.autopilot.control.setpoints import (
    OVER_HOME,
    AttitudeSetpoint,
    MotionSetpoint,
    SetpointRefusal,
    StreamedAttitude,
    StreamedMotion,
)
from sitl.autopilot.flight.flight import FlightLoop
from sitl.autopilot.flight.landing_target import LandingTarget
from sitl.autopilot.flight.mission import heading_from_condition
from sitl.autopilot.flight.modes import CommandResult, Severity, Task
from sitl.autopilot.flight.sticks import Sticks

_LEAST_TAKE_OFF_M = 0.5
_MOST_ALTITUDE_M = 30_000.0


class SimulatedAutopilot(FlightLoop):
    """The flight loop with its commands."""

    # ------------------------------------------------------------ commands

    def arm(self, force: bool = False) -> CommandResult:
        """Arm; refused with a text before alignment, when tilting, or in a mode that lands."""
        if "arm" in self.refused:
            return self.profile.refused_arming
        return self._commander.arm(force)

    def disarm(self, force: bool = False) -> CommandResult:
        """Disarm; refused in flight unless forced."""
        if "disarm" in self.refused:
            return self.profile.refused_disarming
        return self._commander.disarm(force)

    def set_mode(self, custom_mode: int) -> CommandResult:
        """Change to the mode of that custom_mode."""
        return self._change_mode(self.profile.mode_by_number(custom_mode), custom_mode)

    def take_off(self, altitude_m: float) -> CommandResult:
        """NAV_TAKEOFF.

        PX4 takes an altitude above sea level, NaN or too low a one meaning MIS_TAKEOFF_ALT; ArduPilot
        takes one over home, in GUIDED, armed, from the ground.
        """
        if "take_off" in self.refused:
            return CommandResult.TEMPORARILY_REJECTED
        if self.profile.take_off_needs_guided:
            if self.mode != self.profile.take_off_mode or not self.armed or not self._cascade.landed:
                return CommandResult.FAILED
            if not _LEAST_TAKE_OFF_M <= altitude_m <= _MOST_ALTITUDE_M:
                return CommandResult.FAILED
            self._navigator.climb_to_m = altitude_m
            self._commander.begin(Task.TAKE_OFF)
            return CommandResult.ACCEPTED
        if not self._cascade.landed:
            return self.set_mode_named(self.profile.hold_mode)
        height = altitude_m - self.geodetic(self._navigator.home_ned_m)[2]
        if self.profile.parameter_map.take_off_height and not _LEAST_TAKE_OFF_M <= height <= _MOST_ALTITUDE_M:
            height = self.parameters.si(self.profile.parameter_map.take_off_height)
            self._commander.send_text(Severity.INFO, f"Using default takeoff altitude: {height:.2f} m")
        self._navigator.climb_to_m = height
        return self.set_mode_named(self.profile.take_off_mode)

    def go_to(
        self, place: Vector3, over_home: bool, yaw_rad: float = nan, speed_m_s: float | None = None
    ) -> CommandResult:
        """DO_REPOSITION: fly to latitude, longitude and altitude (over home, or above sea level), and hold.

        NaN keeps the present latitude and longitude, or altitude; a NaN yaw keeps the heading.
        """
        if not self.armed or self._cascade.landed or not _is_place(place):
            return CommandResult.DENIED
        result = self.set_mode_named(self.profile.after_take_off_mode)
        if result is CommandResult.ACCEPTED:
            self._navigator.target_ned_m = self._local(place, over_home)
            self._navigator.target_yaw_rad = yaw_rad if isfinite(yaw_rad) else nan
            self._navigator.target_speed_m_s = speed_m_s
            self._commander.begin(Task.GO_TO)
        return result

    def go_to_where_guided(self, place: Vector3, over_home: bool) -> bool:
        """A waypoint with current = 2: `go_to`, in the mode that takes such orders; whether it does."""
        takes_orders = self.mode == self.profile.after_take_off_mode
        return takes_orders and self.go_to(place, over_home) is CommandResult.ACCEPTED

    def precision_land(self) -> CommandResult:
        """NAV_PRECLAND, where there is a mode for it."""
        mode = next((mode for mode in self.profile.modes if mode.task is Task.PRECISION_LAND), None)
        return CommandResult.UNSUPPORTED if mode is None else self._change_mode(mode)

    def change_speed(self, kind: int, speed_m_s: float) -> CommandResult:
        """DO_CHANGE_SPEED."""
        if not self._navigator.speeds.change(kind, speed_m_s):
            return CommandResult.DENIED
        if self.task is Task.GO_TO and kind in (0, 1) and speed_m_s > 0.0:
            self._navigator.target_speed_m_s = speed_m_s
        return CommandResult.ACCEPTED

    def turn_to(self, parameters: tuple[float, ...]) -> CommandResult:
        """CONDITION_YAW while it holds a place or flies to one; parameters 1 to 4 of the command."""
        heading = heading_from_condition(parameters, yaw_from_quat(self.estimate.attitude))
        if heading is None or not self.armed or self.task not in (Task.HOLD, Task.GO_TO):
            return CommandResult.FAILED
        self._navigator.target_yaw_rad = self._navigator.held_yaw_rad = heading
        return CommandResult.ACCEPTED

    def set_home(self, place: Vector3 | None, over_home: bool = False) -> CommandResult:
        """DO_SET_HOME to a place (deg, deg, m), None: to where the vehicle is; denied when too far away."""
        if not self.aligned:
            return CommandResult.FAILED
        home = self.estimate.position_ned_m if place is None else self._local(place, over_home)
        return CommandResult.ACCEPTED if self._navigator.fix_home(home) else CommandResult.DENIED

    def terminate(self) -> CommandResult:
        """Flight termination: motors off."""
        self._commander.terminate()
        return CommandResult.ACCEPTED

    def reboot(self) -> CommandResult:
        """Reboot on the ground, as after power-up; parameters and mission stay. Refused while armed."""
        if self.armed:
            return self.profile.refused_arming
        self._boot()
        return CommandResult.ACCEPTED

    def recover(self, now_s: float) -> None:
        """A watchdog's reset: the motors stay on, the time since boot begins again, and it holds."""
        self.booted_s, self._setpoint, self._setpoint_s = now_s, None, -inf
        self._commander.recover()

    def send_text(self, severity: Severity, text: str) -> None:
        """Queue a STATUSTEXT."""
        self._commander.send_text(severity, text)

    # ------------------------------------------------------------ missions

    def start_mission(self, first: int = -1) -> CommandResult:
        """MISSION_START; PX4 arms for it, ArduPilot has to be armed."""
        if not self.mission.flyable or (first >= 0 and not self.mission.select(first)):
            self._commander.send_text(Severity.CRITICAL, self.profile.texts.no_mission)
            return self.profile.refused_mode
        mode = next(mode for mode in self.profile.modes if mode.task is Task.MISSION)
        waits = self.profile.mission.waits_for_start
        if waits and not self.armed:
            return CommandResult.FAILED
        result = self._change_mode(mode)
        if result is CommandResult.ACCEPTED and not waits:
            result = self.arm()
        if result is CommandResult.ACCEPTED:
            self._runner.started = True
        return result

    def select_mission_item(self, number: int) -> CommandResult:
        """DO_SET_MISSION_CURRENT."""
        return CommandResult.ACCEPTED if self.mission.select(number) else self.profile.refused_selection

    def land_by_mission(self) -> CommandResult:
        """DO_LAND_START: continue with the mission's item of that command."""
        number = self.mission.landing_start()
        return CommandResult.FAILED if number is None else self.start_mission(number)

    def pause(self, paused: bool) -> CommandResult:
        """DO_PAUSE_CONTINUE: hold within a mission, and go on with it."""
        if self.task is not Task.MISSION:
            return CommandResult.DENIED
        self._runner.paused = paused
        return CommandResult.ACCEPTED

    # ------------------------------------------------------------ sticks and targets

    def override_rc_channels(self, values: list[int | None], sender_system: int, now_s: float) -> None:
        """RC_CHANNELS_OVERRIDE (microseconds, 0 releases, None keeps), from a permitted system."""
        if self._may_control_manually(sender_system):
            self.rc_input.override(values, now_s)

    def set_manual_control(self, sticks: Sticks, sender_system: int, now_s: float) -> None:
        """MANUAL_CONTROL, from a permitted system."""
        if self._may_control_manually(sender_system):
            self.rc_input.manual(sticks, now_s)

    def handle_landing_target(self, target: LandingTarget) -> None:
        """LANDING_TARGET."""
        if self._precision_landing is not None:
            self._precision_landing.update_target(target)

    def _may_control_manually(self, sender_system: int) -> bool:
        own = self.profile.parameter_map.gcs_system_id
        return own is None or sender_system == int(self.parameters.si(own))

    # ------------------------------------------------------------ streamed setpoints

    def stream_fields(self, fields: StreamedMotion, now_s: float) -> None:
        """SET_POSITION_TARGET_LOCAL_NED: flown, rejected with a text, or ignored, as the autopilot does."""
        estimate = self.estimate
        heading = yaw_from_quat(estimate.attitude)
        wish = self.profile.read_motion(fields, estimate.position_ned_m, estimate.attitude, heading)
        if isinstance(wish, MotionSetpoint):
            top_speed = self.parameters.si(self.profile.parameter_map.top_speed)
            wish = dataclasses.replace(wish, horizontal_speed_m_s=top_speed)
        self._take(wish, now_s)

    def stream_global(self, fields: StreamedMotion, place: Vector3, now_s: float) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT: as local fields, but the position is a geodetic place."""
        local = self._local(place, fields.frame in OVER_HOME)
        self.stream_fields(dataclasses.replace(fields, is_global=True, position_m=local), now_s)

    def stream_attitude(self, fields: StreamedAttitude, now_s: float) -> None:
        """SET_ATTITUDE_TARGET."""
        self._take(self.profile.read_attitude(fields), now_s)

    def _take(self, wish: MotionSetpoint | AttitudeSetpoint | SetpointRefusal, now_s: float) -> None:
        if isinstance(wish, SetpointRefusal):
            self._commander.send_text(Severity.CRITICAL, wish.text)
        else:
            self.stream(wish, now_s)

    def stream(self, setpoint: MotionSetpoint | AttitudeSetpoint, now_s: float) -> None:
        """Take a streamed setpoint: stored always, flown in OFFBOARD or GUIDED only."""
        mode, moves = self._commander.mode, isinstance(setpoint, MotionSetpoint)
        if isinstance(setpoint, MotionSetpoint):
            setpoint = dataclasses.replace(setpoint, streamed=True)
        self._setpoint, self._setpoint_s = setpoint, now_s
        self._commander.situation.setpoint_age_s = 0.0
        if mode.by_attitude and moves:
            self._commander.begin(mode.task)
        elif mode.takes_setpoints and (mode.by_attitude or not self._cascade.landed):
            self._commander.begin(Task.SETPOINT)


def _is_place(place: Vector3) -> bool:
    """Latitude, longitude and altitude within their ranges; NaN means the present one."""
    return all(
        isnan(value) or abs(value) <= most
        for value, most in zip(place, (90.0, 180.0, _MOST_ALTITUDE_M), strict=True)
    )
