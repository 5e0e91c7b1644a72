"""The ellipsoid fit on made-up truth: unbiased, honest about its uncertainty, not carried away."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from calibration.clipping import clipped_axes
from calibration.magnetometer.calibrate import Calibrated, TrueField, UnfitError, calibrate
from calibration.magnetometer.collect import drawn_map, hint, progress, text_map
from calibration.magnetometer.ellipsoid import (
    CELLS,
    BoolArray,
    Ellipsoid,
    EllipsoidFit,
    NoEllipsoidError,
    algebraic_fit,
    covered_cells,
    covered_share,
    distance,
    fit_ellipsoid,
    lattice,
    pack,
    unpack,
    whiteness_sigma,
)
from calibration.magnetometer.quality import (
    AxisMisalignment,
    Dip,
    Figures,
    align,
    beside_plane,
    dip_of,
    judge,
    suggest_next_rotation,
)
from calibration.magnetometer.recording import MagnetometerRecording
from companion.base.geometry import FloatArray, matrix_from_quat, quat_from_rotation_vector, vector3
from tests.unit.calibration.magnetometer.magnetometer_truth import DIP_RAD, FIELD_UT, Turned, turned

SEEDS = range(16)


def fitted(case: Turned) -> EllipsoidFit:
    return fit_ellipsoid(case.raw, np.random.default_rng(0))


def errors(case: Turned, fit: EllipsoidFit) -> FloatArray:
    """What `EllipsoidFit.covariance` is of (9,): matrix by its mean scale, and centre by the field."""
    scale = float(np.cbrt(np.linalg.det(case.matrix)))
    off = (fit.ellipsoid.matrix * FIELD_UT - case.matrix) / scale
    centre = (fit.ellipsoid.centre - case.centre) * scale / FIELD_UT
    return np.concatenate([off[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], centre])


def test_without_noise_the_truth_comes_out() -> None:
    case = turned(1, noise=0.0)
    fit = fitted(case)
    assert fit.ellipsoid.centre == pytest.approx(case.centre, abs=1e-6)
    assert fit.ellipsoid.matrix * FIELD_UT == pytest.approx(case.matrix, abs=1e-7)


def test_half_a_sphere_with_noise_is_fitted_without_bias_and_its_uncertainty_is_honest() -> None:
    all_errors, nees = [], []
    for seed in SEEDS:
        case = turned(seed, samples=3000)
        fit = fitted(case)
        error = errors(case, fit)
        all_errors.append(error)
        nees.append(error @ np.linalg.solve(fit.covariance, error) / 9.0)
    offsets = np.linalg.norm(np.array(all_errors)[:, 6:], axis=1)
    assert np.sqrt(np.mean(offsets**2)) < 0.01
    # chi-squared of 16 * 9: its mean is within 0.78 and 1.24 in 95 of 100
    assert 0.75 < np.mean(nees) < 1.3
    # plain least squares err by 7 % here
    plain = fit_ellipsoid(turned(0, samples=3000).raw, np.random.default_rng(0), "residual")
    assert np.linalg.norm(errors(turned(0, samples=3000), plain)[6:]) > 0.03


@pytest.mark.parametrize(("half", "share"), [(True, 0.1), (False, 0.3)])
def test_outliers_are_dropped(half: bool, share: float) -> None:
    for seed in range(5):
        case = turned(seed, samples=3000, half=half, outliers=share)
        fit = fitted(case)
        assert np.linalg.norm(errors(case, fit)[6:]) < (0.05 if half else 0.01)
        assert 0.8 * share < 1.0 - fit.kept.mean() < 1.05 * share + 0.02


@pytest.mark.parametrize("wild", [1e4, 1e9, 1e30])
def test_one_reading_however_wild_changes_nothing(wild: float) -> None:
    case = turned(3, samples=800)
    raw = case.raw.copy()
    raw[400] = (wild, -wild, 0.0)
    fit = fit_ellipsoid(raw, np.random.default_rng(0))
    assert not fit.kept[400]
    assert fit.ellipsoid.centre == pytest.approx(fitted(case).ellipsoid.centre, abs=0.1 * FIELD_UT / 100.0)


def test_the_unit_does_not_matter() -> None:
    case = turned(2)
    one, other = fitted(case), fit_ellipsoid(case.raw * 327.0, np.random.default_rng(0))
    assert other.ellipsoid.centre / 327.0 == pytest.approx(one.ellipsoid.centre, rel=1e-6)
    assert other.centre_std == pytest.approx(one.centre_std, rel=1e-4)


def test_correlated_residuals_of_a_whole_sphere_are_minimised_themselves_and_count_for_less() -> None:
    case = turned(3, samples=4000, half=False, noise=0.0)
    rng = np.random.default_rng(5)
    drift = np.convolve(rng.standard_normal(4200), np.ones(200) / np.sqrt(200.0), "valid")[:4000]
    raw = case.centre + (case.raw - case.centre) * (1.0 + 0.02 * drift[:, None])
    fit = fit_ellipsoid(raw, np.random.default_rng(0))
    assert fit.objective == "residual"
    assert fit.correlation_samples > 50.0
    likely = fit_ellipsoid(raw, np.random.default_rng(0), "likelihood")
    residual = [np.std(each.ellipsoid.deviation(raw)) for each in (fit, likely)]
    assert residual[0] <= residual[1]
    error = errors(case, fit)[6:]
    assert error @ np.linalg.solve(fit.covariance[6:, 6:], error) < 14.2  # chi-squared of 3, 99.7 %


def test_white_noise_is_found_white_and_drift_is_not() -> None:
    rng = np.random.default_rng(0)
    white = rng.standard_normal(5000)
    assert abs(whiteness_sigma(white)) < 3.5
    assert whiteness_sigma(np.cumsum(white)) > 50.0


def test_the_distance_is_to_the_nearest_point_and_its_derivatives_are_true() -> None:
    ellipsoid = Ellipsoid(
        np.array([[1.0, 0.2, 0.0], [0.2, 0.8, 0.1], [0.0, 0.1, 1.3]]), np.array([0.1, 0.2, 0.3])
    )
    rng = np.random.default_rng(0)
    sphere = rng.standard_normal((300_000, 3))
    sphere /= np.linalg.norm(sphere, axis=1)[:, None]
    surface = sphere @ np.linalg.inv(ellipsoid.matrix) + ellipsoid.centre
    raw = surface[:12] * 1.1 - 0.05
    x = pack(ellipsoid)
    found = distance(x, raw)
    nearest = np.min(np.linalg.norm(raw[:, None] - surface[None], axis=2), axis=1)
    assert np.abs(found.signed) == pytest.approx(nearest, abs=2e-3)
    jacobian = found.jacobian()
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        change = (distance(x + step, raw).signed - distance(x - step, raw).signed) / 2e-6
        assert jacobian[:, k] == pytest.approx(change, abs=1e-6)
    assert unpack(x).matrix == pytest.approx(ellipsoid.matrix)


@pytest.mark.parametrize(
    "raw",
    [
        np.zeros((100, 3)),
        np.random.default_rng(0).standard_normal((5, 3)),
        np.outer(np.arange(90.0), [1, 2, 3]),
    ],
)
def test_what_is_no_ellipsoid_is_said_to_be_none(raw: FloatArray) -> None:
    with pytest.raises(NoEllipsoidError):
        algebraic_fit(raw)


def test_the_dip_and_the_accelerometers_axes_are_found() -> None:
    case = turned(4, samples=3000, half=False, soft_iron=0.0)
    angle = np.radians(4.0)
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    directions = (case.raw - case.centre) / np.linalg.norm(case.raw - case.centre, axis=1)[:, None]
    dip = dip_of(directions, case.force)
    assert dip is not None
    assert dip.median_deg == pytest.approx(np.degrees(DIP_RAD), abs=0.2)
    found = align(directions @ rotation, case.force)
    assert found is not None
    assert found.rotation == pytest.approx(rotation, abs=5e-3)
    assert found.angle_deg == pytest.approx(4.0, abs=4.0 * found.std_deg + 0.02)
    assert align(directions[:10], case.force[:10]) is None


@pytest.mark.filterwarnings("error")
def test_an_accelerometer_that_measures_nothing_shows_no_down() -> None:
    case = turned(4, samples=300, half=False, soft_iron=0.0)
    directions = (case.raw - case.centre) / np.linalg.norm(case.raw - case.centre, axis=1)[:, None]
    for force in (np.zeros_like(case.force), case.force * (np.arange(300) < 100)[:, None]):
        assert dip_of(directions, force) is None
        assert align(directions, force) is None


# ---------------- Each reason for a refusal, and what is refused without a fit

GOOD_FIT = EllipsoidFit(
    ellipsoid=Ellipsoid(np.diag([1.0, 1.1, 0.9]), np.zeros(3)),
    objective="likelihood",
    covariance=1e-6 * np.eye(9),
    radius=48.0,
    kept=np.ones(1000, dtype=bool),
    noise=0.01,
    condition=4.0,
    correlation_samples=1.0,
)
GOOD = Figures(
    samples=1000, kept=990, residual=0.02, residual_kept=0.01, coverage=0.95, dip=Dip(64.0, 1.0, 500)
)


def vague(index: int, std: float) -> EllipsoidFit:
    covariance = GOOD_FIT.covariance.copy()
    covariance[index, index] = std**2
    return replace(GOOD_FIT, covariance=covariance)


def calibrated(raw: FloatArray, **options: object) -> Calibrated:
    recording = MagnetometerRecording("test", "mpu9250", raw)
    given = {"field": None, "aligned": False, "tool": "t", "date": "d", **options}
    return calibrate(recording, np.random.default_rng(0), **given)  # type: ignore[arg-type]


def test_a_good_one_is_good() -> None:
    assert judge(GOOD_FIT, GOOD) == ("good", ())


@pytest.mark.parametrize("swapped", [[1, 0, 2], [0, 2, 1]])
def test_swapped_axes_are_refused_beside_gravity_and_else_said_to_be_unseen(swapped: list[int]) -> None:
    """GIVEN two axes swapped, WHEN fitted, THEN gravity refuses it; without gravity it is not "good"."""
    case = turned(0, samples=3000, half=False)
    wrong = case.raw[:, swapped]
    beside = MagnetometerRecording("test", "mpu9250", wrong, force=case.force)
    told = {"field": None, "aligned": False, "tool": "t", "date": "d"}
    quality = calibrate(beside, np.random.default_rng(0), **told).file.quality  # type: ignore[arg-type]
    assert quality.verdict == "refused"
    alone = calibrated(wrong).file.quality
    assert alone.verdict == "usable"
    assert "swapped or mirrored axes cannot be seen; expected an accelerometer" in "; ".join(alone.reasons)


@pytest.mark.parametrize(
    ("fit", "changes", "reason"),
    [
        (GOOD_FIT, {"samples": 60, "kept": 60}, "60 samples; expected 100"),
        (GOOD_FIT, {"coverage": 0.2}, "20% of the sphere is covered"),
        (vague(7, 0.04), {}, "hard iron is known to 4.0% of the field only; expected 2.5% or less"),
        (vague(2, 0.07), {}, "soft iron is known to 7.0% only"),
        (GOOD_FIT, {"residual_kept": 0.2}, "residual is 20.0% of the field"),
        (GOOD_FIT, {"kept": 600}, "40.0% of the samples are outliers"),
        (
            replace(GOOD_FIT, ellipsoid=Ellipsoid(np.diag([6.0, 1.0, 1.0]), np.zeros(3))),
            {},
            "6.0 times as long as wide",
        ),
        (GOOD_FIT, {"strength_ratio": 2.5}, "2.50 times the field that there is"),
        (GOOD_FIT, {"strength_ratio": 0.4}, "0.40 times the field that there is"),
        (GOOD_FIT, {"dip": Dip(60.0, 25.0, 500)}, "the dip wavers by 25.0°"),
        (GOOD_FIT, {"dip": Dip(40.0, 1.0, 500), "true_dip_deg": 64.0}, "24.0° off the 64.0° there is"),
        (GOOD_FIT, {"alignment": AxisMisalignment(np.eye(3), 50.0, 0.1)}, "axes stand 50.0° apart"),
        (GOOD_FIT, {"alignment": AxisMisalignment(np.eye(3), 1.0, 3.0)}, "alignment is known to 3.0° only"),
    ],
)
def test_each_reason_for_a_refusal(fit: EllipsoidFit, changes: dict[str, object], reason: str) -> None:
    verdict, reasons = judge(fit, replace(GOOD, **changes))  # type: ignore[arg-type]
    assert verdict == "refused"
    assert [text for text in reasons if reason in text] == list(reasons[:1])


@pytest.mark.parametrize(
    ("fit", "changes"),
    [
        (vague(7, math.nan), {}),
        (vague(2, math.nan), {}),
        (replace(GOOD_FIT, ellipsoid=Ellipsoid(np.diag([0.0, 0.0, 0.0]), np.zeros(3))), {}),
        (GOOD_FIT, {"coverage": math.nan}),
        (GOOD_FIT, {"residual_kept": math.nan}),
        (GOOD_FIT, {"strength_ratio": math.nan}),
        (GOOD_FIT, {"dip": Dip(60.0, math.nan, 500)}),
        (GOOD_FIT, {"dip": Dip(math.nan, 1.0, 500), "true_dip_deg": 64.0}),
        (GOOD_FIT, {"alignment": AxisMisalignment(np.eye(3), math.nan, 0.1)}),
        (GOOD_FIT, {"alignment": AxisMisalignment(np.eye(3), 1.0, math.nan)}),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_figure_that_is_no_number_is_proven_by_nothing(
    fit: EllipsoidFit, changes: dict[str, object]
) -> None:
    verdict, reasons = judge(fit, replace(GOOD, **changes))  # type: ignore[arg-type]
    assert verdict == "refused"
    assert len(reasons) == 1


@pytest.mark.parametrize("changes", [{"coverage": 0.55}, {"residual_kept": 0.05}, {"strength_ratio": 1.4}])
def test_between_the_bounds_it_is_usable(changes: dict[str, float]) -> None:
    verdict, reasons = judge(GOOD_FIT, replace(GOOD, **changes))  # type: ignore[arg-type]
    assert verdict == "usable"
    assert len(reasons) == 1


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_clipped_axis_is_named(axis: int) -> None:
    raw = turned(1, half=False).raw
    raw[:, axis] = np.minimum(raw[:, axis], np.quantile(raw[:, axis], 0.9))
    quality = calibrated(raw).file.quality
    assert quality.verdict == "refused"
    assert quality.reasons[0].startswith(f"the {'xyz'[axis]} axis is clipped: ")


def test_coarse_steps_are_not_taken_for_a_clipped_axis() -> None:
    for seed in range(20):
        raw = np.round(turned(seed, half=False, noise=0.002).raw / 0.6) * 0.6
        assert clipped_axes(raw, raw) == ()


def test_a_turn_about_one_axis_alone_is_refused() -> None:
    angle = np.linspace(0.0, 12.0, 800)
    rng = np.random.default_rng(0)
    cone = np.stack([20.0 * np.cos(angle), 20.0 * np.sin(angle), np.full(800, 40.0)], axis=1)
    with pytest.raises(UnfitError, match="one plane or on a narrow band"):
        calibrated(cone + 0.5 * rng.standard_normal((800, 3)))
    with pytest.raises(UnfitError, match="all readings are the same"):
        calibrated(np.ones((800, 3)))


def test_a_cap_is_refused_for_what_it_cannot_know() -> None:
    case = turned(1, samples=3000, half=False, soft_iron=0.0)
    direction = (case.raw - case.centre) / FIELD_UT
    cap = case.raw[direction[:, 0] > 0.6]
    assert calibrated(cap).file.quality.verdict == "refused"


def test_the_half_sphere_of_the_bar_is_not_refused() -> None:
    quality = calibrated(turned(0, samples=1500).raw).file.quality
    assert quality.verdict == "usable"
    assert "of the sphere is covered" in quality.reasons[0]


def test_the_scale_is_the_fields_or_as_measured() -> None:
    case = turned(2, samples=3000, half=False)
    scaled = calibrated(case.raw, field=TrueField((20.0, 0.0, 44.0), "test"))
    strength = float(np.hypot(20.0, 44.0))
    size = np.linalg.norm(scaled.file.apply(case.raw), axis=1)
    assert size.mean() == pytest.approx(strength, rel=2e-3)
    as_measured = calibrated(case.raw)
    assert np.linalg.det(as_measured.file.matrix) == pytest.approx(1.0)
    assert as_measured.file.field_source == "as measured"


def test_an_alignment_needs_an_accelerometer() -> None:
    with pytest.raises(UnfitError, match="needs an accelerometer"):
        calibrated(turned(0).raw, aligned=True)


# ----------------
# Which turns a recording lacks: named by the vehicle's faces, and carried out they make the calibration.

FIELD_NED_UT = np.array([21.0, 0.0, 43.0])
HARD_IRON_UT = np.array([12.0, -30.0, 8.0])
FACES = {
    "nose down": (1.0, 0.0, 0.0),
    "nose up": (-1.0, 0.0, 0.0),
    "right side down": (0.0, 1.0, 0.0),
    "left side down": (0.0, -1.0, 0.0),
    "upright": (0.0, 0.0, 1.0),
    "upside down": (0.0, 0.0, -1.0),
}
SIDEWAYS = matrix_from_quat(quat_from_rotation_vector(vector3([2.0, -1.0, 0.5])))


def held(face: str, rng: np.random.Generator) -> FloatArray:
    """The field (n, 3) in body axes, of a vehicle that a hand turns once right round with a face down."""
    down = np.array(FACES[face]) + 0.06 * rng.standard_normal((300, 3))
    down /= np.linalg.norm(down, axis=1)[:, None]
    north = np.cross(down, np.roll(FACES[face], 1))
    north /= np.linalg.norm(north, axis=1)[:, None]
    east = np.cross(down, north)
    angle = np.linspace(0.0, 2.0 * np.pi, 300)[:, None]
    across = np.cos(angle) * north + np.sin(angle) * east
    field: FloatArray = FIELD_NED_UT[0] * across + FIELD_NED_UT[2] * down
    return field


def faces(words: str) -> list[str]:
    """What the words have a person do, in their order."""
    found = re.findall("|".join(FACES), words)
    assert words.count("once right round") == len(found) / 2
    return found


def recording(
    field: FloatArray, body_from_sensor: FloatArray, rng: np.random.Generator
) -> MagnetometerRecording:
    raw = field @ body_from_sensor + HARD_IRON_UT + 0.3 * rng.standard_normal(field.shape)
    return MagnetometerRecording("test", "mpu9250", raw, body_from_sensor=body_from_sensor)


def refusal(made: MagnetometerRecording, rng: np.random.Generator) -> str:
    """Why no good calibration comes of it; empty where one does."""
    try:
        done = calibrate(made, rng, field=None, aligned=False, tool="test", date="")
    except UnfitError as error:
        return str(error)
    quality = done.file.quality
    return "; ".join(quality.reasons) if quality.verdict == "refused" else ""


@pytest.mark.parametrize("mounting", [np.eye(3), SIDEWAYS], ids=["square", "sideways"])
@pytest.mark.parametrize("face", ["nose down", "right side down", "upright"])
def test_after_a_turn_about_one_axis_the_other_two_are_named_and_enough(
    face: str, mounting: FloatArray
) -> None:
    rng = np.random.default_rng(3)
    field = held(face, rng)
    words = refusal(recording(field, mounting, rng), rng)
    assert "one plane or on a narrow band; next: " in words
    turns = faces(words)
    assert len(turns) == 4
    assert face not in turns
    for turn in turns:
        field = np.vstack((field, held(turn, rng)))
    assert refusal(recording(field, mounting, rng), rng) == ""


def test_a_vehicle_that_was_not_turned_is_to_be_turned_about_all_axes() -> None:
    line = np.outer(np.linspace(-1.0, 1.0, 100), (1.0, 2.0, 3.0))
    assert faces(beside_plane(line, np.eye(3))) == list(FACES)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("mounting", [np.eye(3), SIDEWAYS], ids=["square", "sideways"])
def test_the_axis_that_the_field_was_never_near_is_turned_about_next(axis: int, mounting: FloatArray) -> None:
    directions = np.random.default_rng(5).standard_normal((2000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    seen = directions[np.abs(directions[:, axis]) < 0.6]
    assert faces(suggest_next_rotation(seen @ mounting, mounting)) == list(FACES)[2 * axis : 2 * axis + 2]


# ----------------
# What a person is told while the vehicle is turned about: carried out, it leads to what is missing.

CENTRES = lattice(CELLS)


def all_but(direction: FloatArray, cosine: float = 0.8) -> BoolArray:
    """A mask with a hole about a direction."""
    return np.asarray(CENTRES @ direction < cosine)


def carried_out(words: str, now: FloatArray) -> FloatArray:
    """Where the field points after the vehicle has been turned as it was told."""
    axes = {"roll": 0, "nose": 1, "turn": 2}
    turn = np.zeros(3)
    for kind, side, degrees in re.findall(r"(roll|nose|turn) (\w+) (\d+)°", words):
        turn[axes[kind]] = np.radians(float(degrees)) * (1.0 if side in ("right", "up") else -1.0)
    return matrix_from_quat(quat_from_rotation_vector(vector3(turn.tolist()))).T @ now


@pytest.mark.parametrize("missing", [(1.0, 0, 0), (0, -1.0, 0), (0, 0, -1.0), (0.6, 0.0, 0.8)])
@pytest.mark.parametrize("now", [(0.0, 0.8, 0.6), (0.0, 0.0, 1.0), (-0.9, 0.1, 0.4)])
def test_the_hint_leads_to_the_hole(missing: tuple[float, ...], now: tuple[float, ...]) -> None:
    direction, wanted = np.array(now) / np.linalg.norm(now), np.array(missing)
    words = hint(all_but(wanted), direction, None)
    # components under 15 degrees are not told, and the hole has a size
    assert carried_out(words, direction) @ wanted > np.cos(np.radians(40.0))


def test_level_and_facing_north_the_words_are_a_pilots() -> None:
    dip = np.array([0.5, 0.0, 0.866])
    down = np.array([0.0, 0.0, 1.0])
    # the field is to come to the nose: it points down at 60 degrees, so the nose must go down by as much
    words = hint(all_but(np.array([1.0, 0.0, 0.0]), 0.95), dip, down)
    assert re.fullmatch(r"nose down \d0°(, \w+ \w+ 20°)*, until its (nose|belly) is lowest", words)
    assert hint(np.ones(CELLS, dtype=bool), dip, down) == "all covered"


def test_progress_grows_to_the_whole_and_shows_no_more_than_there_is() -> None:
    case = turned(1, samples=3000, half=False)
    few = progress(case.raw[:10], None, np.eye(3))
    assert few.share == 0.0
    assert few.hint == "begin to turn it about"
    whole = progress(case.raw, case.force, np.eye(3))
    assert whole.share == 1.0
    half = progress(turned(1, samples=3000).raw, None, np.eye(3))
    assert 0.4 < half.share < 0.75


@pytest.mark.parametrize("noise_ut", [0.3, 0.6, 2.0])
def test_a_sensor_that_is_held_still_covers_nothing(noise_ut: float) -> None:
    """Its noise is a ball with points on all sides, which is no sphere that it was turned about on."""
    still = np.random.default_rng(0).normal((20.0, -5.0, 40.0), noise_ut, (1000, 3))
    assert progress(still, None, np.eye(3)).share < 0.1
    on_a_grid = 0.15 * np.round(still / 0.15)
    assert progress(on_a_grid, None, np.eye(3)).share < 0.1


def test_a_few_still_samples_cover_next_to_nothing() -> None:
    still = np.random.default_rng(0).normal((20.0, -5.0, 40.0), 0.5, (400, 3))
    moved = still + np.linspace(0.0, 10.0, 400)[:, None] * (1.0, 0.0, 0.0)
    assert progress(moved, None, np.eye(3)).share < 0.5


def test_a_full_lattice_covers_everything_and_one_direction_one_cell() -> None:
    assert covered_share(CENTRES) == 1.0
    assert covered_cells(np.array([[0.0, 0.0, 1.0]])).sum() == 1
    assert covered_share(np.zeros((0, 3))) == 0.0
    assert np.linalg.norm(lattice(50), axis=1) == pytest.approx(np.ones(50))


def test_the_map_shows_the_hole_where_it_is() -> None:
    now = progress(turned(1, samples=3000, half=False).raw, None, np.eye(3))
    assert not any("." in line for line in text_map(now.covered)[1:])
    lines = text_map(all_but(np.array([0.0, 0.0, 1.0])))
    left, right = zip(*((line[:22], line[25:]) for line in lines[1:]), strict=True)
    assert "." in left[5][8:14]  # the belly's disc has it in the middle
    assert not any("." in line for line in right)
    image = drawn_map(now)
    assert image.shape == (430, 720, 3)
    assert image.max() > 200
