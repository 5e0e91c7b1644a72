"""Obstacles."""

import heapq
import math
from itertools import pairwise

import numpy as np
import pytest

from companion.base.geometry import Vector3, add, norm, scale, subtract
from companion.base.motion import Motion
from companion.config import Box, Cylinder, PlanConfig, Shape
from companion.plan.obstacles.obstacles import Obstacle, _graph, clearance_m, line_clear, route
from companion.plan.trajectory.avoidance import Avoidance
from companion.plan.trajectory.min_jerk import plan
from companion.plan.trajectory.reference_generator import ReferenceGenerator

MARGIN_M = 0.7


def pole(north: float, east: float, radius: float = 0.5, height: float = 10.0) -> Obstacle:
    return Obstacle.of(
        Cylinder(kind="cylinder", centre_ned_m=(north, east), radius_m=radius, height_m=height)
    )


def wall(
    north: float, east: float, length: float, width: float, heading: float = 0.0, height: float = 3.0
) -> Obstacle:
    return Obstacle.of(
        Box(
            kind="box",
            centre_ned_m=(north, east),
            length_m=length,
            width_m=width,
            heading_deg=heading,
            height_m=height,
        )
    )


def distance(point: Vector3, obstacle: Obstacle) -> float:
    return float(clearance_m(np.array([point]), [obstacle])[0])


def length(points: list[Vector3]) -> float:
    return sum(math.dist(p, q) for p, q in pairwise(points))


def scene(rng: np.random.Generator, count: int) -> list[Obstacle]:
    found = []
    for _ in range(count):
        north, east = rng.uniform(-7.0, 7.0, 2)
        if rng.random() < 0.5:
            found.append(pole(north, east, rng.uniform(0.1, 1.5), rng.uniform(1.0, 10.0)))
        else:
            sides = rng.uniform(0.2, 5.0), rng.uniform(0.2, 3.0)
            found.append(wall(north, east, *sides, rng.uniform(-180.0, 180.0), rng.uniform(1.0, 10.0)))
    return found


# ---------------------------------------------------------------- distances


def test_a_pole_is_as_far_as_its_side_or_its_top() -> None:
    p = pole(3.0, 4.0, radius=1.0, height=2.0)
    assert distance((0.0, 0.0, -1.0), p) == pytest.approx(4.0)
    assert distance((3.0, 4.0, -5.0), p) == pytest.approx(3.0)
    assert distance((3.0, 8.0, -6.0), p) == pytest.approx(5.0)  # 3 aside, 4 over
    assert distance((3.0, 4.0, -1.5), p) == pytest.approx(-0.5)


def test_a_box_turns_clockwise_from_north() -> None:
    b = wall(0.0, 0.0, length=10.0, width=2.0, heading=90.0)
    assert distance((0.0, 7.0, 0.0), b) == pytest.approx(2.0)
    assert distance((4.0, 0.0, 0.0), b) == pytest.approx(3.0)
    slanted = wall(0.0, 0.0, length=10.0, width=2.0, heading=30.0)
    tip = (5.0 * math.cos(math.radians(30.0)), 5.0 * math.sin(math.radians(30.0)), -1.0)
    assert distance(tip, slanted) == pytest.approx(0.0, abs=1e-9)


def test_without_obstacles_the_clearance_has_no_end() -> None:
    assert clearance_m(np.zeros((2, 3)), []).tolist() == [math.inf, math.inf]


# ---------------------------------------------------------------- the way round


def test_a_clear_way_has_no_points() -> None:
    assert route((0.0, 0.0, -3.0), (9.0, 0.0, -3.0), [pole(4.0, 3.0)], MARGIN_M) == ()


def test_the_way_goes_round_the_nearer_side() -> None:
    for east, side in ((0.2, -1.0), (-0.2, 1.0)):
        way = route((0.0, 0.0, -3.0), (9.0, 0.0, -3.0), [pole(4.0, east)], MARGIN_M)
        assert way
        assert all(math.copysign(1.0, point[1]) == side for point in way)


def test_a_low_wall_is_flown_over_and_a_high_ceiling_is_needed_for_it() -> None:
    low = [wall(5.0, 0.0, length=30.0, width=0.5, heading=90.0, height=4.0)]
    start, goal = (0.0, 0.0, -3.0), (10.0, 0.0, -2.0)
    over = route(start, goal, low, MARGIN_M, ceiling_down_m=-6.0)
    assert over
    assert min(p[2] for p in over) == pytest.approx(-4.7, abs=1e-3)
    round_it = route(start, goal, low, MARGIN_M, ceiling_down_m=-4.6)
    assert round_it
    assert max(abs(p[1]) for p in round_it) > 15.0
    assert round_it == route(start, goal, low, MARGIN_M)


def test_a_slope_that_passes_over_an_obstacle_high_up_is_left_alone() -> None:
    assert route((0.0, 0.0, -7.0), (10.0, 0.0, -0.5), [pole(2.0, 0.0, height=3.0)], MARGIN_M) == ()


def test_what_cannot_be_had_has_no_way() -> None:
    goal = (5.0, 0.0, -1.0)
    assert route((0.0, 0.0, -1.0), goal, [pole(5.5, 0.0)], MARGIN_M, ceiling_down_m=-20.0) is None
    fence = [
        wall(5.0 + n, e, 6.0, 0.3, heading, 9.0)
        for n, e, heading in ((3, 0, 90), (-3, 0, 90), (0, 3, 0), (0, -3, 0))
    ]
    assert route((0.0, 0.0, -1.0), goal, fence, MARGIN_M) is None
    assert route((0.0, 0.0, -1.0), goal, fence, MARGIN_M, ceiling_down_m=-8.0) is None
    over = route((0.0, 0.0, -1.0), goal, fence, MARGIN_M, ceiling_down_m=-10.0)
    assert over
    assert over[-1][:2] == pytest.approx(goal[:2])


def test_who_stands_within_the_margin_goes_out_of_it_first() -> None:
    p = pole(0.0, 0.0)
    way = route((0.6, 0.1, -3.0), (-8.0, 0.0, -3.0), [p], MARGIN_M)
    assert way
    assert distance(way[0], p) >= MARGIN_M
    assert math.dist(way[0], (0.6, 0.1, -3.0)) < 0.8
    points = [*way, (-8.0, 0.0, -3.0)]
    assert all(line_clear(a, b, (p,), MARGIN_M - 1e-3) for a, b in pairwise(points))


@pytest.mark.parametrize("ceiling", [None, -9.0])
def test_every_way_in_random_scenes_keeps_the_margin(ceiling: float | None) -> None:
    rng = np.random.default_rng(5)
    found = 0
    for _ in range(60):
        obstacles = scene(rng, 6)
        start, goal = ((n, float(rng.uniform(-5, 5)), -float(rng.uniform(1, 7))) for n in (-12.0, 12.0))
        way = route(start, goal, obstacles, MARGIN_M, ceiling_down_m=ceiling)
        assert way == route(start, goal, obstacles, MARGIN_M, ceiling_down_m=ceiling)
        if way is not None:
            found += 1
            points = [start, *way, goal]
            assert all(line_clear(a, b, tuple(obstacles), MARGIN_M - 1e-3) for a, b in pairwise(points))
    assert found > 50


def test_the_way_is_as_short_as_that_over_a_fine_grid() -> None:
    obstacles = scene(np.random.default_rng(8), 5)
    obstacles = [pole(o.north_m, o.east_m, 1.2) for o in obstacles] + [wall(0.0, 0.0, 6.0, 0.4, 80.0, 20.0)]
    start, goal = (-10.0, 0.0, -1.0), (10.0, 0.0, -1.0)
    way = route(start, goal, obstacles, MARGIN_M)
    assert way
    ours = length([start, *way, goal])
    # the octagons cost up to 8 % at each round, the grid's 16 directions at most 2.8 % of the way
    assert ours <= 1.03 * grid_length(start, goal, obstacles)
    assert ours >= 0.97 * grid_length(start, goal, obstacles)


def grid_length(start: Vector3, goal: Vector3, obstacles: list[Obstacle], step: float = 0.25) -> float:
    """Dijkstra's shortest way over a grid with 16 directions."""
    half = round(12.0 / step)
    ticks = step * np.arange(-half, half + 1)
    n, e = (a.ravel() for a in np.meshgrid(ticks, ticks, indexing="ij"))
    free = clearance_m(np.stack((n, e, np.full_like(n, start[2])), axis=1), obstacles) >= MARGIN_M
    size = len(ticks)
    moves = [(i, j) for i in (-2, -1, 0, 1, 2) for j in (-2, -1, 0, 1, 2) if math.gcd(i, j) == 1]
    source, sink = ((round(p[0] / step) + half) * size + round(p[1] / step) + half for p in (start, goal))
    best, heap = {source: 0.0}, [(0.0, source)]
    while heap:
        cost, at = heapq.heappop(heap)
        if at == sink:
            return cost
        if cost > best[at]:
            continue
        for i, j in moves:
            row, column = at // size + i, at % size + j
            to = row * size + column
            if 0 <= row < size and 0 <= column < size and free[to]:
                further = cost + step * math.hypot(i, j)
                if further < best.get(to, math.inf):
                    best[to] = further
                    heapq.heappush(heap, (further, to))
    return math.inf


@pytest.mark.parametrize(
    "shape",
    [
        Cylinder(kind="cylinder", centre_ned_m=(1.0, 2.0), radius_m=0.3, height_m=4.0),
        Box(kind="box", centre_ned_m=(1.0, 2.0), length_m=3.0, width_m=1.0, heading_deg=20.0, height_m=4.0),
    ],
)
def test_the_corners_lie_just_outside_what_is_grown(shape: Shape) -> None:
    obstacle = Obstacle.of(shape)
    for (north, east), (n, e) in pairwise(obstacle.corners(MARGIN_M)):
        assert distance((north, east, -1.0), obstacle) >= MARGIN_M
        along = [
            distance((north + k * (n - north), east + k * (e - east), -1.0), obstacle)
            for k in np.linspace(0, 1, 41)
        ]
        assert MARGIN_M - 1e-9 <= min(along) <= MARGIN_M + 0.01


# ---------------- test_avoidance

CYCLE_S = 1.0 / 30.0
RADIUS_M = 0.4
HOME = (0.7, -1.2, 2.5)  # not where the EKF's origin is
KEPT_AWAY_M = PlanConfig().obstacle_margin_m + RADIUS_M


def pole_shape(north: float, east: float, radius: float = 0.3, height: float = 20.0) -> Cylinder:
    return Cylinder(kind="cylinder", centre_ned_m=(north, east), radius_m=radius, height_m=height)


def wall_shape(north: float, east: float, length: float, heading: float = 90.0, height: float = 20.0) -> Box:
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
        (pole_shape(6.0, 0.2),),
        (wall_shape(6.0, 2.0, 7.0),),
        (pole_shape(4.0, -1.0), pole_shape(8.0, 1.5), wall_shape(11.0, -3.0, 6.0, heading=60.0)),
    ],
)
def test_what_stands_in_the_way_is_flown_round_smoothly_and_the_target_reached(
    shapes: tuple[Shape, ...],
) -> None:
    g = generator(*shapes)
    g.start("local", Motion(from_home(0.0, 0.0, 5.0)), 0.0)
    goal = from_home(15.0, 0.0, 5.0)
    flown = fly(g, Motion(goal), 25.0)
    assert clearance([m.position_m for m in flown], shapes) >= KEPT_AWAY_M - 0.02
    assert math.dist(flown[-1].position_m, goal) < 0.05
    assert_smooth(flown)


def test_without_obstacles_in_the_way_nothing_changes() -> None:
    far, none = generator(pole_shape(5.0, 30.0)), generator()
    for g in (far, none):
        g.start("local", Motion(from_home(0.0, 0.0, 5.0), (1.0, 0.5, 0.0)), 0.0)
    target = Motion(from_home(15.0, 3.0, 4.0), (0.5, 0.0, 0.0))
    assert fly(far, target, 3.0) == fly(none, target, 3.0)


def test_a_low_wall_is_flown_over_and_not_over_the_ceiling() -> None:
    low = (wall_shape(6.0, 0.0, 40.0, height=3.0),)
    for ceiling, highest in ((8.0, 5.8), (4.0, 3.2)):
        g = generator(*low, ceiling=ceiling)
        g.start("local", Motion(from_home(0.0, 0.0, 3.0)), 0.0)
        flown = fly(g, Motion(from_home(12.0, 0.0, 3.0)), 60.0 if ceiling < 5.0 else 25.0)
        assert clearance([m.position_m for m in flown], low) >= KEPT_AWAY_M - 0.02
        assert HOME[2] - min(m.position_m[2] for m in flown) < highest
        assert math.dist(flown[-1].position_m, from_home(12.0, 0.0, 3.0)) < 0.1


def test_where_there_is_no_way_it_brakes_and_holds_and_says_so() -> None:
    target = pole_shape(10.0, 0.0, radius=1.0)
    g = generator(target)
    # on its way already, at speed
    g.start("local", Motion(from_home(0.0, 0.0, 5.0), (3.0, 0.0, 0.0)), 0.0)
    flown = fly(g, Motion(from_home(10.0, 0.5, 5.0)), 10.0)
    held = g.avoidance.blocked
    assert held
    assert clearance([m.position_m for m in flown], (target,)) >= KEPT_AWAY_M
    assert norm(flown[-1].velocity_m_s) < 0.02
    assert_smooth(flown)
    # and goes on as soon as it may
    onward = fly(g, Motion(from_home(10.0, 6.0, 5.0)), 15.0, start_s=10.0)
    assert not g.avoidance.blocked
    assert clearance([m.position_m for m in onward], (target,)) >= KEPT_AWAY_M - 0.02
    assert math.dist(onward[-1].position_m, from_home(10.0, 6.0, 5.0)) < 0.1


def relative(g: ReferenceGenerator, pad: Motion, now_s: float) -> Vector3:
    return add(g.at(now_s).position_m, pad.position_m)


def test_over_a_pad_that_passes_beneath_a_gantry_it_goes_along_higher_up_and_comes_down_behind() -> None:
    gantry = wall_shape(0.0, 12.0, 8.0, heading=0.0, height=4.0)
    g = generator(gantry, ceiling=12.0)
    flown, waited, heights = [], 0, []
    for k in range(round(40.0 / CYCLE_S)):
        t = k * CYCLE_S
        pad = Motion(from_home(0.0, t, 0.3), (0.0, 1.0, 0.0))
        g.see(HOME, pad)
        if k == 0:
            g.start("pad", Motion((0.0, 0.0, -7.0)), t)
        g.fly_to(Motion((0.0, 0.0, -1.5)), t)
        waited += g.avoidance.situation == "waiting_over"
        assert not g.avoidance.blocked
        flown.append(relative(g, pad, t))
        heights.append(-g.at(t).position_m[2])
    assert clearance(flown, (gantry,)) >= KEPT_AWAY_M - 0.05
    assert waited > 30
    assert heights[-1] == pytest.approx(1.5, abs=0.02)
    assert max(math.hypot(*g.at(40.0).position_m[:2]), 0.0) < 0.05


def test_a_place_on_a_moving_pad_stays_clear_only_until_the_pad_comes_near() -> None:
    g = generator(pole_shape(0.0, 10.0))
    g.see(HOME, Motion(from_home(0.0, 0.0, 0.3), (0.0, 2.0, 0.0)))
    g.start("pad", Motion((0.0, 0.0, -1.0)), 0.0)
    assert g.avoidance.free_for((0.0, 0.0, -0.2), 3.5)
    assert not g.avoidance.free_for((0.0, 0.0, -0.2), 4.5)
    # a pad that turns away in time does not
    g.see(HOME, Motion(from_home(0.0, 0.0, 0.3), (0.0, 2.0, 0.0), (1.0, 0.0, 0.0)))
    assert g.avoidance.free_for((0.0, 0.0, -0.2), 6.0)


def test_a_gust_into_the_margin_is_left_the_short_way() -> None:
    p = pole_shape(0.0, 0.0)
    g = generator(p)
    g.start("local", Motion(from_home(-1.0, 0.0, 5.0)), 0.0)
    flown = [m.position_m for m in fly(g, Motion(from_home(8.0, 0.0, 5.0)), 25.0)]
    assert clearance(flown, (p,)) >= 0.69
    assert clearance(flown[60:], (p,)) >= KEPT_AWAY_M - 0.05
    assert math.dist(flown[-1], from_home(8.0, 0.0, 5.0)) < 0.1


def test_a_route_goes_through_all_points_without_a_halt_and_round_what_is_between() -> None:
    shapes = (pole_shape(5.0, 0.0), wall_shape(10.0, 9.0, 6.0, heading=0.0))
    g = generator(*shapes)
    g.start("local", Motion(from_home(0.0, 0.0, 5.0)), 0.0)
    points = [from_home(10.0, 0.0, 5.0), from_home(10.0, 5.0, 6.0), from_home(10.0, 14.0, 5.0)]
    flown = []
    for k in range(round(40.0 / CYCLE_S)):
        g.fly_along(points, k * CYCLE_S)
        flown.append(g.at((k + 1) * CYCLE_S))
    assert not g.avoidance.blocked
    assert clearance([m.position_m for m in flown], shapes) >= KEPT_AWAY_M - 0.02
    for point in points[:-1]:
        near = min(flown, key=lambda m: math.dist(m.position_m, point))
        assert math.dist(near.position_m, point) < 0.1
        assert norm(near.velocity_m_s) > 0.3
    assert math.dist(flown[-1].position_m, points[-1]) < 1e-6


def test_a_route_that_cannot_be_had_is_not_begun() -> None:
    g = generator(pole_shape(10.0, 0.0, radius=1.0))
    g.start("local", Motion(from_home(0.0, 0.0, 5.0)), 0.0)
    for k in range(60):
        g.fly_along([from_home(10.0, 0.0, 5.0)], k * CYCLE_S)
    assert g.avoidance.blocked
    assert g.at(2.0).position_m == pytest.approx(from_home(0.0, 0.0, 5.0))


@pytest.mark.parametrize("gaining_m_s2", [0.0, 2.0])
@pytest.mark.parametrize("speed_m_s", [1.5, 3.0, 6.0])
def test_the_stop_that_was_checked_is_the_one_that_is_flown(speed_m_s: float, gaining_m_s2: float) -> None:
    g = generator(wall_shape(60.0, 0.0, 200.0))
    g.start("local", Motion(from_home(0.0, 0.0, 5.0), (speed_m_s, 0.0, 0.0), (gaining_m_s2, 0.0, 0.0)), 0.0)
    planned = g.resting_place_m()
    reached = []
    for k in range(600):
        g.fly_along([from_home(60.0, 0.0, 5.0)], k * CYCLE_S)  # within the wall: there is no way
        reached.append(g.at((k + 1) * CYCLE_S).position_m)
    assert g.avoidance.blocked
    assert reached[-1] == pytest.approx(planned, abs=1e-6)
    assert max(north for north, _, _ in reached) <= planned[0] + 1e-6


def test_over_a_pad_that_turns_towards_a_wall_it_stops_in_space() -> None:
    wall_m, speed_m_s, turns_rad_s = 12.0, 4.0, 0.6
    shape = wall_shape(0.0, wall_m, 400.0, heading=0.0, height=40.0)
    g = generator(shape)
    north = east = course_rad = 0.0
    g.see(HOME, Motion(HOME, (speed_m_s, 0.0, 0.0)))
    g.start("pad", Motion((0.0, 0.0, -2.0)), 0.0)
    flown, blocked = [], False
    for k in range(round(14.0 / CYCLE_S)):
        now_s, turn_rad_s = k * CYCLE_S, 0.0
        if now_s >= 3.0 and course_rad < math.pi / 2:
            turn_rad_s = turns_rad_s
        course_rad = min(math.pi / 2, course_rad + turn_rad_s * CYCLE_S)
        along, aside = speed_m_s * math.cos(course_rad), speed_m_s * math.sin(course_rad)
        north, east = north + along * CYCLE_S, east + aside * CYCLE_S
        pad = Motion(
            from_home(north, east, 0.0), (along, aside, 0.0), (-aside * turn_rad_s, along * turn_rad_s, 0.0)
        )
        g.see(HOME, pad)
        g.fly_level(Motion((0.0, 0.0, -2.0)), math.inf, now_s)
        blocked = blocked or g.avoidance.blocked
        flown.append(relative(g, pad, now_s))
    assert blocked
    assert clearance(flown, (shape,)) >= KEPT_AWAY_M


def test_the_reference_has_no_step_where_a_way_round_begins_while_sinking() -> None:
    shapes = (wall_shape(6.0, 2.0, 7.0), pole_shape(12.0, -2.0))
    g = generator(*shapes, ceiling=5.0)
    g.start("local", Motion(from_home(0.0, 0.0, 9.0), (0.0, 0.0, 1.2), (0.0, 0.0, 0.8)), 0.0)
    flown = fly(g, Motion(from_home(18.0, 0.0, 8.8)), 25.0)
    assert_smooth(flown)
    assert clearance([m.position_m for m in flown], shapes) >= KEPT_AWAY_M - 0.02


def test_a_thin_pole_on_a_way_of_many_minutes_is_not_stepped_over() -> None:
    g = generator(*(pole_shape(n, 0.0, radius=0.1) for n in (6.0,)))
    start, goal = Motion(from_home(0.0, 0.0, 5.0)), Motion(from_home(1900.0, 0.0, 5.0))
    for phase_s in np.arange(0.0, 1.0, 0.1).tolist():
        assert not g.avoidance.keeps_clear(
            plan(start, goal, -60.0 - phase_s, 3600.0), -60.0 - phase_s, g.avoidance.frame
        )
        running = Motion(from_home(-1.0, 0.0, 5.0), (3.0, 0.0, 0.0))
        goes_on = Motion(from_home(1799.0, 0.0, 5.0), (3.0, 0.0, 0.0))
        assert not g.avoidance.keeps_clear(plan(running, goes_on, phase_s, 600.0), phase_s, g.avoidance.frame)


def test_no_graph_is_made_in_flight() -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform((5.0, -15.0, 3.0), (40.0, 15.0, 14.0), (12, 3)).tolist()
    g = generator(
        wall_shape(20.0, 0.0, 12.0, height=9.0), *(pole_shape(n, e, height=h) for n, e, h in places)
    )
    made = _graph.cache_info().misses
    g.start("local", Motion(from_home(0.0, 0.0, 5.0)), 0.0)
    fly(g, Motion(from_home(45.0, 0.0, 4.0)), 3.0)
    assert g.avoidance.situation == "detour"
    assert _graph.cache_info().misses == made
    assert _graph.cache_info().currsize <= _graph.cache_parameters()["maxsize"]


def test_more_obstacles_than_can_be_thought_of_are_refused() -> None:
    with pytest.raises(ValueError, match="at most 24 items"):
        PlanConfig(obstacles=tuple(pole_shape(10.0 * k, 5.0) for k in range(25)))
