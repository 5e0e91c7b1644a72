"""Table 1: several markers against a single one, recall and precision over the heights of Tables 2 and 3.

The same rendered frames of a pad (rolling shutter, noise, blur of the motion; drawn aim, tilt, heading and
speed, but no vibration) are shown to vision in several ways: with all markers, by the joint pose that flies;
with all, by the paper's rule (each marker alone, eq. 1, mean); and for each group with one of its markers
known alone. Vision knows where the pad is expected, as in flight. Precision is the root mean square error
of the pad's position, all axes together.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.table import Table

from companion.base.geometry import norm, subtract
from companion.config import CameraConfig, VehicleConfig, VisionConfig, find_file, load_model
from companion.pad import Pad, load_pad
from companion.sense.vision.pipeline import Vision
from experiments.pad_recall import Shown, show
from sitl.camera.camera import CameraModel
from sitl.camera.exposure import ImagingSettings

HEIGHTS_M: Final = (0.3, 0.6, 1.0, 3.0, 9.0)
SPEED_STD_M_S: Final = 0.2
SEVERAL, BY_EQUATION_1, SINGLE = "all, joint", "all, eq. 1", "one "
BEST_SINGLE: Final = "one, best"
PAPER: Final = {"several": (99.3, 2.55), "single": (97.1, 4.89)}  # recall (%), precision (cm)


@dataclass(frozen=True, slots=True)
class Cell:
    """One way of looking from one height: frames, those with a pose, root mean square error (m)."""

    frames: int
    seen: int
    rmse_m: float

    @property
    def recall(self) -> float:
        """Share of the frames that gave a pose."""
        return self.seen / self.frames


Cells = Mapping[tuple[str, float], Cell]


def look(pad_name: str, camera_name: str, frames: int, seed: int) -> Cells:
    """`frames` frames from each height, each shown to all ways of looking.

    Raises:
        ConfigError: there is no such pad or camera.
    """
    pad = load_pad(pad_name)
    camera = load_model(CameraConfig, find_file("cameras", camera_name))
    vehicle = load_model(VehicleConfig, find_file("vehicles", "x500"))
    rng = np.random.default_rng(seed)
    model = CameraModel(camera, vehicle, pad, ImagingSettings(), rng)
    eyes = dict(_eyes(pad, camera, vehicle))
    cells: dict[tuple[str, float], Cell] = {}
    for height_m in HEIGHTS_M:
        errors: dict[str, list[float]] = {name: [] for name in eyes}
        for _ in range(frames):
            speed_m_s = abs(rng.normal(0.0, SPEED_STD_M_S))
            shown = show(model, vehicle, height_m, speed_m_s, rng)
            for name, group in eyes.items():
                error_m = _error(group[int(rng.integers(len(group)))], shown)
                errors[name] += [] if error_m is None else [error_m]
        for name, found in errors.items():
            rmse_m = math.sqrt(float(np.mean(np.square(found)))) if found else math.nan
            cells[name, height_m] = Cell(frames, len(found), rmse_m)
    return cells


def _eyes(pad: Pad, camera: CameraConfig, vehicle: VehicleConfig) -> Iterator[tuple[str, list[Vision]]]:
    """Each way of looking; of a single marker one for each of the group's, to be drawn from."""
    yield SEVERAL, [Vision(pad, camera, vehicle, VisionConfig())]
    yield BY_EQUATION_1, [Vision(pad, camera, vehicle, VisionConfig(pose="paper"))]
    for name in dict.fromkeys(marker.group for marker in pad.markers):
        group = [marker for marker in pad.markers if marker.group == name]
        alone = [pad.model_copy(update={"markers": (marker,)}) for marker in group]
        title = f"{SINGLE}{name} {100.0 * group[0].side_m:g} cm"
        yield title, [Vision(one, camera, vehicle, VisionConfig()) for one in alone]


def _error(vision: Vision, shown: Shown) -> float | None:
    """Of the pad's position (m); None without a pose."""
    sighting = vision.step(shown.frame, shown.prior).sighting
    if sighting is None:
        return None
    return norm(subtract(sighting.pad_position_body_m, shown.pad_position_body_m(sighting.time_s)))


# ---------------------------------------------------------------- what came of it


def names(cells: Cells) -> list[str]:
    """The ways of looking, in their order."""
    return list(dict.fromkeys(name for name, _ in cells))


def best_single(cells: Cells) -> list[Cell]:
    """Of each height the single marker that was seen most often, of equals the more exact one."""
    singles = [name for name in names(cells) if name.startswith(SINGLE)]
    return [max((cells[name, h] for name in singles), key=lambda c: (c.seen, -c.rmse_m)) for h in HEIGHTS_M]


def over_heights(row: Sequence[Cell]) -> tuple[float, float]:
    """Recall (%) over all frames, and the mean over the heights of the error (cm)."""
    recall = sum(cell.seen for cell in row) / sum(cell.frames for cell in row)
    return 100.0 * recall, 100.0 * float(np.nanmean([cell.rmse_m for cell in row]))


def table(cells: Cells) -> Table:
    """Recall and precision by height, and over all heights beside the paper's."""
    made = Table(title="Table 1: recall in %, error in cm (rms)", title_justify="left", padding=0)
    for heading in ("", *(f"{h:g} m" for h in HEIGHTS_M), "all", "paper"):
        made.add_column(heading, justify="right" if heading else "left")
    rows = {name: [cells[name, h] for h in HEIGHTS_M] for name in names(cells)}
    rows[BEST_SINGLE] = best_single(cells)
    for name, row in rows.items():
        recall, rmse_cm = over_heights(row)
        cited = {SEVERAL: "several", BEST_SINGLE: "single"}.get(name)
        paper = "" if cited is None else "{:g} {:g}".format(*PAPER[cited])
        made.add_row(
            name,
            *(f"{100 * c.recall:.0f} {100 * c.rmse_m:.2f}" if c.seen else "0 -" for c in row),
            f"{recall:.1f} {rmse_cm:.2f}",
            paper,
        )
    return made


def bars(cells: Cells) -> dict[str, bool]:
    """Several markers: not below the paper's figures, nor those of the best single marker at each height."""
    recall, rmse_cm = over_heights([cells[SEVERAL, h] for h in HEIGHTS_M])
    single_recall, single_cm = over_heights(best_single(cells))
    return {
        f"recall >= {PAPER['several'][0]:g} %": recall >= PAPER["several"][0],
        f"error <= {PAPER['several'][1]:g} cm": rmse_cm <= PAPER["several"][1],
        "recall >= the single's": recall >= single_recall,
        "error <= the single's": rmse_cm <= single_cm,
    }
