"""A lithium-polymer battery that the motors drain: charge, voltage under load, current.

A rotor's power goes with its thrust to the power of 1.5 (momentum theory in hover: T^1.5 / sqrt(2 rho A)),
over one efficiency for propeller, motor and speed controller. The open-circuit voltage is a table over the
charge, the sag one inner resistance. Empty it stays at its lowest voltage: what the motors can do then is not
simulated. SI units but for mAh, as MAVLink has it.
"""

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Final

CELLS: Final = 3
CAPACITY_MAH: Final = 5000.0
_RESISTANCE_OHM: Final = 0.02
_ELECTRONICS_W: Final = 7.0
# of a ten-inch propeller: full thrust of one takes 100 W, a hover of 1.5 kg 150 W in all
_DISC_M2: Final = 0.0507
_AIR_KG_M3: Final = 1.225
_EFFICIENCY: Final = 0.55
# share of the charge, volts a cell at rest: usual for the chemistry
_AT_REST: Final = ((0.0, 3.30), (0.1, 3.65), (0.2, 3.73), (0.5, 3.84), (0.8, 4.02), (1.0, 4.20))
_MAH_PER_AS: Final = 1.0 / 3.6


class Battery:
    """One battery, charged, with motors of a known full thrust (N)."""

    def __init__(self, max_thrust_n: float) -> None:
        self.consumed_mah = 0.0
        self.consumed_j = 0.0
        self.current_a = 0.0
        self.false_share: float | None = None  # what a fault makes of the charge
        self._full_power_w = max_thrust_n**1.5 / (_EFFICIENCY * math.sqrt(2.0 * _AIR_KG_M3 * _DISC_M2))

    @property
    def share(self) -> float:
        """Remaining charge, 0 to 1."""
        if self.false_share is not None:
            return self.false_share
        return max(0.0, 1.0 - self.consumed_mah / CAPACITY_MAH)

    @property
    def voltage_v(self) -> float:
        """At its terminals, under the present load."""
        return CELLS * _cell_at_rest_v(self.share) - _RESISTANCE_OHM * self.current_a

    def step(self, motors: Iterable[float], dt_s: float) -> None:
        """Drain it: `motors` are shares of full thrust, 0 to 1."""
        power_w = _ELECTRONICS_W + self._full_power_w * sum(max(0.0, motor) ** 1.5 for motor in motors)
        self.current_a = power_w / self.voltage_v
        self.consumed_mah += self.current_a * dt_s * _MAH_PER_AS
        self.consumed_j += power_w * dt_s


def _cell_at_rest_v(share: float) -> float:
    for (low, low_v), (high, high_v) in pairwise(_AT_REST):
        if share <= high:
            return low_v + (high_v - low_v) * (max(share, low) - low) / (high - low)
    return _AT_REST[-1][1]
