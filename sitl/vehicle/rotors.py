"""Where an airframe's rotors are and which way they turn: each layout as data.

Rotors lie on one circle and are numbered clockwise from the front, seen from above; neighbours turn against
one another, the first anticlockwise. Plain floats and loops: arrays this short cost ten times as much.
"""

import math
from dataclasses import dataclass
from typing import Final, Literal

LayoutName = Literal["quad_plus", "quad_x", "hexa", "octa"]
RotorValues = tuple[float, ...]
"""One value a rotor: commands (0..1), thrust shares, factors."""


@dataclass(frozen=True, slots=True)
class RotorLayout:
    """Unit places forward and right of the centre, and the sign of each one's reaction torque (FRD)."""

    forward: RotorValues
    right: RotorValues
    turns: RotorValues

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.turns)

    @property
    def tilting(self) -> float:
        """What a unit of command along `right` makes of roll, in motors at one arm; of pitch alike."""
        return sum(right * right for right in self.right)

    def torques(self, thrusts: RotorValues) -> tuple[float, float]:
        """Roll and pitch torque over the arm's length."""
        roll = pitch = 0.0
        for thrust, forward, right in zip(thrusts, self.forward, self.right, strict=True):
            roll -= right * thrust
            pitch += forward * thrust
        return roll, pitch

    def momentum(self, speeds: RotorValues) -> float:
        """Sum of the speeds about the down axis: those that turn clockwise less the others."""
        total = 0.0
        for speed, turn in zip(speeds, self.turns, strict=True):
            if turn < 0.0:
                total += speed
        for speed, turn in zip(speeds, self.turns, strict=True):
            if turn > 0.0:
                total -= speed
        return total


def _ring(count: int, first_deg: float) -> RotorLayout:
    angles = [math.radians(first_deg + 360.0 * k / count) for k in range(count)]
    turns = tuple(1.0 if k % 2 == 0 else -1.0 for k in range(count))
    return RotorLayout(tuple(map(math.cos, angles)), tuple(map(math.sin, angles)), turns)


LAYOUTS: Final[dict[LayoutName, RotorLayout]] = {
    "quad_plus": RotorLayout((1.0, 0.0, -1.0, 0.0), (0.0, 1.0, 0.0, -1.0), (1.0, -1.0, 1.0, -1.0)),
    "quad_x": _ring(4, 45.0),
    "hexa": _ring(6, 0.0),
    "octa": _ring(8, 22.5),
}
