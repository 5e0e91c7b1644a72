"""Commands to the autopilot: sent, acknowledged, repeated, given up. Pure (sans I/O).

MAVLink's command protocol: COMMAND_LONG or COMMAND_INT is answered by COMMAND_ACK of the same number; without
an answer it is repeated with `confirmation` counted up; IN_PROGRESS means wait. Two commands of the same
number to the same target cannot be distinguished by their answers, so they go one after the other; after a
withdrawn one the next answer is taken for its answer, as long as that may still come.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Final

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
        self._answer_to_withdrawn_until_s: dict[_Key, float] = {}

    def submit(self, command: VehicleCommand) -> Pending:
        """Queue a command; `to_send` sends it."""
        pending = Pending(command)
        self._queues.setdefault(_key(command), deque()).append(pending)
        return pending

    def withdraw(self, pending: Pending) -> None:
        """Send it no more; it ends as "withdrawn"."""
        if pending.outcome is not None:
            return
        if pending.tries:
            self._answer_to_withdrawn_until_s[_key(pending.command)] = pending.due_s
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
        if target not in {us, (us[0], 0), (0, 0)} or self._is_to_withdrawn(key, now_s):
            return None
        queue = self._queues.get(key)
        if not queue:
            return None
        pending = queue[0]
        if pending.tries == 0:
            return None
        if message.result == mavlink.MAV_RESULT_IN_PROGRESS:
            pending.due_s = now_s + _IN_PROGRESS_S
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

    def _is_to_withdrawn(self, key: _Key, now_s: float) -> bool:
        """Whether an answer is a withdrawn command's; wrongly so costs one repeat, wrongly not a command."""
        return now_s < self._answer_to_withdrawn_until_s.pop(key, -math.inf)

    def _end(self, pending: Pending, outcome: str) -> None:
        pending.outcome = outcome
        key = _key(pending.command)
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
