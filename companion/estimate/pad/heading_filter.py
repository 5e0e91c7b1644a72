"""The pad's heading and its rate: a Kalman filter of two states, in plain floats for speed.

Heading rad (any turn; the caller wraps), rate rad/s, about NED's down axis. The rate is a random walk.
Immutable: each step gives a new one.
"""

from __future__ import annotations

from typing import NamedTuple


class HeadingState(NamedTuple):
    """Heading (rad) and rate (rad/s) with their variances and covariance."""

    heading_rad: float = 0.0
    rate_rad_s: float = 0.0
    heading_variance: float = 1.0
    covariance: float = 0.0
    rate_variance: float = 1.0

    def after(self, dt_s: float, acceleration_rad_s2_rthz: float, turned_rad: float = 0.0) -> HeadingState:
        """The state dt_s later, under white angular acceleration of that density, and a corrected north."""
        s = acceleration_rad_s2_rthz**2
        return HeadingState(
            self.heading_rad + self.rate_rad_s * dt_s + turned_rad,
            self.rate_rad_s,
            self.heading_variance
            + dt_s * (2.0 * self.covariance + dt_s * (self.rate_variance + s * dt_s / 3.0)),
            self.covariance + dt_s * (self.rate_variance + 0.5 * s * dt_s),
            self.rate_variance + s * dt_s,
        )

    def corrected(self, innovation_rad: float, variance: float) -> HeadingState:
        """With a heading measured that much further on, with noise of that variance (Joseph form)."""
        p, c, r = self.heading_variance, self.covariance, self.rate_variance
        a, b = p / (p + variance), c / (p + variance)
        left = 1.0 - a
        return HeadingState(
            self.heading_rad + a * innovation_rad,
            self.rate_rad_s + b * innovation_rad,
            left * left * p + a * a * variance,
            left * (c - b * p) + a * b * variance,
            r - 2.0 * b * c + b * b * (p + variance),
        )
