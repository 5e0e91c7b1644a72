"""Pictures in, a line for each out, and overlays: photos as .png, a video as a video.

Each goes through the app's vision stage. Nothing is known of the vehicle here, so there is no expectation of
the pad and no direction of gravity: what is found is what the app would find in its first look. Camera axes
are OpenCV's (x right, y down, z ahead).
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from companion.base.clock import wall_clock_s
from companion.base.command_line import say
from companion.base.files import make_folder, write_atomically
from companion.base.geometry import FloatArray, matrix_from_quat
from companion.base.messages import Frame, PadSighting
from companion.config import (
    CameraConfig,
    ConfigError,
    VehicleConfig,
    VisionConfig,
    find_file,
    load_config,
    load_model,
)
from companion.pad import Pad, colours, load_pad
from companion.sense.camera.photos import Photo, photo_paths, read_photos
from companion.sense.vision.aruco import Detection
from companion.sense.vision.lens import Lens
from companion.sense.vision.opencv import prepare_opencv
from companion.sense.vision.pipeline import Vision, body_from_camera

# without an expectation, vision looks in turn for what is far and what is near
LOOKS: Final = 2
# the camera alone: it is the vehicle's reference point, and the body's axes are turned from its own
CAMERA_ALONE: Final = VehicleConfig(
    name="camera", camera_position_body_m=(0.0, 0.0, 0.0), range_position_body_m=(0.0, 0.0, 0.0),
    leg_height_m=0.02, hover_thrust=0.5,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class PadView:
    """The pad as one picture shows it, in camera axes.

    `position_m` (3,) is the pad's centre, `camera_from_pad` (3, 3) its rotation. `along_std_m` is the stated
    standard deviation along the line of sight, `across_std_m` in each direction across it.
    """

    position_m: FloatArray
    camera_from_pad: FloatArray
    along_std_m: float
    across_std_m: float
    reprojection_error_px: float

    @property
    def distance_m(self) -> float:
        return float(np.linalg.norm(self.position_m))

    @property
    def slant_deg(self) -> float:
        """Angle between the line of sight and the pad's normal: 0 is straight above it."""
        cosine = float(self.camera_from_pad[:, 2] @ self.position_m) / self.distance_m
        return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


@dataclass(frozen=True, slots=True)
class Found:
    """What one picture gave. `markers` are those of the pose; without a pose, those that were read."""

    markers: tuple[Detection, ...]
    view: PadView | None
    sighting: PadSighting | None = None


class PadFinder:
    """The app's vision over single pictures."""

    def __init__(self, pad: Pad, camera: CameraConfig, config: VisionConfig) -> None:
        self.pad = pad
        self.camera = camera
        self.lens = Lens(camera)
        self._vision = Vision(pad, camera, CAMERA_ALONE, config)
        self._camera_from_body = matrix_from_quat(body_from_camera(CAMERA_ALONE)).T

    def find(self, image: NDArray[np.uint8]) -> Found:
        """Look for what is far and for what is near, as the app does in two frames that follow each other.

        Raises:
            ValueError: the image (height, width) is not of the calibrated size.
        """
        read: tuple[Detection, ...] = ()
        for _ in range(LOOKS):
            result = self._vision.step(Frame(0.0, 0.0, 0, image), None)
            if result.sighting is not None:
                return Found(result.used, self._view(result.sighting), result.sighting)
            read = max(read, result.read, key=len)
        return Found(read, None)

    def _view(self, sighting: PadSighting) -> PadView:
        turn = self._camera_from_body
        position = turn @ np.array(sighting.pad_position_body_m)
        covariance = turn @ sighting.covariance[:3, :3] @ turn.T
        ray = position / np.linalg.norm(position)
        along = float(ray @ covariance @ ray)
        across = 0.5 * max(float(np.trace(covariance)) - along, 0.0)
        return PadView(
            position, turn @ matrix_from_quat(sighting.body_from_pad), math.sqrt(along), math.sqrt(across),
            sighting.reprojection_error_px,
        )  # fmt: skip


# ---------------------------------------------------------------- the overlay

# blue, green, red
GROUP_COLOURS: Final = {group: colours.bgr(colour) for group, colour in colours.GROUP_COLOURS.items()}
UNUSED: Final = (40, 40, 220)
OUTLINE: Final = (255, 180, 0)
AXES: Final = (("front", (60, 60, 255)), ("right", (80, 220, 80)), ("up", (255, 120, 60)))
WHITE: Final = (255, 255, 255)
FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
# lines and text are drawn for an image of this width
DESIGN_WIDTH_PX: Final = 960
LEAST_TEXT: Final = 0.45
AXIS_SHARE: Final = 0.35  # of the pad's shorter side, or of the distance to it
SIDE_POINTS: Final = 16  # a lens bends the board's sides
SHIFT: Final = 4  # sub-pixel bits of OpenCV's drawing


def draw(image: NDArray[np.uint8], found: Found, pad: Pad, lens: Lens, text: str) -> NDArray[np.uint8]:
    """A colour picture (height, width, 3) of a grey one with what was found, and a line of text below."""
    picture: Any = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    unit = max(image.shape[1] / DESIGN_WIDTH_PX, 0.4)
    width = max(2, round(2 * unit))
    for detection in found.markers:
        colour = UNUSED if found.view is None else GROUP_COLOURS[detection.marker.group]
        _outline(picture, detection.corners_px, colour, width)
        # a dot at the first corner: top left of the code
        first, radius = _fixed(detection.corners_px[0]), round(4 * unit * (1 << SHIFT))
        cv2.circle(picture, first, radius, colour, -1, cv2.LINE_AA, shift=SHIFT)
        above = detection.corners_px.min(axis=0) - (0.0, 9.0 * unit)
        above[0] = detection.corners_px[:, 0].mean()
        _write(picture, str(detection.marker.id), above, colour, max(0.6 * unit, LEAST_TEXT))
    if found.view is not None:
        _outline(picture, _seen(lens, found.view, board_outline(pad)), OUTLINE, width)
        length_m = AXIS_SHARE * min(pad.length_m, pad.width_m, found.view.distance_m)
        _draw_axes(picture, lens, found.view, length_m, unit)
    bar = round(28 * unit)
    strip = np.zeros((bar, picture.shape[1], 3), np.uint8)
    cv2.putText(strip, text, (round(8 * unit), bar - round(9 * unit)), FONT, 0.5 * unit, WHITE,
                max(1, round(unit)), cv2.LINE_AA)  # fmt: skip
    return np.vstack((picture, strip)).astype(np.uint8)


def board_outline(pad: Pad) -> FloatArray:
    """Points (n, 3) along the board's edge, in pad axes (m)."""
    corners = pad.corners_pad_m()
    share = np.arange(SIDE_POINTS)[None, :, None] / SIDE_POINTS
    sides = corners[:, None] + share * (np.roll(corners, -1, axis=0) - corners)[:, None]
    return np.asarray(sides.reshape(-1, 3))


def _seen(lens: Lens, view: PadView, points_pad_m: FloatArray) -> FloatArray:
    """Pixels (n, 2) of points on the pad, NaN where the lens cannot see."""
    return lens.project(points_pad_m @ view.camera_from_pad.T + view.position_m)[0]


def _draw_axes(picture: Any, lens: Lens, view: PadView, length_m: float, unit: float) -> None:
    # the pad's z axis goes into the ground
    ends = np.diag((length_m, length_m, -length_m))
    pixels = _seen(lens, view, np.vstack((np.zeros(3), ends)))
    for end, (name, colour) in zip(pixels[1:], AXES, strict=True):
        if np.isfinite((pixels[0], end)).all():
            start, tip = _fixed(pixels[0]), _fixed(end)
            width = max(2, round(2 * unit))
            cv2.arrowedLine(picture, start, tip, colour, width, cv2.LINE_AA, shift=SHIFT, tipLength=0.12)
            _write(picture, name, end, colour, max(0.5 * unit, LEAST_TEXT))


def _outline(picture: Any, pixels: FloatArray, colour: tuple[int, int, int], width: int) -> None:
    """A closed line; an open one through what the lens can see of it."""
    whole = bool(np.isfinite(pixels).all())
    points = pixels[np.isfinite(pixels).all(axis=1)]
    if len(points) > 1:
        fixed = np.rint(points * (1 << SHIFT)).astype(np.int32)
        cv2.polylines(picture, [fixed], whole, colour, width, cv2.LINE_AA, shift=SHIFT)


def _fixed(pixel: FloatArray) -> tuple[int, int]:
    u, v = np.rint(pixel * (1 << SHIFT)).astype(int).tolist()
    return u, v


def _write(picture: Any, text: str, pixel: FloatArray, colour: tuple[int, int, int], scale: float) -> None:
    """Text about a pixel, on a dark edge so that it can be read on black and on white."""
    thick = max(1, round(2 * scale))
    (width, height), _ = cv2.getTextSize(text, FONT, scale, thick)
    at = (round(float(pixel[0]) - 0.5 * width), round(float(pixel[1]) + 0.5 * height))
    cv2.putText(picture, text, at, FONT, scale, (0, 0, 0), thick + 2, cv2.LINE_AA)
    cv2.putText(picture, text, at, FONT, scale, colour, thick, cv2.LINE_AA)


# ---------------------------------------------------------------- the pictures

VIDEO_CODE: Final = "mp4v"
VIDEO_ENDING: Final = ".mp4"


@dataclass
class Tally:
    """What came of all pictures."""

    pictures: int = 0
    other_sizes: Counter[tuple[int, int]] = field(default_factory=Counter)
    distances_m: list[float] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)

    def lines(self, size_px: tuple[int, int]) -> Iterator[str]:
        for (width, height), count in self.other_sizes.items():
            expected = "x".join(map(str, size_px))
            yield f"left out: {count} of {width}x{height}; the camera's calibration is for {expected}"
        if self.times_s:
            median, most = np.percentile(self.times_s, (50, 95))
            seen = f"pad seen in {len(self.distances_m)} of {len(self.times_s)}"
            if self.distances_m:
                seen += f", {min(self.distances_m):.2f} to {max(self.distances_m):.2f} m away"
            yield f"{seen}; {1e3 * median:.0f} ms a picture, p95 {1e3 * most:.0f} ms"


def find_with(config: Path, pad: str | None, camera: str | None) -> PadFinder:
    """Vision for this pad and camera; what is None is as in the settings."""
    prepare_opencv()
    settings = load_config(config)
    calibrated = load_model(CameraConfig, find_file("cameras", camera or settings.camera))
    return PadFinder(load_pad(pad or settings.pad), calibrated, settings.sense.vision)


def detect_all(
    sources: Sequence[Path],
    finder: PadFinder,
    out: Path | None,
    send: Callable[[PadSighting, Pad], None] | None = None,
) -> bool:
    """Look at all pictures, print what they show, write the overlays; whether any shows the pad.

    `send` is given what each picture with the pad shows.
    """
    console, tally = Console(), Tally()
    overlays = None if out is None else Overlays(out)

    try:
        for photo in read_photos(photo_paths(sources), partial(say, console)):
            if photo.size_px != finder.lens.size_px:
                tally.other_sizes[photo.size_px] += 1
                continue
            begun_s = wall_clock_s()
            found = finder.find(photo.image)
            took_s = wall_clock_s() - begun_s
            tally.times_s.append(took_s)
            if found.view is not None:
                tally.distances_m.append(found.view.distance_m)
            if send is not None and found.sighting is not None:
                send(found.sighting, finder.pad)
            words = line(found)
            say(console, f"{photo.name}: {words}, {1e3 * took_s:.0f} ms")
            if overlays is not None:
                overlays.write(photo, draw(photo.image, found, finder.pad, finder.lens, words))
    finally:
        if overlays is not None:
            overlays.close()
    if not tally.times_s:
        raise ConfigError(f"{sources[0]}: {'; '.join(tally.lines(finder.lens.size_px))}")
    say(console, *tally.lines(finder.lens.size_px), *(() if overlays is None else overlays.lines()))
    return bool(tally.distances_m)


def line(found: Found) -> str:
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
        self._folder = make_folder("--out", folder)
        self._videos: dict[Path, Any] = {}
        self._written: list[Path] = []

    def write(self, photo: Photo, picture: NDArray[np.uint8]) -> None:
        if photo.frame is None:
            path = self._free(photo.path, ".png")
            write_atomically(path, cv2.imencode(".png", picture)[1].tobytes())
            self._written.append(path)
        else:
            self._video(photo, picture).write(picture)

    def close(self) -> None:
        for video in self._videos.values():
            video.release()

    def lines(self) -> list[str]:
        one = len(self._written) == 1
        return [f"overlay{'' if one else 's'}: {self._written[0] if one else self._folder}"]

    def _free(self, source: Path, ending: str) -> Path:
        """A name as the source's; numbered where two folders have files of one name."""
        number, free = 1, self._folder / f"{source.stem}{ending}"
        while free in self._written:
            number += 1
            free = self._folder / f"{source.stem}-{number}{ending}"
        return free

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
