"""The fit, its honesty and its verdict, on corners whose truth is known."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calibration.camera.board import CalibrationBoard
from calibration.camera.quality import Assessment, assess, unfolded_share
from calibration.camera.solver import (
    UnsolvableError,
    empirical_bayes_variance,
    projection_std_px,
    solve,
    uncertainty,
)
from calibration.camera.views import BoardView, ImageCoverage, tilt_of
from companion.base.geometry import FloatArray
from companion.config import CameraConfig, find_file, load_model
from tests.unit.calibration.camera.board_pictures import (
    BoardPainter,
    BoardPose,
    hand_held_poses,
    ideal_view,
    tour_poses,
)

CAMERA = load_model(CameraConfig, find_file("cameras", "hd_1280x720"))
SIZE = (CAMERA.width_px, CAMERA.height_px)
BOARD = CalibrationBoard(columns=7, rows=5, square_m=0.034, marker_m=0.025)
WIDE = CAMERA.model_copy(
    update={"fx_px": 620.0, "fy_px": 621.0, "distortion": (0.9, 0.2, 3e-4, -2e-4, 0.01, 1.25, 0.42, 0.04)}
)


def numbers_of(camera: CameraConfig) -> FloatArray:
    return np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion])


def views_of(
    seed: int,
    *,
    count: int = 25,
    camera: CameraConfig = CAMERA,
    bow_m: float = 0.0,
    noise_px: float = 0.05,
    tilt_deg: float = 45.0,
) -> list[BoardView]:
    rng = np.random.default_rng(seed)
    painter = BoardPainter(BOARD, camera, bow_m)
    poses = hand_held_poses(BOARD, camera, count, rng, tilt_deg)
    return [ideal_view(painter, pose, rng, noise_px, f"view {k}") for k, pose in enumerate(poses)]


def judged(views: Sequence[BoardView], model: str = "brown") -> Assessment:
    return assess(views, SIZE, BOARD.surface, "rational" if model == "rational" else "brown")


def test_without_noise_the_camera_comes_out_exactly() -> None:
    solution = solve(views_of(1, noise_px=0.0), SIZE, BOARD.surface)
    assert solution.camera.numbers == pytest.approx(numbers_of(CAMERA), rel=2e-4, abs=2e-5)


def test_a_wide_lens_needs_the_rational_model_and_gets_it() -> None:
    painter, rng = BoardPainter(BOARD, WIDE), np.random.default_rng(2)
    tours = tour_poses(BOARD, WIDE, width_share=0.35) + tour_poses(BOARD, WIDE, 40.0, width_share=0.6)
    views = views_of(2, camera=WIDE, count=30)
    views += [ideal_view(painter, pose, rng, 0.05, f"tour {k}") for k, pose in enumerate(tours)]
    views = [view for view in views if len(view.ids) >= 6]
    rational, brown = judged(views, "rational"), judged(views)
    assert rational.reasons == ()
    assert rational.solution.camera.numbers[:4] == pytest.approx(numbers_of(WIDE)[:4], rel=2e-3)
    assert rational.rms_px < 0.08 < brown.rms_px
    assert rational.brown_held_out_rms_px is not None


def test_a_bent_board_is_found_out_and_does_no_harm() -> None:
    solution = solve(views_of(3, bow_m=0.001), SIZE, BOARD.surface)
    # a bow of 1 mm from chord to middle is 2/3 of that, at the ends, from the mean plane
    assert solution.surface.bend_m == pytest.approx((0.001, 0.0, 0.0), abs=5e-5)
    assert solution.surface.bow_m == pytest.approx(0.0006, abs=1e-4)
    # taken for flat, it would be wrong by 1 %
    assert solution.camera.numbers[:2] == pytest.approx((1065.0, 1065.0), rel=1e-3)


def test_wrong_corners_and_a_view_of_another_board_are_left_out() -> None:
    views = views_of(4)
    clean = solve(views, SIZE, BOARD.surface)
    spoilt = list(views)
    spoilt[3].corners_px[2] += (1.5, -2.0)
    spoilt[7].corners_px[0] += (40.0, 10.0)
    shrunk = np.array(spoilt[9].points_m) * np.where(np.arange(3) == 0, 0.9, 1.0) + 2e-3 * (
        spoilt[9].points_m > 0.1
    )
    spoilt[9] = replace(spoilt[9], points_m=shrunk)
    found = solve(spoilt, SIZE, BOARD.surface)
    assert "view 9" in found.dropped_views
    assert found.dropped_corners >= 2
    assert found.camera.numbers[:4] == pytest.approx(clean.camera.numbers[:4], abs=1.0)


def test_stated_deviations_are_honest() -> None:
    """NEES of the whole camera over 16 runs: a χ² of 9 x 16 = 144; the band is that of 99.9 %."""
    nees = []
    for seed in range(16):
        solution = solve(views_of(100 + seed, bow_m=4e-4), SIZE, BOARD.surface)
        known = uncertainty(solution)
        error = solution.camera.numbers - numbers_of(CAMERA)
        nees.append(float(error @ np.linalg.solve(known.covariance, error)))
    assert 92.0 < sum(nees) < 204.0


def test_sharp_views_count_for_more_and_deviations_stay_honest() -> None:
    nees, ratios = [], []
    for seed in range(20):
        painter, rng = BoardPainter(BOARD, CAMERA), np.random.default_rng(seed)
        poses = hand_held_poses(BOARD, CAMERA, 25, rng)
        noises_px = np.where(np.arange(25) % 3 == 0, 0.02, 0.06)
        drawn = zip(poses, noises_px.tolist(), strict=True)
        views = [ideal_view(painter, p, rng, noise, f"view {k}") for k, (p, noise) in enumerate(drawn)]
        solution = solve(views, SIZE, BOARD.surface)
        errors = solution.camera.numbers - numbers_of(CAMERA)
        nees.append(errors @ np.linalg.solve(uncertainty(solution).covariance, errors) / 9.0)
        weights = np.array([seen.weight for seen in solution.seen])
        sharp = np.array([int(seen.view.name.split()[1]) % 3 == 0 for seen in solution.seen])
        ratios.append(np.median(weights[sharp]) / np.median(weights[~sharp]))
    # 180 degrees of freedom: 95 in 100 are within 0.8 .. 1.22
    assert 0.8 < np.mean(nees) < 1.25
    assert 5.0 < np.mean(ratios) < 11.0  # of 9


def test_views_alike_count_alike() -> None:
    rng = np.random.default_rng(5)
    freedom = np.tile((6.0, 20.0, 42.0), 200)
    usual, worth = empirical_bayes_variance(2.5 * rng.chisquare(freedom) / freedom, freedom)
    assert usual == pytest.approx(2.5, rel=0.06)
    assert worth > 50.0
    true = 2.5 * 8.0 / rng.chisquare(8.0, len(freedom))
    usual, worth = empirical_bayes_variance(true * rng.chisquare(freedom) / freedom, freedom)
    assert usual == pytest.approx(2.5, rel=0.1)
    assert worth == pytest.approx(8.0, rel=0.3)


def test_views_that_err_as_a_whole_make_the_deviations_larger() -> None:
    views = views_of(5)
    rng = np.random.default_rng(1)
    sheared = []
    for view in views:  # a rolling shutter in motion: rows are moved by how far down they are
        amount = rng.normal(0.0, 0.5, 2) / CAMERA.height_px
        sheared.append(replace(view, corners_px=view.corners_px + view.corners_px[:, 1:] * amount))
    plain, known = (uncertainty(solve(some, SIZE, BOARD.surface)) for some in (views, sheared))
    assert plain.stretch < 2.0 < known.stretch


def test_the_projection_is_least_certain_where_no_board_was() -> None:
    rng = np.random.default_rng(6)
    painter = BoardPainter(BOARD, CAMERA)
    poses = hand_held_poses(BOARD, CAMERA, 40, rng)
    views = [ideal_view(painter, pose, rng, 0.05, f"view {k}") for k, pose in enumerate(poses)]
    left = [v.only(v.corners_px[:, 0] < 640.0) for v in views]
    solution = solve([v for v in left if len(v.ids) >= 8], SIZE, BOARD.surface)
    grid = projection_std_px(solution.camera, uncertainty(solution).covariance)
    assert grid[6, -1] > 1.2 * grid[6, 0]


# ---------------------------------------------------------------- verdict


def test_a_good_calibration_has_no_reasons_against_it() -> None:
    found = judged(views_of(7))
    assert found.reasons == ()
    assert found.held_out_rms_px is not None
    assert found.rms_px < found.held_out_rms_px < 1.2 * found.rms_px
    assert found.rms_px <= found.rms_all_px


def reasons(views: Sequence[BoardView], model: str = "brown") -> str:
    return "; ".join(judged(views, model).reasons)


def test_too_few_views() -> None:
    assert "too few views: 6, expected 8" in reasons(views_of(8, count=6))


def test_many_pictures_of_few_poses_are_few_views() -> None:
    few, rng = views_of(8, count=6), np.random.default_rng(8)
    many = [
        replace(
            view, name=f"{view.name} {k}", corners_px=rng.normal(view.corners_px, 0.05, view.corners_px.shape)
        )
        for view in few
        for k in range(4)
    ]
    assert "too few views: 6 (18 more are of the same), expected 8" in reasons(many)


def test_no_tilt_leaves_the_focal_length_open() -> None:
    told = reasons(views_of(9, tilt_deg=4.0))
    assert "tilted by" in told
    assert "fx" in told
    assert "is uncertain by" in told


def test_the_middle_of_the_image_alone() -> None:
    middle = []
    for view in views_of(10, count=40):
        inside = (np.abs(view.corners_px - (640, 360)) < (300, 170)).all(axis=1)
        middle.append(view.only(np.asarray(inside)))
    told = reasons([view for view in middle if len(view.ids) >= 8])
    assert "% of the image; expected 55 %" in told
    assert "corners of the image without the board: upper left" in told


def test_corners_that_do_not_fit() -> None:
    rng = np.random.default_rng(0)
    views = [
        replace(v, corners_px=v.corners_px + rng.normal(0, 1.6, v.corners_px.shape)) for v in views_of(11)
    ]
    assert "px; expected 1.54 or less" in reasons(views)


def test_more_numbers_than_the_views_can_tell() -> None:
    told = reasons(views_of(12, count=10, noise_px=0.3), "rational")
    assert "the rational model overfits" in told
    assert "expected --model brown" in told


def test_distortion_that_folds_back() -> None:
    solution = solve(views_of(13), SIZE, BOARD.surface)
    folded = replace(solution.camera, numbers=np.array([1065, 1065, 640, 360, -0.9, 0.0, 0.0, 0.0, 0.0]))
    assert unfolded_share(folded) < 0.9
    assert unfolded_share(solution.camera) == 1.0


def test_one_view_fixes_no_camera() -> None:
    with pytest.raises(UnsolvableError, match="1 usable views of the board; expected 2"):
        judged(views_of(14, count=1))


# ---------------------------------------------------------------- coverage


@pytest.mark.parametrize(
    ("tilt", "away"),
    [((0.5, 0, 0), "bottom"), ((-0.5, 0, 0), "top"), ((0, 0.5, 0), "left"), ((0, -0.5, 0), "right")],
)
def test_the_edge_that_is_named_is_the_one_farther_away(tilt: tuple[float, ...], away: str) -> None:
    painter = BoardPainter(BOARD, CAMERA)
    corner = {"top": (0.119, 0.0), "bottom": (0.119, 0.17), "left": (0.0, 0.085), "right": (0.238, 0.085)}
    pose = BoardPose(np.array(tilt, dtype=float), np.array((-0.1, -0.08, 0.6)))
    assert tilt_of(pose.turn).directions == (away,)
    view = ideal_view(painter, pose, np.random.default_rng(0), 0.0, "")
    coverage = ImageCoverage(SIZE)
    coverage.add(view)
    assert coverage.tilt_count(away) == 1
    import cv2

    rotation = np.asarray(cv2.Rodrigues(pose.turn)[0])
    depths = {name: float((rotation @ np.array((*xy, 0.0)))[2]) for name, xy in corner.items()}
    assert max(depths, key=lambda name: depths[name]) == away


def test_hints_name_what_is_missing_until_nothing_is() -> None:
    coverage = ImageCoverage(SIZE)
    assert coverage.hints()[0] == "show it at the upper left of the image"
    assert "tilt its top edge away from the camera" in coverage.hints()
    for view in views_of(15, count=60):
        coverage.add(view)
    assert coverage.complete
    assert coverage.hints() == []
    assert coverage.share == 1.0


def test_a_fisheye_comes_out_as_surely_as_it_is_stated() -> None:
    camera = load_model(CameraConfig, find_file("cameras", "fisheye_800x600"))
    found = assess(views_of(4, camera=camera, tilt_deg=35.0), (800, 600), BOARD.surface, "fisheye")
    errors = found.solution.camera.numbers - numbers_of(camera)
    assert found.reasons == ()
    assert abs(errors[0]) < 0.002 * camera.fx_px
    assert np.abs(errors / found.uncertainty.std).max() < 4.0
    # with five numbers no camera fits, and it is said
    assert assess(views_of(4, camera=camera, tilt_deg=35.0), (800, 600), BOARD.surface, "brown").reasons
