"""Frame time and recall while tracking, beside OpenCV's own detector over the whole frame, on the same
frames.

Ours is the whole step from frame to pose, with what the app would expect from its own last sighting: the pad
stays where it was, seen from where the vehicle now is by its attitude. The peer detects and refines corners,
no more: `cv2.aruco.ArucoDetector`, default settings with CORNER_REFINE_SUBPIX, both dictionaries of the pad.
Both look at each frame in turn, on one thread; times are that thread's, so that a busy machine does not
count.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from benchmarks.vision.cases import SEED
from benchmarks.vision.judge import eyes
from benchmarks.vision.photos import Peer
from benchmarks.vision.shots import ATTITUDE_STD_RAD, HoverScene, PadBeforeCamera, camera_named, pad_of
from companion.base.geometry import (
    Quaternion,
    Vector3,
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    yaw_from_quat,
)
from companion.base.messages import Frame, PadPrior, PadSighting
from companion.config import VisionConfig

HEIGHTS_M: Final = (0.15, 0.3, 0.6, 1.0, 3.0, 6.0, 9.0, 12.0)
FRAMES_OF_A_HOVER: Final = 30
# the first frames find the pad; they are not tracking yet
FINDING: Final = 2
# how far a prediction over one frame may be off beside what the last sighting was off by
UNKNOWN_SPEED_M_S: Final = 0.3


@dataclass
class Times:
    """Of both on the same frames: times (s) and how many frames showed them the pad."""

    size: str
    height_m: float
    ours_s: list[float] = field(default_factory=list)
    peers_s: list[float] = field(default_factory=list)
    ours_seen: int = 0
    peers_seen: int = 0

    @property
    def ratio(self) -> float:
        """How many times less our median is."""
        return float(np.median(self.peers_s) / np.median(self.ours_s))


class Follower:
    """What the app would expect: the last sighting's place, seen from the attitude that is now estimated."""

    def __init__(self, rng: np.random.Generator) -> None:
        east_north = rng.normal(0.0, ATTITUDE_STD_RAD, 2).tolist()
        self._wrong = quat_from_rotation_vector((*east_north, 0.0))
        self._place_ned_m: Vector3 | None = None
        self._heading_rad = self._std_m = self._time_s = 0.0

    def expects(self, time_s: float, attitude: Quaternion) -> PadPrior:
        """Before a frame; `attitude` is the true one, which the app's differs from."""
        attitude = quat_multiply(self._wrong, attitude)
        down = quat_rotate_inverse(attitude, (0.0, 0.0, 1.0))
        if self._place_ned_m is None:
            return PadPrior(time_s, down)
        level_pad = quat_from_euler(0.0, 0.0, self._heading_rad)
        std_m = self._std_m + UNKNOWN_SPEED_M_S * (time_s - self._time_s)
        body_from_pad = quat_multiply(quat_conjugate(attitude), level_pad)
        place = quat_rotate_inverse(attitude, self._place_ned_m)
        return PadPrior(time_s, down, place, body_from_pad, std_m)

    def take(self, sighting: PadSighting, attitude: Quaternion) -> None:
        """After a frame that showed it."""
        attitude = quat_multiply(self._wrong, attitude)
        self._place_ned_m = quat_rotate(attitude, sighting.pad_position_body_m)
        self._heading_rad = yaw_from_quat(quat_multiply(attitude, sighting.body_from_pad))
        self._std_m = float(np.sqrt(np.trace(sighting.covariance[:3, :3]) / 3.0))
        self._time_s = sighting.time_s


def measure(size: str, height_m: float, frames: int) -> Times:
    """Hovers at one height, until so many frames have been timed."""
    times, hovers = Times(size, height_m), 0
    while len(times.ours_s) < frames:
        rng = np.random.default_rng((SEED, 2_000_003, hovers, round(100 * height_m)))
        stage = PadBeforeCamera(camera_named(size), pad_of(0.0), rng)
        _time_hover(times, stage, rng, frames)
        hovers += 1
    return times


def _time_hover(times: Times, stage: PadBeforeCamera, rng: np.random.Generator, frames: int) -> None:
    vision, peer, follower = eyes(stage, VisionConfig()), Peer(stage.pad, stage.camera), Follower(rng)
    scene = hover_scene(stage, times.height_m)
    for k, (frame, attitude) in enumerate(frames_of(stage, scene)):
        prior = follower.expects(frame.time_s, attitude)
        began_s = time.thread_time()
        result = vision.step(frame, prior)
        ours_s = time.thread_time() - began_s
        began_s = time.thread_time()
        points, _ = peer.read(frame.image)
        peers_s = time.thread_time() - began_s
        if result.sighting is not None:
            follower.take(result.sighting, attitude)
        if k >= FINDING and len(times.ours_s) < frames:
            times.ours_s.append(ours_s)
            times.peers_s.append(peers_s)
            times.ours_seen += result.sighting is not None
            times.peers_seen += len(points) > 0


def hover_scene(stage: PadBeforeCamera, height_m: float) -> HoverScene:
    """One that lasts for the frames of a hover."""
    return stage.scene(height_m, follows_s=FRAMES_OF_A_HOVER / stage.camera.rate_hz)


def frames_of(stage: PadBeforeCamera, scene: HoverScene) -> Iterator[tuple[Frame, Quaternion]]:
    """Frames one after another, and the true attitude at each."""
    period_s = 1.0 / stage.camera.rate_hz
    for k in range(FRAMES_OF_A_HOVER):
        yield stage.frame(scene, k * period_s), scene.pose(k * period_s).vehicle_attitude
