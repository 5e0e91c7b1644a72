"""Frames rendered by the simulator, read by the eyes: the pose against the truth."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import (
    Quaternion,
    Vector3,
    euler_from_quat,
    norm,
    quat_conjugate,
    quat_from_euler,
    quat_rotate,
    subtract,
)
from companion.base.messages import Frame, PadPrior, PadSighting
from companion.config import CameraConfig, VehicleConfig, VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import Detection, PadDetector, SearchPass
from companion.sense.vision.pipeline import Vision
from companion.sense.vision.search import ENOUGH_MARKERS
from tests.attitudes import between_rad

TakePicture = Callable[..., tuple[Frame, Vector3, Quaternion]]
LEVEL = quat_from_euler(0.0, 0.0, 0.0)
NORTH_90 = [0.0, 90.0, 180.0, 270.0]


@pytest.fixture(scope="module")
def vision(pad: Pad, camera: CameraConfig, vehicle: VehicleConfig) -> Vision:
    return Vision(pad, camera, vehicle, VisionConfig())


def prior_of(attitude: Quaternion, position: Vector3, body_from_pad: Quaternion, std: float) -> PadPrior:
    return PadPrior(0.0, quat_rotate(quat_conjugate(attitude), (0.0, 0.0, 1.0)), position, body_from_pad, std)


def gravity_only(attitude: Quaternion) -> PadPrior:
    return PadPrior(0.0, quat_rotate(quat_conjugate(attitude), (0.0, 0.0, 1.0)))


def seen(vision: Vision, frame: Frame, prior: PadPrior | None) -> PadSighting:
    # without an expectation far and near pads have their turns: two looks find either
    sighting = vision.step(frame, prior).sighting or vision.step(frame, prior).sighting
    assert sighting is not None
    return sighting


# camera height over the pad, and how far the position and the turn may be off
HEIGHTS = [(7.0, 0.05, 2.0), (3.0, 0.015, 1.5), (1.0, 0.005, 1.0), (0.4, 0.005, 1.0), (0.12, 0.003, 2.5)]


@pytest.mark.parametrize("yaw_deg", NORTH_90)
@pytest.mark.parametrize("case", HEIGHTS)
def test_the_pose_is_true_at_every_height_and_yaw_and_at_tilt(
    vision: Vision, take_picture: TakePicture, yaw_deg: float, case: tuple[float, float, float]
) -> None:
    height_m, position_bound_m, turn_bound_deg = case
    tilt = 0.12 if height_m > 0.5 else 0.05
    attitude = quat_from_euler(tilt, -0.6 * tilt, math.radians(yaw_deg))
    # place the vehicle so that the camera, tilting, still has the pad in view
    away = quat_rotate(attitude, (0.03, 0.0, 0.08 + height_m))
    position = (-away[0], -away[1], -height_m - 0.08)
    frame, truth, body_from_pad = take_picture(position, attitude, 0.4)
    sighting = seen(vision, frame, prior_of(attitude, truth, body_from_pad, 0.01 + 0.01 * height_m))
    assert norm(subtract(sighting.pad_position_body_m, truth)) < position_bound_m
    assert math.degrees(between_rad(body_from_pad, sighting.body_from_pad)) < turn_bound_deg
    assert sighting.sequence == frame.sequence
    assert len(sighting.marker_ids) == sum(sighting.marker_count.values())


@pytest.mark.parametrize("yaw_deg", NORTH_90)
def test_a_pad_ahead_is_at_positive_x_and_one_to_the_right_at_positive_y(
    vision: Vision, take_picture: TakePicture, yaw_deg: float
) -> None:
    yaw = math.radians(yaw_deg)
    attitude = quat_from_euler(0.0, 0.0, yaw)
    for ahead, right in ((0.5, 0.0), (0.0, 0.5)):
        north = ahead * math.cos(yaw) - right * math.sin(yaw)
        east = ahead * math.sin(yaw) + right * math.cos(yaw)
        frame, _, _ = take_picture((-north, -east, -4.0), attitude, 1.0)
        x, y, z = seen(vision, frame, gravity_only(attitude)).pad_position_body_m
        assert (x, y, z) == pytest.approx((ahead, right, 4.0), abs=0.02)


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0, -90.0, 37.0])
def test_a_pad_turned_clockwise_seen_from_above_has_positive_yaw(
    vision: Vision, take_picture: TakePicture, heading_deg: float
) -> None:
    frame, _, _ = take_picture((0.0, 0.0, -3.0), LEVEL, math.radians(heading_deg))
    yaw = euler_from_quat(seen(vision, frame, gravity_only(LEVEL)).body_from_pad)[2]
    assert math.remainder(yaw - math.radians(heading_deg), math.tau) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("turned", [(90.0, 0.0), (180.0, 0.0), (0.0, 20.0), (90.0, 15.0)])
def test_the_mount_of_the_camera_is_taken_out(
    pad: Pad,
    camera: CameraConfig,
    vehicle: VehicleConfig,
    take_picture: TakePicture,
    turned: tuple[float, float],
) -> None:
    camera_yaw_deg, camera_tilt_deg = turned
    mounted = vehicle.model_copy(
        update={"camera_yaw_deg": camera_yaw_deg, "camera_tilt_deg": camera_tilt_deg}
    )
    # tilted forward (and turned right by the yaw) the camera looks at what is 3 tan(tilt) m away
    reach = 3.0 * math.tan(math.radians(camera_tilt_deg))
    yaw = math.radians(camera_yaw_deg)
    position = (-reach * math.cos(yaw), -reach * math.sin(yaw), -3.0)
    frame, truth, _ = take_picture(position, LEVEL, 0.3, mounted=mounted)
    sighting = seen(Vision(pad, camera, mounted, VisionConfig()), frame, gravity_only(LEVEL))
    assert norm(subtract(sighting.pad_position_body_m, truth)) < 0.015


def test_a_sighting_is_stamped_with_the_time_of_the_rows_that_show_the_pad(
    vision: Vision, take_picture: TakePicture, camera: CameraConfig
) -> None:
    # flying fast sideways over a pad that is low in the image: its rows are read after the middle one
    velocity = (0.0, 3.0, 0.0)
    frame, _, _ = take_picture((1.2, 0.0, -4.0), LEVEL, velocity_m_s=velocity)
    sighting = seen(vision, frame, gravity_only(LEVEL))
    assert 0.2 * camera.readout_s < sighting.time_s < 0.5 * camera.readout_s
    _, truth, _ = take_picture((1.2, 0.0, -4.0), LEVEL, velocity_m_s=velocity, at_s=sighting.time_s)
    assert sighting.pad_position_body_m[1] == pytest.approx(truth[1], abs=0.003)
    assert abs(truth[1]) > 0.008  # what forgetting the row would have cost


def test_motion_within_the_frame_does_not_bend_the_pose(vision: Vision, take_picture: TakePicture) -> None:
    position, velocity = (-0.03, 0.0, -0.38), (0.5, 0.5, 0.2)
    frame, truth, body_from_pad = take_picture(position, LEVEL, 0.2, velocity_m_s=velocity)
    sighting = seen(vision, frame, prior_of(LEVEL, truth, body_from_pad, 0.02))
    _, truth, _ = take_picture(position, LEVEL, 0.2, velocity_m_s=velocity, at_s=sighting.time_s)
    assert norm(subtract(sighting.pad_position_body_m, truth)) < 0.003


def test_the_covariance_covers_the_error_and_is_a_covariance(
    vision: Vision, take_picture: TakePicture
) -> None:
    frame, truth, _ = take_picture((0.3, -0.2, -6.0), LEVEL, 0.7)
    sighting = seen(vision, frame, gravity_only(LEVEL))
    assert sighting.covariance.shape == (6, 6)
    assert np.allclose(sighting.covariance, sighting.covariance.T)
    assert np.linalg.eigvalsh(sighting.covariance).min() > 0.0
    error = np.array(subtract(sighting.pad_position_body_m, truth))
    assert error @ np.linalg.solve(sighting.covariance[:3, :3], error) < 16.0


def test_an_expected_pad_is_found_without_searching_the_whole_frame(
    vision: Vision, take_picture: TakePicture
) -> None:
    frame, truth, body_from_pad = take_picture((0.4, 0.3, -5.0), LEVEL)
    result = vision.step(frame, prior_of(LEVEL, truth, body_from_pad, 0.1))
    assert result.sighting is not None
    assert not result.searched_whole_frame
    assert result.marker_count["F"] >= ENOUGH_MARKERS  # at this size noise may take one of the four
    assert result.sighting.group == "F"


def test_a_pad_that_is_not_where_it_was_expected_is_found_all_the_same(
    vision: Vision, take_picture: TakePicture
) -> None:
    frame, truth, body_from_pad = take_picture((1.0, 1.0, -5.0), LEVEL)
    result = vision.step(frame, prior_of(LEVEL, (1.0, 1.0, 5.0), body_from_pad, 0.05))
    assert result.searched_whole_frame
    assert result.sighting is not None
    assert norm(subtract(result.sighting.pad_position_body_m, truth)) < 0.05


def test_a_pad_that_is_near_but_not_known_well_enough_is_seen_in_every_frame(
    vision: Vision, take_picture: TakePicture
) -> None:
    frame, truth, body_from_pad = take_picture((0.0, 0.0, -0.2), LEVEL, 0.3)
    vague = prior_of(LEVEL, truth, body_from_pad, 0.05)
    results = [vision.step(frame, vague) for _ in range(2)]
    assert all(result.sighting is not None and result.searched_whole_frame for result in results)


def test_without_any_prior_the_pose_comes_from_the_corners_alone(
    vision: Vision, take_picture: TakePicture
) -> None:
    attitude = quat_from_euler(0.1, 0.1, 0.3)
    frame, truth, _ = take_picture((0.2, 0.1, -2.0), attitude)
    assert norm(subtract(seen(vision, frame, None).pad_position_body_m, truth)) < 0.02


@pytest.mark.parametrize(("height_m", "shrinkings"), [(1.8, [4]), (3.2, [4, 2])])
def test_codes_that_a_shrunk_picture_shows_by_luck_are_looked_at_more_closely(
    pad: Pad,
    camera: CameraConfig,
    vehicle: VehicleConfig,
    take_picture: TakePicture,
    monkeypatch: pytest.MonkeyPatch,
    *,
    height_m: float,
    shrinkings: list[int],
) -> None:
    """Shrunk four times, one code of cells of 4.4 px is no luck; of cells of 2.5 px it is, if it is alone."""
    looks: list[int] = []
    read = PadDetector.read

    def unlucky(self: PadDetector, image: NDArray[np.uint8], where: SearchPass) -> list[Detection]:
        looks.append(where.shrink)
        found = read(self, image, where)
        return found[:1] if where.shrink == 4 else found

    monkeypatch.setattr(PadDetector, "read", unlucky)
    frame, _, _ = take_picture((0.0, 0.0, -height_m), LEVEL)
    result = Vision(pad, camera, vehicle, VisionConfig()).step(frame, gravity_only(LEVEL))
    assert looks == shrinkings
    assert result.sighting is not None
    assert sum(d.refined for d in result.read) == (1 if looks == [4] else 4)


def test_where_there_is_no_pad_nothing_is_seen(vision: Vision, take_picture: TakePicture) -> None:
    for place in range(6):
        frame, _, _ = take_picture((30.0 + 3.0 * place, 12.0, -2.0 - place), LEVEL)
        result = vision.step(frame, gravity_only(LEVEL))
        assert result.sighting is None
        assert result.searched_whole_frame
        assert sum(result.marker_count.values()) == 0


def test_a_frame_of_the_wrong_size_is_refused(vision: Vision) -> None:
    frame = Frame(0.0, 0.0, 0, np.zeros((240, 320), np.uint8))
    with pytest.raises(ValueError, match="320x240"):
        vision.step(frame, None)
