"""Which frames of a moving picture are worth keeping: sharp, still, and of something not yet seen. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.camera.views.coverage import ENOUGH_VIEWS, ImageCoverage
from calibration.camera.views.detection import BoardView

# an edge wider than this is blurred, unless this lens makes no sharper ones
SHARP_EDGE_PX: Final = 3.5
SHARP_RATIO: Final = 1.25
# in image widths a second. A rolling shutter of 20 ms shears what moves so fast by 0.4 px of 1280
STILL_SHARE_S: Final = 0.015
# the board has to be still for this long, and has not to have been out of sight for longer
STILL_S: Final = 0.1
FORGOTTEN_S: Final = 0.5
# views whose corners are on average so near in the image (of its width) are the same view
SAME_SHARE: Final = 0.06
FEWEST_COMMON: Final = 4


@dataclass(frozen=True, slots=True)
class CaptureStep:
    """What came of one frame: whether it was kept, and what to tell whoever holds the board."""

    kept: bool
    text: str


class CaptureSession:
    """Chooses frames. Time is given; nothing is read from a clock."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.size_px = size_px
        self.coverage = ImageCoverage(size_px)
        self.views: list[BoardView] = []
        self._last: tuple[float, BoardView] | None = None
        self._still_since_s: float | None = None
        self._sharpest_px = float("inf")

    @property
    def complete(self) -> bool:
        """Whether all that is asked for has been seen."""
        return len(self.views) >= ENOUGH_VIEWS and self.coverage.complete

    def step(self, time_s: float, view: BoardView | None) -> CaptureStep:
        """Take one frame's view of the board (None: not found), at its time."""
        if view is None:
            self._last = self._still_since_s = None
            return CaptureStep(False, "no board in sight")
        still_s = self._still_for(time_s, view)
        self._last = (time_s, view)
        self._sharpest_px = min(self._sharpest_px, view.edge_px)
        if view.edge_px > max(SHARP_EDGE_PX, SHARP_RATIO * self._sharpest_px):
            return CaptureStep(False, "blurred: hold it still, in more light or farther off")
        if still_s < STILL_S:
            return CaptureStep(False, "hold it still")
        if not self._is_new(view):
            return CaptureStep(False, self.hint())
        self.views.append(view)
        self.coverage.add(view)
        self._still_since_s = None
        return CaptureStep(True, f"view {len(self.views)} kept; {self.hint()}")

    def hint(self) -> str:
        """What to do next, in words."""
        hints = self.coverage.hints()
        return hints[0] if hints else "all has been seen"

    def _still_for(self, time_s: float, view: BoardView) -> float:
        """For how long the board has not moved."""
        if self._last is None or not 0.0 < time_s - self._last[0] < FORGOTTEN_S:
            self._still_since_s = None
            return 0.0
        moved = _distance_px(view, self._last[1])
        if moved is None or moved > STILL_SHARE_S * self.size_px[0] * (time_s - self._last[0]):
            self._still_since_s = None
            return 0.0
        if self._still_since_s is None:
            self._still_since_s = self._last[0]
        return time_s - self._still_since_s

    def _is_new(self, view: BoardView) -> bool:
        distances = [_distance_px(view, old) for old in self.views]
        near = [d for d in distances if d is not None and d < SAME_SHARE * self.size_px[0]]
        return not near or self.coverage.brings_something(view)


def _distance_px(one: BoardView, other: BoardView) -> float | None:
    """Root mean square distance of the corners that both have; None where there are hardly any."""
    _, a, b = np.intersect1d(one.ids, other.ids, return_indices=True)
    if len(a) < FEWEST_COMMON:
        return None
    moved = one.corners_px[a] - other.corners_px[b]
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))
