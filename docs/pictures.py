"""The pictures in the documentation, from a recorded flight and from the simulated camera.

    python -m docs.pictures flights/circle --to docs/images

reads flights/circle/flight.mcap and writes landing.gif, camera and side view of the landing in real time,
landing.png, the flight's path in three dimensions (in the style of the paper's Fig. 14), and view.png, what
the camera sees of the pad from 7 m, 2 m and 0.5 m with the markers that the pose was fitted to. NED, metres;
drawn with up upwards.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from mcap.reader import make_reader
from numpy.typing import NDArray

from companion.base.geometry import (
    BODY_FROM_DOWNWARD_CAMERA,
    add,
    matrix_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    subtract,
    vector3,
)
from companion.config import CameraConfig, ConfigError, VehicleConfig, VisionConfig, find_file, load_model
from companion.pad import load_pad
from companion.pad.colours import GROUP_COLOURS, bgr
from companion.sense.vision.aruco import PadDetector
from companion.sense.vision.lens import Lens
from companion.sense.vision.pose import PoseFit, estimate_pose
from companion.sense.vision.search import SearchPlanner
from docs.landing_gif import draw_landing_gif
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings

mpl.use("Agg")

PHASES: Final = {
    "take-off and way there": (("connect", "arm", "take_off", "waypoint", "route"), "#7f8c8d"),
    "search": (("search",), "#d68910"),
    "approach": (("approach",), "#2471a3"),
    "descend": (("descend",), "#7d3c98"),
    "touchdown": (("touchdown", "landed"), "#c0392b"),
}
PAD_COLOUR: Final = "#27ae60"
GROUP_COLOURS_BGR: Final = {group: bgr(colour) for group, colour in GROUP_COLOURS.items()}
HEIGHTS_M: Final = (7.0, 2.0, 0.5)
VIEW_WIDTH_PX: Final = 400
GREY_STEP: Final = 8  # fewer greys, a smaller file

Colour = NDArray[np.uint8]


# ---------------------------------------------------------------- the path


def read_topics(path: Path, topics: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    """The messages of some topics of a flight log, each as the JSON it was logged as."""
    messages: dict[str, list[dict[str, Any]]] = {topic: [] for topic in topics}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages([f"/{topic}" for topic in topics]):
            messages[channel.topic.removeprefix("/")].append(json.loads(message.data))
    return messages


def draw_landing(log: Path, picture: Path) -> None:
    """The vehicle's path by phase, the pad's path under it, and the pad where they met."""
    messages = read_topics(log, ("truth", "plan"))
    truth, plan = messages["truth"], messages["plan"]
    times = np.array([t["time_s"] for t in truth])
    vehicle = _drawn([t["vehicle_position_ned_m"] for t in truth])
    pad = _drawn([t["pad_position_ned_m"] for t in truth])
    figure = Figure(figsize=(9.0, 6.0), dpi=100)
    axes: Any = figure.add_axes((-0.06, -0.06, 1.12, 1.16), projection="3d")
    starts = np.searchsorted([p["time_s"] for p in plan], times, side="right") - 1
    phases = np.array([plan[max(0, k)]["phase"] for k in starts])
    axes.plot(*vehicle.T[:2], np.zeros(len(vehicle)), color="#d5d8dc", linewidth=1.0)
    axes.plot(*pad.T, color=PAD_COLOUR, linewidth=1.6, label="pad")
    for label, (names, colour) in PHASES.items():
        for number, (first, last) in enumerate(_runs(np.isin(phases, names))):
            named = label if number == 0 else None
            axes.plot(*vehicle[first : last + 2].T, color=colour, linewidth=2.2, label=named)
    _draw_board(axes, truth[-1])
    axes.set(xlabel="east (m)", ylabel="north (m)", zlabel="up (m)")
    axes.set_zlim(bottom=0.0)
    axes.set_box_aspect(_extent(np.vstack((vehicle, pad))))
    axes.view_init(elev=24.0, azim=-62.0)
    axes.legend(loc="upper left", bbox_to_anchor=(0.1, 0.86), frameon=False)
    figure.savefig(picture, bbox_inches="tight", pad_inches=0.15)  # labels in three dimensions lie outside


def _drawn(positions_ned_m: list[list[float]]) -> NDArray[np.float64]:
    """East, north, up (n, 3)."""
    ned = np.array(positions_ned_m)
    return np.column_stack((ned[:, 1], ned[:, 0], -ned[:, 2]))


def _runs(holds: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of each unbroken run."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], holds.astype(np.int8), [0]))))
    return [(int(a), int(b) - 1) for a, b in pairwise(edges)][::2]


def _extent(points: NDArray[np.float64]) -> tuple[float, float, float]:
    """Sides of the box that holds the points, so that a metre is as long in every direction."""
    east, north, _ = np.ptp(points, axis=0)
    return float(east), float(north), float(points[:, 2].max())


def _draw_board(axes: Any, truth: dict[str, Any]) -> None:
    pad = load_pad("moving_1300")
    c, s = math.cos(truth["pad_heading_rad"]), math.sin(truth["pad_heading_rad"])
    x, y = 0.5 * pad.length_m, 0.5 * pad.width_m
    corners = [
        [a * c - b * s + truth["pad_position_ned_m"][0], a * s + b * c + truth["pad_position_ned_m"][1]]
        for a, b in ((x, -y), (x, y), (-x, y), (-x, -y), (x, -y))
    ]
    north, east = np.array(corners).T
    axes.plot(east, north, -truth["pad_position_ned_m"][2], color="black", linewidth=1.5)


# ---------------------------------------------------------------- the camera


class PadRenderer:
    """The simulated camera, the eyes' detector and their pose, over the shipped pad."""

    def __init__(self) -> None:
        self._camera = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
        self._vehicle = load_model(VehicleConfig, find_file("vehicles", "x500"))
        pad, settings = load_pad("moving_1300"), VisionConfig()
        self._settings = settings
        self._model = CameraModel(
            self._camera, self._vehicle, pad, ImagingSettings(), np.random.default_rng(0)
        )
        self._lens = Lens(self._camera)
        self._planner = SearchPlanner(pad, self._lens, settings)
        self._detector = PadDetector(pad, settings, self._lens)
        self._attitude = quat_from_euler(math.radians(1.5), math.radians(-2.0), math.radians(12.0))

    def view(self, height_m: float) -> Colour:
        """What the camera sees from a height (m) over the pad, with the accepted markers outlined."""
        scene = self._scene(height_m)
        image = self._model.render(0.0, lambda _time_s: scene)
        pose = self._pose(image, scene)
        used = () if pose is None else pose.used
        picture, scale = _small(image)
        for detection in used:
            outline = np.round(scale * detection.corners_px * 16).astype(np.int32)
            colour = GROUP_COLOURS_BGR[detection.marker.group]
            cv2.polylines(picture, [outline], True, colour, 2, cv2.LINE_AA, shift=4)
        return _labelled(picture, f"{height_m:g} m: {len(used)} markers")

    def _scene(self, height_m: float) -> ScenePose:
        """The vehicle over the pad, tilting a little and a little aside."""
        mount = quat_rotate(self._attitude, self._vehicle.camera_position_body_m)
        aside = 0.02 * height_m
        position = (aside - mount[0], aside - mount[1], -0.3 - height_m - mount[2])
        return ScenePose(position, self._attitude, (0.0, 0.0, -0.3), math.radians(25.0))

    def _pose(self, image: NDArray[np.uint8], scene: ScenePose) -> PoseFit | None:
        """The pose by the first look that gives one; the pad is expected to within 5 cm, as in flight."""
        world_from_camera = quat_multiply(scene.vehicle_attitude, BODY_FROM_DOWNWARD_CAMERA)
        camera_from_world = matrix_from_quat(quat_conjugate(world_from_camera))
        pad_heading = matrix_from_quat(quat_from_euler(0.0, 0.0, scene.pad_heading_rad))
        mount = quat_rotate(scene.vehicle_attitude, self._vehicle.camera_position_body_m)
        away = subtract(scene.pad_position_ned_m, add(scene.vehicle_position_ned_m, mount))
        looks = self._planner.expected(
            camera_from_world @ pad_heading, camera_from_world @ np.array(away), 0.05
        )
        down_camera = vector3(camera_from_world[:, 2])
        for look in looks:
            pose = estimate_pose(self._detector.detect(image, look), self._lens, self._settings, down_camera)
            if pose is not None:
                return pose
        return None


def _small(image: NDArray[np.uint8]) -> tuple[Colour, float]:
    """The image at the picture's scale, in colour, and that scale."""
    scale = VIEW_WIDTH_PX / image.shape[1]
    size = (VIEW_WIDTH_PX, round(scale * image.shape[0]))
    grey = cv2.resize(image, size, interpolation=cv2.INTER_AREA) // GREY_STEP * GREY_STEP
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8), scale


def _labelled(picture: Colour, text: str) -> Colour:
    height_px = picture.shape[0]
    cv2.rectangle(picture, (0, height_px - 26), (12 + 9 * len(text), height_px), (0, 0, 0), cv2.FILLED)
    place, font = (8, height_px - 8), cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(picture, text, place, font, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return picture


def draw_view(picture: Path) -> None:
    """Compose the views from all heights into one picture."""
    viewer = PadRenderer()
    views = [viewer.view(height_m) for height_m in HEIGHTS_M]
    gap = np.full((views[0].shape[0], 8, 3), 255, np.uint8)
    row = np.hstack([part for view in views for part in (view, gap)][:-1])
    cv2.imwrite(str(picture), row, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m docs.pictures", description=__doc__.split("\n")[0])
    parser.add_argument("flight", type=Path, help="a folder that `companion --record` has left")
    parser.add_argument("--to", type=Path, default=Path(), help="the folder to write the pictures to")
    chosen = parser.parse_args(arguments)
    log: Path = chosen.flight / "flight.mcap"
    if not log.is_file():
        parser.error(f"{log}: no such file; expected a folder that `companion --record` has left")
    chosen.to.mkdir(parents=True, exist_ok=True)
    try:
        draw_landing_gif(log, chosen.to / "landing.gif")
    except ConfigError as error:
        parser.error(str(error))
    draw_landing(log, chosen.to / "landing.png")
    draw_view(chosen.to / "view.png")


if __name__ == "__main__":
    main()
