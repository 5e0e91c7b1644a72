"""How much the IMU may err over a step: what grows with the vibration, and with a turn that lasts.

Vibration is no motion of the vehicle. What alternates from sample to sample is vibration: it shows in the
second difference of three samples. Most of it is gone from a sum of samples; what is left, and what comes in
by aliasing, shows in the same difference of means over 40 ms, quicker than a vehicle moves, and is noise of
the velocity. The means are weighted by a triangle: a quick tone leaves nothing in them, as in the velocity.
An element that saturates, or that rectifies vibration, shifts its mean besides, by a share of
what exceeds a bound, and for as long as that lasts.

Scale errors and misalignment turn the attitude by a share of the turn itself. A vehicle that tilts and
levels again has turned by nothing: what counts is the rate that lasts. Plain floats, body FRD, SI units.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from companion.base.geometry import ZERO3, Vector3, add, dot, scale, subtract
from companion.config import EkfConfig

SHAKING_SHARE: Final = 0.5  # of the vibration beyond the bound: so far may the force's mean be off
MEMORY_S: Final = 0.2
BLOCK_S: Final = 0.04  # motion of the vehicle is slower, vibration that matters for the velocity is not
WEIGHED: Final = 0.75  # a triangle's mean is as noisy as a plain one over so much of its length
BLOCK_MEMORY_S: Final = 1.0
LASTING_S: Final = 2.0
LARGEST_ERROR_M_S2: Final = 3.0
_SECOND_DIFFERENCE_VARIANCE: Final = 6.0  # of 1, -2, 1, for white noise


class StepNoise(NamedTuple):
    """What is known of the errors of a step of the IMU.

    `force_density_m2_s3` is the density of the noise that vibration leaves on an axis, `force_error_m_s2` by
    how much the mean may be off for a second or so, `lasting_rate_rad_s` (body) how the vehicle has turned in
    the last seconds.
    """

    force_density_m2_s3: float = 0.0
    force_error_m_s2: float = 0.0
    lasting_rate_rad_s: Vector3 = ZERO3


STEADY: Final = StepNoise()


class VibrationMonitor:
    """The root mean square of what alternates from sample to sample, all axes together."""

    def __init__(self, memory_s: float = MEMORY_S) -> None:
        self._memory_s = memory_s
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
            k = dt_s / (self._memory_s + dt_s)
            self._mean_square += k * (dot(swing, swing) / _SECOND_DIFFERENCE_VARIANCE - self._mean_square)

    @property
    def rms_m_s2(self) -> float:
        """The vibration's root mean square (m/s²)."""
        return math.sqrt(self._mean_square)

    def error_m_s2(self, bound_m_s2: float, share: float) -> float:
        """By how much the mean may be off: a share of what exceeds the bound."""
        return min(max(share * (self.rms_m_s2 - bound_m_s2), 0.0), LARGEST_ERROR_M_S2)


class ImuNoise:
    """Feed it every sample; `now` is how much a step may err."""

    def __init__(self, config: EkfConfig) -> None:
        self._config = config
        self._vibration, self._left = VibrationMonitor(), VibrationMonitor(BLOCK_MEMORY_S)
        self._push: Vector3 = ZERO3  # of the block that is being filled
        self._block_s = self._weights_s = 0.0
        self._density_m2_s3 = 0.0
        self._rate: Vector3 = ZERO3

    def add(self, rate_body_rad_s: Vector3, specific_force_m_s2: Vector3, dt_s: float) -> None:
        """Take a sample, dt_s after the one before; a gyroscope's bias is too small to count as a turn."""
        self._vibration.add(specific_force_m_s2, dt_s)
        self._rate = add(self._rate, scale(subtract(rate_body_rad_s, self._rate), dt_s / (LASTING_S + dt_s)))
        middle_s = self._block_s + 0.5 * dt_s
        weight_s = dt_s * min(middle_s, max(BLOCK_S - middle_s, 0.0)) / BLOCK_S
        self._push = add(self._push, scale(specific_force_m_s2, weight_s))
        self._weights_s += weight_s
        self._block_s += dt_s
        if self._block_s < BLOCK_S - 0.5 * dt_s:
            return
        if self._weights_s > 0.0:
            self._left.add(scale(self._push, 1.0 / self._weights_s), self._block_s)
            self._density_m2_s3 = self._left.rms_m_s2**2 * WEIGHED * self._block_s / 3.0
        self._push, self._block_s, self._weights_s = ZERO3, 0.0, 0.0

    @property
    def now(self) -> StepNoise:
        """Of a step that ends with the newest sample."""
        config = self._config
        return StepNoise(
            self._density_m2_s3,
            self._vibration.error_m_s2(config.shaking_bound_m_s2, SHAKING_SHARE),
            self._rate,
        )
