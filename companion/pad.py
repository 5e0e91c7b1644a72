"""The pad as data: the eyes, the renderer and the printer all read the same layout.

Pad frame: origin at the centre of the surface, x along the pad's heading, y to its right, z down.
Marker corners go round as OpenCV's do: top-left, top-right, bottom-right, bottom-left of the printed
code. A marker with yaw 0 is printed with its top edge towards +x.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from pydantic import Field, model_validator

from companion.config import StrictModel, find_file, load_model
from companion.geometry import FloatArray
from companion.messages import MarkerGroup

DICTIONARIES = {
    "4x4_50": cv2.aruco.DICT_4X4_50,
    "5x5_50": cv2.aruco.DICT_5X5_50,
    "6x6_50": cv2.aruco.DICT_6X6_50,
}
DictionaryName = Literal["4x4_50", "5x5_50", "6x6_50"]


class Marker(StrictModel):
    """One printed marker."""

    dictionary: DictionaryName
    id: int = Field(ge=0, lt=50)
    side_m: float = Field(gt=0.005, le=3.0)
    position_pad_m: tuple[float, float]
    yaw_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    group: MarkerGroup

    def corners_pad_m(self) -> FloatArray:
        """Corners (4, 3) in the pad frame (m), in OpenCV's order."""
        half = 0.5 * self.side_m
        yaw = math.radians(self.yaw_deg)
        c, s = math.cos(yaw), math.sin(yaw)
        # top is +x, right is +y
        square = ((half, -half), (half, half), (-half, half), (-half, -half))
        x0, y0 = self.position_pad_m
        return np.array([(x0 + c * x - s * y, y0 + s * x + c * y, 0.0) for x, y in square])


class Pad(StrictModel):
    """A landing pad: a board with markers of several sizes."""

    name: str
    width_m: float = Field(gt=0.05, le=10.0)
    length_m: float = Field(gt=0.05, le=10.0)
    markers: tuple[Marker, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _unique_and_on_the_board(self) -> Pad:
        keys = [(marker.dictionary, marker.id) for marker in self.markers]
        repeated = sorted({f"{d} id {i}" for d, i in keys if keys.count((d, i)) > 1})
        if repeated:
            raise ValueError(f"markers repeated: {', '.join(repeated)}; expected each dictionary and id once")
        for marker in self.markers:
            corners = np.abs(marker.corners_pad_m())
            if corners[:, 0].max() > 0.5 * self.length_m or corners[:, 1].max() > 0.5 * self.width_m:
                raise ValueError(f"marker {marker.dictionary} id {marker.id} reaches over the board's edge")
        return self


def load_pad(name: str | Path) -> Pad:
    """Read a pad by name (from configs/pads) or path.

    Raises:
        ConfigError: the file is missing, not YAML, or breaks a rule.
    """
    return load_model(Pad, find_file("pads", name))
