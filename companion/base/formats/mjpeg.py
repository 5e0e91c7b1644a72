"""A page with a camera's picture for a browser: HTTP on the loopback, the frames as Motion JPEG.

`/` is the page, `/stream` the frames (multipart/x-mixed-replace). A browser that has not taken its last frame
yet misses this one.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

_BOUNDARY: Final = "frame"
_REQUEST_TIMEOUT_S: Final = 5.0
_LONGEST_REQUEST: Final = 8192
_PAGE: Final = b"""<!DOCTYPE html><html><head><title>companion</title></head>
<body style="margin:0;background:#222">
<img src="/stream" style="width:100%;image-rendering:pixelated">
</body></html>
"""


class MjpegServer:
    """Serves whatever `show` is given."""

    def __init__(self) -> None:
        self._server: asyncio.Server | None = None
        self._viewers: set[asyncio.StreamWriter] = set()
        self._answering: set[asyncio.Task[None]] = set()

    @property
    def viewer_count(self) -> int:
        """How many browsers are watching."""
        return len(self._viewers)

    async def start(self, port: int) -> int:
        """Listen on the loopback; returns the port (a free one for 0).

        Raises:
            OSError: the port is taken.
        """
        self._server = await asyncio.start_server(self._answer, "127.0.0.1", port, limit=_LONGEST_REQUEST)
        taken: int = self._server.sockets[0].getsockname()[1]
        return taken

    def show(self, image: NDArray[np.uint8]) -> None:
        """Send an image (grey, or blue, green, red) to every browser that can take it."""
        free = [v for v in self._viewers if v.transport.get_write_buffer_size() == 0]
        if not free:
            return
        jpeg: Any = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, 80))[1]
        data = jpeg.tobytes()
        head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
        for viewer in free:
            viewer.write(head.encode() + data + b"\r\n")

    async def close(self) -> None:
        """Stop listening and part from all browsers."""
        if self._server is not None:
            self._server.close()
        for viewer in self._viewers:
            viewer.transport.abort()
        if self._answering:
            await asyncio.wait(self._answering, timeout=1.0)

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One request a connection."""
        task = asyncio.current_task()
        assert task is not None
        self._answering.add(task)
        task.add_done_callback(self._answering.discard)
        with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            request = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _REQUEST_TIMEOUT_S)
            words = request.split(b"\r\n", 1)[0].split(b" ")
            path = words[1] if len(words) == 3 and words[0] == b"GET" else b""
            if path == b"/stream":
                await self._stream(reader, writer)
            elif path == b"/":
                writer.write(_head("200 OK", "text/html", len(_PAGE)) + _PAGE)
                await writer.drain()
            else:
                writer.write(_head("404 Not Found", "text/plain", 0))
                await writer.drain()
        writer.close()

    async def _stream(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Keep a browser until it goes."""
        writer.write(_head("200 OK", f"multipart/x-mixed-replace; boundary={_BOUNDARY}", None))
        self._viewers.add(writer)
        try:
            while await reader.read(_LONGEST_REQUEST):
                pass
        finally:
            self._viewers.discard(writer)


def _head(status: str, kind: str, length: int | None) -> bytes:
    size = "" if length is None else f"Content-Length: {length}\r\n"
    return (
        f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\n{size}"
        "Cache-Control: no-store\r\nConnection: close\r\n\r\n"
    ).encode()
