"""One printed marker: its code, its place on the pad, and the white that it needs.

Corners go round as OpenCV's do: top-left, top-right, bottom-right, bottom-left of the code as OpenCV prints
it. A marker with yaw 0 is printed with its top edge towards +x of the pad. The top of an AprilTag is that of
AprilRobotics' pictures, which most people print: OpenCV's, turned by half a turn.
"""

import math
from functools import cache
from typing import Any, Final

import cv2
import numpy as np
from pydantic import Field, field_validator, model_validator

from companion.base.geometry import FloatArray
from companion.base.messages import MarkerGroup
from companion.config import StrictModel

# OpenCV has some names twice, in capitals and not
DICTIONARIES: Final = {
    name.removeprefix("DICT_").lower(): int(getattr(cv2.aruco, name))
    for name in dir(cv2.aruco)
    if name.startswith("DICT_")
}
EXACT_CELLS: Final = 1e-6
# as much of what a family's codes can do without is corrected by vision
ERROR_CORRECTION_RATE: Final = 0.5
Corners = tuple[tuple[float, float], ...]


@cache
def dictionary_named(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of a name in `DICTIONARIES`."""
    return cv2.aruco.getPredefinedDictionary(DICTIONARIES[name])


@cache
def _cells(dictionary: str) -> int:
    return int(dictionary_named(dictionary).markerSize) + 2


class Marker(StrictModel):
    """One printed marker."""

    dictionary: str
    """Family: ArUco's 4x4_50 to 7x7_1000, aruco_original, aruco_mip_36h12, or apriltag_16h5, 25h9, 36h10,
    36h11"""
    id: int = Field(ge=0)
    """Number of the marker in its dictionary; each once"""
    side_m: float = Field(gt=0.005, le=3.0)
    """Side of the black square; set it to what was printed"""
    position_pad_m: tuple[float, float]
    """Centre of the marker, along the heading and to the right"""
    yaw_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    """0: its top edge points along the heading; an AprilTag's is the one of AprilRobotics' pictures"""
    group: MarkerGroup = "F"
    """F (far), M (medium) or C (close): the height at which the marker is searched; none: by its size among
    the pad's markers"""
    quiet_zone_m: float | None = Field(default=None, ge=0.0, le=1.0)
    """White margin all around it; none: one cell of its code"""

    @field_validator("dictionary", mode="before")
    @classmethod
    def _known(cls, name: Any) -> str:
        known = str(name).lower().removeprefix("dict_")
        if known not in DICTIONARIES:
            raise ValueError(f"expected one of {', '.join(sorted(DICTIONARIES))}")
        return known

    @model_validator(mode="after")
    def _in_its_dictionary(self) -> "Marker":
        if self.id >= (count := len(dictionary_named(self.dictionary).bytesList)):
            raise ValueError(f"id {self.id}: expected less than {count} in {self.dictionary}")
        return self

    @property
    def name(self) -> str:
        """As messages call it."""
        return f"{self.dictionary} id {self.id}"

    @property
    def cells(self) -> int:
        """Cells along a side, the black border included."""
        return _cells(self.dictionary)

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
        yaw = math.radians(self.yaw_deg + (180.0 if self.dictionary.startswith("apriltag") else 0.0))
        c, s = math.cos(yaw), math.sin(yaw)
        # top is +x, right is +y
        square = ((half, -half), (half, half), (-half, half), (-half, -half))
        x0, y0 = self.position_pad_m
        return tuple((x0 + c * x - s * y, y0 + s * x + c * y) for x, y in square)

    def cells_under(self, other: "Marker") -> tuple[slice, slice] | None:
        """Rows and columns of the cells of this code on which another marker lies, its white included.

        They are printed white, and the other on them. None: it does not lie within the code.
        """
        (x0, y0), (x1, y1), _, (x3, y3) = self.square_pad_m()
        per_m = self.cells / self.side_m**2
        right, down = np.array((x1 - x0, y1 - y0)) * per_m, np.array((x3 - x0, y3 - y0)) * per_m
        corners = np.array(other.square_pad_m(other.quiet_m)) - (x0, y0)
        spans = []
        for across in (corners @ down, corners @ right):
            low, high = float(across.min()) + EXACT_CELLS, float(across.max()) - EXACT_CELLS
            if low < 1.0 or high > self.cells - 1.0:
                return None
            spans.append(slice(math.floor(low), math.ceil(high)))
        rows, columns = spans
        return rows, columns

    def corners_pad_m(self) -> FloatArray:
        """Corners (4, 3) in the pad frame (m), in OpenCV's order."""
        return np.array([(x, y, 0.0) for x, y in self.square_pad_m()])
