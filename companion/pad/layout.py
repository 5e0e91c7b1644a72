"""A landing pad: its board, its markers and the sheet that it is printed on."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from companion.base.geometry import FloatArray
from companion.config import ConfigError, StrictModel, find_file, load_model
from companion.pad.landing_target import is_landing_target, pad_of
from companion.pad.marker import Marker, dictionary_named
from companion.pad.rules import extent, impossible, unfit
from companion.pad.sheet import Sheet, Tiling, tile


class Pad(StrictModel):
    """A landing pad: a board with markers of several sizes."""

    name: str
    """Name of the pad"""
    width_m: float = Field(gt=0.05, le=10.0)
    """Board width, across its heading"""
    length_m: float = Field(gt=0.05, le=10.0)
    """Board length, along its heading"""
    sheet: Sheet = Sheet()
    markers: tuple[Marker, ...] = Field(min_length=1)
    """List of the markers"""

    @model_validator(mode="before")
    @classmethod
    def _grouped_by_size(cls, data: Any) -> Any:
        """Markers without a group get one by their size: nearest to the largest, the smallest or between.

        The file may be another project's `landing-target.json`.
        """
        data = pad_of(data) if is_landing_target(data) else data
        given = data.get("markers") if isinstance(data, dict) else None
        if not isinstance(given, (list, tuple)) or not given or not all(isinstance(m, dict) for m in given):
            return data
        sides = [m.get("side_m") for m in given]
        if not all(isinstance(side, (int, float)) and side > 0.0 for side in sides):
            return data  # which is told of where it stands
        steps = np.unique(np.log(np.array(sides, dtype=float)))
        least, span = float(steps[0]), float(steps[-1] - steps[0])
        shares = [1.0 if span == 0.0 else (math.log(side) - least) / span for side in sides]
        groups = ["F" if share > 2.0 / 3.0 else "M" if share > 1.0 / 3.0 else "C" for share in shares]
        marked = [{"group": group, **m} for group, m in zip(groups, given, strict=True)]
        return {**data, "markers": marked}

    @model_validator(mode="after")
    def _can_be(self) -> Pad:
        wrong = impossible(self)
        if wrong is not None:
            raise ValueError(wrong)
        return self

    def corners_pad_m(self) -> FloatArray:
        """The board's corners (4, 3) in pad axes (m), from the front left clockwise seen from above."""
        x, y = 0.5 * self.length_m, 0.5 * self.width_m
        return np.array([(x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0), (-x, -y, 0.0)])

    def printed(self, marker: Marker) -> NDArray[np.uint8]:
        """A marker's cells as OpenCV draws them (0 or 255), white where another one is nested in it."""
        dictionary = dictionary_named(marker.dictionary)
        image = np.array(cv2.aruco.generateImageMarker(dictionary, marker.id, marker.cells), dtype=np.uint8)
        for other in self.markers:
            if other.side_m < marker.side_m and (under := marker.cells_under(other)) is not None:
                image[under] = 255
        return image

    def tiling(self) -> Tiling:
        """Where the board is cut into sheets.

        Raises:
            ValueError: the sheet has no room for it (a loaded pad has been checked for that).
        """
        extents = [extent(marker.square_pad_m()) for marker in self.markers]
        made = tile(self.sheet, (self.length_m, self.width_m), extents)
        if made is None:
            raise ValueError(unfit(self))
        return made


def load_pad(name: str | Path) -> Pad:
    """Read a pad by name (from configs/pads) or path, and check that it can be printed and read.

    Raises:
        ConfigError: the file is missing, not YAML, or breaks a rule; one line names the markers.
    """
    path = find_file("pads", name)
    return checked(load_model(Pad, path), str(path))


def checked(pad: Pad, source: str) -> Pad:
    """The pad, if it can be printed on its sheet and read from the air.

    Raises:
        ConfigError: it cannot; one line with the source and the markers.
    """
    wrong = unfit(pad)
    if wrong is not None:
        raise ConfigError(f"{source}: {wrong}")
    return pad
