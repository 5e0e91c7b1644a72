"""The page's server by aiohttp's own client: files, who is let in, what each viewer gets."""

import asyncio
import io
import json
import os
import socket
import struct
import tempfile
import zipfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest
from aiohttp import WSMsgType, web
from aiohttp.test_utils import TestClient, TestServer

from companion.app.page import server as page
from companion.app.page.access import (
    TOKEN_VARIABLE,
    Access,
    host_is_ours,
    own_names,
    read_access,
    same_origin,
    same_token,
    url_of,
)
from companion.app.page.listener import Painter, _protocol
from companion.app.page.look import Look, Reply, Start, Text, TrackPoint
from companion.app.page.server import (
    BURST,
    FILES,
    LONGEST_MESSAGE,
    MOST_UNDER_WAY,
    STATIC,
    TOO_MANY,
    WRONG_TOKEN,
    PageServer,
)
from companion.base.errors import ConfigError
from companion.base.messages import Frame
from companion.config import CameraConfig, ServeConfig, find_file, load_model, load_vehicle, validate
from companion.pad import load_pad

TOKEN = "a token of enough characters"
START = Start(
    access=Access("127.0.0.1", 0, None),
    serve=ServeConfig(host_names=("rover.lan",), most_viewers=2),
    camera=load_model(CameraConfig, find_file("cameras", "sitl_640x480")),
    vehicle=load_vehicle("x500", None, "sitl_640x480"),
    pad=load_pad("moving_1300"),
    start_unix_s=1.7e9,
    start_s=100.0,
)


def start(
    *,
    token: str | None = None,
    port: int = START.access.port,
    flights: Path | None = None,
    settings_text: str = "",
    **serve: Any,
) -> Start:
    access, config = replace(START.access, token=token, port=port), START.serve.model_copy(update=serve)
    return replace(START, access=access, serve=config, flights=flights, settings_text=settings_text)


def frame(time_s: float = 101.0, sequence: int = 7) -> Frame:
    image = np.zeros((START.camera.height_px, START.camera.width_px), dtype=np.uint8)
    return Frame(time_s, time_s + 0.03, sequence, image)


def look(**values: Any) -> Look:
    return Look(TrackPoint(102.0, 2.0, 0.1, 2.5), "descend", **values)


# ---------------- The page's server by aiohttp's own client: files, who is let in, what each viewer gets

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


# ---------------- Who may look: addresses, tokens, hosts and origins

NAMES = own_names(("rover.lan",))


def config(**values: object) -> ServeConfig:
    return validate(ServeConfig, values, "serve")


@pytest.mark.parametrize(
    "address", ["127.0.0.1:8080", "[::1]:8080", "0.0.0.0:1", "localhost:65535", "[::]:0"]
)
def test_an_address_is_an_ip_address_and_a_port(address: str) -> None:
    assert config(address=address).address == address


@pytest.mark.parametrize(
    "address",
    ["8080", "127.0.0.1", "::1:8080", "rover:8080", "127.0.0.1:65536", "127.0.0.1:", ":80", "[::1]"],
)
def test_anything_else_is_refused_in_one_line(address: str) -> None:
    with pytest.raises(ConfigError, match=r"^serve: address: expected ADDRESS:PORT[^\n]*$"):
        config(address=address)


@pytest.mark.parametrize(
    ("host", "shown"),
    [
        ("127.0.0.1", "127.0.0.1"),
        ("::1", "[::1]"),
        ("localhost", "localhost"),
        ("192.168.4.1", "192.168.4.1"),
    ],
)
def test_the_address_that_is_told_can_be_typed_into_a_browser(host: str, shown: str) -> None:
    assert url_of(host, 8080) == f"http://{shown}:8080/"
    for every in ("0.0.0.0", "::"):
        url = url_of(every, 8080)
        assert url == f"http://{socket.gethostname()}:8080/"
        assert host_is_ours(url.removeprefix("http://").rstrip("/"), NAMES)


def test_without_an_address_there_is_no_page() -> None:
    assert read_access(config(), {TOKEN_VARIABLE: TOKEN}) is None


def test_only_loopback_without_commands_needs_no_token() -> None:
    for address in ("127.0.0.1:80", "[::1]:80", "localhost:80"):
        access = read_access(config(address=address), {})
        assert access is not None
        assert access.token is None
    for values in ({"address": "0.0.0.0:80"}, {"address": "192.168.4.1:80"}, {"address": "[::]:80"}):
        with pytest.raises(ConfigError, match=r"others reach it; expected a token: serve\.token_file"):
            read_access(config(**values), {})
    with pytest.raises(ConfigError, match=r"serve\.allow_commands; expected a token"):
        read_access(config(address="127.0.0.1:80", allow_commands=True), {})


def test_a_token_comes_from_the_environment_or_a_file_of_its_owner_s(tmp_path: Path) -> None:
    access = read_access(config(address="0.0.0.0:80"), {TOKEN_VARIABLE: f" {TOKEN}\n"})
    assert access is not None
    assert access.token == TOKEN
    assert TOKEN not in repr(access)
    path = tmp_path / "token"
    path.write_text(f"{TOKEN}, in the file\n")
    path.chmod(0o600)
    access = read_access(config(address="0.0.0.0:80", token_file=path), {TOKEN_VARIABLE: TOKEN})
    assert access is not None
    assert access.token == f"{TOKEN}, in the file"
    path.chmod(0o640)
    with pytest.raises(ConfigError, match="mode 0640, others may read it; expected 0600"):
        read_access(config(address="0.0.0.0:80", token_file=path), {})


@pytest.mark.parametrize("content", [b"", b"short", b"x" * 257, "sécret de seize lettres".encode()])
def test_a_token_that_is_none_is_refused_and_not_repeated(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(ConfigError) as error:
        read_access(config(address="0.0.0.0:80", token_file=path), {})
    assert str(path) in str(error.value)
    assert "cret" not in str(error.value)
    with pytest.raises(ConfigError, match="No such file"):
        read_access(config(address="0.0.0.0:80", token_file=tmp_path / "nope"), {})


def test_tokens_are_compared_whatever_is_given() -> None:
    assert same_token(TOKEN, TOKEN)
    for wrong in ("", TOKEN[:-1], TOKEN + " ", None, 7, ["x"], "é" * 20):
        assert not same_token(wrong, TOKEN)


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8080", "192.168.4.1", "[::1]:80", "localhost:1", "Rover.LAN:80", "rover.lan.:80"]
)
def test_an_ip_address_and_our_own_names_are_ours(host: str) -> None:
    assert host_is_ours(host, NAMES)


@pytest.mark.parametrize(
    "host",
    [
        None,
        "",
        "evil.example",
        "127.0.0.1.evil.example",
        "evil.example:8080",
        "x@127.0.0.1",
        "127.0.0.1/x",
        "[::1",
    ],
)
def test_a_foreign_name_is_not_whatever_it_resolves_to(host: str | None) -> None:
    assert not host_is_ours(host, NAMES)


def test_a_websocket_is_opened_by_the_page_that_we_served() -> None:
    assert same_origin("http://127.0.0.1:8080", "127.0.0.1:8080")
    assert same_origin("http://rover.lan", "rover.lan")
    assert same_origin("https://rover.lan", "rover.lan:443")
    for origin, host in (
        (None, "127.0.0.1:8080"),
        ("null", "127.0.0.1:8080"),
        ("http://evil.example", "127.0.0.1:8080"),
        ("http://127.0.0.1:8081", "127.0.0.1:8080"),
        ("http://127.0.0.1:8080@evil.example", "127.0.0.1:8080"),
        ("file://127.0.0.1:8080", "127.0.0.1:8080"),
        ("http://127.0.0.1:8080", None),
    ):
        assert not same_origin(origin, host)


# ---------------- Flights to download from the page, and the settings to read: for those who show the token

BEARER = {"Authorization": f"Bearer {TOKEN}"}


@pytest.fixture
def flights(tmp_path: Path) -> Path:
    for name in ("flight-0001", "flight-0002"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "flight.mcap").write_bytes(name.encode())
    (tmp_path / "latch.json").write_text("not a flight")
    return tmp_path


async def test_flights_are_listed_and_come_whole(flights: Path) -> None:
    async with served(flights=flights, token=TOKEN) as on:
        listed = await (await on.client.get("/flights", headers=BEARER)).json()
        assert [flight["name"] for flight in listed] == ["flight-0002", "flight-0001"]
        answer = await on.client.get("/flights/flight-0002", headers=BEARER)
        assert answer.headers["Content-Disposition"] == 'attachment; filename="flight-0002.zip"'
        with zipfile.ZipFile(io.BytesIO(await answer.read())) as archive:
            assert archive.namelist() == ["flight-0002/flight.mcap"]
            assert archive.read("flight-0002/flight.mcap") == b"flight-0002"


async def test_a_flight_that_is_downloaded_takes_no_room_on_the_card(
    flights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GIVEN browsers that ask for a flight and take nothing, WHEN they wait, THEN no copy of it is kept."""
    log = os.urandom(1 << 23)
    (flights / "flight-0002" / "flight.mcap").write_bytes(log)
    made: list[str] = []
    make = tempfile.NamedTemporaryFile

    def counted(suffix: str = "") -> Any:
        made.append(suffix)
        return make(suffix=suffix)

    monkeypatch.setattr(tempfile, "NamedTemporaryFile", counted)
    async with served(flights=flights) as on:
        async with on.client.get("/flights/flight-0002") as waiting:
            assert waiting.status == 200
        whole = await (await on.client.get("/flights/flight-0002")).read()
    assert made == []
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        assert archive.read("flight-0002/flight.mcap") == log


async def test_who_takes_nothing_of_a_flight_is_let_go(
    flights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "SENDING_S", 0.2)
    (flights / "flight-0002" / "flight.mcap").write_bytes(bytes(1 << 26))
    async with served(flights=flights) as on:
        answer = await on.client.get("/flights/flight-0002")
        await asyncio.sleep(1.0)
        with pytest.raises(aiohttp.ClientError):  # and it does not look whole
            await answer.read()


@pytest.mark.parametrize("name", ["latch.json", "%2e%2e%2fetc", "flight-0009"])
async def test_nothing_else_can_be_had(flights: Path, name: str) -> None:
    async with served(flights=flights, token=TOKEN) as on:
        assert (await on.client.get(f"/flights/{name}", headers=BEARER)).status == 404


async def test_without_the_token_nothing_is_shown(flights: Path) -> None:
    async with served(flights=flights, token=TOKEN, settings_text="pad: x") as on:
        for path in ("/flights", "/flights/flight-0001", "/settings"):
            for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": f"Basic {TOKEN}"}):
                assert (await on.client.get(path, headers=headers)).status == 403
        assert await (await on.client.get("/settings", headers=BEARER)).text() == "pad: x"


async def test_where_nothing_is_recorded_there_are_no_flights() -> None:
    async with served() as on:
        assert await (await on.client.get("/flights")).json() == []
