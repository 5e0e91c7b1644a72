"""The ellipsoid fit on made-up truth: unbiased, honest about its uncertainty, not carried away."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.magnetometer.ellipsoid import (
    Ellipsoid,
    EllipsoidFit,
    NoEllipsoidError,
    algebraic_fit,
    distance,
    fit_ellipsoid,
    pack,
    unpack,
    whiteness_sigma,
)
from calibration.magnetometer.quality import align, dip_of
from companion.base.geometry import FloatArray
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
