"""The joint pose, from corners made with OpenCV's own projection."""

import math
from dataclasses import replace
from typing import Literal

import cv2
import numpy as np
import pytest

from companion.base.geometry import ZERO3, FloatArray, Vector3, matrix_from_quat, quat_from_euler, vector3
from companion.config import CameraConfig, VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import Detection
from companion.sense.vision.lens import Lens
from companion.sense.vision.pose import estimate_pose

CONFIG = VisionConfig()
# corners that are taken for this uncertain, px
STATED_NOISE = np.random.default_rng(3).normal(0.0, 0.3, (8, 4, 2))


def camera_from_pad_at(yaw: float, roll: float = 0.0, pitch: float = 0.0) -> FloatArray:
    return matrix_from_quat(quat_from_euler(roll, pitch, yaw))


def detections(
    pad: Pad,
    camera: CameraConfig,
    rotation: FloatArray,
    position: Vector3,
    *,
    group: str = "F",
    noise: FloatArray | None = None,
) -> list[Detection]:
    """Corners of a group's markers as that pose shows them; noise is (markers, 4, 2) px, and is known of."""
    matrix = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
    turn, _ = cv2.Rodrigues(rotation)
    found = []
    for k, marker in enumerate(m for m in pad.markers if m.group == group):
        points = marker.corners_pad_m()
        pixels, _ = cv2.projectPoints(points, turn, np.array(position), matrix, np.array(camera.distortion))
        corners = np.asarray(pixels, dtype=np.float64).reshape(4, 2)
        if noise is not None:
            corners = corners + noise[k]
        std_px = 0.0 if noise is None else float(noise.std())
        side_px = float(np.linalg.norm(corners[1] - corners[0]))
        found.append(Detection(marker, points, corners, side_px, std_px))
    return found


def noise_of_sides(rng: np.random.Generator, corner_std_px: float, markers: int) -> FloatArray:
    """What corners (markers, 4, 2) miss by when each of an upright square's sides is off, and turned."""
    normals = np.array([(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)])
    off = rng.normal(0.0, corner_std_px / math.sqrt(2.0), (markers, 4, 2))
    middle, slope = off.mean(axis=2), math.sqrt(3.0) * 0.5 * (off[..., 1] - off[..., 0])
    ahead, behind = (middle - slope)[..., None] * normals, (middle + slope)[..., None] * normals
    return np.asarray(ahead + np.roll(behind, 1, axis=1))


@pytest.fixture
def lens(camera: CameraConfig) -> Lens:
    return Lens(camera)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0, 33.0])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.3, -0.2), (-0.1, 0.35)])
def test_perfect_corners_give_the_perfect_pose(
    pad: Pad, camera: CameraConfig, lens: Lens, yaw_deg: float, tilt: tuple[float, float]
) -> None:
    rotation = camera_from_pad_at(math.radians(yaw_deg), *tilt)
    position = (0.2, -0.1, 3.0)
    pose = estimate_pose(detections(pad, camera, rotation, position), lens, CONFIG, vector3(rotation[:, 2]))
    assert pose is not None
    assert pose.position_camera_m == pytest.approx(position, abs=1e-4)
    assert np.abs(pose.camera_from_pad - rotation).max() < 1e-4
    assert pose.reprojection_error_px < 0.01


def test_gravity_holds_the_pose_of_a_single_marker_seen_square_on(
    pad: Pad, camera: CameraConfig, lens: Lens
) -> None:
    # one 36 cm marker at 7 m: 27 px; two solutions fit it alike and the corners alone choose at random
    rng = np.random.default_rng(3)
    rotation, position = camera_from_pad_at(0.5), (0.3, -0.2, 7.0)
    tilts_with: list[float] = []
    tilts_without: list[float] = []
    for _ in range(30):
        one = detections(pad, camera, rotation, position, noise=rng.normal(0.0, 0.3, (4, 4, 2)))[:1]
        for down, tilts in (((0.0, 0.0, 1.0), tilts_with), (None, tilts_without)):
            pose = estimate_pose(one, lens, CONFIG, down)
            assert pose is not None
            tilts.append(math.degrees(math.acos(min(1.0, pose.camera_from_pad[2, 2]))))
    assert max(tilts_with) < 4.0
    assert np.median(tilts_without) > 8.0  # the ambiguity is real: the test could fail


def test_at_seven_metres_the_horizontal_position_is_good_to_a_centimetre(
    pad: Pad, camera: CameraConfig, lens: Lens
) -> None:
    rng = np.random.default_rng(5)
    rotation, position = camera_from_pad_at(1.0), (0.5, 0.4, 7.0)
    errors = []
    for _ in range(40):
        found = detections(pad, camera, rotation, position, noise=rng.normal(0.0, 0.2, (4, 4, 2)))
        pose = estimate_pose(found, lens, CONFIG, (0.0, 0.0, 1.0))
        assert pose is not None
        errors.append(pose.position_camera_m - position)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert rms[:2].max() < 0.01
    assert rms[2] < 0.05


def test_the_covariance_says_how_large_the_errors_are(pad: Pad, camera: CameraConfig, lens: Lens) -> None:
    rng = np.random.default_rng(8)
    config = VisionConfig(scale_error=0.0)
    rotation, position = camera_from_pad_at(-0.5 * math.pi), (0.1, 0.2, 4.0)  # its top edge up the image
    normalised = []
    for _ in range(60):
        tilt = rng.normal(0.0, math.radians(config.level_std_deg), 2)
        down = matrix_from_quat(quat_from_euler(tilt[0], tilt[1], 0.0))[:, 2]
        found = detections(pad, camera, rotation, position, noise=noise_of_sides(rng, 0.2, 4))
        pose = estimate_pose(found, lens, config, vector3(down))
        assert pose is not None
        error = pose.position_camera_m - position
        normalised.append(error @ np.linalg.solve(pose.covariance[:3, :3], error) / 3.0)
    assert 0.5 < np.mean(normalised) < 1.6


def test_a_marker_that_disagrees_is_dropped(pad: Pad, camera: CameraConfig, lens: Lens) -> None:
    rotation, position = camera_from_pad_at(0.0), (0.0, 0.0, 3.0)
    found = detections(pad, camera, rotation, position)
    shifted = Detection(found[2].marker, found[2].corners_pad_m, found[2].corners_px + 25.0, found[2].side_px)
    pose = estimate_pose([*found[:2], shifted, found[3]], lens, CONFIG, (0.0, 0.0, 1.0))
    assert pose is not None
    assert [d.marker.id for d in pose.used] == [0, 1, 3]
    assert pose.position_camera_m == pytest.approx(position, abs=1e-3)


def test_two_markers_that_contradict_each_other_are_both_disbelieved(
    pad: Pad, camera: CameraConfig, lens: Lens
) -> None:
    found = detections(pad, camera, camera_from_pad_at(0.0), (0.0, 0.0, 3.0))[:2]
    shifted = Detection(found[1].marker, found[1].corners_pad_m, found[1].corners_px + 40.0, found[1].side_px)
    assert estimate_pose([found[0], shifted], lens, CONFIG, (0.0, 0.0, 1.0)) is None


@pytest.mark.parametrize(("pad_on", "most_deg"), [("fixed", 7.0), ("vehicle", 11.0), ("ship", 18.0)])
def test_how_far_a_pad_may_tilt_is_what_it_lies_on(
    pad: Pad, camera: CameraConfig, lens: Lens, pad_on: Literal["fixed", "vehicle", "ship"], most_deg: float
) -> None:
    config, position = VisionConfig(pad_on=pad_on), (0.1, 0.2, 1.5)
    for tilt_deg, seen in ((most_deg, True), (1.5 * most_deg, False)):
        rotation = camera_from_pad_at(0.3, math.radians(tilt_deg))
        pose = estimate_pose(detections(pad, camera, rotation, position), lens, config, (0.0, 0.0, 1.0))
        assert (pose is not None) == seen
        if pose is not None:
            assert pose.position_camera_m == pytest.approx(position, abs=2e-3)


def test_what_tilts_far_from_the_level_is_not_our_pad(pad: Pad, camera: CameraConfig, lens: Lens) -> None:
    found = detections(pad, camera, camera_from_pad_at(0.0), (0.0, 0.0, 1.5))
    down = matrix_from_quat(quat_from_euler(0.5, 0.0, 0.0))[:, 2]
    assert estimate_pose(found, lens, CONFIG, vector3(down)) is None


def test_no_markers_is_no_pose(lens: Lens) -> None:
    assert estimate_pose([], lens, CONFIG, (0.0, 0.0, 1.0)) is None


def rolled(
    found: list[Detection],
    camera: CameraConfig,
    rotation: FloatArray,
    position: FloatArray,
    velocity: Vector3 = ZERO3,
    rate: Vector3 = ZERO3,
) -> list[Detection]:
    """The same corners as a rolling shutter shows them: of a pad that moves, by a camera that turns."""
    rows = np.concatenate([d.corners_px[:, 1] for d in found])
    matrix = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
    sheared = []
    for d in found:
        corners = np.empty((4, 2))
        for k, row in enumerate(d.corners_px[:, 1]):
            delay_s = camera.readout_s * (row - rows.mean()) / camera.height_px
            seen = rotation @ d.corners_pad_m[k] + position + np.array(velocity) * delay_s
            back = -np.array(rate) * delay_s
            pixel, _ = cv2.projectPoints(seen[None], back, np.zeros(3), matrix, np.array(camera.distortion))
            corners[k] = np.asarray(pixel).reshape(2)
        sheared.append(replace(d, corners_px=corners))
    return sheared


def test_a_rolling_shutters_shear_is_reported_apart_from_the_pose(
    pad: Pad, camera: CameraConfig, lens: Lens
) -> None:
    rotation, position = camera_from_pad_at(0.3), np.array([0.01, 0.02, 0.25])
    found = detections(pad, camera, rotation, vector3(position), group="C")
    found = [d for d in found if d.corners_px.min() > 5 and (d.corners_px < (635, 475)).all()]
    sheared = rolled(found, camera, rotation, position, velocity=(1.0, -0.5, 0.0))
    moved = max(float(np.abs(a.corners_px - b.corners_px).max()) for a, b in zip(found, sheared, strict=True))
    assert moved > 8.0
    pose = estimate_pose(sheared, lens, CONFIG, (0.0, 0.0, 1.0))
    assert pose is not None
    assert len(pose.used) == len(found)
    assert pose.position_camera_m == pytest.approx(position, abs=0.002)
    still = Lens(camera.model_copy(update={"readout_s": 0.0}))
    bent = estimate_pose(sheared, still, CONFIG, (0.0, 0.0, 1.0))
    assert bent is None or bent.reprojection_error_px > 3.0 * pose.reprojection_error_px


@pytest.mark.parametrize("rate", [(0.6, 0.1, 0.2), (0.8, 0.4, -0.3), (-0.8, -0.3, 0.2)])
def test_how_the_camera_turns_is_reported_apart_from_how_far_the_pad_is(
    pad: Pad, camera: CameraConfig, lens: Lens, rate: Vector3
) -> None:
    # GIVEN two markers of a pad 8 m off, near the edge of the view, that pass at up to 6 m/s
    rotation, position = camera_from_pad_at(0.3), np.array([1.0, -3.0, 7.0])
    still = detections(pad, camera, rotation, vector3(position), noise=STATED_NOISE)
    found = rolled(still[:2], camera, rotation, position, rate=rate)
    down = vector3(rotation[:, 2])
    # WHEN the gyroscope's word is taken
    told = estimate_pose(found, lens, CONFIG, down, rate_camera_rad_s=rate)
    untold = estimate_pose(found, lens, CONFIG, down)
    # THEN the distance is right, which otherwise is off by centimetres
    assert told is not None
    assert untold is not None
    errors = [float(np.linalg.norm(pose.position_camera_m - position)) for pose in (told, untold)]
    assert errors[0] < 0.002
    assert errors[1] > 0.01


def test_a_climb_is_bounded_by_how_near_the_pad_is(pad: Pad, camera: CameraConfig, lens: Lens) -> None:
    # seen from 1 m, half of the pad is out of view: a tilt that is a climb moves its middle
    rotation, position = camera_from_pad_at(0.3), (0.02, -0.12, 1.0)
    found = [
        d
        for d in detections(pad, camera, rotation, position, group="M")
        if d.corners_px.min() > 5 and (d.corners_px < (635, 475)).all()
    ]
    assert found
    config = VisionConfig(scale_error=0.0, level_std_deg=0.7)
    near = estimate_pose(found, lens, config, (0.0, 0.0, 1.0))
    vague = config.model_copy(update={"relative_climb_std_m_s": 20.0})
    any_climb = estimate_pose(found, lens, vague, (0.0, 0.0, 1.0))
    assert near is not None
    assert any_climb is not None
    assert near.covariance[2, 2] < 0.6 * any_climb.covariance[2, 2]
    assert near.position_camera_m == pytest.approx(position, abs=1e-3)
    # one that is expected is no reason to be sure that there is none
    climbing = estimate_pose(found, lens, config, (0.0, 0.0, 1.0), climb_m_s=-1.0)
    assert climbing is not None
    assert climbing.covariance[2, 2] > 1.5 * near.covariance[2, 2]
