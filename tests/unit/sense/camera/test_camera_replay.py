"""Recordings as cameras: each frame when it is due, stamped by the recording's own times."""

import asyncio
import struct
import threading
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.clock import Clock
from companion.config import CameraConfig, ConfigError
from companion.sense.camera.photos import open_folder, open_video, read_photos, recorded_times
from companion.sense.camera.reader import EndOfFrames
from companion.sense.camera.source import keep_camera, open_camera
from tests.unit.sense.camera.camera_frames import noisy

RATE_HZ = 50.0


class ManualClock(Clock):
    """A clock that stands still until it is put on: a busy machine is no late reader."""

    time_s = 100.0

    def now_s(self) -> float:
        """The time."""
        return self.time_s


class WaitsByClock(threading.Event):
    """A wait that puts the clock on instead of waiting."""

    def __init__(self, clock: ManualClock) -> None:
        """Take the clock."""
        super().__init__()
        self._clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        """Let the time go by."""
        self._clock.time_s += timeout or 0.0
        return self.is_set()


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """Ten frames, each brighter than the last."""
    path = tmp_path / "flight.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), RATE_HZ, (640, 480))
    for number in range(10):
        image = np.clip(noisy(number).astype(int) + 10 * number - 60, 0, 255).astype(np.uint8)
        writer.write(np.dstack([image] * 3))
    writer.release()
    return path


def write(folder: Path, names: list[str]) -> None:
    folder.mkdir(exist_ok=True)
    for number, name in enumerate(names):
        cv2.imwrite(str(folder / name), noisy(number))


async def test_a_video_s_frames_are_stamped_by_its_frames_a_second(camera: CameraConfig, video: Path) -> None:
    clock = ManualClock()
    device = open_video(video, camera, clock, WaitsByClock(clock))
    shots = [device.read() for _ in range(10)]
    steps = np.diff([shot.time_s for shot in shots])
    assert steps == pytest.approx(np.full(9, 1 / RATE_HZ))
    assert [shot.received_s for shot in shots] == pytest.approx([shot.time_s for shot in shots])
    assert shots[-1].image.mean() > shots[0].image.mean() + 60
    assert shots[0].image.shape == (480, 640)
    with pytest.raises(EndOfFrames, match=r"flight\.avi has ended"):
        device.read()


async def test_a_recording_through_the_app_s_camera_ends_with_a_line(
    camera: CameraConfig, video: Path
) -> None:
    kept = await keep_camera(f"video:{video}", camera)
    report = await kept.report()
    assert report.text == "camera: flight.avi has ended"
    kept.close()


async def test_images_are_stamped_by_the_times_that_are_their_names(
    camera: CameraConfig, tmp_path: Path
) -> None:
    write(tmp_path, ["12.500000.png", "12.510000.png", "12.5300.png"])
    clock = ManualClock()
    device = open_folder(tmp_path, camera, clock, WaitsByClock(clock))
    shots = [device.read() for _ in range(3)]
    assert np.diff([shot.time_s for shot in shots]) == pytest.approx([0.01, 0.02])
    assert np.array_equal(shots[2].image, noisy(2))


@pytest.mark.parametrize(
    ("names", "times_s"),
    [
        (["9.5.png", "10.25.png"], [0.0, 0.75]),
        (["1700000000.123456789.png", "1700000000.123456999.png"], [0.0, 2.1e-7]),
        (["1403636579763555584.png", "1403636579813555456.png"], [0.0, 0.049999872]),
        (["frame-9.png", "frame-10.png", "frame-11.png"], [0.0, 0.1, 0.2]),
        (["0001.png", "0002.jpg"], [0.0, 0.1]),
    ],
)
def test_when_images_were_taken(names: list[str], times_s: list[float]) -> None:
    found = recorded_times([Path(name) for name in reversed(names)], 10.0)
    assert [path.name for _, path in found] == names
    assert [time_s for time_s, _ in found] == pytest.approx(times_s, abs=1e-12)


async def test_who_comes_late_misses_frames(camera: CameraConfig, tmp_path: Path) -> None:
    write(tmp_path, [f"{10 + 0.01 * k:.2f}.png" for k in range(6)])
    clock = ManualClock()
    device = open_folder(tmp_path, camera, clock, WaitsByClock(clock))
    first = device.read()
    clock.time_s += 0.08
    assert device.read().time_s == pytest.approx(first.time_s + 0.05)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"no image", "cannot be read"),
        (cv2.imencode(".png", np.zeros((120, 160), np.uint8))[1].tobytes(), "another size"),
    ],
    ids=["unreadable", "of another size"],
)
async def test_an_image_that_does_not_fit_is_reported_and_passed_over(
    content: bytes, said: str, camera: CameraConfig, tmp_path: Path
) -> None:
    write(tmp_path, ["1.png", "3.png"])
    (tmp_path / "2.png").write_bytes(content)
    device = open_folder(tmp_path, camera, Clock(), threading.Event())
    device.read()
    assert np.array_equal(device.read().image, noisy(1))
    assert said in device.notes[0]


def turned_image(path: Path, image: NDArray[np.uint8]) -> None:
    """With a note beside it (Exif's orientation 3) that it is to be shown upside down."""
    note = b"Exif\0\0MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, 3, 0, 0)
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    path.write_bytes(jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(note) + 2) + note + jpeg[2:])


def turned_video(path: Path, image: NDArray[np.uint8]) -> None:
    """With a matrix in its track's header that shows it upside down."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), RATE_HZ, (640, 480))
    writer.write(np.dstack([image] * 3))
    writer.release()
    data = bytearray(path.read_bytes())
    matrix = data.index(b"tkhd") + 44
    data[matrix : matrix + 36] = struct.pack(
        ">9i", -1 << 16, 0, 0, 0, -1 << 16, 0, 640 << 16, 480 << 16, 1 << 30
    )
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("name", "save"), [("1.jpg", turned_image), ("flight.mp4", turned_video)], ids=["images", "video"]
)
async def test_a_turn_that_is_noted_beside_a_picture_is_not_applied(
    name: str, save: Callable[[Path, NDArray[np.uint8]], None], camera: CameraConfig, tmp_path: Path
) -> None:
    white_above = np.zeros((480, 640), np.uint8)
    white_above[:240] = 255
    save(tmp_path / name, white_above)
    if name.endswith(".mp4"):
        played = open_video(tmp_path / name, camera, Clock(), threading.Event()).read().image
    else:
        played = open_folder(tmp_path, camera, Clock(), threading.Event()).read().image
    (photo,) = read_photos([tmp_path / name], pytest.fail)
    for image in (played, photo.image):
        assert image[:200].min() > 200
        assert image[280:].max() < 50


async def test_a_dark_recording_with_a_gap_is_neither_trouble_nor_played_again(
    camera: CameraConfig, tmp_path: Path
) -> None:
    dark = np.zeros((480, 640), np.uint8)
    for time_s in (1.0, 1.1, 2.4, 2.5):
        cv2.imwrite(str(tmp_path / f"{time_s}.png"), dark)
    kept = await keep_camera(f"images:{tmp_path}", camera)
    report = await asyncio.wait_for(kept.report(), 10.0)
    assert report.text == f"camera: {tmp_path.name} has ended"
    kept.close()


async def test_a_wait_for_a_frame_that_is_long_in_coming_ends_with_the_camera(
    camera: CameraConfig, tmp_path: Path
) -> None:
    write(tmp_path, ["1.0.png", "1000.0.png"])
    source = await open_camera(f"images:{tmp_path}", camera)
    await source.next()
    source.close()
    assert not source.held


@pytest.mark.parametrize("kind", ["video", "images"])
async def test_a_recording_that_is_not_there_is_one_line(
    kind: str, camera: CameraConfig, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError) as caught:
        await open_camera(f"{kind}:{tmp_path / 'nothing'}", camera)
    assert f"{kind}:{tmp_path / 'nothing'}" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("names", [["1.png"], ["1.png", "2.png", "3.png"]])
async def test_a_folder_whose_images_all_are_broken_does_not_open(
    camera: CameraConfig, tmp_path: Path, names: list[str]
) -> None:
    for name in names:
        (tmp_path / name).write_bytes(b"no image")
    kept = await keep_camera(f"images:{tmp_path}", camera)
    with pytest.raises(ConfigError, match="none of its frames can be read; expected images of 640x480"):
        await asyncio.wait_for(kept.next(), 5.0)
    kept.close()


async def test_a_video_of_another_size_is_refused(camera: CameraConfig, video: Path) -> None:
    wider = camera.model_copy(update={"width_px": 1280})
    with pytest.raises(ConfigError, match="640x480, expected the calibration's 1280x480"):
        await open_camera(f"video:{video}", wider)
