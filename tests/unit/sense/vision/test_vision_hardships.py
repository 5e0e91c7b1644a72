"""What light, motion, dirt and clutter do to the eyes: the pad is seen rightly, or not at all."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from companion.base.geometry import FloatArray, Vector3, quat_from_euler
from companion.base.messages import Frame, PadPrior, PadSighting
from companion.config import CameraConfig, VehicleConfig, VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import PadDetector, SearchPass
from companion.sense.vision.lens import Lens
from companion.sense.vision.pipeline import Vision
from companion.sense.vision.pose import estimate_pose
from companion.sense.vision.print_check import PrintCheck
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import DirtSettings, ExposureSettings, ImagingSettings
from sitl.camera.light import GlareSettings, LightSettings, ShadowSettings

LEVEL = quat_from_euler(0.0, 0.0, 0.3)
DOWN: Vector3 = (0.0, 0.0, 1.0)
SURFACE_M = 0.3
# of a sighting's error in terms of its covariance, three axes: one in a million
IMPOSSIBLE = 30.7


class Studio:
    """The pad under a camera of these settings."""

    def __init__(
        self, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig, settings: ImagingSettings
    ) -> None:
        self._model = CameraModel(camera, vehicle, pad, settings, np.random.default_rng(11))

    def shoot(self, away_m: Vector3, velocity_m_s: Vector3 = (0.0, 0.0, 0.0)) -> tuple[Frame, Vector3]:
        """A frame, and where the pad truly is (body, m); `away_m`: the vehicle from the pad, NED."""

        def scene(time_s: float) -> ScenePose:
            x, y, z = (p + v * time_s for p, v in zip(away_m, velocity_m_s, strict=True))
            return ScenePose((x, y, z - SURFACE_M), LEVEL, (0.0, 0.0, -SURFACE_M), 0.0)

        c, s = math.cos(0.3), math.sin(0.3)
        x, y, z = away_m
        return Frame(0.0, 0.03, 1, self._model.render(0.0, scene)), (-c * x - s * y, s * x - c * y, -z)


def lit(lux: float = 2500.0, *, gain: float = 1.0, **light: object) -> ImagingSettings:
    """A fixed exposure that is right at 2500 lux."""
    exposure = ExposureSettings(automatic=False, gain=gain)
    return ImagingSettings(
        light=LightSettings.model_validate({"illuminance_lux": lux, **light}), exposure=exposure
    )


def expected(truth: Vector3, std_m: float = 0.05) -> PadPrior:
    return PadPrior(0.0, DOWN, truth, quat_from_euler(0.0, 0.0, -0.3), std_m)


def is_true(sighting: PadSighting, truth: Vector3, moved_m: float = 0.0) -> bool:
    """Whether the covariance admits the error; `moved_m`: how far the pad moves in the readout."""
    error = np.array(sighting.pad_position_body_m) - truth
    covariance = sighting.covariance[:3, :3] + np.eye(3) * moved_m**2
    return bool(error @ np.linalg.solve(covariance, error) < IMPOSSIBLE)


@pytest.fixture(scope="module")
def vision(pad: Pad, camera: CameraConfig, vehicle: VehicleConfig) -> Vision:
    return Vision(pad, camera, vehicle, VisionConfig())


BORNE = {
    "a shadow's edge": lit(shadow=ShadowSettings(depth=0.85, course_deg=40.0, speed_m_s=0.0)),
    "stripes of shade": lit(shadow=ShadowSettings(depth=0.7, course_deg=10.0, speed_m_s=0.0, stripes_m=0.4)),
    "the sun's mirror image": lit(glare=GlareSettings(elevation_deg=88.0, azimuth_deg=40.0, spread_deg=2.0)),
    "stray light": lit(veil=0.6),
    "over-exposed": lit(gain=2.5),
    "under-exposed": lit(500.0),
    "noise of dusk": lit(100.0, gain=16.0),
    "dirt on the lens": ImagingSettings(dirt=DirtSettings(blobs=30, largest_share=0.12, opacity=0.9)),
    "out of focus": ImagingSettings(lens_blur_px=1.2),
}


@pytest.mark.parametrize("name", BORNE)
def test_the_pad_is_seen_rightly_in_bad_light(
    vision: Vision, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig, name: str
) -> None:
    studio, seen = Studio(pad, camera, vehicle, BORNE[name]), 0
    heights = (0.25, 0.6, 1.5, 4.0)
    for height_m in heights:
        frame, truth = studio.shoot((0.02, -0.03, -height_m - 0.08))
        sighting = vision.step(frame, expected(truth)).sighting
        seen += sighting is not None
        assert sighting is None or is_true(sighting, truth)
    assert seen == len(heights)


@pytest.mark.parametrize("settings", [lit(15.0), lit(gain=40.0), ImagingSettings(lens_blur_px=5.0)])
def test_a_picture_that_shows_next_to_nothing_gives_no_false_pose(
    vision: Vision, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig, settings: ImagingSettings
) -> None:
    studio = Studio(pad, camera, vehicle, settings)
    for height_m in (0.3, 2.0, 8.0):
        frame, truth = studio.shoot((0.0, 0.05, -height_m))
        sighting = vision.step(frame, expected(truth)).sighting
        assert sighting is None or is_true(sighting, truth)


@pytest.mark.parametrize("height_m", [0.3, 1.0, 3.0])
def test_motion_blur_is_borne(
    vision: Vision, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig, height_m: float
) -> None:
    studio = Studio(pad, camera, vehicle, ImagingSettings())
    frame, truth = studio.shoot((0.0, 0.0, -height_m - 0.08), (1.0, 0.6, 0.3))
    sighting = vision.step(frame, expected(truth)).sighting
    assert sighting is not None
    assert is_true(sighting, truth, 1.2 * abs(sighting.time_s))


@pytest.mark.parametrize("away", [(1.3, 0.0), (0.0, -1.8), (-1.2, 1.5)])
def test_markers_that_the_frame_cuts_do_not_bend_the_pose(
    vision: Vision, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig, away: tuple[float, float]
) -> None:
    studio = Studio(pad, camera, vehicle, ImagingSettings())
    frame, truth = studio.shoot((*away, -3.2))
    result = vision.step(frame, expected(truth))
    assert result.sighting is not None
    assert is_true(result.sighting, truth)


def corners_in(frame: Frame, pad: Pad, camera: CameraConfig) -> dict[int, FloatArray]:
    """Corners (4, 2) px of the far markers that are read, by id."""
    height, width = frame.image.shape
    found = PadDetector(pad, VisionConfig(), Lens(camera)).detect(
        frame.image, SearchPass(0, 0, width, height, 1, ("F",))
    )
    return {d.marker.id: d.corners_px for d in found}


def test_dirt_on_a_marker_costs_that_marker_and_not_the_pose(
    vision: Vision, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig
) -> None:
    frame, truth = Studio(pad, camera, vehicle, ImagingSettings()).shoot((0.0, 0.0, -4.0))
    corners = corners_in(frame, pad, camera)
    for marker, corner, radius in ((0, 0, 3), (1, 2, 6), (2, 1, 14)):
        dirty = frame.image.copy()
        at = tuple(round(v) for v in corners[marker][corner])
        cv2.circle(dirty, (at[0], at[1]), radius, (90,), -1)
        sighting = vision.step(replace(frame, image=dirty), expected(truth)).sighting
        assert sighting is not None
        assert is_true(sighting, truth)


def forged(image_side: int, number: int) -> FloatArray:
    """A code of the far markers' dictionary with white around it."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    code = cv2.aruco.generateImageMarker(dictionary, number, image_side)
    return np.asarray(np.pad(code, image_side // 6, constant_values=255))


def test_foreign_markers_and_squares_beside_the_pad_change_nothing(
    vision: Vision, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig
) -> None:
    frame, truth = Studio(pad, camera, vehicle, ImagingSettings()).shoot((0.0, 0.0, -5.0))
    plain = vision.step(frame, expected(truth)).sighting
    crowded = frame.image.copy()
    for k, (row, column) in enumerate(((20, 30), (380, 40), (30, 520), (390, 530), (200, 20))):
        mark = forged(48, 20 + k) if k < 4 else np.pad(np.zeros((48, 48)), 8, constant_values=255)
        crowded[row : row + mark.shape[0], column : column + mark.shape[1]] = mark
    found = vision.step(replace(frame, image=crowded), PadPrior(0.0, DOWN))
    again = found.sighting or vision.step(replace(frame, image=crowded), PadPrior(0.0, DOWN)).sighting
    assert plain is not None
    assert again is not None
    assert again.marker_ids == plain.marker_ids
    assert again.pad_position_body_m == pytest.approx(plain.pad_position_body_m, abs=0.01)


@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_one_code_of_the_pad_by_itself_is_not_the_pad(
    vision: Vision, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig, number: int
) -> None:
    frame, _ = Studio(pad, camera, vehicle, ImagingSettings()).shoot((30.0, 12.0, -4.0))
    mark = forged(40, number)
    image = frame.image.copy()
    image[200 : 200 + mark.shape[0], 300 : 300 + mark.shape[1]] = mark
    lone = replace(frame, image=image)
    assert len(corners_in(lone, pad, camera)) == 1  # it is read
    assert vision.step(lone, PadPrior(0.0, DOWN)).sighting is None
    assert vision.step(lone, PadPrior(0.0, DOWN)).sighting is None


def test_one_marker_is_believed_where_the_print_about_it_is_the_pads(
    pad: Pad, camera: CameraConfig, vehicle: VehicleConfig
) -> None:
    frame, _ = Studio(pad, camera, vehicle, ImagingSettings()).shoot((0.0, 0.0, -5.0))
    lens, config = Lens(camera), VisionConfig()
    found = PadDetector(pad, config, lens).detect(frame.image, SearchPass(0, 0, 640, 480, 1, ("F",)))
    check = PrintCheck(pad, lens)
    for detection in found:
        pose = estimate_pose([detection], lens, config, DOWN)
        assert pose is not None
        assert check.bears_out(frame.image, pose)
        quarter = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
        assert not check.bears_out(frame.image, replace(pose, camera_from_pad=pose.camera_from_pad @ quarter))


def test_a_descent_hands_over_between_groups_without_a_jump(
    vision: Vision, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig
) -> None:
    """From 9 m to 0.1 m in steps of 4 %: the error changes by no more than the covariances admit."""
    studio = Studio(pad, camera, vehicle, ImagingSettings())
    before: tuple[str, FloatArray, FloatArray] | None = None
    changes = []
    for height_m in np.geomspace(9.0, 0.1, 110):
        frame, truth = studio.shoot((0.01 * height_m, -0.02 * height_m, -float(height_m) - 0.08))
        sighting = vision.step(frame, expected(truth, 0.01 + 0.01 * float(height_m))).sighting
        assert sighting is not None
        error = np.array(sighting.pad_position_body_m) - truth
        if before is not None and before[0] != sighting.group:
            admitted = before[2] + sighting.covariance[:3, :3]
            jump = error - before[1]
            changes.append(f"{before[0]}{sighting.group}")
            assert jump @ np.linalg.solve(admitted, jump) < 16.3
            assert np.abs(jump).max() < 0.01
        before = (sighting.group, error, sighting.covariance[:3, :3])
    assert changes == ["FM", "MC"]
