"""The board's edges between neighbouring corners, in grey values: what shows how the camera encodes light."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray

REACH_PX: Final = (2.5, 6.0)
# of an edge's length, and of the width of the white beside it
SPAN: Final = 0.5
REACH_SHARE: Final = 0.8
LEAST_CONTRAST: Final = 40.0
# white that is brighter may be cut off
FULL_GREY: Final = 250.0
# edge, distance as a share of the reach, reach, grey value
COLUMNS: Final = 4


def edge_pixels(
    image: NDArray[np.uint8], points_m: FloatArray, corners_px: FloatArray, square_m: float, white_m: float
) -> FloatArray:
    """The pixels about edges between neighbouring corners (n, 4): greys as they are, interpolated nowhere.

    Of each: which edge, how far from it into the white as a share of the reach (-1..1), the reach (px), and
    its grey value. `white_m` is how much white an edge has beside it.
    """
    steps = np.rint(2.0 * points_m[:, :2] / square_m).astype(int)
    places = {(x, y): k for k, (x, y) in enumerate(steps.tolist())}
    pairs = [
        (k, places[other])
        for (x, y), k in places.items()
        for other in ((x + 2, y), (x, y + 2))
        if other in places
    ]
    found = (_about(image, corners_px[a], corners_px[b], white_m / square_m) for a, b in pairs)
    kept = [each for each in found if each is not None]
    if not kept:
        return np.empty((0, COLUMNS))
    numbered = (np.column_stack((np.full(len(each), k), each)) for k, each in enumerate(kept))
    return np.concatenate(list(numbered))


def _about(
    image: NDArray[np.uint8], start: FloatArray, end: FloatArray, white_share: float
) -> FloatArray | None:
    """Distances into the white, the reach and grey values (n, 3) of one edge's pixels."""
    along = end - start
    length = float(np.linalg.norm(along))
    reach = min(REACH_SHARE * white_share * length, REACH_PX[1])
    middle, margin = 0.5 * (start + end), 0.5 * SPAN * np.abs(along) + reach + 1.0
    low, high = np.floor(middle - margin).astype(int), np.ceil(middle + margin).astype(int)
    if reach < REACH_PX[0] or low.min() < 0 or (high >= image.shape[::-1]).any():
        return None
    along = along / length
    v, u = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    x, y = u - middle[0], v - middle[1]
    across = (x * along[1] - y * along[0]) / reach
    near = (np.abs(across) < 1.0) & (np.abs(x * along[0] + y * along[1]) < 0.5 * SPAN * length)
    grey, across = image[low[1] : high[1] + 1, low[0] : high[0] + 1][near].astype(np.float64), across[near]
    ends = [float(grey[side].mean()) if side.any() else 0.0 for side in (across < -0.7, across > 0.7)]
    if abs(ends[1] - ends[0]) < LEAST_CONTRAST or max(ends) > FULL_GREY:
        return None
    return np.column_stack((across if ends[1] > ends[0] else -across, np.full(len(grey), reach), grey))
