"""Real photographs with reference corners: OpenCV's own tutorial pictures (gold_corners.json: photo, id,
corners).

Each photo is read as the app reads a frame of the whole pad, with every code of its dictionary allowed, so
that a false marker can be found. Photos of the marker grid (gb...) show the dictionary that lies beside them;
the others OpenCV's 6X6_250. As in OpenCV's own test, each coordinate counts for itself. The references are
the outermost dark pixels, as contours have them, and the contours' corners that the app starts from are
judged by them; the border that they mean runs half a pixel further out, and what the app refines the corners
to is measured against that.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from rich.table import Table

from companion.base.geometry import FloatArray
from companion.config import VisionConfig
from companion.sense.vision.aruco import CodeReader
from companion.sense.vision.corners import refine_quads

REFERENCES: Final = "gold_corners.json"
OWN_DICTIONARY: Final = ("gb", "tutorial_dict.yml")
CORNER_PX: Final = 1.0


@dataclass(frozen=True)
class PhotoErrors:
    """What was found in one: ids missed, false ones, and the errors of the others.

    `errors_px` (n, 4, 2) are the contours' corners less the references, which are contours' corners too;
    `border_errors_px` what the pose is made of, the refined corners, less the borders that these mean.
    """

    name: str
    printed: int
    errors_px: FloatArray
    border_errors_px: FloatArray
    missed: tuple[int, ...]
    false: tuple[int, ...]

    @property
    def worst_px(self) -> float:
        """The largest coordinate's error; infinite when nothing was found."""
        return float(np.abs(self.errors_px).max()) if len(self.errors_px) else float("inf")

    @property
    def holds(self) -> bool:
        """Whether all markers were found and no other, each corner where it is."""
        return not self.missed and not self.false and self.worst_px <= CORNER_PX


def read_photos(folder: Path) -> list[PhotoErrors]:
    """All photos that have references.

    Raises:
        OSError: a file is missing, or is no picture.
    """
    references = json.loads((folder / REFERENCES).read_text(encoding="utf-8"))
    return [
        _read(folder / name, {int(k): np.array(c) for k, c in of.items()}) for name, of in references.items()
    ]


def _read(path: Path, printed: dict[int, FloatArray]) -> PhotoErrors:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise OSError(f"{path}: not a picture")
    dictionary = _dictionary(path)
    count = len(dictionary.bytesList)
    grey = np.asarray(image, dtype=np.uint8)
    codes = CodeReader([dictionary], [(0, k) for k in range(count)]).read(
        grey, VisionConfig().minimum_side_px
    )
    contours: FloatArray = np.array([code.corners_px for code in codes]).reshape(-1, 4, 2)
    refined = (
        refine_quads(grey, contours, np.full(len(codes), dictionary.markerSize + 2.0)).corners
        if codes
        else contours
    )
    found = {code.number: both for code, *both in zip(codes, contours, refined, strict=True)}
    right = sorted(found.keys() & printed.keys())
    errors: FloatArray = np.array([found[k][0] - printed[k] for k in right]).reshape(-1, 4, 2)
    border: FloatArray = np.array([found[k][1] - outer_border(printed[k]) for k in right]).reshape(-1, 4, 2)
    missed, false = sorted(printed.keys() - found.keys()), sorted(found.keys() - printed.keys())
    return PhotoErrors(path.name, len(printed), errors, border, tuple(missed), tuple(false))


def outer_border(corners_px: FloatArray) -> FloatArray:
    """Corners (4, 2) with each side moved outwards by half a pixel; they go round clockwise in the image."""
    along = np.roll(corners_px, -1, axis=0) - corners_px
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    out = np.stack((along[:, 1], -along[:, 0]), axis=1)
    before = np.roll(out, 1, axis=0)
    return np.asarray(corners_px + 0.5 * (out + before) / (1.0 + (out * before).sum(axis=1, keepdims=True)))


def _dictionary(path: Path) -> cv2.aruco.Dictionary:
    prefix, name = OWN_DICTIONARY
    if not path.name.startswith(prefix):
        return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    storage = cv2.FileStorage(str(path.with_name(name)), cv2.FILE_STORAGE_READ)
    dictionary = cv2.aruco.Dictionary()
    if not dictionary.readDictionary(storage.root()):
        raise OSError(f"{path.with_name(name)}: not a dictionary")
    return dictionary


def _rms(errors_px: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors_px**2))) if errors_px.size else float("nan")


def photo_table(photos: list[PhotoErrors]) -> tuple[Table, dict[str, bool]]:
    """What was found beside what is there."""
    grid = Table(title="Real photographs")
    worst = f"worst coordinate px (≤{CORNER_PX:g})"
    for heading in (
        "photo",
        "found",
        "missed",
        "false",
        "rms px",
        worst,
        "refined, to the border: rms px",
        "worst px",
    ):
        grid.add_column(heading, justify="right")
    for photo in photos:
        grid.add_row(
            photo.name,
            f"{len(photo.errors_px)} of {photo.printed}",
            " ".join(map(str, photo.missed)) or "-",
            " ".join(map(str, photo.false)) or "-",
            f"{_rms(photo.errors_px):.2f}",
            f"{photo.worst_px:.2f}{'' if photo.holds else ' ✗'}",
            f"{_rms(photo.border_errors_px):.2f}",
            f"{np.abs(photo.border_errors_px).max(initial=0.0):.2f}",
        )
    return grid, {"photographs": bool(photos) and all(photo.holds for photo in photos)}
