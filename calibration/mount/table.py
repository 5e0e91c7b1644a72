"""Inertial samples from a table: CSV of many dialects, or .npz, in the sensor's own axes.

Columns are found by their names (ax, acc_x, "Accel X (g)", gyr_y, ...), or given in order. A time may be
missing when a rate is given. The accelerometer's unit shows in what it measures at rest: g, mg or m/s²; a
time's that the header leaves open by its steps: s, ms, µs or ns.
"""

import re
from pathlib import Path
from typing import Final

import numpy as np

from calibration.mount.recording import ImuSamples, usable
from calibration.tables import read_arrays, read_text, vectors
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
    found = _npz(path) if path.suffix == ".npz" else _csv(path, columns)
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
    rows = usable(np.column_stack([found[name] for name in NAMES]))
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
    arrays = read_arrays(path)
    found = {canonical(name): array for name, array in arrays.items() if np.ndim(array) == 1}
    for letter, stem in (("a", "acc"), ("g", "gyr")):
        whole = vectors(arrays | found, [name for name in arrays if name.startswith(stem)], letter)
        if whole is not None:
            found |= {f"{letter}{axis}": whole[:, k] for k, axis in enumerate("xyz")}
    rate_hz = np.ravel(arrays.get("fs", 0.0))
    if "t" not in found and "ax" in found and rate_hz.size == 1 and rate_hz[0] > 0.0:
        found["t"] = np.arange(len(found["ax"])) / rate_hz[0]
    return found


def _csv(path: Path, columns: str | None) -> dict[str, FloatArray]:
    table = read_text(path, f"a table of {', '.join(NAMES)}")
    names = [word.strip() for word in columns.split(",")] if columns else list(map(canonical, table.names))
    found = {name: table.values[:, k] for k, name in enumerate(names[: table.values.shape[1]])}
    if "t" in found and not columns:
        word = table.names[names.index("t")].lower().strip(" )]")
        found["t"] = found["t"] * next((u for end, u in TIME_UNITS.items() if word.endswith(end)), 1.0)
    if any(canonical(word).startswith("g") and DEGREES.search(word.lower()) for word in table.names):
        found["degrees"] = np.ones(1)
    return found


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
