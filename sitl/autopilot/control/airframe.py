"""The vehicle's parameters as the autopilot has them.

"+" frame, motors in order front (1), right (2), rear (3), left (4); FRD, SI units.
"""

from __future__ import annotations

from typing import Protocol

from companion.base.geometry import GRAVITY_M_S2, Vector3


class Airframe(Protocol):
    """As the installer enters them; the plant's may differ (a payload, a worn motor)."""

    @property
    def mass_kg(self) -> float:
        """Take-off mass."""

    @property
    def inertia_kg_m2(self) -> Vector3:
        """Moments of inertia about the body axes."""

    @property
    def arm_length_m(self) -> float:
        """Distance from the centre of mass to a motor."""

    @property
    def max_thrust_n(self) -> float:
        """Thrust of one motor at full command."""

    @property
    def torque_to_thrust_m(self) -> float:
        """Reaction torque over thrust of one rotor."""


def hover_thrust(airframe: Airframe) -> float:
    """Share (0..1) of full thrust that carries the weight."""
    return airframe.mass_kg * GRAVITY_M_S2 / (4.0 * airframe.max_thrust_n)
