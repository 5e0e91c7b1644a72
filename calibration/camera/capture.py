"""Which frames of a moving picture are worth keeping: sharp, still, and of something not yet seen. Pure."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera import Model
from calibration.camera.board import CalibrationBoard
from calibration.camera.quality import assess
from calibration.camera.solver import UnsolvableError
from calibration.camera.views import (
    COLUMNS,
    ROWS,
    TILTS,
    VIEWS_A_TILT,
    BoardFinder,
    BoardView,
    ImageCoverage,
    distance_px,
)
from companion.base.files import write_atomically
from companion.base.formats.mjpeg import MjpegServer, serving
from companion.config import CaptureConfig, ConfigError, without_password
from companion.sense.camera.source import FrameSource, open_camera

# an edge wider than this is blurred, unless this lens makes no sharper ones
SHARP_EDGE_PX: Final = 3.5
SHARP_RATIO: Final = 1.25
# in image widths a second. A rolling shutter of 20 ms shears what moves so fast by 0.4 px of 1280
STILL_SHARE_S: Final = 0.015
# the board has to be still for this long, and has not to have been out of sight for longer
STILL_S: Final = 0.1
FORGOTTEN_S: Final = 0.5
# views whose corners are on average so near in the image (of its width) are the same view
SAME_SHARE: Final = 0.06


@dataclass(frozen=True, slots=True)
class CaptureStep:
    """What came of one frame: whether it was kept, and what to tell whoever holds the board."""

    kept: bool
    text: str


class CaptureSession:
    """Chooses frames. Time is given; nothing is read from a clock."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.size_px = size_px
        self.coverage = ImageCoverage(size_px)
        self.views: list[BoardView] = []
        self._last: tuple[float, BoardView] | None = None
        self._still_since_s: float | None = None
        self._sharpest_px = float("inf")

    def step(self, time_s: float, view: BoardView | None) -> CaptureStep:
        """Take one frame's view of the board (None: not found), at its time."""
        if view is None:
            self._last = self._still_since_s = None
            return CaptureStep(False, "no board in sight")
        still_s = self._still_for(time_s, view)
        self._last = (time_s, view)
        self._sharpest_px = min(self._sharpest_px, view.edge_px)
        if view.edge_px > max(SHARP_EDGE_PX, SHARP_RATIO * self._sharpest_px):
            return CaptureStep(False, "blurred: hold it still, in more light or farther off")
        if still_s < STILL_S:
            return CaptureStep(False, "hold it still")
        if not self._is_new(view):
            return CaptureStep(False, self.hint())
        self.views.append(view)
        self.coverage.add(view)
        self._still_since_s = None
        return CaptureStep(True, f"view {len(self.views)} kept; {self.hint()}")

    def hint(self) -> str:
        hints = self.coverage.hints()
        return hints[0] if hints else "all has been seen"

    def _still_for(self, time_s: float, view: BoardView) -> float:
        if self._last is None or not 0.0 < time_s - self._last[0] < FORGOTTEN_S:
            self._still_since_s = None
            return 0.0
        moved = distance_px(view, self._last[1])
        if moved is None or moved > STILL_SHARE_S * self.size_px[0] * (time_s - self._last[0]):
            self._still_since_s = None
            return 0.0
        if self._still_since_s is None:
            self._still_since_s = self._last[0]
        return time_s - self._still_since_s

    def _is_new(self, view: BoardView) -> bool:
        distances = [distance_px(view, old) for old in self.views]
        near = [d for d in distances if d is not None and d < SAME_SHARE * self.size_px[0]]
        return not near or self.coverage.brings_something(view)


# ---------------------------------------------------------------- live
# Captures views from a live camera: looks at the newest frame, keeps what is of use, stops by itself.
#
# The only part of camera calibration with a loop in it; what is kept is decided in `capture`.

OVERLAY_PERIOD_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class CameraCalibrationJob:
    """One run: where views come from, the distortion model, and where the results go.

    `capture` is how the camera takes images, which all goes into its file; `sized`: their size was named.
    """

    sources: Sequence[str]
    capture: CaptureConfig
    sized: bool
    model: Model
    most_views: int
    output: Path
    keep: Path | None
    overlay: Path | None
    serve_port: int | None
    plots: Path | None
    force: bool


async def capture_live(
    board: CalibrationBoard, job: CameraCalibrationJob, tell: Callable[[str], None]
) -> CaptureSession:
    """Capture until the views calibrate the camera, or there are as many as wanted.

    `tell` gets a line whenever there is something new to say.

    Raises:
        ConfigError: no such camera, images of another size, the camera went away, or a port or folder that
            cannot be used.
    """
    camera = job.sources[0]
    source = await open_camera(camera, job.capture)
    try:
        async with serving(job.serve_port, tell) as server:
            for note in source.take_notes():
                tell(f"camera: {note}")
            capture = _Capture(board, job, server, tell)
            await capture.run(source)
            return capture.session
    except OSError as error:
        raise ConfigError(f"{without_password(camera)}: {error}") from error
    finally:
        source.close()


class _Capture:
    """One run of it."""

    def __init__(
        self,
        board: CalibrationBoard,
        job: CameraCalibrationJob,
        server: MjpegServer,
        tell: Callable[[str], None],
    ) -> None:
        size = (job.capture.width_px, job.capture.height_px)
        self.session = CaptureSession(size)
        self._finder = BoardFinder(board)
        self._board = board
        self._job = job
        self._server = server
        self._tell = tell
        self._reported = ""
        self._overlay_s = float("-inf")

    async def run(self, source: FrameSource) -> None:
        while len(self.session.views) < self._job.most_views:
            frame = await source.next()
            name = f"view-{len(self.session.views) + 1:04d}.png"
            view = await asyncio.to_thread(self._finder.find, frame.image, name)
            step = self.session.step(frame.time_s, view)
            self._say(step.text)
            await self._show(frame.image, view, step.text, frame.time_s)
            if not step.kept:
                continue
            if self._job.keep is not None:
                await asyncio.to_thread(write_image, self._job.keep / name, frame.image)
            if self.session.coverage.complete and await self._is_good():
                break

    async def _is_good(self) -> bool:
        """Whether the views calibrate the camera; if not, why is reported, and more are taken."""
        board, size = self._board, self.session.size_px
        try:
            found = await asyncio.to_thread(
                assess, list(self.session.views), size, board.surface, self._job.model
            )
        except UnsolvableError as error:
            self._say(f"more views, please: {error}")
            return False
        if found.reasons:
            self._say(f"more views, please: {found.reasons[0]}")
        return not found.reasons

    def _say(self, text: str) -> None:
        if text != self._reported:
            self._reported = text
            self._tell(text)

    async def _show(self, image: NDArray[np.uint8], view: BoardView | None, text: str, time_s: float) -> None:
        file_due = self._job.overlay is not None and time_s - self._overlay_s >= OVERLAY_PERIOD_S
        if not file_due and self._server.viewer_count == 0:
            return
        picture = await asyncio.to_thread(draw, image, self.session, view, text)
        self._server.show(picture)
        if file_due and self._job.overlay is not None:
            self._overlay_s = time_s
            await asyncio.to_thread(write_image, self._job.overlay, picture)


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Write a picture whole, in the format that the name's ending says."""
    try:
        good, data = cv2.imencode(path.suffix or ".png", image)
    except cv2.error as error:
        raise ConfigError(f"{path}: expected a name that ends in .png or .jpg") from error
    write_atomically(path, data.tobytes() if good else b"")


# ---------------------------------------------------------------- overlay

# blue, green, red
MISSING: Final = (40, 40, 200)
DONE: Final = (80, 200, 80)
SEEN: Final = (40, 220, 255)
WHITE: Final = (255, 255, 255)
TINT: Final = 0.25
# text and lines are drawn for an image of this width
DESIGN_WIDTH_PX: Final = 960
FONT: Final = cv2.FONT_HERSHEY_SIMPLEX


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
    cv2.putText(picture, status, at, FONT, 0.6 * unit, WHITE, max(1, round(unit)), cv2.LINE_AA)
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
        scale, thick = 0.55 * unit, max(1, round(unit))
        size, _ = cv2.getTextSize(words, FONT, scale, thick)
        pad = round(4 * unit)
        box = (at[0] - pad, at[1] - size[1] - pad), (at[0] + size[0] + pad, at[1] + pad)
        cv2.rectangle(picture, *box, (0, 0, 0), -1)
        colour = DONE if done else SEEN
        cv2.putText(picture, words, at, FONT, scale, colour, thick, cv2.LINE_AA)
