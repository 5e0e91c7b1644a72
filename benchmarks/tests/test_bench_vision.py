"""The vision bench's own reckoning: where corners truly are, the bound, flips, bands, clutter and tables."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.vision import shots
from benchmarks.vision.cases import CaseOutcome, VisionCase, clutter_board, random_code
from benchmarks.vision.judge import UNKNOWNS, JudgedShot, _errors, _rows, bound_m2, noise_px
from benchmarks.vision.photos import TAG_FAMILY, TagCounts, outer_border, read_tags, tag_table
from benchmarks.vision.shots import (
    BenchShot,
    HoverFlight,
    HoverMoment,
    HoverScene,
    PadBeforeCamera,
    camera_named,
    pad_of,
    vehicle,
)
from benchmarks.vision.speed import Follower, Times
from benchmarks.vision.tables import (
    PAD_HEIGHTS_M,
    PAPER_RECALL,
    error_tables,
    flips_table,
    nees_band,
    pad_cases,
    recall_tables,
    single_cases,
    speed_table,
)
from companion.base.geometry import (
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
)
from companion.base.messages import PadSighting
from companion.config import VisionConfig
from companion.sense.vision.aruco import GROUPS, PadDetector, SearchPass
from companion.sense.vision.lens import Lens
from sitl.run.scene_camera import perturbed_lens
from sitl.run.simulation import PHYSICS_STEP_S


@pytest.fixture(autouse=True)
def _a_flight_that_costs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of the simulated one: to the east at 0.3 m/s, rolling at 0.1 rad/s."""
    cv2.setNumThreads(1)
    steps = np.arange(2000) * PHYSICS_STEP_S
    away = np.outer(steps, (0.0, 0.3, 0.0))
    attitudes = np.array([quat_from_euler(0.1 * (s - 2.5), 0.02, 0.0) for s in steps])
    monkeypatch.setattr(shots, "flight", lambda _: HoverFlight(away, attitudes))


def test_corners_are_where_the_detector_finds_them_in_the_middle_of_their_rows() -> None:
    stage = PadBeforeCamera(camera_named("1280x720"), pad_of(0.0), np.random.default_rng(3))
    misses = []
    for _ in range(4):
        shot = stage.shoot(2.0)
        whole = SearchPass(0, 0, 1280, 720, 1, GROUPS)
        detector = PadDetector(stage.pad, VisionConfig(), Lens(stage.camera))
        for found in detector.detect(shot.frame.image, whole):
            true_px, _ = stage.pixels(shot.scene, found.corners_pad_m)
            misses.append(found.corners_px - true_px)
    all_misses = np.concatenate(misses)
    assert np.abs(all_misses.mean(axis=0)).max() < 0.05
    assert np.sqrt((all_misses**2).mean()) < 0.3


def test_a_row_is_looked_at_when_it_is_exposed() -> None:
    stage = PadBeforeCamera(camera_named("640x480"), pad_of(0.0), np.random.default_rng(4))
    scene = stage.scene(3.0)
    points = np.array([(0.4, 0.0, 0.0), (-0.4, 0.3, 0.0)])
    pixels, times = stage.pixels(scene, points)
    rows = ((pixels[:, 1] + 0.5) / 480.0 - 0.5) * stage.camera.readout_s
    assert times == pytest.approx(rows, abs=1e-6)
    for point, pixel, time_s in zip(points, pixels, times, strict=True):
        camera = stage.in_camera(scene, point[None], float(time_s))
        matrix = np.array([[532.6, 0, 321.4], [0, 532.6, 238.2], [0, 0, 1.0]])
        at, _ = cv2.projectPoints(camera, np.zeros(3), np.zeros(3), matrix, np.array(stage.camera.distortion))
        assert np.asarray(at).reshape(2) == pytest.approx(pixel, abs=0.01)


def test_vibration_is_the_integral_of_what_the_simulated_gyroscope_feels() -> None:
    moment = HoverMoment.draw(np.random.default_rng(0), vehicle())
    step = 1e-6
    before, after = moment.at(-step)[1], moment.at(step)[1]
    turned = quat_multiply(quat_conjugate(before), after)
    rates = [2.0 * part / (2.0 * step) for part in turned[1:]]
    phase = moment.rotor_phase_rad
    k = math.sqrt(2.0) * 0.5 * 0.04
    flown = (0.1, 0.0, 0.0)
    shaken = (k * math.cos(phase), k * math.sin(phase), 0.5 * k * math.sin(2.0 * phase))
    assert rates == pytest.approx([a + b for a, b in zip(flown, shaken, strict=True)], abs=1e-3)


def test_a_shot_tells_the_app_no_more_than_it_would_know() -> None:
    stage = PadBeforeCamera(camera_named("640x480"), pad_of(18.0), np.random.default_rng(5))
    tilts, misses = [], []
    for _ in range(300):
        scene = stage.scene(1.0)
        prior = stage.expectation(scene, 0.0, 1.0)
        place, _ = scene.pad_in_body(0.0)
        assert prior.pad_position_body_m is not None
        misses.append(np.subtract(prior.pad_position_body_m, place) / prior.position_std_m)
        down = quat_rotate(quat_conjugate(scene.pose(0.0).vehicle_attitude), (0.0, 0.0, 1.0))
        tilts.append(math.degrees(math.acos(min(1.0, float(np.dot(down, prior.down_body))))))
    assert np.std(misses) == pytest.approx(1.0, abs=0.1)
    assert math.sqrt(np.mean(np.square(tilts))) == pytest.approx(1.0, abs=0.1)


def test_a_tilted_shot_tilts_as_far_as_asked_and_looks_at_the_pad() -> None:
    stage = PadBeforeCamera(camera_named("640x480"), pad_of(0.0), np.random.default_rng(6))
    for tilt in (0.0, 0.05, 0.17):
        scene = stage.scene(3.0, tilt)
        down = quat_rotate(scene.pose(0.0).vehicle_attitude, (0.0, 0.0, 1.0))
        assert math.acos(min(1.0, down[2])) == pytest.approx(tilt, abs=1e-3)
        u, v = stage.pixels(scene, np.zeros((1, 3)))[0][0]
        assert abs(u - 320.0) < 120.0
        assert abs(v - 240.0) < 120.0


# ---------------------------------------------------------------- judging


def sighting(shot: BenchShot, stage: PadBeforeCamera, turned: tuple[float, float, float]) -> PadSighting:
    """The truth, its pad turned in its own axes."""
    place, body_from_pad = shot.scene.pad_in_body(0.0)
    wrong = quat_multiply(body_from_pad, quat_from_rotation_vector(turned))
    return PadSighting(0.0, 1, place, wrong, np.eye(6), "F", (3,), {"F": 1, "M": 0, "C": 0}, 0.1)


def test_a_flip_is_a_tilt_to_the_other_side_or_far_off() -> None:
    stage = PadBeforeCamera(camera_named("640x480"), pad_of(18.0), np.random.default_rng(7))
    # it rolls by 4 degrees: mirrored it is off by 8
    moment = HoverMoment(shots.flight(0), 3.2, 0.0, 0.5)
    north, east, down = quat_rotate(moment.at(0.0)[1], (0.0, 0.0, -1.0))
    scene = HoverScene(moment, (1.0, 0.0, 0.0, 0.0), (north, east, down), 0.0)
    shot = BenchShot(stage.frame(scene, 0.0), scene, stage.expectation(scene, 0.0, 1.0))
    assert not _errors(shot, sighting(shot, stage, (0.0, 0.0, 0.0))).flipped
    assert not _errors(shot, sighting(shot, stage, (0.05, 0.0, 0.0))).flipped
    assert _errors(shot, sighting(shot, stage, (0.0, 0.0, 0.2))).flipped
    assert _errors(shot, sighting(shot, stage, (0.14, 0.0, 0.0))).flipped


def test_the_bound_is_what_a_fit_of_noisy_corners_reaches() -> None:
    # the information of the linearised problem, against the spread of the linear least squares estimate
    rng = np.random.default_rng(8)
    points = np.array([(0.2, -0.2, 0.0), (0.2, 0.2, 0.0), (-0.2, 0.2, 0.0), (-0.2, -0.2, 0.0)])
    position = np.array([0.1, -0.1, 2.0])

    def image(state: np.ndarray) -> np.ndarray:
        turn = np.array(
            [[0, -state[5], state[4]], [state[5], 0, -state[3]], [-state[4], state[3], 0]], dtype=float
        )
        p = points + points @ turn.T + position + state[:3]
        return np.asarray((p[:, :2] / p[:, 2:]).reshape(-1))

    jacobian = np.stack([(image(1e-6 * unit) - image(-1e-6 * unit)) / 2e-6 for unit in np.eye(6)], axis=1)
    rows = _rows(points, position, np.zeros(4), np.zeros((4, 2)))
    assert rows[:, :6] == pytest.approx(jacobian, rel=1e-5, abs=1e-7)
    assert not rows[:, 6:].any()
    shot = JudgedShot(True, False, information={"F": rows.T @ rows}, known=1e4 * np.eye(UNKNOWNS))
    noise = 1e-3
    estimates = np.linalg.solve(
        jacobian.T @ jacobian / noise**2 + 1e4 * np.eye(6),
        jacobian.T @ (noise * rng.standard_normal((8, 20000))) / noise**2
        + 1e4 * 0.01 * rng.standard_normal((6, 20000)),
    )
    spread = float((estimates[:3] ** 2).sum(axis=0).mean())
    assert bound_m2(shot, {"F": noise}) == pytest.approx(spread, rel=0.05)


def test_vibration_turns_the_camera_about_itself() -> None:
    points, position = np.array([(0.2, -0.1, 0.0)]), np.array([0.1, -0.1, 2.0])
    rows = _rows(points, position, np.zeros(1), np.array([(1.0, 0.5)]))
    away = points[0] + position
    for k in (0, 1):
        turned = away + 1e-6 * np.cross(np.eye(3)[k], away)
        moved = (turned[:2] / turned[2] - away[:2] / away[2]) / 1e-6
        assert rows[:, 12 + k] == pytest.approx(moved, rel=1e-4)
        assert rows[:, 14 + k] == pytest.approx(0.5 * moved, rel=1e-4)


def test_corner_noise_is_pooled_by_group() -> None:
    shots = [JudgedShot(True, False, misses_px={"F": np.full((4, 2), 0.1)}) for _ in range(3)]
    shots.append(JudgedShot(True, False, misses_px={"M": np.full((4, 2), -0.3)}))
    assert noise_px(shots) == pytest.approx({"F": 0.1, "M": 0.3})


def test_a_wrong_calibration_is_wrong_by_what_is_stated() -> None:
    rng, camera = np.random.default_rng(9), camera_named("1280x720")
    drawn = [perturbed_lens(camera, 0.003, rng) for _ in range(2000)]
    assert np.std([c.fx_px / camera.fx_px for c in drawn]) == pytest.approx(0.003, rel=0.06)
    assert np.std([c.cy_px for c in drawn]) == pytest.approx(0.003 * camera.fx_px, rel=0.06)


# ---------------------------------------------------------------- clutter


def test_clutter_holds_no_code_of_the_pad() -> None:
    pad = pad_of(0.0)
    rng = np.random.default_rng(10)
    board, side_m = clutter_board(rng, pad)
    image = board.levels[0].image
    assert image.std() > 20.0
    assert 0.5 <= side_m <= 6.0
    whole = SearchPass(0, 0, image.shape[1], image.shape[0], 1, GROUPS)
    assert len(PadDetector(pad, VisionConfig(), Lens(camera_named("640x480"))).detect(image, whole)) <= 1
    assert random_code(pad)(rng, 60).min() == 0


# ---------------------------------------------------------------- speed and photos


def test_the_follower_expects_the_pad_where_it_was_seen_from_where_the_vehicle_now_tilts() -> None:
    follower = Follower(np.random.default_rng(11))
    level = quat_from_euler(0.0, 0.0, 0.0)
    assert follower.expects(0.0, level).pad_position_body_m is None
    seen = PadSighting(
        0.0, 1, (0.0, 0.0, 2.0), level, 1e-4 * np.eye(6), "F", (0,), {"F": 1, "M": 0, "C": 0}, 0.1
    )
    follower.take(seen, level)
    tilting = quat_from_euler(0.1, 0.0, 0.0)
    prior = follower.expects(0.1, tilting)
    there = (0.0, 2.0 * math.sin(0.1), 2.0 * math.cos(0.1))
    assert prior.pad_position_body_m == pytest.approx(there, abs=0.01)
    assert prior.position_std_m == pytest.approx(0.04)


def test_the_border_of_dark_pixels_is_half_a_pixel_further_out() -> None:
    square = np.array([(10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0)])
    out = np.array([(9.5, 9.5), (20.5, 9.5), (20.5, 20.5), (9.5, 20.5)])
    assert outer_border(square) == pytest.approx(out)


def test_tags_are_counted_by_their_places_and_not_by_their_numbers(tmp_path: Path) -> None:
    """Cells of 4 px, one tag thrice on dark ground with a cell of white about each, one of them turned."""
    dictionary = cv2.aruco.getPredefinedDictionary(TAG_FAMILY)
    tag = np.pad(cv2.aruco.generateImageMarker(dictionary, 0, 32), 4, constant_values=220)
    picture = np.full((120, 260), 70, np.uint8)
    for left, drawn in ((10, tag), (90, tag[::-1, ::-1]), (170, tag)):
        picture[40:80, left : left + 40] = drawn
    noise = np.random.default_rng(13).normal(0.0, 2.0, picture.shape)
    noisy = (cv2.GaussianBlur(picture, (0, 0), 0.7) + noise).clip(0, 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a_c.jpg"), noisy)
    lines = [
        f"{number}, ({at} 44), ({at + 32} 44), ({at + 32} 76), ({at} 76)\n"
        for number, at in ((0, 14), (0, 94))
    ]
    (tmp_path / "a_c.txt").write_text("".join(lines))
    counted = read_tags(tmp_path)
    assert counted == [TagCounts("a_c.jpg", 2, 2, counted[0].peers, 0)]
    assert tag_table(counted)[1] == {"one tag many times": True}
    (tmp_path / "a_c.txt").write_text("7" + lines[0][1:])
    counted = read_tags(tmp_path)
    assert (counted[0].ours, counted[0].false) == (1, 3)
    assert tag_table(counted)[1] == {"one tag many times": False}
    assert tag_table([TagCounts("nothing read", 2, 0, 2, 0)])[1] == {"one tag many times": False}


# ---------------------------------------------------------------- bars


def outcome(
    case: VisionCase, error_m: float, seen: int, missed: int, rng: np.random.Generator
) -> CaseOutcome:
    """Shots with errors of that rms, covariances that are right, and corners as noisy as explains them."""
    std = error_m / math.sqrt(3.0)
    information = np.zeros((UNKNOWNS, UNKNOWNS))
    information[:3, :3] = np.eye(3) * 0.1**2 / std**2
    known = np.diag([0.0] * 3 + [1.0] * (UNKNOWNS - 3))
    shots = [
        JudgedShot(
            True,
            False,
            error_m=std * rng.standard_normal(3),
            covariance_m2=std**2 * np.eye(3),
            turn_error_rad=0.01,
            misses_px={"F": np.full((4, 2), 0.1)},
            information={"F": information},
            known=known,
        )
        for _ in range(seen)
    ]
    with_misses = shots + [JudgedShot(False, True) for _ in range(missed)]
    return CaseOutcome(case, list(shots), with_misses)


def outcomes(
    rng: np.random.Generator, missed: int = 0, error_m: float = 0.001
) -> dict[VisionCase, CaseOutcome]:
    return {case: outcome(case, error_m, 400, missed, rng) for case in (*single_cases(), *pad_cases())}


def test_bars_hold_when_they_do_and_fail_when_they_do_not() -> None:
    rng = np.random.default_rng(12)
    good = outcomes(rng)
    assert recall_tables(good)[1] == {"recall of markers": True, "recall of the pad": True}
    assert all(error_tables(good)[1].values())
    assert not any(recall_tables(outcomes(rng, missed=60))[1].values())
    far = error_tables(outcomes(rng, error_m=0.2))[1]
    assert not far["RMSE of markers"]
    assert not far["RMSE of the pad"]
    assert far["Cramér-Rao"]
    sure = outcomes(rng)
    for found in sure.values():
        for shot in found.exact:
            shot.covariance_m2 = 0.25 * shot.covariance_m2
            shot.information = {"F": 4.0 * shot.information["F"]}
    held = error_tables(sure)[1]
    assert not held["NEES"]
    assert not held["NEES with calibration"]
    assert not held["Cramér-Rao"]


def test_the_tables_cover_the_papers_cells_and_both_resolutions() -> None:
    assert {(case.side_cm, case.height_m) for case in single_cases()} == set(PAPER_RECALL)
    assert len(pad_cases()) == 2 * len(PAD_HEIGHTS_M)


def test_a_flip_fails_its_bar() -> None:
    case = VisionCase("640x480", 0.0, 1.0, tilted=True)
    found = CaseOutcome(case, calibrated=[JudgedShot(True, False, turn_error_rad=0.01) for _ in range(10)])
    assert flips_table({case: found})[1] == {"flips": True}
    found.calibrated[3].flipped = True
    assert flips_table({case: found})[1] == {"flips": False}


def test_speed_is_judged_by_the_medians_and_with_the_recall() -> None:
    times = [
        Times("640x480", 1.0, [1.0, 1.0, 9.0], [3.5, 3.5, 3.5], 3, 3),
        Times("1280x720", 1.0, [1.0, 1.0, 1.0], [4.9, 4.9, 9.0], 2, 3),
    ]
    assert speed_table(times)[1] == {
        "speed at 640x480": True,
        "recall at speed, 640x480": True,
        "speed at 1280x720": False,
        "recall at speed, 1280x720": False,
    }


def test_the_band_is_wider_for_fewer_shots_and_more_rows() -> None:
    low, high = nees_band(100, 1)
    assert low < 3.0 < high
    assert high - low == pytest.approx(2.0 * 1.96 * math.sqrt(6.0 / 100.0), rel=0.03)
    assert nees_band(100, 20)[1] > high
    assert nees_band(40, 1)[0] < low
