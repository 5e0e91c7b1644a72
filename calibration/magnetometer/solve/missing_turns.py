"""Which turns a set of samples lacks, in the words of somebody who holds the vehicle. Pure.

With one axis vertical and the vehicle turned once right round, the field comes near that axis: near its one
end with the nose down (or the right side, or the belly), near its other end the other way up.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from companion.base.geometry import FloatArray

ON_A_LINE: Final = 0.05  # of the samples' second extent to their largest: no turn to speak of
_TURNS: Final = (
    "nose down, then nose up: roll it once right round in each",
    "right side down, then left side down: turn it once right round in each",
    "upright, then upside down: turn it once right round in each",
)


def beside_plane(raw: FloatArray, body_from_sensor: FloatArray) -> str:
    """What to do after raw readings (n, 3) that lie nearly in one plane, whatever their centre and scale.

    A turn about one axis alone keeps the field in a plane across it: the other two axes' turns are missing.
    """
    _, extents, axes = np.linalg.svd(raw - np.median(raw, axis=0), full_matrices=False)
    if extents[1] <= ON_A_LINE * extents[0]:
        return "; ".join(_TURNS)
    turned_about = int(np.argmax(np.abs(body_from_sensor @ axes[2])))
    return "; ".join(words for axis, words in enumerate(_TURNS) if axis != turned_about)


def suggest_next_rotation(directions: FloatArray, body_from_sensor: FloatArray) -> str:
    """What to do next after calibrated directions (n, 3): turns about the axis the field was least near."""
    return _TURNS[int(np.argmin(np.mean((directions @ body_from_sensor.T) ** 2, axis=0)))]
