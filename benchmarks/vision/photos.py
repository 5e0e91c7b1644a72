"""Real photographs with reference corners: OpenCV's own tutorial pictures (gold_corners.json: photo, id,
corners).

Each photo is read as the app reads a frame of the whole pad, with every code of its dictionary allowed, so
that a false marker can be found. Photos of the marker grid (gb...) show the dictionary that lies beside them;
the others OpenCV's 6X6_250. As in OpenCV's own test, each coordinate counts for itself. The references are
the outermost dark pixels, as contours have them, and the contours' corners that the app starts from are
judged by them; the border that they mean runs half a pixel further out, and what the app refines the corners
to is measured against that.
"""

import json
import math
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from benchmarks.report import figures_table
from companion.base.geometry import FloatArray, matrix_from_quat
from companion.base.messages import Frame
from companion.config import CameraConfig, VisionConfig
from companion.pad import DICTIONARIES, Pad, load_pad
from companion.sense.vision.aruco import CodeReader
from companion.sense.vision.corners import refine_quads
from companion.sense.vision.pipeline import Vision, body_from_camera, turn_covariance
from companion.tools.detect.run import CAMERA_ALONE, LOOKS

REFERENCES: Final = "gold_corners.json"
OWN_DICTIONARY: Final = ("gb", "tutorial_dict.yml")
CORNER_PX: Final = 1.0


@dataclass(frozen=True)
class PhotoErrors:
    """What was found in one: ids missed, false ones, and the errors of the others.

    `errors_px` (n, 4, 2) are the contours' corners less the references, which are contours' corners too;
    `border_errors_px` what the pose is made of, the refined corners, less the borders that these mean.
    """

    name: str
    printed: int
    errors_px: FloatArray
    border_errors_px: FloatArray
    missed: tuple[int, ...]
    false: tuple[int, ...]

    @property
    def worst_px(self) -> float:
        """The largest coordinate's error; infinite when nothing was found."""
        return float(np.abs(self.errors_px).max()) if len(self.errors_px) else float("inf")

    @property
    def holds(self) -> bool:
        """Whether all markers were found and no other, each corner where it is."""
        return not self.missed and not self.false and self.worst_px <= CORNER_PX


def read_photos(folder: Path) -> list[PhotoErrors]:
    """All photos that have references.

    Raises:
        OSError: a file is missing, or is no picture.
    """
    references = json.loads((folder / REFERENCES).read_text(encoding="utf-8"))
    return [
        _read(folder / name, {int(k): np.array(c) for k, c in of.items()}) for name, of in references.items()
    ]


def _read(path: Path, printed: dict[int, FloatArray]) -> PhotoErrors:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise OSError(f"{path}: not a picture")
    dictionary = _dictionary(path)
    count = len(dictionary.bytesList)
    grey = np.asarray(image, dtype=np.uint8)
    codes = CodeReader([dictionary], [(0, k) for k in range(count)]).read(
        grey, VisionConfig().minimum_side_px
    )
    contours: FloatArray = np.array([code.corners_px for code in codes]).reshape(-1, 4, 2)
    refined = (
        refine_quads(grey, contours, np.full(len(codes), dictionary.markerSize + 2.0)).corners
        if codes
        else contours
    )
    found = {code.number: both for code, *both in zip(codes, contours, refined, strict=True)}
    right = sorted(found.keys() & printed.keys())
    errors: FloatArray = np.array([found[k][0] - printed[k] for k in right]).reshape(-1, 4, 2)
    border: FloatArray = np.array([found[k][1] - outer_border(printed[k]) for k in right]).reshape(-1, 4, 2)
    missed, false = sorted(printed.keys() - found.keys()), sorted(found.keys() - printed.keys())
    return PhotoErrors(path.name, len(printed), errors, border, tuple(missed), tuple(false))


def outer_border(corners_px: FloatArray) -> FloatArray:
    """Corners (4, 2) with each side moved outwards by half a pixel; they go round clockwise in the image."""
    along = np.roll(corners_px, -1, axis=0) - corners_px
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    out = np.stack((along[:, 1], -along[:, 0]), axis=1)
    before = np.roll(out, 1, axis=0)
    return np.asarray(corners_px + 0.5 * (out + before) / (1.0 + (out * before).sum(axis=1, keepdims=True)))


def _dictionary(path: Path) -> cv2.aruco.Dictionary:
    prefix, name = OWN_DICTIONARY
    if not path.name.startswith(prefix):
        return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    storage = cv2.FileStorage(str(path.with_name(name)), cv2.FILE_STORAGE_READ)
    dictionary = cv2.aruco.Dictionary()
    if not dictionary.readDictionary(storage.root()):
        raise OSError(f"{path.with_name(name)}: not a dictionary")
    return dictionary


def _rms(errors_px: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors_px**2))) if errors_px.size else float("nan")


def photo_table(photos: list[PhotoErrors]) -> tuple[Table, dict[str, bool]]:
    """What was found beside what is there."""
    grid = figures_table(
        "Real photographs",
        *("photo", "found", "missed", "false", "rms px", f"worst coordinate px (≤{CORNER_PX:g})"),
        *("refined, to the border: rms px", "worst px"),
    )
    for photo in photos:
        grid.add_row(
            photo.name,
            f"{len(photo.errors_px)} of {photo.printed}",
            " ".join(map(str, photo.missed)) or "-",
            " ".join(map(str, photo.false)) or "-",
            f"{_rms(photo.errors_px):.2f}",
            f"{photo.worst_px:.2f}{'' if photo.holds else ' ✗'}",
            f"{_rms(photo.border_errors_px):.2f}",
            f"{np.abs(photo.border_errors_px).max(initial=0.0):.2f}",
        )
    return grid, {"photographs": bool(photos) and all(photo.holds for photo in photos)}


# ---------------------------------------------------------------- one tag many times
# AprilRobotics' test pictures (their test/data): prints of tag 36h11 number 0 lie about by the dozen, many
# of cells of 2 to 5 px. Beside each lies a text, a line for each tag that their detector reads: its number
# and its corners. To believe none of the sightings of a code where there are several is the pad's rule, not
# the reader's.

TAG_FAMILY: Final = cv2.aruco.DICT_APRILTAG_36h11
SAME_TAG_PX: Final = 4.0


@dataclass(frozen=True)
class TagCounts:
    """Of one picture: tags in the reference, how many of them we and the peer read, and ours of other ids."""

    name: str
    printed: int
    ours: int
    peers: int
    false: int


def read_tags(folder: Path) -> list[TagCounts]:
    """All pictures that have references.

    Raises:
        OSError: a file is missing, or is no picture.
    """
    return [_tags_in(path.with_suffix(".jpg"), path) for path in sorted(folder.glob("*_c.txt"))]


def _tags_in(picture: Path, references: Path) -> TagCounts:
    image = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise OSError(f"{picture}: not a picture")
    numbers, middles = [], []
    for line in references.read_text(encoding="utf-8").splitlines():
        number, *corners = line.translate(str.maketrans("(),", "   ")).split()
        numbers.append(int(number))
        middles.append(np.array(corners, dtype=np.float64).reshape(4, 2).mean(axis=0))
    dictionary = cv2.aruco.getPredefinedDictionary(TAG_FAMILY)
    reader = CodeReader([dictionary], [(0, k) for k in range(len(dictionary.bytesList))])
    codes = reader.read(np.asarray(image, np.uint8), VisionConfig().minimum_side_px)
    quads, _, _ = cv2.aruco.ArucoDetector(dictionary, cv2.aruco.DetectorParameters()).detectMarkers(image)
    ours, peers = (
        _matched(middles, [np.asarray(quad).reshape(4, 2).mean(axis=0) for quad in found])
        for found in ([code.corners_px for code in codes], quads)
    )
    false = sum(code.number not in numbers for code in codes)
    return TagCounts(picture.name, len(numbers), ours, peers, false)


def _matched(references: list[FloatArray], found: list[FloatArray]) -> int:
    """How many of the references (2,) px have a sighting about them."""
    return sum(any(np.hypot(*(each - at)) < SAME_TAG_PX for each in found) for at in references)


def tag_table(pictures: list[TagCounts]) -> tuple[Table, dict[str, bool]]:
    """What was read beside what their detector and OpenCV's read."""
    title = "AprilRobotics' pictures: one tag many times"
    grid = figures_table(title, "picture", "tags", "read", "OpenCV's", "others (0)")
    for each in pictures:
        numbers = (each.printed, each.ours, each.peers, each.false)
        grid.add_row(each.name, *(str(number) for number in numbers))
    held = bool(pictures) and all(each.ours and not each.false for each in pictures)
    return grid, {"one tag many times": held}


# ---------------------------------------------------------------- photoreal
# Photoreal pictures of printed pads with the true pose of each, beside OpenCV's detector and pose.
#
# A set is a folder of pictures with `truth.json`: `width`, `height`, `f_px` and for each of `images` its
# `file`, the camera's `position_m` in the pad's frame (origin in the middle, x right, y up in the print, z
# out of the pad) and `pad_from_camera` (OpenCV's axes). The principal point is the image's middle, there is
# no distortion, grey values are sRGB's. Noise of 2 grey values is added here, the same in every run.
#
# Ours is as `companion detect` sees a picture: nothing is expected and gravity is not known. The peer is
# `cv2.aruco.ArucoDetector` with CORNER_REFINE_SUBPIX, IPPE and Levenberg-Marquardt on all corners.

SETS: Final = {"moving": "moving_1300", "indoor": "indoor_400", "hard": "moving_1300"}
TRUTH: Final = "truth.json"
NOISE_GREY: Final = 2.0
# ours has x up the print, y to the right and z into the board
PAD_FROM_TRUTHS: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
MEDIAN_MM: Final = {"moving": 0.2, "indoor": 0.12, "hard": math.inf}
P90_MM: Final = 4.0
WORST_SHARE, WORST_DEG = 0.015, 3.0
NEES: Final = (2.0, 5.0)
SIGMAS: Final = 4.0

Pose = tuple[FloatArray, FloatArray]  # camera-from-pad (3, 3), the pad's centre (3,) in camera axes


@dataclass(frozen=True)
class PoseError:
    """Of one picture: position (m), as a share of the range, rotation (rad); and its NEES, if it is stated.

    The calibration's share of the covariance, which all frames have in common, is left out: there is no error
    of the calibration here.
    """

    position_m: float
    share: float
    rotation_rad: float
    position_nees: float = math.nan
    rotation_nees: float = math.nan


@dataclass(frozen=True)
class SetErrors:
    """Of one set: how many pictures, and the errors of those in which each found the pad."""

    name: str
    pictures: int
    ours: list[PoseError]
    peers: list[PoseError]


def read_set(folder: Path, pad_name: str) -> SetErrors:
    """All pictures of a set.

    Raises:
        OSError: a file is missing, or is no picture.
    """
    truth = json.loads((folder / TRUTH).read_text(encoding="utf-8"))
    camera, pad = _camera(truth), load_pad(pad_name)
    vision, peer = Vision(pad, camera, CAMERA_ALONE, VisionConfig()), Peer(pad, camera)
    ours, peers = [], []
    for entry in truth["images"]:
        image = _noisy(folder / entry["file"])
        true = _true_pose(entry)
        peer_pose = peer.look(image)
        if peer_pose is not None:
            peers.append(_error(true, peer_pose))
        found = _look(vision, image, true)
        if found is not None:
            ours.append(found)
    return SetErrors(folder.name, len(truth["images"]), ours, peers)


class Peer:
    """OpenCV's detector, with corners refined to a share of a pixel, and pose for one pad and camera."""

    def __init__(self, pad: Pad, camera: CameraConfig) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        names = sorted({marker.dictionary for marker in pad.markers})
        dictionaries = [cv2.aruco.getPredefinedDictionary(DICTIONARIES[name]) for name in names]
        self._detector = cv2.aruco.ArucoDetector(dictionaries, parameters)
        self._corners = {(names.index(m.dictionary), m.id): m.corners_pad_m() for m in pad.markers}
        self._matrix = np.array(
            [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]]
        )
        self._distortion = np.array(camera.distortion)

    def read(self, image: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray]:
        """Corners on the pad (n, 3) and in the image (n, 2) of the pad's markers that it reads."""
        quads, ids, _, which = self._detector.detectMarkersMultiDict(image)
        points, pixels = [np.empty((0, 3))], [np.empty((0, 2))]
        for quad, number, dictionary in zip(quads, _numbers(ids), _numbers(which), strict=True):
            corners = self._corners.get((dictionary, number))
            if corners is not None:
                points.append(corners)
                pixels.append(np.asarray(quad, dtype=np.float64).reshape(4, 2))
        return np.concatenate(points), np.concatenate(pixels)

    def look(self, image: NDArray[np.uint8]) -> Pose | None:
        """The pose from all corners."""
        return self.pose(*self.read(image))

    def pose(self, points: FloatArray, pixels: FloatArray) -> Pose | None:
        """The pose from corners on the pad (n, 3) and in the image (n, 2)."""
        if len(points) == 0:
            return None
        given = (points, pixels, self._matrix, self._distortion)
        solved, turns, places, _ = cv2.solvePnPGeneric(*given, flags=cv2.SOLVEPNP_IPPE)
        if not solved:
            return None
        turn, place = cv2.solvePnPRefineLM(*given, turns[0], places[0])
        return np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(place, np.float64).reshape(3)


def _numbers(values: Any) -> list[int]:
    return [] if values is None else [int(v) for v in np.asarray(values).reshape(-1)]


def _camera(truth: dict[str, Any]) -> CameraConfig:
    width, height, focal = truth["width"], truth["height"], truth["f_px"]
    return CameraConfig(
        name="photoreal", width_px=width, height_px=height, rate_hz=30.0, fx_px=focal, fy_px=focal,
        cx_px=0.5 * (width - 1), cy_px=0.5 * (height - 1), distortion=(0.0,) * 5, encoding="srgb",
    )  # fmt: skip


def _noisy(path: Path) -> NDArray[np.uint8]:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise OSError(f"{path}: not a picture")
    rng = np.random.default_rng(zlib.crc32(f"{path.parent.name}/{path.name}".encode()))
    noisy = image + rng.normal(0.0, NOISE_GREY, image.shape)
    return np.asarray(np.rint(noisy).clip(0, 255), dtype=np.uint8)


def _true_pose(entry: dict[str, Any]) -> Pose:
    camera_from_pad = np.array(entry["pad_from_camera"]).T
    return camera_from_pad @ PAD_FROM_TRUTHS.T, -camera_from_pad @ np.array(entry["position_m"])


def _error(true: Pose, told: Pose) -> PoseError:
    error, turn = told[1] - true[1], cv2.Rodrigues(told[0] @ true[0].T)[0]
    distance_m = float(np.linalg.norm(true[1]))
    error_m = float(np.linalg.norm(error))
    return PoseError(error_m, error_m / distance_m, float(np.linalg.norm(turn)))


def _look(vision: Vision, image: NDArray[np.uint8], true: Pose) -> PoseError | None:
    sightings = (vision.step(Frame(0.0, 0.0, 0, image), None).sighting for _ in range(LOOKS))
    sighting = next((sighting for sighting in sightings if sighting is not None), None)
    if sighting is None:
        return None
    camera_from_body = matrix_from_quat(body_from_camera(CAMERA_ALONE)).T
    rotation = camera_from_body @ matrix_from_quat(sighting.body_from_pad)
    position = camera_from_body @ np.array(sighting.pad_position_body_m)
    covariance = turn_covariance(sighting.covariance, camera_from_body)
    covariance[:3, :3] -= sighting.common_variance_m2 * np.eye(3)
    error, turn = position - true[1], cv2.Rodrigues(rotation @ true[0].T)[0].reshape(3)
    plain = _error(true, (rotation, position))
    return PoseError(
        plain.position_m,
        plain.share,
        plain.rotation_rad,
        float(error @ np.linalg.solve(covariance[:3, :3], error)),
        float(turn @ np.linalg.solve(covariance[3:, 3:], turn)),
    )


def photoreal_table(sets: list[SetErrors]) -> tuple[Table, dict[str, bool]]:
    """Ours beside the peer's and the bars."""
    grid = figures_table(
        "Photoreal pictures: ours / the peer's (bar)",
        *("set", "poses", "position mm: median", "p90", "largest, % of range", "largest turn °"),
        *("NEES position median, mean", "rotation median, mean", f"> {SIGMAS:g} sigma"),
    )
    bars: dict[str, bool] = {}
    for each in sets:
        held = _bars(each)
        bars |= {f"photoreal {each.name}: {name}": holds for name, holds in held.items()}
        marks = {name: "" if holds else " ✗" for name, holds in held.items()}
        both = (each.ours, each.peers)
        median, p90 = ([_mm(errors, share) for errors in both] for share in (50, 90))
        share = [100.0 * max((e.share for e in errors), default=math.nan) for errors in both]
        turn = [math.degrees(max((e.rotation_rad for e in errors), default=math.nan)) for errors in both]
        nees = [[getattr(e, f"{kind}_nees") for e in each.ours] for kind in ("position", "rotation")]
        grid.add_row(
            f"{each.name} ({each.pictures})",
            f"{len(each.ours)} / {len(each.peers)}{marks['found']}",
            f"{median[0]:.2f} / {median[1]:.2f} (≤{MEDIAN_MM.get(each.name, math.inf):g}){marks['median']}",
            f"{p90[0]:.1f} / {p90[1]:.1f} (≤{P90_MM:g}){marks['p90']}",
            f"{share[0]:.2f} / {share[1]:.2f} (≤{100.0 * WORST_SHARE:g}){marks['largest']}",
            f"{turn[0]:.2f} / {turn[1]:.2f} (≤{WORST_DEG:g}){marks['largest']}",
            f"{np.median(nees[0]):.2f}, {np.mean(nees[0]):.2f} ({NEES[0]:g}..{NEES[1]:g}){marks['NEES']}",
            f"{np.median(nees[1]):.2f}, {np.mean(nees[1]):.2f}",
            f"{_beyond(each.ours)} (0){marks['sigmas']}",
        )
    return grid, bars


def _bars(each: SetErrors) -> dict[str, bool]:
    ours = each.ours
    return {
        "found": len(ours) >= len(each.peers),
        "median": _mm(ours, 50) <= MEDIAN_MM.get(each.name, math.inf),
        "p90": _mm(ours, 90) <= P90_MM,
        "largest": all(e.share <= WORST_SHARE and e.rotation_rad <= math.radians(WORST_DEG) for e in ours),
        "NEES": bool(ours) and NEES[0] <= float(np.mean([e.position_nees for e in ours])) <= NEES[1],
        "sigmas": _beyond(ours) == 0,
    }


def _beyond(errors: list[PoseError]) -> int:
    return sum(max(e.position_nees, e.rotation_nees) > SIGMAS**2 for e in errors)


def _mm(errors: list[PoseError], percentile: float) -> float:
    return 1e3 * float(np.percentile([e.position_m for e in errors], percentile)) if errors else math.nan
