"""One printed marker: its code, its place on the pad, and the white that it needs.

Corners go round as OpenCV's do: top-left, top-right, bottom-right, bottom-left of the printed code. A
marker with yaw 0 is printed with its top edge towards +x of the pad.
"""

import math
from typing import Final, Literal

import cv2
import numpy as np
from pydantic import Field

from companion.base.geometry import FloatArray
from companion.base.messages import MarkerGroup
from companion.config import StrictModel

DictionaryName = Literal["4x4_50", "5x5_50", "6x6_50"]
DICTIONARIES: Final[dict[DictionaryName, int]] = {
    "4x4_50": cv2.aruco.DICT_4X4_50,
    "5x5_50": cv2.aruco.DICT_5X5_50,
    "6x6_50": cv2.aruco.DICT_6X6_50,
}
Corners = tuple[tuple[float, float], ...]


class Marker(StrictModel):
    """One printed marker."""

    dictionary: DictionaryName
    """ArUco dictionary"""
    id: int = Field(ge=0, lt=50)
    """Number of the marker in its dictionary; each once"""
    side_m: float = Field(gt=0.005, le=3.0)
    """Side of the black square; set it to what was printed"""
    position_pad_m: tuple[float, float]
    """Centre of the marker, along the heading and to the right"""
    yaw_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    """0: its top edge points along the heading"""
    group: MarkerGroup
    """F (far), M (medium) or C (close): the height at which it is looked for"""
    quiet_zone_m: float | None = Field(default=None, ge=0.0, le=1.0)
    """White all around it; none: a cell of its code"""

    @property
    def name(self) -> str:
        """As messages call it."""
        return f"{self.dictionary} id {self.id}"

    @property
    def cells(self) -> int:
        """Cells along a side, the black border included."""
        return int(self.dictionary[0]) + 2

    @property
    def cell_m(self) -> float:
        return self.side_m / self.cells

    @property
    def quiet_m(self) -> float:
        """Width of the white all around it."""
        return self.cell_m if self.quiet_zone_m is None else self.quiet_zone_m

    def square_pad_m(self, margin_m: float = 0.0) -> Corners:
        """Corners (x, y) in the pad frame (m), in OpenCV's order, of the marker grown by a margin."""
        half = 0.5 * self.side_m + margin_m
        yaw = math.radians(self.yaw_deg)
        c, s = math.cos(yaw), math.sin(yaw)
        # top is +x, right is +y
        square = ((half, -half), (half, half), (-half, half), (-half, -half))
        x0, y0 = self.position_pad_m
        return tuple((x0 + c * x - s * y, y0 + s * x + c * y) for x, y in square)

    def corners_pad_m(self) -> FloatArray:
        """Corners (4, 3) in the pad frame (m), in OpenCV's order."""
        return np.array([(x, y, 0.0) for x, y in self.square_pad_m()])
