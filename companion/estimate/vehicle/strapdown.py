"""Combines a few IMU samples to one step of constant rate and specific force.

The combination is exact, unlike an average: rotations about changing axes do not commute (coning), and a
force measured while turning has another direction at the end than at the start (sculling). Between two
samples, which are the sensor's filtered output at their times, rate and force are taken as linear. Body
FRD, SI units, plain floats.
"""

from __future__ import annotations

from typing import NamedTuple

from companion.base.geometry import (
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    quat_from_rotation_vector,
    quat_integrate,
    quat_rotate,
    quat_rotate_inverse,
    rotation_vector_from_quat,
    scale,
)


class Increment(NamedTuple):
    """The constant rate and specific force that do over span_s what the samples did."""

    span_s: float
    samples: int
    rate_body_rad_s: Vector3
    specific_force_body_m_s2: Vector3


class Strapdown:
    """Collects samples until they are taken; biases are not removed."""

    def __init__(self) -> None:
        self.samples = 0
        self.span_s = 0.0
        self._turn: Quaternion = IDENTITY
        self._push: Vector3 = ZERO3

    def add(self, dt_s: float, rate_body_rad_s: Vector3, specific_force_m_s2: Vector3) -> None:
        """Take the mean rate and force of the dt_s since the sample before."""
        x, y, z = quat_rotate(quat_integrate(self._turn, rate_body_rad_s, 0.5 * dt_s), specific_force_m_s2)
        u, v, w = self._push
        self._push = (u + x * dt_s, v + y * dt_s, w + z * dt_s)
        self._turn = quat_integrate(self._turn, rate_body_rad_s, dt_s)
        self.span_s += dt_s
        self.samples += 1

    def take(self) -> Increment:
        """What was collected, and start again.

        Raises:
            ZeroDivisionError: nothing was collected.
        """
        rate = scale(rotation_vector_from_quat(self._turn), 1.0 / self.span_s)
        # the sum is in the axes of the start, a constant force in those of the middle
        middle = quat_from_rotation_vector(scale(rate, 0.5 * self.span_s))
        force = scale(quat_rotate_inverse(middle, self._push), 1.0 / self.span_s)
        result = Increment(self.span_s, self.samples, rate, force)
        self.samples, self.span_s, self._turn, self._push = 0, 0.0, IDENTITY, ZERO3
        return result
