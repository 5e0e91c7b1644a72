"""Jerk-limited input shaping as ArduPilot does it: a setpoint becomes a path that the vehicle can follow.

A square-root law turns an error into a rate: proportional near by, and further off no more than what can
still be braked at the given limit. Laws of that kind are stacked: position to velocity, velocity to
acceleration, whose own rate of change (jerk) is bounded. After ArduPilot 4.6, AP_Math/control.cpp. SI units,
one or two axes.
"""

import math
from dataclasses import dataclass

Two = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ShapingLimits:
    """Bounds of a shaped path: acceleration (m/s²) and jerk (m/s³)."""

    acceleration: float
    jerk: float

    @property
    def velocity_gain(self) -> float:
        """Gain (1/s) from velocity error to acceleration."""
        return self.jerk / self.acceleration

    @property
    def position_gain(self) -> float:
        """Gain (1/s) from position error to velocity: half the inner loop's, for stability."""
        return 0.5 * self.jerk / self.acceleration

    @property
    def braking(self) -> float:
        """Deceleration (m/s²) counted on when approaching a place: half, the rest is for corners."""
        return 0.5 * self.acceleration


def root_law(error: float, gain: float, limit: float, dt_s: float) -> float:
    """Rate for an error (not negative): gain times it, along a root where `limit` would be exceeded."""
    linear = limit / (gain * gain)
    rate = gain * error if error <= linear else math.sqrt(2.0 * limit * (error - 0.5 * linear))
    return min(rate, error / dt_s)


def signed_root_law(error: float, gain: float, limit: float, dt_s: float) -> float:
    return math.copysign(root_law(abs(error), gain, limit, dt_s), error)


def bounded(x: float, y: float, longest: float) -> Two:
    """A vector, shortened to a length."""
    length = math.hypot(x, y)
    return (x, y) if length <= longest else (x * longest / length, y * longest / length)


def approach(x: float, y: float, to: Two, step: float) -> Two:
    """Move a point towards another by at most `step`."""
    dx, dy = bounded(to[0] - x, to[1] - y, step)
    return x + dx, y + dy


def clamp(value: float, limit: float) -> float:
    """Bound to either side of zero."""
    return limit if value > limit else -limit if value < -limit else value


def _dot(a: Two, b: Two) -> float:
    return a[0] * b[0] + a[1] * b[1]


@dataclass(slots=True)
class Path2:
    """A shaped path in the plane: where it is, how fast, how it accelerates.

    The controller that tracks it sets: `limit`, the direction in which the vehicle cannot be pushed
    any harder (zero while it can), `behind_m` and `slower_m_s` are how far the path is ahead of it. The path
    then waits in that direction, so that the lead is not flown after a stop (AC_PosControl's limit vector).
    """

    position: Two = (0.0, 0.0)
    velocity: Two = (0.0, 0.0)
    acceleration: Two = (0.0, 0.0)
    limit: Two = (0.0, 0.0)
    behind_m: Two = (0.0, 0.0)
    slower_m_s: Two = (0.0, 0.0)

    def to_place(
        self, place: Two, velocity: Two, acceleration: Two, top: float, by: ShapingLimits, dt: float
    ) -> None:
        """One step towards a place that itself moves at a velocity and acceleration."""
        ex, ey = place[0] - self.position[0], place[1] - self.position[1]
        distance = math.hypot(ex, ey)
        vx = vy = 0.0
        if distance > 0.0:
            speed = min(top, root_law(distance, by.position_gain, by.braking, dt))
            vx, vy = ex * speed / distance, ey * speed / distance
        self.to_velocity((vx + velocity[0], vy + velocity[1]), acceleration, by, dt)

    def to_velocity(self, velocity: Two, acceleration: Two, by: ShapingLimits, dt: float) -> None:
        """One step towards a velocity, on top of an acceleration."""
        ex, ey = velocity[0] - self.velocity[0], velocity[1] - self.velocity[1]
        error = math.hypot(ex, ey)
        ax = ay = 0.0
        if error > 0.0:
            size = root_law(error, by.velocity_gain, by.jerk, dt)
            ax, ay = bounded(ex * size / error, ey * size / error, by.acceleration)
        self.to_acceleration((ax + acceleration[0], ay + acceleration[1]), by, dt)

    def to_acceleration(self, acceleration: Two, by: ShapingLimits, dt: float) -> None:
        """One step towards an acceleration, and on along the path."""
        ax, ay = self.acceleration = approach(*self.acceleration, acceleration, by.jerk * dt)
        (px, py), (vx, vy), limit = self.position, self.velocity, self.limit
        half = 0.5 * dt * dt
        way, gain = (vx * dt + ax * half, vy * dt + ay * half), (ax * dt, ay * dt)
        if not (_dot(way, limit) > 0.0 and _dot(self.behind_m, limit) > 0.0):
            self.position = (px + way[0], py + way[1])
        braking = _dot(self.velocity, limit) < 0.0
        if braking or not (_dot(gain, limit) > 0.0 and _dot(self.slower_m_s, limit) > 0.0):
            self.velocity = (vx + gain[0], vy + gain[1])


@dataclass(slots=True)
class Path1:
    """A shaped path along one axis; `limit`, `behind_m` and `slower_m_s` as `Path2` has them."""

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0
    limit: float = 0.0
    behind_m: float = 0.0
    slower_m_s: float = 0.0

    def to_place(
        self, place: float, velocity: float, acceleration: float, top: Two, by: ShapingLimits, dt: float
    ) -> None:
        """One step towards a place; `top` are the greatest speeds against and along the axis."""
        wish = signed_root_law(place - self.position, by.position_gain, by.braking, dt)
        self.to_velocity(min(max(wish, -top[0]), top[1]) + velocity, acceleration, by, dt)

    def to_velocity(self, velocity: float, acceleration: float, by: ShapingLimits, dt: float) -> None:
        wish = signed_root_law(velocity - self.velocity, by.velocity_gain, by.jerk, dt)
        self.to_acceleration(clamp(wish, by.acceleration) + acceleration, by, dt)

    def to_acceleration(self, acceleration: float, by: ShapingLimits, dt: float) -> None:
        self.acceleration += clamp(acceleration - self.acceleration, by.jerk * dt)
        limit = self.limit
        way, gain = self.velocity * dt + 0.5 * self.acceleration * dt * dt, self.acceleration * dt
        if not (way * limit > 0.0 and self.behind_m * limit > 0.0):
            self.position += way
        braking = self.velocity * limit < 0.0
        if braking or not (gain * limit > 0.0 and self.slower_m_s * limit > 0.0):
            self.velocity += gain


def low_pass_share(cutoff_hz: float, dt_s: float) -> float:
    """How far a first-order low-pass follows in one step."""
    return dt_s / (dt_s + 1.0 / (2.0 * math.pi * cutoff_hz))


def low_pass(value: float, to: float, cutoff_hz: float, dt_s: float) -> float:
    """A filtered value one step on."""
    return value + low_pass_share(cutoff_hz, dt_s) * (to - value)


class FirstOrderLowPass:
    """A first-order filter that starts from its first value."""

    def __init__(self, cutoff_hz: float) -> None:
        self._cutoff_hz = cutoff_hz
        self.value: float | None = None

    def step(self, value: float, dt_s: float) -> float:
        self.value = value if self.value is None else low_pass(self.value, value, self._cutoff_hz, dt_s)
        return self.value

    def reset(self) -> None:
        self.value = None
