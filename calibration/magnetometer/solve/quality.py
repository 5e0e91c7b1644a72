"""Is a calibration good enough to fly by? Figures in, a verdict and its reasons out.

Bounds are about what a heading needs: an error of 1 % of the field is about 1° of heading at a dip of 60°.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.magnetometer.ellipsoid.coverage import WHOLE
from calibration.magnetometer.ellipsoid.fit import EllipsoidFit
from calibration.magnetometer.solve.alignment import AxisMisalignment, Dip
from companion.base.geometry import FloatArray
from companion.config.magnetometer import Verdict


@dataclass(frozen=True, slots=True)
class Bound:
    """A figure above `usable` makes a calibration less than good, above `refused` too bad."""

    usable: float
    refused: float


HARD_IRON_STD: Final = Bound(0.01, 0.025)  # share of the field, the worst axis
SOFT_IRON_STD: Final = Bound(0.015, 0.05)
RESIDUAL: Final = Bound(0.03, 0.10)
OUTLIERS: Final = Bound(0.05, 0.30)  # share of the samples
AXIS_RATIO: Final = Bound(2.0, 5.0)  # of the ellipsoid's longest to its shortest
STRENGTH_RATIO: Final = Bound(1.25, 2.0)  # measured to true, or the other way about
DIP_ERROR_DEG: Final = Bound(5.0, 15.0)
DIP_SPREAD_DEG: Final = Bound(6.0, 20.0)
ALIGNMENT_DEG: Final = Bound(10.0, 45.0)
ALIGNMENT_STD_DEG: Final = Bound(0.5, 2.0)
LEAST_COVERAGE: Final = 0.30
LEAST_SAMPLES: Final = 100
FLATTEST: Final = 0.12  # of the samples' smallest extent to their largest


@dataclass(frozen=True, slots=True)
class Figures:
    """What a calibration is judged by; shares are of the field."""

    samples: int
    kept: int
    residual: float
    residual_kept: float
    coverage: float
    next_turn: str = "turn it further"
    strength_ratio: float | None = None  # as measured to what it should be
    dip: Dip | None = None
    true_dip_deg: float | None = None
    alignment: AxisMisalignment | None = None


def flatness(raw: FloatArray) -> float:
    """Smallest extent of readings (n, 3) by their largest, 0 (in a plane) to 1."""
    extents = np.linalg.svd(raw - np.median(raw, axis=0), compute_uv=False)
    return float(extents[2] / extents[0]) if extents[0] > 0.0 else 0.0


def judge(fit: EllipsoidFit, figures: Figures) -> tuple[Verdict, tuple[str, ...]]:
    """The verdict, and the reasons why it is no better, the worst first."""
    found = [*_coverage(figures), *_fit(fit, figures), *_field(figures), *_alignment(figures)]
    refusals = tuple(text for refused, text in found if refused)
    if refusals:
        return "refused", refusals
    return ("usable" if found else "good"), tuple(text for _, text in found)


Finding = tuple[bool, str]


def _coverage(figures: Figures) -> list[Finding]:
    found: list[Finding] = []
    if figures.samples < LEAST_SAMPLES:
        found.append((True, f"{figures.samples} samples; expected {LEAST_SAMPLES} or more"))
    if figures.coverage < WHOLE:
        text = f"{figures.coverage:.0%} of the sphere is covered; expected {WHOLE:.0%}"
        found.append((figures.coverage < LEAST_COVERAGE, f"{text}; next: {figures.next_turn}"))
    return found


def _fit(fit: EllipsoidFit, figures: Figures) -> list[Finding]:
    lengths = np.linalg.eigvalsh(fit.ellipsoid.matrix)
    dropped = 1.0 - figures.kept / figures.samples
    return [
        *_above(HARD_IRON_STD, float(fit.centre_std.max()), "the hard iron is known to {} of the field only"),
        *_above(SOFT_IRON_STD, fit.matrix_std, "the soft iron is known to {} only"),
        *_above(RESIDUAL, figures.residual_kept, "the residual is {} of the field: a disturbance nearby"),
        *_above(OUTLIERS, dropped, "{} of the samples are outliers"),
        *_above(AXIS_RATIO, float(lengths[2] / lengths[0]), "the ellipsoid is {:.1f} times as long as wide"),
    ]


def _field(figures: Figures) -> list[Finding]:
    found: list[Finding] = []
    if (ratio := figures.strength_ratio) is not None:
        text = f"the sensor shows {ratio:.2f} times the field that there is"
        found += _above(STRENGTH_RATIO, max(ratio, 1.0 / ratio), text + " ({:.2f})")
    if (dip := figures.dip) is not None:
        found += _above(DIP_SPREAD_DEG, dip.spread_deg, "the dip wavers by {:.1f}° over the attitudes")
        if figures.true_dip_deg is not None:
            text = f"the dip is {dip.median_deg:.1f}°, {{:.1f}}° off the {figures.true_dip_deg:.1f}° there is"
            found += _above(DIP_ERROR_DEG, abs(dip.median_deg - figures.true_dip_deg), text)
    return found


def _alignment(figures: Figures) -> list[Finding]:
    if (alignment := figures.alignment) is None:
        return []
    return [
        *_above(ALIGNMENT_DEG, alignment.angle_deg, "the sensors' axes stand {:.1f}° apart"),
        *_above(ALIGNMENT_STD_DEG, alignment.std_deg, "the alignment is known to {:.1f}° only"),
    ]


def _above(bound: Bound, value: float, text: str) -> list[Finding]:
    """A finding, if the value is above a bound; a text without a format of its own gets per cents."""
    if value <= bound.usable:
        return []
    refused = value > bound.refused
    limit = bound.refused if refused else bound.usable
    form = "{:.1%}" if "{}" in text else text[text.index("{") : text.index("}") + 1]
    return [(refused, f"{text.replace('{}', form).format(value)}; expected {form.format(limit)} or less")]
