"""Each reason for a refusal, and what is refused without a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.magnetometer.calibrate import Calibrated, TrueField, UnfitError, calibrate
from calibration.magnetometer.ellipsoid import Ellipsoid, EllipsoidFit
from calibration.magnetometer.quality import AxisMisalignment, Dip, Figures, judge
from calibration.magnetometer.recording import MagnetometerRecording
from companion.base.geometry import FloatArray
from tests.unit.calibration.magnetometer.magnetometer_truth import FIELD_UT, turned

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
GOOD = Figures(samples=1000, kept=990, residual=0.02, residual_kept=0.01, coverage=0.95)


def vague(index: int, std: float) -> EllipsoidFit:
    covariance = GOOD_FIT.covariance.copy()
    covariance[index, index] = std**2
    return replace(GOOD_FIT, covariance=covariance)


def calibrated(raw: FloatArray, **options: object) -> Calibrated:
    recording = MagnetometerRecording("test", "mpu9250", raw)
    given = {"field": None, "aligned": False, "objective": None, "tool": "t", "date": "d", **options}
    return calibrate(recording, np.random.default_rng(0), **given)  # type: ignore[arg-type]


def test_a_good_one_is_good() -> None:
    assert judge(GOOD_FIT, GOOD) == ("good", ())


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


@pytest.mark.parametrize("changes", [{"coverage": 0.55}, {"residual_kept": 0.05}, {"strength_ratio": 1.4}])
def test_between_the_bounds_it_is_usable(changes: dict[str, float]) -> None:
    verdict, reasons = judge(GOOD_FIT, replace(GOOD, **changes))  # type: ignore[arg-type]
    assert verdict == "usable"
    assert len(reasons) == 1


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
