"""COMMAND_LONG and COMMAND_INT to the simulated autopilot: one function per command, in a table.

Both kinds of message become a `CommandRequest`; the function's result is sent as COMMAND_ACK.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from companion.link.codec import Message, mavlink
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.autopilot.flight.manual_control import CHANNELS, Sticks
from sitl.autopilot.flight.modes import CommandResult
from sitl.autopilot.flight.profile import LandingTarget

if TYPE_CHECKING:
    from sitl.mavlink.endpoint import MavlinkEndpoint

FORCE_MAGIC: Final = 21196
_ARDUPILOT_FORCE_ARM: Final = 2989
_NOT_GIVEN_E7: Final = 0x7FFFFFFF
_OVER_HOME: Final = {mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT}
_POSITION_OF_LONG: Final = mavlink.MAV_FRAME_GLOBAL
_GLOBAL_FRAMES: Final = _OVER_HOME | {mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT}
_REBOOT: Final = (1, 3)  # 3 stays in the boot loader, which is not simulated
# x and y of COMMAND_INT are degrees times 1e7 for these, plain numbers for all others
_WITH_PLACE: Final = {
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_NAV_LAND,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM,
    mavlink.MAV_CMD_DO_REPOSITION,
    mavlink.MAV_CMD_DO_SET_HOME,
    mavlink.MAV_CMD_DO_LAND_START,
}
_NAV_PRECLAND: Final = 23  # PX4's own, where MAVLink's dialects have NAV_LAND_LOCAL


@dataclass(frozen=True, slots=True)
class CommandRequest:
    """A command: its number, parameters 1 to 7 (latitude and longitude in degrees), frame."""

    command: int
    parameters: tuple[float, float, float, float, float, float, float]
    frame: int

    def whole(self, index: int) -> int:
        """Parameter 1..7 as an integer, -1 when it does not fit into 32 bits."""
        value = self.parameters[index - 1]
        return int(value) if abs(value) < _NOT_GIVEN_E7 else -1

    def place(self) -> tuple[float, float, float]:
        """Parameters 5 to 7: latitude, longitude (deg), altitude (m)."""
        _, _, _, _, latitude, longitude, altitude = self.parameters
        return latitude, longitude, altitude


def request_from_message(message: Any) -> CommandRequest:
    """The request in a COMMAND_LONG or COMMAND_INT."""
    m = message
    first = (m.param1, m.param2, m.param3, m.param4)
    if m.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
        return CommandRequest(m.command, (*first, m.param5, m.param6, m.param7), _POSITION_OF_LONG)
    scale = 1e-7 if m.command in _WITH_PLACE else 1.0
    latitude, longitude = (math.nan if e7 == _NOT_GIVEN_E7 else e7 * scale for e7 in (m.x, m.y))
    return CommandRequest(m.command, (*first, latitude, longitude, m.z), m.frame)


def _arm_or_disarm(autopilot: SimulatedAutopilot, request: CommandRequest) -> CommandResult:
    force = request.whole(2) in (FORCE_MAGIC, _ARDUPILOT_FORCE_ARM)
    if request.parameters[0] == 1.0:
        return autopilot.arm(force)
    if request.parameters[0] == 0.0:
        return autopilot.disarm(force)
    return CommandResult.UNSUPPORTED


def _set_mode(autopilot: SimulatedAutopilot, request: CommandRequest) -> CommandResult:
    flags, main, sub = request.whole(1), request.whole(2), request.whole(3)
    if flags < 0 or not flags & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED or main < 0:
        return CommandResult.DENIED
    return autopilot.set_mode(autopilot.profile.custom_mode(main, max(sub, 0)))


def _reposition(autopilot: SimulatedAutopilot, request: CommandRequest) -> CommandResult:
    speed, yaw = request.parameters[0], request.parameters[3]
    if request.frame not in _GLOBAL_FRAMES:
        return CommandResult.DENIED
    changes_mode = request.whole(2) > 0 and request.whole(2) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
    if not changes_mode and autopilot.mode != autopilot.profile.after_take_off_mode:
        return CommandResult.DENIED
    return autopilot.go_to(
        request.place(),
        over_home=request.frame in _OVER_HOME,
        yaw_rad=yaw,
        speed_m_s=speed if math.isfinite(speed) and speed > 0.0 else None,
    )


def _pause(autopilot: SimulatedAutopilot, request: CommandRequest) -> CommandResult:
    if request.whole(1) not in (0, 1):
        return CommandResult.DENIED
    return autopilot.pause(request.whole(1) == 0)


def _turn(autopilot: SimulatedAutopilot, request: CommandRequest) -> CommandResult:
    if not autopilot.profile.turns_by_command:
        return CommandResult.UNSUPPORTED
    return autopilot.turn_to(request.parameters)


def _set_home(autopilot: SimulatedAutopilot, request: CommandRequest) -> CommandResult:
    if request.whole(1) == 1:
        return autopilot.set_home(None)
    latitude, longitude, altitude = request.place()
    usable = abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and abs(altitude) < 1e5
    if not usable or request.frame not in _GLOBAL_FRAMES:
        return CommandResult.DENIED
    return autopilot.set_home((latitude, longitude, altitude), request.frame in _OVER_HOME)


def _enable_fence(autopilot: SimulatedAutopilot, request: CommandRequest) -> CommandResult:
    switch = autopilot.profile.parameter_map.fence_enabled
    if switch is None:
        return CommandResult.UNSUPPORTED
    accepted = autopilot.parameters.set(switch.name, request.parameters[0])
    return CommandResult.ACCEPTED if accepted else CommandResult.FAILED


def _store_parameters(autopilot: SimulatedAutopilot, request: CommandRequest) -> CommandResult:
    """PREFLIGHT_STORAGE: 0 and 1 (load, save) have no effect here; 2 resets."""
    if autopilot.armed or request.whole(1) not in (0, 1, 2):
        return CommandResult.DENIED
    if request.whole(1) == 2:
        autopilot.parameters.reset()
    return CommandResult.ACCEPTED


def _request_message(link: MavlinkEndpoint, request: CommandRequest, now_s: float) -> CommandResult:
    if link.send_once(request.whole(1), now_s):
        return CommandResult.ACCEPTED
    return link.autopilot.profile.unsupported_request


def _set_interval(link: MavlinkEndpoint, request: CommandRequest, now_s: float) -> CommandResult:
    accepted = link.set_interval(request.whole(1), request.parameters[1])
    return CommandResult.ACCEPTED if accepted else CommandResult.FAILED


def _get_interval(link: MavlinkEndpoint, request: CommandRequest, now_s: float) -> CommandResult:
    link.send_message_interval(request.whole(1))
    return CommandResult.ACCEPTED


def _sender_of(message_id: int) -> Callable[[MavlinkEndpoint, CommandRequest, float], CommandResult]:
    def send(link: MavlinkEndpoint, request: CommandRequest, now_s: float) -> CommandResult:
        link.send_once(message_id, now_s)
        return CommandResult.ACCEPTED

    return send


Handler = Callable[[SimulatedAutopilot, CommandRequest], CommandResult]
HANDLERS: Final[dict[int, Handler]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm_or_disarm,
    mavlink.MAV_CMD_DO_SET_MODE: _set_mode,
    mavlink.MAV_CMD_NAV_TAKEOFF: lambda ap, request: ap.take_off(request.parameters[6]),
    mavlink.MAV_CMD_NAV_LAND: lambda ap, _: ap.set_mode_named(ap.profile.land_mode),
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda ap, _: ap.set_mode_named(ap.profile.return_mode),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda ap, _: ap.set_mode_named(ap.profile.hold_mode),
    mavlink.MAV_CMD_DO_REPOSITION: _reposition,
    mavlink.MAV_CMD_MISSION_START: lambda ap, request: ap.start_mission(max(request.whole(1), 0) or -1),
    mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: lambda ap, request: ap.select_mission_item(request.whole(1)),
    mavlink.MAV_CMD_DO_LAND_START: lambda ap, _: ap.land_by_mission(),
    mavlink.MAV_CMD_DO_PAUSE_CONTINUE: _pause,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: lambda ap, request: ap.change_speed(
        request.whole(1), request.parameters[1]
    ),
    mavlink.MAV_CMD_CONDITION_YAW: _turn,
    mavlink.MAV_CMD_DO_SET_HOME: _set_home,
    mavlink.MAV_CMD_DO_FENCE_ENABLE: _enable_fence,
    mavlink.MAV_CMD_DO_FLIGHTTERMINATION: lambda ap, request: (
        ap.terminate() if request.parameters[0] > 0.5 else CommandResult.DENIED
    ),
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: lambda ap, request: (
        ap.reboot() if request.whole(1) in _REBOOT else CommandResult.UNSUPPORTED
    ),
    mavlink.MAV_CMD_PREFLIGHT_STORAGE: _store_parameters,
    mavlink.MAV_CMD_RUN_PREARM_CHECKS: lambda ap, _: (
        CommandResult.TEMPORARILY_REJECTED if ap.armed else CommandResult.ACCEPTED
    ),
    _NAV_PRECLAND: lambda ap, _: ap.precision_land(),
}
# those that concern the link they come over
LINK_HANDLERS: Final[dict[int, Callable[[MavlinkEndpoint, CommandRequest, float], CommandResult]]] = {
    mavlink.MAV_CMD_REQUEST_MESSAGE: _request_message,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _sender_of(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION),
    mavlink.MAV_CMD_GET_HOME_POSITION: _sender_of(mavlink.MAVLINK_MSG_ID_HOME_POSITION),
}


def execute(link: MavlinkEndpoint, request: CommandRequest, now_s: float) -> CommandResult:
    if (handler := HANDLERS.get(request.command)) is not None:
        return handler(link.autopilot, request)
    of_link = LINK_HANDLERS.get(request.command)
    return CommandResult.UNSUPPORTED if of_link is None else of_link(link, request, now_s)


# ---------------------------------------------------------------- pilot inputs
# Each handler takes (autopilot, message, now_s); invalid values are ignored.


_LEAVE: Final = 0xFFFF
_RELEASE_UPPER: Final = 0xFFFE
_FULL: Final = 1000
_NOT_GIVEN: Final = 0x7FFF


def channels_overridden(autopilot: SimulatedAutopilot, m: Message, now_s: float) -> None:
    """RC_CHANNELS_OVERRIDE: 0 releases channels 1 to 8 and leaves 9 to 18, 65534 releases these."""
    values: list[int | None] = []
    for number in range(1, CHANNELS + 1):
        raw = getattr(m, f"chan{number}_raw")
        leaves = raw == _LEAVE or (number > 8 and raw == 0)
        values.append(None if leaves else 0 if number > 8 and raw == _RELEASE_UPPER else raw)
    autopilot.override_rc_channels(values, m.get_srcSystem(), now_s)


def manually_controlled(autopilot: SimulatedAutopilot, m: Message, now_s: float) -> None:
    """MANUAL_CONTROL: x forward, y right, r clockwise (-1000..1000), z throttle (0..1000, 500 the middle)."""
    axes = [0 if value == _NOT_GIVEN else value for value in (m.y, m.x, 2 * m.z - _FULL, m.r)]
    roll, pitch, throttle, yaw = (min(max(axis / _FULL, -1.0), 1.0) for axis in axes)
    if m.z == _NOT_GIVEN:
        throttle = 0.0
    autopilot.set_manual_control(Sticks(roll, pitch, throttle, yaw), m.get_srcSystem(), now_s)


def target_seen(autopilot: SimulatedAutopilot, m: Message, now_s: float) -> None:
    """LANDING_TARGET: the position if position_valid is 1, else the angles."""
    position = (m.x, m.y, m.z) if m.position_valid == 1 else None
    numbers = (m.angle_x, m.angle_y, m.distance) if position is None else (*position, m.distance)
    if not all(math.isfinite(number) and abs(number) < 1e6 for number in numbers):
        return
    autopilot.handle_landing_target(
        LandingTarget(m.frame, position, (m.angle_x, m.angle_y), max(m.distance, 0.0))
    )


PilotInputHandler = Callable[[SimulatedAutopilot, Message, float], None]
PILOT_INPUTS: Final[dict[int, PilotInputHandler]] = {
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE: channels_overridden,
    mavlink.MAVLINK_MSG_ID_MANUAL_CONTROL: manually_controlled,
    mavlink.MAVLINK_MSG_ID_LANDING_TARGET: target_seen,
}
