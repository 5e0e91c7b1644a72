"""The transport of frames from the camera to the app: delayed, lost, repeated or corrupted frames.

A camera may drop frames by itself, singly or in bursts (a Gilbert model: two states, and a probability of
change at each frame); faults add to that.
"""

import numpy as np

from sitl.camera.textures import GreyImage


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
