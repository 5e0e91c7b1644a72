"""In the page's process: it listens for browsers, and shows them what comes through the pipe."""

import asyncio
import json
import os
import sys
import threading
from multiprocessing.connection import Connection
from typing import Any, Final

from aiohttp import web

from companion.app.page.access import url_of
from companion.app.page.look import Look, Reply, Start, Text
from companion.app.page.picture import Painter
from companion.app.page.server import PageServer
from companion.config.service import LOCALHOST
from companion.sense.vision.opencv import prepare_opencv

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
    server = PageServer(start, say)
    runner = web.AppRunner(
        server.application(), access_log=None, handle_signals=False, keepalive_timeout=KEEP_ALIVE_S
    )
    await runner.setup()
    loop = asyncio.get_running_loop()
    try:
        host = "127.0.0.1" if start.host == LOCALHOST else start.host
        listening = await loop.create_server(lambda: _protocol(runner, server), host, start.port)
    except OSError as error:
        say({"problem": f"cannot listen on {start.host}:{start.port}: {os.strerror(error.errno or 0)}"})
        return
    port = listening.sockets[0].getsockname()[1]
    say({"listening": url_of(start.host, port)})
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
