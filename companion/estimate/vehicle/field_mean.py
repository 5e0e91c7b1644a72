"""The mean of the magnetometer's samples between two steps of the filter, and their delay, learnt from turns.

A magnetometer converts, filters and is read out, mostly after its stamp: delays of 10 to 60 ms are usual
(13 ms on the boards of BROAD; ArduPilot's EK3_MAG_DELAY is 60). In a turn at w a field that is late by t is
wrong by t w x F (NED), with F the Earth's field. If turns are mostly to one side, the heading follows this
error. F is constant, so the samples' change shows t. A scalar Kalman filter compares the sample minus its
running mean with w x F minus its own. NED and FRD, µT, rad/s, s, plain floats.
"""

import math
from typing import Final

from companion.base.geometry import (
    ZERO3,
    Quaternion,
    Vector3,
    add,
    between,
    cross,
    dot,
    quat_from_rotation_vector,
    quat_rotate,
    quat_rotate_inverse,
    scale,
    subtract,
)
from companion.config import EkfConfig

DELAY_STD_S: Final = 0.05  # before anything has turned
FADING_S: Final = 2.0  # what changes more slowly is the place's field, or an error of the attitude


class FieldMean:
    """The mean field since it was last taken, of `count` samples; `delay_s` is how late their stamps are."""

    def __init__(self, config: EkfConfig) -> None:
        # of a field's error on an axis, as white noise
        self._density_ut2_s = config.mag_noise_ut**2 / config.mag_rate_hz
        self._variance_s2 = DELAY_STD_S**2
        self.delay_s = 0.0
        self.start_over()

    def start_over(self) -> None:
        """The attitude is another; the sensor, and so its delay, is the same."""
        self._begin()
        self._lasting: tuple[Vector3, Vector3] | None = None

    def _begin(self) -> None:
        self.count = 0
        self._fields = self._sweeps = ZERO3  # sums

    @property
    def delay_std_s(self) -> float:
        """Standard deviation of `delay_s`."""
        return math.sqrt(self._variance_s2)

    def on_time(self, field_body_ut: Vector3, rate_body_rad_s: Vector3) -> Vector3:
        """A sample as it would be had it come without delay."""
        return quat_rotate_inverse(
            quat_from_rotation_vector(scale(rate_body_rad_s, self.delay_s)), field_body_ut
        )

    def add(self, attitude: Quaternion, field_body_ut: Vector3, rate_body_rad_s: Vector3) -> None:
        """Take a sample that is on time."""
        self._fields = add(self._fields, quat_rotate(attitude, field_body_ut))
        self._sweeps = add(self._sweeps, quat_rotate(attitude, cross(rate_body_rad_s, field_body_ut)))
        self.count += 1

    def take(self, span_s: float) -> Vector3:
        """The mean (NED) over span_s; then it starts again.

        Raises:
            ZeroDivisionError: there was no sample.
        """
        field, sweep = scale(self._fields, 1.0 / self.count), scale(self._sweeps, 1.0 / self.count)
        self._begin()
        self._learn(add(field, scale(sweep, self.delay_s)), sweep, min(span_s, FADING_S))
        return field

    def _learn(self, field: Vector3, sweep: Vector3, span_s: float) -> None:
        """Take the mean field at the samples' own stamps, and that of w x F."""
        last_field, last_sweep = self._lasting or (field, sweep)
        share = span_s / (FADING_S + span_s)
        self._lasting = between(last_field, field, share), between(last_sweep, sweep, share)
        field_mean, sweep_mean = self._lasting
        moved, by = subtract(field, field_mean), subtract(sweep, sweep_mean)
        square = dot(by, by)
        gain = self._variance_s2 / (self._density_ut2_s / span_s + self._variance_s2 * square)
        self.delay_s += gain * (dot(by, moved) - self.delay_s * square)
        self._variance_s2 *= 1.0 - gain * square
