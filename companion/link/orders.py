"""Orders that come over the link, and their answers: pure, messages in, messages out.

Four ways to ask for a landing, each off unless set but the first: a command of the ground station's addressed
to our component, an RC switch, a flight mode that the pilot enters, a mission item that is reached. Levels
are noted and edges count: a switch that is up when standby begins, or a mode that holds then, asks for
nothing; so it is for `SETTLES_S` after each begin, while the autopilot still changes by what was asked last.
Nor does an edge that was not seen, because the link was silent, ask for a landing.

An autopilot changes its mode by itself, too: at the end of its own take-off or mission, and as a failsafe. A
mode is a pilot's choice only where it follows on one that is flown by hand, in heartbeats that say that
nothing is wrong (MAV_STATE_ACTIVE).

MAVLink's command protocol: IN_PROGRESS when the order is followed and again for each repeat, then how it
ended; the same command again after its end is a new one, but for a repeat (confirmation > 0) within
`REPEATED_S`, which gets the old answer: only that may have been lost.
"""

import math
from dataclasses import dataclass
from typing import Final

from companion.base.autopilots import PROFILES
from companion.base.messages import AutopilotState, Order, OrderKind, OrderOutcome, OrderReply
from companion.config.service import OrdersConfig
from companion.link.codec import Message, mavlink

SETTLES_S: Final = 3.0
REPEATED_S: Final = 3.0
# What came before a silence of so long is not what was just before: PX4 leaves OFFBOARD after a second of it.
UNBROKEN_S: Final = 1.0
# Between two heartbeats (1 Hz) one may be lost.
_NEXT_HEARTBEAT_S: Final = 2.5
BY_PARAMETER: Final = {0: OrderKind.STOP, 1: OrderKind.LAND, 2: OrderKind.FLY}  # of MAV_CMD_USER_1
ASKS_STATUS: Final = 3  # of the same: no order, how it stands is told
ORDER_MESSAGES: Final = frozenset({mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT})
SWITCH_MESSAGES: Final = frozenset({mavlink.MAVLINK_MSG_ID_RC_CHANNELS})
MISSION_MESSAGES: Final = frozenset({mavlink.MAVLINK_MSG_ID_MISSION_ITEM_REACHED})
RC_RATE_HZ: Final = 5.0
_SWITCHED: Final = 2  # messages in a row: one alone may be a glitch of the radio
_NO_SIGNAL: Final = (0, 0xFFFF)
_RESULTS: Final = {
    OrderOutcome.ACCEPTED: mavlink.MAV_RESULT_ACCEPTED,
    OrderOutcome.TEMPORARILY_REJECTED: mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
    OrderOutcome.DENIED: mavlink.MAV_RESULT_DENIED,
    OrderOutcome.FAILED: mavlink.MAV_RESULT_FAILED,
    OrderOutcome.IN_PROGRESS: mavlink.MAV_RESULT_IN_PROGRESS,
    OrderOutcome.CANCELLED: 6,  # MAV_RESULT_CANCELLED, which this dialect's pymavlink has not got
}


@dataclass(frozen=True, slots=True)
class _Sender:
    """Who sent a command, and what it was; `number` of the command."""

    system_id: int
    component_id: int
    number: int


class OrderListener:
    """Takes what may be an order, gives orders (`take`) and messages to send (`answers`)."""

    def __init__(self, config: OrdersConfig, component_id: int, ground_system_id: int) -> None:
        self._config, self._component_id, self._ground = config, component_id, ground_system_id
        self._orders: list[Order] = []
        self._answers: list[Message] = []
        self._senders: dict[Order, _Sender] = {}  # of what has not ended
        self._last: tuple[_Sender, OrderOutcome, float] | None = None
        self._asked = False
        self._settled_s = -math.inf
        self._mode = ""
        self._by_hand_s = -math.inf  # when a pilot's stick mode was last said to be flown
        self._heard_s = -math.inf
        self._switched_on: bool | None = None
        self._switch_count = 0
        self._reached: int | None = None  # the mission item, of this flight

    @property
    def messages(self) -> frozenset[int]:
        """The messages that have to be decoded for it."""
        c = self._config
        return (
            ORDER_MESSAGES
            | (SWITCH_MESSAGES if c.rc_channel is not None else frozenset())
            | (MISSION_MESSAGES if c.mission_item is not None else frozenset())
        )

    @property
    def rates_hz(self) -> dict[int, float]:
        """What has to be asked of the autopilot, and how often."""
        return dict.fromkeys(SWITCH_MESSAGES, RC_RATE_HZ) if self._config.rc_channel is not None else {}

    def stand_by(self, now_s: float) -> None:
        """Standby begins: what was asked for before is settled first."""
        self._settled_s = now_s + SETTLES_S
        for order in self.take():
            self._senders.pop(order, None)

    @property
    def waiting(self) -> bool:
        """Whether `take` would give an order."""
        return bool(self._orders)

    def take(self) -> list[Order]:
        """The orders since the last call."""
        orders, self._orders = self._orders, []
        return orders

    def take_question(self) -> bool:
        """Whether the ground station has asked how it stands since the last call."""
        asked, self._asked = self._asked, False
        return asked

    def answers(self) -> list[Message]:
        """The COMMAND_ACKs to send since the last call."""
        answers, self._answers = self._answers, []
        return answers

    # ------------------------------------------------------------ in

    def hear_command(self, message: Message, us: int, now_s: float) -> None:
        """A COMMAND_LONG or COMMAND_INT; another's, or for another, is left alone. `us`: our system id."""
        target = (message.target_system, message.target_component)
        if message.get_srcSystem() != self._ground or target != (us, self._component_id):
            return
        sender = _Sender(message.get_srcSystem(), message.get_srcComponent(), message.command)
        if (
            self._config.mavlink
            and message.command == mavlink.MAV_CMD_USER_1
            and message.param1 == ASKS_STATUS
        ):
            self._asked = True
            self._answer(sender, mavlink.MAV_RESULT_ACCEPTED)
            return
        kind = self._kind(message)
        if kind is None:
            self._answer(sender, mavlink.MAV_RESULT_UNSUPPORTED)
            return
        if self._is_repeat(sender, kind, message, now_s):
            return
        order = Order(now_s, kind, f"the ground station (system {sender.system_id})")
        self._senders[order] = sender
        self._orders.append(order)

    def _kind(self, message: Message) -> OrderKind | None:
        if not self._config.mavlink:
            return None
        if message.command in {mavlink.MAV_CMD_NAV_LAND, mavlink.MAV_CMD_DO_LAND_START}:
            return OrderKind.LAND
        if message.command != mavlink.MAV_CMD_USER_1 or not math.isfinite(message.param1):
            return None
        return BY_PARAMETER.get(message.param1)

    def _is_repeat(self, sender: _Sender, kind: OrderKind, message: Message, now_s: float) -> bool:
        """Answer a repeat of what has not ended, or just has; two ways to us bring each command twice."""
        if any(order.kind is kind and who == sender for order, who in self._senders.items()):
            self._answer(sender, mavlink.MAV_RESULT_IN_PROGRESS)
            return True
        if self._last is None or not getattr(message, "confirmation", 0):
            return False
        last, outcome, ended_s = self._last
        if last != sender or now_s - ended_s > REPEATED_S:
            return False
        self._answer(sender, _RESULTS[outcome])
        return True

    def hear_autopilot(self, message: Message, message_id: int, now_s: float) -> bool:
        """A message of the autopilot's; whether it was one of a switch or of the mission."""
        if message_id in SWITCH_MESSAGES:
            self._hear_channels(message, now_s)
        elif message_id in MISSION_MESSAGES:
            self._hear_item(message, now_s)
        else:
            return False
        return True

    def _hear_channels(self, message: Message, now_s: float) -> None:
        """RC_CHANNELS of the autopilot. A radio that is gone is no switch: what it then shows is a start."""
        channel = self._config.rc_channel
        assert channel is not None
        value = int(getattr(message, f"chan{channel}_raw"))
        if value in _NO_SIGNAL or message.chancount < channel:
            self._switched_on = None
            return
        on = value > self._config.rc_on_us
        if self._switched_on is None or now_s < self._settled_s:
            self._switched_on, self._switch_count = on, 0
            return
        self._switch_count = self._switch_count + 1 if on is not self._switched_on else 0
        if self._switch_count < _SWITCHED:
            return
        self._switched_on, self._switch_count = on, 0
        kind = OrderKind.LAND if on else OrderKind.STOP
        self._orders.append(Order(now_s, kind, f"the switch on RC channel {channel}"))

    def heard(self, now_s: float) -> None:
        """Anything of the autopilot's has come: after a silence what was seen before begins anew."""
        if now_s - self._heard_s > UNBROKEN_S:
            self._by_hand_s = -math.inf
            # one that was up may be seen to fall: a stop is never missed
            self._switched_on, self._switch_count = self._switched_on or None, 0
        self._heard_s = now_s

    def hear_heartbeat(self, state: AutopilotState, system_status: int, now_s: float) -> None:
        """The state after a HEARTBEAT, and its MAV_STATE, which CURRENT_MODE has not got."""
        wanted, kind = self._config.flight_mode, state.autopilot_kind
        if not state.armed:
            self._reached = None
        if wanted is None or kind is None:
            return
        mode = state.mode.upper().replace(" ", "_")
        active = system_status == mavlink.MAV_STATE_ACTIVE
        intended = state.intended_mode in {"", state.mode}
        chosen = active and intended and state.armed and now_s - self._by_hand_s <= _NEXT_HEARTBEAT_S
        by_hand = active and state.mode in PROFILES[kind].stick_modes
        entered = mode in {wanted, f"AUTO.{wanted}"} and mode != self._mode
        if entered and chosen and now_s >= self._settled_s:
            self._orders.append(Order(now_s, OrderKind.LAND, f"flight mode {mode}"))
        self._mode, self._by_hand_s = mode, now_s if by_hand else -math.inf

    def _hear_item(self, message: Message, now_s: float) -> None:
        """MISSION_ITEM_REACHED of the autopilot. PX4 sends each another ten times, once a second."""
        again, self._reached = message.seq == self._reached, message.seq
        if message.seq == self._config.mission_item and not again and now_s >= self._settled_s:
            self._orders.append(Order(now_s, OrderKind.LAND, f"mission item {message.seq}"))

    # ------------------------------------------------------------ out

    def reply(self, order: Order, reply: OrderReply) -> None:
        """Answer whoever gave an order by MAVLink; the other ways have no answer but the notice."""
        sender = self._senders.get(order)
        if sender is None:
            return
        if reply.outcome is not OrderOutcome.IN_PROGRESS:
            del self._senders[order]
            self._last = (sender, reply.outcome, reply.time_s)
        self._answer(sender, _RESULTS[reply.outcome])

    def _answer(self, sender: _Sender, result: int) -> None:
        self._answers.append(
            mavlink.MAVLink_command_ack_message(
                sender.number, result, 0, 0, sender.system_id, sender.component_id
            )
        )
