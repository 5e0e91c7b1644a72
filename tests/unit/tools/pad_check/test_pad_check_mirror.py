"""The watch on whether the eyes are shown a mirror image."""

from typing import Any

import numpy as np

from companion.base.messages import Frame, PadPrior
from companion.sense.vision.pipeline import VisionResult
from companion.tools.pad_check.mirror import MirrorWatch

IMAGE = np.tile(np.arange(64, dtype=np.uint8), (48, 1))


class CountingVision:
    """Sees nothing, and notes at which turn of the search it was shown a mirrored frame."""

    def __init__(self) -> None:
        self.turn = 0
        self.mirrored_at: list[int] = []

    def step(self, frame: Frame, prior: PadPrior | None) -> VisionResult:
        self.turn += 1
        if frame.image[0, 0] > frame.image[0, -1]:
            self.mirrored_at.append(self.turn)
        return VisionResult(None, {"F": 0, "M": 0, "C": 0}, searched_whole_frame=True)


def test_a_mirrored_pad_is_looked_for_far_and_near() -> None:
    vision: Any = CountingVision()
    eyes = MirrorWatch(vision)
    for k in range(60):
        eyes.step(Frame(k / 30, k / 30, k, IMAGE), None)
    turns = [turn % 2 for turn in vision.mirrored_at]
    assert len(turns) >= 8
    assert abs(turns.count(0) - turns.count(1)) <= 1
