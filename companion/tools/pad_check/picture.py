"""The live picture: what the camera shows, with what the app takes for forward, right and the pad."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray, Vector3, matrix_from_quat
from companion.base.messages import Frame, PadSighting
from companion.pad import Pad
from companion.sense.vision.pipeline import Vision
from companion.tools.pad_check.wizard import Wizard

ARROW_SHARE: Final = 0.2  # of the distance to the pad
# blue, green, red
_FORWARD, _RIGHT, _PAD, _ASKED, _TEXT = (
    (80, 220, 80),
    (60, 60, 255),
    (255, 180, 0),
    (0, 255, 255),
    (255, 255, 255),
)
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
Colour = tuple[int, int, int]


def draw(
    frame: Frame, sighting: PadSighting | None, vision: Vision, pad: Pad, wizard: Wizard
) -> NDArray[np.uint8]:
    """The frame in colour (h, w, 3) with the pad's outline, the body's axes and the order."""
    image = cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR)
    origin: FloatArray = np.array((0.0, 0.0, 1.0))
    if sighting is not None:
        origin = np.array(sighting.pad_position_body_m)
        outline = vision.pixels(origin + _board(pad) @ matrix_from_quat(sighting.body_from_pad).T)
        if np.isfinite(outline).all():
            cv2.polylines(image, [np.rint(outline).astype(np.int32)], True, _PAD, 2)
    length_m = ARROW_SHARE * float(origin[2])
    if wizard.axis is not None and wizard.axis[0] == "shift":
        forward, right, down = (2.0 * length_m * share for share in wizard.axis[1])
        _arrow(image, vision, origin, (forward, right, down), _ASKED, "move")
    _arrow(image, vision, origin, (length_m, 0.0, 0.0), _FORWARD, "forward")
    _arrow(image, vision, origin, (0.0, length_m, 0.0), _RIGHT, "right")
    text = wizard.order.replace("°", " deg")
    cv2.rectangle(image, (0, 0), (image.shape[1], 26), (0, 0, 0), cv2.FILLED)
    cv2.putText(image, text, (6, 18), _FONT, 0.45, _TEXT, 1, cv2.LINE_AA)
    return np.asarray(image, dtype=np.uint8)


def _board(pad: Pad) -> FloatArray:
    """The board's corners (4, 3) in the pad's axes (m)."""
    length, width = 0.5 * pad.length_m, 0.5 * pad.width_m
    return np.array(
        [(length, -width, 0.0), (length, width, 0.0), (-length, width, 0.0), (-length, -width, 0.0)]
    )


def _arrow(image: Any, vision: Vision, origin: FloatArray, along: Vector3, colour: Colour, name: str) -> None:
    """An arrow from a point along a vector, both in body axes, where the lens sees them."""
    ends = vision.pixels(np.array((origin, origin + along)))
    if not np.isfinite(ends).all():
        return
    (x0, y0), (x1, y1) = np.rint(ends).astype(int).tolist()
    cv2.arrowedLine(image, (x0, y0), (x1, y1), colour, 2, cv2.LINE_AA, tipLength=0.2)
    cv2.putText(image, name, (x1 + 4, y1 + 4), _FONT, 0.5, colour, 1, cv2.LINE_AA)
