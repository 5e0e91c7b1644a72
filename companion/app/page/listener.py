"""In the page's process: it listens for browsers, and shows them what comes through the pipe."""

import asyncio
import json
import os
import struct
import sys
import threading
from multiprocessing.connection import Connection
from typing import Any, Final

import cv2
import numpy as np
from aiohttp import web

from companion.app.page.access import url_of
from companion.app.page.look import Look, Reply, Start, Text
from companion.app.page.server import PageServer
from companion.base.geometry import quat_conjugate, quat_rotate
from companion.base.messages import Frame
from companion.config.service import LOCALHOST
from companion.flightlog.foxglove.camera import CameraAnnotations
from companion.sense.vision.opencv import prepare_opencv

# ---------------------------------------------------------------- a frame as JPEG, and what is drawn over it
# Only the picture is compressed here; lines and words are drawn by the browser, in its own resolution.

WIDEST_PX: Final = 960
JPEG_QUALITY: Final = 70
# digits of pixels, metres
PIXEL_DIGITS: Final = 1
METRE_DIGITS: Final = 3


class Painter:
    """Makes each look into one binary message: 4 bytes of length, JSON, and JPEG where there is a picture."""

    def __init__(self, start: Start) -> None:
        self._overlay = CameraAnnotations(start.camera, start.vehicle, start.pad)
        self._start_s, self._start_unix_s = start.start_s, start.start_unix_s
        self._number = 0

    def paint(self, look: Look) -> tuple[int, bytes]:
        """The message and its number, which the page says back when it has drawn it."""
        self._number += 1
        time_s, *values = look.point
        height_m, lateral_m, altitude_m = (None if v is None else round(v, METRE_DIGITS) for v in values)
        header: dict[str, Any] = {
            "number": self._number,
            "time_s": round(time_s - self._start_s, 3),
            "phase": look.phase,
            "height_m": height_m,
            "lateral_m": lateral_m,
            "altitude_m": altitude_m,
            "touchdown_in_s": look.time_to_touchdown_s,
        }
        jpeg = b""
        if look.frame is not None:
            jpeg, scale = _jpeg(look.frame)
            header |= self._drawing(look, look.frame, scale)
        text = json.dumps(header).encode()
        return self._number, struct.pack(">I", len(text)) + text + jpeg

    def _drawing(self, look: Look, frame: Frame, scale: float) -> dict[str, Any]:
        """What belongs to the frame; pixels are those of the JPEG."""
        outlines = [] if look.sighting is None else self._overlay.outlines(look.sighting)
        return {
            "exposed_unix_ms": 1000.0 * (self._start_unix_s + frame.time_s),
            "outlines": [
                {"id": marker_id, "corners": (scale * corners_px).round(PIXEL_DIGITS).tolist()}
                for corners_px, marker_id in outlines
            ],
            "touchdown": self._touchdown(look, scale),
        }

    def _touchdown(self, look: Look, scale: float) -> list[float] | None:
        """Where the predicted touchdown is in the picture; it may lie beyond its edge."""
        if look.touchdown_ned_m is None or look.attitude is None:
            return None
        body = np.array(quat_rotate(quat_conjugate(look.attitude), look.touchdown_ned_m))
        (pixel,) = self._overlay.pixels(body[None])
        if not np.isfinite(pixel).all():
            pixel = self._overlay.beyond(body)
        place: list[float] = (scale * pixel).round(PIXEL_DIGITS).tolist()
        return place


def _jpeg(frame: Frame) -> tuple[bytes, float]:
    """A frame, no wider than a phone shows, and by how much it was scaled."""
    image = frame.image
    scale = min(1.0, WIDEST_PX / image.shape[1])
    if scale < 1.0:
        size = (round(scale * image.shape[1]), round(scale * image.shape[0]))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return jpeg.tobytes(), scale


KEEP_ALIVE_S: Final = 5.0


def serve(pipe: Connection) -> None:
    """Serve until nothing comes any more; the first that comes is the `Start`."""
    prepare_opencv()
    start: Start = pipe.recv()
    asyncio.run(_serve(pipe, start))


def say(line: dict[str, Any]) -> None:
    """A line to the app; its end of the pipe never fills, since it always reads."""
    os.write(sys.stdout.fileno(), json.dumps(line).encode() + b"\n")


async def _serve(pipe: Connection, start: Start) -> None:
    """Listen, and show what comes until nothing comes any more."""
    server, access = PageServer(start, say), start.access
    runner = web.AppRunner(
        server.application(), access_log=None, handle_signals=False, keepalive_timeout=KEEP_ALIVE_S
    )
    await runner.setup()
    loop = asyncio.get_running_loop()
    try:
        host = "127.0.0.1" if access.host == LOCALHOST else access.host
        listening = await loop.create_server(lambda: _protocol(runner, server), host, access.port)
    except OSError as error:
        say({"problem": f"cannot listen on {access.host}:{access.port}: {os.strerror(error.errno or 0)}"})
        return
    port = listening.sockets[0].getsockname()[1]
    say({"listening": url_of(access.host, port)})
    ended = asyncio.Event()
    threading.Thread(target=_read, args=(pipe, Painter(start), server, loop, ended), daemon=True).start()
    await ended.wait()


def _protocol(runner: web.AppRunner, server: PageServer) -> asyncio.Protocol:
    """For one more connection; where there is no room it is closed at once."""
    assert runner.server is not None
    return runner.server() if server.make_room(runner.server.connections) else _Full()


class _Full(asyncio.Protocol):
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport.close()


def _read(
    pipe: Connection,
    painter: Painter,
    server: PageServer,
    loop: asyncio.AbstractEventLoop,
    ended: asyncio.Event,
) -> None:
    """Take what the app sends, and paint here: while that takes long, the app's newest waits in its slot."""
    try:
        while True:
            message = pipe.recv()
            if isinstance(message, Look):
                loop.call_soon_threadsafe(server.picture, *painter.paint(message))
            elif isinstance(message, Text):
                loop.call_soon_threadsafe(server.text, message)
            elif isinstance(message, Reply):
                loop.call_soon_threadsafe(server.reply, message)
    except (EOFError, OSError):
        pass
    finally:
        loop.call_soon_threadsafe(ended.set)
