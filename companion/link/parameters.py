"""Reading and setting the autopilot's parameters: asked, answered, repeated, given up. Pure (sans I/O).

PARAM_REQUEST_READ and PARAM_SET are both answered by PARAM_VALUE of the same name, and not at all for a name
that the autopilot does not have. ArduPilot sends integers as numbers; PX4 sends their bytes in a float's
place, which is read here and never written: only ArduPilot's parameters are ever set.

Names and units depend on the firmware's version (`AutopilotMake.other_names`). All names of one are asked
for; one answers.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.link.codec import AUTOPILOT_COMPONENT, Message, mavlink
from companion.link.commands import NO_ANSWER, WITHDRAWN

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

    def submit(self, request: ParameterRequest) -> None:
        """Start a request; `to_send` sends it."""
        self._waiting.append(request)

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
