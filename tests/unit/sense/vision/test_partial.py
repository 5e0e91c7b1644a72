"""A tag of which only a part is to be seen: grown out of the image, or with something lying on it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import FloatArray, matrix_from_quat, quat_conjugate, quat_from_euler, vector3
from companion.base.messages import Frame, PadPrior, PadSighting
from companion.config import CameraConfig, VehicleConfig, VisionConfig, find_file, load_model
from companion.pad import Pad
from companion.sense.vision.pipeline import Vision
from companion.tools.pads.run import single_pad
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings

SURFACE_DOWN_M = -0.05
EXPECTED_STD_M = 0.005


@pytest.fixture(scope="module")
def tag() -> Pad:
    return single_pad({})  # of 40 cm


@pytest.fixture(scope="module")
def wide() -> CameraConfig:
    return load_model(CameraConfig, find_file("cameras", "hd_1280x720"))


class Over:
    """The vehicle over a tag: what it sees, what it expects, and the truth in body axes."""

    def __init__(
        self, tag: Pad, camera: CameraConfig, vehicle: VehicleConfig, lens_m: float, yaw_rad: float = 0.4
    ) -> None:
        self.vision = Vision(tag, camera, vehicle, VisionConfig())
        model = CameraModel(camera, vehicle, tag, ImagingSettings(), np.random.default_rng(2))
        self.attitude = quat_from_euler(0.02, -0.03, yaw_rad)
        turn = matrix_from_quat(self.attitude)
        place = np.array((0.02, -0.01, SURFACE_DOWN_M - lens_m)) - turn @ np.array(model.position_body_m)
        scene = ScenePose(vector3(place), self.attitude, (0.0, 0.0, SURFACE_DOWN_M), 0.0)
        self.image = model.render(0.0, lambda _: scene)
        self.pad_body_m: FloatArray = turn.T @ (np.array((0.0, 0.0, SURFACE_DOWN_M)) - place)
        self.down = vector3(turn.T[:, 2])

    def prior(self, off_m: float = 0.004, std_m: float = EXPECTED_STD_M) -> PadPrior:
        """Expected a few millimetres beside the truth."""
        expected = vector3(self.pad_body_m + off_m * np.array((1.0, -1.0, 0.5)))
        return PadPrior(0.0, self.down, expected, quat_conjugate(self.attitude), std_m)

    def seen(self, prior: PadPrior | None, image: NDArray[np.uint8] | None = None) -> PadSighting | None:
        return self.vision.step(Frame(0.0, 0.0, 0, self.image if image is None else image), prior).sighting

    def without_place(self) -> PadPrior:
        return PadPrior(0.0, self.down)

    def off(self, sighting: PadSighting) -> FloatArray:
        return np.array(sighting.pad_position_body_m) - self.pad_body_m


@pytest.mark.parametrize("lens_m", [0.35, 0.5, 0.7])
@pytest.mark.parametrize("yaw_rad", [0.0, 0.8])
def test_a_tag_that_has_grown_out_of_the_image_is_seen_where_it_is_expected(
    tag: Pad, wide: CameraConfig, vehicle: VehicleConfig, lens_m: float, yaw_rad: float
) -> None:
    over = Over(tag, wide, vehicle, lens_m, yaw_rad)
    sighting = over.seen(over.prior())
    assert sighting is not None
    away = over.off(sighting)
    assert np.linalg.norm(away) < 0.004
    assert away @ np.linalg.solve(sighting.covariance[:3, :3], away) < 3.0 * 3.0
    if lens_m < 0.7:
        assert over.seen(over.without_place()) is None


@pytest.mark.parametrize("yaw_rad", [0.2, 0.4, 0.6, 1.8, 2.4])
@pytest.mark.parametrize("lens_m", [0.3, 0.35, 0.4])
def test_a_few_cells_that_fill_a_vignetted_image_are_measured_to_a_millimetre(
    tag: Pad, wide: CameraConfig, vehicle: VehicleConfig, lens_m: float, yaw_rad: float
) -> None:
    over = Over(tag, wide, vehicle, lens_m, yaw_rad)  # corners have a quarter less light
    sighting = over.seen(over.prior())
    assert sighting is not None
    assert np.linalg.norm(over.off(sighting)) < 0.001


@pytest.mark.parametrize("lens_m", [1.5, 2.5, 4.0])
@pytest.mark.parametrize("share", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("grey", [10, 90, 230])
def test_a_tag_of_which_a_corner_is_covered_is_seen_by_the_rest(
    tag: Pad, wide: CameraConfig, vehicle: VehicleConfig, lens_m: float, share: float, grey: int
) -> None:
    """Up to 30 % of it, from beyond a corner."""
    over = Over(tag, wide, vehicle, lens_m, 0.0)
    assert over.seen(over.without_place()) or over.seen(over.without_place())
    corners = over.vision.pixels(
        over.pad_body_m + tag.markers[0].corners_pad_m() @ matrix_from_quat(over.attitude)
    )
    (left, top), (right, _) = corners.min(axis=0).astype(int), corners.max(axis=0).astype(int)
    covered = over.image.copy()
    side = int(math.sqrt(share) * (right - left))
    covered[top - 4 : top + side, left - 4 : left + side] = grey
    sighting = over.seen(over.prior(), covered)
    assert sighting is not None
    away = over.off(sighting)
    assert np.linalg.norm(away) < 0.006 * lens_m
    assert away @ np.linalg.solve(sighting.covariance[:3, :3], away) < 3.0 * 3.0


@pytest.mark.parametrize("lens_m", [0.4, 0.6])
def test_another_tag_is_not_taken_for_the_one_that_is_expected(
    tag: Pad, wide: CameraConfig, vehicle: VehicleConfig, lens_m: float
) -> None:
    seen = [
        Over(tag, wide, vehicle, lens_m).seen(
            Over(tag, wide, vehicle, lens_m).prior(), Over(single_pad({"id": n}), wide, vehicle, lens_m).image
        )
        for n in range(1, 9)
    ]
    assert seen == [None] * len(seen)


def test_one_that_is_expected_within_no_half_cell_is_not_looked_for(
    tag: Pad, wide: CameraConfig, vehicle: VehicleConfig
) -> None:
    over = Over(tag, wide, vehicle, 0.5)
    cell_m = tag.markers[0].cell_m
    assert over.seen(over.prior(std_m=0.2 * cell_m)) is not None
    assert over.seen(over.prior(std_m=0.3 * cell_m)) is None


def test_a_pad_that_has_gone_is_not_seen(tag: Pad, wide: CameraConfig, vehicle: VehicleConfig) -> None:
    over = Over(tag, wide, vehicle, 0.5)
    gone = np.full_like(over.image, 120)
    gone[:, 700:] = 60  # a shadow's edge
    gone[300:330, :] = 200
    assert over.seen(over.prior(), gone) is None
