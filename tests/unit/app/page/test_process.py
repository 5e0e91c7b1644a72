"""The page's process: started with what it needs alone, started again, and never in the app's way."""

import asyncio
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from companion.app.page import process as page
from companion.app.page.access import TOKEN_VARIABLE
from companion.app.page.process import Line, PageProcess
from tests.scenario.flying import alive, children
from tests.unit.app.page.test_server import TOKEN, frame, look, start

PATIENCE_S = 20.0


class Running:
    """A page's process, and what it and its keeper have said."""

    def __init__(self, **changes: Any) -> None:
        self.lines: list[Line] = []
        self.problems: list[str] = []
        self.process = PageProcess(start(**changes), self.lines.append, self.problems.append)

    async def until(self, key: str, times: int = 1) -> Any:
        """The value of the so-manieth line with a key; each may take the start of a process of its own."""
        async with asyncio.timeout(times * PATIENCE_S):
            while len(said := [line[key] for line in self.lines if key in line]) < times:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        return said[times - 1]


@asynccontextmanager
async def running(**changes: Any) -> AsyncIterator[Running]:
    on = Running(**changes)
    task = asyncio.create_task(on.process.run())
    try:
        yield on
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_it_serves_and_its_token_is_seen_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/nobody")
    async with running(token=TOKEN) as on, aiohttp.ClientSession() as session:
        url = await on.until("listening")
        async with session.get(url) as answer:
            assert answer.status == 200
        (child,) = children(os.getpid())
        for name in ("cmdline", "environ"):
            content = await asyncio.to_thread(Path(f"/proc/{child}/{name}").read_bytes)
            assert TOKEN.encode() not in content
            assert b"NOTIFY_SOCKET" not in content
    assert not alive(child)
    assert TOKEN not in str(on.lines)
    assert TOKEN not in repr(start(token=TOKEN))


async def test_one_that_is_killed_is_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "FIRST_PAUSE_S", 0.1)
    async with running() as on:
        await on.until("listening")
        (child,) = children(os.getpid())
        os.kill(child, signal.SIGKILL)
        await on.until("listening", times=2)
        assert on.problems == ["ended"]
        assert {"viewers": 0} in on.lines


@pytest.mark.parametrize(
    ("well_s", "told", "paused_s"), [(60.0, 1, [1.0, 2.0, 4.0]), (0.0, 3, [1.0, 1.0, 1.0])]
)
async def test_an_end_after_it_ran_well_is_reported_again_and_one_soon_after_waits_longer(
    well_s: float, told: int, paused_s: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses: list[float] = []

    async def life(_: PageProcess) -> str:
        return "ended"

    async def pause(pause_s: float) -> None:
        pauses.append(pause_s)
        if len(pauses) == 3:
            raise asyncio.CancelledError

    monkeypatch.setattr(page, "WELL_S", well_s)
    monkeypatch.setattr(page, "FIRST_PAUSE_S", 1.0)
    monkeypatch.setattr(PageProcess, "_one_life", life)
    monkeypatch.setattr(asyncio, "sleep", pause)
    on = Running()
    with pytest.raises(asyncio.CancelledError):
        await on.process.run()
    assert (on.problems, pauses) == (["ended"] * told, paused_s)


async def test_a_port_that_is_taken_is_reported_once_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "FIRST_PAUSE_S", 0.1)
    with closing(socket.socket()) as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        async with running(port=port) as on:
            await on.until("problem", times=2)
            assert on.problems == [f"cannot listen on 127.0.0.1:{port}: Address already in use"]
            taken.close()
            assert await on.until("listening") == f"http://127.0.0.1:{port}/"


async def test_one_that_stands_still_holds_nobody_up_and_fills_no_memory() -> None:
    async with running() as on:
        await on.until("listening")
        (child,) = children(os.getpid())
        os.kill(child, signal.SIGSTOP)
        picture = look(frame=frame())
        for _ in range(200):  # far more than the pipe holds: whoever waited for it would wait for ever
            on.process.put(picture)
            await asyncio.sleep(0.001)
        sender = on.process._sender
        assert sender is not None
        assert len(sender._newest) <= 1
    assert not alive(child)


async def test_it_ends_with_the_app_that_was_killed() -> None:
    theirs, ours = Pipe(duplex=False)
    child = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "companion.app.page.child", str(theirs.fileno())),
        stdout=asyncio.subprocess.PIPE,
        pass_fds=(theirs.fileno(),),
    )
    theirs.close()
    ours.send(start())
    assert child.stdout is not None
    assert b"listening" in await asyncio.wait_for(child.stdout.readline(), PATIENCE_S)
    for number in (signal.SIGINT, signal.SIGTERM):
        child.send_signal(number)  # a service manager's, to every process of the service
    await asyncio.sleep(0.2)
    assert child.returncode is None
    ours.close()
    assert await asyncio.wait_for(child.wait(), PATIENCE_S) == 0


@pytest.mark.parametrize("words", ["nonsense", "[1]", "x" * 5000])
async def test_what_nobody_understands_ends_it(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def speaks(*_: object) -> asyncio.subprocess.Process:
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-c", f"print({words!r}, flush=True); import time; time.sleep(60)"),
            stdout=asyncio.subprocess.PIPE,
            limit=page.LONGEST_LINE,
        )

    monkeypatch.setattr(page, "_spawn", speaks)
    async with running() as on:
        await on.until("viewers")
        assert on.problems == ["said what nobody understands"]
        assert children(os.getpid()) == []
