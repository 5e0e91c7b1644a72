"""A headless Chromium, driven by its DevTools protocol over a WebSocket (chromedevtools.github.io)."""

import asyncio
import os
import shutil
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Final

import aiohttp

NAMES: Final = ("chromium", "chromium-browser", "google-chrome")
START_S: Final = 30.0
ANSWER_S: Final = 20.0
MOST_BYTES: Final = 64 * 1024 * 1024
PHONE: Final = (390, 844)
DESK: Final = (1440, 900)


def program() -> str | None:
    """Chromium's program, where it is installed."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Tab:
    """One tab; `console` collects what the page logs as an error, and exceptions."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self._asked = 0
        self._answers: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self.console: list[str] = []
        self._task = asyncio.create_task(self._receive())

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command; its result."""
        self._asked += 1
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._answers[self._asked] = answer
        await self._socket.send_json({"id": self._asked, "method": method, "params": parameters})
        return await asyncio.wait_for(answer, ANSWER_S)

    async def open(self, url: str) -> None:
        """Go there."""
        await self.call("Page.enable")
        await self.call("Runtime.enable")
        await self.call("Log.enable")
        await self.call("Page.navigate", url=url)

    async def resize(self, size: tuple[int, int], ratio: float = 1.0) -> None:
        """The window's size (CSS px), and its pixels a CSS px."""
        width, height = size
        await self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=ratio,
            mobile=width < 600,
        )

    async def evaluate(self, expression: str) -> Any:
        """The value of an expression; promises are waited for."""
        said = await self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in said:
            raise RuntimeError(str(said["exceptionDetails"]))
        return said["result"].get("value")

    async def wait_for(self, expression: str, most_s: float = 30.0) -> None:
        """Wait until an expression is true."""
        async with asyncio.timeout(most_s):
            while not await self.evaluate(f"Boolean({expression})"):  # noqa: ASYNC110 - it is another process
                await asyncio.sleep(0.1)

    async def touch(self, element: str) -> None:
        """A person's click in the middle of an element: what a page may do only after one, it may then."""
        box = await self.evaluate(
            f"{element}.scrollIntoView(), "
            f"((b) => [b.x + b.width / 2, b.y + b.height / 2])({element}.getBoundingClientRect())"
        )
        for kind in ("mousePressed", "mouseReleased"):
            await self.call(
                "Input.dispatchMouseEvent", type=kind, x=box[0], y=box[1], button="left", clickCount=1
            )

    async def _receive(self) -> None:
        async for message in self._socket:
            said = message.json()
            if (answer := self._answers.pop(said.get("id"), None)) is not None:
                if "error" in said:
                    answer.set_exception(RuntimeError(str(said["error"])))
                elif not answer.done():
                    answer.set_result(said["result"])
            elif said.get("method") == "Runtime.exceptionThrown":
                self.console.append(str(said["params"]["exceptionDetails"]))
            elif said.get("method") == "Log.entryAdded" and said["params"]["entry"]["level"] == "error":
                self.console.append(said["params"]["entry"]["text"])


@asynccontextmanager
async def browser(folder: Path) -> AsyncIterator[Tab]:
    """A browser of its own with one tab; ended with all its processes."""
    chromium = program()
    assert chromium is not None
    process = await asyncio.create_subprocess_exec(
        chromium,
        *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"),
        *("--disable-extensions", "--disable-background-networking", "--disable-sync", "--mute-audio"),
        *(f"--user-data-dir={folder / 'browser'}", "--remote-debugging-port=0", "about:blank"),
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        port = await _port(folder / "browser" / "DevToolsActivePort")
        async with aiohttp.ClientSession() as session:
            async with session.get(f"http://127.0.0.1:{port}/json/list") as listed:
                tabs = await listed.json()
            url = next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")
            async with session.ws_connect(url, max_msg_size=MOST_BYTES) as socket:
                yield Tab(socket)
    finally:
        # its helpers outlive it for a while, and write into its folder
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        await process.wait()


async def _port(path: Path) -> int:
    async with asyncio.timeout(START_S):
        while True:
            with suppress(OSError, ValueError, IndexError):
                return int((await asyncio.to_thread(path.read_text)).splitlines()[0])
            await asyncio.sleep(0.1)
