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
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.state.consistency import nees
from benchmarks.vision.judge import JudgedShot, bound_m2, eyes, judge, noise_px
from benchmarks.vision.shots import (
    ATTITUDE_STD_RAD,
    CAMERAS,
    BenchShot,
    PadBeforeCamera,
    camera_named,
    pad_of,
)
from companion.base.geometry import FloatArray
from companion.base.messages import PadPrior
from companion.config import VisionConfig
from companion.pad import DICTIONARIES, Pad
from companion.sense.vision.pipeline import Vision
from sitl.camera.textures import PAD_BLACK, PAD_WHITE, GreyImage, Texture, board_texture, ground_texture
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

    def stage(self, rng: np.random.Generator, finer: int = 1) -> PadBeforeCamera:
        """Its pad before its camera."""
        return PadBeforeCamera(camera_named(self.size), pad_of(self.side_cm), rng, finer=finer)


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
    stage, outcome = case.stage(rng, finer=FINER), CaseOutcome(case)
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


# ---------------------------------------------------------------- clutter
# Frames without the pad, full of what might be taken for it: none may become a sighting.
#
# A board lies where the pad would: foreign markers of the pad's own dictionaries (ids that are not printed on
# it) and of others, black squares with and without a random code in them, squares in squares, chessboards,
# lines of text, and patches of soil. Some boards hold one kind, most a mixture. A code that is one of the
# pad's bit for bit is left out: that is the pad's print. The app looks for the pad everywhere, or expects it
# where the board is, as after a pad that has been taken away.

BOARD_PX: Final = 2000
BOARD_M: Final = (0.5, 6.0)
HEIGHTS_M: Final = (0.15, 12.0)
SHOTS_OF_A_BOARD: Final = 50
THINGS: Final = 60
THING_SHARE: Final = (0.02, 0.3)
# every so many frames the pad is expected where it is not
EXPECTED_EVERY: Final = 3
FOREIGN: Final = (
    cv2.aruco.DICT_4X4_1000,
    cv2.aruco.DICT_5X5_1000,
    cv2.aruco.DICT_6X6_1000,
    cv2.aruco.DICT_7X7_1000,
    cv2.aruco.DICT_ARUCO_ORIGINAL,
    cv2.aruco.DICT_ARUCO_MIP_36h12,
    cv2.aruco.DICT_APRILTAG_16h5,
    cv2.aruco.DICT_APRILTAG_25h9,
    cv2.aruco.DICT_APRILTAG_36h11,
)
Painter = Callable[[np.random.Generator, int], GreyImage]


def same_dictionary(pad: Pad) -> Painter:
    """Markers of the pad's dictionaries with ids that are not on it."""
    free = [
        (name, number)
        for name in sorted({m.dictionary for m in pad.markers})
        for number in range(len(cv2.aruco.getPredefinedDictionary(DICTIONARIES[name]).bytesList))
        if (name, number) not in {(m.dictionary, m.id) for m in pad.markers}
    ]

    def paint(rng: np.random.Generator, side: int) -> GreyImage:
        name, number = free[int(rng.integers(len(free)))]
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[name])
        return _framed(cv2.aruco.generateImageMarker(dictionary, number, max(side, 16)))

    return paint


def other_dictionary(pad: Pad) -> Painter:
    """A marker of a larger or another dictionary."""

    def paint(rng: np.random.Generator, side: int) -> GreyImage:
        while True:
            dictionary = cv2.aruco.getPredefinedDictionary(FOREIGN[int(rng.integers(len(FOREIGN)))])
            number = int(rng.integers(len(dictionary.bytesList)))
            code = cv2.aruco.generateImageMarker(dictionary, number, dictionary.markerSize + 2)
            if not _printed_on(pad, code):
                return _framed(cv2.aruco.generateImageMarker(dictionary, number, max(side, 16)))

    return paint


def random_code(pad: Pad) -> Painter:
    """A black frame about random cells, of no dictionary."""

    def paint(rng: np.random.Generator, side: int) -> GreyImage:
        cells = int(rng.integers(3, 8))
        code = np.pad(rng.integers(0, 2, (cells, cells), dtype=np.uint8) * 255, 1)
        if _printed_on(pad, code):
            code = 255 - code
        cell = max(side // (cells + 2), 2)
        return _framed(code.repeat(cell, axis=0).repeat(cell, axis=1))

    return paint


def _printed_on(pad: Pad, code: NDArray[Any]) -> bool:
    """Whether a code (one pixel a cell) is one of the pad's, whichever side is up."""
    return any(np.array_equal(np.rot90(code, k), printed) for printed in _codes(pad) for k in range(4))


@lru_cache(maxsize=2)
def _codes(pad: Pad) -> tuple[GreyImage, ...]:
    dictionaries = {name: cv2.aruco.getPredefinedDictionary(DICTIONARIES[name]) for name in DICTIONARIES}
    codes = [(dictionaries[m.dictionary], m.id) for m in pad.markers]
    return tuple(
        np.asarray(cv2.aruco.generateImageMarker(d, n, d.markerSize + 2), np.uint8) for d, n in codes
    )


def squares(rng: np.random.Generator, side: int) -> GreyImage:
    """A full square, a frame, or squares in squares."""
    image = np.zeros((side, side), np.uint8)
    for k in range(int(rng.integers(0, 4))):
        cut = round(side * 0.12 * (k + 1))
        if side > 2 * cut:
            image[cut:-cut, cut:-cut] = 255 * ((k + 1) % 2)
    return _framed(image)


def chessboard(rng: np.random.Generator, side: int) -> GreyImage:
    """Of 4 to 9 squares a side."""
    cells = int(rng.integers(4, 10))
    checks = (np.indices((cells, cells)).sum(axis=0) % 2 * 255).astype(np.uint8)
    cell = max(side // cells, 2)
    return _framed(checks.repeat(cell, axis=0).repeat(cell, axis=1))


def text(rng: np.random.Generator, side: int) -> GreyImage:
    """Lines of letters."""
    image = np.full((side, side), 255, np.uint8)
    lines = int(rng.integers(2, 7))
    for line in range(lines):
        letters = "".join(chr(int(c)) for c in rng.integers(33, 91, 12))
        height = side / lines
        place = (2, round(height * (line + 0.8)))
        cv2.putText(
            image, letters, place, cv2.FONT_HERSHEY_SIMPLEX, height / 32, (0,), max(1, round(height / 9))
        )
    return image


def soil(rng: np.random.Generator, side: int) -> GreyImage:
    """A patch of rough ground with hard edges."""
    tile = ground_texture(int(rng.integers(2, 4))).levels[0].image
    row, column = rng.integers(0, tile.shape[0] // 2 - 1, 2)
    rough = tile[row : row + side, column : column + side].astype(float)
    return np.asarray(((rough - rough.mean()) * 3.0 + 128.0).clip(0, 255), dtype=np.uint8)


def _framed(image: NDArray[Any]) -> GreyImage:
    """With white around, as markers need."""
    return np.pad(np.asarray(image, dtype=np.uint8), max(2, image.shape[0] // 7), constant_values=255)


def clutter_board(rng: np.random.Generator, pad: Pad) -> tuple[Texture, float]:
    """A board full of things, and its side (m)."""
    kinds: list[Painter] = [
        *(same_dictionary(pad), other_dictionary(pad), random_code(pad), squares, chessboard, text, soil),
    ]
    chosen = kinds if rng.random() < 0.7 else [kinds[int(rng.integers(len(kinds)))]]
    canvas = np.full((BOARD_PX, BOARD_PX), 255, np.uint8)
    if rng.random() < 0.3:
        canvas = soil(rng, 600).repeat(4, axis=0).repeat(4, axis=1)[:BOARD_PX, :BOARD_PX].copy()
    for _ in range(THINGS):
        side = round(BOARD_PX * _drawn(rng, THING_SHARE))
        thing = chosen[int(rng.integers(len(chosen)))](rng, side)
        if rng.random() < 0.5:
            thing = np.ascontiguousarray(np.rot90(thing, int(rng.integers(4))))
        rows, columns = thing.shape
        if min(BOARD_PX - rows, BOARD_PX - columns) <= 0:
            continue
        row, column = int(rng.integers(BOARD_PX - rows)), int(rng.integers(BOARD_PX - columns))
        canvas[row : row + rows, column : column + columns] = thing
    grey = np.asarray(PAD_BLACK + canvas.astype(float) / 255.0 * (PAD_WHITE - PAD_BLACK), dtype=np.uint8)
    side_m = _drawn(rng, BOARD_M)
    return board_texture(grey, side_m, side_m), side_m


def _drawn(rng: np.random.Generator, between: tuple[float, float]) -> float:
    """Small and large alike."""
    low, high = between
    return float(low * (high / low) ** rng.uniform())


def clutter_shots(chunk: int, shots: int) -> list[tuple[PadBeforeCamera, BenchShot, PadPrior]]:
    """One board from several heights: the stage, each shot, and what the app expects."""
    rng = np.random.default_rng((SEED, 1_000_003, chunk))
    size = list(CAMERAS)[chunk % len(CAMERAS)]
    pad = pad_of(0.0)
    board, _ = clutter_board(rng, pad)
    stage = PadBeforeCamera(camera_named(size), pad, rng, board)
    made = []
    for k in range(shots):
        shot = stage.shoot(_drawn(rng, HEIGHTS_M))
        prior = shot.prior if k % EXPECTED_EVERY == 0 else PadPrior(0.0, shot.prior.down_body)
        made.append((stage, shot, prior))
    return made


def false_pads(chunk: int, shots: int) -> int:
    """How many shots of a board became a sighting."""
    made = clutter_shots(chunk, shots)
    vision = eyes(made[0][0], VisionConfig())
    return sum(vision.step(shot.frame, prior).sighting is not None for _, shot, prior in made)
