"""Vectors, and how an autopilot flies to a point by itself."""

from companion.base.geometry import Vector3


def plus(a: Vector3, b: Vector3, factor: float = 1.0) -> Vector3:
    return (a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2])


def mix(a: Vector3, b: Vector3, k: float) -> Vector3:
    return (a[0] + k * (b[0] - a[0]), a[1] + k * (b[1] - a[1]), a[2] + k * (b[2] - a[2]))


def toward(position: Vector3, velocity: Vector3, target: Vector3, fastest: float) -> Vector3:
    """A cascade of P on position and P on velocity, as an autopilot's own navigation."""
    out = []
    for axis, most in enumerate((fastest, fastest, 1.5)):
        speed = max(-most, min(most, 0.9 * (target[axis] - position[axis])))
        out.append(max(-3.0, min(3.0, 2.0 * (speed - velocity[axis]))))
    return (out[0], out[1], out[2])
