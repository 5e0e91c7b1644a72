"""How the pad tilts and how it swings: a deck rolls and pitches, a roof slopes, and both may land a vehicle.

The tilt is the horizontal part of the pad's normal (north and east; the normal points down, as the z axis of
the pad does): for small angles its tilt in rad. Each axis is a Kalman filter of angle and rate, as the pad's
heading is; beside them run the means over tens of seconds of the tilt, of its swing about that, and of its
rate. From the last two follows how quickly it swings, so that a tilt can be predicted through a part of its
period. Immutable.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

SWING_S: Final = 15.0  # memory of mean and swing: two or three periods of a ship's roll
# of a tilt that a first sighting leaves open: a deck's that rolls; judged
FIRST_STD_RAD: Final = math.radians(8.0)
FIRST_RATE_STD_RAD_S: Final = math.radians(10.0)  # as of one that swings by so much in 5 s; judged
JITTER_RAD: Final = math.radians(0.2)  # of our own attitude, from frame to frame
QUICKEST_RAD_S: Final = math.tau / 2.0  # no deck swings quicker
SLOWEST_RAD_S: Final = math.tau / 20.0  # nor slower: a slope is what it is then
STILL_RAD: Final = math.radians(0.5)  # a smaller swing is noise: it has no period


class AngleState(NamedTuple):
    """Angle (rad; any turn, the caller wraps) and rate (rad/s), with their variances and covariance.

    A Kalman filter, in plain floats for speed; the rate is a random walk.
    """

    angle_rad: float = 0.0
    rate_rad_s: float = 0.0
    variance: float = 1.0
    covariance: float = 0.0
    rate_variance: float = 1.0

    def after(self, dt_s: float, acceleration_rad_s2_rthz: float, turned_rad: float = 0.0) -> AngleState:
        """The state dt_s later, under white angular acceleration of that density, and a corrected zero."""
        s = acceleration_rad_s2_rthz**2
        return AngleState(
            self.angle_rad + self.rate_rad_s * dt_s + turned_rad,
            self.rate_rad_s,
            self.variance + dt_s * (2.0 * self.covariance + dt_s * (self.rate_variance + s * dt_s / 3.0)),
            self.covariance + dt_s * (self.rate_variance + 0.5 * s * dt_s),
            self.rate_variance + s * dt_s,
        )

    def corrected(self, innovation_rad: float, noise: float) -> AngleState:
        """With an angle measured that much further on, with noise of that variance (Joseph form)."""
        p, c, r = self.variance, self.covariance, self.rate_variance
        a, b = p / (p + noise), c / (p + noise)
        left = 1.0 - a
        return AngleState(
            self.angle_rad + a * innovation_rad,
            self.rate_rad_s + b * innovation_rad,
            left * left * p + a * a * noise,
            left * (c - b * p) + a * b * noise,
            r - 2.0 * b * c + b * b * (p + noise),
        )


class TiltState(NamedTuple):
    """Both axes' filters, and fading means: of the tilt, of the swing's square and of the rate's square."""

    north: AngleState = AngleState()
    east: AngleState = AngleState()
    mean_rad: tuple[float, float] = (0.0, 0.0)
    swing_square: float = 0.0
    rate_square: float = 0.0
    watched_s: float = 0.0

    @classmethod
    def first(cls, tilt_rad: tuple[float, float], std_rad: float) -> TiltState:
        """From one sighting."""
        variance = min(std_rad, FIRST_STD_RAD) ** 2 + JITTER_RAD**2
        north, east = (AngleState(angle, 0.0, variance, 0.0, FIRST_RATE_STD_RAD_S**2) for angle in tilt_rad)
        return cls(north, east, tilt_rad)

    def after(self, dt_s: float, acceleration_rad_s2_rthz: float) -> TiltState:
        """The state dt_s later."""
        north, east = (axis.after(dt_s, acceleration_rad_s2_rthz) for axis in self[:2])
        return TiltState(north, east, *self[2:])

    def corrected(self, tilt_rad: tuple[float, float], std_rad: float, since_s: float) -> TiltState:
        """With a sighting's tilt, so long after the one before."""
        noise = std_rad**2 + JITTER_RAD**2
        north = self.north.corrected(tilt_rad[0] - self.north.angle_rad, noise)
        east = self.east.corrected(tilt_rad[1] - self.east.angle_rad, noise)
        watched_s = self.watched_s + since_s
        share = min(1.0, since_s / min(SWING_S, max(watched_s, since_s, 1e-6)))
        (mn, me), (ln, le) = self.mean_rad, (north.angle_rad, east.angle_rad)
        mean = (mn + share * (ln - mn), me + share * (le - me))
        swing = (ln - mean[0]) ** 2 + (le - mean[1]) ** 2
        rate = north.rate_rad_s**2 + east.rate_rad_s**2
        return TiltState(
            north,
            east,
            mean,
            self.swing_square + share * (swing - self.swing_square),
            self.rate_square + share * (rate - self.rate_square),
            watched_s,
        )

    @property
    def tilt_rad(self) -> tuple[float, float]:
        """The tilt, north and east."""
        return self.north.angle_rad, self.east.angle_rad

    @property
    def rate_rad_s(self) -> tuple[float, float]:
        """Its rate."""
        return self.north.rate_rad_s, self.east.rate_rad_s

    @property
    def swing_rad(self) -> float:
        """The root mean square of the swing about the mean, both axes together."""
        return math.sqrt(self.swing_square)

    @property
    def frequency_rad_s(self) -> float:
        """How quickly it swings; 0: not at all."""
        if not self.swing_rad > STILL_RAD:
            return 0.0
        return min(QUICKEST_RAD_S, max(SLOWEST_RAD_S, math.sqrt(self.rate_square) / self.swing_rad))


LEVEL: Final = TiltState()
