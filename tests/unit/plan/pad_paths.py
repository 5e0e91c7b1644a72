"""How pads move: a place (NED, m) for each time (s)."""

import math
from collections.abc import Callable

from companion.base.geometry import Vector3

Path = Callable[[float], Vector3]


Heading = Callable[[float], float]


def still(north: float = 10.6, east: float = 0.8) -> Path:
    return lambda _t: (north, east, -0.3)


def line(speed: float = 1.0, start: float = -15.0) -> Path:
    return lambda t: (10.0, start + speed * t, -0.3)


def circle(speed: float = 1.5, radius: float = 5.0) -> Path:
    def at(t: float) -> Vector3:
        angle = speed / radius * t
        return (10.0 - radius + radius * math.cos(angle), radius * math.sin(angle), -0.3)

    return at


def figure_eight(speed: float = 2.0, size: float = 8.0) -> Path:
    # the fastest point is the crossing: speed = size * w * sqrt(2)
    w = speed / (size * math.sqrt(2.0))

    def at(t: float) -> Vector3:
        return (10.0 + size * math.sin(w * t), 0.5 * size * math.sin(2.0 * w * t), -0.3)

    return at


def heave(amplitude: float = 0.25, period: float = 6.0) -> Path:
    return lambda t: (10.5, 0.5, -0.8 + amplitude * math.sin(math.tau / period * t))


def derivative(path: Path, t: float) -> tuple[Vector3, Vector3]:
    """Velocity and acceleration of a path by central differences."""
    h = 1e-3
    a, b, c = path(t - h), path(t), path(t + h)
    velocity = tuple((z - x) / (2.0 * h) for x, z in zip(a, c, strict=True))
    acceleration = tuple((x - 2.0 * y + z) / (h * h) for x, y, z in zip(a, b, c, strict=True))
    return (velocity[0], velocity[1], velocity[2]), (acceleration[0], acceleration[1], acceleration[2])
