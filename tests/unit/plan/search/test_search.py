"""The search: setpoints, requests, climbs, and taking up a pad that is seen."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from companion.base.geometry import geodetic_from_ned
from companion.base.messages import PadBeacon
from companion.base.motion import Motion
from companion.config import GuidanceConfig, SearchConfig
from companion.plan.landing.relative_state import PadTrack
from companion.plan.search.pad_locator import Lead, PadLocator, turn_rate
from companion.plan.search.search import Search, square_spiral
from companion.plan.trajectory.reference_generator import ReferenceGenerator
from tests.unit.plan.pad_paths import still
from tests.unit.plan.plan_harness import PlanWorld

ORIGIN = (47.0, 8.0, 400.0)
CONFIG = SearchConfig()
UNSEEN = PadTrack(1)


def beacon(time_s: float, north: float, east: float, velocity: tuple[float, float, float]) -> PadBeacon:
    latitude, longitude, altitude = geodetic_from_ned((north, east, 0.0), ORIGIN)
    return PadBeacon(time_s, latitude, longitude, altitude, velocity, 1.5)


# ---------------- The search: setpoints, requests, climbs, and taking up a pad that is seen


def in_view(
    aside_m: float = 0.0, speed_m_s: float = 0.0, velocity_std_m_s: float = 0.1, now_s: float = 0.0
) -> PadTrack:
    """A pad 7 m below, `aside_m` south of the vehicle, which flies north at a speed."""
    w = PlanWorld(still())
    w.now_s, w.position, w.velocity = now_s, (10.6 + aside_m, 0.8, -7.3), (speed_m_s, 0.0, 0.0)
    w._sense()
    given = w.inputs()
    assert given.pad is not None
    known = PadTrack(1)
    known.update(replace(given.pad, velocity_std_m_s=velocity_std_m_s), given.vehicle, now_s)
    return known


def searching() -> tuple[Search, ReferenceGenerator]:
    generator = ReferenceGenerator(GuidanceConfig(), lambda _d, _v, _a: 1.5, 20, 0.1)
    generator.start("local", Motion((0.0, 0.0, -7.0)), 0.0)
    search = Search(CONFIG, generator)
    search.begin(0.0, math.inf, 0.0)
    return search, generator


def test_setpoints_stream_before_control_is_asked_for() -> None:
    search, generator = searching()
    here = generator.at(0.0)
    asked = [t / 30.0 for t in range(30) if search.step(here, False, UNSEEN, t / 30.0).streaming]
    assert asked[0] == pytest.approx(CONFIG.stream_s, abs=0.04)
    assert generator.active


def test_it_holds_asks_at_once_and_every_few_seconds() -> None:
    search, generator = searching()
    requests, first_move = [], None
    for k in range(600):
        now = k / 30.0
        step = search.step(generator.at(now), True, UNSEEN, now)
        if step.request_pad:
            requests.append(now)
        if step.flying and first_move is None:
            first_move = now
    expected = [CONFIG.request_s * k for k in range(14)]
    assert requests == pytest.approx(expected, abs=0.5)
    assert min(b - a for a, b in pairwise(requests)) >= CONFIG.request_s
    assert first_move == pytest.approx(CONFIG.hold_s, abs=0.04)


def test_a_pad_in_view_ends_the_search_without_a_request() -> None:
    search, generator = searching()
    step = search.step(generator.at(0.0), True, in_view(), 0.0)
    assert step.seen
    assert not step.request_pad


def test_it_flies_to_the_beacon_and_goes_along_with_it() -> None:
    search, generator = searching()
    along = 0
    for k in range(600):
        now = k / 30.0
        if k % 90 == 30:
            search.hear(beacon(now, 12.0 + 1.0 * now, -6.0, (1.0, 0.0, 0.0)), ORIGIN)
        search.step(generator.at(now), True, UNSEEN, now)
        north, east, down = generator.at(now).position_m
        if math.hypot(north - 12.0 - now, east + 6.0) < 1.0:
            along += abs(generator.at(now).velocity_m_s[0] - 1.0) < 0.3
            assert down == pytest.approx(-7.0, abs=0.05)
    # for a second at least before it looks elsewhere
    assert along >= 30


def test_without_any_word_it_spirals_out_and_stays_within_its_radius() -> None:
    search, generator = searching()
    farthest, quadrants = 0.0, set()
    for k in range(3000):
        now = k / 30.0
        search.step(generator.at(now), True, UNSEEN, now)
        north, east, _ = generator.at(now).position_m
        farthest = max(farthest, math.hypot(north, east))
        if farthest > 3.0:
            quadrants.add((north > 0.0, east > 0.0))
    assert 9.0 < farthest <= CONFIG.radius_m + 1.0
    assert len(quadrants) == 4


def test_the_climb_of_a_search_is_bounded() -> None:
    search, generator = searching()
    assert search.begin(50.0, math.inf, 0.0) == CONFIG.climb_m
    assert search.begin(-3.0, math.inf, 0.0) == 0.0
    assert search.begin(2.0, math.inf, 0.0) == 2.0
    for k in range(300):
        search.step(generator.at(k / 30.0), True, UNSEEN, k / 30.0)
    assert generator.at(10.0).position_m[2] == pytest.approx(-9.0, abs=0.05)


def test_a_search_that_begins_below_the_floor_climbs_to_it_however_small_the_bound() -> None:
    generator = ReferenceGenerator(GuidanceConfig(), lambda _d, _v, _a: 1.5, 20, 0.1)
    generator.start("local", Motion((0.0, 0.0, -0.5)), 0.0)
    search = Search(CONFIG.model_copy(update={"climb_m": 0.5}), generator)
    assert search.begin(0.0, -1.5, 0.0) == pytest.approx(1.0)
    for k in range(150):
        search.step(generator.at(k / 30.0), True, UNSEEN, k / 30.0)
    assert generator.at(5.0).position_m[2] == pytest.approx(-1.5, abs=0.05)


def test_a_floor_that_rises_is_kept_above_in_steps_and_not_without_end() -> None:
    search, _ = searching()
    assert search.keep_above(-6.9) == 0.0
    assert search.keep_above(-7.2) == 0.0  # within a step
    first = search.keep_above(-7.4)
    assert first == pytest.approx(0.7)
    assert search.keep_above(-7.6) == 0.0
    total = first + sum(search.keep_above(-8.0 - k) for k in range(50))
    assert total == pytest.approx(CONFIG.climb_m, abs=0.31)


@pytest.mark.parametrize(
    ("known", "taken"),
    [
        (in_view(), True),
        (in_view(velocity_std_m_s=0.51), False),
        (in_view(aside_m=2.7), True),
        (in_view(aside_m=2.9), False),
        # stops v^2/4 farther on: 1 m at 2 m/s, 6 m at 5 m/s
        (in_view(aside_m=1.7, speed_m_s=2.0), True),
        (in_view(aside_m=1.9, speed_m_s=2.0), False),
        (in_view(aside_m=-2.0, speed_m_s=2.0), True),
        (in_view(speed_m_s=5.0), False),
    ],
)
def test_a_pad_is_taken_up_when_it_is_known_and_will_stay_in_view(known: PadTrack, taken: bool) -> None:
    search, generator = searching()
    step = search.step(generator.at(0.0), True, known, 0.0)
    assert step.seen is taken
    assert not step.request_pad


def test_a_pad_in_view_for_long_is_taken_up_however_it_moves() -> None:
    search, generator = searching()
    for now, taken in ((0.0, False), (2.9, False), (3.1, True)):
        known = in_view(velocity_std_m_s=2.0, now_s=now)
        assert search.step(generator.at(now), True, known, now).seen is taken


def test_a_pad_seen_in_passing_is_flown_back_to_at_once() -> None:
    search, generator = searching()
    search.locator.remember(Motion((5.0, 0.0, -0.3), (0.5, 0.0, 0.0)), 0.0, 0.0)
    assert search.step(generator.at(0.0), True, UNSEEN, 0.0).flying
    assert not searching()[0].step(generator.at(0.0), True, UNSEEN, 0.0).flying
    for k in range(120):
        search.step(generator.at(k / 30.0), True, UNSEEN, k / 30.0)
    assert generator.at(4.0).position_m[0] > 5.5


def test_until_the_beacon_is_compared_its_position_is_asked_for_every_so_often() -> None:
    search, _ = searching()
    asked = [k / 30.0 for k in range(90) if search.ask_again(0.0, k / 30.0)]
    assert asked == pytest.approx([0.0, 1.5], abs=0.04)


def test_once_compared_it_is_asked_for_while_the_pad_is_unseen_only() -> None:
    search, _ = searching()
    search.locator.remember(Motion((0.0, 0.0, 0.0)), 1.0, 1.0)
    search.hear(beacon(1.5, 1.0, 0.0, (0.0, 0.0, 0.0)), ORIGIN)
    assert [search.ask_again(unseen_s, 20.0) for unseen_s in (0.0, 1.0)] == [False, True]


def test_each_corner_is_sought_before_it_is_given_up_for_an_obstacle() -> None:
    # GIVEN a search whose every corner is out of reach
    search, generator = searching()
    generator.avoidance._block(0.0)
    corners = set()
    for k in range(round(10.0 * 30.0)):
        search._target(k / 30.0)
        corners.add(search._corner)
        if k == 149:
            # THEN they are given up one after another, each with time for a way to it to be found
            assert 3 <= search._corner <= 10
    assert corners == set(range(max(corners) + 1))


@pytest.mark.parametrize(("speed_m_s", "followed"), [(4.0, True), (6.0, False)])
def test_a_pad_that_is_reported_to_be_too_fast_is_waited_for_not_chased(
    speed_m_s: float, followed: bool
) -> None:
    generator = ReferenceGenerator(GuidanceConfig(), lambda _d, _v, _a: 1.5, 20, 0.1)
    generator.start("local", Motion((0.0, 0.0, -7.0)), 0.0)
    search = Search(CONFIG, generator, fastest_m_s=5.0)
    search.begin(0.0, math.inf, 0.0)
    for k in range(600):
        now = k / 30.0
        if k % 30 == 0:  # a beacon a second: away to the east, and from 10 s on it stands
            told = min(now, 10.0)
            moves = speed_m_s if now < 10.0 else 0.0
            search.hear(beacon(now, 3.0, speed_m_s * told, velocity=(0.0, moves, 0.0)), ORIGIN)
        search.step(generator.at(now), True, UNSEEN, now)
        if k == 290:
            assert (generator.at(now).position_m[1] > 20.0) is followed
            assert (math.hypot(*generator.at(now).velocity_m_s) < 0.1) is not followed
    # it has come to rest, and is flown to
    assert generator.at(20.0).velocity_m_s[1] > 0.5 or followed


# ---------------- Where the pad is looked for: the spiral, words of the beacon led on, and the last sight


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
