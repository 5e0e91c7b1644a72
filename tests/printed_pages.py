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
