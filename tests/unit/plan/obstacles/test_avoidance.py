import math
from itertools import pairwise

import numpy as np
import pytest

from companion.base.geometry import Vector3, add, norm, scale, subtract
from companion.base.motion import Motion
from companion.config import Box, Cylinder, PlanConfig, Shape
from companion.plan.obstacles.avoidance import Avoidance
from companion.plan.obstacles.obstacles import Obstacle, _graph, clearance_m
from companion.plan.trajectory.min_jerk import plan
from companion.plan.trajectory.reference_generator import ReferenceGenerator

CYCLE_S = 1.0 / 30.0
RADIUS_M = 0.4
HOME = (0.7, -1.2, 2.5)  # not where the EKF's origin is
MARGIN_M = PlanConfig().obstacle_margin_m + RADIUS_M


def pole(north: float, east: float, radius: float = 0.3, height: float = 20.0) -> Cylinder:
    return Cylinder(kind="cylinder", centre_ned_m=(north, east), radius_m=radius, height_m=height)


def wall(north: float, east: float, length: float, heading: float = 90.0, height: float = 20.0) -> Box:
    return Box(
        kind="box",
        centre_ned_m=(north, east),
        length_m=length,
        width_m=0.4,
        heading_deg=heading,
        height_m=height,
    )


def generator(*shapes: Shape, ceiling: float = 15.0) -> ReferenceGenerator:
    config = PlanConfig(obstacles=shapes, obstacle_ceiling_m=ceiling)
    made = ReferenceGenerator(config.guidance, lambda _d, _v, _a: 2.0, 20, 0.1, Avoidance(config, RADIUS_M))
    made.see(HOME, None)
    return made


def from_home(north: float, east: float, height: float) -> Vector3:
    return add(HOME, (north, east, -height))


def clearance(places: list[Vector3], shapes: tuple[Shape, ...]) -> float:
    points = np.array([subtract(place, HOME) for place in places])
    return float(np.min(clearance_m(points, [Obstacle.of(shape) for shape in shapes])))


def fly(g: ReferenceGenerator, target: Motion, seconds: float, start_s: float = 0.0) -> list[Motion]:
    """Every cycle towards a target that goes on at its velocity; the reference's states in the EKF's NED."""
    flown = []
    for k in range(round(seconds / CYCLE_S)):
        t = start_s + k * CYCLE_S
        led = add(target.position_m, scale(target.velocity_m_s, k * CYCLE_S))
        g.fly_to(Motion(led, target.velocity_m_s), t)
        flown.append(g.at(t + CYCLE_S))
    return flown


def assert_smooth(flown: list[Motion]) -> None:
    for before, after in pairwise(flown):
        expected = add(before.position_m, scale(before.velocity_m_s, CYCLE_S))
        assert math.dist(after.position_m, expected) < 0.01
        assert math.dist(after.velocity_m_s, before.velocity_m_s) < 5.0 * CYCLE_S
        assert math.dist(after.acceleration_m_s2, before.acceleration_m_s2) < 1.5


@pytest.mark.parametrize(
    "shapes",
    [
        (pole(6.0, 0.2),),
        (wall(6.0, 2.0, 7.0),),
        (pole(4.0, -1.0), pole(8.0, 1.5), wall(11.0, -3.0, 6.0, heading=60.0)),
    ],
)
def test_what_stands_in_the_way_is_flown_round_smoothly_and_the_target_reached(
    shapes: tuple[Shape, ...],
) -> None:
    g = generator(*shapes)
    g.start("local", Motion(from_home(0.0, 0.0, 5.0)), 0.0)
    goal = from_home(15.0, 0.0, 5.0)
    flown = fly(g, Motion(goal), 25.0)
    assert clearance([m.position_m for m in flown], shapes) >= MARGIN_M - 0.02
    assert math.dist(flown[-1].position_m, goal) < 0.05
    assert_smooth(flown)


def test_without_obstacles_in_the_way_nothing_changes() -> None:
    far, none = generator(pole(5.0, 30.0)), generator()
    for g in (far, none):
        g.start("local", Motion(from_home(0.0, 0.0, 5.0), (1.0, 0.5, 0.0)), 0.0)
    target = Motion(from_home(15.0, 3.0, 4.0), (0.5, 0.0, 0.0))
    assert fly(far, target, 3.0) == fly(none, target, 3.0)


def test_a_low_wall_is_flown_over_and_not_over_the_ceiling() -> None:
    low = (wall(6.0, 0.0, 40.0, height=3.0),)
    for ceiling, highest in ((8.0, 5.8), (4.0, 3.2)):
        g = generator(*low, ceiling=ceiling)
        g.start("local", Motion(from_home(0.0, 0.0, 3.0)), 0.0)
        flown = fly(g, Motion(from_home(12.0, 0.0, 3.0)), 60.0 if ceiling < 5.0 else 25.0)
        assert clearance([m.position_m for m in flown], low) >= MARGIN_M - 0.02
        assert HOME[2] - min(m.position_m[2] for m in flown) < highest
        assert math.dist(flown[-1].position_m, from_home(12.0, 0.0, 3.0)) < 0.1


def test_where_there_is_no_way_it_brakes_and_holds_and_says_so() -> None:
    target = pole(10.0, 0.0, radius=1.0)
    g = generator(target)
    # on its way already, at speed
    g.start("local", Motion(from_home(0.0, 0.0, 5.0), (3.0, 0.0, 0.0)), 0.0)
    flown = fly(g, Motion(from_home(10.0, 0.5, 5.0)), 10.0)
    held = g.avoidance.blocked
    assert held
    assert clearance([m.position_m for m in flown], (target,)) >= MARGIN_M
    assert norm(flown[-1].velocity_m_s) < 0.02
    assert_smooth(flown)
    # and goes on as soon as it may
    onward = fly(g, Motion(from_home(10.0, 6.0, 5.0)), 15.0, start_s=10.0)
    assert not g.avoidance.blocked
    assert clearance([m.position_m for m in onward], (target,)) >= MARGIN_M - 0.02
    assert math.dist(onward[-1].position_m, from_home(10.0, 6.0, 5.0)) < 0.1


def relative(g: ReferenceGenerator, pad: Motion, now_s: float) -> Vector3:
    return add(g.at(now_s).position_m, pad.position_m)


def test_over_a_pad_that_passes_beneath_a_gantry_it_goes_along_higher_up_and_comes_down_behind() -> None:
    gantry = wall(0.0, 12.0, 8.0, heading=0.0, height=4.0)
    g = generator(gantry, ceiling=12.0)
    flown, waited, heights = [], 0, []
    for k in range(round(40.0 / CYCLE_S)):
        t = k * CYCLE_S
        pad = Motion(from_home(0.0, t, 0.3), (0.0, 1.0, 0.0))
        g.see(HOME, pad)
        if k == 0:
            g.start("pad", Motion((0.0, 0.0, -7.0)), t)
        g.fly_to(Motion((0.0, 0.0, -1.5)), t)
        waited += g.avoidance.waiting
        assert not g.avoidance.blocked
        flown.append(relative(g, pad, t))
        heights.append(-g.at(t).position_m[2])
    assert clearance(flown, (gantry,)) >= MARGIN_M - 0.05
    assert waited > 30
    assert heights[-1] == pytest.approx(1.5, abs=0.02)
    assert max(math.hypot(*g.at(40.0).position_m[:2]), 0.0) < 0.05


def test_a_place_on_a_moving_pad_stays_clear_only_until_the_pad_comes_near() -> None:
    g = generator(pole(0.0, 10.0))
    g.see(HOME, Motion(from_home(0.0, 0.0, 0.3), (0.0, 2.0, 0.0)))
    g.start("pad", Motion((0.0, 0.0, -1.0)), 0.0)
    assert g.stays_clear((0.0, 0.0, -0.2), 3.5)
    assert not g.stays_clear((0.0, 0.0, -0.2), 4.5)
    # a pad that turns away in time does not
    g.see(HOME, Motion(from_home(0.0, 0.0, 0.3), (0.0, 2.0, 0.0), (1.0, 0.0, 0.0)))
    assert g.stays_clear((0.0, 0.0, -0.2), 6.0)


def test_a_gust_into_the_margin_is_left_the_short_way() -> None:
    p = pole(0.0, 0.0)
    g = generator(p)
    g.start("local", Motion(from_home(-1.0, 0.0, 5.0)), 0.0)
    flown = [m.position_m for m in fly(g, Motion(from_home(8.0, 0.0, 5.0)), 25.0)]
    assert clearance(flown, (p,)) >= 0.69
    assert clearance(flown[60:], (p,)) >= MARGIN_M - 0.05
    assert math.dist(flown[-1], from_home(8.0, 0.0, 5.0)) < 0.1


def test_a_route_goes_through_all_points_without_a_halt_and_round_what_is_between() -> None:
    shapes = (pole(5.0, 0.0), wall(10.0, 9.0, 6.0, heading=0.0))
    g = generator(*shapes)
    g.start("local", Motion(from_home(0.0, 0.0, 5.0)), 0.0)
    points = [from_home(10.0, 0.0, 5.0), from_home(10.0, 5.0, 6.0), from_home(10.0, 14.0, 5.0)]
    flown = []
    for k in range(round(40.0 / CYCLE_S)):
        g.fly_along(points, k * CYCLE_S)
        flown.append(g.at((k + 1) * CYCLE_S))
    assert not g.avoidance.blocked
    assert clearance([m.position_m for m in flown], shapes) >= MARGIN_M - 0.02
    for point in points[:-1]:
        near = min(flown, key=lambda m: math.dist(m.position_m, point))
        assert math.dist(near.position_m, point) < 0.1
        assert norm(near.velocity_m_s) > 0.3
    assert math.dist(flown[-1].position_m, points[-1]) < 1e-6


def test_a_route_that_cannot_be_had_is_not_begun() -> None:
    g = generator(pole(10.0, 0.0, radius=1.0))
    g.start("local", Motion(from_home(0.0, 0.0, 5.0)), 0.0)
    for k in range(60):
        g.fly_along([from_home(10.0, 0.0, 5.0)], k * CYCLE_S)
    assert g.avoidance.blocked
    assert g.at(2.0).position_m == pytest.approx(from_home(0.0, 0.0, 5.0))


def test_the_reference_has_no_step_where_a_way_round_begins_while_sinking() -> None:
    shapes = (wall(6.0, 2.0, 7.0), pole(12.0, -2.0))
    g = generator(*shapes, ceiling=5.0)
    g.start("local", Motion(from_home(0.0, 0.0, 9.0), (0.0, 0.0, 1.2), (0.0, 0.0, 0.8)), 0.0)
    flown = fly(g, Motion(from_home(18.0, 0.0, 8.8)), 25.0)
    assert_smooth(flown)
    assert clearance([m.position_m for m in flown], shapes) >= MARGIN_M - 0.02


def test_a_thin_pole_on_a_way_of_many_minutes_is_not_stepped_over() -> None:
    g = generator(*(pole(n, 0.0, radius=0.1) for n in (6.0,)))
    start, goal = Motion(from_home(0.0, 0.0, 5.0)), Motion(from_home(1900.0, 0.0, 5.0))
    for phase_s in np.arange(0.0, 1.0, 0.1).tolist():
        assert not g.avoidance.still_clear(plan(start, goal, -60.0 - phase_s, 3600.0), -60.0 - phase_s)
        running = Motion(from_home(-1.0, 0.0, 5.0), (3.0, 0.0, 0.0))
        goes_on = Motion(from_home(1799.0, 0.0, 5.0), (3.0, 0.0, 0.0))
        assert not g.avoidance.still_clear(plan(running, goes_on, phase_s, 600.0), phase_s)


def test_no_graph_is_made_in_flight() -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform((5.0, -15.0, 3.0), (40.0, 15.0, 14.0), (12, 3)).tolist()
    g = generator(wall(20.0, 0.0, 12.0, height=9.0), *(pole(n, e, height=h) for n, e, h in places))
    made = _graph.cache_info().misses
    g.start("local", Motion(from_home(0.0, 0.0, 5.0)), 0.0)
    fly(g, Motion(from_home(45.0, 0.0, 4.0)), 3.0)
    assert g.avoidance.detouring
    assert _graph.cache_info().misses == made
    assert _graph.cache_info().currsize <= _graph.cache_parameters()["maxsize"]


def test_more_obstacles_than_can_be_thought_of_are_refused() -> None:
    with pytest.raises(ValueError, match="at most 24 items"):
        PlanConfig(obstacles=tuple(pole(10.0 * k, 5.0) for k in range(25)))
