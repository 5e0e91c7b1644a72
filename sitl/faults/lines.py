"""A MAVLink line that loses, delays and reorders datagrams between the vehicle and its clients.

Pure: from the time a datagram is sent (s) it returns when it arrives, or that it is lost. A datagram is whole
or lost, as over UDP, or as radio packets are. Each direction has its own random numbers.

The transport of frames from the camera to the app: delayed, lost, repeated or corrupted frames.

A camera may drop frames by itself, singly or in bursts (a Gilbert model: two states, and a probability of
change at each frame); faults add to that.
"""

from typing import Final

import numpy as np
from pydantic import Field

from companion.config import StrictModel
from sitl.camera.textures import GreyImage

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


class FrameLine:
    """`lost_share` of the frames is always lost, in bursts of `burst_frames` on average."""

    def __init__(self, rng: np.random.Generator, lost_share: float = 0.0, burst_frames: float = 1.0) -> None:
        self._rng = rng
        self._always = (lost_share, burst_frames)
        self._losing = False
        self._last: GreyImage | None = None
        self.clear_faults()

    def clear_faults(self) -> None:
        """Clear all faults; the camera's own losses stay."""
        self.late_s = 0.0
        self.late_every = 1
        self.lost_share, self.burst_frames = self._always
        self.stuck = False
        self.garbled_share = 0.0
        self.black = self.garbage = False

    def delay_s(self, sequence: int) -> float | None:
        """Additional delay of a frame (s); None: it is lost."""
        if self.lost_share > 0.0 and self._lost():
            return None
        return self.late_s if sequence % self.late_every == 0 else 0.0

    def _lost(self) -> bool:
        """Whether the next frame is lost; with bursts of 1, each is drawn independently."""
        draw, share = float(self._rng.random()), self.lost_share
        if self.burst_frames <= 1.0 or share >= 1.0:
            return draw < share
        ends = 1.0 / self.burst_frames
        begins = min(1.0, ends * share / (1.0 - share))
        self._losing = draw >= ends if self._losing else draw < begins
        return self._losing

    def carried(self, image: GreyImage) -> GreyImage:
        """The image that arrives: unchanged, black, the last one again, or random data (below some row)."""
        if self.black:
            return np.zeros_like(image)
        if self.garbage:
            return self._rng.integers(0, 256, image.shape, dtype=np.uint8)
        if self.stuck and self._last is not None:
            return self._last
        self._last = image
        if self.garbled_share == 0.0 or float(self._rng.random()) >= self.garbled_share:
            return image
        row = int(self._rng.integers(image.shape[0]))
        garbled = image.copy()
        garbled[row:] = self._rng.integers(0, 256, garbled[row:].shape, dtype=np.uint8)
        return garbled
