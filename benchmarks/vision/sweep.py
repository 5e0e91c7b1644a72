"""From which heights the pad is found, beside OpenCV's detector: each shipped pad before each shipped camera.

At each height of a geometric row a few hovers are drawn: level, tilted by up to 15°, and so far aside that
half of the pad is out of the picture; each with what the app would expect of the pad, and with nothing but
gravity. A hole is a frame in which the peer reads a marker of the pad, and ours has not found the pad when it
has looked at that frame three times, as at three that follow each other.
"""

import math
import zlib
from collections import Counter
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from rich.table import Table

from benchmarks.report import figures_table
from benchmarks.vision.cases import SEED
from benchmarks.vision.photos import Peer
from benchmarks.vision.shots import HoverScene, PadBeforeCamera, vehicle
from companion.base.messages import Frame, PadPrior
from companion.config import CameraConfig, VisionConfig, find_file, load_model
from companion.pad import load_pad
from companion.sense.vision.pipeline import Vision

PADS: Final = ("indoor_400", "moving_1300", "touchdown_1300")
CAMERAS: Final = (
    *("sitl_640x480", "hd_1280x720", "pi_v2_640x480", "pi_v3_1152x648"),
    *("pi_global_shutter_728x544", "usb_ov9281_1280x800"),
)
VIEWS: Final = ("level", "tilted", "half out")
LOWEST_M, STEP, MOST_SIDES = 0.05, 1.15, 40.0
MOST_TILT_RAD: Final = math.radians(15.0)
FRAMES: Final = 3


@dataclass(frozen=True)
class SweepCase:
    """A pad before a camera, in one way of hovering."""

    pad: str
    camera: str
    view: str


@dataclass(frozen=True)
class SweepOutcome:
    """How many frames the peer read, and the holes: (height, with a prior?)."""

    case: SweepCase
    read: int
    holes: tuple[tuple[float, bool], ...]


def aside(scene: HoverScene, away: float, rng: np.random.Generator) -> HoverScene:
    """The same, so far (m) to any side."""
    north, east, down = scene.start_ned_m
    way = float(rng.uniform(-math.pi, math.pi))
    return replace(scene, start_ned_m=(north + away * math.cos(way), east + away * math.sin(way), down))


def cases() -> list[SweepCase]:
    """All of them."""
    return [SweepCase(pad, camera, view) for pad in PADS for camera in CAMERAS for view in VIEWS]


def sweep(case: SweepCase, shots: int) -> SweepOutcome:
    """So many hovers at each height."""
    rng = np.random.default_rng((SEED, zlib.crc32(f"{case.pad} {case.camera} {case.view}".encode())))
    camera = load_model(CameraConfig, find_file("cameras", case.camera))
    stage = PadBeforeCamera(camera, load_pad(case.pad), rng, instants=3)
    peer = Peer(stage.pad, stage.camera)
    read, holes = 0, []
    height_m = LOWEST_M
    while height_m < MOST_SIDES * max(marker.side_m for marker in stage.pad.markers):
        for _ in range(shots):
            tilt = float(rng.uniform(0.0, MOST_TILT_RAD)) if case.view == "tilted" else None
            scene = stage.scene(height_m, tilt)
            scene = aside(scene, 0.5 * stage.pad.width_m, rng) if case.view == "half out" else scene
            frame, prior = stage.frame(scene, 0.0), stage.expectation(scene, 0.0, height_m)
            if len(peer.read(frame.image)[0]) == 0:
                continue
            read += 1
            nothing = PadPrior(prior.time_s, prior.down_body, rate_body_rad_s=prior.rate_body_rad_s)
            holes += [
                (height_m, told is prior) for told in (prior, nothing) if not _found(stage, frame, told)
            ]
        height_m *= STEP
    return SweepOutcome(case, read, tuple(holes))


def _found(stage: PadBeforeCamera, frame: Frame, prior: PadPrior) -> bool:
    vision = Vision(stage.pad, stage.camera, vehicle(), VisionConfig())
    return any(vision.step(frame, prior).sighting is not None for _ in range(FRAMES))


def sweep_table(outcomes: list[SweepOutcome]) -> tuple[Table, dict[str, bool]]:
    """Holes by pad and camera."""
    title = f"Frames that OpenCV reads, not found within {FRAMES} frames: with a prior, without one"
    grid = figures_table(title, "pad", "camera", *VIEWS, "holes at m")
    pairs = dict.fromkeys((outcome.case.pad, outcome.case.camera) for outcome in outcomes)
    for pad, camera in pairs:
        rows = {o.case.view: o for o in outcomes if (o.case.pad, o.case.camera) == (pad, camera)}
        cells, where = [], Counter[float]()
        for view in VIEWS:
            outcome = rows.get(view)
            if outcome is None:
                cells.append("-")
                continue
            told = sum(with_prior for _, with_prior in outcome.holes)
            cells.append(f"{told}, {len(outcome.holes) - told} of {outcome.read}")
            where.update(round(height_m, 2) for height_m, _ in outcome.holes)
        grid.add_row(pad, camera, *cells, " ".join(f"{h:g}" for h in sorted(where)) or "-")
    return grid, {"sweep": bool(outcomes) and not any(outcome.holes for outcome in outcomes)}
