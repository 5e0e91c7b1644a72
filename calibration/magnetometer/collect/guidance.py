"""While the vehicle is turned about: how much of the sphere is covered, what is missing, how to turn there.

Directions are the field's in body axes (FRD), raw fields in µT. A rotation of the vehicle about its own axes
is given as a person does it: roll, nose up or down, turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.magnetometer.ellipsoid.coverage import CELLS, BoolArray, covered_cells, lattice
from calibration.magnetometer.ellipsoid.ellipsoid import Ellipsoid, NoEllipsoidError, algebraic_fit
from companion.base.geometry import FloatArray

_MOST_SAMPLES: Final = 3000
_LEAST_SAMPLES: Final = 30
_HOLE_COSINE: Final = math.cos(math.radians(40.0))
_WORTH_TELLING_DEG: Final = 15.0
_WORST_RATIO: Final = 3.0
# a smaller ellipsoid is not the Earth's field turned about, but a sensor's noise where it is held still
_LEAST_FIELD_UT: Final = 15.0
_CENTRES: Final = lattice(CELLS)
_TURNS: Final = (("roll right", "roll left"), ("nose up", "nose down"), ("turn right", "turn left"))
_FACES: Final = (("nose", "tail"), ("right side", "left side"), ("belly", "top"))


@dataclass(frozen=True, slots=True)
class CoverageProgress:
    """How far it is: `covered` (CELLS,) by cell, the field's direction now (3,), and what to do next."""

    samples: int
    covered: BoolArray
    direction: FloatArray | None
    hint: str

    @property
    def share(self) -> float:
        """Of the sphere, 0 to 1."""
        return float(np.mean(self.covered))


def progress(raw: FloatArray, force: FloatArray | None, body_from_sensor: FloatArray) -> CoverageProgress:
    """Of raw fields (n, 3) and specific forces (n, 3) in the sensor's axes, the newest last."""
    if len(raw) < _LEAST_SAMPLES:
        return CoverageProgress(len(raw), np.zeros(CELLS, dtype=bool), None, "begin to turn it about")
    step = math.ceil(len(raw) / _MOST_SAMPLES)
    sphere = rough_ellipsoid(raw[::step]).apply(np.vstack([raw[::step], raw[-1:]]))
    length = np.linalg.norm(sphere, axis=1)
    # what lies far from the sphere is no direction that was held
    near = np.abs(length - 1.0) < 0.5
    near[-1] = True
    directions = (sphere / np.maximum(length, 1e-9)[:, None]) @ body_from_sensor.T
    covered = covered_cells(directions[near])
    now, down = directions[-1], None
    if force is not None and np.isfinite(force[-1]).all() and np.linalg.norm(force[-1]) > 0.0:
        down = -body_from_sensor @ force[-1] / np.linalg.norm(force[-1])
    return CoverageProgress(len(raw), covered, now, hint(covered, now, down))


def rough_ellipsoid(raw: FloatArray) -> Ellipsoid:
    """An ellipsoid for readings (n, 3) that may be too few for one: then the sphere that they lie in."""
    try:
        ellipsoid = algebraic_fit(raw)
        lengths = np.linalg.eigvalsh(ellipsoid.matrix)
        low, high = raw.min(axis=0), raw.max(axis=0)
        inside = bool(np.all((ellipsoid.centre > low) & (ellipsoid.centre < high)))
        large = 1.0 / lengths[2] >= _LEAST_FIELD_UT
        if inside and large and lengths[2] / lengths[0] < _WORST_RATIO:
            return ellipsoid
    except NoEllipsoidError:
        pass
    low, high = np.percentile(raw, [1.0, 99.0], axis=0)
    radius = max(0.5 * float(np.max(high - low)), _LEAST_FIELD_UT)
    return Ellipsoid(np.eye(3) / radius, 0.5 * (low + high))


def hint(covered: BoolArray, now: FloatArray, down: FloatArray | None) -> str:
    """How to turn the vehicle so that the field comes to where the largest hole is.

    Args:
        covered: mask (CELLS,).
        now: unit vector (3,), the field in body axes.
        down: unit vector (3,), down in body axes; None: not known.
    """
    missing = np.flatnonzero(~covered)
    if not missing.size:
        return "all covered"
    centres = _CENTRES[missing]
    holes = np.sum(centres @ centres.T > _HOLE_COSINE, axis=1) + 0.5 * (centres @ now)
    wanted = centres[int(np.argmax(holes))]
    turn = _turn(wanted, now)
    words = [
        f"{_TURNS[axis][0 if angle > 0.0 else 1]} {10 * round(abs(angle) / 10):.0f}°"
        for axis, angle in sorted(enumerate(np.degrees(turn).tolist()), key=lambda each: -abs(each[1]))
        if abs(angle) >= _WORTH_TELLING_DEG
    ]
    if not words:
        return "go on turning about here"
    return ", ".join(words) + ("" if down is None else f", until its {_lowest(turn, down)} is lowest")


def _turn(wanted: FloatArray, now: FloatArray) -> FloatArray:
    """The vehicle's rotation vector (3,), rad, body axes, that takes the field from `now` to `wanted`."""
    axis = np.cross(wanted, now)
    sine, cosine = float(np.linalg.norm(axis)), float(wanted @ now)
    if sine < 1e-6:
        # the other way about: any axis across will do
        axis = np.cross(now, np.eye(3)[int(np.argmin(np.abs(now)))])
    rotation: FloatArray = math.atan2(sine, cosine) * axis / max(float(np.linalg.norm(axis)), 1e-12)
    return rotation


def _lowest(turn: FloatArray, down: FloatArray) -> str:
    """Which face of the vehicle is lowest after the turn."""
    angle = float(np.linalg.norm(turn))
    axis = turn / max(angle, 1e-12)
    # Rodrigues' formula, backwards: the vehicle turns, down stays
    after = (
        down * math.cos(angle)
        - np.cross(axis, down) * math.sin(angle)
        + axis * float(axis @ down) * (1.0 - math.cos(angle))
    )
    face = int(np.argmax(np.abs(after)))
    return _FACES[face][0 if after[face] > 0.0 else 1]
