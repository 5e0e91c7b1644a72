"""The paper's way to the pose: each marker by itself, its group by distance, eq. 1, mean."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from companion.base.geometry import (
    FloatArray,
    Quaternion,
    Vector3,
    matrix_from_quat,
    norm,
    quat_from_euler,
    subtract,
)
from companion.base.messages import Frame, PadPrior
from companion.config import CameraConfig, VehicleConfig, VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import Detection
from companion.sense.vision.lens import Lens
from companion.sense.vision.paper_pose import (
    extracted,
    marker_pose,
    mean_rotation,
    of_the_group_for_the_distance,
    paper_pose,
)
from companion.sense.vision.pipeline import Vision

TakePicture = Callable[..., tuple[Frame, Vector3, Quaternion]]
CONFIG = VisionConfig()
ROTATION = matrix_from_quat(quat_from_euler(0.15, -0.1, 0.7))
POSITION = (0.1, -0.05, 2.0)


def seen(
    pad: Pad, lens: Lens, rotation: FloatArray = ROTATION, position: Vector3 = POSITION
) -> list[Detection]:
    """Perfect corners of the markers that are whole in the image."""
    found = []
    for marker in pad.markers:
        points = marker.corners_pad_m()
        pixels, _ = lens.project(points @ rotation.T + position)
        side_px = float(np.linalg.norm(pixels[1] - pixels[0]))
        if np.isfinite(pixels).all() and pixels.min() > 0.0 and (pixels < lens.size_px).all():
            found.append(Detection(marker, points, pixels, side_px))
    return found


@pytest.fixture
def lens(camera: CameraConfig) -> Lens:
    return Lens(camera)


def test_each_marker_by_itself_gives_the_pads_pose(pad: Pad, lens: Lens) -> None:
    for detection in seen(pad, lens):
        solved = marker_pose(detection, lens)
        assert solved is not None
        assert solved[1] == pytest.approx(POSITION, abs=2e-3)
        assert np.abs(solved[0] - ROTATION).max() < 5e-3


def test_perfect_corners_give_the_perfect_mean(pad: Pad, lens: Lens) -> None:
    pose = paper_pose(seen(pad, lens), lens, CONFIG)
    assert pose is not None
    assert pose.position_camera_m == pytest.approx(POSITION, abs=1e-3)
    assert np.abs(pose.camera_from_pad - ROTATION).max() < 1e-3
    assert pose.reprojection_error_px < 0.05
    assert np.linalg.eigvalsh(pose.covariance).min() > 0.0


@pytest.mark.parametrize(("height_m", "group"), [(8.0, "F"), (3.0, "F"), (1.2, "M"), (0.4, "C")])
def test_the_group_goes_by_the_distance(pad: Pad, lens: Lens, height_m: float, group: str) -> None:
    chosen = of_the_group_for_the_distance(seen(pad, lens, np.eye(3), (0.0, 0.0, height_m)))
    assert {d.marker.group for d in chosen} == {group}


def test_of_few_estimates_eq_1_drops_the_worst_however_good_it_is() -> None:
    # millimetres apart, or micrometres: the same one goes
    near = np.array([(0.0, 0.0, 1.0), (0.0, 0.0, 1.001), (0.0, 0.0, 1.002), (0.0, 0.0, 1.006)])
    for scale in (1.0, 1e-3):
        dropped = extracted(near * scale)
        assert dropped[3]
        assert not dropped[2]


def test_eq_1_drops_an_outlier_and_never_everything() -> None:
    many = np.array([(0.0, 0.0, 1.0 + 0.001 * k) for k in range(8)] + [(0.0, 0.3, 1.4)])
    assert extracted(many).tolist() == [False] * 8 + [True]
    assert not extracted(many[:1]).any()
    assert not extracted(np.array([(0.0, 0.0, 1.0), (0.0, 0.0, 1.1)])).any()
    assert not extracted(np.ones((3, 3))).any()


def test_the_mean_rotation_is_a_rotation_between_the_others() -> None:
    turns = np.array([matrix_from_quat(quat_from_euler(0.0, 0.0, yaw)) for yaw in (0.2, 0.3, 0.7)])
    mean = mean_rotation(turns)
    assert mean @ mean.T == pytest.approx(np.eye(3))
    assert math.atan2(mean[1, 0], mean[0, 0]) == pytest.approx(0.4, abs=0.01)


def test_nothing_seen_is_no_pose(lens: Lens) -> None:
    assert paper_pose([], lens, CONFIG) is None


def test_the_setting_chooses_it_and_the_joint_fit_is_the_better_one(
    pad: Pad, camera: CameraConfig, vehicle: VehicleConfig, take_picture: TakePicture
) -> None:
    level = quat_from_euler(0.0, 0.0, 0.2)
    errors: dict[str, list[float]] = {"joint": [], "paper": []}
    for k in range(4):
        frame, truth, body_from_pad = take_picture((0.1 * k, -0.1, -3.0), level)
        prior = PadPrior(0.0, (0.0, 0.0, 1.0), truth, body_from_pad, 0.05)
        for way, found in errors.items():
            vision = Vision(pad, camera, vehicle, VisionConfig.model_validate({"pose": way}))
            sighting = vision.step(frame, prior).sighting
            assert sighting is not None
            found.append(norm(subtract(sighting.pad_position_body_m, truth)))
    assert max(errors["paper"]) < 0.3
    assert 3.0 * np.mean(errors["joint"]) < np.mean(errors["paper"])
