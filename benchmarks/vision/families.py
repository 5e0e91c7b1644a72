"""Recall, error and time by family of markers, beside the detectors that others use, on the same frames.

One marker, seen from each height by a camera of 1280x720 that hovers, tracked from frame to frame. Ours is
the step from frame to pose with what the app would expect. A peer detects and refines over the whole frame;
its pose, IPPE and Levenberg-Marquardt on its corners, is not timed. Peers: `cv2.aruco.ArucoDetector` with
CORNER_REFINE_SUBPIX and, for AprilTags where it is installed (`.[peers]`), pupil-apriltags, in full
resolution and as it comes (halved). Times are of one thread's own work; errors are of frames that both have
seen.
"""

import math
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from benchmarks.report import figures_table
from benchmarks.vision.cases import SEED
from benchmarks.vision.judge import eyes
from benchmarks.vision.photos import Peer
from benchmarks.vision.shots import PadBeforeCamera, camera_named
from benchmarks.vision.speed import FINDING, Follower, frames_of, hover_scene
from companion.base.geometry import FloatArray, norm, subtract, vector3
from companion.config import CameraConfig, VisionConfig
from companion.pad import Marker, Pad

SIZE: Final = "1280x720"
SIDE_M: Final = 0.2
HEIGHTS_M: Final = (0.6, 2.0, 5.0)
NUMBER: Final = 3
FAMILIES: Final = (
    "4x4_50",
    "5x5_100",
    "6x6_250",
    "7x7_1000",
    "aruco_original",
    "aruco_mip_36h12",
    "apriltag_16h5",
    "apriltag_25h9",
    "apriltag_36h10",
    "apriltag_36h11",
)
# as pupil-apriltags calls those that it has
PUPIL: Final = {"apriltag_16h5": "tag16h5", "apriltag_25h9": "tag25h9", "apriltag_36h11": "tag36h11"}
PUPIL_MODULE: Final = "pupil_apriltags"
# its corners begin at the bottom left of AprilRobotics' picture, which OpenCV draws upside down
PUPIL_ORDER: Final = (1, 0, 3, 2)
LEAST_TIMES_LESS: Final = 3.0
MOST_ERROR_SHARE: Final = 0.5


class Reader(Protocol):
    """Corners on the pad (n, 3) and in the image (n, 2) of the markers that it reads."""

    def read(self, image: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray]: ...


@cache
def _pupil_detector(family: str, halved: float) -> Any:
    """Kept for good: freeing some ends the interpreter."""
    return import_module(PUPIL_MODULE).Detector(families=family, nthreads=1, quad_decimate=halved)


class PupilDetector:
    """pupil-apriltags for a pad of one AprilTag."""

    def __init__(self, pad: Pad, halved: float) -> None:
        """`halved`: by how much it shrinks frames before it looks for outlines."""
        (self._marker,) = pad.markers
        self._detector = _pupil_detector(PUPIL[self._marker.dictionary], halved)

    def read(self, image: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray]:
        """Its pixels' middles lie at halves."""
        found: list[Any] = [d for d in self._detector.detect(image) if d.tag_id == self._marker.id]
        if len(found) != 1:
            return np.empty((0, 3)), np.empty((0, 2))
        corners = np.asarray(found[0].corners, np.float64)[PUPIL_ORDER, :] - 0.5
        return self._marker.corners_pad_m(), corners


@dataclass
class PeerRun:
    """A peer on the frames of one family: times (s), and errors (m) where it saw the marker, by frame."""

    times_s: list[float] = field(default_factory=list)
    errors_m: dict[int, float] = field(default_factory=dict)


@dataclass
class FamilyRun:
    """Ours and the peers on the frames of one family."""

    family: str
    ours: PeerRun = field(default_factory=PeerRun)
    peers: dict[str, PeerRun] = field(default_factory=dict)

    def error_share(self, peer: PeerRun) -> float:
        """Ours as a share of the peer's (root mean squares), of frames that both have seen."""
        both = self.ours.errors_m.keys() & peer.errors_m.keys()
        return rms([self.ours.errors_m[k] for k in both]) / rms([peer.errors_m[k] for k in both])

    def times_less(self, peer: PeerRun) -> float:
        """How many times less our median is."""
        return float(np.median(peer.times_s) / np.median(self.ours.times_s))


def rms(errors: Sequence[float]) -> float:
    """Root mean square; NaN of none."""
    return math.sqrt(sum(error**2 for error in errors) / len(errors)) if errors else math.nan


def family_pad(family: str) -> Pad:
    """One marker of it."""
    marker = Marker(dictionary=family, id=NUMBER, side_m=SIDE_M, position_pad_m=(0.0, 0.0))
    board_m = 1.5 * SIDE_M
    return Pad(name=f"one {family}", width_m=board_m, length_m=board_m, markers=(marker,))


def readers(pad: Pad, camera: CameraConfig) -> Iterator[tuple[str, Reader]]:
    """The peers that have the pad's family."""
    yield "OpenCV", Peer(pad, camera)
    if pad.markers[0].dictionary in PUPIL and find_spec(PUPIL_MODULE) is not None:
        yield "pupil-apriltags", PupilDetector(pad, 1.0)
        yield "the same, halved", PupilDetector(pad, 2.0)


def run_family(family: str, hovers: int) -> FamilyRun:
    """So many hovers at each height."""
    cv2.setNumThreads(1)
    run, number = FamilyRun(family), 0
    for height_m in HEIGHTS_M:
        for hover in range(hovers):
            rng = np.random.default_rng((SEED, zlib.crc32(f"{family} {height_m:g} {hover}".encode())))
            stage = PadBeforeCamera(camera_named(SIZE), family_pad(family), rng)
            number = _run_hover(run, stage, height_m, rng, number)
    return run


def _run_hover(
    run: FamilyRun, stage: PadBeforeCamera, height_m: float, rng: np.random.Generator, number: int
) -> int:
    """A hover's frames, counted on from a number; returns the next."""
    vision, follower, poses = eyes(stage, VisionConfig()), Follower(rng), Peer(stage.pad, stage.camera)
    peers = list(readers(stage.pad, stage.camera))
    scene = hover_scene(stage, height_m)
    for k, (frame, attitude) in enumerate(frames_of(stage, scene)):
        number += 1
        prior = follower.expects(frame.time_s, attitude)
        began_s = time.thread_time()
        sighting = vision.step(frame, prior).sighting
        took_s = time.thread_time() - began_s
        if sighting is not None:
            follower.take(sighting, attitude)
        if k < FINDING:
            continue
        run.ours.times_s.append(took_s)
        if sighting is not None:
            true = scene.pad_in_body(sighting.time_s)[0]
            run.ours.errors_m[number] = norm(subtract(sighting.pad_position_body_m, true))
        for name, reader in peers:
            peer = run.peers.setdefault(name, PeerRun())
            began_s = time.thread_time()
            points, pixels = reader.read(frame.image)
            peer.times_s.append(time.thread_time() - began_s)
            pose = poses.pose(points, pixels)
            if pose is not None:
                row = (float(pixels[:, 1].mean()) + 0.5) / stage.camera.height_px - 0.5
                _, true_camera_m = stage.pose_in_camera(scene, frame.time_s + row * stage.camera.readout_s)
                peer.errors_m[number] = norm(vector3(pose[1] - true_camera_m))
    return number


def family_table(runs: Sequence[FamilyRun]) -> tuple[Table, dict[str, bool]]:
    """A row a family and peer, and whether each bar holds for all of them."""
    grid = figures_table(
        f"One marker of {100 * SIDE_M:g} cm, tracked at {SIZE} from {HEIGHTS_M} m",
        *("family", "peer", "our recall %", "its", "our error mm", f"of its (≤{MOST_ERROR_SHARE:g})"),
        *("our ms", f"times less (≥{LEAST_TIMES_LESS:g})"),
    )
    recall = error = faster = True
    for run in runs:
        ours = run.ours
        frames, seen = len(ours.times_s), len(ours.errors_m)
        ours_mm, ours_ms = 1e3 * rms(list(ours.errors_m.values())), 1e3 * float(np.median(ours.times_s))
        for name, peer in run.peers.items():
            share, less, peers_seen = run.error_share(peer), run.times_less(peer), len(peer.errors_m)
            recall &= seen >= peers_seen
            error &= not share > MOST_ERROR_SHARE  # none, where the peer has seen nothing
            faster &= less >= LEAST_TIMES_LESS
            recalls = (f"{100.0 * count / frames:.1f}" for count in (seen, peers_seen))
            rest = (f"{ours_mm:.2f}", f"{share:.2f}", f"{ours_ms:.2f}", f"{less:.1f}")
            grid.add_row(run.family, name, *recalls, *rest)
    return grid, {"families' recall": recall, "families' errors": error, "families' time": faster}
