"""Detects rest, and computes the first attitude and gyroscope bias from the mean of a few seconds.

Samples are judged in blocks of 0.1 s by the standard deviation within the block, so that a constant bias
does not look like motion. In motion the gyroscope relates the blocks of the last seconds: rotated into the
present axes, their mean force is gravity plus the mean change of velocity, and their mean field is the
Earth's. FRD, SI units, µT.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

from companion.base.geometry import (
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    add,
    norm,
    quat_integrate,
    quat_rotate,
    quat_rotate_inverse,
    scale,
    subtract,
)
from companion.config import AlignmentConfig

BLOCK_S: Final = 0.1  # long against vibration, of which it takes the mean, short against `still_s`
# zero-rate output of the MPU9250: up to 5 deg/s an axis, 8.7 of three
LARGEST_BIAS_RAD_S: Final = math.radians(10.0)


@dataclass(frozen=True, slots=True)
class Block:
    """Means over about 0.1 s, and whether the vehicle stood still."""

    rate_body_rad_s: Vector3
    specific_force_body_m_s2: Vector3
    samples: int
    still: bool


class StillnessDetector:
    """Cuts the IMU's stream into blocks and judges each."""

    def __init__(self, config: AlignmentConfig) -> None:
        self._config = config
        self._start_s = math.nan
        self._first_rate: Vector3 = ZERO3
        self._first_force: Vector3 = ZERO3
        self._begin()

    def _begin(self) -> None:
        self._count, self._rate, self._force = 0, ZERO3, ZERO3
        self._rate_squares = self._force_squares = 0.0

    def add(self, time_s: float, rate_body_rad_s: Vector3, specific_force_m_s2: Vector3) -> Block | None:
        """Take one sample; the finished block when this sample begins a new one."""
        block = self._finish() if self._count and time_s - self._start_s >= BLOCK_S else None
        if not self._count:
            self._start_s, self._first_rate, self._first_force = time_s, rate_body_rad_s, specific_force_m_s2
        # sums about the first sample: squares of small numbers keep their digits
        rx, ry, rz = subtract(rate_body_rad_s, self._first_rate)
        fx, fy, fz = subtract(specific_force_m_s2, self._first_force)
        self._rate = add(self._rate, (rx, ry, rz))
        self._force = add(self._force, (fx, fy, fz))
        self._rate_squares += rx * rx + ry * ry + rz * rz
        self._force_squares += fx * fx + fy * fy + fz * fz
        self._count += 1
        return block

    def _finish(self) -> Block:
        n, config = self._count, self._config
        rate, force = scale(self._rate, 1.0 / n), scale(self._force, 1.0 / n)
        # three axes together
        rate_std = math.sqrt(max(self._rate_squares / n - norm(rate) ** 2, 0.0))
        force_std = math.sqrt(max(self._force_squares / n - norm(force) ** 2, 0.0))
        still = n >= 3 and rate_std < config.still_rate_rad_s and force_std < config.still_force_m_s2
        block = Block(add(rate, self._first_rate), add(force, self._first_force), n, still)
        self._begin()
        return block


@dataclass(frozen=True, slots=True)
class InitialAlignment:
    """Mean readings; `still` False: of a vehicle in motion, turned into its present axes, and inaccurate."""

    rate_body_rad_s: Vector3
    specific_force_body_m_s2: Vector3
    field_body_ut: Vector3
    samples: int
    still: bool


class _Felt(NamedTuple):
    """A block in the axes of the first one; no field where the magnetometer has not spoken within it."""

    force: Vector3
    field: Vector3 | None


class StaticAligner:
    """Collects blocks until enough in a row are still, or as many have gone by in motion.

    The magnetometer has to have spoken. After a start in motion a rest is still looked for, until
    `timeout_s`: it knows more.
    """

    def __init__(self, config: AlignmentConfig) -> None:
        self._config = config
        self._start_s: float | None = None
        self._restart()
        self._turn: Quaternion = IDENTITY  # since the first block
        self._felt: deque[_Felt] = deque(maxlen=math.ceil(config.still_s / BLOCK_S))
        self._block_field, self._block_fields = ZERO3, 0
        self._end_s: float | None = None

    def _restart(self) -> None:
        self._rate, self._force, self._field = ZERO3, ZERO3, ZERO3
        self._count = self._blocks = self._fields = 0

    def add_field(self, field_body_ut: Vector3) -> None:
        """Take one magnetometer sample."""
        self._field = add(self._field, field_body_ut)
        self._fields += 1
        self._block_field = add(self._block_field, field_body_ut)
        self._block_fields += 1

    def add_block(self, time_s: float, block: Block) -> InitialAlignment | None:
        """Take one block of IMU samples, ended at time_s; the alignment when there is one."""
        if self._start_s is None:
            self._start_s = time_s - BLOCK_S
        self._feel(time_s, block)
        if not self._stands(block):
            self._restart()
            in_motion = time_s - self._start_s >= self._config.still_s - BLOCK_S
            return self._in_motion(block) if in_motion else None
        n = block.samples
        self._rate = add(self._rate, scale(block.rate_body_rad_s, n))
        self._force = add(self._force, scale(block.specific_force_body_m_s2, n))
        self._count += n
        self._blocks += 1
        if self._blocks * BLOCK_S < self._config.still_s or not self._fields:
            return None
        k = 1.0 / self._count
        field = scale(self._field, 1.0 / self._fields)
        return InitialAlignment(scale(self._rate, k), scale(self._force, k), field, self._count, still=True)

    def expired(self, time_s: float) -> bool:
        """Whether a rest is not looked for any more."""
        return self._start_s is not None and time_s - self._start_s > self._config.timeout_s

    def _feel(self, time_s: float, block: Block) -> None:
        span_s = BLOCK_S if self._end_s is None else time_s - self._end_s
        middle = quat_integrate(self._turn, block.rate_body_rad_s, 0.5 * span_s)
        field = None
        if self._block_fields:
            field = quat_rotate(middle, scale(self._block_field, 1.0 / self._block_fields))
        self._felt.append(_Felt(quat_rotate(middle, block.specific_force_body_m_s2), field))
        self._turn = quat_integrate(self._turn, block.rate_body_rad_s, span_s)
        self._end_s, self._block_field, self._block_fields = time_s, ZERO3, 0

    def _in_motion(self, block: Block) -> InitialAlignment | None:
        fields = [felt.field for felt in self._felt if felt.field is not None]
        if not fields:
            return None
        force = _mean([felt.force for felt in self._felt])
        return InitialAlignment(
            block.rate_body_rad_s,
            quat_rotate_inverse(self._turn, force),
            quat_rotate_inverse(self._turn, _mean(fields)),
            block.samples,
            still=False,
        )

    def _stands(self, block: Block) -> bool:
        """Still within the block, and the same as in the blocks before: slow oscillation moves the mean."""
        config = self._config
        if not block.still or norm(block.rate_body_rad_s) > LARGEST_BIAS_RAD_S:
            return False
        if not self._count:
            return True
        k = 1.0 / self._count
        rate_change = norm(subtract(block.rate_body_rad_s, scale(self._rate, k)))
        force_change = norm(subtract(block.specific_force_body_m_s2, scale(self._force, k)))
        return rate_change < config.still_rate_rad_s and force_change < config.still_force_m_s2


def _mean(vectors: list[Vector3]) -> Vector3:
    total = ZERO3
    for vector in vectors:
        total = add(total, vector)
    return scale(total, 1.0 / len(vectors))
