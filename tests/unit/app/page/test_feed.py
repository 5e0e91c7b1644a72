"""The tap on the log: what it keeps, when it hands over, and that it never harms who logs."""

import json
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from companion.app.app import App
from companion.app.page import live_page
from companion.app.page.feed import TRACK_PERIOD_S, TRACK_S, LiveFeed
from companion.app.page.listener import Painter
from companion.app.page.live_page import MOST_OPEN_ORDERS, LivePage
from companion.app.page.look import Look, Reply, Text
from companion.app.page.process import PageProcess
from companion.base.messages import (
    FrameReport,
    Order,
    OrderKind,
    OrderOutcome,
    OrderReply,
    PadSighting,
    PadState,
    Phase,
    PlanStep,
    Reference,
)
from companion.config import CompanionConfig, ConfigError, validate
from companion.flightlog.record import FlightLog, Tap
from tests.unit.app.page.test_server import START, frame, start
from tests.unit.flightlog.test_foxglove import SIGHTING, VEHICLE
from tests.unit.flightlog.test_result import pad_at, vehicle_at


def plan(time_s: float, phase: Phase = Phase.DESCEND, time_to_go_s: float = 2.0) -> PlanStep:
    rows = np.zeros((3, 3))
    return PlanStep(
        time_s, phase, Reference(time_s, "pad", 0.1, rows, rows, rows, 0.0), time_to_go_s=time_to_go_s
    )


def report(time_s: float, sequence: int, *, seen: bool) -> FrameReport:
    return FrameReport(time_s, time_s, time_s + 0.05, sequence, {}, seen, False)


def sighting(sequence: int) -> PadSighting:
    return replace(SIGHTING, time_s=1.0, sequence=sequence)


def show(feed: LiveFeed, time_s: float, sequence: int, *, seen: bool = True) -> None:
    """A frame, and what follows from it, in the app's order."""
    feed.frame(frame(time_s, sequence))
    if seen:
        feed.note("sighting", sighting(sequence), time_s + 0.05)
    feed.note("frame_report", report(time_s, sequence, seen=seen), time_s + 0.05)


@pytest.fixture
def looks() -> list[Look]:
    return []


@pytest.fixture
def feed(looks: list[Look]) -> LiveFeed:
    feed = LiveFeed(10.0)
    feed.on_look = looks.append
    return feed


def test_while_nobody_looks_no_picture_is_made(feed: LiveFeed, looks: list[Look]) -> None:
    feed.on_look = None
    show(feed, 1.0, 1)
    assert looks == []


def test_a_picture_comes_with_its_own_sighting_and_no_other(feed: LiveFeed, looks: list[Look]) -> None:
    show(feed, 1.0, 1)
    show(feed, 2.0, 2, seen=False)
    assert [(look.frame and look.frame.sequence, look.sighting is not None) for look in looks] == [
        (1, True),
        (2, False),
    ]


def test_no_more_pictures_than_asked_for(feed: LiveFeed, looks: list[Look]) -> None:
    for number in range(300):
        show(feed, 1.0 + number / 30.0, number)
    assert 95 <= len(looks) <= 105


def test_the_predicted_touchdown_is_where_the_pad_will_be(feed: LiveFeed, looks: list[Look]) -> None:
    vehicle, pad = vehicle_at(1.0, 0.0, 0.0), pad_at(1.0, 0.0)
    feed.note("vehicle", vehicle, 1.0)
    feed.note("pad", pad, 1.0)
    feed.note("plan", plan(1.0), 1.0)
    show(feed, 1.0, 1)
    moved = [p + 2.0 * v for p, v in zip(pad.relative_position_ned_m, pad.velocity_ned_m_s, strict=True)]
    assert looks[0].touchdown_ned_m == pytest.approx(tuple(moved))
    assert looks[0].time_to_touchdown_s == pytest.approx(2.0 - 0.05)
    feed.note("plan", plan(1.2, time_to_go_s=0.0), 1.2)
    show(feed, 1.2, 2)
    assert looks[1].touchdown_ned_m is None


def test_a_pad_straight_below_is_drawn_in_the_middle_of_the_picture() -> None:
    painter = Painter(start())
    look = Look(
        LiveFeed(10.0).look(1.0).point,
        "descend",
        frame(1.0),
        SIGHTING,
        attitude=(1.0, 0.0, 0.0, 0.0),
        touchdown_ned_m=SIGHTING.pad_position_body_m,
    )
    drawing = painter._drawing(look, frame(1.0), 1.0)
    edge = np.array(next(o["corners"] for o in drawing["outlines"] if o["id"] is None))
    centre = (START.camera.cx_px, START.camera.cy_px)
    assert edge.mean(axis=0) == pytest.approx(centre, abs=1.0)
    assert drawing["touchdown"] == pytest.approx(centre, abs=0.1)
    assert {o["id"] for o in drawing["outlines"]} == {None, *SIGHTING.marker_ids}


def test_the_height_is_that_of_the_feet(feed: LiveFeed) -> None:
    feed.know({"vehicle": START.vehicle})
    feed.note("pad", pad_below(1.0, START.vehicle.leg_height_m), 1.0)
    assert feed.look(1.0).point.height_m == pytest.approx(0.0)


def pad_below(time_s: float, height_m: float) -> PadState:
    known = pad_at(time_s, 0.0)
    return replace(known, relative_position_ned_m=(0.0, 0.0, height_m))


def test_the_time_to_touchdown_is_that_of_all_that_is_left(feed: LiveFeed, looks: list[Look]) -> None:
    config = CompanionConfig()
    feed.know({"config": config, "vehicle": START.vehicle})
    final_s = config.plan.landing.wait_height_m / config.plan.touchdown.contact_speed_m_s
    for number, (phase, left_s) in enumerate(
        [(Phase.APPROACH, None), (Phase.DESCEND, 2.0 - 0.05 + final_s), (Phase.TOUCHDOWN, 0.5)]
    ):
        time_s = 1.0 + number
        feed.note("plan", plan(time_s, phase), time_s)
        height_m = START.vehicle.leg_height_m + 0.5 * config.plan.touchdown.contact_speed_m_s
        feed.note("pad", pad_below(time_s, height_m), time_s)
        show(feed, time_s, number)
        assert looks[-1].time_to_touchdown_s == (
            left_s if left_s is None else pytest.approx(left_s, abs=0.02)
        )


@pytest.mark.parametrize(("ahead_m", "below_m"), [(5.0, 1.0), (50.0, 1.0), (5.0, -1.0)])
def test_a_touchdown_that_the_lens_cannot_see_is_pointed_at(ahead_m: float, below_m: float) -> None:
    # the shipped camera's top edge is forward
    look = Look(
        LiveFeed(10.0).look(1.0).point,
        "descend",
        frame(1.0),
        attitude=(1.0, 0.0, 0.0, 0.0),
        touchdown_ned_m=(ahead_m, VEHICLE.camera_position_body_m[1], below_m),
    )
    u, v = Painter(start())._drawing(look, frame(1.0), 1.0)["touchdown"]
    assert u == pytest.approx(0.5 * START.camera.width_px, abs=5.0)
    assert v < 0.0


def test_track_and_phases_are_kept_for_who_comes_later(feed: LiveFeed) -> None:
    for number in range(30_000):
        time_s = number / 30.0
        feed.note("plan", plan(time_s, Phase.SEARCH if time_s < 500.0 else Phase.DESCEND), time_s)
    assert len(feed.track) == round(TRACK_S / TRACK_PERIOD_S)
    assert list(feed.phases) == [(0.0, "search"), (500.0, "descend")]


def test_a_state_that_is_old_is_not_shown_as_if_it_were_new(feed: LiveFeed) -> None:
    feed.note("vehicle", vehicle_at(1.0, 0.0, 0.0), 1.0)
    feed.note("pad", pad_at(1.0, 0.0), 1.0)
    assert feed.look(1.1).point.height_m is not None
    assert feed.look(9.0).point[1:] == (None, None, None)


def test_a_fault_of_the_page_never_reaches_who_logs(feed: LiveFeed) -> None:
    def fails(_: Look) -> None:
        raise RuntimeError("no such luck")

    feed.on_look = fails
    show(feed, 1.0, 1)
    show(feed, 2.0, 2)
    assert feed.failure == "RuntimeError: no such luck"


# ---------------- The page's orders go the way of `companion order`; nothing is told while nobody looks


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


def is_looking(page: LivePage) -> bool:
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
    assert not is_looking(page)
    assert take(page, {"viewers": 1}, desk) == []
    assert json.loads(page._track()) == {"kind": "track", "rows": []}
    assert is_looking(page)
    take(page, {"viewers": 0}, desk)
    assert not is_looking(page)


async def test_without_an_address_the_log_has_no_tap() -> None:
    log = FlightLog(None, 0.0)
    page_of(log, address=None)
    assert type(log.tap) is Tap
    with pytest.raises(ConfigError, match="expected a token"):
        page_of(log, address="0.0.0.0:0")
