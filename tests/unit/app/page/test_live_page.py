"""The page's orders go the way of `companion order`; nothing is told while nobody looks."""

import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from companion.app.app import App
from companion.app.page import live_page
from companion.app.page.live_page import MOST_OPEN_ORDERS, LivePage
from companion.app.page.look import Look, Reply, Text
from companion.app.page.process import PageProcess
from companion.base.messages import Order, OrderKind, OrderOutcome, OrderReply
from companion.config import CompanionConfig, ConfigError, validate
from companion.flightlog.record import FlightLog
from companion.flightlog.tap import NoTap


class PageOrders:
    """Who takes orders, as `Missions` does."""

    def __init__(self) -> None:
        self.given: list[tuple[Order, Callable[[OrderReply], None]]] = []

    def give(self, order: Order, on_reply: Callable[[OrderReply], None]) -> None:
        self.given.append((order, on_reply))

    def answer(self, outcome: OrderOutcome, text: str = "") -> None:
        order, on_reply = self.given[-1]
        on_reply(OrderReply(1.0, order.kind, order.source, outcome, text))


class Outlet:
    """Where the page's process would be."""

    def __init__(self) -> None:
        self.sent: list[Look | Text | Reply] = []

    def put(self, message: Look | Text | Reply) -> None:
        self.sent.append(message)


def page_of(log: FlightLog | None = None, **serve: Any) -> LivePage:
    config = validate(CompanionConfig, {"serve": {"address": "127.0.0.1:0", **serve}}, "test")
    return LivePage(config, FlightLog(None, 0.0) if log is None else log)


def take(page: LivePage, line: dict[str, Any], desk: PageOrders) -> list[Look | Text | Reply]:
    """What the page's process is sent after a line of its."""
    outlet = Outlet()
    page._take(line, cast(App, SimpleNamespace(missions=desk)), cast(PageProcess, outlet))
    return outlet.sent


def looks(page: LivePage) -> bool:
    """Whether pictures are made."""
    return page._feed.on_look is not None


@pytest.fixture
def _token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COMPANION_SERVE_TOKEN", "x" * 32)


@pytest.mark.usefixtures("_token")
async def test_an_order_is_given_and_every_answer_goes_back_with_its_reason() -> None:
    page, desk, outlet = page_of(allow_commands=True), PageOrders(), Outlet()
    app = cast(App, SimpleNamespace(missions=desk))
    page._take({"order": "land", "number": 7}, app, cast(PageProcess, outlet))
    order, _ = desk.given[0]
    assert (order.kind, order.source) == (OrderKind.LAND, "the live page")
    desk.answer(OrderOutcome.IN_PROGRESS)
    desk.answer(OrderOutcome.FAILED, "taken by the pilot")
    assert outlet.sent == [
        Reply(7, "land", "in_progress", ""),
        Reply(7, "land", "failed", "taken by the pilot"),
    ]


async def test_without_allow_commands_no_order_is_given_whatever_the_page_s_process_says() -> None:
    desk = PageOrders()
    assert take(page_of(), {"order": "land", "number": 1}, desk) == [
        Reply(1, "land", "denied", "not allowed by serve.allow_commands")
    ]
    assert desk.given == []


@pytest.mark.usefixtures("_token")
@pytest.mark.parametrize("line", [{"order": "fly", "number": 1}, {"order": ["land"], "number": 1}])
async def test_nobody_arms_from_the_page(line: dict[str, Any]) -> None:
    desk = PageOrders()
    (reply,) = take(page_of(allow_commands=True), line, desk)
    assert isinstance(reply, Reply)
    assert (reply.outcome, desk.given) == ("denied", [])


@pytest.mark.usefixtures("_token")
async def test_open_orders_are_counted_and_hold_no_stop_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_page, "ORDER_PERIOD_S", 0.0)
    page, desk = page_of(allow_commands=True), PageOrders()
    for number in range(MOST_OPEN_ORDERS):
        assert take(page, {"order": "land", "number": number}, desk) == []
    (reply,) = take(page, {"order": "land", "number": 9}, desk)
    assert isinstance(reply, Reply)
    assert (reply.outcome, len(desk.given)) == ("temporarily_rejected", MOST_OPEN_ORDERS)
    desk.answer(OrderOutcome.TEMPORARILY_REJECTED, "on the ground")
    assert take(page, {"order": "land", "number": 10}, desk) == []
    assert take(page, {"order": "stop", "number": 11}, desk) == []
    assert desk.given[-1][0].kind is OrderKind.STOP


@pytest.mark.usefixtures("_token")
async def test_the_next_process_numbers_afresh_and_hears_no_answer_to_an_order_of_the_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(live_page, "ORDER_PERIOD_S", 0.0)
    page, desk, outlet = page_of(allow_commands=True), PageOrders(), Outlet()
    app, process = cast(App, SimpleNamespace(missions=desk)), cast(PageProcess, outlet)
    page._take({"order": "land", "number": 1}, app, process)
    _, answer_the_first = desk.given[0]
    page._take({"viewers": 0}, app, process)  # as it is told when a process has ended
    page._take({"order": "stop", "number": 1}, app, process)
    answer_the_first(OrderReply(1.0, OrderKind.LAND, "", OrderOutcome.CANCELLED, "stopped"))
    assert outlet.sent == []
    desk.answer(OrderOutcome.ACCEPTED)
    assert outlet.sent == [Reply(1, "stop", "accepted", "")]


@pytest.mark.usefixtures("_token")
async def test_orders_of_a_kind_that_come_too_fast_are_refused_and_a_stop_is_not_held_up_by_them() -> None:
    page, desk = page_of(allow_commands=True), PageOrders()
    assert take(page, {"order": "land", "number": 1}, desk) == []
    desk.answer(OrderOutcome.TEMPORARILY_REJECTED, "on the ground")
    (reply,) = take(page, {"order": "land", "number": 2}, desk)
    assert isinstance(reply, Reply)
    assert (reply.outcome, reply.text) == ("temporarily_rejected", "too many orders")
    assert take(page, {"order": "stop", "number": 3}, desk) == []


@pytest.mark.parametrize(
    "line", [{}, {"viewers": "many"}, {"listening": 7}, {"order": "land"}, {"number": 3}, {"x": 1}]
)
async def test_lines_that_say_nothing_do_nothing(line: dict[str, Any]) -> None:
    assert take(page_of(), line, PageOrders()) == []


async def test_pictures_are_made_while_somebody_looks_and_the_plots_begin_with_what_was() -> None:
    log = FlightLog(None, 0.0)
    page, desk = page_of(log), PageOrders()
    assert log.tap is page._feed
    assert not looks(page)
    assert take(page, {"viewers": 1}, desk) == []
    assert json.loads(page._track()) == {"kind": "track", "rows": []}
    assert looks(page)
    take(page, {"viewers": 0}, desk)
    assert not looks(page)


async def test_without_an_address_the_log_has_no_tap() -> None:
    log = FlightLog(None, 0.0)
    page_of(log, address=None)
    assert isinstance(log.tap, NoTap)
    with pytest.raises(ConfigError, match="expected a token"):
        page_of(log, address="0.0.0.0:0")
