"""The shortest path around or over obstacles that keeps a margin from all of them.

The path around is the shortest path in the visibility graph (Lozano-Perez and Wesley, 1979) of the octagons
about the grown shapes; the path over them is the same at a height above some of them. Nothing is random:
the same input gives the same path. NED, m, in the obstacles' frame.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray, Vector3
from companion.base.late_import import imported_late
from companion.config import MOST_OBSTACLES
from companion.plan.obstacles.shapes import HorizontalPoint, Obstacle, clearance_m, shapes_of

# SciPy takes all that NumPy has, these two with it: 6 MB, and a tenth of our start
with imported_late("numpy.f2py", "numpy.testing"):
    from scipy.sparse.csgraph import csgraph_from_dense, dijkstra

__all__ = ["Obstacle", "clearance_m", "line_clear", "nearest_free", "prepare", "route", "way_cost"]

_TOLERANCE_M: Final = 1e-6
_SPACING_M: Final = 0.2  # of the points at which a straight line is looked at
_STEP_OUT_M: Final = 0.05  # beyond the margin, for who stands within it
# Climbing is so much slower than flying across: a metre of it counts as so many.
_CLIMB_COST: Final = 2.5
_SAME_HEIGHT_M: Final = 0.05


def route(
    start: Vector3,
    goal: Vector3,
    obstacles: Sequence[Obstacle],
    margin_m: float,
    *,
    ceiling_down_m: float | None = None,
) -> tuple[Vector3, ...] | None:
    """The points to go by on the shortest way that keeps the margin; none at all when it is straight.

    Round the obstacles, between the heights of start and goal; or, with a ceiling (down, m), up to where
    they are below, across and down again, a metre of climb counting as 2.5. A start within the margin first
    goes where it is not, by the shortest way. None: there is no way, or the goal lies within the margin.
    """
    shapes = tuple(obstacles)
    if line_clear(start, goal, shapes, margin_m):
        return ()
    if not _free(goal, shapes, margin_m):
        return None
    if not _free(start, shapes, margin_m):
        out = nearest_free(start, shapes, margin_m, ceiling_down_m=ceiling_down_m)
        onward = None if out is None else route(out, goal, shapes, margin_m, ceiling_down_m=ceiling_down_m)
        return None if out is None or onward is None else (out, *onward)
    return _from_free(start, goal, shapes, margin_m, ceiling_down_m)


def line_clear(start: Vector3, goal: Vector3, obstacles: tuple[Obstacle, ...], margin_m: float) -> bool:
    """Whether the straight line between two points keeps the margin."""
    count = 2 + int(math.dist(start, goal) / _SPACING_M)
    line = np.linspace(start, goal, count)
    return bool(np.min(clearance_m(line, obstacles)) >= margin_m - _TOLERANCE_M)


def _free(point: Vector3, obstacles: tuple[Obstacle, ...], margin_m: float) -> bool:
    return bool(clearance_m(np.array([point]), obstacles)[0] >= margin_m - _TOLERANCE_M)


def _from_free(
    start: Vector3,
    goal: Vector3,
    obstacles: tuple[Obstacle, ...],
    margin_m: float,
    ceiling_down_m: float | None,
) -> tuple[Vector3, ...] | None:
    """The cheapest: round all that the lower end meets, or over some of it, at each height that pays."""
    sloped = _round(start, goal, _taller(obstacles, max(start[2], goal[2]), margin_m), margin_m)
    best = None if sloped is None else _sloping(start, goal, sloped)
    cost = math.inf if best is None else way_cost((start, *best, goal))
    for level in _levels(start, goal, obstacles, margin_m, ceiling_down_m):
        straight = ((*start[:2], level), (*goal[:2], level))
        if way_cost((start, *straight, goal)) >= cost:
            continue
        plan = _round(start, goal, _taller(obstacles, level, margin_m), margin_m)
        if plan is None:
            continue
        way = _unbent(start, ((*start[:2], level), *((*p, level) for p in plan), (*goal[:2], level)), goal)
        if way_cost((start, *way, goal)) < cost:
            best, cost = way, way_cost((start, *way, goal))
    return best


def _levels(
    start: Vector3,
    goal: Vector3,
    obstacles: tuple[Obstacle, ...],
    margin_m: float,
    ceiling_down_m: float | None,
) -> list[float]:
    """Heights (down) worth a look: the higher end's own, and just over each top that is higher."""
    own = min(start[2], goal[2])
    levels = [own] if abs(start[2] - goal[2]) > _SAME_HEIGHT_M else []
    if ceiling_down_m is None:
        return levels
    over = {o.top_down_m - margin_m - _TOLERANCE_M for o in obstacles}
    return [*levels, *sorted((level for level in over if ceiling_down_m <= level < own), reverse=True)]


def _taller(obstacles: tuple[Obstacle, ...], down_m: float, margin_m: float) -> tuple[Obstacle, ...]:
    return tuple(o for o in obstacles if o.top_down_m - margin_m < down_m)


def way_cost(points: Sequence[Vector3]) -> float:
    """Length (m) of a way, a metre of climb counting as 2.5."""
    return sum(math.hypot(math.dist(p[:2], q[:2]), _CLIMB_COST * (q[2] - p[2])) for p, q in pairwise(points))


def _sloping(start: Vector3, goal: Vector3, plan: Sequence[HorizontalPoint]) -> tuple[Vector3, ...]:
    """Heights for the points of a plan: evenly from the start's to the goal's along the way."""
    places = [start[:2], *plan, goal[:2]]
    lengths = np.cumsum([0.0, *(math.dist(p, q) for p, q in pairwise(places))])
    share = lengths / max(float(lengths[-1]), 1e-9)
    return tuple(
        (n, e, start[2] + float(k) * (goal[2] - start[2]))
        for (n, e), k in zip(plan, share[1:-1], strict=True)
    )


def _unbent(start: Vector3, points: Sequence[Vector3], goal: Vector3) -> tuple[Vector3, ...]:
    ends = (start, goal)
    return tuple(p for p in points if min(math.dist(p, end) for end in ends) > _SAME_HEIGHT_M)


def nearest_free(
    start: Vector3, obstacles: Sequence[Obstacle], margin_m: float, *, ceiling_down_m: float | None = None
) -> Vector3 | None:
    """The place nearest to one that keeps the margin, or None: a corner or the side of a grown shape.

    With a ceiling (down, m) straight up too.
    """
    if _free(start, tuple(obstacles), margin_m):
        return start
    grown = margin_m + _STEP_OUT_M
    places: list[Vector3] = [(n, e, start[2]) for o in obstacles for n, e in o.corners(grown)]
    places += [_side(start, o, grown) for o in obstacles]
    up = min(o.top_down_m for o in obstacles) - grown
    if ceiling_down_m is not None and up >= ceiling_down_m:
        places.append((start[0], start[1], up))
    free = clearance_m(np.array(places), obstacles) >= margin_m - _TOLERANCE_M
    outside = [place for place, is_free in zip(places, free, strict=True) if is_free]
    return min(outside, key=lambda place: way_cost((start, place)), default=None)


def _side(start: Vector3, obstacle: Obstacle, grown_m: float) -> Vector3:
    """Where one leaves a grown shape by the shortest way."""
    o = obstacle
    c, s = math.cos(o.heading_rad), math.sin(o.heading_rad)
    north, east = start[0] - o.north_m, start[1] - o.east_m
    along, across = c * north + s * east, c * east - s * north
    x = max(-o.half_length_m, min(o.half_length_m, along))
    y = max(-o.half_width_m, min(o.half_width_m, across))
    away = math.hypot(along - x, across - y)
    if away > 1e-9:
        k = (o.round_m + grown_m) / away
        along, across = x + k * (along - x), y + k * (across - y)
    elif o.half_length_m - abs(along) < o.half_width_m - abs(across):
        along = math.copysign(o.half_length_m + o.round_m + grown_m, along)
    else:
        across = math.copysign(o.half_width_m + o.round_m + grown_m, across)
    return (o.north_m + c * along - s * across, o.east_m + s * along + c * across, start[2])


# ---------------------------------------------------------------- the visibility graph


class _Graph:
    """The corners that are free, and the shortest ways between all of them."""

    def __init__(self, obstacles: tuple[Obstacle, ...], margin_m: float) -> None:
        self._shapes, self._grown = shapes_of(obstacles), margin_m - _TOLERANCE_M
        corners = np.array([corner for o in obstacles for corner in o.corners(margin_m)])
        self._corners = corners[np.all(self._shapes.beside_m(corners) >= self._grown, axis=1)]
        i, j = np.triu_indices(len(self._corners), 1)
        web = np.full((len(self._corners), len(self._corners)), np.inf)
        web[i, j] = web[j, i] = self._lengths(self._corners[i], self._corners[j])
        self._between, self._before = web, web
        if len(web):
            sparse = csgraph_from_dense(web, null_value=np.inf)
            self._between, self._before = dijkstra(sparse, return_predecessors=True)

    def _lengths(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Lengths (n,) of the lines from a to b, (n, 2) each; inf where one is not clear."""
        clear = np.all(self._shapes.along_m(a, b) >= self._grown, axis=1)
        return np.where(clear, np.hypot(b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]), np.inf)

    def shortest(self, start: HorizontalPoint, goal: HorizontalPoint) -> tuple[HorizontalPoint, ...] | None:
        n, ends = len(self._corners), np.array([start, goal])
        a = np.concatenate((np.repeat(ends, n, axis=0), ends[:1]))
        lengths = self._lengths(a, np.concatenate((self._corners, self._corners, ends[1:])))
        whole = lengths[:n, None] + self._between + lengths[None, n : 2 * n]
        first, last = divmod(int(np.argmin(whole)), n) if n else (0, 0)
        best = float(whole[first, last]) if n else math.inf
        if lengths[-1] <= best:
            return () if math.isfinite(lengths[-1]) else None
        way = [last]
        while way[-1] != first:
            way.append(int(self._before[first, way[-1]]))
        return tuple((float(self._corners[i, 0]), float(self._corners[i, 1])) for i in reversed(way))


def prepare(obstacles: Sequence[Obstacle], margin_m: float) -> None:
    """Make every graph that `route` may ask for: in flight it would take longer than a cycle has."""
    for top_down_m in {o.top_down_m for o in obstacles}:
        _graph(tuple(o for o in obstacles if o.top_down_m <= top_down_m), margin_m)


# all of two sets of MOST_OBSTACLES by three margins
@lru_cache(maxsize=6 * MOST_OBSTACLES)
def _graph(obstacles: tuple[Obstacle, ...], margin_m: float) -> _Graph:
    return _Graph(obstacles, margin_m)


def _round(
    start: Vector3, goal: Vector3, obstacles: tuple[Obstacle, ...], margin_m: float
) -> tuple[HorizontalPoint, ...] | None:
    """The shortest way in the plane, by its corners."""
    if not obstacles:
        return ()
    return _graph(obstacles, margin_m).shortest(start[:2], goal[:2])
