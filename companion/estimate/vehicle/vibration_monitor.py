"""How strong the accelerometer's vibration is: beyond a bound its mean is not reliable.

An element that saturates, or that rectifies vibration, shifts its mean by a share of the vibration, and for
as long as that lasts. What alternates from sample to sample is no motion of the vehicle, so the vibration
shows in the second difference of three samples. Plain floats, body FRD, m/s².
"""

from __future__ import annotations

import math
from typing import Final

from companion.base.geometry import ZERO3, Vector3, add, dot, scale, subtract

MEMORY_S: Final = 0.2
LARGEST_ERROR_M_S2: Final = 3.0
SHARE: Final = 0.5  # of the vibration beyond the bound: so far may the force's mean be off
_SECOND_DIFFERENCE_VARIANCE: Final = 6.0  # of 1, -2, 1, for white noise


class VibrationMonitor:
    """The root mean square of what alternates from sample to sample, all axes together."""

    def __init__(self) -> None:
        self._last: Vector3 = ZERO3
        self._before: Vector3 = ZERO3
        self._samples = 0
        self._mean_square = 0.0

    def add(self, specific_force_m_s2: Vector3, dt_s: float) -> None:
        """Take a sample, dt_s after the one before."""
        swing = add(subtract(specific_force_m_s2, scale(self._last, 2.0)), self._before)
        self._before, self._last = self._last, specific_force_m_s2
        self._samples += 1
        if self._samples > 2:
            k = dt_s / (MEMORY_S + dt_s)
            self._mean_square += k * (dot(swing, swing) / _SECOND_DIFFERENCE_VARIANCE - self._mean_square)

    def error_m_s2(self, bound_m_s2: float) -> float:
        """By how much the mean may be off: a share of what exceeds the bound."""
        excess = math.sqrt(self._mean_square) - bound_m_s2
        return min(max(SHARE * excess, 0.0), LARGEST_ERROR_M_S2)
