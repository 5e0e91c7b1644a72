"""A fisheye lens: its projection, drawn by the simulator, and a pose whose stated error is the image's."""

import math

import cv2
import numpy as np
import pytest

from companion.base.geometry import IDENTITY
from companion.base.messages import Frame
from companion.config import (
    CameraConfig,
    ConfigError,
    VehicleConfig,
    VisionConfig,
    find_file,
    load_model,
    validate,
)
from companion.pad import Pad
from companion.sense.vision.aruco import Detection
from companion.sense.vision.lens import Lens
from companion.sense.vision.pipeline import Vision
from companion.sense.vision.pose import estimate_pose
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from sitl.camera.mesh import node_rays

FISHEYE = load_model(CameraConfig, find_file("cameras", "fisheye_800x600"))
MATRIX = np.array([[FISHEYE.fx_px, 0.0, FISHEYE.cx_px], [0.0, FISHEYE.fy_px, FISHEYE.cy_px], [0.0, 0.0, 1.0]])


def test_projection_is_opencvs_and_undistortion_is_its_inverse() -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack((rng.uniform(-6.0, 6.0, (200, 2)), np.full(200, 3.0)))
    pixels, _ = Lens(FISHEYE).project(points)
    expected, _ = cv2.fisheye.projectPoints(
        points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), MATRIX, np.array(FISHEYE.distortion)
    )
    assert pixels == pytest.approx(np.asarray(expected).reshape(-1, 2), abs=1e-6)
    assert Lens(FISHEYE).undistort(pixels) == pytest.approx(points[:, :2] / 3.0, abs=1e-8)


def test_the_simulators_rays_are_the_lens_inverted() -> None:
    rays = node_rays(FISHEYE)[1:-1, 1:-1]
    middle = 8.0 * np.arange(100) + 3.5
    pixels, _ = Lens(FISHEYE).project(rays.reshape(-1, 3))
    u, v = np.meshgrid(middle, middle[:75])
    assert pixels == pytest.approx(np.column_stack((u.ravel(), v.ravel())), abs=1e-6)


def test_slopes_are_what_pixels_do() -> None:
    lens, rays = Lens(FISHEYE), np.array([(0.0, 0.0), (1.2, -0.4), (-2.0, 1.5)])
    moved = np.array((2e-4, -1e-4))
    there, _ = lens.project(np.column_stack((rays + moved, np.ones(3))))
    before, _ = lens.project(np.column_stack((rays, np.ones(3))))
    assert lens.slopes(rays) @ moved == pytest.approx(there - before, abs=2e-5)


def nees(pad: Pad, off_m: float) -> float:
    """Of the place of a pad 3 m below and so far aside, by corners that err alike in the image."""
    lens, config = Lens(FISHEYE), VisionConfig(scale_error=0.0, corner_noise_px=0.2)
    position, rng = np.array((off_m, 0.3, 3.0)), np.random.default_rng(8)
    squares = []
    for _ in range(80):
        found = []
        for marker in (m for m in pad.markers if m.group == "F"):
            corners = marker.corners_pad_m()
            pixels, _ = lens.project(corners + position)
            noisy = pixels + rng.normal(0.0, 0.2, pixels.shape)
            found.append(Detection(marker, corners, noisy, 30.0, refined=True))
        pose = estimate_pose(found, lens, config, (0.0, 0.0, 1.0))
        assert pose is not None
        off = pose.position_camera_m - position
        squares.append(float(off @ np.linalg.solve(pose.covariance[:3, :3], off)) / 3.0)
    return float(np.mean(squares))


def test_a_poses_stated_error_holds_at_the_images_edge_as_in_its_middle(pad: Pad) -> None:
    # by rays that err alike everywhere it would be 20 to 40 times as large at 6 m
    assert [nees(pad, 3.0), nees(pad, 6.0)] == pytest.approx([nees(pad, 0.0)] * 2, rel=0.6)


@pytest.mark.parametrize("angle_deg", [0.0, 35.0, 50.0])
def test_the_simulated_pad_is_seen_where_it_is(pad: Pad, vehicle: VehicleConfig, angle_deg: float) -> None:
    """Drawn by the simulator's own table of the lens, within the stated error."""
    height_m = 2.0
    off_m = height_m * math.tan(math.radians(angle_deg))
    model = CameraModel(FISHEYE, vehicle, pad, ImagingSettings(), np.random.default_rng(0))
    image = model.render(
        0.0, lambda _: ScenePose((0.2, off_m, -height_m - 0.3), IDENTITY, (0.0, 0.0, -0.3), 0.4)
    )
    vision = Vision(pad, FISHEYE, vehicle, VisionConfig())
    looks = (vision.step(Frame(0.0, 0.03, number, image), None).sighting for number in range(2))
    sighting = next(seen for seen in looks if seen is not None)
    off = np.array(sighting.pad_position_body_m) - (-0.2, -off_m, height_m)
    assert math.sqrt(off @ np.linalg.solve(sighting.covariance[:3, :3], off)) < 3.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"distortion": (0.0,) * 5}, "distortion: expected 4 numbers .* of a fisheye, found 5"),
        ({"projection": "perspective"}, "distortion: expected 5 numbers .* found 4"),
    ],
)
def test_numbers_of_another_model_are_refused(change: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        validate(CameraConfig, {**FISHEYE.model_dump(), **change}, "camera.yaml")
