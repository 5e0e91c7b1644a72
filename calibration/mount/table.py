"""Inertial samples from a table: CSV of many dialects, or .npz, in the sensor's own axes.

Columns are found by their names (ax, acc_x, "Accel X (g)", gyr_y, ...), or given in order. A time may be
missing when a rate is given. The accelerometer's unit shows in what it measures at rest: g, mg or m/s²; a
time's that the header leaves open by its steps: s, ms, µs or ns.
"""

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np

from calibration.mount.recording import ImuSamples
from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.config import ConfigError

NAMES: Final = ("t", "ax", "ay", "az", "gx", "gy", "gz")
# of a time column, by what its name ends in
TIME_UNITS: Final = {"us": 1e-6, "ms": 1e-3, "ns": 1e-9}
USUAL_STEP_S: Final = (2e-4, 0.2)
ACCEL_UNITS: Final = {"g": GRAVITY_M_S2, "mg": 1e-3 * GRAVITY_M_S2, "m/s2": 1.0}
DEGREES: Final = re.compile(r"deg|dps|°")


def read_table(path: Path, columns: str | None, rate_hz: float | None, gyro_unit: str | None) -> ImuSamples:
    """Read a CSV or .npz.

    Args:
        columns: names of the columns in order, out of `NAMES`, "-" for one to pass over.
        rate_hz: for a table without a time.
        gyro_unit: "rad/s" or "deg/s"; by the header where it says so, else rad/s.

    Raises:
        ConfigError: unreadable, or what is needed is not in it.
    """
    try:
        found = _npz(path) if path.suffix == ".npz" else _csv(path, columns)
    # what numpy raises of a file that is no archive, a cut one, and one of other things than numbers
    except (OSError, EOFError, BadZipFile, ValueError, TypeError) as error:
        raise ConfigError(
            f"{path}: cannot be read: {error}; expected a table of {', '.join(NAMES)}"
        ) from error
    missing = [name for name in NAMES[1:] if name not in found]
    if missing:
        raise ConfigError(
            f"{path}: no column for {', '.join(missing)}; expected names like ax or gyro_x, or --columns"
        )
    if "t" not in found:
        if rate_hz is None:
            raise ConfigError(f"{path}: no column of times; expected one named t or time, or --rate")
        found["t"] = np.arange(len(found["ax"])) / rate_hz
    return _inertial(path, found, gyro_unit)


def _inertial(path: Path, found: dict[str, FloatArray], gyro_unit: str | None) -> ImuSamples:
    lengths = {name: len(found[name]) for name in NAMES}
    if len(set(lengths.values())) > 1:
        lengths_text = ", ".join(f"{name} {count}" for name, count in lengths.items())
        raise ConfigError(f"{path}: columns of different lengths ({lengths_text}); expected equal ones")
    rows = np.column_stack([found[name] for name in NAMES])
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows[np.concatenate(([True], np.diff(rows[:, 0]) > 0.0))] if len(rows) else rows
    if len(rows) < 100:
        raise ConfigError(f"{path}: {len(rows)} usable rows; expected those of some seconds at least")
    rows[:, 0] *= _time_unit(float(np.median(np.diff(rows[:, 0]))))
    felt = float(np.median(np.linalg.norm(rows[:, 1:4], axis=1)))
    unit = min(ACCEL_UNITS, key=lambda name: abs(np.log(felt * ACCEL_UNITS[name] / GRAVITY_M_S2)))
    if abs(np.log(felt * ACCEL_UNITS[unit] / GRAVITY_M_S2)) > 0.4:
        raise ConfigError(
            f"{path}: the accelerometer feels {felt:.3g} at rest; expected 1 (g), 1000 (mg) or 9.8 (m/s²)"
        )
    degrees = gyro_unit == "deg/s" if gyro_unit is not None else "degrees" in found
    rate = np.radians(rows[:, 4:7]) if degrees else rows[:, 4:7]
    warmth = np.full(len(rows), np.nan)
    return ImuSamples(rows[:, 0], rate, rows[:, 1:4] * ACCEL_UNITS[unit], warmth)


def _time_unit(step: float) -> float:
    """Seconds in the unit of a time with such steps; 1 where none makes a usual one of it."""
    low, high = USUAL_STEP_S
    return next((unit for unit in (1.0, 1e-3, 1e-6, 1e-9) if low <= step * unit <= high), 1.0)


def _npz(path: Path) -> dict[str, FloatArray]:
    with np.load(path) as archive:
        arrays = {name.lower(): np.asarray(archive[name], dtype=float) for name in archive.files}
    found = {canonical(name): a for name, a in arrays.items() if a.ndim == 1 and canonical(name) in NAMES}
    for letter, stem in (("a", "acc"), ("g", "gyr")):
        wide = (a for name, a in arrays.items() if name.startswith(stem) and a.ndim == 2)
        whole = next((a if a.shape[1] == 3 else a.T for a in wide if 3 in a.shape), None)
        if whole is not None:
            found |= {f"{letter}{axis}": whole[:, k] for k, axis in enumerate("xyz")}
    rate_hz = arrays.get("fs", np.zeros(1)).ravel()
    if "t" not in found and "ax" in found and rate_hz.size == 1 and rate_hz[0] > 0.0:
        found["t"] = np.arange(len(found["ax"])) / rate_hz[0]
    return found


def _csv(path: Path, columns: str | None) -> dict[str, FloatArray]:
    lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    first = next((k for k, line in enumerate(lines) if _numbers(_split(line)) >= 6), None)
    if first is None:
        raise ValueError("no row of six numbers")
    header = _split(lines[first - 1]) if first else []
    names = [word.strip() for word in columns.split(",")] if columns else [canonical(word) for word in header]
    wide = len(_split(lines[first]))
    cells = [_split(line) for line in lines[first:]]
    values = np.array([[_number(cell) for cell in row] for row in cells if len(row) == wide])
    found = {name: values[:, k] for k, name in enumerate(names[:wide]) if name in NAMES}
    if "t" in found and not columns:
        word = next(word for word in header if canonical(word) == "t").lower().strip(" )]")
        found["t"] = found["t"] * next((u for end, u in TIME_UNITS.items() if word.endswith(end)), 1.0)
    if any(canonical(word).startswith("g") and DEGREES.search(word.lower()) for word in header):
        found["degrees"] = np.ones(1)
    return found


def _split(line: str) -> list[str]:
    for mark in (";", "\t", ","):
        if mark in line:
            return next(csv.reader([line], delimiter=mark))
    return line.split()


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _numbers(cells: Sequence[str]) -> int:
    return int(np.isfinite([_number(cell) for cell in cells]).sum())


def canonical(word: str) -> str:
    """The column's name out of `NAMES`, or "-"."""
    plain = re.sub(r"\(.*?\)|\[.*?\]", "", word.lower())
    plain = re.sub(r"[^a-z]", " ", plain).strip()
    if re.match(r"(t|time|timestamp|seconds?)\b", plain):
        return "t"
    axis = re.search(r"\b([xyz])\b|^(?:acc\w*|a|gyro?\w*|g)([xyz])\b", plain)
    kind = re.match(
        r"a(cc\w*)?(?=[xyz ]|$)|g(yr\w*)?(?=[xyz ]|$)|a[xyz]\b|g[xyz]\b|omega|rate|acc|gyr", plain
    )
    if axis is None or kind is None:
        return "-"
    return ("a" if plain.startswith("a") else "g") + (axis[1] or axis[2])
