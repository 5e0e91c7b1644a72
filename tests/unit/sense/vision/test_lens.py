"""The lens against OpenCV's projection."""

import cv2
import numpy as np
import pytest

from companion.config import CameraConfig, ConfigError, validate
from companion.sense.vision.lens import Lens

RATIONAL = (0.9, 0.2, 3e-4, -2e-4, 0.01, 1.25, 0.42, 0.04)


@pytest.mark.parametrize("distortion", [None, RATIONAL], ids=["five numbers", "eight"])
def test_projection_is_opencvs_and_undistortion_is_its_inverse(
    camera: CameraConfig, distortion: tuple[float, ...] | None
) -> None:
    if distortion is not None:
        camera = camera.model_copy(update={"distortion": distortion})
    rng = np.random.default_rng(2)
    points = np.column_stack(
        (rng.uniform(-1.5, 1.5, 50), rng.uniform(-1.0, 1.0, 50), rng.uniform(2.5, 6.0, 50))
    )
    matrix = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(camera.distortion))
    lens = Lens(camera)
    pixels, depth = lens.project(points)
    assert np.abs(pixels - np.asarray(expected).reshape(-1, 2)).max() < 1e-9
    assert depth == pytest.approx(points[:, 2])
    assert np.abs(lens.undistort(pixels) - points[:, :2] / points[:, 2:]).max() < 1e-7


def test_a_distortion_of_a_length_that_no_model_has_is_refused(camera: CameraConfig) -> None:
    with pytest.raises(ConfigError, match=r"distortion: expected 5 numbers .* or 8 .* found 6"):
        validate(CameraConfig, {**camera.model_dump(), "distortion": (0.0,) * 6}, "camera.yaml")


def test_what_the_lens_cannot_see_is_nowhere(camera: CameraConfig) -> None:
    points = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.01], [5.0, 0.0, 1.0], [0.1, 0.1, 1.0]])
    pixels, _ = Lens(camera).project(points)
    assert np.isnan(pixels).any(axis=1).tolist() == [True, True, True, False]


def test_a_wide_lens_sees_to_the_edge_of_its_image(camera: CameraConfig) -> None:
    wide = camera.model_copy(
        update={
            "fx_px": 0.5 * camera.width_px,
            "fy_px": 0.5 * camera.width_px,
            "distortion": (-0.2, 0.04, 0, 0, 0),
        }
    )
    lens = Lens(wide)
    edge = np.array([[3.0, 0.5 * camera.height_px]])
    ray = lens.undistort(edge)
    pixels, _ = lens.project(np.column_stack((ray, [[1.0]])))
    assert abs(ray[0, 0]) > 1.1
    assert pixels == pytest.approx(edge, abs=1e-3)


def test_what_a_distortion_folds_into_the_image_is_nowhere(camera: CameraConfig) -> None:
    """From a tangent of 0.577 on this polynomial brings the picture back to the middle."""
    folded = Lens(camera.model_copy(update={"distortion": (-1.0, 0.0, 0.0, 0.0, 0.0)}))
    pixels, _ = folded.project(np.array([[0.5, 0.0, 1.0], [0.95, 0.0, 1.0]]))
    assert np.isnan(pixels).any(axis=1).tolist() == [False, True]


def test_straight_sides_bow_as_the_lens_draws_them(camera: CameraConfig) -> None:
    lens = Lens(camera)
    corners = np.array([(40.0, 60.0), (300.0, 30.0), (330.0, 290.0), (70.0, 320.0)])
    (bows,) = lens.bows(corners[None])
    rays = lens.undistort(corners)
    for k, bow in enumerate(bows):
        start, end = corners[k], corners[(k + 1) % 4]
        shares = np.linspace(0.0, 1.0, 101)[:, None]
        line = (1.0 - shares) * rays[k] + shares * rays[(k + 1) % 4]
        seen, _ = lens.project(np.column_stack((line, np.ones(len(line)))))
        across = (end - start) / np.linalg.norm(end - start)
        outward = (seen - start) @ np.array([across[1], -across[0]])
        assert bow == pytest.approx(outward[50], abs=0.01)
    assert np.abs(bows).max() > 0.3
