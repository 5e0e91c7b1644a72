"""Commands to the autopilot and its parameters: sent, acknowledged, repeated, given up. Pure (sans I/O).

MAVLink's command protocol: COMMAND_LONG or COMMAND_INT is answered by COMMAND_ACK of the same number; without
an answer it is repeated with `confirmation` counted up; IN_PROGRESS means wait. Two commands of the same
number to the same target cannot be distinguished by their answers, so they go one after the other; after one
that was withdrawn, or repeated, the next answers are taken for its own, as long as those may still come.
"""

import math
import struct
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.geometry import Vector3
from companion.link.codec import (
    AUTOPILOT_COMPONENT,
    Message,
    command_int,
    command_long,
    mavlink,
)

NO_ANSWER: Final = "no answer"
WITHDRAWN: Final = "withdrawn"
_IN_PROGRESS_S: Final = 3.0


@dataclass(frozen=True, slots=True)
class VehicleCommand:
    """One command; with a position (latitude deg, longitude deg, altitude m AMSL) it goes as COMMAND_INT."""

    number: int
    parameters: tuple[float, ...] = ()
    position: Vector3 | None = None
    target_system: int = 1
    target_component: int = AUTOPILOT_COMPONENT

    def message(self, confirmation: int) -> Message:
        """The message of the first try (confirmation 0) or of a repeat."""
        target = (self.target_system, self.target_component)
        if self.position is not None:
            return command_int(self.number, self.parameters, self.position, *target)
        return command_long(self.number, self.parameters, *target, confirmation)


def request_message(
    message_id: int, target_system: int, target_component: int = AUTOPILOT_COMPONENT
) -> VehicleCommand:
    """Send this message once."""
    parameters = (float(message_id), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return VehicleCommand(
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        parameters,
        target_system=target_system,
        target_component=target_component,
    )


def set_message_interval(message_id: int, rate_hz: float, target_system: int) -> VehicleCommand:
    """Send this message at this rate to who asks."""
    parameters = (float(message_id), float(round(1e6 / rate_hz)), 0.0, 0.0, 0.0, 0.0, 0.0)
    return VehicleCommand(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, parameters, target_system=target_system)


@dataclass(slots=True, eq=False)
class Pending:
    """A command under way. `outcome` is None until it ends: "accepted", "denied", ... or "no answer"."""

    command: VehicleCommand
    outcome: str | None = None
    tries: int = 0
    answers: int = 0  # heard while it was under way, but IN_PROGRESS
    due_s: float = field(default=0.0)

    @property
    def accepted(self) -> bool:
        return self.outcome == "accepted"


_Key = tuple[int, int]


class CommandQueue:
    """All commands under way; `timeout_s` is waited for an answer, `tries` times."""

    def __init__(self, timeout_s: float = 0.5, tries: int = 4) -> None:
        self._timeout_s = timeout_s
        self._tries = tries
        self._queues: dict[_Key, deque[Pending]] = {}
        self._to_come: dict[_Key, tuple[int, float]] = {}  # answers to what has ended, and until when

    def submit(self, command: VehicleCommand) -> Pending:
        """Queue a command; `to_send` sends it."""
        pending = Pending(command)
        self._queues.setdefault(_key(command), deque()).append(pending)
        return pending

    def withdraw(self, pending: Pending) -> None:
        """Send it no more; it ends as "withdrawn"."""
        if pending.outcome is not None:
            return
        self._end(pending, WITHDRAWN)

    def is_under_way(self, command: VehicleCommand) -> bool:
        """Whether the very same command waits already."""
        queue = self._queues.get(_key(command), ())
        return any(pending.command == command for pending in queue)

    def acknowledged(self, message: Message, us: tuple[int, int], now_s: float) -> Pending | None:
        """Take a COMMAND_ACK; returns the command that ends by it, if one does.

        One meant for another component on the link is left alone.
        """
        target = (message.target_system, message.target_component)
        key = (message.get_srcSystem(), message.command)
        if target not in {us, (us[0], 0), (0, 0)}:
            return None
        queue = self._queues.get(key)
        pending = queue[0] if queue and queue[0].tries else None
        if message.result == mavlink.MAV_RESULT_IN_PROGRESS:
            if pending is not None and now_s >= self._to_come.get(key, (0, -math.inf))[1]:
                pending.due_s = now_s + _IN_PROGRESS_S
            return None
        if pending is not None:
            pending.answers += 1
        if self._is_to_an_ended_one(key, now_s) or pending is None:
            return None
        self._end(pending, _result_name(message.result))
        return pending

    def to_send(self, now_s: float) -> list[Message]:
        """The messages due now: first tries, and repeats of what was not answered in time."""
        messages: list[Message] = []
        for queue in list(self._queues.values()):
            while queue:
                pending = queue[0]
                if pending.tries and now_s < pending.due_s:
                    break
                if pending.tries >= self._tries:
                    self._end(pending, NO_ANSWER)
                    continue
                messages.append(pending.command.message(pending.tries))
                pending.tries += 1
                pending.due_s = now_s + self._timeout_s
        return messages

    def _is_to_an_ended_one(self, key: _Key, now_s: float) -> bool:
        """Whether an answer is an ended command's; wrongly so costs one repeat, wrongly not a command."""
        count, until_s = self._to_come.pop(key, (0, -math.inf))
        if now_s >= until_s:
            return False
        if count > 1:
            self._to_come[key] = count - 1, until_s
        return True

    def _end(self, pending: Pending, outcome: str) -> None:
        pending.outcome = outcome
        key = _key(pending.command)
        if pending.tries > pending.answers:
            self._to_come[key] = pending.tries - pending.answers, pending.due_s
        queue = self._queues[key]
        queue.remove(pending)
        if not queue:
            del self._queues[key]


def _key(command: VehicleCommand) -> _Key:
    return (command.target_system, command.number)


def _result_name(result: int) -> str:
    """MAV_RESULT in words: "temporarily rejected"."""
    entry = mavlink.enums["MAV_RESULT"].get(result)
    name = f"result {result}" if entry is None else entry.name.removeprefix("MAV_RESULT_")
    return str(name).lower().replace("_", " ")


# ---------------------------------------------------------------- parameters
# PARAM_REQUEST_READ and PARAM_SET are both answered by PARAM_VALUE of the same name, and not at all for a
# name that the autopilot does not have. ArduPilot sends integers as numbers; PX4 sends their bytes in a
# float's place, which is read here and never written: only ArduPilot's parameters are ever set. Names and
# units depend on the firmware's version (`AutopilotMake.other_names`): all names of one are asked for; one
# answers.

GUIDED_OPTIONS: Final = "GUID_OPTIONS"
THRUST_IS_THRUST: Final = 8  # GUID_OPTIONS bit 3: SET_ATTITUDE_TARGET's thrust is no climb rate
# of MAV_PARAM_TYPE: how the integers' bytes are read
_INTEGERS: Final = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<B3x",
    mavlink.MAV_PARAM_TYPE_INT8: "<b3x",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H2x",
    mavlink.MAV_PARAM_TYPE_INT16: "<h2x",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


def reported_value(message: Message, autopilot_kind: AutopilotKind | None) -> float:
    """The value in a PARAM_VALUE, whichever way its autopilot sends integers."""
    value: float = message.param_value
    as_bytes = autopilot_kind is not None and PROFILES[autopilot_kind].integers_as_bytes
    form = _INTEGERS.get(message.param_type) if as_bytes else None
    return value if form is None else float(struct.unpack(form, struct.pack("<f", value))[0])


@dataclass(slots=True, eq=False)
class ParameterRequest:
    """A parameter to read, or to set to `wanted`; `value` is the autopilot's newest answer.

    `outcome` is None until it ends: "accepted", "withdrawn" or "no answer" (none that has the wanted value).
    """

    name: str
    wanted: float | None = None
    value: float | None = None
    mav_type: int | None = None  # the autopilot's MAV_PARAM_TYPE of it
    outcome: str | None = None
    tries: int = 0
    due_s: float = field(default=0.0)

    def message(self, target_system: int) -> Message:
        target, name = (target_system, AUTOPILOT_COMPONENT), self.name.encode("ascii")
        if self.wanted is None:
            return mavlink.MAVLink_param_request_read_message(*target, name, -1)
        return mavlink.MAVLink_param_set_message(*target, name, self.wanted, mavlink.MAV_PARAM_TYPE_INT32)

    def answered(self, value: float) -> None:
        """Take the autopilot's value; a late answer to the reading before does not end a setting."""
        self.value = value
        if self.wanted is None or value == self.wanted:
            self.outcome = "accepted"


class ParameterRequests:
    """All requests under way; `timeout_s` is waited for an answer, `tries` times."""

    def __init__(self, timeout_s: float = 0.5, tries: int = 4) -> None:
        self._timeout_s = timeout_s
        self._tries = tries
        self._waiting: list[ParameterRequest] = []

    def submit(self, request: ParameterRequest) -> ParameterRequest:
        """Start a request; `to_send` sends it."""
        self._waiting.append(request)
        return request

    def withdraw(self, request: ParameterRequest) -> None:
        """Send it no more; it ends as "withdrawn"."""
        if request.outcome is None:
            request.outcome = WITHDRAWN

    def heard(self, message: Message, autopilot_kind: AutopilotKind | None) -> None:
        """Take a PARAM_VALUE of our autopilot's."""
        value = reported_value(message, autopilot_kind)
        if not math.isfinite(value):
            return
        for request in self._waiting:
            if request.outcome is None and request.tries and request.name == message.param_id:
                request.mav_type = message.param_type
                request.answered(value)

    def to_send(self, now_s: float, target_system: int) -> list[Message]:
        """The messages due now: first tries, and repeats of what was not answered in time."""
        messages: list[Message] = []
        for request in self._waiting:
            if request.outcome is not None or (request.tries and now_s < request.due_s):
                continue
            if request.tries >= self._tries:
                request.outcome = NO_ANSWER
                continue
            messages.append(request.message(target_system))
            request.tries += 1
            request.due_s = now_s + self._timeout_s
        self._waiting = [request for request in self._waiting if request.outcome is None]
        return messages


def all_names(kind: AutopilotKind, name: str) -> tuple[str, ...]:
    """A parameter's name, and those that other versions have for it."""
    return name, *(other.name for other in PROFILES[kind].other_names.get(name, ()))


def value_of(kind: AutopilotKind, name: str, values: Mapping[str, float | None]) -> float | None:
    """What the autopilot has reported under any of the names, in the first one's unit; None: nothing."""
    scales = {name: 1.0} | {other.name: other.scale for other in PROFILES[kind].other_names.get(name, ())}
    reported = [(known, value) for known in scales if (value := values.get(known)) is not None]
    return next((scales[known] * value for known, value in reported), None)
