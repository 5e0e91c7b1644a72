"""`companion-sitl view`: frames from a socket into files and a browser, end to end."""

import asyncio
import sys
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from companion.base.clock import Clock
from companion.base.formats.frame_format import FrameHeader, pack_frame
from companion.base.formats.mjpeg import MjpegServer
from companion.base.messages import Frame
from companion.config import CONFIG_FOLDER, ConfigError
from sitl.devices.socket_servers import FrameServer
from sitl.run.view import Statistics, ViewOptions, annotated, view
from tests.programs import ProgramHere

GREY = np.full((120, 160), 90, np.uint8)
RATE_HZ = 100.0


@asynccontextmanager
async def camera(where: Path | int) -> AsyncIterator[str]:
    """A server of frames at 100 Hz whose number 3 and 4 are lost; gives its address."""
    server = FrameServer(where)
    await server.start()

    async def film() -> None:
        clock, sequence = Clock(), 0
        while True:
            if server.client_count and sequence not in (3, 4):
                now_s = clock.now_s()
                server.deliver(Frame(now_s - 0.02, now_s, sequence, GREY))
            sequence += server.client_count
            await asyncio.sleep(1.0 / RATE_HZ)

    filming = asyncio.create_task(film())
    try:
        yield server.address
    finally:
        filming.cancel()
        await server.close()


@pytest.mark.parametrize("kind", ["unix", "tcp"])
async def test_every_nth_frame_becomes_a_file(kind: str, tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    async with camera(tmp_path / "camera" if kind == "unix" else 0) as address:
        statistics = await view(address, ViewOptions(pictures, every=3, frames=4))
    first, second, *others = sorted(path.name for path in pictures.iterdir())
    # the 4th frame that came is number 5
    assert (first, second, len(others)) == ("frame-00000000.png", "frame-00000005.png", 2)
    picture = cv2.imread(str(pictures / first))
    assert picture is not None
    assert picture.shape == (120, 160, 3)
    assert (picture[:90] == 90).all()
    assert (picture[-20:] != 90).any()  # the number and the time
    assert (statistics.count, statistics.dropped) == (10, 2)
    assert "ms old, 2 dropped" in str(statistics)


async def test_a_video_has_the_frames_and_their_rate(tmp_path: Path) -> None:
    path = tmp_path / "flight.mp4"
    async with camera(tmp_path / "camera") as address:
        statistics = await view(address, ViewOptions(path, frames=40))
    video = cv2.VideoCapture(str(path))
    assert [video.read()[0] for _ in range(41)] == [True] * 40 + [False]
    assert 0.5 * statistics.rate_hz < video.get(cv2.CAP_PROP_FPS) < 2.0 * statistics.rate_hz
    video.release()


async def test_terminated_it_leaves_a_video_that_plays(tmp_path: Path) -> None:
    path = tmp_path / "flight.mp4"
    async with camera(tmp_path / "camera") as address:
        words = (sys.executable, "-m", "sitl.cli", "view", address, "--record", str(path))
        process = await asyncio.create_subprocess_exec(*words, cwd=CONFIG_FOLDER.parent, stdout=PIPE)
        assert process.stdout is not None
        await asyncio.wait_for(process.stdout.readline(), 20.0)  # a second of frames
        process.terminate()
        await asyncio.wait_for(process.communicate(), 20.0)
    assert process.returncode == 0
    video = cv2.VideoCapture(str(path))
    assert video.read()[0]
    video.release()


@pytest.mark.parametrize("name", ["flight.avi", "frame.PNG"])
async def test_another_kind_of_file_is_refused_and_nothing_made(name: str, tmp_path: Path) -> None:
    async with camera(tmp_path / "camera") as address:
        with pytest.raises(ConfigError, match=r"expected FILE\.mp4, or a folder"):
            await view(address, ViewOptions(tmp_path / name, frames=1))
    assert not (tmp_path / name).exists()


async def test_a_browser_gets_a_page_and_the_pictures(tmp_path: Path) -> None:
    page = MjpegServer()
    port = await page.start(0)
    assert b'src="/stream"' in await get(port, "/")
    assert (await get(port, "/secrets")).startswith(b"HTTP/1.0 404")
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /stream HTTP/1.0\r\nHost: localhost\r\n\r\n")
    head = await reader.readuntil(b"\r\n\r\n")
    assert b"multipart/x-mixed-replace; boundary=frame" in head
    for level in (30, 200):
        page.show(np.full((120, 160), level, np.uint8))
        part = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 5.0)
        size = int(part.split(b"Content-Length: ")[1].split(b"\r\n")[0])
        image = cv2.imdecode(np.frombuffer(await reader.readexactly(size), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        assert abs(int(image[60, 80]) - level) < 4
        await reader.readexactly(2)
    writer.close()
    while page.viewer_count:  # noqa: ASYNC110 - it has no event for it
        await asyncio.sleep(0.01)
    await page.close()


async def get(port: int, path: str) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"GET {path} HTTP/1.0\r\nHost: localhost\r\n\r\n".encode())
    answer = await asyncio.wait_for(reader.read(), 5.0)
    writer.close()
    return answer


async def test_what_is_served_is_watched_as_it_comes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async with camera(tmp_path / "camera") as address:
        await view(address, ViewOptions(frames=3, serve_port=0))
    assert capsys.readouterr().out.startswith("picture at http://127.0.0.1:")


async def test_a_server_that_goes_ends_it_with_what_there_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server = FrameServer(tmp_path / "camera")
    await server.start()
    watching = asyncio.create_task(view(server.address, ViewOptions()))
    while server.client_count == 0:  # noqa: ASYNC110 - it has no event for it
        await asyncio.sleep(0.01)
    server.deliver(Frame(Clock().now_s(), 0.0, 0, GREY))
    await asyncio.sleep(0.1)
    await server.close()
    assert (await asyncio.wait_for(watching, 5.0)).count == 1
    assert "was closed by its server" in capsys.readouterr().err


async def test_what_is_no_frame_is_an_error(tmp_path: Path) -> None:
    async def talk(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(pack_frame(GREY, 0, None) + b"and now something else that is long enough")
        await writer.drain()
        writer.close()

    server = await asyncio.start_unix_server(talk, tmp_path / "camera")
    with pytest.raises(ConfigError, match="does not send frames: not a frame"):
        await view(f"socket:{tmp_path / 'camera'}", ViewOptions())
    server.close()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("/nowhere/camera",), "socket:/nowhere/camera: No such file or directory; expected a program that"),
        (("tcp:nowhere",), "'tcp:nowhere'; expected socket:PATH or tcp:HOST:PORT"),
        (("x", "--every", "0"), "Invalid value for '--every'"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    arguments: tuple[str, ...], expected: str, program: ProgramHere
) -> None:
    assert expected in program("companion-sitl", "view", *arguments).refusal


async def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    async with camera(tmp_path / "camera") as address:
        for record in (tmp_path / "file" / "folder", tmp_path / "missing" / "film.mp4"):
            with pytest.raises(ConfigError, match=f"--record {record}: .*expected a"):
                await view(address, ViewOptions(record))


def test_statistics_bear_a_server_that_starts_anew_and_frames_without_times() -> None:
    statistics = Statistics()
    for sequence in (100, 101, 104, 0, 1):
        statistics.take(FrameHeader(160, 120, 1, sequence, None), 0.1 * sequence)
    assert statistics.dropped == 2
    assert "without times" in str(statistics)


def test_a_colour_picture_keeps_its_colours() -> None:
    image = np.full((120, 160, 3), (10, 20, 30), np.uint8)
    picture = annotated(image, FrameHeader(160, 120, 3, 7, 1.0), 1.05)
    assert (picture[:90] == (10, 20, 30)).all()
    assert (image == (10, 20, 30)).all()  # what came is not written on
