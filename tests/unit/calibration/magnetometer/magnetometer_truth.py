"""Made-up magnetometers with known errors, turned about in a known field."""

from dataclasses import dataclass

import numpy as np

from companion.base.geometry import FloatArray

FIELD_UT = 48.0
DIP_RAD = 1.1


@dataclass(frozen=True, slots=True)
class Turned:
    """Raw readings (n, 3), and what is wrong with the sensor: raw = inverse(matrix) true + centre."""

    raw: FloatArray
    matrix: FloatArray
    centre: FloatArray
    force: FloatArray


def turned(
    seed: int,
    samples: int = 1500,
    *,
    soft_iron: float = 0.3,
    noise: float = 0.02,
    half: bool = True,
    field: float = FIELD_UT,
    outliers: float = 0.0,
) -> Turned:
    """Soft iron of this size, hard iron up to a field, noise as a share of it, half a sphere or all.

    The force is gravity in the same axes, at the field's dip.
    """
    rng = np.random.default_rng(seed)
    directions = rng.standard_normal((samples, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    if half:
        pole = rng.standard_normal(3)
        directions *= np.where(directions @ pole < 0.0, -1.0, 1.0)[:, None]
    flaw = rng.uniform(-1.0, 1.0, (3, 3))
    flaw = 0.5 * (flaw + flaw.T)
    distortion = np.eye(3) + flaw * soft_iron / np.abs(np.linalg.eigvalsh(flaw)).max()
    centre = field * rng.uniform(-1.0, 1.0, 3)
    raw = field * directions @ distortion + centre + noise * field * rng.standard_normal((samples, 3))
    wild = rng.random(samples) < outliers
    raw[wild] += 1.5 * field * rng.standard_normal((int(wild.sum()), 3))
    return Turned(raw, np.linalg.inv(distortion), centre, _gravity(directions, rng))


def _gravity(directions: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Specific forces (n, 3) at rest, so that the field's dip is DIP_RAD."""
    across = np.cross(directions, rng.standard_normal(directions.shape))
    across /= np.linalg.norm(across, axis=1)[:, None]
    down: FloatArray = np.sin(DIP_RAD) * directions + np.cos(DIP_RAD) * across
    return -9.80665 * down
