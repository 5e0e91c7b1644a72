"""MAVLink's mission protocol, sans I/O: upload, download, clear, set current, and what has been reached.

One object a link: it keeps that link's transfer, the lists are in the autopilot's `MissionStore` and `Fence`.
`handle` takes a message and returns the answers, `due` what has to be sent or requested again by now. An
upload goes MISSION_COUNT, then MISSION_REQUEST(_INT) and MISSION_ITEM(_INT) for each, then MISSION_ACK. Both
kinds of item are taken. Downloads are answered item by item without a state: none can get stuck.
Rally points are not simulated: their list is empty and stays so.
Source: mavlink.io's mission protocol; results and time-outs as in `MissionRules`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from companion.base.geometry import Vector3
from companion.link.codec import Message, mavlink
from sitl.autopilot.flight.mission_items import (
    FENCE_COMMANDS,
    PLACES,
    Fence,
    ItemFrame,
    MissionItem,
    MissionResult,
    MissionStore,
    item_frame,
)
from sitl.autopilot.flight.modes import Severity

Partner = tuple[int, int]

_MISSION: Final = mavlink.MAV_MISSION_TYPE_MISSION
_FENCE: Final = mavlink.MAV_MISSION_TYPE_FENCE
_EMPTY: Final = mavlink.MAV_MISSION_TYPE_RALLY
_KNOWN: Final = (_MISSION, _FENCE, _EMPTY)
_ALL_TYPES: Final = mavlink.MAV_MISSION_TYPE_ALL
_IN_DEGREES: Final = PLACES | FENCE_COMMANDS
_DEGREES_E7: Final = 1e-7
_FLY_TO_IT_NOW: Final = 2  # in the field `current`
# an autopilot that requests integers also sends integer frames
_INTEGER_FRAMES: Final[dict[int, int]] = {
    ItemFrame.GLOBAL: mavlink.MAV_FRAME_GLOBAL_INT,
    ItemFrame.RELATIVE: mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
}


@dataclass(slots=True)
class _Upload:
    """An upload in progress: sender, list, next and last item, times of the last item and request."""

    partner: Partner
    mission_type: int
    next: int
    last: int
    draft: list[MissionItem]
    begun: int
    heard_s: float
    asked_s: float


class MissionProtocol:
    """One link's end of the protocol."""

    def __init__(
        self, store: MissionStore, fence: Fence, go_to: Callable[[Vector3, bool], bool] | None = None
    ) -> None:
        """`go_to` flies to latitude, longitude and altitude (deg, deg, m; over home or above sea level)."""
        self._store, self._fence, self._go_to = store, fence, go_to
        self._upload: _Upload | None = None
        self._completed_last: tuple[Partner, int] | None = None
        self._reported = store.reached_total
        self._handlers: dict[int, Callable[[Message, float], list[Message]]] = {
            mavlink.MAVLINK_MSG_ID_MISSION_COUNT: self._on_count,
            mavlink.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: self._on_partial_list,
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM: self._on_item,
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT: self._on_item,
            mavlink.MAVLINK_MSG_ID_MISSION_ACK: self._on_ack,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._on_request_list,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST: self._on_request,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT: self._on_request,
            mavlink.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: self._on_clear,
            mavlink.MAVLINK_MSG_ID_MISSION_SET_CURRENT: self._on_set_current,
        }
        self.message_ids: Final = frozenset(self._handlers)

    def handle(self, message: Message, now_s: float) -> list[Message]:
        """Answers to a message; none to one that is not of this protocol."""
        handler = self._handlers.get(message.get_msgId())
        return [] if handler is None else handler(message, now_s)

    def due(self, now_s: float) -> list[Message]:
        """Repeated requests, the end of an upload that timed out, and items newly reached."""
        upload = self._upload
        messages = [] if upload is None else self._keep_asking(upload, now_s)
        new = self._store.reached_total - self._reported
        if new > 0:
            self._reported += new
            recent = list(self._store.reached)[-new:]
            messages += [mavlink.MAVLink_mission_item_reached_message(number) for number in recent]
        return messages

    # ------------------------------------------------------------ upload

    def _on_count(self, m: Message, now_s: float) -> list[Message]:
        store, rules, busy = self._store, self._store.rules, self._upload
        if m.mission_type not in (_MISSION, _FENCE):
            empty = m.mission_type == _EMPTY and m.count == 0
            return [_ack(m, MissionResult.ACCEPTED if empty else MissionResult.UNSUPPORTED)]
        if self._other_link_uploads(now_s) or (busy is not None and busy.partner != _sender(m)):
            return [_ack(m, MissionResult.DENIED if rules.restarts else MissionResult.ERROR)]
        if busy is not None and not rules.restarts and busy.next != busy.begun:
            return [_ack(m, MissionResult.ERROR)]
        self._end()
        if m.count > rules.max_items:
            return [_ack(m, MissionResult.NO_SPACE)]
        if m.count == 0:
            self._clear(m.mission_type)
            return [_ack(m, MissionResult.ACCEPTED)]
        draft = store.begin_upload(m.count) if m.mission_type == _MISSION else []
        return self._begin(m, 0, m.count - 1, draft, now_s)

    def _on_partial_list(self, m: Message, now_s: float) -> list[Message]:
        if not self._store.rules.partial_lists:
            return []
        if m.mission_type != _MISSION:
            return [_ack(m, MissionResult.UNSUPPORTED)]
        if self._upload is not None or self._other_link_uploads(now_s):
            return [_ack(m, MissionResult.DENIED)]
        if not 0 <= m.start_index <= m.end_index < len(self._store):
            self._store.send_text(Severity.WARNING, "Flight plan update rejected")
            return [_ack(m, MissionResult.ERROR)]
        return self._begin(m, m.start_index, m.end_index, self._store.items, now_s)

    def _begin(
        self, m: Message, first: int, last: int, draft: list[MissionItem], now_s: float
    ) -> list[Message]:
        self._completed_last = None
        self._store.uploader, self._store.uploader_heard_s = self, now_s
        self._upload = _Upload(_sender(m), m.mission_type, first, last, draft, first, now_s, now_s)
        return [self._ask(self._upload, now_s)]

    def _end(self) -> None:
        self._upload = None
        if self._store.uploader is self:
            self._store.uploader = None

    def _other_link_uploads(self, now_s: float) -> bool:
        """Another link has an upload in progress that has not timed out."""
        store = self._store
        silent = now_s - store.uploader_heard_s >= store.rules.timeout_s
        return store.uploader is not None and store.uploader is not self and not silent

    def _on_item(self, m: Message, now_s: float) -> list[Message]:
        if m.current == _FLY_TO_IT_NOW and self._store.rules.guided_items:
            return [_ack(m, self._guided(m))]
        return self._on_item_of_a_list(m, now_s)

    def _guided(self, m: Message) -> MissionResult:
        """An item of no list: ArduPilot's way to send a vehicle somewhere, which DroneKit uses."""
        item = item_from_message(m)
        checked = self._store.rules.check(item, m.frame)
        if checked is not MissionResult.ACCEPTED:
            return checked
        flies, place = item.command == mavlink.MAV_CMD_NAV_WAYPOINT, (item.x, item.y, item.z)
        accepted = flies and self._go_to is not None and self._go_to(place, item.frame is ItemFrame.RELATIVE)
        return MissionResult.ACCEPTED if accepted else MissionResult.ERROR

    def _on_item_of_a_list(self, m: Message, now_s: float) -> list[Message]:
        upload, rules = self._upload, self._store.rules
        if upload is None:
            repeated = (_sender(m), m.seq) == self._completed_last  # our acknowledgement was lost
            return [_ack(m, MissionResult.ACCEPTED if repeated else MissionResult.ERROR)]
        if upload.partner != _sender(m):
            return [_ack(m, MissionResult.DENIED)]
        if m.mission_type != upload.mission_type:
            return [_ack(m, MissionResult.ERROR)]
        upload.heard_s = self._store.uploader_heard_s = now_s
        if m.seq != upload.next:
            return [_ack(m, MissionResult.INVALID_SEQUENCE)] if rules.restarts else [self._ask(upload, now_s)]
        item = item_from_message(m)
        mission = upload.mission_type == _MISSION
        result = rules.check(item, m.frame) if mission else self._fence.check(item, item_frame(m.frame))
        if result is not MissionResult.ACCEPTED:
            self._end()
            return [_ack(m, result)]
        upload.draft[upload.next : upload.next + 1] = [item]
        upload.next += 1
        return [self._ask(upload, now_s)] if upload.next <= upload.last else self._complete(m, upload)

    def _complete(self, m: Message, upload: _Upload) -> list[Message]:
        self._end()
        self._completed_last = (upload.partner, upload.last)
        if upload.mission_type == _FENCE:
            return [
                _ack(m, MissionResult.ACCEPTED if self._fence.replace(upload.draft) else MissionResult.ERROR)
            ]
        self._store.finish_upload(upload.draft)
        return [_ack(m, MissionResult.ACCEPTED)]

    def _keep_asking(self, upload: _Upload, now_s: float) -> list[Message]:
        rules = self._store.rules
        if now_s - upload.heard_s >= rules.timeout_s:
            self._end()
            self._store.send_text(Severity.WARNING, rules.timeout_text)
            cancelled = mavlink.MAVLink_mission_ack_message(
                *upload.partner, MissionResult.OPERATION_CANCELLED, upload.mission_type
            )
            return [cancelled]
        return [self._ask(upload, now_s)] if now_s - upload.asked_s >= rules.retry_s else []

    def _ask(self, upload: _Upload, now_s: float) -> Message:
        upload.asked_s = now_s
        kind = mavlink.MAVLink_mission_request_message
        if self._store.rules.asks_for_integers:
            kind = mavlink.MAVLink_mission_request_int_message
        return kind(*upload.partner, upload.next, upload.mission_type)

    def _on_ack(self, m: Message, now_s: float) -> list[Message]:
        upload = self._upload
        if (
            upload is not None
            and upload.partner == _sender(m)
            and m.type == MissionResult.OPERATION_CANCELLED
        ):
            self._end()
        return []

    # ------------------------------------------------------------ download

    def _on_request_list(self, m: Message, now_s: float) -> list[Message]:
        return [self._count(m)] if m.mission_type in _KNOWN else [_ack(m, MissionResult.UNSUPPORTED)]

    def _on_request(self, m: Message, now_s: float) -> list[Message]:
        mission = m.mission_type == _MISSION
        try:
            item = self._store.item(m.seq) if mission else self._others(m.mission_type)[m.seq]
        except IndexError:
            # a request beyond the end is answered with the count
            return [self._count(m), _ack(m, MissionResult.ERROR)]
        integers = m.get_msgId() == mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT
        current = mission and m.seq == self._store.current
        frame: int = item.frame
        if integers and self._store.rules.asks_for_integers:
            frame = _INTEGER_FRAMES.get(frame, frame)
        kind, x, y = mavlink.MAVLink_mission_item_message, item.x, item.y
        if integers:
            scale = 1.0 / _DEGREES_E7 if item.command in _IN_DEGREES else 1.0
            kind, x, y = mavlink.MAVLink_mission_item_int_message, _int32(x * scale), _int32(y * scale)
        flags = (frame, item.command, int(current), int(item.autocontinue))
        return [kind(*_sender(m), m.seq, *flags, *item.parameters, x, y, item.z, m.mission_type)]

    def _others(self, mission_type: int) -> list[MissionItem]:
        return self._fence.items if mission_type == _FENCE else []

    def _count(self, m: Message) -> Message:
        count = len(self._store if m.mission_type == _MISSION else self._others(m.mission_type))
        return mavlink.MAVLink_mission_count_message(*_sender(m), count, m.mission_type)

    # ------------------------------------------------------------ the rest

    def _on_clear(self, m: Message, now_s: float) -> list[Message]:
        if m.mission_type not in (_ALL_TYPES, *_KNOWN):
            return [_ack(m, MissionResult.UNSUPPORTED)]
        if self._upload is not None or self._other_link_uploads(now_s):
            return [_ack(m, MissionResult.ERROR)]
        for mission_type in _KNOWN if m.mission_type == _ALL_TYPES else (m.mission_type,):
            self._clear(mission_type)
        return [_ack(m, MissionResult.ACCEPTED)]

    def _clear(self, mission_type: int) -> None:
        if mission_type == _MISSION:
            self._store.clear()
        elif mission_type == _FENCE:
            self._fence.replace(())

    def _on_set_current(self, m: Message, now_s: float) -> list[Message]:
        self._store.select(m.seq)
        return [mission_current(self._store)]


def item_from_message(m: Message) -> MissionItem:
    """The item in a MISSION_ITEM or MISSION_ITEM_INT; an unknown frame is left for `MissionRules.check`."""
    x, y = float(m.x), float(m.y)
    if m.get_msgId() == mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT and m.command in _IN_DEGREES:
        x, y = x * _DEGREES_E7, y * _DEGREES_E7
    frame = item_frame(m.frame)
    return MissionItem(
        m.command,
        ItemFrame.MISSION if frame is None else frame,
        (m.param1, m.param2, m.param3, m.param4),
        x,
        y,
        m.z,
        bool(m.autocontinue),
    )


def mission_current(store: MissionStore) -> Message:
    """MISSION_CURRENT with the number of items (65535: there is no mission)."""
    total = len(store) - store.rules.first
    if total <= 0:
        return mavlink.MAVLink_mission_current_message(0, 0xFFFF, mavlink.MISSION_STATE_NO_MISSION)
    state = mavlink.MISSION_STATE_COMPLETE if store.finished else mavlink.MISSION_STATE_UNKNOWN
    return mavlink.MAVLink_mission_current_message(min(store.current, 0xFFFF), total, state)


def _int32(value: float) -> int:
    return round(min(max(value, -(2.0**31)), 2.0**31 - 1.0)) if math.isfinite(value) else 0


def _sender(m: Message) -> Partner:
    return m.get_srcSystem(), m.get_srcComponent()


def _ack(m: Message, result: MissionResult) -> Message:
    return mavlink.MAVLink_mission_ack_message(*_sender(m), result, m.mission_type)
