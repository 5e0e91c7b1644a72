"""The camera on a socket, with the simulator's server or a stranger behind it; sources' names."""

import asyncio
import itertools
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest

from companion.base.clock import Clock
from companion.base.formats.frame_format import pack_frame
from companion.base.messages import Frame
from companion.config import CameraConfig, ConfigError
from companion.sense.camera.frame_socket import MOST_STRANGE, SocketCamera
from companion.sense.camera.reader import grey
from companion.sense.camera.source import FrameSource, keep_camera, open_camera
from sitl.devices.socket_servers import FrameServer
from tests.unit.sense.camera.camera_frames import AGE_S, noisy_frame


async def connected(where: Path | int, camera: CameraConfig) -> tuple[FrameServer, SocketCamera]:
    server = FrameServer(where)
    await server.start()
    source = await open_camera(server.address, camera)
    assert isinstance(source, SocketCamera)
    while server.client_count == 0:  # noqa: ASYNC110 - the server has no event for it
        await asyncio.sleep(0)
    return server, source


@pytest.mark.parametrize("kind", ["unix", "tcp"])
async def test_frames_cross_the_socket_unchanged(kind: str, tmp_path: Path, camera: CameraConfig) -> None:
    server, source = await connected(tmp_path / "frames" if kind == "unix" else 0, camera)
    image = np.random.default_rng(0).integers(0, 256, (480, 640)).astype(np.uint8)
    time_s = round(Clock().now_s() - 0.04, 6)
    server.deliver(Frame(time_s, time_s, 41, image))
    frame = await asyncio.wait_for(source.next(), 5.0)
    assert (frame.sequence, frame.time_s) == (41, time_s)
    assert np.array_equal(frame.image, image)
    source.close()
    await server.close()


async def test_the_newest_frame_wins_and_a_slow_client_never_holds_the_server_up(
    tmp_path: Path, camera: CameraConfig
) -> None:
    server, source = await connected(tmp_path / "frames", camera)
    image, time_s = np.zeros((480, 640), np.uint8), Clock().now_s()
    for sequence in range(50):  # without a pause: most cannot be taken and are dropped
        server.deliver(Frame(time_s, time_s, sequence, image))
    first = await asyncio.wait_for(source.next(), 5.0)
    assert first.sequence < 49
    for sequence in range(100, 103):  # with pauses: all are taken, and the last is what the reader gets
        await asyncio.sleep(0.1)
        server.deliver(Frame(time_s, time_s, sequence, image))
    await asyncio.sleep(0.05)
    newest = await asyncio.wait_for(source.next(), 5.0)
    assert newest.sequence == 102
    source.close()
    await server.close()


async def test_a_server_that_goes_is_an_error(tmp_path: Path, camera: CameraConfig) -> None:
    server, source = await connected(tmp_path / "frames", camera)
    await server.close()
    with pytest.raises(OSError, match="closed by its server"):
        await asyncio.wait_for(source.next(), 5.0)
    source.close()


async def test_frames_of_another_size_than_the_calibrations_are_refused(
    tmp_path: Path, camera: CameraConfig
) -> None:
    server, source = await connected(tmp_path / "frames", camera)
    server.deliver(Frame(0.0, 0.0, 0, np.zeros((240, 320), np.uint8)))
    with pytest.raises(ConfigError, match="320x240, expected the calibration's 640x480"):
        await asyncio.wait_for(source.next(), 5.0)
    source.close()
    await server.close()


@asynccontextmanager
async def a_server_that_says(
    data: Sequence[bytes], folder: Path, camera: CameraConfig
) -> AsyncIterator[FrameSource]:
    """The app's camera at a stranger who sends these bytes, piece by piece, and hangs up."""

    async def talk(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for piece in data:
            writer.write(piece)
            await writer.drain()
            await asyncio.sleep(0.01)
        writer.close()

    server = await asyncio.start_unix_server(talk, folder / "frames")
    source = await open_camera(f"socket:{folder / 'frames'}", camera, unstamped_latency_s=0.03)
    try:
        yield source
    finally:
        source.close()
        server.close()


async def from_a_server_that_says(data: bytes, folder: Path, camera: CameraConfig) -> Frame:
    """The frame that the app makes of a stranger's bytes."""
    async with a_server_that_says([data], folder, camera) as source:
        return await asyncio.wait_for(source.next(), 5.0)


async def test_a_colour_image_becomes_grey(tmp_path: Path, camera: CameraConfig) -> None:
    image = np.full((480, 640, 3), (0, 100, 0), np.uint8)
    frame = await from_a_server_that_says(pack_frame(image, 3, Clock().now_s()), tmp_path, camera)
    assert frame.image.shape == (480, 640)
    assert int(frame.image[0, 0]) == 59  # green's weight, 0.587


def test_grey_values_of_more_than_8_bits_are_refused() -> None:
    ramp = np.linspace(0.0, 65535.0, 640 * 480).reshape(480, 640).astype(np.uint16)
    with pytest.raises(ConfigError, match=r"images of 16 bits a pixel \(uint16\); expected 8 bits"):
        grey(ramp)


async def test_a_frame_without_a_time_is_as_old_as_the_settings_say(
    tmp_path: Path, camera: CameraConfig
) -> None:
    frame = await from_a_server_that_says(
        pack_frame(np.zeros((480, 640), np.uint8), 0, None), tmp_path, camera
    )
    assert frame.time_s == pytest.approx(frame.received_s - 0.03)


async def test_frames_without_a_time_that_were_held_up_are_passed_over(
    tmp_path: Path, camera: CameraConfig
) -> None:
    """A line that carries nothing for 0.6 s, and then all of it."""
    frames = [pack_frame(np.zeros((480, 640), np.uint8), number, None) for number in range(45)]
    began_s = Clock().now_s()

    async def talk(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for number, frame in enumerate(frames):
            leaves = number if number < 12 else max(number, 30)
            await asyncio.sleep(max(0.0, began_s + leaves / 30 - Clock().now_s()))
            writer.write(frame)
            await writer.drain()

    server = await asyncio.start_unix_server(talk, tmp_path / "frames")
    source = await open_camera(f"socket:{tmp_path / 'frames'}", camera, unstamped_latency_s=0.03)
    errors_s: dict[int, float] = {}
    while max(errors_s, default=0) < 40:
        frame = await asyncio.wait_for(source.next(), 5.0)
        errors_s[frame.sequence] = frame.time_s + 0.03 - (began_s + frame.sequence / 30)
    source.close()
    server.close()
    assert max(errors_s.values()) < min(errors_s.values()) + 0.1


@pytest.mark.parametrize("off_s", [-60.0, 3600.0])
async def test_another_clock_than_ours_is_reported(
    off_s: float, tmp_path: Path, camera: CameraConfig
) -> None:
    data = pack_frame(np.zeros((480, 640), np.uint8), 0, max(Clock().now_s() + off_s, 1e-9))
    with pytest.raises(ConfigError, match="expected CLOCK_MONOTONIC at mid-exposure, or 0"):
        await from_a_server_that_says(data, tmp_path, camera)


async def until_it_fails(source: FrameSource) -> None:
    while True:
        await source.next()


def grey_frame(sequence: int, off_s: float) -> bytes:
    return pack_frame(np.zeros((480, 640), np.uint8), sequence, max(Clock().now_s() + off_s, 1e-9))


async def test_a_single_frame_from_another_time_is_passed_over(tmp_path: Path, camera: CameraConfig) -> None:
    data = [grey_frame(0, 0.0), grey_frame(1, 3600.0), grey_frame(2, 0.0)]
    seen: list[int] = []
    async with asyncio.timeout(5.0), a_server_that_says(data, tmp_path, camera) as source:
        while 2 not in seen:
            seen.append((await source.next()).sequence)
    assert 1 not in seen


async def test_a_clock_that_runs_away_after_good_frames_is_a_lost_camera(
    tmp_path: Path, camera: CameraConfig
) -> None:
    data = [grey_frame(0, 0.0), *(grey_frame(n, 3600.0) for n in range(1, 1 + MOST_STRANGE))]
    async with asyncio.timeout(5.0), a_server_that_says(data, tmp_path, camera) as source:
        with pytest.raises(OSError, match="expected CLOCK_MONOTONIC"):
            await until_it_fails(source)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n" + bytes(64), "does not send frames: not a frame"),
        (pack_frame(np.zeros((480, 640), np.uint8), 0, None)[:-1], "after 307199 of 307200 bytes"),
        (b"CFRM", "after 4 of 32 bytes of a frame's header"),
    ],
)
async def test_what_is_not_a_whole_frame_is_an_error(
    data: bytes, text: str, tmp_path: Path, camera: CameraConfig
) -> None:
    with pytest.raises(OSError, match=text):
        await from_a_server_that_says(data, tmp_path, camera)


@pytest.mark.parametrize("spec", ["usb", "v4l2:", "v4l2:front", "socket:", "tcp:host", ""])
async def test_a_source_that_is_not_one_is_named_with_what_was_expected(
    spec: str, camera: CameraConfig
) -> None:
    with pytest.raises(ConfigError, match=r"expected v4l2:NUMBER, picamera2:NUMBER, .* or tcp:HOST"):
        await open_camera(spec, camera)


async def test_a_missing_camera_or_server_is_one_line(tmp_path: Path, camera: CameraConfig) -> None:
    for spec in ("v4l2:63", f"socket:{tmp_path / 'nobody'}", "tcp:127.0.0.1:1"):
        with pytest.raises(ConfigError) as caught:
            await open_camera(spec, camera)
        assert "\n" not in str(caught.value)
        assert spec in str(caught.value)


async def test_a_server_that_comes_back_is_connected_to_again(tmp_path: Path, camera: CameraConfig) -> None:
    server = FrameServer(tmp_path / "frames")
    await server.start()
    kept = await keep_camera(server.address, camera)
    async with asyncio.timeout(10.0):
        serving = asyncio.create_task(serve(server))
        await kept.next()
        serving.cancel()
        await server.close()
        assert "closed by its server" in (await kept.report()).text
        another = FrameServer(tmp_path / "frames")
        await another.start()
        serving = asyncio.create_task(serve(another))
        while kept.problem is not None:
            assert (await kept.next()).image.shape == (480, 640)
        serving.cancel()
    kept.close()
    await another.close()


async def serve(server: FrameServer) -> None:
    """Thirty noisy frames a second."""
    for number in itertools.count():
        server.deliver(noisy_frame(number, Clock().now_s() - AGE_S))
        await asyncio.sleep(1 / 30)
