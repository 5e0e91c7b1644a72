import math

import pytest

from companion.config import GuidanceConfig, SearchConfig
from companion.geometry import geodetic_from_ned
from companion.messages import PadBeacon
from companion.plan.guidance import Guide
from companion.plan.min_jerk import Motion
from companion.plan.search import Lead, Search, Whereabouts, square_spiral, turn_rate

ORIGIN = (47.0, 8.0, 400.0)
CONFIG = SearchConfig()


def beacon(time_s: float, north: float, east: float, velocity: tuple[float, float, float]) -> PadBeacon:
    latitude, longitude, altitude = geodetic_from_ned((north, east, 0.0), ORIGIN)
    return PadBeacon(time_s, latitude, longitude, altitude, velocity, 1.5)


def searching() -> tuple[Search, Guide]:
    guide = Guide(GuidanceConfig(), lambda _d, _v, _a: 1.5, 20, 0.1)
    guide.start("local", Motion((0.0, 0.0, -7.0)), 0.0)
    search = Search(CONFIG, guide)
    search.begin(0.0, math.inf, 0.0)
    return search, guide


def test_the_spiral_leaves_no_gap_wider_than_its_spacing() -> None:
    # GIVEN the way along the corners, sampled
    way = []
    for k in range(24):
        (a, b), (c, d) = square_spiral(k, 4.0), square_spiral(k + 1, 4.0)
        way += [(a + (c - a) * s / 20.0, b + (d - b) * s / 20.0) for s in range(21)]
    # THEN every place within its reach is within half a spacing of it, in both directions
    for north in range(-18, 19, 3):
        for east in range(-18, 19, 3):
            assert min(max(abs(n - north), abs(e - east)) for n, e in way) <= 2.0 + 1e-9


def test_the_legs_of_the_spiral_are_square() -> None:
    corners = [square_spiral(k, 1.0) for k in range(9)]
    assert corners == [(0, 0), (1, 0), (1, 1), (-1, 1), (-1, -1), (2, -1), (2, 2), (-2, 2), (-2, -2)]


@pytest.mark.parametrize("course_deg", [0.0, 90.0, 180.0, 270.0])
def test_a_turning_pad_is_led_along_its_circle(course_deg: float) -> None:
    # GIVEN a pad on a circle of 5 m, clockwise from above, at 1.5 m/s
    rate, course = 0.3, math.radians(course_deg)
    velocity = (1.5 * math.cos(course), 1.5 * math.sin(course), 0.0)
    later = Lead(10.0, (3.0, 4.0, 0.0), velocity, rate).at(13.0, 5.0)
    # THEN it is where the circle says: the centre lies 5 m to the right of the course
    centre = (3.0 - 5.0 * math.sin(course), 4.0 + 5.0 * math.cos(course))
    angle = course - math.pi / 2 + rate * 3.0
    expected = (centre[0] + 5.0 * math.cos(angle), centre[1] + 5.0 * math.sin(angle))
    assert later.position_m[:2] == pytest.approx(expected, abs=1e-9)
    assert math.atan2(later.velocity_m_s[1], later.velocity_m_s[0]) == pytest.approx(
        math.remainder(course + 0.9, math.tau)
    )


def test_a_word_is_led_for_a_while_only() -> None:
    lead = Lead(0.0, (0.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    assert lead.at(4.0, 5.0) == Motion((8.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    assert lead.at(60.0, 5.0) == Motion((10.0, 0.0, 0.0))


def test_the_turn_rate_comes_from_two_words_across_south_too() -> None:
    old = Lead(0.0, (0.0, 0.0, 0.0), (-1.0, 0.1, 0.0))
    rate = turn_rate(old, 2.0, (-1.0, -0.1, 0.0))
    assert rate == pytest.approx(2.0 * math.atan(0.1) / 2.0)
    assert turn_rate(old, 2.0, (0.01, 0.0, 0.0)) == 0.0
    assert turn_rate(None, 2.0, (1.0, 0.0, 0.0)) == 0.0
    assert abs(turn_rate(old, 0.6, (1.0, 0.0, 0.0))) == 1.0


def test_the_newest_word_counts_until_it_is_stale() -> None:
    w = Whereabouts(CONFIG)
    w.start = Lead(-math.inf, (1.0, 1.0, -7.0))
    assert w.likely(0.0).position_m[:2] == (1.0, 1.0)
    w.remember(Motion((5.0, 0.0, 0.0)), 2.0, 2.0)
    assert w.likely(3.0).position_m[:2] == pytest.approx((5.0, 0.0))
    w.hear(beacon(4.0, 20.0, -3.0, (0.0, 0.0, 0.0)), ORIGIN)
    assert w.likely(5.0).position_m[:2] == pytest.approx((20.0, -3.0), abs=1e-3)
    assert w.source(5.0) == "by its beacon"
    assert w.likely(4.0 + CONFIG.trust_s + 0.1).position_m[:2] == (1.0, 1.0)


def test_the_last_sight_counts_from_when_it_was_seen_not_from_what_the_filter_made_of_it() -> None:
    w = Whereabouts(CONFIG)
    # seen at 1 s; at 3 s the filter has led it on by 4 m
    w.remember(Motion((14.0, 0.0, 0.0), (2.0, 0.0, 0.0)), 1.0, 3.0)
    assert w.likely(3.0).position_m[0] == pytest.approx(14.0)
    assert w.likely(1.0).position_m[0] == pytest.approx(10.0)


def test_setpoints_stream_before_control_is_asked_for() -> None:
    search, guide = searching()
    here = guide.at(0.0)
    asked = [t / 30.0 for t in range(30) if search.step(here, False, False, t / 30.0).ask_for_control]
    assert asked[0] == pytest.approx(CONFIG.stream_s, abs=0.04)
    assert guide.active


def test_it_holds_asks_at_once_and_every_few_seconds() -> None:
    search, guide = searching()
    requests, first_move = [], None
    for k in range(600):
        now = k / 30.0
        step = search.step(guide.at(now), True, False, now)
        if step.request_pad:
            requests.append(now)
        if step.flying and first_move is None:
            first_move = now
    assert requests == pytest.approx([0.0, 5.0, 10.0, 15.0], abs=0.15)
    assert first_move == pytest.approx(CONFIG.hold_s, abs=0.04)


def test_a_pad_in_view_ends_the_search_without_a_request() -> None:
    search, guide = searching()
    step = search.step(guide.at(0.0), True, True, 0.0)
    assert step.seen
    assert not step.request_pad


def test_it_flies_to_the_beacon_and_goes_along_with_it() -> None:
    search, guide = searching()
    along = 0
    for k in range(450):
        now = k / 30.0
        if k % 90 == 30:
            search.hear(beacon(now, 12.0 + 1.0 * now, -6.0, (1.0, 0.0, 0.0)), ORIGIN)
        search.step(guide.at(now), True, False, now)
        north, east, down = guide.at(now).position_m
        if math.hypot(north - 12.0 - now, east + 6.0) < 1.0:
            along += abs(guide.at(now).velocity_m_s[0] - 1.0) < 0.3
            assert down == pytest.approx(-7.0, abs=0.05)
    # for a second at least before it looks elsewhere
    assert along >= 30


def test_without_any_word_it_spirals_out_and_stays_within_its_radius() -> None:
    search, guide = searching()
    farthest, quadrants = 0.0, set()
    for k in range(3000):
        now = k / 30.0
        search.step(guide.at(now), True, False, now)
        north, east, _ = guide.at(now).position_m
        farthest = max(farthest, math.hypot(north, east))
        if farthest > 3.0:
            quadrants.add((north > 0.0, east > 0.0))
    assert 9.0 < farthest <= CONFIG.radius_m + 1.0
    assert len(quadrants) == 4


def test_the_climb_of_a_search_is_bounded() -> None:
    search, guide = searching()
    assert search.begin(50.0, math.inf, 0.0) == CONFIG.climb_m
    assert search.begin(-3.0, math.inf, 0.0) == 0.0
    assert search.begin(2.0, math.inf, 0.0) == 2.0
    for k in range(300):
        search.step(guide.at(k / 30.0), True, False, k / 30.0)
    assert guide.at(10.0).position_m[2] == pytest.approx(-9.0, abs=0.05)


def test_a_word_far_from_the_old_one_is_a_surprise() -> None:
    w = Whereabouts(CONFIG)
    w.start = Lead(-math.inf, (0.0, 0.0, -7.0))
    assert w.hear(beacon(1.0, 10.0, 0.0, (1.0, 0.0, 0.0)), ORIGIN)
    assert not w.hear(beacon(3.0, 12.2, 0.0, (1.0, 0.0, 0.0)), ORIGIN)
    again = beacon(4.0, 30.0, 0.0, (1.0, 0.0, 0.0))
    assert w.hear(again, ORIGIN)
    assert not w.hear(again, ORIGIN)
    assert not w.hear(beacon(5.0, 99.0, 0.0, (1.0, 0.0, 0.0)), None)


def test_a_search_that_begins_below_the_floor_climbs_to_it_however_small_the_bound() -> None:
    guide = Guide(GuidanceConfig(), lambda _d, _v, _a: 1.5, 20, 0.1)
    guide.start("local", Motion((0.0, 0.0, -0.5)), 0.0)
    search = Search(CONFIG.model_copy(update={"climb_m": 0.5}), guide)
    assert search.begin(0.0, -1.5, 0.0) == pytest.approx(1.0)
    for k in range(150):
        search.step(guide.at(k / 30.0), True, False, k / 30.0)
    assert guide.at(5.0).position_m[2] == pytest.approx(-1.5, abs=0.05)


def test_a_floor_that_rises_is_kept_above_in_steps_and_not_without_end() -> None:
    search, _ = searching()
    assert search.keep_above(-6.9) == 0.0
    assert search.keep_above(-7.2) == 0.0  # within a step
    first = search.keep_above(-7.4)
    assert first == pytest.approx(0.7)
    assert search.keep_above(-7.6) == 0.0
    total = first + sum(search.keep_above(-8.0 - k) for k in range(50))
    assert total == pytest.approx(CONFIG.climb_m, abs=0.31)
