"""Captures views from a live camera: looks at the newest frame, keeps what is of use, stops by itself.

The only part of camera calibration with a loop in it; what is kept is decided in `capture`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.board.board import CalibrationBoard
from calibration.camera.collect.capture import CaptureSession
from calibration.camera.collect.overlay import draw
from calibration.camera.kinds import Model
from calibration.camera.solve.adjustment import UnsolvableError
from calibration.camera.solve.quality import assess
from calibration.camera.views.detection import BoardFinder, BoardView
from companion.base.files import write_atomically
from companion.base.formats.mjpeg import MjpegServer
from companion.config import CaptureConfig, ConfigError
from companion.sense.camera.source import FrameSource, open_camera

OVERLAY_PERIOD_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """How to capture. `keep` and `overlay` are where frames and the overlay's picture go, if anywhere."""

    source: str
    capture: CaptureConfig
    most_views: int
    model: Model
    keep: Path | None = None
    overlay: Path | None = None
    serve_port: int | None = None


async def capture_live(
    board: CalibrationBoard, options: LiveOptions, tell: Callable[[str], None]
) -> CaptureSession:
    """Capture until the views calibrate the camera, or there are as many as wanted.

    `tell` gets a line whenever there is something new to say.

    Raises:
        ConfigError: no such camera, images of another size, the camera went away, or a port or folder that
            cannot be used.
    """
    source = await open_camera(options.source, options.capture)
    server = MjpegServer()
    try:
        if options.serve_port is not None:
            try:
                port = await server.start(options.serve_port)
            except OSError as error:
                raise ConfigError(
                    f"--serve {options.serve_port}: {error.strerror}; expected a free port, or 0 for any"
                ) from error
            tell(f"live picture: http://127.0.0.1:{port}/")
        for note in source.take_notes():
            tell(f"camera: {note}")
        capture = _Capture(board, options, server, tell)
        await capture.run(source)
        return capture.session
    except OSError as error:
        raise ConfigError(f"{options.source}: {error}") from error
    finally:
        source.close()
        await server.close()


class _Capture:
    """One run of it."""

    def __init__(
        self, board: CalibrationBoard, options: LiveOptions, server: MjpegServer, tell: Callable[[str], None]
    ) -> None:
        size = (options.capture.width_px, options.capture.height_px)
        self.session = CaptureSession(size)
        self._finder = BoardFinder(board)
        self._board = board
        self._options = options
        self._server = server
        self._tell = tell
        self._reported = ""
        self._overlay_s = float("-inf")

    async def run(self, source: FrameSource) -> None:
        while len(self.session.views) < self._options.most_views:
            frame = await source.next()
            name = f"view-{len(self.session.views) + 1:04d}.png"
            view = await asyncio.to_thread(self._finder.find, frame.image, name)
            step = self.session.step(frame.time_s, view)
            self._say(step.text)
            await self._show(frame.image, view, step.text, frame.time_s)
            if not step.kept:
                continue
            if self._options.keep is not None:
                await asyncio.to_thread(write_image, self._options.keep / name, frame.image)
            if self.session.complete and await self._is_good():
                break

    async def _is_good(self) -> bool:
        """Whether the views calibrate the camera; if not, why is reported, and more are taken."""
        board, size = self._board, self.session.size_px
        try:
            found = await asyncio.to_thread(
                assess, list(self.session.views), size, board.surface, self._options.model
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
        file_due = self._options.overlay is not None and time_s - self._overlay_s >= OVERLAY_PERIOD_S
        if not file_due and self._server.viewer_count == 0:
            return
        picture = await asyncio.to_thread(draw, image, self.session, view, text)
        self._server.show(picture)
        if file_due and self._options.overlay is not None:
            self._overlay_s = time_s
            await asyncio.to_thread(write_image, self._options.overlay, picture)


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Write a picture whole, in the format that the name's ending says.

    Raises:
        ConfigError: it cannot be written.
    """
    try:
        good, data = cv2.imencode(path.suffix or ".png", image)
    except cv2.error as error:
        raise ConfigError(f"{path}: expected a name that ends in .png or .jpg") from error
    write_atomically(path, data.tobytes() if good else b"")
