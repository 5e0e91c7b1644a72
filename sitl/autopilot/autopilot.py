"""The simulated flight controller as its MAVLink endpoint sees it: commands and streamed setpoints.

Commands are method calls that answer with a MAV_RESULT; what it has to say is in `take_texts`. SI units.
"""

from __future__ import annotations

import dataclasses
from math import isfinite, nan

from companion.geometry import Vector3, ned_from_geodetic, yaw_from_quat
from sitl.autopilot.flight import FlightLoop
from sitl.autopilot.modes import Result, Severity, Task
from sitl.autopilot.setpoints import (
    OVER_HOME,
    AttitudeSetpoint,
    MotionSetpoint,
    Refusal,
    StreamedAttitude,
    StreamedMotion,
)

_LEAST_TAKE_OFF_M = 0.5


class Autopilot(FlightLoop):
    """The flight loop, and what may be asked of it."""

    # ------------------------------------------------------------ commands

    def arm(self, force: bool = False) -> Result:
        """Arm; refused with a text before alignment, when leaning, or in a mode that lands."""
        return self._commander.arm(force)

    def disarm(self, force: bool = False) -> Result:
        """Disarm; refused in flight unless forced."""
        return self._commander.disarm(force)

    def set_mode(self, custom_mode: int) -> Result:
        """Change to the mode of that custom_mode."""
        return self._commander.change_mode(self.manner.mode_by_number(custom_mode))

    def take_off(self, altitude_m: float) -> Result:
        """NAV_TAKEOFF.

        PX4 takes an altitude above sea level, NaN or too low a one meaning MIS_TAKEOFF_ALT; ArduPilot
        takes one over home, in GUIDED, armed, from the ground.
        """
        if self.manner.take_off_needs_guided:
            if self.mode != self.manner.take_off_mode or not self.armed or not self._cascade.landed:
                return Result.FAILED
            if not altitude_m >= _LEAST_TAKE_OFF_M:
                return Result.FAILED
            self._navigator.climb_to_m = altitude_m
            self._commander.begin(Task.TAKE_OFF)
            return Result.ACCEPTED
        if not self._cascade.landed:
            return self.set_mode_named(self.manner.hold_mode)
        height = altitude_m - self.geodetic(self._navigator.home_ned_m)[2]
        if self.manner.settings.take_off_height and not height >= _LEAST_TAKE_OFF_M:
            height = self.parameters.si(self.manner.settings.take_off_height)
            self._commander.say(Severity.INFO, f"Using default takeoff altitude: {height:.2f} m")
        self._navigator.climb_to_m = height
        return self.set_mode_named(self.manner.take_off_mode)

    def go_to(
        self, place: Vector3, over_home: bool, yaw_rad: float = nan, speed_m_s: float | None = None
    ) -> Result:
        """DO_REPOSITION: fly to latitude, longitude and altitude (over home, or above sea level), and hold.

        NaN keeps the present latitude and longitude, or altitude.
        """
        if not self.armed or self._cascade.landed:
            return Result.DENIED
        result = self.set_mode_named(self.manner.after_take_off_mode)
        if result is Result.ACCEPTED:
            self._navigator.target_ned_m = self._local(place, over_home)
            self._navigator.target_yaw_rad = yaw_rad
            self._navigator.target_speed_m_s = speed_m_s
            self._commander.begin(Task.GO_TO)
        return result

    def _local(self, place: Vector3, over_home: bool) -> Vector3:
        """Place in the own NED; a coordinate that is no number is the present one."""
        latitude, longitude, altitude = self.geodetic(self.estimate.position_ned_m)
        if isfinite(place[0]) and isfinite(place[1]):
            latitude, longitude = place[0], place[1]
        if isfinite(place[2]):
            altitude = place[2] + (self.geodetic(self.home_ned_m)[2] if over_home else 0.0)
        return ned_from_geodetic(latitude, longitude, altitude, self._origin)

    # ------------------------------------------------------------ streamed setpoints

    def stream_fields(self, fields: StreamedMotion, now_s: float) -> None:
        """SET_POSITION_TARGET_LOCAL_NED: obeyed, answered by a text, or passed over, as the manner has it."""
        estimate = self.estimate
        heading = yaw_from_quat(estimate.attitude)
        wish = self.manner.read_motion(fields, estimate.position_ned_m, estimate.attitude, heading)
        if isinstance(wish, MotionSetpoint):
            top_speed = self.parameters.si(self.manner.settings.top_speed)
            wish = dataclasses.replace(wish, horizontal_speed_m_s=top_speed)
        self._take(wish, now_s)

    def stream_global(self, fields: StreamedMotion, place: Vector3, now_s: float) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT: as local fields, but the position is a geodetic place."""
        local = self._local(place, fields.frame in OVER_HOME)
        self.stream_fields(dataclasses.replace(fields, is_global=True, position_m=local), now_s)

    def stream_attitude(self, fields: StreamedAttitude, now_s: float) -> None:
        """SET_ATTITUDE_TARGET."""
        self._take(self.manner.read_attitude(fields), now_s)

    def _take(self, wish: MotionSetpoint | AttitudeSetpoint | Refusal, now_s: float) -> None:
        if isinstance(wish, Refusal):
            self._commander.say(Severity.CRITICAL, wish.text)
        else:
            self.stream(wish, now_s)

    def stream(self, setpoint: MotionSetpoint | AttitudeSetpoint, now_s: float) -> None:
        """Take a streamed setpoint: kept always, flown in OFFBOARD or GUIDED only."""
        if isinstance(setpoint, MotionSetpoint):
            setpoint = dataclasses.replace(setpoint, streamed=True)
        self._setpoint, self._setpoint_s = setpoint, now_s
        self._commander.situation.setpoint_age_s = 0.0
        if self._commander.mode.takes_setpoints and not self._cascade.landed:
            self._commander.begin(Task.SETPOINT)
