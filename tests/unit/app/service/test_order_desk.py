"""The desk of orders: one at a time, each answered, and a stop for whatever is under way."""

from companion.app.service.order_desk import MOST_WAITING, TOO_MANY, OrderDesk
from companion.base.messages import Order, OrderKind, OrderOutcome, OrderReply, Phase, Refusal


class AnsweredDesk:
    """A desk whose answers are kept."""

    def __init__(self) -> None:
        self.replies: list[tuple[str, OrderOutcome, str]] = []
        self.desk = OrderDesk(self._take)

    def _take(self, order: Order, reply: OrderReply) -> None:
        assert (reply.kind, reply.source) == (order.kind, order.source)
        self.replies.append((order.source, reply.outcome, reply.text))


def followed(d: AnsweredDesk) -> Order | None:
    return d.desk.followed


def stop_requested(d: AnsweredDesk) -> bool:
    return d.desk.stop_requested


def order(source: str, kind: OrderKind = OrderKind.LAND) -> Order:
    return Order(1.0, kind, source)


def test_an_order_is_followed_and_its_end_is_reported() -> None:
    d = AnsweredDesk()
    d.desk.take([order("a")])
    taken = d.desk.next_order(Phase.STANDBY, 1.0)
    assert taken is not None
    d.desk.decided(taken, None, 1.0)
    assert followed(d) is taken
    d.desk.mission_ended(Phase.LANDED, "landed: disarmed", 60.0)
    assert followed(d) is None
    assert d.replies == [
        ("a", OrderOutcome.IN_PROGRESS, ""),
        ("a", OrderOutcome.ACCEPTED, "landed: disarmed"),
    ]


def test_a_refusal_for_now_differs_from_one_by_the_settings() -> None:
    d = AnsweredDesk()
    d.desk.decided(order("a"), Refusal("no pad camera"), 1.0)
    d.desk.decided(order("b"), Refusal("not allowed", lasting=True), 1.0)
    assert d.desk.followed is None
    assert d.replies == [
        ("a", OrderOutcome.TEMPORARILY_REJECTED, "no pad camera"),
        ("b", OrderOutcome.DENIED, "not allowed"),
    ]


def test_in_a_mission_a_second_order_is_busy_and_a_stop_stops() -> None:
    d = AnsweredDesk()
    d.desk.decided(order("a"), None, 1.0)
    d.desk.take([order("b"), order("c", OrderKind.STOP)])
    assert d.desk.next_order(Phase.TAKE_OFF, 2.0) is None
    assert stop_requested(d)
    d.desk.mission_ended(Phase.ABORT, "abort: stop requested", 3.0)
    assert not stop_requested(d)
    assert d.replies[1:] == [
        ("b", OrderOutcome.TEMPORARILY_REJECTED, "busy: take off"),
        ("c", OrderOutcome.IN_PROGRESS, ""),
        ("a", OrderOutcome.CANCELLED, "abort: stop requested"),
        ("c", OrderOutcome.ACCEPTED, "abort: stop requested"),
    ]


def test_a_mission_that_ends_otherwise_has_failed() -> None:
    d = AnsweredDesk()
    d.desk.decided(order("a"), None, 1.0)
    d.desk.mission_ended(Phase.ABORT, "abort: taken over", 3.0)
    assert d.replies[-1] == ("a", OrderOutcome.FAILED, "abort: taken over")


def test_who_sends_orders_without_end_fills_no_memory_and_each_is_answered() -> None:
    d = AnsweredDesk()
    d.desk.take(order(str(number)) for number in range(1000))
    assert len(d.replies) == 1000 - MOST_WAITING
    assert set(d.replies[0][1:]) == {OrderOutcome.TEMPORARILY_REJECTED, TOO_MANY}
    waiting = 0
    while d.desk.next_order(Phase.STANDBY, 1.0) is not None:
        waiting += 1
    assert waiting == MOST_WAITING


def test_a_flood_of_orders_keeps_no_stop_out_and_a_flood_of_stops_fills_no_memory() -> None:
    d = AnsweredDesk()
    d.desk.decided(order("a"), None, 1.0)
    d.desk.take(order("flood") for _ in range(100))
    d.desk.take([order("operator", OrderKind.STOP)])
    d.desk.next_order(Phase.APPROACH, 2.0)
    assert d.replies[-1] == ("operator", OrderOutcome.IN_PROGRESS, "")
    for cycle in range(100):
        d.desk.take([order(f"stop {cycle}", OrderKind.STOP)])
        d.desk.next_order(Phase.HOLD, 2.0)
    assert d.replies[-1] == ("stop 99", OrderOutcome.TEMPORARILY_REJECTED, TOO_MANY)
    before = len(d.replies)
    d.desk.mission_ended(Phase.ABORT, "stopped", 3.0)
    assert len(d.replies) - before == 1 + MOST_WAITING
