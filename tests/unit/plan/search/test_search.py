"""The search: setpoints, requests, climbs, and taking up a pad that is seen."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from companion.base.motion import Motion
from companion.config import GuidanceConfig
from companion.plan.landing.relative_state import PadTrack
from companion.plan.search.search import Search
from companion.plan.trajectory.reference_generator import ReferenceGenerator
from tests.unit.plan.pad_paths import still
from tests.unit.plan.plan_harness import PlanWorld
from tests.unit.plan.search.search_words import CONFIG, ORIGIN, UNSEEN, beacon


def in_view(
    aside_m: float = 0.0, speed_m_s: float = 0.0, velocity_std_m_s: float = 0.1, now_s: float = 0.0
) -> PadTrack:
    """A pad 7 m below, `aside_m` south of the vehicle, which flies north at a speed."""
    w = PlanWorld(still())
    w.now_s, w.position, w.velocity = now_s, (10.6 + aside_m, 0.8, -7.3), (speed_m_s, 0.0, 0.0)
    w._sense()
    given = w.inputs()
    assert given.pad is not None
    known = PadTrack(1, 0.5)
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
    requests, told, first_move = [], 0, None
    for k in range(600):
        now = k / 30.0
        step = search.step(generator.at(now), True, UNSEEN, now)
        if step.request_pad:
            requests.append(now)
        told += step.worth_telling
        if step.flying and first_move is None:
            first_move = now
    assert told == 4  # every 5 s of the 20
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
    generator.avoidance.blocked = True
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
