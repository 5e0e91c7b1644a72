"""A V4L2 camera with OpenCV's part replaced: setting up, reading back, stamps, and every way to fail."""

import asyncio
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from companion.base.clock import Clock
from companion.base.errors import DeviceMissing
from companion.config import CameraConfig, ConfigError
from companion.sense.camera import keeper, v4l2
from companion.sense.camera.reader import ThreadedCamera
from companion.sense.camera.source import is_camera, keep_camera, open_camera
from companion.sense.camera.v4l2 import MOST_FAILURES, V4l2Device, device_number, driver_name, stamp_point
from tests.unit.sense.camera.camera_frames import noisy

SIZE = {cv2.CAP_PROP_FRAME_WIDTH: 640.0, cv2.CAP_PROP_FRAME_HEIGHT: 480.0}
# what a USB camera has when it is plugged in: everything automatic
PLUGGED_IN = {
    **SIZE,
    cv2.CAP_PROP_FPS: 30.0,
    cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"YUYV")),
    cv2.CAP_PROP_BUFFERSIZE: 4.0,
    cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
    cv2.CAP_PROP_EXPOSURE: 157.0,
    cv2.CAP_PROP_AUTO_WB: 1.0,
    cv2.CAP_PROP_GAIN: 64.0,
}


class FakeVideo:
    """cv2.VideoCapture on a camera that takes what its driver takes, and gives what `act` says."""

    def __init__(self, act: Callable[[int], Any], stubborn: tuple[int, ...] = ()) -> None:
        """`act` gets the number of the frame; `stubborn` are controls that stay as they are."""
        self._act, self._stubborn = act, stubborn
        self.values = dict(PLUGGED_IN)
        self.number = 0
        self.stamp_s: float | None = None  # None: this moment
        self.released = threading.Event()

    def isOpened(self) -> bool:
        return True

    def read(self) -> tuple[bool, Any]:
        image = self._act(self.number)
        self.number += 1
        return image is not None, image

    def get(self, propId: int) -> float:
        if propId == cv2.CAP_PROP_POS_MSEC:
            return 1e3 * (time.monotonic() if self.stamp_s is None else self.stamp_s)
        return self.values.get(propId, -1.0)

    def set(self, propId: int, value: float) -> bool:
        if propId not in self.values or propId in self._stubborn:
            return False
        self.values[propId] = value
        return True

    def release(self) -> None:
        self.released.set()


def paced(number: int) -> Any:
    """A grey picture in colour, at a hundred frames a second."""
    time.sleep(0.01)
    return np.dstack([noisy(number)] * 3)


Install = Callable[..., FakeVideo]


@pytest.fixture
def plug_in(monkeypatch: pytest.MonkeyPatch) -> Install:
    """Put a fake in the place of OpenCV's."""

    def plug_in(act: Callable[[int], Any] = paced, stubborn: tuple[int, ...] = ()) -> FakeVideo:
        video = FakeVideo(act, stubborn)
        monkeypatch.setattr(cv2, "VideoCapture", lambda *_: video)
        return video

    return plug_in


async def device(camera: CameraConfig) -> V4l2Device:
    return V4l2Device(0, camera, Clock())


async def test_exposure_gain_and_white_balance_are_fixed_and_read_back(
    camera: CameraConfig, plug_in: Install
) -> None:
    video = plug_in()
    opened = await device(camera.model_copy(update={"gain": 32.0, "pixel_format": "MJPG"}))
    assert video.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    assert video.values[cv2.CAP_PROP_EXPOSURE] == 40  # 4 ms in units of 100 µs
    assert video.values[cv2.CAP_PROP_AUTO_WB] == 0
    assert video.values[cv2.CAP_PROP_GAIN] == 32
    assert video.values[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter.fourcc(*"MJPG")
    assert str(opened.read_back) == "exposure 4.00 ms, gain 32"
    assert list(opened.notes) == []


async def test_a_gain_that_is_not_asked_for_is_left_alone_and_read_back(
    camera: CameraConfig, plug_in: Install
) -> None:
    assert plug_in().values[cv2.CAP_PROP_GAIN] == 64
    assert (await device(camera)).read_back.gain == 64


@pytest.mark.parametrize(
    ("stubborn", "told"),
    [
        (cv2.CAP_PROP_AUTO_EXPOSURE, "did not switch its automatic exposure off"),
        (cv2.CAP_PROP_EXPOSURE, "exposure of 4.0 ms asked for, the driver says 15.7 ms"),
        (cv2.CAP_PROP_AUTO_WB, "did not switch its automatic white balance off"),
        (cv2.CAP_PROP_GAIN, "gain 32 asked for, the driver says 64"),
        (cv2.CAP_PROP_FOURCC, "did not take pixel_format MJPG"),
    ],
)
async def test_what_the_driver_did_not_take_is_one_line(
    camera: CameraConfig, plug_in: Install, stubborn: int, told: str
) -> None:
    plug_in(stubborn=(stubborn,))
    opened = await device(camera.model_copy(update={"gain": 32.0, "pixel_format": "MJPG"}))
    (note,) = opened.notes
    assert told in note


async def test_a_control_that_the_driver_has_not_got_is_reported_only_when_it_is_wanted(
    camera: CameraConfig, plug_in: Install
) -> None:
    plug_in()
    assert list((await device(camera)).notes) == []
    assert list((await device(camera.model_copy(update={"focus": 10.0}))).notes) == [
        "focus 10 asked for, the driver has none"
    ]


async def test_a_rate_that_the_driver_does_not_make_is_reported(
    camera: CameraConfig, plug_in: Install
) -> None:
    plug_in(stubborn=(cv2.CAP_PROP_FPS,)).values[cv2.CAP_PROP_FPS] = 10.0
    assert "30 frames/s asked for, the driver says 10" in (await device(camera)).notes[0]


async def test_another_size_than_asked_for_is_refused_and_the_camera_released(
    camera: CameraConfig, plug_in: Install
) -> None:
    video = plug_in(stubborn=(cv2.CAP_PROP_FRAME_WIDTH,))
    video.values[cv2.CAP_PROP_FRAME_WIDTH] = 1280.0
    with pytest.raises(ConfigError, match="images of 1280x480, expected the calibration's 640x480"):
        await open_camera("v4l2:0", camera)
    assert video.released.is_set()


async def test_opencv_s_wait_for_a_frame_is_cut_to_a_second(
    camera: CameraConfig, plug_in: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(v4l2.WAIT_VARIABLE, raising=False)
    plug_in()
    await device(camera)
    assert os.environ[v4l2.WAIT_VARIABLE] == "1"


async def test_a_frame_becomes_grey_and_is_stamped_with_the_exposure_that_was_read_back(
    camera: CameraConfig, plug_in: Install
) -> None:
    video = plug_in(lambda _: np.full((480, 640, 3), 90, np.uint8), stubborn=(cv2.CAP_PROP_EXPOSURE,))
    video.stamp_s = time.monotonic() - 0.01
    shot = (await device(camera)).read()
    assert shot.image.shape == (480, 640)
    assert int(shot.image[0, 0]) == 90
    # no uvcvideo behind it: its stamp is the end of the readout
    assert shot.time_s == pytest.approx(video.stamp_s - 0.5 * camera.readout_s - 0.5 * 0.0157)


@pytest.mark.parametrize(
    ("driver", "setting", "point"),
    [
        ("uvcvideo", "auto", "start_of_readout"),
        ("unicam", "auto", "end_of_readout"),
        ("", "auto", "end_of_readout"),
        ("uvcvideo", "start_of_exposure", "start_of_exposure"),
    ],
)
def test_which_moment_a_stamp_is(camera: CameraConfig, driver: str, setting: str, point: str) -> None:
    assert stamp_point(camera.model_copy(update={"stamped_at": setting}), driver) == point


def test_the_driver_s_name_is_the_kernel_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "drivers" / "uvcvideo").mkdir(parents=True)
    (tmp_path / "video2" / "device").mkdir(parents=True)
    (tmp_path / "video2" / "device" / "driver").symlink_to(tmp_path / "drivers" / "uvcvideo")
    monkeypatch.setattr(v4l2, "DRIVERS", tmp_path)
    assert driver_name(2) == "uvcvideo"


async def test_a_single_frame_that_cannot_be_had_is_passed_over(
    camera: CameraConfig, plug_in: Install
) -> None:
    plug_in(lambda number: None if number < MOST_FAILURES - 1 else noisy(number))
    assert (await device(camera)).read().image.shape == (480, 640)


async def test_a_camera_that_stops_is_an_error_and_not_silence(
    camera: CameraConfig, plug_in: Install
) -> None:
    video = plug_in(lambda number: noisy(number) if number < 3 else None)
    source = await open_camera("v4l2:0", camera)

    async def until_it_fails() -> None:
        while True:
            await source.next()

    with pytest.raises(OSError, match="unplugged, or it hangs"):
        await asyncio.wait_for(until_it_fails(), 5.0)
    source.close()
    assert video.released.is_set()


async def test_a_camera_that_stalls_is_waited_for_once(camera: CameraConfig, plug_in: Install) -> None:
    asked: list[int] = []

    def stalled(number: int) -> Any:
        asked.append(number)
        time.sleep(1.0)

    plug_in(stalled)
    source = await open_camera("v4l2:0", camera)
    with pytest.raises(OSError, match="no frames any more"):
        await asyncio.wait_for(source.next(), 5.0)
    assert len(asked) == 1


async def test_whatever_a_driver_raises_while_it_is_set_up_the_camera_is_released(
    camera: CameraConfig, plug_in: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> float:
        raise cv2.error("gone")

    video = plug_in()
    monkeypatch.setattr(V4l2Device, "_choose_exposure", broken)
    with pytest.raises(ConfigError, match="gone"):
        await open_camera("v4l2:0", camera)
    assert video.released.is_set()


async def test_whatever_a_driver_raises_is_a_camera_that_is_gone(
    camera: CameraConfig, plug_in: Install
) -> None:
    def broken(_: int) -> Any:
        raise cv2.error("assertion failed")

    plug_in(broken)
    source = await open_camera("v4l2:0", camera)
    with pytest.raises(OSError, match="assertion failed"):
        await asyncio.wait_for(source.next(), 5.0)


async def test_a_driver_that_sends_another_size_than_it_promised_is_reported(
    camera: CameraConfig, plug_in: Install
) -> None:
    plug_in(lambda _: np.zeros((720, 1280, 3), np.uint8))
    source = await open_camera("v4l2:0", camera)
    with pytest.raises(ConfigError, match="images of 1280x720, expected the calibration's 640x480"):
        await asyncio.wait_for(source.next(), 5.0)


async def test_an_opening_that_is_given_up_closes_the_camera_when_it_does_open(
    camera: CameraConfig, plug_in: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    may_open = threading.Event()
    video = plug_in()
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: may_open.wait(5.0) and video)
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(open_camera("v4l2:0", camera), 0.02)
    may_open.set()
    assert await asyncio.to_thread(video.released.wait, 5.0)


async def test_a_read_that_hangs_is_left_behind_and_the_camera_opened_anew(
    camera: CameraConfig, plug_in: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time is real here: a thread that does not come back cannot be pretended."""
    monkeypatch.setattr(keeper, "LETTING_GO_S", 0.05)
    hung, may_return = threading.Event(), threading.Event()

    def hang_once(number: int) -> Any:
        if number == 10 and not hung.is_set():
            hung.set()
            may_return.wait(20.0)
        return paced(number)

    plug_in(hang_once)
    kept = await keep_camera("v4l2:0", camera)
    try:
        async with asyncio.timeout(10.0):
            while not hung.is_set():
                await kept.next()
            first = await kept.report()
            assert first.text == "camera: no frame for 0.25 s"
            assert kept.problem is not None
            again = await kept.report()
        assert "frames again" in again.text
        assert not may_return.is_set()
        assert any(thread.name == "camera" and thread.daemon for thread in threading.enumerate())
    finally:
        kept.close()
        may_return.set()


async def test_closing_ends_the_thread_and_gives_the_camera_back(
    camera: CameraConfig, plug_in: Install
) -> None:
    video = plug_in()
    source = await open_camera("v4l2:0", camera)
    assert isinstance(source, ThreadedCamera)
    await source.next()
    source.close()
    assert video.released.is_set()
    assert not source.held


def test_a_camera_by_its_link_is_the_device_it_points_to_now(tmp_path: Path) -> None:
    link = tmp_path / "usb-046d_0825-video-index0"
    link.symlink_to("/dev/video3")
    assert device_number(str(link)) == 3
    link.unlink()
    link.symlink_to("/dev/video12")  # after another start
    assert device_number(str(link)) == 12
    assert device_number("7") == 7
    with pytest.raises(DeviceMissing, match="ls /dev/v4l/by-id"):
        device_number(str(tmp_path / "unplugged"))


def test_a_path_names_a_source_of_frames() -> None:
    assert is_camera("v4l2:/dev/v4l/by-id/usb-046d_0825_B862FCA0-video-index0")
    assert is_camera("v4l2:/dev/v4l/by-path/platform-xhci-usb-0:1:1.0-video-index0")
    assert not is_camera("v4l2:webcam")
