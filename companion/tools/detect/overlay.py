"""The overlay: the markers with their ids, the pad's outline and axes, and what is stated, on the picture."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.pad import Pad, colours
from companion.sense.vision.lens import Lens
from companion.tools.detect.finder import Found, PadView

# blue, green, red
GROUP_COLOURS: Final = {group: colours.bgr(colour) for group, colour in colours.GROUP_COLOURS.items()}
UNUSED: Final = (40, 40, 220)
OUTLINE: Final = (255, 180, 0)
AXES: Final = (("front", (60, 60, 255)), ("right", (80, 220, 80)), ("up", (255, 120, 60)))
WHITE: Final = (255, 255, 255)
FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
# lines and text are drawn for an image of this width
DESIGN_WIDTH_PX: Final = 960
LEAST_TEXT: Final = 0.45
AXIS_SHARE: Final = 0.35  # of the pad's shorter side, or of the distance to it
SIDE_POINTS: Final = 16  # a lens bends the board's sides
SHIFT: Final = 4  # sub-pixel bits of OpenCV's drawing


def draw(image: NDArray[np.uint8], found: Found, pad: Pad, lens: Lens, text: str) -> NDArray[np.uint8]:
    """A colour picture (height, width, 3) of a grey one with what was found, and a line of text below."""
    picture: Any = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    unit = max(image.shape[1] / DESIGN_WIDTH_PX, 0.4)
    width = max(2, round(2 * unit))
    for detection in found.markers:
        colour = UNUSED if found.view is None else GROUP_COLOURS[detection.marker.group]
        _lines(picture, detection.corners_px, colour, width, closed=True)
        _mark(picture, detection.corners_px[0], colour, unit)
        above = detection.corners_px.min(axis=0) - (0.0, 9.0 * unit)
        above[0] = detection.corners_px[:, 0].mean()
        _write(picture, str(detection.marker.id), above, colour, max(0.6 * unit, LEAST_TEXT))
    if found.view is not None:
        _lines(picture, _seen(lens, found.view, board_outline(pad)), OUTLINE, width, closed=True)
        length_m = AXIS_SHARE * min(pad.length_m, pad.width_m, found.view.distance_m)
        _draw_axes(picture, lens, found.view, length_m, unit)
    bar = round(28 * unit)
    strip = np.zeros((bar, picture.shape[1], 3), np.uint8)
    cv2.putText(strip, text, (round(8 * unit), bar - round(9 * unit)), FONT, 0.5 * unit, WHITE,
                max(1, round(unit)), cv2.LINE_AA)  # fmt: skip
    return np.vstack((picture, strip)).astype(np.uint8)


def board_outline(pad: Pad) -> FloatArray:
    """Points (n, 3) along the board's edge, in pad axes (m)."""
    x, y = 0.5 * pad.length_m, 0.5 * pad.width_m
    corners = np.array([(x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0), (-x, -y, 0.0)])
    share = np.arange(SIDE_POINTS)[None, :, None] / SIDE_POINTS
    sides = corners[:, None] + share * (np.roll(corners, -1, axis=0) - corners)[:, None]
    return np.asarray(sides.reshape(-1, 3))


def _seen(lens: Lens, view: PadView, points_pad_m: FloatArray) -> FloatArray:
    """Pixels (n, 2) of points on the pad, NaN where the lens cannot see."""
    return lens.project(points_pad_m @ view.camera_from_pad.T + view.position_m)[0]


def _draw_axes(picture: Any, lens: Lens, view: PadView, length_m: float, unit: float) -> None:
    # the pad's z axis goes into the ground
    ends = np.diag((length_m, length_m, -length_m))
    pixels = _seen(lens, view, np.vstack((np.zeros(3), ends)))
    for end, (name, colour) in zip(pixels[1:], AXES, strict=True):
        if np.isfinite((pixels[0], end)).all():
            start, tip = _fixed(pixels[0]), _fixed(end)
            width = max(2, round(2 * unit))
            cv2.arrowedLine(picture, start, tip, colour, width, cv2.LINE_AA, shift=SHIFT, tipLength=0.12)
            _write(picture, name, end, colour, max(0.5 * unit, LEAST_TEXT))


def _lines(
    picture: Any, pixels: FloatArray, colour: tuple[int, int, int], width: int, *, closed: bool
) -> None:
    whole = np.isfinite(pixels).all()
    points = pixels if whole else pixels[np.isfinite(pixels).all(axis=1)]
    if len(points) > 1:
        fixed = np.rint(points * (1 << SHIFT)).astype(np.int32)
        cv2.polylines(picture, [fixed], bool(closed and whole), colour, width, cv2.LINE_AA, shift=SHIFT)


def _mark(picture: Any, pixel: FloatArray, colour: tuple[int, int, int], unit: float) -> None:
    """A dot at a marker's first corner: top left of its code."""
    cv2.circle(picture, _fixed(pixel), round(4 * unit * (1 << SHIFT)), colour, -1, cv2.LINE_AA, shift=SHIFT)


def _fixed(pixel: FloatArray) -> tuple[int, int]:
    u, v = np.rint(pixel * (1 << SHIFT)).astype(int).tolist()
    return u, v


def _write(picture: Any, text: str, pixel: FloatArray, colour: tuple[int, int, int], scale: float) -> None:
    """Text about a pixel, on a dark edge so that it can be read on black and on white."""
    thick = max(1, round(2 * scale))
    (width, height), _ = cv2.getTextSize(text, FONT, scale, thick)
    at = (round(float(pixel[0]) - 0.5 * width), round(float(pixel[1]) + 0.5 * height))
    cv2.putText(picture, text, at, FONT, scale, (0, 0, 0), thick + 2, cv2.LINE_AA)
    cv2.putText(picture, text, at, FONT, scale, colour, thick, cv2.LINE_AA)
