"""Frames without the pad, full of what might be taken for it: none may become a sighting.

A board lies where the pad would: foreign markers of the pad's own dictionaries (ids that are not printed on
it) and of others, black squares with and without a random code in them, squares in squares, chessboards,
lines of text, and patches of soil. Some boards hold one kind, most a mixture. A code that is one of the pad's
bit for bit is left out: that is the pad's print. The app looks for the pad everywhere, or expects it where
the board is, as after a pad that has been taken away.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.vision.cases import SEED
from benchmarks.vision.judge import eyes
from benchmarks.vision.shots import CAMERAS, BenchShot, PadBeforeCamera, pad_of
from companion.base.messages import PadPrior
from companion.config import VisionConfig
from companion.pad import DICTIONARIES, Pad
from sitl.camera.textures import PAD_BLACK, PAD_WHITE, GreyImage, Texture, board_texture, ground_texture

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
    board, _ = clutter_board(rng, pad_of(0.0))
    stage = PadBeforeCamera(size, 0.0, rng, board)
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
