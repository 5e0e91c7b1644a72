"""RC input: channels or a ground station's joystick, and the setpoints that the sticks mean.

Sticks are -1..1: roll right, pitch forward, throttle up (0: middle), yaw clockwise. Channels are in
microseconds, ordered roll, pitch, throttle, yaw, then switches. Without RC input since boot there is no RC
loss: a simulator is flown without. Sources: MAVLink RC_CHANNELS_OVERRIDE and MANUAL_CONTROL; PX4's and
ArduPilot's stick mapping in outline (dead band, full scale), without their expo and smoothing.

Manual control in the flight loop: RC availability, RC loss, and the setpoints of the sticks.
"""

import math
from dataclasses import dataclass
from math import inf, nan

from companion.base.geometry import Vector3, quat_from_euler, rotate_yaw, wrap_angle
from sitl.autopilot.control.setpoints import AttitudeSetpoint, MotionSetpoint
from sitl.autopilot.flight.modes import Mode, StickMode, Task, VehicleStatus
from sitl.autopilot.flight.profile import AutopilotProfile, Parameters

CHANNELS = 18
_MIDDLE_US, _SPAN_US = 1500, 500
_DEAD_BAND = 0.1
_RAISED = 0.1


@dataclass(frozen=True, slots=True)
class Sticks:
    """The four axes, -1..1."""

    roll: float = 0.0
    pitch: float = 0.0
    throttle: float = 0.0
    yaw: float = 0.0

    @property
    def throttle_is_up(self) -> bool:
        return self.throttle > _RAISED


class RcInput:
    """The last RC input and its time."""

    def __init__(self, pitch_channel_reversed: bool) -> None:
        self._pitch_sign = -1.0 if pitch_channel_reversed else 1.0
        self._heard_s = -inf
        self._channels = [0] * CHANNELS
        self._sticks: Sticks | None = None

    @property
    def channels(self) -> list[int] | None:
        """The 18 channels (microseconds, 0: none), None without RC input."""
        return None if self._sticks is None else list(self._channels)

    def override(self, values: list[int | None], now_s: float) -> None:
        """RC_CHANNELS_OVERRIDE: 18 values; 0 releases a channel, None leaves it as it is."""
        for index, value in enumerate(values[:CHANNELS]):
            if value is not None:
                self._channels[index] = value
        if not any(self._channels):
            self._sticks = None  # released: as if RC input had never been received
            return
        roll, pitch, throttle, yaw = (_axis(value) for value in self._channels[:4])
        self._sticks, self._heard_s = Sticks(roll, self._pitch_sign * pitch, throttle, yaw), now_s

    def manual(self, sticks: Sticks, now_s: float) -> None:
        """MANUAL_CONTROL: a joystick."""
        self._sticks, self._heard_s = sticks, now_s
        axes = (sticks.roll, self._pitch_sign * sticks.pitch, sticks.throttle, sticks.yaw)
        self._channels[:4] = [round(_MIDDLE_US + _SPAN_US * axis) for axis in axes]

    def sticks(self, now_s: float, timeout_s: float) -> Sticks | None:
        """The last sticks, None when they are older than the time-out or were never received."""
        return self._sticks if now_s - self._heard_s <= timeout_s else None

    def lost(self, now_s: float, timeout_s: float) -> bool:
        return self._sticks is not None and now_s - self._heard_s > timeout_s


def _axis(channel_us: int) -> float:
    """-1..1 of a channel; a missing one is centred."""
    return 0.0 if channel_us == 0 else min(max((channel_us - _MIDDLE_US) / _SPAN_US, -1.0), 1.0)


def _outside_band(axis: float) -> float:
    """The stick beyond its dead band, stretched to -1..1 again."""
    beyond = max(0.0, abs(axis) - _DEAD_BAND) / (1.0 - _DEAD_BAND)
    return math.copysign(beyond, axis) if beyond else 0.0


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
        self._heading_rad = nan  # held while the yaw stick is centred; NaN: the sticks do not fly

    def watch(self, now: VehicleStatus, task: Task, now_s: float) -> None:
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
        self.stick_mode = None
        sticks = None if mode.sticks is None else self._sticks(now_s)
        if mode.sticks is None or sticks is None:
            self._heading_rad = nan
            return None
        setpoint = self._by_sticks(mode.sticks, sticks, heading_rad, dt_s)
        if setpoint is not None:
            self.stick_mode = mode.sticks
        return setpoint

    def _sticks(self, now_s: float) -> Sticks | None:
        return self.rc_input.sticks(now_s, self._timeout_s())

    def _timeout_s(self) -> float:
        """RC loss time-out; a negative one is none."""
        timeout_s = self._parameters.si(self._parameter_map.rc_timeout)
        return timeout_s if timeout_s >= 0.0 else inf

    def _by_sticks(
        self, stick_mode: StickMode, sticks: Sticks, heading_rad: float, dt_s: float
    ) -> MotionSetpoint | AttitudeSetpoint | None:
        """The sticks' setpoint; None when they are centred in a mode that then holds position."""
        parameter_map, si = self._parameter_map, self._parameters.si
        yaw_rate = si(parameter_map.stick_yaw_rate) * _outside_band(sticks.yaw)
        if stick_mode is not StickMode.VELOCITY:
            return self._tilt(stick_mode, sticks, heading_rad, yaw_rate, dt_s)
        forward, right = _outside_band(sticks.pitch), _outside_band(sticks.roll)
        climb = _outside_band(sticks.throttle)
        if not (forward or right or climb or yaw_rate):
            return None
        down = -climb * si(parameter_map.stick_climb if climb > 0.0 else parameter_map.stick_descent)
        speed_m_s = si(parameter_map.stick_speed)
        level: Vector3 = (speed_m_s * forward, speed_m_s * right, down)
        return MotionSetpoint(
            velocity_ned_m_s=rotate_yaw(level, heading_rad),
            yaw_rate_rad_s=yaw_rate,
            horizontal_speed_m_s=speed_m_s,
        )

    def _tilt(
        self, stick_mode: StickMode, sticks: Sticks, heading_rad: float, yaw_rate: float, dt_s: float
    ) -> AttitudeSetpoint:
        if yaw_rate or math.isnan(self._heading_rad):
            self._heading_rad = wrap_angle(heading_rad + yaw_rate * dt_s)
        tilt_rad = self._parameters.si(self._parameter_map.stick_tilt)
        attitude = quat_from_euler(tilt_rad * sticks.roll, -tilt_rad * sticks.pitch, self._heading_rad)
        if stick_mode is StickMode.ANGLE_AND_CLIMB:
            thrust = 0.5 + 0.5 * _outside_band(sticks.throttle)
        else:
            up, hover = sticks.throttle, self._hover
            thrust = hover * (1.0 + up) + max(up, 0.0) * (1.0 - 2.0 * hover)
        return AttitudeSetpoint(attitude, thrust, yaw_rate)
