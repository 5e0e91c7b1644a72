"""Obstacles as shapes: distances of points and lines from them.

An obstacle stands on the ground and is solid up to its top. Its shape is a rectangle with rounded sides: a
box has radius 0, a cylinder has no rectangle. Grown by a margin it keeps this form. NED, m; the frame is
the caller's (the planner's is relative to home, so that surveyed obstacles never move).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray
from companion.config import Cylinder, Shape

_CORNERS: Final = 8  # of the polygon about a grown shape
_HALF_TURN: Final = math.pi / _CORNERS
_OUTSIDE: Final = 1.0 / math.cos(_HALF_TURN)  # so that its sides touch the round

HorizontalPoint = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A rectangle rounded by `round_m`, from the ground up to `top_down_m` (down of its top)."""

    north_m: float
    east_m: float
    half_length_m: float
    half_width_m: float
    heading_rad: float
    round_m: float
    top_down_m: float

    @classmethod
    def of(cls, shape: Shape) -> Obstacle:
        """As it was surveyed: NED from home."""
        north, east = shape.centre_ned_m
        if isinstance(shape, Cylinder):
            return cls(north, east, 0.0, 0.0, 0.0, shape.radius_m, -shape.height_m)
        heading = math.radians(shape.heading_deg)
        return cls(north, east, 0.5 * shape.length_m, 0.5 * shape.width_m, heading, 0.0, -shape.height_m)

    def corners(self, margin_m: float) -> list[HorizontalPoint]:
        """North and east of the octagon whose sides touch the shape grown by a margin."""
        reach = (self.round_m + margin_m) * _OUTSIDE
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        points = []
        for k in range(_CORNERS):
            angle = (2 * k + 1) * _HALF_TURN
            along = math.copysign(self.half_length_m, math.cos(angle)) + reach * math.cos(angle)
            across = math.copysign(self.half_width_m, math.sin(angle)) + reach * math.sin(angle)
            points.append((self.north_m + c * along - s * across, self.east_m + s * along + c * across))
        return points


class Shapes:
    """The same obstacles as columns, (1, m) each."""

    def __init__(self, obstacles: Sequence[Obstacle]) -> None:
        columns = np.array([astuple(obstacle) for obstacle in obstacles]).reshape(-1, 7)
        self.north, self.east, self.length, self.width, heading, self.round, self.top = columns.T[:, None, :]
        self.c, self.s = np.cos(heading), np.sin(heading)

    def local(self, plan: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (n, 2) along and across each shape, (n, m) each."""
        north, east = plan[:, :1] - self.north, plan[:, 1:2] - self.east
        return self.c * north + self.s * east, self.c * east - self.s * north

    def beside_m(self, plan: FloatArray) -> FloatArray:
        """Horizontal distance (n, m) of points (n, 2); negative inside."""
        along, across = self.local(plan)
        u, v = np.abs(along) - self.length, np.abs(across) - self.width
        outside = np.hypot(np.maximum(u, 0.0), np.maximum(v, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(u, v), 0.0) - self.round)

    def distance_m(self, points: FloatArray) -> FloatArray:
        """Distance (n, m) of points (n, 3), over the tops too; negative inside."""
        beside, over = self.beside_m(points[:, :2]), self.top - points[:, 2:3]
        outside = np.hypot(np.maximum(beside, 0.0), np.maximum(over, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(beside, over), 0.0))

    def along_m(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Least horizontal distance (n, m) of the lines from a to b, (n, 2) each; not below -round."""
        (ax, ay), (bx, by) = self.local(a), self.local(b)
        dx, dy = bx - ax, by - ay
        square = np.maximum(dx * dx + dy * dy, 1e-18)
        u, v = np.maximum(np.abs(ax) - self.length, 0.0), np.maximum(np.abs(ay) - self.width, 0.0)
        p, q = np.maximum(np.abs(bx) - self.length, 0.0), np.maximum(np.abs(by) - self.width, 0.0)
        nearest = np.minimum(u * u + v * v, p * p + q * q)
        for x, y in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
            ex, ey = x * self.length - ax, y * self.width - ay
            t = np.clip((ex * dx + ey * dy) / square, 0.0, 1.0)
            nearest = np.minimum(nearest, (ex - t * dx) ** 2 + (ey - t * dy) ** 2)
        nearest = np.where(self._crossed(ax, ay, dx, dy), 0.0, nearest)
        return np.asarray(np.sqrt(nearest) - self.round)

    def _crossed(self, ax: FloatArray, ay: FloatArray, dx: FloatArray, dy: FloatArray) -> FloatArray:
        """Whether a line passes through the rectangle: it does where it is within both pairs of sides."""
        dx = np.where(np.abs(dx) < 1e-12, 1e-12, dx)
        dy = np.where(np.abs(dy) < 1e-12, 1e-12, dy)
        x1, x2 = (-self.length - ax) / dx, (self.length - ax) / dx
        y1, y2 = (-self.width - ay) / dy, (self.width - ay) / dy
        enter = np.maximum(np.minimum(x1, x2), np.minimum(y1, y2))
        leave = np.minimum(np.maximum(x1, x2), np.maximum(y1, y2))
        return np.asarray((enter <= leave) & (leave >= 0.0) & (enter <= 1.0))


@lru_cache(maxsize=256)
def shapes_of(obstacles: tuple[Obstacle, ...]) -> Shapes:
    """The columns of the same obstacles, made once."""
    return Shapes(obstacles)


def clearance_m(points: FloatArray, obstacles: Iterable[Obstacle]) -> FloatArray:
    """Distance (n,) of points (n, 3) to the nearest obstacle; negative inside one, inf without any."""
    among = tuple(obstacles)
    if not among:
        return np.full(len(points), np.inf)
    return np.asarray(np.min(shapes_of(among).distance_m(points), axis=1))
