"""The app's vision, and a watch on whether it is shown a mirror image. Pure."""

from dataclasses import replace
from typing import Final

import numpy as np

from companion.base.messages import Frame, PadPrior
from companion.sense.vision.pipeline import Vision, VisionResult

UNSEEN_FRAMES: Final = 12  # so many in a row without the pad before its mirror image is looked for
# even: with the mirrored look the search's turns then alternate between far and near there, too
EVERY: Final = 4
ENOUGH: Final = 4


class MirrorWatch:
    """Vision as in flight. A printed code is no code in a mirror: only a flipped frame shows it then."""

    def __init__(self, vision: Vision) -> None:
        self._vision = vision
        self._unseen = self._mirrored = 0
        self.last: tuple[Frame, VisionResult] | None = None

    @property
    def mirrored(self) -> bool:
        """Whether the pad has been found in mirrored frames, several times, and in none as it came."""
        return self._mirrored >= ENOUGH

    def step(self, frame: Frame, prior: PadPrior | None) -> VisionResult:
        """Look at a frame; see `Vision.step`."""
        seen = self._vision.step(frame, prior)
        self.last = (frame, seen)
        if seen.sighting is not None:
            self._unseen = self._mirrored = 0
            return seen
        self._unseen += 1
        if self._unseen > UNSEEN_FRAMES and self._unseen % EVERY == 0:
            flipped = replace(frame, image=np.ascontiguousarray(frame.image[:, ::-1]))
            self._mirrored += self._vision.step(flipped, None).sighting is not None
        return seen
