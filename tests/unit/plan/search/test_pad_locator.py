"""Where the pad is looked for: the spiral, words of the beacon led on, and the last sight."""

import math
from dataclasses import replace

import pytest

from companion.base.motion import Motion
from companion.config import GuidanceConfig
from companion.plan.search.pad_locator import Lead, PadLocator, turn_rate
from companion.plan.search.search import Search, square_spiral
from companion.plan.trajectory.reference_generator import ReferenceGenerator
from tests.unit.plan.search.search_words import CONFIG, ORIGIN, UNSEEN, beacon


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


def on_circle(radius_m: float, now_s: float) -> tuple[tuple[float, float], tuple[float, float, float]]:
    """Where a pad is that goes round through (8, 0) at 2.4 m/s, and its velocity; right for radii over 0."""
    angle = 2.4 / radius_m * now_s
    place = (8.0 - radius_m + radius_m * math.cos(angle), radius_m * math.sin(angle))
    return place, (-2.4 * math.sin(angle), 2.4 * math.cos(angle), 0.0)


@pytest.mark.parametrize("radius_m", [3.8, -3.8, 6.0, 30.0])
@pytest.mark.parametrize("gap_s", [0.2, 0.6, 1.5])
def test_a_pad_that_turns_is_caught_up_with(radius_m: float, gap_s: float) -> None:
    # GIVEN a search that dwells over where the pad should be
    generator = ReferenceGenerator(GuidanceConfig(), lambda _d, _v, _a: 1.5, 20, 0.1)
    generator.start("local", Motion((0.0, 0.0, -7.0)), 0.0)
    search = Search(CONFIG.model_copy(update={"dwell_s": 30.0}), generator)
    search.begin(0.0, math.inf, 0.0)
    heard_s, farthest_m = -math.inf, 0.0
    for k in range(round(24.0 * 30.0)):
        now_s = k / 30.0
        if now_s - heard_s >= gap_s:
            heard_s = now_s
            place, velocity = on_circle(radius_m, now_s)
            search.hear(beacon(now_s, *place, velocity), ORIGIN)
        search.step(generator.at(now_s), True, UNSEEN, now_s)
        if now_s > 14.0:
            here = generator.at(now_s).position_m
            farthest_m = max(farthest_m, math.dist(here[:2], on_circle(radius_m, now_s)[0]))
    # THEN it does not lag; planned towards a point that goes straight on it did, by a metre on the tightest
    assert farthest_m < 0.5


def test_the_turn_rate_comes_from_two_words_across_south_too() -> None:
    old = Lead(0.0, (0.0, 0.0, 0.0), (-1.0, 0.1, 0.0))
    rate = turn_rate(old, 2.0, (-1.0, -0.1, 0.0))
    assert rate == pytest.approx(2.0 * math.atan(0.1) / 2.0)
    assert turn_rate(old, 2.0, (0.01, 0.0, 0.0)) == 0.0
    assert turn_rate(None, 2.0, (1.0, 0.0, 0.0)) == 0.0
    # a pad that turned back, or words between which it may have gone round, tell no turn
    assert turn_rate(old, 1.1, (1.0, 0.0, 0.0)) == 0.0
    assert turn_rate(old, 3.1, (-1.0, -0.1, 0.0)) == 0.0
    # two words close to one another say nothing of a turn: what was known stays
    assert turn_rate(replace(old, turn_rate_rad_s=0.4), 0.9, (1.0, 0.0, 0.0)) == 0.4


def test_the_newest_word_counts_until_it_is_stale() -> None:
    w = PadLocator(CONFIG)
    w.start = Lead(-math.inf, (1.0, 1.0, -7.0))
    assert w.likely(0.0).position_m[:2] == (1.0, 1.0)
    w.remember(Motion((5.0, 0.0, 0.0)), 2.0, 2.0)
    assert w.likely(3.0).position_m[:2] == pytest.approx((5.0, 0.0))
    w.hear(beacon(4.0, 20.0, -3.0, (0.0, 0.0, 0.0)), ORIGIN)
    assert w.likely(5.0).position_m[:2] == pytest.approx((20.0, -3.0), abs=1e-3)
    assert w.source(5.0) == "by its beacon"
    assert w.likely(4.0 + CONFIG.trust_s + 0.1).position_m[:2] == (1.0, 1.0)


def test_the_last_sight_counts_from_when_it_was_seen_not_from_what_the_filter_made_of_it() -> None:
    w = PadLocator(CONFIG)
    # seen at 1 s; at 3 s the filter has led it on by 4 m
    w.remember(Motion((14.0, 0.0, 0.0), (2.0, 0.0, 0.0)), 1.0, 3.0)
    assert w.likely(3.0).position_m[0] == pytest.approx(14.0)
    assert w.likely(1.0).position_m[0] == pytest.approx(10.0)


def test_a_sight_that_is_kept_is_not_led_on_a_second_time() -> None:
    w = PadLocator(CONFIG)
    # GIVEN a pad on a circle of 4 m at 2 m/s, seen at 1 s, when it went north
    w.remember(Motion((0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 1.0, 0.0)), 1.0, 1.0)
    for k in range(1, 4):
        # WHEN the filter leads it on, and turns it
        now_s, turned = 1.0 + 0.5 * k, 0.25 * k
        course = (2.0 * math.cos(turned), 2.0 * math.sin(turned), 0.0)
        w.remember(Motion((2.0 * k * 0.5, 0.0, 0.0), course, (0.0, 1.0, 0.0)), 1.0, now_s)
    # THEN it is still where its circle says, seen from the sight
    assert w.likely(2.5).position_m[:2] == pytest.approx(
        (4.0 * math.sin(0.75), 4.0 - 4.0 * math.cos(0.75)), abs=1e-6
    )


def test_no_more_acceleration_is_followed_than_a_vehicle_can_tilt_for() -> None:
    for speed_m_s, followed_m_s2 in ((1.5, 1.5), (2.5, 2.0), (10.0, 2.0)):
        pad = Lead(0.0, (0.0, 0.0, 0.0), (speed_m_s, 0.0, 0.0), -1.0).at(0.0, 5.0)
        assert pad.acceleration_m_s2 == pytest.approx((0.0, -followed_m_s2, 0.0))


def test_a_word_far_from_the_old_one_is_a_surprise() -> None:
    w = PadLocator(CONFIG)
    w.start = Lead(-math.inf, (0.0, 0.0, -7.0))
    assert w.hear(beacon(1.0, 10.0, 0.0, (1.0, 0.0, 0.0)), ORIGIN)
    assert not w.hear(beacon(3.0, 12.2, 0.0, (1.0, 0.0, 0.0)), ORIGIN)
    again = beacon(4.0, 30.0, 0.0, (1.0, 0.0, 0.0))
    assert w.hear(again, ORIGIN)
    assert not w.hear(again, ORIGIN)
    assert not w.hear(beacon(5.0, 99.0, 0.0, (1.0, 0.0, 0.0)), None)


def test_the_beacons_offset_is_learnt_from_a_sight_and_kept() -> None:
    w = PadLocator(CONFIG)
    w.start = Lead(-math.inf, (0.0, 0.0, -7.0))
    # GIVEN a pad at 1 m/s and a beacon 3 m north and 2 m west of it
    w.remember(Motion((10.0, 5.0, 0.0), (1.0, 0.0, 0.0)), 1.0, 1.0)
    compared = [w.beacon_compared]
    w.hear(beacon(2.0, 14.0, 3.0, (1.0, 0.0, 0.0)), ORIGIN)
    compared.append(w.beacon_compared)
    assert compared == [False, True]
    assert w.likely(2.0).position_m[:2] == pytest.approx((11.0, 5.0), abs=1e-3)
    # THEN it still holds when the sight is long gone
    w.hear(beacon(9.0, 21.0, 3.0, (1.0, 0.0, 0.0)), ORIGIN)
    assert w.likely(9.0).position_m[:2] == pytest.approx((18.0, 5.0), abs=1e-3)


def test_neither_an_old_sight_nor_a_far_one_says_how_far_the_beacon_is_off() -> None:
    for seen_s, north in ((0.4, 12.0), (1.9, 40.0)):
        w = PadLocator(CONFIG)
        w.start = Lead(-math.inf, (0.0, 0.0, -7.0))
        w.remember(Motion((10.0, 5.0, 0.0)), seen_s, seen_s)
        w.hear(beacon(2.0, north, 5.0, (0.0, 0.0, 0.0)), ORIGIN)
        assert not w.beacon_compared
        assert w.likely(2.0).position_m[:2] == pytest.approx((north, 5.0), abs=1e-3)
