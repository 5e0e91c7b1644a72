"""How well a camera will see a pad from each height: per group, and P_ND = prod(1 - P_i) for the pad.

The vehicle hovers over the pad: its poses spread about the middle in place, tilt and heading. For each pose a
marker counts when it is wholly in the image, with the probability that it is then read; the product over the
markers is taken pose by pose and then averaged, since what is in view at the same time is anything but
independent. Heights are those of the lens over the surface; camera axes as OpenCV has them, SI.

How surely a marker that is wholly in view is read (P_i, section 2.2) depends on the cell of its code: how
many pixels wide its image is, and what blur leaves of it. The probability is a constant times two logistic
curves in logarithms, one of the cell's width and one of the blur's share of it. Blur is one standard
deviation: of the lens and its focus as a Gauss bell, of motion as a stroke (its length over sqrt(12)). The
numbers are fitted, not assumed: `python -m experiments pad-recall` shows single markers to vision through the
simulated camera, and prints them.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import expit, ndtri

from companion.base.geometry import FloatArray
from companion.base.messages import MarkerGroup
from companion.config import CameraConfig
from companion.pad import Pad
from companion.sense.vision.aruco import GROUPS
from companion.sense.vision.lens import Lens
from companion.sense.vision.search import EDGE_PX


@dataclass(frozen=True, slots=True)
class RecallModel:
    """The two curves: where each is at one half, and how steep it is there (in logarithms)."""

    cell_px: float  # width of a cell that is read half of the time, when sharp
    cell_steepness: float
    blur_cells: float  # blur, in widths of a cell, at which a large one is read half of the time
    blur_steepness: float
    most: float  # of markers that are large and sharp

    def __call__(self, cell_px: FloatArray, blur_px: FloatArray | float) -> FloatArray:
        """Probability (...) that a marker wholly in view is read, by its cell's width and the blur (px)."""
        large = expit(self.cell_steepness * np.log(cell_px / self.cell_px))
        sharp = expit(self.blur_steepness * np.log(self.blur_cells * cell_px / blur_px))
        return np.asarray(self.most * large * sharp)


@dataclass(frozen=True, slots=True)
class Optics:
    """What blurs an image; by default a small f/2 lens of 3 mm, as a Raspberry Pi's."""

    lens_blur_px: float = 0.45  # standard deviation, in focus
    aperture_m: float = 0.0015
    focus_m: float = 1.5

    def blur_px(self, focal_px: float, distance_m: float, stroke_px: float) -> float:
        """Standard deviation of lens, focus and motion together.

        That of focus is a quarter of the circle of confusion's diameter.
        """
        circle_px = focal_px * self.aperture_m * abs(1.0 / distance_m - 1.0 / self.focus_m)
        return math.hypot(self.lens_blur_px, 0.25 * circle_px, stroke_px / math.sqrt(12.0))


# `python -m experiments pad-recall` with its defaults
FITTED: Final = RecallModel(2.151, 15.59, 0.4071, 7.009, 0.9943)


# ---------------------------------------------------------------- the camera over the pad

LOWEST_M: Final = 0.03
HIGHEST_M: Final = 30.0
HEIGHTS: Final = 81
# poses at each height: a power of two, as Sobol's sequence has it
POSES_LOG2: Final = 8
# below this recall the pad is called blind
BLIND_RECALL: Final = 0.5


@dataclass(frozen=True, slots=True)
class HoverSpread:
    """How the vehicle hovers over the pad: standard deviations about its middle, any heading.

    The offset grows with the height from what a touchdown misses by.
    """

    offset_m: float = 0.03
    offset_share: float = 0.05  # of the height
    tilt_deg: float = 3.0
    speed_m_s: float = 0.3  # relative to the pad, across the view: motion blur

    @property
    def words(self) -> str:
        """As it stands beside a prediction."""
        return (
            f"{100 * self.offset_m:g} cm and {100 * self.offset_share:g} % of the height off the middle, "
            f"{self.tilt_deg:g}° of tilt (standard deviations), {self.speed_m_s:g} m/s"
        )


HOVER: Final = HoverSpread()
SMALL_LENS: Final = Optics()


@dataclass(frozen=True, slots=True)
class PredictedRecall:
    """Predicted recall by height: of each group that the pad has (n,), and of the pad (n,)."""

    heights_m: FloatArray
    groups: dict[MarkerGroup, FloatArray]
    pad: FloatArray

    @property
    def blind_height_m(self) -> float:
        """Below this the pad is seen less than half of the time; the lowest height if it is seen there."""
        return seen_between(self.heights_m, self.pad, BLIND_RECALL)[0]

    @property
    def seen_at_the_lowest(self) -> bool:
        """Whether the pad is seen even from the lowest height that was asked for."""
        return bool(self.pad[0] >= BLIND_RECALL)


def predict(
    pad: Pad,
    camera: CameraConfig,
    spread: HoverSpread = HOVER,
    heights_m: FloatArray | None = None,
    optics: Optics = SMALL_LENS,
    model: RecallModel = FITTED,
) -> PredictedRecall:
    """Predict the recall at heights (n,), from 3 cm to 30 m if none are given."""
    heights = np.geomspace(LOWEST_M, HIGHEST_M, HEIGHTS) if heights_m is None else heights_m
    view = _View(pad, camera, spread, optics, model)
    missed = np.array([1.0 - view.read(height_m) for height_m in heights.tolist()])
    members = {g: np.array([m.group == g for m in pad.markers]) for g in GROUPS}
    groups = {g: 1.0 - missed[:, :, m].prod(axis=2).mean(axis=1) for g, m in members.items() if m.any()}
    return PredictedRecall(heights, groups, 1.0 - missed.prod(axis=2).mean(axis=1))


def seen_between(heights_m: FloatArray, recall: FloatArray, least: float) -> tuple[float, float]:
    """The lowest and the highest height with at least this recall, NaN when there is none.

    Between two heights the recall is taken to be straight over the logarithm of the height.
    """
    good = np.flatnonzero(recall >= least)
    if len(good) == 0:
        return (float("nan"), float("nan"))
    logs = np.log(heights_m)

    def crossing(inside: int, outside: int) -> float:
        if not 0 <= outside < len(recall):
            return float(heights_m[inside])
        share = (recall[inside] - least) / (recall[inside] - recall[outside])
        return float(np.exp(logs[inside] + share * (logs[outside] - logs[inside])))

    first, last = int(good[0]), int(good[-1])
    return crossing(first, first - 1), crossing(last, last + 1)


class _View:
    """The pad's markers in the image, from poses over the pad."""

    def __init__(
        self, pad: Pad, camera: CameraConfig, spread: HoverSpread, optics: Optics, model: RecallModel
    ) -> None:
        from scipy.stats import qmc  # noqa: PLC0415 - slow

        self._corners = np.array([marker.corners_pad_m() for marker in pad.markers])
        self._cells = np.array([marker.cells for marker in pad.markers])
        self._lens, self._exposure_s = Lens(camera), camera.exposure_s
        self._spread, self._optics, self._model = spread, optics, model
        self._draws = qmc.Sobol(5, rng=np.random.default_rng(0)).random_base2(POSES_LOG2)

    def read(self, height_m: float) -> FloatArray:
        """Probability (poses, markers) that each marker is read from each pose at one height."""
        rotations, middles = _poses(self._draws, self._spread, height_m)
        points = self._corners.reshape(-1, 3) @ np.swapaxes(rotations, 1, 2) + middles[:, None, :]
        pixels = self._lens.project(points.reshape(-1, 3))[0].reshape(len(points), -1, 4, 2)
        low, high = np.array([EDGE_PX, EDGE_PX]), np.array(self._lens.size_px) - EDGE_PX
        with np.errstate(invalid="ignore"):
            whole = ((pixels > low) & (pixels < high)).all(axis=(2, 3))
        sides_px = np.linalg.norm(pixels - np.roll(pixels, 1, axis=2), axis=3).mean(axis=2)
        cell_px = np.where(whole, sides_px / self._cells, 1.0)
        focal_px = self._lens.focal_px
        stroke_px = focal_px * self._exposure_s * self._spread.speed_m_s / height_m
        blur_px = self._optics.blur_px(focal_px, height_m, stroke_px)
        return np.asarray(np.where(whole, self._model(cell_px, blur_px), 0.0))


def _poses(draws: FloatArray, spread: HoverSpread, height_m: float) -> tuple[FloatArray, FloatArray]:
    """Camera-from-pad rotations (n, 3, 3) and the pad's middle in camera axes (n, 3), from draws (n, 5)."""
    normal = ndtri(np.clip(draws[:, :4], 1e-6, 1.0 - 1e-6))
    offset = np.hypot(spread.offset_m, spread.offset_share * height_m) * normal[:, :2]
    tilt = np.radians(spread.tilt_deg) * normal[:, 2:]
    yaw = 2.0 * np.pi * draws[:, 4]
    zero, one = np.zeros_like(yaw), np.ones_like(yaw)

    def matrices(*rows: tuple[FloatArray, FloatArray, FloatArray]) -> FloatArray:
        return np.asarray(np.moveaxis(np.array(rows), 2, 0))

    (ca, cb, cy), (sa, sb, sy) = ((f(tilt[:, 0]), f(tilt[:, 1]), f(yaw)) for f in (np.cos, np.sin))
    about_x = matrices((one, zero, zero), (zero, ca, -sa), (zero, sa, ca))
    about_y = matrices((cb, zero, sb), (zero, one, zero), (-sb, zero, cb))
    about_z = matrices((cy, -sy, zero), (sy, cy, zero), (zero, zero, one))
    rotations = about_x @ about_y @ about_z
    # the pad's z is down, as a camera's that looks down
    middle = np.column_stack((offset, np.full(len(yaw), height_m)))
    return rotations, np.einsum("pij,pj->pi", about_x @ about_y, middle)
