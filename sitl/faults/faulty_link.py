"""A MAVLink line that loses, delays and reorders datagrams between the vehicle and its clients.

Pure: from the time a datagram is sent (s) it returns when it arrives, or that it is lost. A datagram is whole
or lost, as over UDP, or as radio packets are. Each direction has its own random numbers.
"""

from typing import Final

import numpy as np
from pydantic import Field

from companion.config import StrictModel

# two datagrams that arrive in order do not arrive at once: timers of one time have no order
NEXT_S: Final = 1e-6


class LinkSettings(StrictModel):
    """Quality of the line, the same in both directions."""

    loss_share: float = Field(default=0.0, ge=0.0, le=1.0, description="Share of the datagrams that is lost")
    delay_s: float = Field(default=0.0, ge=0.0, le=2.0, description="Delay of each datagram")
    jitter_s: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Further random delay, at most; the order stays"
    )
    reorder_share: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Share of the datagrams that later ones overtake"
    )
    reorder_hold_s: float = Field(
        default=0.05, gt=0.0, le=2.0, description="How long an overtaken datagram is held back"
    )


class LinkChannel:
    """One direction of a line. `cut` is a blackout; faults add to its delay and its loss."""

    def __init__(self, settings: LinkSettings, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self._perfect = settings == LinkSettings()
        self._latest_s = -1.0
        self.clear_faults()

    def clear_faults(self) -> None:
        """Clear all faults; the line's own quality stays. What is under way is not overtaken."""
        self.cut = False
        self.extra_delay_s = self.extra_loss = 0.0

    def arrival_s(self, now_s: float) -> float | None:
        """When a datagram sent now arrives (s), None if it is lost."""
        if self.cut:
            return None
        if self.extra_loss > 0.0 and float(self._rng.random()) < self.extra_loss:
            return None
        if self._perfect and self.extra_delay_s == 0.0 and self._latest_s < now_s:
            return now_s
        s = self._settings
        lost, late, held = (float(self._rng.random()) for _ in range(3))
        if lost < s.loss_share:
            return None
        arrival_s = now_s + s.delay_s + self.extra_delay_s + s.jitter_s * late
        if held < s.reorder_share:
            return arrival_s + s.reorder_hold_s
        self._latest_s = max(arrival_s, self._latest_s + NEXT_S)
        return self._latest_s
