"""The Raspberry Pi's camera with a module of our own in picamera2's place."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.clock import Clock
from companion.config import CameraConfig, ConfigError
from companion.sense.camera import picamera as camera_picamera2
from companion.sense.camera.picamera import SETTLED_FRAMES, Picamera2Device
from companion.sense.camera.source import keep_camera, open_camera
from tests.unit.sense.camera.camera_frames import noisy

PADDED = 704  # bytes of a row, as its ISP likes them


class FakePi:
    """picamera2.Picamera2 with one camera: remembers what it was told, and says what it is told to."""

    made: list[FakePi]
    mode = (1640, 1232)

    def __init__(self, number: int = 0) -> None:
        if number > 0:
            raise RuntimeError("Camera __init__ sequence did not complete.")
        self.camera_controls: dict[str, Any] = {"ColourGains": (), "AfMode": (), "LensPosition": ()}
        self.started = self.closed = self.stalled = self.waiting = False
        self.released = self.taken = 0
        self.metadata: dict[str, Any] = {}
        self.video: dict[str, Any] = {}
        self.scene: Callable[[int], NDArray[np.uint8]] = noisy
        FakePi.made.append(self)

    def create_video_configuration(self, **wanted: Any) -> dict[str, Any]:
        return wanted

    def in_its_colour_space(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Unless it is told, picamera2 takes a colour space of limited range for video."""
        if self.video.get("colour_space") == "sYCC":
            return image
        return np.asarray(np.rint(16.0 + image * (219.0 / 255.0)), np.uint8)

    def configure(self, wanted: dict[str, Any]) -> None:
        self.video = wanted

    def camera_configuration(self) -> dict[str, Any]:
        return {**self.video, "sensor": {"bit_depth": 10, "output_size": self.mode}}

    def start(self) -> None:
        self.started = True

    def stop(self) -> None:
        assert not self.waiting  # the real one would wait behind the frame that does not come
        self.started = False

    def close(self) -> None:
        self.closed = True

    def cancel_all_and_flush(self) -> None:
        self.waiting = False

    def capture_request(self, wait: float | None = None) -> SimpleNamespace:
        time.sleep(0.005)
        if self.stalled:
            self.waiting = True
            while wait is None:
                time.sleep(1.0)
            raise TimeoutError
        self.taken += 1
        width, height = self.video["main"]["size"]
        planes = np.full((height * 3 // 2, PADDED), 128, np.uint8)
        planes[:height, :width] = self.in_its_colour_space(self.scene(self.taken))
        metadata = {
            "SensorTimestamp": time.monotonic_ns() - 20_000_000,
            "ExposureTime": 3987,
            "AnalogueGain": 4.0,
            **self.metadata,
        }

        def release() -> None:
            self.released += 1

        return SimpleNamespace(make_array=lambda _: planes, get_metadata=lambda: metadata, release=release)


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> None:
    """picamera2, installed."""
    FakePi.made = []
    module = ModuleType("picamera2")
    module.Picamera2 = FakePi  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "picamera2", module)
    libcamera = ModuleType("libcamera")
    libcamera.ColorSpace = SimpleNamespace(Sycc=lambda: "sYCC")  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "libcamera", libcamera)


async def opened(camera: CameraConfig, **changes: Any) -> tuple[Picamera2Device, FakePi]:
    device = Picamera2Device(0, camera.model_copy(update=changes), Clock())
    return device, FakePi.made[-1]


@pytest.mark.usefixtures("module")
async def test_exposure_and_gain_are_fixed_by_value_and_the_automatic_is_not_touched(
    camera: CameraConfig,
) -> None:
    _, pi = await opened(camera, gain=4.0, focus=1.5)
    assert pi.started
    assert pi.video["main"] == {"size": (640, 480), "format": "YUV420"}
    assert pi.video["controls"] == {
        "FrameDurationLimits": (33333, 33333),
        "ExposureTime": 4000,
        "AnalogueGain": 4.0,
        "ColourGains": (1.0, 1.0),
        "AfMode": 0,
        "LensPosition": 1.5,
    }


@pytest.mark.usefixtures("module")
async def test_without_a_gain_it_stays_automatic(camera: CameraConfig) -> None:
    _, pi = await opened(camera)
    assert "AnalogueGain" not in pi.video["controls"]
    assert "LensPosition" not in pi.video["controls"]


@pytest.mark.usefixtures("module")
@pytest.mark.parametrize(
    ("taken", "notes"),
    [((1640, 1232), []), ((640, 480), ["sensor mode 1640x1232 asked for, libcamera took 640x480"])],
)
async def test_the_sensor_s_mode_may_be_chosen_and_is_read_back(
    camera: CameraConfig, taken: tuple[int, int], notes: list[str]
) -> None:
    FakePi.mode = taken
    device, pi = await opened(camera, sensor_mode_px=(1640, 1232))
    assert pi.video["sensor"] == {"output_size": (1640, 1232)}
    assert list(device.notes) == notes


@pytest.mark.usefixtures("module")
async def test_black_is_0_and_white_that_is_cut_off_255(camera: CameraConfig) -> None:
    device, pi = await opened(camera)
    halves = np.full((480, 640), 255, np.uint8)
    halves[:240] = 0
    pi.scene = lambda _: halves
    np.testing.assert_array_equal(device.read().image, halves)


@pytest.mark.usefixtures("module")
async def test_the_grey_plane_is_cut_out_of_its_padding(camera: CameraConfig) -> None:
    device, pi = await opened(camera)
    shot = device.read()
    assert np.array_equal(shot.image, noisy(1))
    assert shot.image.flags.c_contiguous
    assert pi.released == 1


@pytest.mark.usefixtures("module")
@pytest.mark.parametrize("suspended_s", [0.0, 5000.0])
async def test_the_stamp_is_the_end_of_the_first_row_s_exposure_by_either_clock(
    camera: CameraConfig, suspended_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_picamera2, "boot_clock_ahead_s", lambda: suspended_s)
    device, pi = await opened(camera)
    stamp_s = time.monotonic() - 0.02
    pi.metadata["SensorTimestamp"] = round(1e9 * (stamp_s + suspended_s))
    shot = device.read()
    assert shot.time_s == pytest.approx(stamp_s + 0.5 * camera.readout_s - 0.5 * 3987e-6, abs=1e-6)
    assert shot.received_s > stamp_s


@pytest.mark.usefixtures("module")
async def test_what_libcamera_made_of_the_settings_is_read_back_and_reported_once(
    camera: CameraConfig,
) -> None:
    device, pi = await opened(camera, gain=8.0)
    pi.metadata |= {"ExposureTime": 9990, "AnalogueGain": 1.5}
    for _ in range(2 * SETTLED_FRAMES):
        device.read()
    assert str(device.read_back) == "exposure 9.99 ms, gain 1.5"
    assert list(device.notes) == [
        "exposure of 4.0 ms asked for, libcamera says 10.0 ms",
        "gain 8 asked for, libcamera says 1.5",
    ]


@pytest.mark.usefixtures("module")
async def test_a_sensor_s_own_steps_are_no_reason_to_complain(camera: CameraConfig) -> None:
    device, _ = await opened(camera, gain=4.2)
    for _ in range(2 * SETTLED_FRAMES):
        device.read()
    assert list(device.notes) == []


@pytest.mark.usefixtures("module")
async def test_a_size_that_libcamera_rounded_is_refused_and_the_camera_closed(camera: CameraConfig) -> None:
    class Rounding(FakePi):
        def camera_configuration(self) -> dict[str, Any]:
            return {"main": {"size": (640, 478)}}

    sys.modules["picamera2"].Picamera2 = Rounding  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match="640x478, expected the calibration's 640x480"):
        await open_camera("picamera2:0", camera)
    assert FakePi.made[-1].closed


@pytest.mark.usefixtures("module")
async def test_frames_come_through_and_closing_gives_the_camera_back(camera: CameraConfig) -> None:
    kept = await keep_camera("picamera2:0", camera)
    first = await asyncio.wait_for(kept.next(), 5.0)
    second = await asyncio.wait_for(kept.next(), 5.0)
    assert second.time_s > first.time_s
    assert kept.read_back.gain == 4.0
    kept.close()
    assert FakePi.made[-1].closed


@pytest.mark.usefixtures("module")
async def test_a_camera_that_stalls_is_given_back_and_does_not_hold_its_thread(camera: CameraConfig) -> None:
    source = await open_camera("picamera2:0", camera)
    await asyncio.wait_for(source.next(), 5.0)
    FakePi.made[-1].stalled = True

    async def watch() -> None:
        while True:
            await source.next()

    with pytest.raises(OSError, match="no frame in 2 s"):
        await asyncio.wait_for(watch(), 5.0)
    source.close()
    assert FakePi.made[-1].closed
    assert not FakePi.made[-1].started


@pytest.mark.usefixtures("module")
async def test_a_camera_that_cannot_be_stopped_is_closed_all_the_same(camera: CameraConfig) -> None:
    class Gone(FakePi):
        def stop(self) -> None:
            raise RuntimeError("Camera frontend has timed out!")

    sys.modules["picamera2"].Picamera2 = Gone  # type: ignore[attr-defined]
    source = await open_camera("picamera2:0", camera)
    source.close()
    assert FakePi.made[-1].closed


@pytest.mark.usefixtures("module")
async def test_a_camera_that_is_not_there_is_one_line(camera: CameraConfig) -> None:
    with pytest.raises(ConfigError) as caught:
        await open_camera("picamera2:3", camera)
    assert "picamera2:3" in str(caught.value)
    assert "rpicam-hello --list-cameras" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("module")
async def test_whatever_else_libcamera_refuses_is_one_line_and_the_camera_is_closed(
    camera: CameraConfig,
) -> None:
    class WithoutExposure(FakePi):
        def configure(self, wanted: dict[str, Any]) -> None:
            raise RuntimeError("Control ExposureTime is not advertised by libcamera")

    sys.modules["picamera2"].Picamera2 = WithoutExposure  # type: ignore[attr-defined]
    assert "ExposureTime is not advertised" in await refusal(camera)
    assert FakePi.made[-1].closed


async def refusal(camera: CameraConfig) -> str:
    with pytest.raises(ConfigError) as caught:
        await open_camera("picamera2:0", camera)
    assert "\n" not in str(caught.value)
    return str(caught.value)


async def test_without_picamera2_one_line_says_what_to_install(
    camera: CameraConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "picamera2", None)
    assert "sudo apt install python3-picamera2" in await refusal(camera)


async def test_a_picamera2_that_does_not_fit_our_numpy_is_one_line_too(
    camera: CameraConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Misfit(ModuleType):
        def __getattr__(self, name: str) -> Any:
            raise ValueError("numpy.dtype size changed, may indicate binary incompatibility")

    monkeypatch.setitem(sys.modules, "picamera2", Misfit("picamera2"))
    assert "pip install simplejpeg" in await refusal(camera)
