"""A camera over the network, or any pipeline, through OpenCV's VideoCapture: FFmpeg's, or GStreamer's.

    rtsp://HOST/PATH, http://HOST/PATH (MJPEG), ...   FFmpeg
    gstreamer:PIPELINE                                GStreamer, of an OpenCV that was built with it

Its time stamps. A stream has none of the exposure: its own count from where its sender began. A frame counts
as exposed `unstamped_latency_s` before it has been decoded, all of sensor, encoder, network and decoder in
one. `calibrate-mount camera` measures what that is off by (`camera_time_offset_s`). A frame that comes later
than the others' rhythm has it (`rhythm`) is passed over: the link has stalled, and it is older than that.

No frame is queued here: one decoding thread (FFmpeg's threads hold back a frame each), no demuxer's buffer,
and every frame is read as it comes. A host that is not there ends the opening in a second, one that stalls
the reading in one.

A stream is open once it has given a picture, for which an encoder may let wait till its next key frame.
What was queued meanwhile comes in a burst, older than it counts: the frames of the first SETTLING_S are
passed over.
"""

from __future__ import annotations

import os
import re
import socket
from collections import deque
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Final
from urllib.parse import urlsplit

import cv2
import numpy as np

from companion.base.clock import Clock
from companion.base.errors import DeviceMissing
from companion.config import CaptureConfig, ConfigError, without_password
from companion.sense.camera.reader import ReadBack, Shot, check_size, grey
from companion.sense.camera.rhythm import FrameRhythm
from companion.sense.camera.v4l2 import Capture

STREAM_FORM: Final = re.compile(
    r"(?P<url>(?P<scheme>rtsp|rtsps|http|https|udp|rtmp)://.+)|gstreamer:(?P<pipeline>.+)"
)
PORTS: Final = {"rtsp": 554, "rtsps": 322, "http": 80, "https": 443, "rtmp": 1935}  # where a TCP server waits
CONNECT_S: Final = 1.0
OPEN_S: Final = 5.0  # for the first whole picture: an encoder may send one every few seconds only
READ_S: Final = 1.0
SETTLING_S: Final = 0.2
# FFmpeg's, for OpenCV. The rate is not probed for, which takes a second of frames
OPTIONS_VARIABLE: Final = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
OPTIONS: Final = "fflags;nobuffer|flags;low_delay|fpsprobesize;0"
# TCP: a lost packet of UDP's smears what follows. RTSP says what comes, so one packet is probed, and kept:
# it is the key frame, without which nothing can be decoded until the next one. Sound is not asked for
RTSP_OPTIONS: Final = (
    "rtsp_transport;tcp|allowed_media_types;video|flags;low_delay|fpsprobesize;0|probesize;32"
)
RHYTHM_FRAMES: Final = 60  # until it is known how evenly frames arrive


class StreamDevice:
    """A `reader.Device`."""

    def __init__(self, spec: str, camera: CaptureConfig, latency_s: float, clock: Clock) -> None:
        """Open the stream; `latency_s` is how old its frames are as they arrive.

        Raises:
            DeviceMissing: nobody serves it now.
            ConfigError: it is no address, or needs what this OpenCV has not got.
        """
        self._camera, self._latency_s, self._clock = camera, latency_s, clock
        self._shown = without_password(spec)
        self._arrivals_s: list[float] = []
        self._rhythm, self._number = FrameRhythm(camera.rate_hz), 0
        self.notes: deque[str] = deque()
        self.read_back = ReadBack()
        form = STREAM_FORM.fullmatch(spec)
        assert form is not None
        if form["url"] is not None:
            self._capture = self._open_url(form["url"])
        else:
            self._capture = self._open_pipeline(form["pipeline"])

    def read(self) -> Shot:
        in_time = False
        while not in_time:
            good, image = self._capture.read()
            received_s = self._clock.now_s()
            if not good or image is None:
                raise OSError("the stream gives no frames any more: its server closed it, or stalls")
            check_size(image.shape[1], image.shape[0], self._camera)
            self._note_rhythm(received_s)
            self._number += 1
            in_time = self._rhythm.in_time(self._number, received_s)
        return Shot(received_s - self._latency_s, received_s, grey(image))

    def close(self) -> None:
        self._capture.release()

    def _open_url(self, url: str) -> Capture:
        self._must_answer(url)
        until_s = self._clock.now_s() + OPEN_S
        with _options(RTSP_OPTIONS if url.startswith("rtsp") else OPTIONS):
            capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, [*_limits(), cv2.CAP_PROP_N_THREADS, 1])
        if not capture.isOpened() or not self._settle(capture, until_s):
            capture.release()
            raise self._missing("its host answers, but gives no video")
        return capture

    def _settle(self, capture: Capture, until_s: float) -> bool:
        """Read over what comes first, once it comes; whether a picture came by then.

        A read ends after READ_S without a picture, though an encoder may be on its way to a key frame.
        """
        while True:
            began_s = self._clock.now_s()
            good, _ = capture.read()
            now_s = self._clock.now_s()
            if good:
                break
            ended = now_s - began_s < READ_S / 2.0
            if ended or now_s + READ_S > until_s:
                return False
        settled_s = now_s + SETTLING_S
        while good and self._clock.now_s() < settled_s:
            good, _ = capture.read()
        return True

    def _open_pipeline(self, pipeline: str) -> Capture:
        if not cv2.videoio_registry.hasBackend(cv2.CAP_GSTREAMER):
            raise ConfigError(
                f"sense.vision.source: {self._shown}: this OpenCV is built without GStreamer; expected the "
                "distribution's (apt install python3-opencv), or the stream's own URL (rtsp://...)"
            )
        until_s = self._clock.now_s() + OPEN_S
        capture = cv2.VideoCapture(pipeline, cv2.CAP_GSTREAMER, _limits())
        if not capture.isOpened() or not self._settle(capture, until_s):
            capture.release()
            raise self._missing("the pipeline gives no video")
        return capture

    def _must_answer(self, url: str) -> None:
        """A host that is away is known in a second, and why: FFmpeg takes five, and cannot be called off.

        Raises:
            ConfigError: no host, or no port of one.
            DeviceMissing: nobody answers there.
        """
        if url.startswith("udp://"):
            return  # waits for whoever sends
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port or PORTS[parts.scheme]
        except ValueError:
            host, port = None, 0
        if not host:
            raise ConfigError(
                f"sense.vision.source: {self._shown}: no address; expected SCHEME://HOST:PORT/PATH"
            )
        try:
            with closing(socket.create_connection((host, port), CONNECT_S)):
                pass
        except OSError as error:
            raise self._missing(error.strerror or "no answer") from error

    def _missing(self, why: str) -> DeviceMissing:
        return DeviceMissing(
            f"sense.vision.source: {self._shown}: {why}; expected the address of a stream that is on, with "
            "user and password if it wants them"
        )

    def _note_rhythm(self, received_s: float) -> None:
        """Say, once it is known, what the frames' times rest on, and how arrivals scatter about a rhythm."""
        if len(self._arrivals_s) == RHYTHM_FRAMES:
            return
        self._arrivals_s.append(received_s)
        if len(self._arrivals_s) < RHYTHM_FRAMES:
            return
        number = np.arange(RHYTHM_FRAMES)
        line = np.polyval(np.polyfit(number, self._arrivals_s, 1), number)
        scatter_s = float(np.std(np.array(self._arrivals_s) - line))
        self.notes.append(
            f"no exposure stamps: frames count as {1e3 * self._latency_s:.0f} ms old on arrival "
            f"(sense.vision.unstamped_latency_s), which scatters by {1e3 * scatter_s:.0f} ms"
        )


@contextmanager
def _options(options: str) -> Iterator[None]:
    """FFmpeg's options for a stream, unless the user has set some; by them a file loses its last frame."""
    ours = OPTIONS_VARIABLE not in os.environ
    if ours:
        os.environ[OPTIONS_VARIABLE] = options
    try:
        yield
    finally:
        if ours:
            os.environ.pop(OPTIONS_VARIABLE, None)


def _limits() -> list[int]:
    """How long opening and reading may take, as VideoCapture has it."""
    return [
        *(cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, round(1e3 * OPEN_S)),
        *(cv2.CAP_PROP_READ_TIMEOUT_MSEC, round(1e3 * READ_S)),
    ]
