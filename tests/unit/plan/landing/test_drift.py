"""What a level vehicle drifts by, and how the reference comes against it."""

import cmath
import math

import pytest

from companion.base.geometry import ZERO3
from companion.base.motion import Motion
from companion.config import GuidanceConfig
from companion.plan.landing.drift import AFTER_S, FOLLOWS_S, LEADS_S, LEVELS_M_S3, Drift
from companion.plan.trajectory.course import Course

LIMITS = GuidanceConfig()
LEVEL_S = 0.1
WIND = 1.2 - 0.9j
STEP_S = 1e-4


def drift(lacks_m_s2: complex = WIND, due_s: float = 3.0) -> Drift:
    return Drift(lacks_m_s2, due_s, LEVEL_S)


def aside(motion: Motion) -> tuple[complex, complex, complex]:
    rows = (motion.position_m, motion.velocity_m_s, motion.acceleration_m_s2)
    north, east, down = (complex(*row[:2]) for row in rows)
    return north, east, down


def still(_: float) -> Motion:
    return Motion(ZERO3)


def led(of: Drift, now_s: float) -> Course:
    course = of.lead(still, LIMITS, now_s)
    assert course is not None
    return course


def hardest_m_s2(course: Course) -> float:
    lead = course.legs[0]
    times_s = [lead.start_s + 0.02 * k * lead.duration_s for k in range(51)]
    return max(abs(aside(lead.at(time_s))[2]) for time_s in times_s)


@pytest.mark.parametrize("before_s", [1.0, 0.2, 0.15, 0.05])
@pytest.mark.parametrize("lacks_m_s2", [0j, 0.8j, WIND])
def test_who_lacks_something_touches_as_by_summing_it_up(lacks_m_s2: complex, before_s: float) -> None:
    falls, levels_s = drift(lacks_m_s2), abs(lacks_m_s2) / LEVELS_M_S3
    time_s = falls.due_s - before_s
    place, velocity = 0.1 + 0.05j, -0.2 + 0.1j
    begins = Motion((place.real, place.imag, 0.4), (velocity.real, velocity.imag, 0.2))
    for k in range(round(before_s / STEP_S)):
        level_for_s = time_s + (k + 0.5) * STEP_S - (falls.due_s - LEVEL_S - levels_s)
        share = 1.0 if levels_s == 0.0 else min(1.0, max(0.0, level_for_s / levels_s))
        velocity -= lacks_m_s2 * share * STEP_S
        place += velocity * STEP_S
    found = aside(falls.contact(begins, time_s))
    assert found[0] == pytest.approx(place, abs=1e-4)
    assert found[1] == pytest.approx(velocity, abs=1e-3)


@pytest.mark.parametrize("before_s", [0.5, 0.25, 0.12, 0.05])
def test_who_comes_against_it_is_over_the_middle_and_still_when_it_touches(before_s: float) -> None:
    time_s = drift().due_s - before_s
    place, velocity, _ = aside(drift().contact(drift().towards_middle(time_s), time_s))
    assert place == pytest.approx(0j, abs=1e-9)
    assert velocity == pytest.approx(0j, abs=1e-9)


def test_the_way_goes_smoothly_from_where_it_is_to_the_middle_of_the_pad() -> None:
    course = led(drift(), 1.0)
    assert aside(course.at(course.start_s)) == (0j, 0j, 0j)
    assert course.start_s == pytest.approx(drift().begins_s - LEADS_S)
    for here, there in zip(course.legs, course.legs[1:], strict=False):
        ends, begins = aside(here.at(here.end_s)), aside(there.at(there.start_s))
        assert here.end_s == pytest.approx(there.start_s)
        assert ends == pytest.approx(begins, abs=1e-9)
    place, velocity, acceleration = aside(course.at(drift().due_s))
    assert place == pytest.approx(0j, abs=1e-9)
    assert velocity == pytest.approx(0j, abs=1e-9)
    assert acceleration == pytest.approx(-WIND)
    assert aside(course.at(course.end_s))[:2] == pytest.approx((0j, 0j), abs=1e-9)


def test_after_it_was_due_the_reference_drifts_on_as_a_level_vehicle_does() -> None:
    course, after_s = led(drift(), 1.0), 0.5 * AFTER_S
    place, velocity, _ = aside(course.at(drift().due_s + after_s))
    assert place == pytest.approx(-0.5 * WIND * after_s**2)
    assert velocity == pytest.approx(-WIND * after_s)


def test_where_the_limits_ask_for_it_it_begins_sooner() -> None:
    strong = drift(cmath.rect(3.0, 1.0))
    course = led(strong, 0.0)
    assert strong.begins_s - course.start_s > 1.2 * LEADS_S
    assert hardest_m_s2(course) <= 1.05 * LIMITS.horizontal_acceleration_m_s2
    assert aside(course.at(strong.due_s))[1] == pytest.approx(0j, abs=5e-3)


@pytest.mark.parametrize("left_s", [0.3, 0.6])
def test_with_too_little_time_it_comes_as_far_as_the_limits_let_it(left_s: float) -> None:
    strong = drift(cmath.rect(3.0, 1.0))
    course, none = led(strong, strong.begins_s - left_s), strong.contact(Motion(ZERO3), 0.0)
    assert hardest_m_s2(course) <= 1.05 * LIMITS.horizontal_acceleration_m_s2
    speed, without = (aside(motion)[1] for motion in (course.at(strong.due_s), none))
    assert 0.02 * abs(without) < abs(speed) < 0.98 * abs(without)
    assert cmath.phase(speed / without) == pytest.approx(0.0, abs=1e-6)
    begun = course.at(strong.begins_s)
    assert aside(strong.contact(begun, strong.begins_s))[:2] == pytest.approx(
        aside(course.at(strong.due_s))[:2], abs=1e-9
    )


def test_planned_anew_from_where_it_is_the_way_leads_as_far_as_before() -> None:
    strong = drift(cmath.rect(3.0, 1.0))
    course = led(strong, strong.begins_s - 0.7)
    begun_m_s = abs(aside(course.at(strong.begins_s))[1])
    for k in range(1, 12):
        again = strong.lead(course.at, LIMITS, strong.begins_s - 0.7 + k / 30.0)
        assert again is not None
        assert abs(aside(again.at(strong.begins_s))[1]) == pytest.approx(begun_m_s, rel=0.05)
        course = again


def test_a_reference_that_can_no_more_be_stopped_in_time_goes_on_as_it_was() -> None:
    fast = Motion((0.2, 0.0, 0.0), (-1.2, 0.0, 0.0))
    assert drift().lead(lambda _: fast, LIMITS, drift().begins_s - 0.3) is None


def test_too_late_for_a_way_that_the_vehicle_can_follow_there_is_none() -> None:
    assert drift().lead(still, LIMITS, drift().begins_s - 0.98 * FOLLOWS_S) is None
    assert drift().lead(still, LIMITS, drift().begins_s - 1.02 * FOLLOWS_S) is not None


def test_in_still_air_it_only_comes_to_the_middle() -> None:
    calm = drift(0j)
    course = calm.lead(lambda _: Motion((0.02, 0.0, 0.0)), LIMITS, 1.0)
    assert course is not None
    assert aside(course.at(calm.due_s)) == pytest.approx((0j, 0j, 0j), abs=1e-9)
    assert all(math.hypot(*course.at(1.0 + 0.1 * k).position_m[:2]) <= 0.021 for k in range(30))
