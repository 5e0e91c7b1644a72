"""The level moment of a deck that swings: it is met when it will lean little at contact.

A swing goes on as it is for a part of its period: from the mean, by the lean and its rate at the swing's own
frequency. Rad, s.
"""

from __future__ import annotations

import math
from typing import Final

from companion.base.messages import PadState

# a pad that swings less, root mean square, hardly leans by 5 deg, and our own error swings by as much as 0.6
SWINGS_RAD: Final = math.radians(2.0)
# a swing of several periods at once is known for about so long
KNOWN_S: Final = 4.0


def lean_in_rad(sight: PadState, ahead_s: float) -> float:
    """How far the pad will lean (rad) so much later."""
    turned = sight.lean_frequency_rad_s * ahead_s
    known = math.exp(-0.5 * (ahead_s / KNOWN_S) ** 2)
    rate_s = math.sin(turned) / sight.lean_frequency_rad_s if turned > 0.0 else ahead_s
    return math.hypot(
        *(
            mean + known * (math.cos(turned) * (lean - mean) + rate_s * rate)
            for mean, lean, rate in zip(
                sight.lean_mean_rad, sight.lean_rad, sight.lean_rate_rad_s, strict=True
            )
        )
    )


def level_at(sight: PadState, ahead_s: float, most_rad: float) -> bool:
    """Whether a contact so much later meets the pad level enough; a pad that does not swing is as it is."""
    return sight.lean_swing_rad < SWINGS_RAD or lean_in_rad(sight, ahead_s) <= most_rad
