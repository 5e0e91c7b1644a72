"""The page's server by aiohttp's own client: files, who is let in, what each viewer gets."""

import asyncio
import json
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import aiohttp
import pytest
from aiohttp import WSMsgType, web
from aiohttp.test_utils import TestClient, TestServer

from companion.app.page import server as page
from companion.app.page.listener import _protocol
from companion.app.page.look import Reply, Start, Text
from companion.app.page.picture import Painter
from companion.app.page.server import FILES, LONGEST_MESSAGE, STATIC, TOO_MANY, WRONG_TOKEN, PageServer
from companion.app.page.viewer import BURST, MOST_UNDER_WAY
from tests.unit.app.page.starting import TOKEN, frame, look, start

Socket = aiohttp.ClientWebSocketResponse


class ServedPage:
    """A server in this process, and a browser's side of it."""

    def __init__(self, begun: Start) -> None:
        self.said: list[dict[str, Any]] = []
        self.server = PageServer(begun, self.said.append)
        self._http = TestServer(self.server.application())
        self.client = TestClient(self._http)

    @property
    def address(self) -> str:
        return f"{self._http.host}:{self._http.port}"

    async def open(self, **headers: str) -> Socket:
        return await self.client.ws_connect("/live", headers={"Origin": f"http://{self.address}", **headers})

    async def enter(self) -> Socket:
        """Look, with what a viewer is greeted with taken."""
        socket = await self.open()
        assert (await heard(socket))["kind"] == "hello"
        return socket


@asynccontextmanager
async def served(**changes: Any) -> AsyncIterator[ServedPage]:
    shown = ServedPage(start(**changes))
    async with shown.client:
        yield shown


async def heard(socket: Socket) -> dict[str, Any]:
    said: dict[str, Any] = json.loads(await socket.receive_str(timeout=5.0))
    return said


async def end(socket: Socket) -> int | None:
    """The code with which the server ends it."""
    async with asyncio.timeout(5.0):
        async for _ in socket:
            pass
    return socket.close_code


async def test_the_files_come_with_what_a_browser_may_do_with_them() -> None:
    async with served() as on:
        for path, (name, kind) in FILES.items():
            answer = await on.client.get(path)
            assert (answer.status, answer.content_type) == (200, kind)
            assert await answer.read() == (STATIC / name).read_bytes()
            policy = answer.headers["Content-Security-Policy"]
            assert "default-src 'none'" in policy
            assert "frame-ancestors 'none'" in policy
            assert "unsafe" not in policy
        assert {path.name for path in STATIC.iterdir()} == {name for name, _ in FILES.values()}
        for path in ("/page.py", "/../server.py", "/live/x"):
            assert (await on.client.get(path)).status == 404
        assert (await on.client.post("/", data=b"x")).status == 405


def test_nothing_of_the_page_comes_from_the_network_or_from_within_its_html() -> None:
    for path in STATIC.iterdir():
        text = path.read_text()
        assert "http" not in text.replace('location.protocol === "https:"', ""), path.name
        assert "innerHTML" not in text, path.name
        assert " style=" not in text, path.name


@pytest.mark.parametrize(
    ("host", "status"), [("evil.example", 421), ("rover.lan", 200), ("10.0.0.7:80", 200)]
)
async def test_a_page_is_served_by_our_own_names_alone(host: str, status: int) -> None:
    async with served() as on:
        assert (await on.client.get("/", headers={"Host": host})).status == status
        plain = await on.client.get(
            "/live", headers={"Host": "evil.example", "Origin": "http://evil.example"}
        )
        assert plain.status == 421


@pytest.mark.parametrize("origin", ["", "null", "http://evil.example", "http://127.0.0.1:1"])
async def test_a_websocket_from_another_page_is_refused(origin: str) -> None:
    async with served() as on:
        with pytest.raises(aiohttp.WSServerHandshakeError) as error:
            await on.open(Origin=origin)
        assert error.value.status == 403
        assert on.said == []


async def test_a_viewer_gets_the_state_and_pictures() -> None:
    async with served() as on:
        socket = await on.open()
        assert await heard(socket) == {"kind": "hello", "commands": False}
        assert on.said == [{"viewers": 1}]
        on.server.text(Text("state", '{"kind": "state"}'))
        assert await heard(socket) == {"kind": "state"}
        number, data = Painter(start()).paint(look(frame=frame()))
        on.server.picture(number, data)
        message = await socket.receive(timeout=5.0)
        assert (message.type, message.data) == (WSMsgType.BINARY, data)
        await socket.close()
        await asyncio.sleep(0.05)
        assert on.said[-1] == {"viewers": 0}


async def test_a_picture_is_a_jpeg_behind_what_is_drawn_over_it() -> None:
    number, data = Painter(start()).paint(look(frame=frame(101.0)))
    (length,) = struct.unpack(">I", data[:4])
    header = json.loads(data[4 : 4 + length])
    assert data[4 + length :].startswith(b"\xff\xd8")
    assert (header["number"], header["phase"], header["height_m"]) == (number, "descend", 2.0)
    assert header["exposed_unix_ms"] == pytest.approx(1e3 * (1.7e9 + 101.0))
    assert header["time_s"] == pytest.approx(2.0)


async def test_with_a_token_nothing_is_shown_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "WRONG_TOKEN_S", 0.01)
    async with served(token=TOKEN) as on:
        for wrong in ({"token": TOKEN[:-1]}, {"token": 7}, {}, ["x"], {"drawn": 1}):
            socket = await on.open()
            assert await heard(socket) == {"kind": "token"}
            await socket.send_json(wrong)
            assert await end(socket) == WRONG_TOKEN
        assert on.said == []
        socket = await on.open()
        await heard(socket)
        await socket.send_json({"token": TOKEN})
        assert (await heard(socket))["kind"] == "hello"
        assert TOKEN not in str(on.said)


async def test_who_does_not_show_a_token_in_time_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "TOKEN_S", 0.05)
    async with served(token=TOKEN) as on:
        socket = await on.open()
        assert await end(socket) == WRONG_TOKEN


async def test_more_than_so_many_viewers_are_turned_away_until_one_leaves() -> None:
    async with served(most_viewers=2) as on:
        first, _ = await on.enter(), await on.enter()
        assert await end(await on.open()) == TOO_MANY
        await first.close()
        await asyncio.sleep(0.05)
        await on.enter()


async def test_those_without_a_token_yet_take_no_viewer_s_place() -> None:
    async with served(most_viewers=1, token=TOKEN) as on:
        silent = [await on.open() for _ in range(3)]
        await enter_with_token(await on.open())
        late = silent[0]
        assert await heard(late) == {"kind": "token"}
        await late.send_json({"token": TOKEN})
        assert await end(late) == TOO_MANY


async def enter_with_token(socket: Socket) -> None:
    assert await heard(socket) == {"kind": "token"}
    await socket.send_json({"token": TOKEN})
    assert (await heard(socket))["kind"] == "hello"


async def test_a_stranger_s_connection_makes_room_for_a_new_one_and_a_viewer_s_never(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(page, "MOST_CONNECTIONS", 3)
    server = PageServer(start(token=TOKEN, most_viewers=3), lambda _: None)
    runner = web.AppRunner(server.application())
    await runner.setup()
    assert runner.server is not None
    loop = asyncio.get_running_loop()
    listening = await loop.create_server(lambda: _protocol(runner, server), "127.0.0.1", 0)
    address = f"127.0.0.1:{listening.sockets[0].getsockname()[1]}"
    live, origin = f"http://{address}/live", {"Origin": f"http://{address}"}
    looking: list[Socket] = []
    async with aiohttp.ClientSession() as session:
        for viewers in (1, 2, 3):  # while strangers come again and again
            strangers = [await asyncio.open_connection(*address.split(":")) for _ in range(5)]
            looking.append(await session.ws_connect(live, headers=origin))
            await enter_with_token(looking[-1])
            for reader, _ in strangers[: 2 + viewers]:
                with suppress(ConnectionError):
                    assert await asyncio.wait_for(reader.read(), 5.0) == b""
            assert not any(reader.at_eof() for reader, _ in strangers[2 + viewers :])
            for _, writer in strangers:
                writer.close()
            for _ in range(500):
                if len(runner.server.connections) > viewers:
                    await asyncio.sleep(0.01)
        with pytest.raises(aiohttp.ClientError):  # three viewers: the house is full
            await session.ws_connect(live, headers=origin)
    listening.close()
    await runner.cleanup()


async def test_a_slow_viewer_misses_pictures_and_gets_the_newest() -> None:
    async with served() as on:
        slow, quick = await on.enter(), await on.enter()
        for number in range(1, 61):
            on.server.picture(number, number.to_bytes(4, "big") + bytes(200_000))
            got = (await quick.receive_bytes(timeout=5.0))[:4]
            assert int.from_bytes(got, "big") == number
            await quick.send_json({"drawn": number})
            await asyncio.sleep(0)
        assert int.from_bytes((await slow.receive_bytes(timeout=5.0))[:4], "big") == 1
        with pytest.raises(TimeoutError):
            await slow.receive(timeout=0.1)
        assert MOST_UNDER_WAY == 1
        await slow.send_json({"drawn": 1})
        assert int.from_bytes((await slow.receive_bytes(timeout=5.0))[:4], "big") == 60


async def test_text_that_waits_is_replaced_by_newer_of_its_kind() -> None:
    async with served() as on:
        socket = await on.enter()
        for number in range(50):
            on.server.text(Text("state", json.dumps({"kind": "state", "n": number})))
        assert (await heard(socket))["n"] == 49


@pytest.mark.parametrize(
    "message",
    ["x" * (LONGEST_MESSAGE + 1), "[" * LONGEST_MESSAGE, "nonsense", "[]", '{"order": "fly"}', "{}"],
)
async def test_what_no_page_of_ours_says_ends_the_connection(message: str) -> None:
    async with served(allow_commands=True, token=None) as on:
        socket = await on.enter()
        await socket.send_str(message)
        assert await end(socket) in {1008, 1009}
        assert not [line for line in on.said if "order" in line]


async def test_a_flood_ends_the_connection() -> None:
    async with served() as on:
        socket = await on.enter()
        for number in range(round(BURST) + 20):
            await socket.send_json({"drawn": number})
        assert await end(socket) == 1008


async def test_an_order_is_handed_on_and_its_answers_come_back_to_who_gave_it() -> None:
    async with served(allow_commands=True) as on:
        socket, other = await on.enter(), await on.enter()
        await socket.send_json({"order": "land"})
        await socket.send_json({"order": "land"})  # a second press before the first is answered
        await asyncio.sleep(0.05)
        assert [line for line in on.said if "order" in line] == [{"order": "land", "number": 1}]
        on.server.reply(Reply(1, "land", "in_progress", ""))
        on.server.reply(Reply(1, "land", "failed", "taken by the pilot"))
        assert (await heard(socket))["outcome"] == "in_progress"
        expected = {"kind": "reply", "order": "land", "outcome": "failed", "text": "taken by the pilot"}
        assert await heard(socket) == expected
        on.server.text(Text("state", '{"kind": "state"}'))
        assert await heard(other) == {"kind": "state"}
        await socket.send_json({"order": "stop"})
        await asyncio.sleep(0.05)
        assert on.said[-1] == {"order": "stop", "number": 2}
        await socket.close()
        await asyncio.sleep(0.05)
        on.server.reply(Reply(2, "stop", "accepted", ""))  # nobody is there to hear it
