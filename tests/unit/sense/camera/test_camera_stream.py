"""A camera on the network: HTTP-MJPEG and RTSP on loopback, lost and found again, and one that hangs."""

import asyncio
import itertools
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from typing import cast

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.clock import Clock
from companion.base.errors import DeviceMissing
from companion.base.messages import Frame
from companion.config import CameraConfig, CompanionConfig, ConfigError, validate, without_password
from companion.sense.camera import stream
from companion.sense.camera.keeper import LONGEST_PAUSE_S, KeptCamera
from companion.sense.camera.source import FrameSource, is_camera, keep_camera, open_camera
from tests.unit.sense.camera.camera_frames import noisy
from tests.unit.sense.camera.mjpeg_camera import mjpeg_server
from tests.unit.sense.camera.rtsp_camera import rtsp_server

BITS, ROWS = 24, 40
LATENCY_S = 0.25


def stamped_picture(number: int) -> NDArray[np.uint8]:
    """A picture whose upper rows say when it was made: ms of CLOCK_MONOTONIC as black and white fields."""
    image = noisy(number).copy()
    made_ms = int(1e3 * time.monotonic())
    for bit in range(BITS):
        image[:ROWS, bit * BITS : (bit + 1) * BITS] = 255 if made_ms >> bit & 1 else 0
    return image


def age_s(image: NDArray[np.uint8], received_s: float) -> float:
    """How old the picture was when it had come."""
    made_ms: int = sum(int(image[ROWS // 2, bit * BITS + BITS // 2] > 128) << bit for bit in range(BITS))
    age_ms: int = (int(1e3 * received_s) - made_ms) & (2**BITS - 1)
    return 1e-3 * age_ms


def stamped_jpegs() -> Iterator[bytes]:
    """As `stamped_picture` makes them, 30 a second, for ever."""
    for number in itertools.count():
        yield cv2.imencode(".jpg", stamped_picture(number))[1].tobytes()
        time.sleep(1 / 30)


def stamped_pictures() -> Iterator[bytes]:
    """Grey pictures as `stamped_picture` makes them, 30 a second, for ever."""
    for number in itertools.count():
        time.sleep(1 / 30)
        yield stamped_picture(number).tobytes()


@contextmanager
def silent_server(says: bytes = b"") -> Iterator[int]:
    """A server that takes connections, says that, and then nothing for ever."""
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        taken = []

        def take() -> None:
            while True:
                try:
                    client, _ = server.accept()
                except OSError:
                    return
                taken.append(client)
                with suppress(OSError):  # who only asks whether anybody is there has gone again
                    client.sendall(says)

        threading.Thread(target=take, daemon=True).start()
        yield server.getsockname()[1]
        for client in taken:
            client.close()


class ScriptedCapture:
    """A VideoCapture that waits so long at each read, by its own clock, and then has a picture or none."""

    def __init__(self, script: list[tuple[float, bool]]) -> None:
        self._script, self._now_s, self.options = script, 100.0, ""
        self.released = False

    def open(self, *_: object) -> "ScriptedCapture":
        self.options = os.environ[stream.OPTIONS_VARIABLE]
        return self

    def now_s(self) -> float:
        return self._now_s

    @property
    def left(self) -> int:
        return len(self._script)

    def isOpened(self) -> bool:
        return True

    def read(self) -> tuple[bool, NDArray[np.uint8] | None]:
        wait_s, good = self._script.pop(0)
        self._now_s += wait_s
        return good, noisy(len(self._script)) if good else None

    def release(self) -> None:
        self.released = True


@pytest.fixture
def opened(
    camera: CameraConfig, monkeypatch: pytest.MonkeyPatch
) -> Callable[[ScriptedCapture], stream.StreamDevice]:
    """Opens a scripted capture as an RTSP camera."""

    def open_it(capture: ScriptedCapture) -> stream.StreamDevice:
        monkeypatch.setattr(cv2, "VideoCapture", capture.open)
        with silent_server() as port:
            url = f"rtsp://127.0.0.1:{port}/camera"
            return stream.StreamDevice(url, camera, LATENCY_S, cast(Clock, capture))

    return open_it


Opened = Callable[[ScriptedCapture], stream.StreamDevice]


def test_an_opened_stream_may_keep_us_waiting_for_its_key_frame(opened: Opened) -> None:
    silence = (stream.READ_S, False)
    steady = [(1 / 30, True)] * 20
    device = opened(ScriptedCapture([silence, silence, silence, *steady]))
    assert device.read().received_s < 100.0 + 3.0 * stream.READ_S + 2.0 * stream.SETTLING_S


@pytest.mark.parametrize("script", [[(0.0, False)], [(stream.READ_S, False)] * 20])
def test_a_stream_that_ends_or_stays_silent_as_it_opens_gives_no_video(
    opened: Opened, script: list[tuple[float, bool]]
) -> None:
    capture = ScriptedCapture(script)
    with pytest.raises(DeviceMissing, match="its host answers, but gives no video"):
        opened(capture)
    assert capture.released
    assert capture.now_s() - 100.0 <= stream.OPEN_S


def test_what_was_queued_as_a_stream_opened_is_passed_over(opened: Opened) -> None:
    burst, steady = [(0.002, True)] * 30, [(1 / 30, True)] * 20
    capture = ScriptedCapture([*burst, *steady])
    device = opened(capture)
    before_s = capture.now_s()
    assert device.read().received_s == pytest.approx(before_s + 1 / 30)


def test_what_a_link_held_up_is_passed_over(opened: Opened) -> None:
    """A stall of 0.8 s, then the pictures of meanwhile, 5 ms each; the last of them is in time again."""
    script = [(1 / 30, True)] * 60 + [(0.8, True)] + [(0.005, True)] * 26 + [(1 / 30, True)] * 20
    capture, count = ScriptedCapture(script.copy()), len(script)
    device = opened(capture)
    errors_s = []
    while script_left := capture.left:
        shot = device.read()
        made_s = 100.0 + (count - capture.left) / 30
        errors_s.append(shot.time_s + LATENCY_S - made_s)
        assert capture.left < script_left
    assert len(errors_s) > 60
    assert max(map(abs, errors_s)) < 0.035


def test_the_packet_that_is_probed_of_an_rtsp_stream_is_kept(opened: Opened) -> None:
    capture = ScriptedCapture([(1 / 30, True)] * 20)
    opened(capture)
    assert "nobuffer" not in capture.options  # it would be the key frame
    assert "probesize;32" in capture.options
    assert "rtsp_transport;tcp" in capture.options
    assert "allowed_media_types;video" in capture.options  # not a camera's sound
    assert stream.OPTIONS_VARIABLE not in os.environ


async def until_it_fails(source: FrameSource) -> None:
    while True:
        await asyncio.wait_for(source.next(), 10.0)


async def test_frames_of_an_http_camera_are_stamped_by_their_arrival_less_the_settings_delay(
    camera: CameraConfig,
) -> None:
    with mjpeg_server(stamped_jpegs) as port:
        source = await open_camera(f"http://user:secret@127.0.0.1:{port}/video", camera, LATENCY_S)
        frames = [await source.next() for _ in range(stream.RHYTHM_FRAMES + 2)]
        source.close()
    assert [frame.received_s - frame.time_s for frame in frames] == pytest.approx([LATENCY_S] * len(frames))
    assert frames[0].image.shape == (480, 640)
    (note,) = source.take_notes()
    assert "250 ms old on arrival (sense.vision.unstamped_latency_s)" in note
    assert "secret" not in note


async def test_only_the_newest_frame_of_a_stream_is_handed_on(camera: CameraConfig) -> None:
    with mjpeg_server(stamped_jpegs) as port:
        source = await open_camera(f"http://127.0.0.1:{port}/", camera)
        await source.next()
        await asyncio.sleep(1.0)  # thirty come meanwhile
        late = await source.next()
        following = await source.next()
        source.close()
    assert late.sequence > 10
    assert following.sequence > late.sequence
    assert age_s(following.image, following.received_s) < 0.5  # of now: nothing was queued meanwhile


async def first_since(kept: KeptCamera, since_s: float) -> Frame:
    async with asyncio.timeout(30.0):
        while (frame := await kept.next()).received_s < since_s:
            pass
    kept.close()
    return frame


async def test_a_stream_that_went_is_opened_anew(camera: CameraConfig) -> None:
    with mjpeg_server(stamped_jpegs) as port:
        kept = await keep_camera(f"http://127.0.0.1:{port}/", camera, LATENCY_S)
        first = await kept.next()
    async with asyncio.timeout(20.0):
        while "closed it, or stalls" not in (await kept.report()).text:
            pass
    with mjpeg_server(stamped_jpegs, port):
        frame = await first_since(kept, asyncio.get_running_loop().time())
    assert frame.sequence > first.sequence
    assert LONGEST_PAUSE_S + stream.CONNECT_S <= 2.0  # a host that is away is asked again within that


@pytest.mark.slow
@pytest.mark.parametrize("away_s", [0.5, 2.0, 4.0])
@pytest.mark.parametrize("scheme", ["http", "rtsp"])
async def test_a_stream_is_back_within_two_seconds_of_its_server(
    camera: CameraConfig, scheme: str, away_s: float
) -> None:
    def server(port: int = 0) -> AbstractContextManager[int]:
        return (
            mjpeg_server(stamped_jpegs, port) if scheme == "http" else rtsp_server(stamped_pictures(), port)
        )

    with server() as port:
        kept = await keep_camera(f"{scheme}://127.0.0.1:{port}/camera", camera, LATENCY_S)
        await kept.next()
    await asyncio.sleep(away_s)
    with server(port):
        back_s = asyncio.get_running_loop().time()
        frame = await first_since(kept, back_s)
    print(f"away for {away_s:g} s, back after {frame.received_s - back_s:.2f} s")
    assert frame.received_s - back_s < 2.0


@pytest.mark.parametrize("scheme", ["http", "rtsp"])
async def test_an_app_ends_while_a_server_keeps_the_opening_waiting(
    scheme: str, camera: CameraConfig
) -> None:
    with silent_server() as port:
        opening = asyncio.ensure_future(open_camera(f"{scheme}://127.0.0.1:{port}/", camera))
        await asyncio.sleep(0.3)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asyncio.wait_for(opening, 10.0)


async def test_a_server_that_answers_and_gives_no_video_is_said(
    camera: CameraConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "OPEN_S", 0.5)
    with (
        silent_server(b"HTTP/1.0 404 Not Found\r\n\r\n") as port,
        pytest.raises(ConfigError, match="its host answers, but gives no video") as found,
    ):
        await open_camera(f"http://user:secret@127.0.0.1:{port}/video?pwd=hidden", camera)
    assert "secret" not in str(found.value)
    assert "hidden" not in str(found.value)
    assert "user" in str(found.value)


async def test_a_stream_that_stalls_is_lost_and_can_be_closed(
    camera: CameraConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "READ_S", 0.3)
    picture = cv2.imencode(".jpg", stamped_picture(0))[1].tobytes()
    part = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(picture) + picture
    head = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"
    with silent_server(head + 60 * (part + b"\r\n")) as port:
        source = await open_camera(f"http://127.0.0.1:{port}/", camera)
        with pytest.raises(OSError, match="closed it, or stalls"):
            await until_it_fails(source)
        source.close()
        assert not source.held


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("rtsp://", "expected v4l2:NUMBER"),
        ("rtsp:///live", "no address; expected SCHEME://HOST:PORT/PATH"),
        ("http://127.0.0.1:99999/video", "no address; expected SCHEME://HOST:PORT/PATH"),
        (
            "rtsp://operator:secret@127.0.0.1:1/live",
            "rtsp://operator:***@127.0.0.1:1/live: Connection refused",
        ),
        ("ftp://operator:secret@host/live", "'ftp://operator:***@host/live'; expected v4l2:NUMBER"),
    ],
)
async def test_an_address_that_cannot_be_is_said_in_one_line(
    spec: str, said: str, camera: CameraConfig
) -> None:
    with pytest.raises(ConfigError) as found:
        await open_camera(spec, camera)
    assert said in str(found.value)
    assert "secret" not in str(found.value)
    assert "\n" not in str(found.value)


async def test_a_pipeline_needs_an_opencv_with_gstreamer(camera: CameraConfig) -> None:
    if cv2.videoio_registry.hasBackend(cv2.CAP_GSTREAMER):
        pytest.skip("this OpenCV has GStreamer")
    with pytest.raises(ConfigError, match="built without GStreamer; expected the distribution's"):
        await open_camera("gstreamer:videotestsrc ! appsink", camera)


def test_what_is_a_stream_is_a_camera() -> None:
    assert is_camera("rtsp://192.168.1.10/live")
    assert is_camera("gstreamer:udpsrc port=5600 ! appsink")


@pytest.mark.parametrize(
    ("source", "shown"),
    [
        ("rtsp://10.0.0.2:8554/live", "rtsp://10.0.0.2:8554/live"),
        ("rtsp://admin:pa@ss/w:rd@10.0.0.2/live", "rtsp://admin:***@10.0.0.2/live"),
        ("http://10.0.0.2/video.cgi?user=admin&pwd=secret", "http://10.0.0.2/video.cgi?***"),
        (
            "gstreamer:rtspsrc location=rtsp://a:b@h/x ! appsink",
            "gstreamer:rtspsrc location=rtsp://a:***@h/x ! appsink",
        ),
        ("images:frames?old", "images:frames?old"),
    ],
)
def test_a_password_is_not_shown(source: str, shown: str) -> None:
    assert without_password(source) == shown


def test_a_password_is_not_recorded_with_the_settings() -> None:
    source = "rtsp://admin:secret@10.0.0.2/live"
    config = validate(CompanionConfig, {"sense": {"vision": {"source": source}}}, "test")
    assert "secret" not in config.model_dump_json()
    assert config.sense.vision.source == source
    assert config.sense.vision.shown_source == "rtsp://admin:***@10.0.0.2/live"


@pytest.mark.slow
async def test_an_rtsp_stream_is_read_without_a_queue(camera: CameraConfig) -> None:
    with rtsp_server(stamped_pictures()) as port:
        source = await open_camera(f"rtsp://127.0.0.1:{port}/camera", camera, LATENCY_S)
        ages_s = []
        for _ in range(90):
            frame = await source.next()
            ages_s.append(age_s(frame.image, frame.received_s))
        source.close()
    print(f"frames {1e3 * np.median(ages_s):.0f} ms old as they come, the first {1e3 * ages_s[0]:.0f} ms")
    # decoding holds nothing back: at 30 frames/s a queue of a few would be 0.1 s and more
    assert np.median(ages_s) < 0.1
