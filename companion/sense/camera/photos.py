"""Photos and videos as a user has them, in files and folders: each picture once, however long it takes.

A photo is read as the sensor took it: a turn that the camera has noted beside it is not applied, since the
app gets its frames unturned too. For a recording that plays in real time see `folder_replay`.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.files import must_exist
from companion.config import ConfigError

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
    video = cv2.VideoCapture(str(path))
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


def natural_order(path: Path) -> list[tuple[int, int | str]]:
    """To sort by: img_2 comes before img_10."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]
