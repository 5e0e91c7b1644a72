"""Where frames come from: a V4L2 camera, or another process on a local socket.

The newest frame wins: whoever is slow misses frames and never works through old ones. `Frame.time_s` is
mid-exposure of the image's middle row on the loop's clock (CLOCK_MONOTONIC).

Sources, as in `sense.vision.source`: "v4l2:0" (/dev/video0), "socket:/run/companion/frames" and
"tcp:127.0.0.1:5600" (frames in the format of `companion.frame_format`).
"""

from __future__ import annotations

import asyncio
import threading
from dataclasses import replace
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.clock import Clock
from companion.config import CaptureConfig, ConfigError
from companion.frame_format import FrameHeader
from companion.frame_stream import ADDRESS_FORM, FrameStream
from companion.messages import Frame

V4L2_MANUAL_EXPOSURE: Final = 1
V4L2_EXPOSURE_UNIT_S: Final = 1e-4
# a driver's time stamp is believed when it is not from the future and not older than this
OLDEST_STAMP_S: Final = 0.5
# a frame from another process that is further off than this was stamped by another clock than ours
EARLIEST_FOREIGN_S: Final = 0.05
OLDEST_FOREIGN_S: Final = 5.0
# after good ones, so many frames in a row of a time that cannot be right
MOST_STRANGE: Final = 30


class FrameSource(Protocol):
    """A camera."""

    async def next(self) -> Frame:
        """Wait for a frame newer than the last one returned.

        Raises:
            OSError: the camera is gone.
            ConfigError: its images are not of the calibrated size.
        """

    def close(self) -> None:
        """Let go of the camera; `next` may not be called afterwards."""


class Capture(Protocol):
    """What is used of cv2.VideoCapture."""

    def read(self) -> tuple[bool, Any]: ...
    def get(self, propId: int) -> float: ...
    def set(self, propId: int, value: float) -> bool: ...
    def release(self) -> None: ...


async def open_camera(spec: str, camera: CaptureConfig, unstamped_latency_s: float = 0.0) -> FrameSource:
    """Open the source named by `spec`.

    `unstamped_latency_s` is how old a socket's frame without a time is when it has come.

    Raises:
        ConfigError: no such source; one line with what was expected.
    """
    kind, _, where = spec.partition(":")
    if kind == "v4l2" and where.isdigit():
        capture = await asyncio.to_thread(_open_v4l2, int(where), camera)
        return V4l2Camera(capture, camera, Clock())
    if ADDRESS_FORM.fullmatch(spec):
        return await SocketCamera.connect(spec, camera, unstamped_latency_s)
    raise ConfigError(f"sense.vision.source: '{spec}'; expected v4l2:NUMBER, socket:PATH or tcp:HOST:PORT")


class _Newest:
    """A slot for the newest frame, or for the reason why there will be none."""

    def __init__(self) -> None:
        self._frame: Frame | None = None
        self._error: Exception | None = None
        self._arrived = asyncio.Event()

    def put(self, frame: Frame) -> None:
        self._frame = frame
        self._arrived.set()

    def fail(self, error: Exception) -> None:
        self._error = error
        self._arrived.set()

    async def next(self) -> Frame:
        await self._arrived.wait()
        if self._frame is not None:
            frame, self._frame = self._frame, None
            if self._error is None:
                self._arrived.clear()
            return frame
        assert self._error is not None
        raise self._error


class SocketCamera:
    """Frames from another process, grey or in colour."""

    def __init__(
        self, stream: FrameStream, camera: CaptureConfig, unstamped_latency_s: float, clock: Clock
    ) -> None:
        self._stream = stream
        self._camera = camera
        self._unstamped_latency_s = unstamped_latency_s
        self._clock = clock
        self._newest = _Newest()
        self._task = asyncio.create_task(self._receive(), name="frames from the socket")

    @classmethod
    async def connect(cls, address: str, camera: CaptureConfig, unstamped_latency_s: float) -> SocketCamera:
        """Connect to whoever serves frames there.

        Raises:
            ConfigError: nobody does.
        """
        try:
            stream = await FrameStream.open(address)
        except (OSError, ValueError) as error:
            raise ConfigError(f"sense.vision.source: {error}") from error
        return cls(stream, camera, unstamped_latency_s, Clock())

    async def next(self) -> Frame:
        """See `FrameSource`."""
        return await self._newest.next()

    def close(self) -> None:
        """See `FrameSource`."""
        self._task.cancel()
        self._stream.close()

    async def _receive(self) -> None:
        """Frames as they come. One with a time that cannot be right is none, many in a row end them."""
        trusted, strange = False, 0
        try:
            while True:
                header = await self._stream.read_header()
                # before the image: what is of another size is not waited for
                _check_size(header.width_px, header.height_px, self._camera)
                image = await self._stream.read_image(header)
                received_s = self._clock.now_s()
                try:
                    time_s = self._exposure_s(header, received_s)
                except ConfigError as error:
                    strange += 1
                    if not trusted:
                        raise
                    if strange >= MOST_STRANGE:
                        raise OSError(str(error)) from error
                    continue
                trusted, strange = True, 0
                self._newest.put(Frame(time_s, received_s, header.sequence, _grey(image)))
        except (OSError, ConfigError) as error:
            self._newest.fail(error)

    def _exposure_s(self, header: FrameHeader, received_s: float) -> float:
        """When it was exposed on our clock; a frame without a time is as old as the settings say.

        Raises:
            ConfigError: the sender's clock is not CLOCK_MONOTONIC.
        """
        if header.time_s is None:
            return received_s - self._unstamped_latency_s
        age_s = received_s - header.time_s
        if not -EARLIEST_FOREIGN_S <= age_s <= OLDEST_FOREIGN_S:
            raise ConfigError(
                f"{self._stream.address}: a frame stamped {header.time_s:.3f} s came at {received_s:.3f} s; "
                "expected CLOCK_MONOTONIC at mid-exposure, or 0 where that is not known"
            )
        return header.time_s


class V4l2Camera:
    """A camera of the kernel's, read by a thread of its own because reading blocks."""

    def __init__(self, capture: Capture, camera: CaptureConfig, clock: Clock) -> None:
        self._capture = capture
        self._camera = camera
        self._clock = clock
        self._newest = _Newest()
        self._loop = asyncio.get_running_loop()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._read_all, name="camera", daemon=True)
        self._thread.start()

    async def next(self) -> Frame:
        """See `FrameSource`."""
        return await self._newest.next()

    def close(self) -> None:
        """See `FrameSource`. Waits for the frame that is being read, at most a second."""
        self._stop.set()
        self._thread.join(timeout=1.0)
        if not self._thread.is_alive():
            self._capture.release()

    def _read_all(self) -> None:
        sequence = 0
        while not self._stop.is_set():
            good, image = self._capture.read()
            if not good:
                self._loop.call_soon_threadsafe(
                    self._newest.fail, OSError("the camera stopped sending frames")
                )
                return
            received_s = self._clock.now_s()
            try:
                _check_size(image.shape[1], image.shape[0], self._camera)
            except ConfigError as error:  # a driver may promise one size and send another
                self._loop.call_soon_threadsafe(self._newest.fail, error)
                return
            stamp_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
            time_s = exposure_time_s(stamp_s, received_s, self._camera)
            frame = Frame(time_s, received_s, sequence, _grey(image))
            if not self._stop.is_set():
                self._loop.call_soon_threadsafe(self._newest.put, frame)
            sequence += 1


def at_exposure(frame: Frame, time_offset_s: float) -> Frame:
    """The frame with its stamp set right by the mount's calibration (`camera_time_offset_s`)."""
    return frame if time_offset_s == 0.0 else replace(frame, time_s=frame.time_s + time_offset_s)


def exposure_time_s(stamp_s: float, received_s: float, camera: CaptureConfig) -> float:
    """Mid-exposure of the middle row.

    V4L2 stamps a frame when its last row has been read out, which ends the last row's exposure; the middle
    row was read half a readout before. A driver without (believable) stamps leaves the time of receipt.
    """
    end_s = stamp_s if received_s - OLDEST_STAMP_S <= stamp_s <= received_s else received_s
    return end_s - 0.5 * camera.readout_s - 0.5 * camera.exposure_s


def _open_v4l2(number: int, camera: CaptureConfig) -> cv2.VideoCapture:
    """Open and set up a camera: short fixed exposure, so that light changes gain and never blur.

    Raises:
        ConfigError: no such camera, or it cannot make images of the calibrated size.
    """
    source = f"sense.vision.source: v4l2:{number}"
    capture = cv2.VideoCapture(number, cv2.CAP_V4L2)
    if not capture.isOpened():
        raise ConfigError(
            f"{source}: no camera at /dev/video{number}; expected one that is connected and free"
        )
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, camera.width_px)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, camera.height_px)
    capture.set(cv2.CAP_PROP_FPS, camera.rate_hz)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 2)
    capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, V4L2_MANUAL_EXPOSURE)
    capture.set(cv2.CAP_PROP_EXPOSURE, max(1, round(camera.exposure_s / V4L2_EXPOSURE_UNIT_S)))
    width = round(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
    height = round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
    try:
        _check_size(width, height, camera)
    except ConfigError:
        capture.release()
        raise
    return capture


def _check_size(width_px: int, height_px: int, camera: CaptureConfig) -> None:
    if (width_px, height_px) != (camera.width_px, camera.height_px):
        raise ConfigError(
            f"camera '{camera.name}': images of {width_px}x{height_px}, "
            f"expected {camera.size_is} {camera.width_px}x{camera.height_px}"
        )


def _grey(image: Any) -> NDArray[np.uint8]:
    array = np.asarray(image, dtype=np.uint8)
    return array if array.ndim == 2 else np.asarray(cv2.cvtColor(array, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
