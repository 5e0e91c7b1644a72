"""Pictures in, a line for each out, and overlays: photos as .png, a video as a video."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from companion.base.clock import wall_clock_s
from companion.base.files import write_atomically
from companion.config import CameraConfig, ConfigError, find_file, load_config, load_model
from companion.pad import load_pad
from companion.sense.camera.photos import Photo, photo_paths, read_photos
from companion.sense.vision.aruco import Detection
from companion.sense.vision.opencv import prepare_opencv
from companion.tools.detect.finder import Found, PadFinder
from companion.tools.detect.overlay import draw

VIDEO_CODE: Final = "mp4v"
VIDEO_ENDING: Final = ".mp4"


@dataclass
class Tally:
    """What came of all pictures."""

    pictures: int = 0
    other_sizes: Counter[tuple[int, int]] = field(default_factory=Counter)
    distances_m: list[float] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)

    def lines(self, size_px: tuple[int, int]) -> list[str]:
        """The summary."""
        made = []
        for (width, height), count in self.other_sizes.items():
            expected = "x".join(map(str, size_px))
            made.append(f"left out: {count} of {width}x{height}; the camera's calibration is for {expected}")
        if self.times_s:
            median, most = np.percentile(self.times_s, (50, 95))
            seen = f"pad seen in {len(self.distances_m)} of {len(self.times_s)}"
            if self.distances_m:
                seen += f", {min(self.distances_m):.2f} to {max(self.distances_m):.2f} m away"
            made.append(f"{seen}; {1e3 * median:.0f} ms a picture, p95 {1e3 * most:.0f} ms")
        return made


def find_with(config: Path, pad: str | None, camera: str | None) -> PadFinder:
    """Vision for this pad and camera; what is None is as in the settings.

    Raises:
        ConfigError: a file cannot be read, or is wrong.
    """
    prepare_opencv()
    settings = load_config(config)
    calibrated = load_model(CameraConfig, find_file("cameras", camera or settings.camera))
    return PadFinder(load_pad(pad or settings.pad), calibrated, settings.sense.vision)


def detect_all(sources: Sequence[Path], finder: PadFinder, out: Path | None) -> bool:
    """Look at all pictures, print what they show, write the overlays; whether any shows the pad.

    Raises:
        ConfigError: no picture can be read, none is of the calibrated size, or an overlay cannot be written.
    """
    console, tally = Console(), Tally()
    overlays = None if out is None else Overlays(out)

    def say(text: str) -> None:
        console.print(text, highlight=False, soft_wrap=True, markup=False)

    try:
        for photo in read_photos(photo_paths(sources), say):
            if photo.size_px != finder.size_px:
                tally.other_sizes[photo.size_px] += 1
                continue
            begun_s = wall_clock_s()
            found = finder.find(photo.image)
            took_s = wall_clock_s() - begun_s
            tally.times_s.append(took_s)
            if found.view is not None:
                tally.distances_m.append(found.view.distance_m)
            words = line(found)
            say(f"{photo.name}: {words}, {1e3 * took_s:.0f} ms")
            if overlays is not None:
                overlays.write(photo, draw(photo.image, found, finder.pad, finder.lens, words))
    finally:
        if overlays is not None:
            overlays.close()
    if not tally.times_s:
        raise ConfigError(f"{sources[0]}: {'; '.join(tally.lines(finder.size_px))}")
    for text in (*tally.lines(finder.size_px), *(() if overlays is None else overlays.lines())):
        say(text)
    return bool(tally.distances_m)


def line(found: Found) -> str:
    """What a picture shows, in one line."""
    if found.view is None:
        if not found.markers:
            return "no marker of the pad"
        return f"no pose from {ids(found.markers)}"
    view = found.view
    return (
        f"{ids(found.markers)}: {view.distance_m:.{digits(view.along_std_m)}f} m away "
        f"(std {_mm(view.along_std_m)} along, {_mm(view.across_std_m)} across), "
        f"{view.slant_deg:.0f} deg aslant, {view.reprojection_error_px:.2f} px"
    )


def ids(markers: Sequence[Detection]) -> str:
    """The markers by group, each by its id."""
    groups: dict[str, list[int]] = {}
    for each in markers:
        groups.setdefault(each.marker.group, []).append(each.marker.id)
    return ", ".join(f"{group} {' '.join(map(str, found))}" for group, found in groups.items())


def digits(std_m: float) -> int:
    """Decimals of a length in metres that its error leaves meaningful: 2 or 3."""
    return 3 if std_m < 0.01 else 2


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.2g} mm" if length_m < 0.1 else f"{length_m:.2f} m"


class Overlays:
    """Writes overlays to a folder: photos under their own names, and one video for each video."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._videos: dict[Path, Any] = {}
        self._written: list[Path] = []
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"--out {folder}: cannot be made: {error.strerror}") from error

    def write(self, photo: Photo, picture: NDArray[np.uint8]) -> None:
        """Write one picture (height, width, 3).

        Raises:
            ConfigError: it cannot be written.
        """
        if photo.frame is None:
            self._write_photo(self._free(photo.path, ".png"), picture)
        else:
            self._video(photo, picture).write(picture)

    def close(self) -> None:
        """Finish the videos."""
        for video in self._videos.values():
            video.release()

    def lines(self) -> list[str]:
        """Where they are."""
        one = len(self._written) == 1
        return [f"overlay{'' if one else 's'}: {self._written[0] if one else self._folder}"]

    def _free(self, source: Path, ending: str) -> Path:
        """A name as the source's; numbered where two folders have files of one name."""
        number, free = 1, self._folder / f"{source.stem}{ending}"
        while free in self._written:
            number += 1
            free = self._folder / f"{source.stem}-{number}{ending}"
        return free

    def _write_photo(self, path: Path, picture: NDArray[np.uint8]) -> None:
        write_atomically(path, cv2.imencode(".png", picture)[1].tobytes())
        self._written.append(path)

    def _video(self, photo: Photo, picture: NDArray[np.uint8]) -> Any:
        if photo.path not in self._videos:
            path = self._free(photo.path, VIDEO_ENDING)
            height, width = picture.shape[:2]
            video = cv2.VideoWriter(
                str(path), cv2.VideoWriter.fourcc(*VIDEO_CODE), photo.rate_hz, (width, height)
            )
            if not video.isOpened():
                raise ConfigError(f"{path}: cannot be written; expected a folder that can be written to")
            self._videos[photo.path] = video
            self._written.append(path)
        return self._videos[photo.path]
