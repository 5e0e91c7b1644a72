import heapq
import math
from itertools import pairwise

import numpy as np
import pytest

from companion.base.geometry import Vector3
from companion.config import Box, Cylinder, Shape
from companion.plan.obstacles.obstacles import Obstacle, clearance_m, line_clear, route

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
