"""What an autopilot does to its compass's readings, by its own parameters, and the parameters it should have.

    ArduPilot   heard = M s (raw + offset)   COMPASS_OFS_X/Y/Z (mGauss), COMPASS_SCALE (s; 0: 1),
                                             M of COMPASS_DIA_X/Y/Z and COMPASS_ODI_X/Y/Z
                (AP_Compass_Backend::correct_field; the board's axes)
    PX4         heard = M (raw - offset)     CAL_MAG0_XOFF/YOFF/ZOFF (Gauss),
                                             M of CAL_MAG0_XSCALE... and CAL_MAG0_XODIAG...
                (calibration::Magnetometer::Correct; the compass's own axes, turned by CAL_MAG0_ROT after)

In both the off-diagonal three are the elements xy, xz and yz.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import FloatArray

UT_PER_MGAUSS: Final = 0.1
UT_PER_GAUSS: Final = 100.0
_AXES: Final = "XYZ"
_ELEMENTS: Final = ((0, 1), (0, 2), (1, 2))
# a rotation that leaves the axes as they are: none, or "internal: the board's"
_UNROTATED: Final = (-1.0, 0.0)

NAMES: Final[dict[AutopilotKind, tuple[str, ...]]] = {
    "ardupilot": (
        *(f"COMPASS_{kind}_{axis}" for kind in ("OFS", "DIA", "ODI") for axis in _AXES),
        "COMPASS_SCALE",
    ),
    "px4": (
        "CAL_MAG0_ROT",
        *(f"CAL_MAG0_{axis}{kind}" for kind in ("OFF", "SCALE", "ODIAG") for axis in _AXES),
    ),
}


@dataclass(frozen=True, slots=True)
class Onboard:
    """heard = matrix @ (raw + offset_ut), and the parameters that say so."""

    autopilot_kind: AutopilotKind
    matrix: FloatArray
    offset_ut: FloatArray
    parameters: dict[str, float]

    def undo(self, heard: FloatArray) -> FloatArray:
        """Raw readings (n, 3) of what is heard (n, 3), µT."""
        raw: FloatArray = heard @ np.linalg.inv(self.matrix).T - self.offset_ut
        return raw

    def on_top(self, matrix: FloatArray, centre: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What does to the heard readings as `matrix (raw - centre)` does to the raw ones."""
        return matrix @ np.linalg.inv(self.matrix), self.matrix @ (centre + self.offset_ut)


def onboard_of(autopilot_kind: AutopilotKind, parameters: Mapping[str, float]) -> Onboard | None:
    """By an autopilot's parameters; None when they do not say what it does."""
    used = {name: parameters[name] for name in NAMES[autopilot_kind] if name in parameters}
    if autopilot_kind == "ardupilot":
        offset, unit = [used.get(f"COMPASS_OFS_{axis}") for axis in _AXES], UT_PER_MGAUSS
        diagonal = [used.get(f"COMPASS_DIA_{axis}", 1.0) for axis in _AXES]
        if not any(diagonal):  # as ArduPilot has it: none
            diagonal = [1.0, 1.0, 1.0]
        rest = [used.get(f"COMPASS_ODI_{axis}", 0.0) for axis in _AXES]
        factor = used.get("COMPASS_SCALE", 0.0) or 1.0
    else:
        offset, unit = [used.get(f"CAL_MAG0_{axis}OFF") for axis in _AXES], -UT_PER_GAUSS
        diagonal = [used.get(f"CAL_MAG0_{axis}SCALE", 1.0) for axis in _AXES]
        rest, factor = [used.get(f"CAL_MAG0_{axis}ODIAG", 0.0) for axis in _AXES], 1.0
    known = [value for value in offset if value is not None]
    matrix = factor * _symmetric(diagonal, rest)
    turned = autopilot_kind == "px4" and used.get("CAL_MAG0_ROT", 0.0) not in _UNROTATED
    if len(known) < 3 or turned or np.linalg.det(matrix) <= 0.0:
        return None
    return Onboard(autopilot_kind, matrix, unit * np.array(known), used)


def parameters_for(
    autopilot_kind: AutopilotKind, matrix: FloatArray, centre_ut: FloatArray
) -> dict[str, float]:
    """The parameters that have the autopilot reckon `matrix (raw - centre)`: a symmetric matrix, µT."""
    rest = [float(matrix[i, j]) for i, j in _ELEMENTS]
    if autopilot_kind == "ardupilot":
        offsets, form = (-centre_ut / UT_PER_MGAUSS).tolist(), "COMPASS_{kind}_{axis}"
        kinds, more = {"OFS": offsets, "DIA": np.diag(matrix).tolist(), "ODI": rest}, {"COMPASS_SCALE": 1.0}
    else:
        offsets, form = (centre_ut / UT_PER_GAUSS).tolist(), "CAL_MAG0_{axis}{kind}"
        kinds, more = {"OFF": offsets, "SCALE": np.diag(matrix).tolist(), "ODIAG": rest}, {}
    named = {
        form.format(kind=kind, axis=axis): value
        for kind, values in kinds.items()
        for axis, value in zip(_AXES, values, strict=True)
    }
    return {**named, **more}


def _symmetric(diagonal: list[float], off_diagonal: list[float]) -> FloatArray:
    matrix = np.diag(np.array(diagonal, dtype=float))
    for (i, j), value in zip(_ELEMENTS, off_diagonal, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix
