"""How the companion's inertial board lies on the airframe, against what its file says; it may slip.

The board's axes are the body's turned by a rotation vector (FRD, rad). While it slips, the gyroscope feels
the slip as a turn. Magnetometer and inertial sensor are one chip and turn together.
"""

from __future__ import annotations

from companion.base.geometry import (
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    add,
    norm,
    quat_from_rotation_vector,
    quat_rotate_inverse,
    scale,
    subtract,
)


class BoardMount:
    """Turns what the body feels into the board's axes."""

    def __init__(self, dt_s: float) -> None:
        self._dt_s = dt_s
        self._turn: Vector3 = ZERO3
        self._board: Quaternion = IDENTITY
        # for faults: where it is to lie, and how long it takes to get there (s); 0: it lay there before
        self.target_rad: Vector3 = ZERO3
        self.slips_for_s = 0.0

    def clear_faults(self) -> None:
        """Where the file has it."""
        self.target_rad, self.slips_for_s = ZERO3, 0.0

    def felt(self, force_body: Vector3, rate_body: Vector3) -> tuple[Vector3, Vector3]:
        """Specific force and rate (body axes) as the board feels them in this step."""
        slip_rate = ZERO3
        if self._turn != self.target_rad:
            slip_rate = self._move()
        if self._board == IDENTITY:
            return force_body, rate_body
        force = quat_rotate_inverse(self._board, force_body)
        return force, add(quat_rotate_inverse(self._board, rate_body), slip_rate)

    def seen(self, field_body: Vector3) -> Vector3:
        """A field (body axes) in the board's axes."""
        return field_body if self._board == IDENTITY else quat_rotate_inverse(self._board, field_body)

    def _move(self) -> Vector3:
        """One step of the slip; returns its rate (rad/s), about an axis that stays."""
        left = subtract(self.target_rad, self._turn)
        if self.slips_for_s <= 0.0:
            self._turn, rate = self.target_rad, ZERO3
        else:
            speed = norm(self.target_rad) / self.slips_for_s
            step = min(1.0, speed * self._dt_s / norm(left)) if speed > 0.0 else 1.0
            self._turn = self.target_rad if step >= 1.0 else add(self._turn, scale(left, step))
            rate = scale(left, step / self._dt_s)
        self._board = quat_from_rotation_vector(self._turn)
        return rate
