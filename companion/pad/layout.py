"""A landing pad: its board, its markers and the sheet that it is printed on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import Field, model_validator

from companion.base.geometry import FloatArray
from companion.config import ConfigError, StrictModel, find_file, load_model
from companion.pad.marker import Marker
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
