"""A page with a camera's picture for a browser: HTTP on the loopback, the frames as Motion JPEG.

`/` is the page, `/stream` the frames (multipart/x-mixed-replace). A browser that has not taken its last frame
yet misses this one.
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.errors import ConfigError

_PAGE: Final = """<!DOCTYPE html><html><head><title>companion</title></head>
<body style="margin:0;background:#222">
<img src="/stream" style="width:100%;image-rendering:pixelated">
</body></html>
"""


class MjpegServer:
    """Serves whatever `show` is given."""

    def __init__(self) -> None:
        self._runner: Any = None
        self._viewers: set[asyncio.Queue[bytes]] = set()

    @property
    def viewer_count(self) -> int:
        return len(self._viewers)

    async def start(self, port: int) -> int:
        """Listen on the loopback; returns the port (a free one for 0).

        Raises:
            OSError: the port is taken.
        """
        from aiohttp import web  # noqa: PLC0415 - may be left out of an installation

        async def page(_: web.Request) -> web.Response:
            return web.Response(text=_PAGE, content_type="text/html", headers={"Cache-Control": "no-store"})

        async def stream(request: web.Request) -> web.StreamResponse:
            """Keep a browser until it goes."""
            response = web.StreamResponse(headers={"Cache-Control": "no-store"})
            response.content_type = "multipart/x-mixed-replace; boundary=frame"
            await response.prepare(request)
            frames = asyncio.Queue[bytes](1)
            self._viewers.add(frames)
            try:
                while True:
                    await response.write(await frames.get())
            finally:
                self._viewers.discard(frames)

        app = web.Application()
        app.add_routes([web.get("/", page), web.get("/stream", stream)])
        self._runner = web.AppRunner(
            app, access_log=None, handle_signals=False, handler_cancellation=True, shutdown_timeout=0.1
        )
        await self._runner.setup()
        await web.TCPSite(self._runner, "127.0.0.1", port).start()
        taken: int = self._runner.addresses[0][1]
        return taken

    def show(self, image: NDArray[np.uint8]) -> None:
        """Send an image (grey, or blue, green, red) to every browser that can take it."""
        free = [frames for frames in self._viewers if frames.empty()]
        if free:
            data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, 80))[1].tobytes()
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
            for frames in free:
                frames.put_nowait(head.encode() + data + b"\r\n")

    async def close(self) -> None:
        if self._runner is not None:
            await self._runner.cleanup()


@asynccontextmanager
async def serving(port: int | None, tell: Callable[[str], object]) -> AsyncIterator[MjpegServer]:
    """A server while inside, as `--serve` asks for it; `tell` gets its address. No port: nobody watches.

    Raises:
        ConfigError: the port cannot be listened at.
    """
    server = MjpegServer()
    try:
        if port is not None:
            try:
                taken = await server.start(port)
            except OSError as error:
                raise ConfigError(f"--serve {port}: {error.strerror}; expected a free port, or 0") from error
            tell(f"picture at http://127.0.0.1:{taken}/")
        yield server
    finally:
        await server.close()
