"""The desk between those who give orders and the planner: one order at a time, each answered.

link (commands, switch, mode, mission) ─┐                 ┌─► planner, for one cycle
local socket (`companion order`) ───────┴─► OrderDesk ────┤
                                        ◄── replies ──────┴── refused, followed, ended
"""

from collections import deque
from collections.abc import Callable, Iterable
from typing import Final

from companion.base.messages import Order, OrderKind, OrderOutcome, OrderReply, Phase, Refusal

ReplyCallback = Callable[[Order, OrderReply], None]
# of one kind, of one cycle and the last few: more is a fault of whoever sends them
MOST_WAITING: Final = 8
TOO_MANY: Final = "too many orders"


class OrderDesk:
    """Give orders with `take`; each cycle ask `next_order`, and tell what the planner made of it."""

    def __init__(self, on_reply: ReplyCallback) -> None:
        """`on_reply` receives every answer: a refusal or IN_PROGRESS, and later how it ended."""
        self._on_reply = on_reply
        self._waiting: deque[Order] = deque()
        self._followed: Order | None = None
        self._stops: list[Order] = []

    @property
    def followed(self) -> Order | None:
        """The order that the present mission carries out."""
        return self._followed

    @property
    def stop_requested(self) -> bool:
        """Whether the present mission is to be stopped."""
        return bool(self._stops)

    def take(self, orders: Iterable[Order]) -> None:
        """Take orders in. Too many of a kind are refused; of another kind they keep no stop out."""
        for order in orders:
            if _count(self._waiting, order.kind) < MOST_WAITING:
                self._waiting.append(order)
            else:
                self._reply(order, OrderOutcome.TEMPORARILY_REJECTED, TOO_MANY, order.time_s)

    def next_order(self, phase: Phase, now_s: float) -> Order | None:
        """The order for this cycle's planner, in standby; in a mission all but a stop are refused."""
        if not self._waiting:
            return None
        if phase is Phase.STANDBY:
            return self._waiting.popleft()
        while self._waiting:
            order = self._waiting.popleft()
            if order.kind is not OrderKind.STOP:
                busy = f"busy: {phase.value.replace('_', ' ')}"
                self._reply(order, OrderOutcome.TEMPORARILY_REJECTED, busy, now_s)
            elif len(self._stops) >= MOST_WAITING:
                self._reply(order, OrderOutcome.TEMPORARILY_REJECTED, TOO_MANY, now_s)
            else:
                self._stops.append(order)
                self._reply(order, OrderOutcome.IN_PROGRESS, "", now_s)
        return None

    def decided(self, order: Order, refusal: Refusal | None, now_s: float) -> None:
        """What the planner made of this cycle's order."""
        if refusal is None:
            self._followed = order
            self._reply(order, OrderOutcome.IN_PROGRESS, "", now_s)
        else:
            outcome = OrderOutcome.DENIED if refusal.lasting else OrderOutcome.TEMPORARILY_REJECTED
            self._reply(order, outcome, refusal.text, now_s)

    def mission_ended(self, phase: Phase, words: str, now_s: float) -> None:
        """The mission has ended in LANDED or ABORT, for the reason in `words`."""
        if self._followed is not None:
            stopped = OrderOutcome.CANCELLED if self._stops else OrderOutcome.FAILED
            outcome = OrderOutcome.ACCEPTED if phase is Phase.LANDED else stopped
            self._reply(self._followed, outcome, words, now_s)
        for stop in self._stops:
            self._reply(stop, OrderOutcome.ACCEPTED, words, now_s)
        self._followed, self._stops = None, []

    def _reply(self, order: Order, outcome: OrderOutcome, text: str, now_s: float) -> None:
        self._on_reply(order, OrderReply(now_s, order.kind, order.source, outcome, text))


def _count(orders: Iterable[Order], kind: OrderKind) -> int:
    return sum(order.kind is kind for order in orders)
