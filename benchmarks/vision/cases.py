"""The cases of the bench: which pad from which height by which camera, and what many shots of one came to.

A case's shots are drawn by (seed, case, chunk), and each chunk has a renderer of its own: how many processes
share the work changes no figure.

Each shot is judged twice. With the lens exactly as calibrated, no error of the calibration allowed for and
gravity known as well as it is drawn, the covariance says what the corners' noise does. With the settings as
they are shipped and a calibration that is wrong by `sense.vision.scale_error` in focal length and centre,
drawn anew for each shot, it says what a user's camera does: in one flight that error is the same for all
frames, so only frames of different calibrations count as independent. Recall and flips are of the latter.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from benchmarks.state.consistency import nees
from benchmarks.vision.judge import JudgedShot, bound_m2, eyes, judge, noise_px
from benchmarks.vision.shots import ATTITUDE_STD_RAD, PadBeforeCamera
from companion.base.geometry import FloatArray
from companion.config import VisionConfig
from companion.sense.vision.pipeline import Vision
from sitl.run.scene_camera import perturbed_lens

SEED: Final = 11
# places a pixel, each way: with one, the renderer's own edges are off by up to 0.06 px, where corners are
# found to half of that, and a marker of 35 px along the pixels' rows seems to tilt to the other side
FINER: Final = 2
MOST_TILT_RAD: Final = math.radians(10.0)
# fewer sightings say nothing about errors
FEW: Final = 10


@dataclass(frozen=True)
class VisionCase:
    """A pad of one marker of that side (0: the shipped pad) from a height over its surface."""

    size: str
    side_cm: float
    height_m: float
    tilted: bool = False

    def rng(self, chunk: int) -> np.random.Generator:
        """The dice of one chunk of its shots."""
        name = f"{self.size} {self.side_cm:g} {self.height_m:g} {self.tilted}"
        return np.random.default_rng((SEED, zlib.crc32(name.encode()), chunk))


@dataclass
class CaseOutcome:
    """What shots of a case came to; `calibrated` are the same as a user's camera sees them."""

    case: VisionCase
    exact: list[JudgedShot] = field(default_factory=list)
    calibrated: list[JudgedShot] = field(default_factory=list)
    paper: list[JudgedShot] = field(default_factory=list)

    def join(self, other: CaseOutcome) -> None:
        """Take another chunk of the same case in."""
        self.exact += other.exact
        self.calibrated += other.calibrated
        self.paper += other.paper

    @property
    def shots(self) -> int:
        """How many there were."""
        return len(self.calibrated)

    @property
    def recall(self) -> float:
        """Share of the shots in which the pad was found."""
        return sum(shot.seen for shot in self.calibrated) / max(self.shots, 1)

    @property
    def missed(self) -> int:
        """Shots in which it was not."""
        return sum(not shot.seen for shot in self.calibrated)

    @property
    def flips(self) -> int:
        """Shots with a wrong orientation."""
        return sum(shot.flipped for shot in self.calibrated)

    @property
    def rmse_m(self) -> float:
        """Of the position, all three axes together; NaN without enough sightings."""
        return rmse_m(self.exact)

    @property
    def bound_m(self) -> float:
        """Cramér-Rao bound of that."""
        noise, shots = noise_px(self.exact), _seen(self.exact)
        if len(shots) < FEW:
            return math.nan
        return math.sqrt(float(np.mean([bound_m2(shot, noise) for shot in shots])))

    @property
    def noise(self) -> str:
        """Of the corners (px), by group."""
        return " ".join(f"{g} {px:.2f}" for g, px in sorted(noise_px(self.exact).items()))


def rmse_m(shots: Iterable[JudgedShot]) -> float:
    """Root mean square of the position's error."""
    seen = _seen(shots)
    return math.sqrt(float(np.mean([shot.squared_m2 for shot in seen]))) if len(seen) >= FEW else math.nan


def mean_nees(shots: Iterable[JudgedShot]) -> tuple[float, int]:
    """Mean NEES of the position, and over how many independent shots."""
    seen = _seen(shots)
    if len(seen) < FEW:
        return math.nan, len(seen)
    errors = np.array([shot.error_m for shot in seen])
    covariances: FloatArray = np.array([shot.covariance_m2 for shot in seen])
    return float(np.mean(nees(errors, covariances))), len(seen)


def _seen(shots: Iterable[JudgedShot]) -> list[JudgedShot]:
    return [shot for shot in shots if shot.seen]


def run_chunk(case: VisionCase, chunk: int, shots: int) -> CaseOutcome:
    """Render and judge some shots of a case."""
    rng = case.rng(chunk)
    stage, outcome = PadBeforeCamera(case.size, case.side_cm, rng, finer=FINER), CaseOutcome(case)
    shipped = VisionConfig()

    def calibrated() -> Vision:
        return eyes(stage, shipped, perturbed_lens(stage.camera, shipped.scale_error, rng))

    if case.tilted:
        for _ in range(shots):
            shot = stage.shoot(case.height_m, float(rng.uniform(0.0, MOST_TILT_RAD)))
            outcome.calibrated.append(judge(calibrated(), stage, shot))
        return outcome
    exact = eyes(stage, VisionConfig(scale_error=0.0, level_std_deg=math.degrees(ATTITUDE_STD_RAD)))
    paper = eyes(stage, VisionConfig(pose="paper"))
    for _ in range(shots):
        shot = stage.shoot(case.height_m)
        outcome.exact.append(judge(exact, stage, shot, corners=True))
        outcome.calibrated.append(judge(calibrated(), stage, shot))
        outcome.paper.append(judge(paper, stage, shot))
    return outcome
