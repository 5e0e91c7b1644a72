"""Where frames come from: a camera of the kernel's or the Raspberry Pi's, a recording, another process.

The newest frame wins: whoever is slow misses frames and never works through old ones. `Frame.time_s` is
mid-exposure of the image's middle row on the loop's clock (CLOCK_MONOTONIC); how each source comes by it
stands in its own module, and in docs/how-to/cameras.md for users.

Sources, as in `sense.vision.source`:

    v4l2:0                            /dev/video0                             v4l2
    v4l2:/dev/v4l/by-id/NAME          the same camera after each start        v4l2
    picamera2:0                       libcamera's first camera                picamera
    video:flight.mp4                  a video file, in real time              photos
    images:frames                     a folder of images, in real time        photos
    socket:/run/companion/frames      another process (docs/reference/camera-frames.md) frame_socket
    tcp:127.0.0.1:5600                the same over TCP
    rtsp://HOST/PATH, http://HOST/PATH, gstreamer:PIPELINE  a camera on the network  stream
"""

import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, Protocol

from companion.base.clock import Clock
from companion.base.errors import DeviceMissing
from companion.base.formats.frame_stream import ADDRESS_FORM
from companion.base.messages import Frame
from companion.config import CaptureConfig, ConfigError, without_password
from companion.sense.camera.frame_socket import SocketCamera
from companion.sense.camera.health import patience_with
from companion.sense.camera.keeper import KeptCamera, LiveSource
from companion.sense.camera.photos import open_folder, open_video
from companion.sense.camera.picamera import Picamera2Device
from companion.sense.camera.reader import MakeDevice, OpeningHangs, ThreadedCamera
from companion.sense.camera.stream import STREAM_FORM, StreamDevice
from companion.sense.camera.v4l2 import V4l2Device, device_number

DEVICE_FORM: Final = re.compile(
    r"(?P<kind>v4l2|picamera2):(?P<number>\d{1,4})|v4l2:(?P<device>/.+)"
    r"|(?P<recording>video|images):(?P<path>.+)"
)
EXPECTED: Final = (
    "expected v4l2:NUMBER, picamera2:NUMBER, v4l2:/dev/v4l/by-id/NAME, rtsp://..., http://..., "
    "gstreamer:PIPELINE, video:FILE, images:FOLDER, socket:PATH or tcp:HOST:PORT"
)


class FrameSource(Protocol):
    """A camera."""

    async def next(self) -> Frame:
        """Wait for a frame newer than the last one returned; cancelled, it takes none.

        Raises:
            OSError: the camera is gone.
            ConfigError: its images are not of the calibrated size.
        """

    def close(self) -> None:
        """Let go of the camera; `next` may not be called afterwards."""


def is_camera(spec: str) -> bool:
    return any(form.fullmatch(spec) for form in (DEVICE_FORM, ADDRESS_FORM, STREAM_FORM))


async def open_camera(spec: str, camera: CaptureConfig, unstamped_latency_s: float = 0.0) -> LiveSource:
    """Open the source named by `spec`, once: what goes wrong with it ends `next` with an error.

    `unstamped_latency_s` is how old a frame without a time is when it has come.

    Raises:
        ConfigError: no such source; one line with what was expected.
    """
    if ADDRESS_FORM.fullmatch(spec) is not None:
        return await SocketCamera.connect(spec, camera, unstamped_latency_s)
    return await ThreadedCamera.open(_maker(spec, camera, unstamped_latency_s))


async def keep_camera(
    spec: str, camera: CaptureConfig, unstamped_latency_s: float = 0.0, *, waits: bool = False
) -> KeptCamera:
    """Open the source named by `spec` for a flight: what goes wrong later is reported, and it is reopened.

    With `waits` one that is missing now is opened as soon as it is there.

    Raises:
        ConfigError: it cannot be opened now.
    """
    open_it = partial(open_camera, spec, camera, unstamped_latency_s)
    if ADDRESS_FORM.fullmatch(spec) is not None:
        patience = patience_with(camera, "socket")
    elif STREAM_FORM.fullmatch(spec) is not None:
        patience = patience_with(camera, "stream")
    else:
        form = DEVICE_FORM.fullmatch(spec)
        recording = form is not None and form["recording"] is not None
        patience = patience_with(camera, "recording" if recording else "device")
    try:
        return KeptCamera(await open_it(), open_it, patience)
    except (DeviceMissing, OpeningHangs) as error:
        if not waits:
            raise
        return KeptCamera(None, open_it, patience, missing=str(error))


def _maker(spec: str, camera: CaptureConfig, unstamped_latency_s: float) -> MakeDevice:
    """What opens a device, in the thread that will read it.

    Raises:
        ConfigError: no such kind of source.
    """
    clock = Clock()
    if STREAM_FORM.fullmatch(spec) is not None:
        return lambda _: StreamDevice(spec, camera, unstamped_latency_s, clock)
    form = DEVICE_FORM.fullmatch(spec)
    if form is None:
        raise ConfigError(f"sense.vision.source: '{without_password(spec)}'; {EXPECTED}")
    if form["recording"] is not None:
        open_recording = open_video if form["recording"] == "video" else open_folder
        return partial(open_recording, Path(form["path"]), camera, clock)
    if form["kind"] == "picamera2":
        return lambda _: Picamera2Device(int(form["number"]), camera, clock)
    # the link of a camera is resolved whenever it is opened: its number changes
    return lambda _: V4l2Device(device_number(form["device"] or form["number"]), camera, clock)


def at_exposure(frame: Frame, time_offset_s: float) -> Frame:
    """The frame with its stamp set right by the mount's calibration (`camera_time_offset_s`)."""
    return frame if time_offset_s == 0.0 else replace(frame, time_s=frame.time_s + time_offset_s)
