"""Is a calibration good enough to fly by? Figures in, a verdict and its reasons out.

Bounds are about what a heading needs: an error of 1 % of the field is about 1° of heading at a dip of 60°.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.magnetometer.ellipsoid import WHOLE, BoolArray, EllipsoidFit, correlation_samples
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
    clipped: tuple[int, ...] = ()


def flatness(raw: FloatArray) -> float:
    """Smallest extent of readings (n, 3) by their largest, 0 (in a plane) to 1."""
    extents = np.linalg.svd(raw - np.median(raw, axis=0), compute_uv=False)
    return float(extents[2] / extents[0]) if extents[0] > 0.0 else 0.0


def judge(fit: EllipsoidFit, figures: Figures) -> tuple[Verdict, tuple[str, ...]]:
    """The verdict, and the reasons why it is no better, the worst first."""
    found = [
        *_clipping(figures),
        *_coverage(figures),
        *_fit(fit, figures),
        *_field(figures),
        *_alignment(figures),
    ]
    refusals = tuple(text for refused, text in found if refused)
    if refusals:
        return "refused", refusals
    return ("usable" if found else "good"), tuple(text for _, text in found)


Finding = tuple[bool, str]


def _clipping(figures: Figures) -> Iterator[Finding]:
    for axis in figures.clipped:
        text = f"the {'xyz'[axis]} axis is clipped: it reads its extreme value again and again"
        yield True, f"{text}; expected readings within its range (a magnet nearby, or too small a range?)"


def _coverage(figures: Figures) -> Iterator[Finding]:
    if figures.samples < LEAST_SAMPLES:
        yield True, f"{figures.samples} samples; expected {LEAST_SAMPLES} or more"
    if not figures.coverage >= WHOLE:
        text = f"{figures.coverage:.0%} of the sphere is covered; expected {WHOLE:.0%}"
        yield not figures.coverage >= LEAST_COVERAGE, f"{text}; next: {figures.next_turn}"


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


def _field(figures: Figures) -> Iterator[Finding]:
    if (ratio := figures.strength_ratio) is not None:
        text = f"the sensor shows {ratio:.2f} times the field that there is"
        yield from _above(STRENGTH_RATIO, max(ratio, 1.0 / ratio), text + " ({:.2f})")
    if (dip := figures.dip) is None:
        # an ellipsoid is the same for swapped or mirrored axes: only a second sensor tells them apart
        text = "swapped or mirrored axes cannot be seen; expected an accelerometer's samples beside them"
        yield False, f"{text}, {LEAST_CALM} of them calm"
    else:
        yield from _above(DIP_SPREAD_DEG, dip.spread_deg, "the dip wavers by {:.1f}° over the attitudes")
        if figures.true_dip_deg is not None:
            text = f"the dip is {dip.median_deg:.1f}°, {{:.1f}}° off the {figures.true_dip_deg:.1f}° there is"
            yield from _above(DIP_ERROR_DEG, abs(dip.median_deg - figures.true_dip_deg), text)


def _alignment(figures: Figures) -> Iterator[Finding]:
    if (alignment := figures.alignment) is not None:
        yield from _above(ALIGNMENT_DEG, alignment.angle_deg, "the sensors' axes stand {:.1f}° apart")
        yield from _above(ALIGNMENT_STD_DEG, alignment.std_deg, "the alignment is known to {:.1f}° only")


def _above(bound: Bound, value: float, text: str) -> list[Finding]:
    """A finding, unless the value is within the bounds; a text without a format of its own gets per cents."""
    if value <= bound.usable:
        return []
    refused = not value <= bound.refused  # what is no number is within no bound
    limit = bound.refused if refused else bound.usable
    form = "{:.1%}" if "{}" in text else text[text.index("{") : text.index("}") + 1]
    return [(refused, f"{text.replace('{}', form).format(value)}; expected {form.format(limit)} or less")]


# ---------------------------------------------------------------- alignment
# What gravity says of a calibrated magnetometer: the field's dip, and how the two sensors' axes stand.
#
# The angle between the field and gravity is the same in all attitudes. An ellipsoid fit cannot see a rotation
# of the magnetometer's axes against the accelerometer's; the constant angle can (Vasconcelos et al. 2011).
# Specific force is +g upwards at rest, so that down is its opposite.

_CALM_SHARE: Final = 0.1  # of the median: what is accelerated by more does not show down
LEAST_CALM: Final = 50
_PRIOR_RAD: Final = math.radians(5.0)
_TRIM_SIGMA: Final = 3.0
_ROUNDS: Final = 6


@dataclass(frozen=True, slots=True)
class Dip:
    """The field's angle below the horizontal as measured: median and spread (robust, 1 σ), degrees."""

    median_deg: float
    spread_deg: float
    samples: int


@dataclass(frozen=True, slots=True)
class AxisMisalignment:
    """`rotation` (3, 3) turns magnetometer axes into the accelerometer's; its size and uncertainty."""

    rotation: FloatArray
    angle_deg: float
    std_deg: float


def calm(force: FloatArray) -> BoolArray:
    """Mask (n,) of the specific forces (n, 3) that are about as large as gravity (the median).

    None of them are if that is nought: an accelerometer that measures nothing shows no down.
    """
    size = np.linalg.norm(force, axis=1)
    middle = np.nanmedian(size)
    return np.asarray(np.abs(size - middle) < _CALM_SHARE * middle)


def dip_of(directions: FloatArray, force: FloatArray) -> Dip | None:
    """The dip by unit fields (n, 3) and specific forces (n, 3) beside them; None: too few are calm."""
    still = calm(force)
    if still.sum() < LEAST_CALM:
        return None
    angles = np.degrees(_dips(directions[still], force[still]))
    median = float(np.median(angles))
    return Dip(median, 1.4826 * float(np.median(np.abs(angles - median))), int(still.sum()))


def align(directions: FloatArray, force: FloatArray) -> AxisMisalignment | None:
    """The rotation that makes the dip constant over the calm samples; None: too few of them.

    Chips in one housing stand within degrees of one another: the fit knows that (`_PRIOR_RAD`), so that
    attitudes that say nothing of an axis leave it be. What is off by more than `_TRIM_SIGMA` was accelerated.
    """
    still = calm(force)
    if still.sum() < LEAST_CALM:
        return None
    fields, force = directions[still], force[still]
    x = np.array([0.0, 0.0, 0.0, float(np.median(_dips(fields, force)))])
    for _ in range(_ROUNDS):
        off = _off_dip(x, fields, force)
        sigma = max(1.4826 * float(np.median(np.abs(off))), 1e-4)
        near = np.abs(off) <= _TRIM_SIGMA * sigma
        weight = 1.0 / (sigma * math.sqrt(correlation_samples(off[near])))
        solved = least_squares(_weighted, x, args=(fields[near], force[near], weight), x_scale="jac")
        x = solved.x
    covariance = np.linalg.pinv(solved.jac.T @ solved.jac)
    return AxisMisalignment(
        rotation=Rotation.from_rotvec(x[:3]).as_matrix(),
        angle_deg=math.degrees(float(np.linalg.norm(x[:3]))),
        std_deg=math.degrees(math.sqrt(float(np.diag(covariance)[:3].max()))),
    )


def _weighted(x: FloatArray, fields: FloatArray, force: FloatArray, weight: float) -> FloatArray:
    return np.concatenate([weight * _off_dip(x, fields, force), x[:3] / _PRIOR_RAD])


def _off_dip(x: FloatArray, fields: FloatArray, force: FloatArray) -> FloatArray:
    """How far the dip (n,) of fields that are turned by x[:3] is off x[3], rad."""
    return np.asarray(_dips(Rotation.from_rotvec(x[:3]).apply(fields), force) - x[3])


def _dips(directions: FloatArray, force: FloatArray) -> FloatArray:
    """The angle (n,) of unit fields below the horizontal, rad."""
    sines = -np.sum(directions * force, axis=1) / np.linalg.norm(force, axis=1)
    return np.asarray(np.arcsin(np.clip(sines, -1.0, 1.0)))


# ---------------------------------------------------------------- missing turns
# Which turns a set of samples lacks, in the words of somebody who holds the vehicle. Pure.
#
# With one axis vertical and the vehicle turned once right round, the field comes near that axis: near its one
# end with the nose down (or the right side, or the belly), near its other end the other way up.

ON_A_LINE: Final = 0.05  # of the samples' second extent to their largest: no turn to speak of
_TURNS: Final = (
    "nose down, then nose up: roll it once right round in each",
    "right side down, then left side down: turn it once right round in each",
    "upright, then upside down: turn it once right round in each",
)


def beside_plane(raw: FloatArray, body_from_sensor: FloatArray) -> str:
    """What to do after raw readings (n, 3) that lie nearly in one plane, whatever their centre and scale.

    A turn about one axis alone keeps the field in a plane across it: the other two axes' turns are missing.
    """
    _, extents, axes = np.linalg.svd(raw - np.median(raw, axis=0), full_matrices=False)
    if extents[1] <= ON_A_LINE * extents[0]:
        return "; ".join(_TURNS)
    turned_about = int(np.argmax(np.abs(body_from_sensor @ axes[2])))
    return "; ".join(words for axis, words in enumerate(_TURNS) if axis != turned_about)


def suggest_next_rotation(directions: FloatArray, body_from_sensor: FloatArray) -> str:
    """What to do next after calibrated directions (n, 3): turns about the axis the field was least near."""
    return _TURNS[int(np.argmin(np.mean((directions @ body_from_sensor.T) ** 2, axis=0)))]
