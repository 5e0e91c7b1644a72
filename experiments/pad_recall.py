"""How surely vision reads one marker, by the size and the sharpness of its cells: the fit behind coverage.

Single markers of each dictionary are shown to `companion.sense.vision.pipeline.Vision` through the simulated
camera (rolling shutter, noise, ground around the board), at random sizes, angles, speeds and blurs, expected
as in flight; what is read is fitted by maximum likelihood (`companion.tools.pads.coverage.RecallModel`).
Frames that took no part in the fit, and another camera, judge it.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich.table import Table
from scipy.optimize import minimize

from companion.base.geometry import (
    FloatArray,
    Vector3,
    add,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    subtract,
)
from companion.base.messages import Frame, PadPrior
from companion.config import CameraConfig, VehicleConfig, VisionConfig, find_file, load_model
from companion.pad import Marker, Pad
from companion.sense.vision.pipeline import Vision
from companion.tools.pads.coverage import Optics, RecallModel
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings

mpl.use("Agg")

SIDE_M: Final = 0.12
FAMILIES: Final = ("4x4_50", "5x5_50", "6x6_50")
IDS: Final = (3, 17)
LENS_BLURS_PX: Final = (0.45, 1.0, 2.0, 4.0)
CELL_PX: Final = (1.4, 25.0)
LONGEST_STROKE_CELLS: Final = 2.0
TILT_STD_DEG: Final = 4.0
OFFSET_SHARE: Final = 0.05
BOARD_HEIGHT_M: Final = 0.05
TICKS_PX: Final = (1.5, 2.0, 3.0, 5.0, 10.0, 20.0)
START: Final = RecallModel(2.2, 20.0, 0.4, 8.0, 0.99)
# of the recall, over the frames, class by class
LARGEST_MEAN_ERROR: Final = 0.03
CELL_CLASSES: Final = (1.4, 1.8, 2.1, 2.4, 2.8, 3.5, 5.0, 8.0, 25.0)
BLUR_CLASSES: Final = (0.0, 0.15, 0.25, 0.35, 0.45, 0.55, 0.7, 1.0)


@dataclass(frozen=True, slots=True)
class Looks:
    """Frames of single markers: each one's cell and blur (px), and whether it was read; all (n,)."""

    cell_px: FloatArray
    blur_px: FloatArray
    read: FloatArray

    @property
    def blur_cells(self) -> FloatArray:
        """Blur as a share of the cell."""
        return np.asarray(self.blur_px / self.cell_px)


def look(camera_name: str, frames: int, seed: int) -> Looks:
    """Show `frames` frames of each marker and lens to vision.

    Raises:
        ConfigError: there is no such camera.
    """
    camera = load_model(CameraConfig, find_file("cameras", camera_name))
    vehicle = load_model(VehicleConfig, find_file("vehicles", "x500"))
    rng = np.random.default_rng(seed)
    rows = [
        row
        for name in FAMILIES
        for identity in IDS
        for lens_px in LENS_BLURS_PX
        for row in _look_at(
            Marker(dictionary=name, id=identity, side_m=SIDE_M, position_pad_m=(0.0, 0.0), group="F"),
            camera,
            vehicle,
            lens_px,
            frames,
            rng,
        )
    ]
    return Looks(*np.array(rows).T)


def _look_at(
    marker: Marker,
    camera: CameraConfig,
    vehicle: VehicleConfig,
    lens_px: float,
    frames: int,
    rng: np.random.Generator,
) -> Iterator[tuple[float, float, float]]:
    """Cell and blur (px) and 1.0 for read, frame by frame; every other frame moves."""
    board_m = marker.side_m + 2.0 * marker.quiet_m
    pad = Pad(name="one", width_m=board_m, length_m=board_m, markers=(marker,))
    vision = Vision(pad, camera, vehicle, VisionConfig())
    model = CameraModel(camera, vehicle, pad, ImagingSettings(lens_blur_px=lens_px), rng)
    optics = Optics(lens_blur_px=lens_px)
    for k in range(frames):
        cell_px = math.exp(rng.uniform(math.log(CELL_PX[0]), math.log(CELL_PX[1])))
        stroke_px = rng.uniform(0.0, LONGEST_STROKE_CELLS) * cell_px if k % 2 else 0.0
        height_m = camera.fx_px * marker.cell_m / cell_px
        speed_m_s = stroke_px * height_m / (camera.fx_px * camera.exposure_s)
        shown = show(model, vehicle, height_m, speed_m_s, rng)
        read = vision.step(shown.frame, shown.prior).sighting is not None
        yield cell_px, optics.blur_px(camera.fx_px, height_m, stroke_px), float(read)


@dataclass(frozen=True, slots=True)
class Shown:
    """A frame of a board, where vision expects it, and where it is in the body at a time (s): truth."""

    frame: Frame
    prior: PadPrior
    pad_position_body_m: Callable[[float], Vector3]


def show(
    model: CameraModel, vehicle: VehicleConfig, height_m: float, speed_m_s: float, rng: np.random.Generator
) -> Shown:
    """A frame of the board, and where vision expects it: as in flight, not quite there."""
    roll, pitch = rng.normal(0.0, math.radians(TILT_STD_DEG), 2).tolist()
    yaw, heading, course = rng.uniform(-math.pi, math.pi, 3).tolist()
    attitude = quat_from_euler(roll, pitch, yaw)
    board = (0.0, 0.0, -BOARD_HEIGHT_M)
    mount_x, mount_y, mount_z = vehicle.camera_position_body_m
    # along the lens to the board, and a little aside
    to_board = quat_rotate(attitude, (mount_x, mount_y, mount_z + height_m))
    aside_x, aside_y = rng.normal(0.0, OFFSET_SHARE * height_m, 2).tolist()
    start = add(subtract(board, to_board), (aside_x, aside_y, 0.0))
    velocity = (speed_m_s * math.cos(course), speed_m_s * math.sin(course))

    def scene(time_s: float) -> ScenePose:
        x, y, z = start
        return ScenePose((x + velocity[0] * time_s, y + velocity[1] * time_s, z), attitude, board, heading)

    to_body = quat_conjugate(attitude)
    std_m = 0.02 + 0.02 * height_m
    error_x, error_y, error_z = rng.normal(0.0, std_m, 3).tolist()
    prior = PadPrior(
        0.0,
        quat_rotate(to_body, (0.0, 0.0, 1.0)),
        add(quat_rotate(to_body, subtract(board, start)), (error_x, error_y, error_z)),
        quat_multiply(to_body, quat_from_euler(0.0, 0.0, heading)),
        std_m,
    )
    return Shown(
        Frame(0.0, 0.0, 0, model.render(0.0, scene)),
        prior,
        lambda time_s: quat_rotate(to_body, subtract(board, scene(time_s).vehicle_position_ned_m)),
    )


def fit(looks: Looks) -> RecallModel:
    """The curves that make what was read likeliest."""

    def unlikeliness(numbers: FloatArray) -> float:
        p = np.clip(_model(numbers)(looks.cell_px, looks.blur_px), 1e-6, 1.0 - 1e-6)
        return float(-np.mean(looks.read * np.log(p) + (1.0 - looks.read) * np.log1p(-p)))

    s = START
    positive = np.log([s.cell_px, s.cell_steepness, s.blur_cells, s.blur_steepness])
    start = np.append(positive, math.log(s.most / (1.0 - s.most)))
    found = minimize(
        unlikeliness, start, method="Nelder-Mead", options={"maxiter": 4000, "xatol": 1e-4, "fatol": 1e-8}
    )
    return _model(found.x)


def _model(numbers: FloatArray) -> RecallModel:
    cell, cell_steepness, blur, blur_steepness = np.exp(numbers[:4]).tolist()
    return RecallModel(cell, cell_steepness, blur, blur_steepness, 1.0 / (1.0 + math.exp(-numbers[4])))


# ---------------------------------------------------------------- how well it fits


@dataclass(frozen=True, slots=True)
class Class:
    """Frames alike: their number, what share was read, and what was predicted."""

    name: str
    frames: int
    read: float
    predicted: float

    @property
    def error(self) -> float:
        """Of the prediction."""
        return self.predicted - self.read


def classes(looks: Looks, model: RecallModel) -> list[Class]:
    """Frames by the cell's width where blur is small, and by blur where cells are large."""
    predicted = model(looks.cell_px, looks.blur_px)
    made = []
    sharp, large = looks.blur_cells < 0.25, looks.cell_px > 4.0
    for name, values, bounds, where in (
        ("cell {:g} to {:g} px, sharp", looks.cell_px, CELL_CLASSES, sharp),
        ("blur {:g} to {:g} cells, large", looks.blur_cells, BLUR_CLASSES, large),
    ):
        for low, high in pairwise(bounds):
            inside = where & (values >= low) & (values < high)
            if inside.any():
                made.append(
                    Class(
                        name.format(low, high),
                        int(inside.sum()),
                        float(looks.read[inside].mean()),
                        float(predicted[inside].mean()),
                    )
                )
    return made


def table(judged: dict[str, list[Class]]) -> Table:
    """Read and predicted shares, class by class, for each set of frames."""
    made = Table(title="recall of one marker in %: read, predicted (frames)", title_justify="left")
    made.add_column("")
    for name in judged:
        made.add_column(name, justify="right")
    cells: dict[str, dict[str, str]] = {}
    for name, found in judged.items():
        for c in found:
            cells.setdefault(c.name, {})[name] = f"{100 * c.read:.0f}  {100 * c.predicted:.0f}  ({c.frames})"
    for kind, row in cells.items():
        made.add_row(kind, *(row.get(name, "") for name in judged))
    return made


def bars(judged: dict[str, list[Class]]) -> dict[str, bool]:
    """The error of the prediction, averaged over the frames of all classes: each set of frames by itself."""
    errors = {
        name: sum(c.frames * abs(c.error) for c in found) / sum(c.frames for c in found)
        for name, found in judged.items()
    }
    return {f"{name}: mean error {100 * e:.1f} %": e <= LARGEST_MEAN_ERROR for name, e in errors.items()}


def draw(looks: Looks, model: RecallModel, path: Path) -> None:
    """What was read by cell and by blur, and the curves.

    Raises:
        OSError: it cannot be written.
    """
    figure = Figure(figsize=(11.0, 4.4), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    sharp, large = looks.blur_cells < 0.25, looks.cell_px > 4.0
    cells, blurs = np.geomspace(*CELL_PX, 200), np.linspace(0.02, 1.0, 200)
    _draw_half(left, looks.cell_px[sharp], looks.read[sharp], np.geomspace(*CELL_PX, 20))
    left.plot(cells, model(cells, 0.1 * cells), color="#c0392b", label="fitted")
    left.set(xscale="log", xlabel="width of a cell (px)", title="sharp: blur under a quarter of a cell")
    left.set_xticks(TICKS_PX, [f"{px:g}" for px in TICKS_PX])
    left.minorticks_off()
    _draw_half(right, looks.blur_cells[large], looks.read[large], np.linspace(0.0, 1.0, 15))
    right.plot(blurs, model(np.full_like(blurs, 10.0), 10.0 * blurs), color="#c0392b", label="fitted")
    right.set(
        xlabel="blur (standard deviation, cells)", title="large: cells of 4 px and more", xlim=(0.0, 1.0)
    )
    left.legend(frameon=False)
    left.set_ylabel("recall of one marker")
    figure.savefig(path)


def _draw_half(axes: Any, values: FloatArray, read: FloatArray, bounds: FloatArray) -> None:
    middles, shares = [], []
    for low, high in pairwise(bounds.tolist()):
        inside = (values >= low) & (values < high)
        if inside.sum() >= 5:
            middles.append(float(values[inside].mean()))
            shares.append(float(read[inside].mean()))
    axes.plot(middles, shares, "o", color="#2471a3", markersize=4, label="read")
    axes.grid(alpha=0.3)
    axes.set_ylim(-0.03, 1.03)
