"""`companion-sitl view`: shows or records the frames of a socket (docs/reference/camera-frames.md).

A machine without a screen shows them in a browser: Motion JPEG on the loopback. Recorded are PNG files, one a
frame, or an MP4 file. Each picture carries its number, its time and its age when it came.
"""

import asyncio
import sys
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.clock import Clock
from companion.base.files import make_folder
from companion.base.formats.frame_format import FrameHeader
from companion.base.formats.frame_stream import FrameStream
from companion.base.formats.mjpeg import MjpegServer, serving
from companion.base.signals import run_until_stopped, stopping_on_signals
from companion.config import ConfigError
from sitl.run.process_control import terminated_as_interrupted

STATUS_PERIOD_S: Final = 1.0
_WINDOW: Final = 30
_VIDEO_SUFFIX: Final = ".mp4"
_OTHER_SUFFIXES: Final = (".avi", ".mkv", ".mov", ".webm", ".png", ".jpg", ".jpeg", ".gif")
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """What to do with the frames: keep every `every`-th one, end after `frames` kept (0: never)."""

    record: Path | None = None
    every: int = 1
    frames: int = 0
    serve_port: int | None = None


class Statistics:
    """Rate, age and losses of a stream; times in s."""

    def __init__(self) -> None:
        self.count = self.dropped = 0
        self._last_sequence: int | None = None
        self._arrivals: deque[float] = deque(maxlen=_WINDOW)
        self._ages: deque[float] = deque(maxlen=_WINDOW)

    def take(self, header: FrameHeader, received_s: float) -> None:
        if self._last_sequence is not None:
            step = (header.sequence - self._last_sequence) % 2**32
            self.dropped += max(0, step - 1) if step < 2**31 else 0  # a restarted server drops none
        self._last_sequence = header.sequence
        self.count += 1
        self._arrivals.append(received_s)
        if header.time_s is not None:
            self._ages.append(received_s - header.time_s)

    @property
    def rate_hz(self) -> float:
        """Frames a second, over the last ones."""
        arrivals = self._arrivals
        span_s = arrivals[-1] - arrivals[0] if arrivals else 0.0
        return (len(arrivals) - 1) / span_s if span_s > 0.0 else 0.0

    def __str__(self) -> str:
        age = f"{1e3 * median(self._ages):.0f} ms old" if self._ages else "without times"
        return f"{self.count} frames, {self.rate_hz:.1f} a second, {age}, {self.dropped} dropped"


class PngFolder:
    """One PNG file a frame, named by its sequence number."""

    def __init__(self, folder: Path) -> None:
        """Make the folder.

        Raises:
            ConfigError: it cannot be made.
        """
        self._folder = make_folder("--record", folder)

    def keep(self, picture: Image, header: FrameHeader, rate_hz: float) -> None:
        """Write a file; `rate_hz` is how often pictures are kept."""
        path = self._folder / f"frame-{header.sequence:08d}.png"
        if not cv2.imwrite(str(path), picture):
            raise ConfigError(f"--record {path}: cannot be written; expected a folder with room")

    def close(self) -> None:
        """Nothing to finish."""


class Video:
    """An MP4 file. Its frame rate is the stream's, measured over the first pictures, which wait for it."""

    WAITING: Final = 15

    def __init__(self, path: Path) -> None:
        """Check that it can be written.

        Raises:
            ConfigError: its folder does not exist.
        """
        if not path.parent.is_dir():
            raise ConfigError(f"--record {path}: expected a file in an existing folder")
        self._path = path
        self._writer: cv2.VideoWriter | None = None
        self._waiting: list[Image] = []
        self._rate_hz = 0.0

    def keep(self, picture: Image, header: FrameHeader, rate_hz: float) -> None:
        """Append a picture; `rate_hz` is how often pictures are kept."""
        self._rate_hz = rate_hz
        self._waiting.append(picture.copy())
        if self._writer is not None or len(self._waiting) >= self.WAITING:
            self._write()

    def close(self) -> None:
        """Write what waits, and the file's end."""
        if self._waiting:
            self._write()
        if self._writer is not None:
            self._writer.release()

    def _write(self) -> None:
        if self._writer is None:
            height, width = self._waiting[0].shape[:2]
            code = cv2.VideoWriter.fourcc(*"mp4v")
            # MPEG-4 has no room for a rate like 74.183
            rate_hz = max(1.0, round(self._rate_hz) if self._rate_hz > 10.0 else round(self._rate_hz, 1))
            self._writer = cv2.VideoWriter(str(self._path), code, rate_hz, (width, height))
            if not self._writer.isOpened():
                raise ConfigError(f"--record {self._path}: cannot be written as MP4")
        for picture in self._waiting:
            self._writer.write(picture)
        self._waiting.clear()


def annotated(image: Image, header: FrameHeader, received_s: float) -> Image:
    """A colour copy (height, width, 3) with the frame's number, time and age in its lower left corner."""
    colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    time = "no time"
    if header.time_s is not None:
        time = f"{header.time_s:.3f} s, {1e3 * (received_s - header.time_s):.0f} ms old"
    text = f"{header.sequence}  {time}"
    (width, height), below = cv2.getTextSize(text, _FONT, 0.5, 1)
    left, base = 6, header.height_px - 6 - below
    cv2.rectangle(
        colour, (left - 3, base - height - 3), (left + width + 3, base + below + 3), (0, 0, 0), cv2.FILLED
    )
    cv2.putText(colour, text, (left, base), _FONT, 0.5, (0, 255, 255), 1, cv2.LINE_AA)
    return np.asarray(colour, dtype=np.uint8)


async def _view_until_stopped(address: str, options: ViewOptions) -> Statistics:
    """As `view`; SIGTERM and SIGHUP end it like the server's end does, and what was recorded is whole."""
    statistics = Statistics()
    viewing = asyncio.create_task(view(address, options, statistics))
    with stopping_on_signals(viewing.cancel):
        await asyncio.wait([viewing])
    if not viewing.cancelled():
        viewing.result()
    return statistics


async def view(address: str, options: ViewOptions, statistics: Statistics | None = None) -> Statistics:
    """Show and record frames until there are enough or the server goes; `statistics` counts them.

    Raises:
        ConfigError: no server, invalid data, or the options cannot be met.
    """
    try:
        stream = await FrameStream.open(address)
    except (OSError, ValueError) as error:
        raise ConfigError(str(error)) from error
    recorder: PngFolder | Video | None = None
    statistics = statistics or Statistics()
    try:
        recorder = _recorder(options.record)
        async with serving(options.serve_port, lambda text: print(text, flush=True)) as page:
            await _watch(stream, options, recorder, page, statistics)
    except OSError as error:
        if statistics.count == 0 or "does not send frames" in str(error):
            raise ConfigError(str(error)) from error
        print(f"companion-sitl view: {error}", file=sys.stderr)
    finally:
        stream.close()
        if recorder is not None:
            recorder.close()
    return statistics


async def _watch(
    stream: FrameStream,
    options: ViewOptions,
    recorder: PngFolder | Video | None,
    page: MjpegServer,
    statistics: Statistics,
) -> None:
    clock, kept = Clock(), 0
    printed_s = clock.now_s()
    while not (options.frames and kept >= options.frames):
        header = await stream.read_header()
        image = await stream.read_image(header)
        now_s = clock.now_s()
        statistics.take(header, now_s)
        if (statistics.count - 1) % options.every == 0:
            kept += 1
            picture = annotated(image, header, now_s)
            page.show(picture)
            if recorder is not None:
                recorder.keep(picture, header, statistics.rate_hz / options.every)
        if now_s - printed_s >= STATUS_PERIOD_S:
            printed_s = now_s
            _print_status(statistics)


def _recorder(path: Path | None) -> PngFolder | Video | None:
    if path is None:
        return None
    suffix = path.suffix.lower()
    if suffix in _OTHER_SUFFIXES:
        raise ConfigError(f"--record {path}: expected FILE.mp4, or a folder for PNG files")
    return Video(path) if suffix == _VIDEO_SUFFIX else PngFolder(path)


def _print_status(statistics: Statistics) -> None:
    """On a terminal one line that is written over, else a line a time."""
    live = sys.stdout.isatty()
    print(f"\r{statistics}  " if live else statistics, end="" if live else "\n", flush=True)


def run_view(address: str, options: ViewOptions) -> None:
    """Show or record frames until Ctrl-C, then say how they came."""
    with terminated_as_interrupted():
        statistics = run_until_stopped(_view_until_stopped(address, options))
    print(f"\n{statistics}" if sys.stdout.isatty() else statistics)
