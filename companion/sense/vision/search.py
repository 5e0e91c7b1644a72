"""Where in a frame to look for which markers, from where the pad is expected to be.

Far markers (F) are read from afar, medium (M) and close ones (C) as they grow; a group that is seen
whole, with cells of a few pixels after shrinking the image, is enough. What is hardly legible is looked at
enlarged as well, and the next smaller group is the last look, so that there is no height at which vision
depend on a single group.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray
from companion.base.messages import MarkerGroup
from companion.config import VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import GROUPS, SearchPass
from companion.sense.vision.lens import Lens

REGION_MARGIN_PX: Final = 14.0  # about the pad's expected place in the image
REGION_MARGIN_SIGMA: Final = 3.0  # the same in standard deviations of the expected position

# pixels a cell of the code should keep when the image is shrunk, and the shrinkings that are tried
CELL_PX: Final = 3.1
SHRINKINGS: Final = (6, 4, 3, 2, 1)
# cells of fewer pixels are read with luck: outlines are of whole ones. A look in vain is repeated enlarged so
ENLARGED: Final = 2
# markers of the preferred group that should be whole in the image
ENOUGH_MARKERS: Final = 2
# a pad expected with a standard deviation above this share of its distance is searched for everywhere
VAGUE: Final = 0.25
EDGE_PX: Final = 4.0


@dataclass(frozen=True, slots=True)
class _View:
    """One group of markers as it is expected in the image."""

    group: MarkerGroup
    whole: FloatArray  # (k, 4, 2) corners of the markers that should be whole in the image
    side_px: float
    cell_px: float


class SearchPlanner:
    """Knows the pad's corners and the lens, and says where they should appear."""

    def __init__(self, pad: Pad, lens: Lens, config: VisionConfig) -> None:
        self._lens = lens
        self._config = config
        self._middle = 0.5 * np.array(lens.size_px)
        self._far = np.tile(lens.size_px, 4) - EDGE_PX
        self._points = np.array([marker.corners_pad_m() for marker in pad.markers]).reshape(-1, 3)
        self._members = {g: np.array([m.group == g for m in pad.markers]) for g in GROUPS}
        self._cells = {g: max((m.cells for m in pad.markers if m.group == g), default=1) for g in GROUPS}
        self._finest_m = min((m.side_m / m.cells for m in pad.markers), default=0.0)

    def whole_frame(self, turn: int, *, near: bool = False) -> tuple[SearchPass, ...]:
        """Looks over the whole frame when no marker is expected in it: in turn for what is far and is near.

        In full for what is far, and shrunk for what is near. Half of the cost a frame, and the pad is found
        a frame later at worst. A pad that is known to be `near` is looked for in every frame.
        """
        close = (self._whole(4, GROUPS), self._whole(2, GROUPS))
        far = (self._whole(1, GROUPS),)
        if turn % 2 == 0:
            return (*close, *far) if near else far
        return close

    def is_near(self, pad_position_camera_m: FloatArray, position_std_m: float) -> bool:
        """Whether the pad is so near that its smallest marker can be read in an image shrunk to half.

        Of the pad's centre (3,) and its standard deviation, each axis: it may be farther than expected.
        """
        distance = float(np.linalg.norm(pad_position_camera_m))
        distance += REGION_MARGIN_SIGMA * position_std_m
        return self._lens.focal_px * self._finest_m >= 2.0 * CELL_PX * distance

    def widened(self, look: SearchPass) -> tuple[SearchPass, ...]:
        """A look at the whole frame after one in vain, and at what was shrunk much closer ones.

        Larger markers, though none was expected, can be read in them as well, and are worth little more time.
        Nothing when that would be the same again.
        """
        width, height = self._lens.size_px
        groups = GROUPS[: 1 + max(GROUPS.index(group) for group in look.groups)]
        covered = 2 * (look.right - look.left) * (look.bottom - look.top) > width * height
        # what is much shrunk loses most by the frame's edge, and what is blurred most when it is not shrunk
        closer = sorted({max(look.shrink // 2, 2), 2} if look.shrink > 1 else {1}, reverse=True)
        same = look.shrink if covered and look.groups == groups else None
        return tuple(self._whole(s, groups) for s in closer if s != same)

    def _whole(self, shrink: int, groups: tuple[MarkerGroup, ...]) -> SearchPass:
        width, height = self._lens.size_px
        return SearchPass(0, 0, width, height, shrink, groups)

    def expected(
        self, camera_from_pad: FloatArray, pad_position_camera_m: FloatArray, position_std_m: float
    ) -> tuple[SearchPass, ...]:
        """At most three looks at where the pad should be; none when it should be out of view or is vague.

        Args:
            camera_from_pad: rotation (3, 3).
            pad_position_camera_m: (3,) of the pad's centre.
            position_std_m: standard deviation of that position, each axis.
        """
        distance = float(np.linalg.norm(pad_position_camera_m))
        if position_std_m > VAGUE * distance:
            return ()
        pixels, depth = self._lens.project(self._points @ camera_from_pad.T + pad_position_camera_m)
        nearest = max(float(depth.min()), 0.05)
        margin = REGION_MARGIN_SIGMA * position_std_m * self._lens.focal_px / nearest
        pixels = pixels.reshape(-1, 4, 2)
        # what should be cut off by the frame's edge may be whole within the expectation's uncertainty
        views = self._views(pixels, 0.0) or self._views(pixels, margin)
        good = [v for v in views if len(v.whole) >= ENOUGH_MARKERS]
        first = good[0] if good else (views[0] if views else None)
        if first is None:
            return ()
        rank = GROUPS.index(first.group)
        wide = margin + REGION_MARGIN_PX
        look = self._pass(first, wide)
        if first.cell_px < CELL_PX:
            # hardly legible: one larger marker that may be in view is worth more than all of these
            for view in self._views(pixels, margin):
                look = _both(look, self._pass(view, wide)) if GROUPS.index(view.group) < rank else look
        later = [v for v in views if GROUPS.index(v.group) > rank]
        return (look, *self._enlarged(look, first), *(self._pass(v, wide) for v in later[:1]))

    def _enlarged(self, look: SearchPass, view: _View) -> tuple[SearchPass, ...]:
        """What is hardly legible is looked at enlarged, where that costs no more than the frame in full."""
        width, height = self._lens.size_px
        area = (look.right - look.left) * (look.bottom - look.top) * ENLARGED**2
        if view.cell_px >= CELL_PX or area > width * height:
            return ()
        return (replace(look, enlarge=ENLARGED),)

    def _views(self, pixels: FloatArray, slack_px: float) -> list[_View]:
        flat = pixels.reshape(-1, 8)
        inside = ((flat > EDGE_PX - slack_px) & (flat < self._far + slack_px)).all(axis=1)
        views = (self._view(group, pixels[inside & self._members[group]]) for group in GROUPS)
        return [view for view in views if view is not None]

    def _view(self, group: MarkerGroup, whole: FloatArray) -> _View | None:
        """The group's readable markers, of those that are whole in the image: the large enough."""
        if len(whole) == 0:
            return None
        u, v = (whole[:, 1] - whole[:, 0]).T
        side = sorted(np.sqrt(u * u + v * v).tolist())[len(whole) // 2]
        if side < self._config.minimum_side_px:
            return None
        return _View(group, whole, side, side / self._cells[group])

    def _pass(self, view: _View, margin_px: float) -> SearchPass:
        """The rectangle about the group's markers nearest to the image's middle."""
        near, most = view.whole, self._config.maximum_markers
        if len(near) > most:
            away = ((0.25 * near.sum(axis=1) - self._middle) ** 2).sum(axis=1)
            near = near[np.argsort(away, kind="stable")[:most]]
        margin = margin_px + 0.2 * view.side_px
        near = near.reshape(-1, 2)
        (left, top), (right, bottom) = near.min(axis=0).tolist(), near.max(axis=0).tolist()
        left, top = max(math.floor(left - margin), 0), max(math.floor(top - margin), 0)
        width, height = self._lens.size_px
        right, bottom = min(math.ceil(right + margin) + 1, width), min(math.ceil(bottom + margin) + 1, height)
        shrink = next((s for s in SHRINKINGS if view.cell_px >= CELL_PX * s), 1)
        return SearchPass(left, top, right, bottom, shrink, (view.group,))


def _both(a: SearchPass, b: SearchPass) -> SearchPass:
    """One look for what two look for, no coarser than either."""
    left, top = min(a.left, b.left), min(a.top, b.top)
    right, bottom = max(a.right, b.right), max(a.bottom, b.bottom)
    groups = tuple(g for g in GROUPS if g in a.groups or g in b.groups)
    return SearchPass(left, top, right, bottom, min(a.shrink, b.shrink), groups)
