"""What the simulated camera looks at: the pad's print and the ground, as textures at several scales.

A texture lies in a plane with x up the image (the pad's heading, or north) and y to the right, metres.
Texels are light, not grey values: the camera encodes it. Texel centres are at whole numbers, as OpenCV
samples them. Each coarser scale is an exact area average
of the finest, so that a pixel never skips texels (no aliasing) and no edge moves (no bias).
"""

import math
import zlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.pad import Marker, Pad, dictionary_named

GreyImage = NDArray[np.uint8]

PAD_WHITE: Final = 222
# ink throws back a twentieth of what paper does
PAD_BLACK: Final = 11
PAD_TEXELS_PER_M: Final = 2400.0
PAD_COARSEST_PER_M: Final = 8.0
TARPAULIN_GREY: Final = 96
TARPAULIN_PER_M: Final = 100.0
GROUND_TEXELS_PER_M: Final = 64.0
GROUND_TILE_M: Final = 20.0
GROUND_LEVELS: Final = 6
# a level may hold this many texels a pixel before the next coarser one is taken
MAXIMUM_TEXELS_PER_PIXEL: Final = 1.2


@dataclass(frozen=True, slots=True)
class TextureLevel:
    """One scale: the image, and the affine map (3, 3) from plane metres (x, y, 1) to texels (u, v, 1)."""

    image: GreyImage
    texels_per_m: float
    texel_from_plane: FloatArray


@dataclass(frozen=True, slots=True)
class Texture:
    """The scales of one surface, finest first."""

    levels: tuple[TextureLevel, ...]

    def level_for(self, pixels_per_m: float) -> TextureLevel:
        """The finest scale that a camera resolving `pixels_per_m` on the surface samples without aliasing."""
        finest = MAXIMUM_TEXELS_PER_PIXEL * pixels_per_m
        return next((level for level in self.levels if level.texels_per_m <= finest), self.levels[-1])


@lru_cache(maxsize=4)
def pad_texture(pad: Pad) -> Texture:
    """The board as printed: black codes on white. Not to be drawn on."""
    return board_texture(_paint_pad(pad, PAD_TEXELS_PER_M), pad.width_m, pad.length_m)


@lru_cache(maxsize=4)
def other_ids_texture(pad: Pad) -> Texture:
    """The board of another pad: the same layout, other markers."""
    return pad_texture(pad.model_copy(update={"markers": tuple(map(_with_another_id, pad.markers))}))


def _with_another_id(marker: Marker) -> Marker:
    count = len(dictionary_named(marker.dictionary).bytesList)
    return marker.model_copy(update={"id": (marker.id + count // 2) % count})


@lru_cache(maxsize=4)
def covered_texture(pad: Pad) -> Texture:
    size = (round(pad.length_m * TARPAULIN_PER_M), round(pad.width_m * TARPAULIN_PER_M))
    return board_texture(np.full(size, TARPAULIN_GREY, np.uint8), pad.width_m, pad.length_m)


def board_texture(finest: GreyImage, width_m: float, length_m: float) -> Texture:
    """What is printed on a board, at scales a factor of sqrt(2) apart; the image's top edge is towards x."""
    levels: list[TextureLevel] = []
    texels_per_m = min(finest.shape[0] / length_m, finest.shape[1] / width_m)
    while texels_per_m >= PAD_COARSEST_PER_M:
        size = (max(2, round(width_m * texels_per_m)), max(2, round(length_m * texels_per_m)))
        image = finest if not levels else cv2.resize(finest, size, interpolation=cv2.INTER_AREA)
        levels.append(_board_level(np.asarray(image, dtype=np.uint8), width_m, length_m))
        texels_per_m /= math.sqrt(2.0)
    return Texture(tuple(levels))


@lru_cache(maxsize=4)
def ground_texture(seed: int) -> Texture:
    """Bare earth and grass: noise at several scales, without a seam, the same for the same seed.

    The tile is stored twice in each direction, so that a view which starts in one tile seldom needs
    wrapping (OpenCV's slow path).
    """
    size = round(GROUND_TILE_M * GROUND_TEXELS_PER_M)
    tile = _tileable_noise(size, np.random.default_rng(seed))
    levels = []
    for halvings in range(GROUND_LEVELS):
        side = size >> halvings
        image = cv2.resize(tile, (side, side), interpolation=cv2.INTER_AREA)
        s = side / GROUND_TILE_M
        affine = np.array([[0.0, s, -0.5], [-s, 0.0, -0.5], [0.0, 0.0, 1.0]])
        levels.append(TextureLevel(np.tile(np.asarray(image, dtype=np.uint8), (2, 2)), s, affine))
    return Texture(tuple(levels))


def _board_level(image: GreyImage, width_m: float, length_m: float) -> TextureLevel:
    rows, columns = image.shape
    per_x, per_y = rows / length_m, columns / width_m
    affine = np.array([[0.0, per_y, 0.5 * columns - 0.5], [-per_x, 0.0, 0.5 * rows - 0.5], [0.0, 0.0, 1.0]])
    return TextureLevel(image, min(per_x, per_y), affine)


def _paint_pad(pad: Pad, texels_per_m: float) -> GreyImage:
    size = (round(pad.length_m * texels_per_m), round(pad.width_m * texels_per_m))
    canvas = np.full(size, PAD_WHITE, np.uint8)
    plane = _board_level(canvas, pad.width_m, pad.length_m)
    rng = np.random.default_rng(zlib.crc32(pad.name.encode()))
    dot_m = pad.sheet.dot_m
    ink_m = float(rng.uniform(-0.5, 0.5)) * dot_m
    for marker in pad.markers:
        edges_m = ink_m + rng.uniform(-0.5, 0.5, 4) * dot_m
        _paint_marker(canvas, plane, marker, pad.printed(marker), edges_m)
    return canvas


def _paint_marker(
    canvas: GreyImage, plane: TextureLevel, marker: Marker, code: GreyImage, outwards_m: FloatArray
) -> None:
    """Lay one code (n, n) on the board, its edges where the printer puts them to a fraction of a texel.

    That is so far outwards (4,) of where the pad's data put them: top, right, bottom and left. An edge is up
    to half a dot off, and the ink runs on all edges alike.

    The code is drawn a little finer than the board and sampled bilinearly: the ramp of each edge is then
    centred on the true edge, whatever fraction of a texel or angle it lies at.
    """
    cells = len(code)
    per_cell = math.ceil(marker.side_m / cells * plane.texels_per_m)
    if marker.dictionary.startswith("apriltag"):
        code = np.rot90(code, 2)  # AprilRobotics' own picture of a tag, against OpenCV's
    print_ = np.where(code > 127, PAD_WHITE, PAD_BLACK).astype(np.uint8)
    print_ = np.pad(print_, 1, constant_values=PAD_WHITE).repeat(per_cell, axis=0).repeat(per_cell, axis=1)
    bounds = (
        _print_corners(marker, outwards_m) @ plane.texel_from_plane[:2, :2].T + plane.texel_from_plane[:2, 2]
    )
    target = bounds[:3]
    low = np.maximum(np.floor(bounds.min(axis=0)).astype(int) - 2, 0)
    high = np.minimum(np.ceil(bounds.max(axis=0)).astype(int) + 3, canvas.shape[::-1])
    first, last = per_cell - 0.5, per_cell * (cells + 1) - 0.5
    source = np.array([[first, first], [last, first], [last, last]], np.float32)
    affine = cv2.getAffineTransform(source, (target - low).astype(np.float32))
    patch = cv2.warpAffine(
        print_,
        affine,
        (int(high[0] - low[0]), int(high[1] - low[1])),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(PAD_WHITE,),
    )
    view = canvas[low[1] : high[1], low[0] : high[0]]
    np.minimum(view, patch, out=view)


def _print_corners(marker: Marker, outwards_m: FloatArray) -> FloatArray:
    """Where the print's corners lie on the board: (4, 2), x and y of the pad (m).

    Top left, top right, bottom right, bottom left of the code as one reads it. It is read from above with
    the pad's heading (x) up and y to the right, turned clockwise by the marker's yaw. Worked out here and
    not taken from the pad's own `corners_pad_m`, by which the app finds its way: a mistake in either shows.
    """
    yaw = math.radians(marker.yaw_deg)
    centre = np.array(marker.position_pad_m)
    up = np.array([math.cos(yaw), math.sin(yaw)])
    # a quarter of a turn clockwise, from x (up) to y (right), takes (x, y) to (-y, x)
    right = np.array([-up[1], up[0]])
    top, east, bottom, west = (0.5 * marker.side_m + outwards_m).tolist()
    corners = ((top, -west), (top, east), (-bottom, east), (-bottom, -west))
    return np.array([centre + a * up + b * right for a, b in corners])


def _tileable_noise(size: int, rng: np.random.Generator) -> GreyImage:
    """Noise with a falling spectrum, periodic because it is made of whole waves: soil, tufts, pebbles."""
    frequency = np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :]
    radius = np.hypot(*frequency) * size
    radius[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.standard_normal((size, size)))
    soil = np.fft.irfft2(spectrum * radius**-1.1 * (radius > 2.0), s=(size, size))
    grain = np.fft.irfft2(spectrum * radius**-0.4, s=(size, size))
    grey = 104.0 + 20.0 * soil / soil.std() + 11.0 * grain / grain.std()
    return np.asarray(grey.clip(8.0, 235.0), dtype=np.uint8)
