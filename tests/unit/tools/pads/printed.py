"""What is on a printed page, read from the file itself: its size, black shapes and lines, in millimetres.

Lower left corner of the page is the origin, y up.
"""

import re
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.pad import DICTIONARIES, Marker, Pad
from companion.tools.pads.printing import Tile

MM_PER_POINT = 25.4 / 72.0
PX_PER_MM = 6.0
# OpenCV fills a polygon half a pixel too far
FINER = 3


@dataclass(frozen=True)
class Printed:
    """One page: width and height, filled polygons, and lines."""

    size_mm: tuple[float, float]
    filled: list[FloatArray]
    lines: list[FloatArray]

    def picture(self) -> NDArray[np.uint8]:
        """The black shapes alone, `PX_PER_MM` pixels a millimetre."""
        width, height = (round(side * PX_PER_MM) for side in self.size_mm)
        image = np.full((FINER * height, FINER * width), 255, np.uint8)
        for corners in self.filled:
            # edges lie between pixels, whose centres are whole numbers; 4 bits of fraction
            pixels = (
                np.column_stack((corners[:, 0], self.size_mm[1] - corners[:, 1])) * FINER * PX_PER_MM - 0.5
            )
            cv2.fillPoly(image, [np.rint(16.0 * pixels).astype(np.int32)], (0,), shift=4)
        return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def read_pdf(path: Path) -> list[Printed]:
    """The pages of a PDF of ours."""
    data = path.read_bytes()
    boxes = [tuple(map(float, box)) for box in re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", data)]
    streams = [_inflated(s) for s in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.DOTALL)]
    pages = [text.decode("latin-1") for text in streams if b" l\n" in text and b" m\n" in text]
    # glyphs are drawn by streams of their own, which begin with their box
    pages = [text for text in pages if " d1" not in text[:200]]
    return [
        _page(text, w * MM_PER_POINT, h * MM_PER_POINT) for text, (w, h) in zip(pages, boxes, strict=True)
    ]


def read_svg(path: Path) -> Printed:
    """The one page of an SVG of ours."""
    text = path.read_text(encoding="utf-8")
    size = re.search(r'<svg [^>]*?width="([\d.]+)pt" height="([\d.]+)pt"', text)
    assert size is not None
    width, height = (float(n) * MM_PER_POINT for n in size.groups())
    # without a style it is black
    paths = re.findall(r'<path d="([^"]+)"(?:[^>]*?style="([^"]*)")?', text)
    paths = [p for p in paths if "Q" not in p[0]]
    found: dict[bool, list[FloatArray]] = {True: [], False: []}
    for outline, style in paths:
        for part in filter(str.strip, outline.split("M")):
            points = np.array(re.findall(r"([-\d.]+) ([-\d.]+)", part), dtype=float) * MM_PER_POINT
            points[:, 1] = height - points[:, 1]
            found["fill: none" not in style].append(points)
    return Printed((width, height), _on_white(found[True], width), found[False])


def _page(text: str, width_mm: float, height_mm: float) -> Printed:
    filled, lines, points = list[FloatArray](), list[FloatArray](), list[list[tuple[float, float]]]()
    for x, y, kind, end in re.findall(
        r"([-\d.]+) ([-\d.]+) ([ml])\n|^(f|S|s|b|B|n|W n)$", text, re.MULTILINE
    ):
        if kind == "m":
            points.append([])
        if kind:
            points[-1].append((float(x) * MM_PER_POINT, float(y) * MM_PER_POINT))
        elif end:
            shapes = [np.array(shape) for shape in points]
            (filled if end in {"f", "b", "B"} else lines if end in {"S", "s"} else []).extend(shapes)
            points = []
    return Printed((width_mm, height_mm), _on_white(filled, width_mm), lines)


def _on_white(filled: list[FloatArray], width_mm: float) -> list[FloatArray]:
    """Without the page's own white."""
    return [shape for shape in filled if np.ptp(shape[:, 0]) < 0.999 * width_mm]


def _inflated(stream: bytes) -> bytes:
    try:
        return zlib.decompress(stream)
    except zlib.error:
        return b""


def assembled(pages: list[Printed], sheets: list[Tile], pad: Pad) -> NDArray[np.uint8]:
    """The board: each sheet cut at its marks and laid in its place."""
    board = np.full(
        (round(1e3 * pad.length_m * PX_PER_MM), round(1e3 * pad.width_m * PX_PER_MM)), 128, np.uint8
    )
    for page, sheet in zip(pages, sheets, strict=False):
        (left, bottom), (width, height) = sheet.corner_mm, sheet.size_mm
        x, y = left * PX_PER_MM, (page.size_mm[1] - bottom - height) * PX_PER_MM
        size = (round(width * PX_PER_MM), round(height * PX_PER_MM))
        # a cut is where it is, not at a whole pixel
        centre = (x + 0.5 * (size[0] - 1), y + 0.5 * (size[1] - 1))
        piece = cv2.getRectSubPix(page.picture(), size, centre)
        top = round(1e3 * (0.5 * pad.length_m - sheet.along_m[1]) * PX_PER_MM)
        first = round(1e3 * (sheet.across_m[0] + 0.5 * pad.width_m) * PX_PER_MM)
        board[top : top + size[1], first : first + size[0]] = piece
    return board


def read_markers(image: NDArray[np.uint8]) -> dict[tuple[str, int], FloatArray]:
    """Every marker that OpenCV reads: corners (4, 2) in pixels."""
    found: dict[tuple[str, int], FloatArray] = {}
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.minMarkerPerimeterRate = 0.01
    parameters.adaptiveThreshWinSizeMax = 53
    for name, number in DICTIONARIES.items():
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(number), parameters)
        quads, ids, _ = detector.detectMarkers(image)
        for quad, identity in zip(quads, np.ravel(ids) if ids is not None else [], strict=True):
            found[name, int(identity)] = np.asarray(quad, dtype=float).reshape(4, 2)
    return found


def worst_miss_mm(
    found: dict[tuple[str, int], FloatArray],
    markers: tuple[Marker, ...],
    middle_px: tuple[float, float],
    px_per_mm: float,
) -> float:
    """How far corners are from where the pad has them; infinite when a marker is missing.

    `middle_px` is where the board's middle is in the image.
    """
    worst = 0.0
    for marker in markers:
        corners = found.get((marker.dictionary, marker.id))
        if corners is None:
            return float("inf")
        x, y = 1e3 * marker.corners_pad_m()[:, :2].T
        expected = np.column_stack((middle_px[0] + px_per_mm * y, middle_px[1] - px_per_mm * x))
        worst = max(worst, float(np.linalg.norm(corners - expected, axis=1).max()) / px_per_mm)
    return worst
