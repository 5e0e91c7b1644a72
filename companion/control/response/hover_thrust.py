"""The hover thrust as a share of full thrust: one estimate with its covariance, from the accelerometer.

A scalar Kalman filter. State: lift x = 1 / hover thrust, a random walk. Measurement: the upward specific
force f, in g, while a thrust T acts (its upward part, as a share of full thrust):

    f = x T + v

v is the force of the air, `AIR_G` for `AIR_S` at a time; it is treated as white noise of density
`AIR_G2_S`. The relation between T and f does not depend on who flies, so the app takes control with the
thrust that already holds the vehicle. (PX4's hover thrust estimator has this form, with the hover thrust as
its state.)

A sinking gust does not fit this noise: it is strong and it lasts. While the mean of the innovations is
larger than air and covariance explain, the covariance is increased until it explains that mean (a strong
tracking filter, Zhou and Frank 1996, on the mean). So the thrust follows a gust within a fraction of a
second, and small changes as slowly as the margins of a vehicle that differs from its model require. (At 13
rad/s of bandwidth, which a gust causes for a moment, the loop of an x500 has 38 deg and 67 ms of margin; 20
deg and 32 ms if the acceleration is measured 50 ms later than assumed.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from companion.base.geometry import GRAVITY_M_S2
from companion.base.second_sources import SIGMA_THRESHOLD

TOLD_STD: Final = 1.0  # as a share: what is told is twice the truth, or half of it, often enough
AIR_G, AIR_S = 0.05, 0.5
AIR_G2_S: Final = 2.0 * AIR_G**2 * AIR_S  # both ways
# The innovations' mean is that of so long: a thrust that acts some hundredths of a second later or earlier
# than believed leaves little of one.
MEAN_S: Final = 0.1
# Of the bandwidth: a speed that was not explained outlasts what is learnt from it, or no fall would be felt.
FORGETS: Final = 0.5
# So little is lost until the estimate is right: 0.1 g for the filter's first second is 0.2 m at most.
KNOWN_STD: Final = 0.1
# A thrust that holds the vehicle is believed unless it is surely beyond these shares of all that was told.
LEAST_SHARE, MOST_SHARE = 0.5, 1.6


class HoverThrust:
    """The estimate; `correct` with every acceleration measured in the air."""

    def __init__(self, told: float, bandwidth_rad_s: float, std: float = 0.0) -> None:
        """`told` counts with the standard deviation `std` (as a share), at least the settled one.

        `bandwidth_rad_s`: how fast a change is followed once settled, which sets the random walk.
        `unexplained_m_s`: the speed down that the innovations of late add up to.
        """
        self._lift = self._free_lift = 1.0 / told  # the second: when nothing but air was under the feet
        self._bandwidth_rad_s = bandwidth_rad_s
        self.unexplained_m_s, self._mean_g = 0.0, 0.0
        self._walk = AIR_G2_S * bandwidth_rad_s**2
        self._variance = max(std**2, AIR_G2_S * bandwidth_rad_s) * self._lift**2

    @property
    def value(self) -> float:
        """Share of full thrust that carries the weight."""
        return 1.0 / self._lift

    @property
    def std(self) -> float:
        """Its standard deviation, as a share of it."""
        return math.sqrt(self._variance) / self._lift

    def correct(
        self,
        acceleration_down_m_s2: float,
        predicted_down_m_s2: float,
        elapsed_s: float,
        *,
        follows_gusts: bool = False,
        feet_near: bool = False,
        may_stand: bool = False,
    ) -> float:
        """Take in what is felt over `elapsed_s`; returns by how much the lift has changed, as a factor.

        `predicted_down_m_s2`: what the thrust makes by the present estimate, as late as it is measured. What
        carries more than the thrust may be a pad under the feet, and only lifts: that is followed slowly, and
        where it `may_stand` not at all. With `feet_near` what is learnt is not that of free air.
        """
        felt, made = (1.0 - a / GRAVITY_M_S2 for a in (acceleration_down_m_s2, predicted_down_m_s2))
        if not (math.isfinite(felt) and math.isfinite(made)) or elapsed_s <= 0.0:
            return 1.0
        self.unexplained_m_s += elapsed_s * (
            acceleration_down_m_s2
            - predicted_down_m_s2
            - FORGETS * self._bandwidth_rad_s * self.unexplained_m_s
        )
        before, thrust = self._lift, max(0.0, made) / self._lift
        # less than nothing is felt by what falls upside down alone: the lift stays positive
        innovation_g = max(0.0, felt) - thrust * before
        self._mean_g += -math.expm1(-elapsed_s / MEAN_S) * (innovation_g - self._mean_g)
        self._variance += self._walk * before**2 * elapsed_s
        if follows_gusts and thrust > 0.0 and self._mean_g < 0.0:
            by_air_g2 = AIR_G**2 * AIR_S / (AIR_S + MEAN_S)
            self._variance = max(self._variance, (self._mean_g**2 - by_air_g2) / thrust**2)
        gain = self._variance * thrust / (self._variance * thrust**2 + AIR_G2_S / elapsed_s)
        self._lift += gain * innovation_g
        if may_stand:
            self._lift = min(self._lift, before)
        if not feet_near:
            self._free_lift = self._lift
        self._mean_g -= gain * thrust * innovation_g  # so much of it is explained from now on
        self._variance *= 1.0 - gain * thrust
        return self._lift / before

    def leave_surface(self) -> float:
        """Forget the lift that was learnt near a surface; returns by how much it has changed, as a factor."""
        before, self._lift = self._lift, min(self._lift, self._free_lift)
        return self._lift / before

    def doubt(self, told: Mapping[str, float | None]) -> str:
        """Why control by thrust may not be taken: it is not measured, or contradicts all that was `told`."""
        if self.std > KNOWN_STD:
            return (
                f"hover thrust: uncertain: {100.0 * self.std:.0f} %, limit {100.0 * KNOWN_STD:.0f} %: "
                "no ATTITUDE_TARGET received"
            )
        numbers = {name: value for name, value in told.items() if value is not None}
        surely = SIGMA_THRESHOLD * self.std
        shares = [self.value / value for value in numbers.values() if value > 0.0]
        if any((1.0 + surely) * s >= LEAST_SHARE and (1.0 - surely) * s <= MOST_SHARE for s in shares):
            return ""
        words = ", ".join(f"{name} {value:.2f}" for name, value in numbers.items())
        return (
            f"hover thrust: {self.value:.2f} measured, {words} configured; "
            f"expected {LEAST_SHARE:g} to {MOST_SHARE:g} times that"
        )


class HeldThrust:
    """The thrust that acts, as late as its acceleration is measured, from what the autopilot reports."""

    def __init__(self, motor_lag_s: float, sensor_lag_s: float) -> None:
        """First-order lags: from thrust to acceleration, and from that to its measurement."""
        self._lags_s = (motor_lag_s, sensor_lag_s)
        self._acting: tuple[float, float] | None = None

    def step(self, thrust: float | None, elapsed_s: float) -> float | None:
        """What acts by now, measured late; None until it has been reported, unbroken, for those lags."""
        if thrust is None or self._acting is None:
            self._acting = None if thrust is None else (thrust, thrust)
            return None
        made, late = self._acting
        motor_s, sensor_s = self._lags_s
        made += -math.expm1(-elapsed_s / motor_s) * (thrust - made)
        late += -math.expm1(-elapsed_s / sensor_s) * (made - late)
        self._acting = (made, late)
        return late
