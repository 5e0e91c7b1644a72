"""The tap on the log: what it keeps, when it hands over, and that it never harms who logs."""

from dataclasses import replace

import numpy as np
import pytest

from companion.app.page.feed import TRACK_PERIOD_S, TRACK_S, LiveFeed
from companion.app.page.look import Look
from companion.app.page.picture import Painter
from companion.base.messages import FrameReport, PadSighting, PadState, Phase, PlanStep, Reference
from companion.config import CompanionConfig
from tests.unit.app.page.starting import START, frame, start
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
    return PadSighting(
        1.0,
        sequence,
        SIGHTING.pad_position_body_m,
        SIGHTING.body_from_pad,
        SIGHTING.covariance,
        SIGHTING.group,
        SIGHTING.marker_ids,
        SIGHTING.marker_count,
        0.2,
    )


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
