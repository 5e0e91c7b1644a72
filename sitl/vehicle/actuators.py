"""Motor effectiveness: each motor gives a share of the commanded thrust, by its own thrust curve.

A worn propeller, a tired speed controller or a battery's sagging voltage costs thrust and reaction torque
alike, so the command itself is scaled, before the motor's lag.
"""

from __future__ import annotations

from typing import Final

from sitl.vehicle.quadrotor import Four

NOMINAL: Final[Four] = (1.0, 1.0, 1.0, 1.0)


class Motors:
    """Front, right, back and left motor (1 to 4)."""

    def __init__(self, thrust_exponent: float = 1.0) -> None:
        """Thrust goes with the command to this power."""
        self._shares = NOMINAL
        self._exponent = thrust_exponent

    def clear_faults(self) -> None:
        """All motors give the commanded thrust."""
        self._shares = NOMINAL

    def weaken(self, motor: int | None, share: float) -> None:
        """One motor (1 to 4), or all for None, gives only this share of what it gave."""
        a, b, c, d = (
            own * share if motor in (None, number) else own
            for number, own in enumerate(self._shares, start=1)
        )
        self._shares = (a, b, c, d)

    def given(self, commands: Four) -> Four:
        """The effective commands (shares of full thrust)."""
        if self._exponent != 1.0:
            front, right, rear, left = (min(1.0, max(0.0, c)) ** self._exponent for c in commands)
            commands = (front, right, rear, left)
        if self._shares is NOMINAL:
            return commands
        a, b, c, d = self._shares
        return (a * commands[0], b * commands[1], c * commands[2], d * commands[3])
