"""Photos and videos as a user has them, in files and folders: each picture once, however long it takes.

A picture is read as the sensor took it: a turn that the camera has noted beside it is not applied, since the
app gets its frames unturned too. Below, a recording that plays in real time.
"""

import re
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.clock import Clock
from companion.base.files import must_exist
from companion.config import CaptureConfig, ConfigError
from companion.sense.camera.reader import EndOfFrames, ReadBack, Shot, check_size, grey

PHOTOS: Final = {
    *(".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp", ".jp2"),
}
VIDEOS: Final = {".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".mjpg", ".mjpeg", ".h264"}
USUAL_RATE_HZ: Final = 30.0
FLAGS: Final = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION


@dataclass(frozen=True, slots=True)
class Photo:
    """A grey image (height, width) from the file at `path`.

    `frame` and `time_s` count from a video's start, at `rate_hz`; they are None for a photo.
    """

    path: Path
    image: NDArray[np.uint8]
    frame: int | None = None
    time_s: float | None = None
    rate_hz: float = USUAL_RATE_HZ

    @property
    def name(self) -> str:
        """As messages call it."""
        return str(self.path) if self.frame is None else f"{self.path} frame {self.frame}"

    @property
    def size_px(self) -> tuple[int, int]:
        return self.image.shape[1], self.image.shape[0]


def photo_paths(sources: Sequence[Path]) -> list[Path]:
    """The photos and videos that are named, or that lie in the folders that are named, in order.

    Raises:
        ConfigError: there is none, or one is neither.
    """
    found: list[Path] = []
    for source in sources:
        if source.is_dir():
            inside = [p for p in source.iterdir() if p.suffix.lower() in PHOTOS | VIDEOS]
            if not inside:
                raise ConfigError(
                    f"{source}: holds no photos or videos; expected some ({', '.join(sorted(PHOTOS))})"
                )
            found += sorted(inside, key=natural_order)
        elif source.is_file():
            found.append(source)
        else:
            must_exist(source, "expected a camera, a folder of photos, a photo or a video")
    # what is named twice, alone and in its folder, is one view all the same
    return list(dict.fromkeys(found))


def read_photos(paths: Sequence[Path], tell: Callable[[str], None]) -> Iterator[Photo]:
    """Every photo, and every frame of a video, in order. `tell` gets a line for each that cannot be read.

    Raises:
        ConfigError: the only one that there is, or none of several, can be read.
    """
    read = False
    wrong: list[ConfigError] = []
    for path in paths:
        try:
            for photo in _frames(path) if path.suffix.lower() in VIDEOS else [_photo(path)]:
                read = True
                yield photo
        except ConfigError as error:
            # one bad file of many is no reason to give up
            wrong.append(error)
    if wrong and not read:
        raise wrong[0]
    for why in wrong:
        tell(f"left out: {why}")


def _photo(path: Path) -> Photo:
    # read here and only decoded there: OpenCV tells nothing of why it cannot open a file
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    image = cv2.imdecode(data, FLAGS) if len(data) else None
    if image is None:
        raise ConfigError(f"{path}: not a photo that can be read; expected JPEG, PNG, TIFF, BMP or PGM")
    return Photo(path, np.asarray(image, dtype=np.uint8))


def _frames(path: Path) -> Iterator[Photo]:
    video = _unturned(path)
    try:
        rate_hz = video.get(cv2.CAP_PROP_FPS)
        rate_hz = rate_hz if 0.0 < rate_hz < 1000.0 else USUAL_RATE_HZ
        number = 0
        while True:
            good, frame = video.read()
            if not good:
                break
            grey = frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
            yield Photo(path, np.asarray(grey, dtype=np.uint8), number, number / rate_hz, rate_hz)
            number += 1
    finally:
        video.release()
    if number == 0:
        raise ConfigError(f"{path}: not a video that can be read")


def _unturned(path: Path) -> cv2.VideoCapture:
    """A video's frames as they were taken."""
    video = cv2.VideoCapture(str(path))
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0.0)
    return video


def natural_order(path: Path) -> list[tuple[int, int | str]]:
    """To sort by: img_2 comes before img_10."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]


# ---------------------------------------------------------------- a recording as a camera
# A video file, or a folder of images; each comes when it is due, in real time. The first frame is taken to be
# exposed (mid-exposure) when the replay begins, the others as much later as they were recorded later: a
# video's by its frames a second; images' by their names where these are times, else one by one at the
# camera's `rate_hz`. A name is a time when it is a number of seconds with a decimal point (`12.345678.png`)
# or one of 19 digits (nanoseconds since 1970, as many data sets have it). Who comes late misses frames, as
# with a camera. After the last one there are none (`EndOfFrames`).

IMAGE_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".tif", ".tiff")
SECONDS: Final = re.compile(r"\d+\.\d+")
NANOSECONDS: Final = re.compile(r"\d{19}")
# when a frame is due (s after the first one), and how to get its image; None when it cannot be read
Recorded = tuple[float, Callable[[], Any]]


class ReplayDevice:
    """A `reader.Device` that reads a recording."""

    def __init__(
        self,
        name: str,
        frames: Iterator[Recorded],
        camera: CaptureConfig,
        clock: Clock,
        stop: threading.Event,
    ) -> None:
        """Take a recording; `stop` ends the wait for the next frame."""
        self._name, self._frames = name, frames
        self._camera, self._clock, self._stop = camera, clock, stop
        self._begun_s: float | None = None
        self._shown, self._shape = False, (camera.height_px, camera.width_px)
        self.notes: deque[str] = deque()
        self.read_back = ReadBack(camera.exposure_s)

    def read(self) -> Shot:
        for after_s, load in self._frames:
            now_s = self._clock.now_s()
            if self._begun_s is None:
                self._begun_s = now_s - after_s
            due_s = self._begun_s + after_s
            if due_s < now_s - 1.0 / self._camera.rate_hz:
                continue
            image = load()
            if image is None or (self._shown and image.shape[:2] != self._shape):
                fault = "cannot be read" if image is None else "is of another size"
                self.notes.append(f"{self._name}: the frame at {after_s:.3f} s {fault}")
                continue
            check_size(image.shape[1], image.shape[0], self._camera)
            self._shown = True
            self._stop.wait(max(0.0, due_s - self._clock.now_s()))
            return Shot(due_s, self._clock.now_s(), grey(image))
        if not self._shown and self._begun_s is not None:
            raise ConfigError(
                f"sense.vision.source: {self._name}: none of its frames can be read; "
                f"expected images of {self._camera.width_px}x{self._camera.height_px}"
            )
        raise EndOfFrames(f"{self._name} has ended")

    def close(self) -> None:
        self._frames = iter(())


def open_video(path: Path, camera: CaptureConfig, clock: Clock, stop: threading.Event) -> ReplayDevice:
    """A video file of whatever kind OpenCV reads.

    Raises:
        ConfigError: no such file, none that can be read, or of images of another size.
    """
    capture = _unturned(path) if path.is_file() else None
    if capture is None or not capture.isOpened():
        raise ConfigError(f"sense.vision.source: video:{path}: cannot be read; expected a video file")
    size = (capture.get(cv2.CAP_PROP_FRAME_WIDTH), capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
    check_size(round(size[0]), round(size[1]), camera)
    rate_hz = capture.get(cv2.CAP_PROP_FPS)
    return ReplayDevice(path.name, _of_video(capture, rate_hz or camera.rate_hz), camera, clock, stop)


def open_folder(path: Path, camera: CaptureConfig, clock: Clock, stop: threading.Event) -> ReplayDevice:
    """A folder of images, in the order of their times, else of their names.

    Raises:
        ConfigError: no such folder, or no images in it.
    """
    files = (
        [file for file in path.glob("*") if file.suffix.lower() in IMAGE_SUFFIXES] if path.is_dir() else []
    )
    if not files:
        raise ConfigError(
            f"sense.vision.source: images:{path}: no images; expected a folder of {', '.join(IMAGE_SUFFIXES)}"
        )
    return ReplayDevice(path.name, _of_folder(recorded_times(files, camera.rate_hz)), camera, clock, stop)


def recorded_times(files: list[Path], rate_hz: float) -> list[tuple[float, Path]]:
    """When each file's frame was taken, s after the first, in that order (see above)."""
    for form, unit in ((SECONDS, 10**9), (NANOSECONDS, 1)):
        if all(form.fullmatch(file.stem) for file in files):
            taken = sorted((_exact_ns(file.stem, unit), file) for file in files)
            return [(1e-9 * (time_ns - taken[0][0]), file) for time_ns, file in taken]
    return [(k / rate_hz, file) for k, file in enumerate(sorted(files, key=natural_order))]


def _exact_ns(number: str, unit_ns: int) -> int:
    """Nanoseconds; a float of seconds since 1970 would lose some."""
    whole, _, fraction = number.partition(".")
    return int(whole) * unit_ns + int(fraction[:9].ljust(9, "0") if fraction else 0)


def _of_video(capture: cv2.VideoCapture, rate_hz: float) -> Iterator[Recorded]:
    number = 0
    while capture.grab():
        yield number / rate_hz, lambda: capture.retrieve()[1]
        number += 1


def _of_folder(timed: list[tuple[float, Path]]) -> Iterator[Recorded]:
    for after_s, file in timed:
        yield after_s, partial(cv2.imread, str(file), FLAGS)
