"""The live picture: the board's corners, what of the image and of the tilts is missing, and the next hint."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.collect.capture import CaptureSession
from calibration.camera.views.coverage import COLUMNS, ROWS, TILTS, VIEWS_A_TILT
from calibration.camera.views.detection import BoardView

# blue, green, red
MISSING: Final = (40, 40, 200)
DONE: Final = (80, 200, 80)
SEEN: Final = (40, 220, 255)
WHITE: Final = (255, 255, 255)
TINT: Final = 0.25
# text and lines are drawn for an image of this width
DESIGN_WIDTH_PX: Final = 960


def draw(
    image: NDArray[np.uint8], session: CaptureSession, view: BoardView | None, text: str
) -> NDArray[np.uint8]:
    """A colour picture (height, width, 3) of a grey frame with what is to be known over it."""
    picture: Any = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    height, width = image.shape
    unit = width / DESIGN_WIDTH_PX
    _tint_missing(picture, session)
    for kept in session.views:
        for u, v in np.rint(kept.corners_px).astype(int).tolist():
            cv2.circle(picture, (u, v), max(1, round(unit)), DONE, -1)
    if view is not None:
        for u, v in np.rint(view.corners_px).astype(int).tolist():
            cv2.circle(picture, (u, v), max(2, round(5 * unit)), SEEN, max(1, round(1.5 * unit)), cv2.LINE_AA)
    _tilt_marks(picture, session, unit)
    bar = round(30 * unit)
    cv2.rectangle(picture, (0, height - bar), (width, height), (0, 0, 0), -1)
    status = f"{len(session.views)} views, {100 * session.coverage.share:.0f} % seen: {text}"
    at = (round(8 * unit), height - round(9 * unit))
    cv2.putText(
        picture, status, at, cv2.FONT_HERSHEY_SIMPLEX, 0.6 * unit, WHITE, max(1, round(unit)), cv2.LINE_AA
    )
    return np.asarray(picture, dtype=np.uint8)


def _tint_missing(picture: Any, session: CaptureSession) -> None:
    """Redden the cells where no board has been."""
    height, width = picture.shape[:2]
    for row, column in np.argwhere(~session.coverage.covered).tolist():
        top, bottom = (round(height * r / ROWS) for r in (row, row + 1))
        left, right = (round(width * c / COLUMNS) for c in (column, column + 1))
        cell = picture[top:bottom, left:right]
        cell[:] = (1.0 - TINT) * cell + TINT * np.array(MISSING)


def _tilt_marks(picture: Any, session: CaptureSession, unit: float) -> None:
    """A word at each edge of the image: the board's edges that have been away, and those that have not."""
    height, width = picture.shape[:2]
    places = {"top": (0.5, 0.06), "bottom": (0.5, 0.9), "left": (0.03, 0.5), "right": (0.84, 0.5)}
    for name in TILTS:
        done = session.coverage.tilt_count(name) >= VIEWS_A_TILT
        words = f"{name} away {min(session.coverage.tilt_count(name), VIEWS_A_TILT)}/{VIEWS_A_TILT}"
        x, y = places[name]
        at = (round(x * width), round(y * height))
        size, _ = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, 0.55 * unit, max(1, round(unit)))
        pad = round(4 * unit)
        box = (at[0] - pad, at[1] - size[1] - pad), (at[0] + size[0] + pad, at[1] + pad)
        cv2.rectangle(picture, *box, (0, 0, 0), -1)
        colour = DONE if done else SEEN
        cv2.putText(
            picture,
            words,
            at,
            cv2.FONT_HERSHEY_SIMPLEX,
            0.55 * unit,
            colour,
            max(1, round(unit)),
            cv2.LINE_AA,
        )
