"""What a magnetometer measured while it was turned about, wherever it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import FloatArray
from companion.base.messages import ImuSample, MagSample
from companion.config import ConfigError
from companion.config.magnetometer import AXES_OF, Axes, RawUnit, Sensor
from companion.flightlog.replay.flight_record import UT_PER, RecordingPlace

MOST_FIELD: Final = 1e9  # in whatever unit: beyond it stands what no sensor measured
# what drivers give in the place of a reading: least and most of 16 and 32 bits, the HMC5883L's overflow
NO_READING: Final = (-(2.0**31), 2.0**31 - 1.0, -(2.0**15), 2.0**15 - 1.0, -4096.0)
LEAST_SAMPLES: Final = 50  # fewer are no recording of a turn at all
_PAIRED_S: Final = 0.1  # an accelerometer's sample this near in time is the magnetometer's


@dataclass(slots=True)
class MagnetometerRecording:
    """Samples in the order in which they were taken.

    Attributes:
        source: file, device or connection.
        raw: (n, 3) in `unit`, in `axes`.
        force: (n, 3) specific force in the same axes (+g upwards at rest), in any unit; None: not measured.
        place: where and when, if the recording says so.
        body_from_sensor: (3, 3) how the sensor is mounted, from `axes` to FRD; not known: as if along it.
        onboard: what the autopilot does to its compass before anybody hears it; None: it is no autopilot's,
            or not known.
        notes: what a reader of the result should know.
    """

    source: str
    sensor: Sensor
    raw: FloatArray
    unit: RawUnit = "uT"
    force: FloatArray | None = None
    place: RecordingPlace | None = None
    body_from_sensor: FloatArray = field(default_factory=lambda: np.eye(3))
    onboard: Onboard | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def axes(self) -> Axes:
        """Which axes `raw` is in."""
        return AXES_OF[self.sensor]

    def checked(self) -> MagnetometerRecording:
        """Itself, without the samples that are no readings, which is noted.

        Raises:
            ConfigError: too few are left.
        """
        # a comparison with no number is false
        finite = (np.abs(self.raw) < MOST_FIELD).all(axis=1)
        read = finite & ~np.isin(self.raw, NO_READING).any(axis=1)
        if self.force is not None and not np.isfinite(self.force).all(axis=1).any():
            self.force = None
        passed_over = _passed_over(self.raw[~read])
        self.raw = self.raw[read]
        self.force = None if self.force is None else self.force[read]
        if len(self.raw) < LEAST_SAMPLES:
            more = f", {passed_over}" if passed_over else ""
            raise ConfigError(
                f"{self.source}: {len(self.raw)} magnetometer samples{more}; expected {LEAST_SAMPLES} or more"
            )
        if passed_over:
            self.notes.append(passed_over)
        return self


def _passed_over(raw: FloatArray) -> str:
    """How many samples (n, 3) are no readings, and what stands in them; nothing for none."""
    if len(raw) == 0:
        return ""
    odd = raw[~(np.abs(raw) < MOST_FIELD) | np.isin(raw, NO_READING)]
    example = "no number" if np.isnan(odd[0]) else f"{odd[0]:.10g}"
    return f"{len(raw)} samples passed over, in which a reading is {example}"


def paired(mags: list[MagSample], imus: list[ImuSample]) -> tuple[FloatArray, FloatArray | None]:
    """Fields (n, 3) and, beside each, the specific force (n, 3) nearest in time; NaN: none is near."""
    raw = np.array([mag.field_body_ut for mag in mags], dtype=float).reshape(-1, 3)
    if not imus or not mags:
        return raw, None
    times = np.array([imu.time_s for imu in imus])
    order = np.argsort(times, kind="stable")
    times, forces = times[order], np.array([imu.specific_force_body_m_s2 for imu in imus])[order]
    wanted = np.array([mag.time_s for mag in mags])
    nearest = np.searchsorted(0.5 * (times[1:] + times[:-1]), wanted)
    force = forces[nearest]
    force[np.abs(times[nearest] - wanted) > _PAIRED_S] = np.nan
    return raw, force


# ---------------------------------------------------------------- onboard
# What an autopilot does to its compass's readings, by its own parameters, and the parameters it should have.
#
#     ArduPilot   heard = M s (raw + offset)   COMPASS_OFS_X/Y/Z (mGauss), COMPASS_SCALE (s; 0: 1),
#                                              M of COMPASS_DIA_X/Y/Z and COMPASS_ODI_X/Y/Z
#                 (AP_Compass_Backend::correct_field; the board's axes)
#     PX4         heard = M (raw - offset)     CAL_MAG0_XOFF/YOFF/ZOFF (Gauss),
#                                              M of CAL_MAG0_XSCALE... and CAL_MAG0_XODIAG...
#                 (calibration::Magnetometer::Correct; the compass's own axes, turned by CAL_MAG0_ROT after)
#
# In both the off-diagonal three are the elements xy, xz and yz.

_AXES: Final = "XYZ"
_ELEMENTS: Final = ((0, 1), (0, 2), (1, 2))
# a rotation that leaves the axes as they are: none, or "internal: the board's"
_UNROTATED: Final = (-1.0, 0.0)

# by parts: the offset, the matrix's diagonal, and its rest
_PARTS: Final[dict[AutopilotKind, tuple[str, str, str]]] = {
    "ardupilot": ("COMPASS_OFS_{}", "COMPASS_DIA_{}", "COMPASS_ODI_{}"),
    "px4": ("CAL_MAG0_{}OFF", "CAL_MAG0_{}SCALE", "CAL_MAG0_{}ODIAG"),
}
_OTHERS: Final[dict[AutopilotKind, str]] = {"ardupilot": "COMPASS_SCALE", "px4": "CAL_MAG0_ROT"}
# µT in one of the offset, whose sign PX4 has the other way about
_OFFSET_UT: Final[dict[AutopilotKind, float]] = {"ardupilot": UT_PER["mG"], "px4": -UT_PER["G"]}
NAMES: Final[dict[AutopilotKind, tuple[str, ...]]] = {
    kind: (*(part.format(axis) for part in parts for axis in _AXES), _OTHERS[kind])
    for kind, parts in _PARTS.items()
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
        return heard @ np.linalg.inv(self.matrix).T - self.offset_ut

    def on_top(self, matrix: FloatArray, centre: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What does to the heard readings as `matrix (raw - centre)` does to the raw ones."""
        return matrix @ np.linalg.inv(self.matrix), self.matrix @ (centre + self.offset_ut)


def onboard_of(autopilot_kind: AutopilotKind, parameters: Mapping[str, float]) -> Onboard | None:
    """By an autopilot's parameters; None when they do not say what it does."""
    used = {name: parameters[name] for name in NAMES[autopilot_kind] if name in parameters}
    names = [[part.format(axis) for axis in _AXES] for part in _PARTS[autopilot_kind]]
    offset = [used.get(name) for name in names[0]]
    diagonal, rest = [used.get(name, 1.0) for name in names[1]], [used.get(name, 0.0) for name in names[2]]
    other, factor = used.get(_OTHERS[autopilot_kind], 0.0), 1.0
    if autopilot_kind == "ardupilot":
        factor = other or 1.0
        diagonal = diagonal if any(diagonal) else [1.0, 1.0, 1.0]  # as ArduPilot has it: none
    known = [value for value in offset if value is not None]
    matrix = factor * _symmetric(diagonal, rest)
    turned = autopilot_kind == "px4" and other not in _UNROTATED
    if len(known) < 3 or turned or np.linalg.det(matrix) <= 0.0:
        return None
    return Onboard(autopilot_kind, matrix, _OFFSET_UT[autopilot_kind] * np.array(known), used)


def parameters_for(
    autopilot_kind: AutopilotKind, matrix: FloatArray, centre_ut: FloatArray
) -> dict[str, float]:
    """The parameters that have the autopilot reckon `matrix (raw - centre)`: a symmetric matrix, µT."""
    offsets = (-centre_ut / _OFFSET_UT[autopilot_kind]).tolist()
    numbers = (offsets, np.diag(matrix).tolist(), [float(matrix[i, j]) for i, j in _ELEMENTS])
    named = {
        part.format(axis): value
        for part, values in zip(_PARTS[autopilot_kind], numbers, strict=True)
        for axis, value in zip(_AXES, values, strict=True)
    }
    return named | ({"COMPASS_SCALE": 1.0} if autopilot_kind == "ardupilot" else {})


def _symmetric(diagonal: list[float], off_diagonal: list[float]) -> FloatArray:
    matrix = np.diag(np.array(diagonal, dtype=float))
    for (i, j), value in zip(_ELEMENTS, off_diagonal, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix
