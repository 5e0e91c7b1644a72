"""The IMU's error over a step: it grows with vibration and with a turn that lasts.

Vibration alternates from sample to sample, so the second difference of three samples shows it. A sum of
samples removes most of it. The rest, and what aliasing adds, is noise of velocity and attitude:
`SlowNoise`. A sensor that saturates, or that rectifies vibration, also shifts its mean, by a share of the
excess over a bound, for as long as that lasts.

Scale errors and misalignment turn the attitude by a share of the rotation. A vehicle that tilts and levels
again has not turned in total, so only a lasting rate counts. Plain floats, body FRD, SI units.
"""

from __future__ import annotations

import math
import operator
from collections import deque
from itertools import pairwise
from typing import Final, NamedTuple

from companion.base.geometry import ZERO3, Vector3, between
from companion.config import EkfConfig

SHAKING_SHARE: Final = 0.5  # of the vibration beyond the bound: so far may the force's mean be off
# and so far it is, as a share of all vibration: over seconds of two recordings, a phone's vibration and taps
# (2.6 and 5 m/s² rms, velocity by optical tracking) it is off by 0.1 and 0.2 m/s²
USUAL_SHARE: Final = 0.05
MEMORY_S: Final = 0.2  # of the vibration: forty samples at 200 Hz; judged
BLOCK_S: Final = 0.02  # motion of the vehicle is slower, vibration that matters for the velocity is not
BLOCK_MEMORY_S: Final = 50.0 * BLOCK_S  # of the slow noise
LASTING_S: Final = 2.0  # a turn that ends sooner turns back: no scale error is left of it
GAP_STEPS: Final = 3.0  # so many times the step before
_SECOND_DIFFERENCE_VARIANCE: Final = sum(a * a for a in (1.0, -2.0, 1.0))  # for white noise
# a motion whose acceleration changes evenly leaves nothing in it
_THIRD_DIFFERENCE: Final = (1.0, -3.0, 3.0, -1.0)
_ForceAndRate = tuple[float, float, float, float, float, float]
_NOTHING: Final[_ForceAndRate] = (*ZERO3, *ZERO3)
# the sum of its factors' squares, and of its neighbouring factors' products
_SQUARES: Final = sum(a * a for a in _THIRD_DIFFERENCE)
_PRODUCTS: Final = sum(a * b for a, b in pairwise(_THIRD_DIFFERENCE))


class StepNoise(NamedTuple):
    """What is known of the errors of a step of the IMU.

    `force_density_m2_s3` is the density of the noise that vibration leaves on an axis of the accelerometer,
    `rate_density_rad2_s` of that on an axis of the gyroscope. `force_error_m_s2` is by how much the mean
    force may be off for a second or so, `usual_force_error_m_s2` by how much it usually is,
    `lasting_rate_rad_s` (body) how it has turned in the last seconds.
    """

    force_density_m2_s3: float = 0.0
    force_error_m_s2: float = 0.0
    lasting_rate_rad_s: Vector3 = ZERO3
    rate_density_rad2_s: float = 0.0
    usual_force_error_m_s2: float = 0.0


STEADY: Final = StepNoise()


class SlowNoise:
    """The density of the noise (an axis) below some 30 Hz, which a sum of samples keeps, of force and rate.

    By means of the samples that triangles of 40 ms weigh, one every 20 ms: quick tones leave nothing in them,
    as in the integral. Their third difference takes out the vehicle's own motion.
    """

    def __init__(self) -> None:
        self.force_density_m2_s3 = self.rate_density_rad2_s = 0.0
        self.skip_gap()

    def skip_gap(self) -> None:
        """Samples are missing: what the vehicle did meanwhile is no noise of those around."""
        self._begun, self._begun_s = _NOTHING, 0.0  # a triangle's first half and its weight
        self._means: deque[_ForceAndRate] = deque(maxlen=len(_THIRD_DIFFERENCE))
        self._begin_block()

    def _begin_block(self) -> None:
        self._rising = _NOTHING  # the first half of one triangle
        self._falling = _NOTHING  # the second half of the one before
        self._rise_s = self._fall_s = self._block_s = 0.0
        self._samples = 0
        self._squares_s2 = self._products_s2 = 0.0

    def add(self, force: Vector3, rate: Vector3, dt_s: float) -> None:
        """Take a sample, dt_s after the one before."""
        rise_s = dt_s * min((self._block_s + 0.5 * dt_s) / BLOCK_S, 1.0)
        fall_s = dt_s - rise_s
        (x, y, z), (p, q, r) = force, rate
        (a, b, c, d, e, f), w = self._rising, rise_s
        self._rising = (a + x * w, b + y * w, c + z * w, d + p * w, e + q * w, f + r * w)
        (a, b, c, d, e, f), w = self._falling, fall_s
        self._falling = (a + x * w, b + y * w, c + z * w, d + p * w, e + q * w, f + r * w)
        self._rise_s, self._fall_s = self._rise_s + rise_s, self._fall_s + fall_s
        self._squares_s2 += rise_s * rise_s + fall_s * fall_s
        self._products_s2 += rise_s * fall_s
        self._block_s += dt_s
        self._samples += 1
        if self._block_s >= BLOCK_S - 0.5 * dt_s:
            self._end_block()

    def _end_block(self) -> None:
        weight_s = self._begun_s + self._fall_s
        if self._begun_s > 0.0:
            k = 1.0 / weight_s
            a, b, c, d, e, f = map(operator.add, self._begun, self._falling)
            self._means.append((a * k, b * k, c * k, d * k, e * k, f * k))
        if len(self._means) == len(_THIRD_DIFFERENCE):
            # of white noise with a variance of 1: neighbouring triangles share a block
            variance = (_SQUARES * self._squares_s2 + 2.0 * _PRODUCTS * self._products_s2) / weight_s**2
            share = self._block_s / (BLOCK_MEMORY_S + self._block_s)
            x, y, z, p, q, r = map(_third_difference, *self._means)
            force = (x * x + y * y + z * z) / 3.0 / variance * self._block_s / self._samples
            rate = (p * p + q * q + r * r) / 3.0 / variance * self._block_s / self._samples
            self.force_density_m2_s3 += share * (force - self.force_density_m2_s3)
            self.rate_density_rad2_s += share * (rate - self.rate_density_rad2_s)
        self._begun, self._begun_s = self._rising, self._rise_s
        self._begin_block()


def _third_difference(a: float, b: float, c: float, d: float) -> float:
    w, x, y, z = _THIRD_DIFFERENCE
    return w * a + x * b + y * c + z * d


class ImuNoise:
    """Feed it every sample; `now` is how much a step may err."""

    def __init__(self, config: EkfConfig) -> None:
        self._config = config
        self._slow = SlowNoise()
        self._rate: Vector3 = ZERO3
        self._last = self._before = ZERO3  # two forces, of as many samples
        self._samples, self._vibration_m2_s4 = 0, 0.0  # the mean square, of all axes together
        self._dt_s = math.inf

    def add(self, rate_body_rad_s: Vector3, specific_force_m_s2: Vector3, dt_s: float) -> None:
        """Take a sample, dt_s after the one before; a gyroscope's bias is too small to count as a turn."""
        if dt_s > GAP_STEPS * self._dt_s:
            self._slow.skip_gap()
        self._dt_s = dt_s
        self._shake(specific_force_m_s2, dt_s)
        self._slow.add(specific_force_m_s2, rate_body_rad_s, dt_s)
        self._rate = between(self._rate, rate_body_rad_s, dt_s / (LASTING_S + dt_s))

    def _shake(self, force: Vector3, dt_s: float) -> None:
        """Take what alternates from sample to sample for vibration."""
        (x, y, z), (lx, ly, lz), (bx, by, bz) = force, self._last, self._before
        x, y, z = x - lx * 2.0 + bx, y - ly * 2.0 + by, z - lz * 2.0 + bz
        self._before, self._last = self._last, force
        self._samples += 1
        if self._samples > 2:
            k = dt_s / (MEMORY_S + dt_s)
            square = x * x + y * y + z * z
            self._vibration_m2_s4 += k * (square / _SECOND_DIFFERENCE_VARIANCE - self._vibration_m2_s4)

    @property
    def now(self) -> StepNoise:
        """Of a step that ends with the newest sample."""
        rms_m_s2 = math.sqrt(self._vibration_m2_s4)
        return StepNoise(
            self._slow.force_density_m2_s3,
            max(SHAKING_SHARE * (rms_m_s2 - self._config.shaking_bound_m_s2), 0.0),
            self._rate,
            self._slow.rate_density_rad2_s,
            USUAL_SHARE * rms_m_s2,
        )
