"""The level moment: of a deck that swings, and of the vehicle that tilts with a pad and against the wind.

A swing goes on as it is for a part of its period: from the mean, by the tilt and its rate at the swing's own
frequency. The vehicle's tilt against the wind stays, that for the pad's acceleration turns with its course:
over a pad on a circle there is a moment at which the two are against one another. NED, rad, m/s², s.
"""

from __future__ import annotations

import cmath
import math
from typing import Final

from companion.base.geometry import Quaternion, horizontal_acceleration, tilt_from_quat
from companion.base.messages import PadState

# a pad that swings less, root mean square, hardly tilts by 5 deg, and our own error swings by as much as 0.6
SWINGS_RAD: Final = math.radians(2.0)
# a swing of several periods at once is known for about so long
KNOWN_S: Final = 4.0


def tilt_in_rad(sight: PadState, ahead_s: float) -> float:
    """How far the pad will tilt (rad) so much later."""
    turned = sight.tilt_frequency_rad_s * ahead_s
    known = math.exp(-0.5 * (ahead_s / KNOWN_S) ** 2)
    rate_s = math.sin(turned) / sight.tilt_frequency_rad_s if turned > 0.0 else ahead_s
    return math.hypot(
        *(
            mean + known * (math.cos(turned) * (tilt - mean) + rate_s * rate)
            for mean, tilt, rate in zip(
                sight.tilt_mean_rad, sight.tilt_rad, sight.tilt_rate_rad_s, strict=True
            )
        )
    )


def level_at(sight: PadState, ahead_s: float, most_rad: float) -> bool:
    """Whether a contact so much later meets the pad level enough; a pad that does not swing is as it is."""
    return sight.tilt_swing_rad < SWINGS_RAD or tilt_in_rad(sight, ahead_s) <= most_rad


class TiltPrediction:
    """How far the vehicle tilts, and will have to, as the horizontal acceleration that its thrust makes."""

    SMOOTHING_S: Final = 0.25

    def __init__(self) -> None:
        self.tilt_rad = 0.0
        # complex: north + i east
        self._lasting_m_s2, self._with_pad_m_s2, self._turn_rad_s = 0j, 0j, 0.0
        self._noted_s: float | None = None

    def note(self, attitude: Quaternion, sight: PadState | None, now_s: float) -> None:
        """Take in the vehicle's attitude; an unseen pad goes on as it did."""
        if sight is not None:
            self._with_pad_m_s2 = complex(*sight.acceleration_ned_m_s2[:2])
            self._turn_rad_s = sight.turn_rate_rad_s
        self.tilt_rad = tilt_from_quat(attitude)
        lasting = complex(*horizontal_acceleration(attitude)) - self._with_pad_m_s2
        first = self._noted_s is None
        elapsed_s = 0.0 if self._noted_s is None else max(0.0, now_s - self._noted_s)
        share = 1.0 if first else -math.expm1(-elapsed_s / self.SMOOTHING_S)
        self._noted_s = now_s
        self._lasting_m_s2 += share * (lasting - self._lasting_m_s2)

    def predicted_acceleration_m_s2(self, ahead_s: float) -> float:
        """How much it will take (m/s²) so much later."""
        turned = cmath.rect(1.0, self._turn_rad_s * ahead_s)
        return abs(self._lasting_m_s2 + self._with_pad_m_s2 * turned)
