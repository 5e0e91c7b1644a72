"""Tables of samples: CSV and its relatives, .npz and .npy.

CSV is read liberally: any number of lines before the samples, a heading or none, comma, semicolon, tab or
blanks between the columns, decimal commas where the comma does not separate, columns of other things in
between, a serial monitor's time stamp or a label before a number, rows as Python and JSON print them, UTF-8
or UTF-16. The magnetometer's columns are found by their names, of a heading or of the labels.
"""

import math
import re
import zipfile
import zlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeGuard

import numpy as np
from numpy.typing import NDArray

from companion.base.files import cannot_read
from companion.base.geometry import FloatArray
from companion.config import ConfigError

_SEPARATORS: Final = (",", ";", "\t", None)  # None: blanks
_LEAST_ROWS: Final = 3
_MAGNETOMETER: Final = re.compile(r"^(m|b|h|mf|.*mag.*|.*compass.*)$")
# beside one that has been through a calibration
_RAW_MAGNETOMETER: Final = re.compile(r"^(?=.*(mag|compass))(?=.*(raw|uncal)).*$")
_NAMELESS: Final = re.compile(r"^$")
_OTHER: Final = re.compile(r"^(a|f|g|w|.*acc.*|.*specificforce.*|.*gyr.*|.*rate.*|.*vel.*|.*pos.*)$")
_ACCELEROMETER: Final = re.compile(r"^(a|f|.*acc.*|.*specificforce.*)$")
# before a number in its cell: the time stamp of a serial monitor (it ends in ] or ->), a label, a type
_BEFORE: Final = re.compile(r"^(?:.*(?:->|\]))?\s*(?:([^\W\d][^:=]*)[:=])?\s*(?:[\w.]*\()?")
_AROUND: Final = " \r\n()[]{}"  # a row as Python and JSON print it
_QUOTES: Final = "\"'"
_WORD: Final = re.compile(r"[a-zµμ]+|\d+")
_BRACKETS: Final = re.compile(r"[\[({]([^\])}]*)[\])}]")
_NPZ_MAGNETOMETER: Final = ("mag", "magnetometer", "m", "magnetic_field", "compass", "raw", "data", "arr_0")
_NPZ_ACCELEROMETER: Final = ("acc", "accel", "accelerometer", "a", "specific_force")


@dataclass(frozen=True, slots=True)
class SampleTable:
    """Columns as they stand in a file: `raw` (n, 3), `force` (n, 3) or None, the unit by the headings."""

    raw: FloatArray
    force: FloatArray | None
    unit: str | None
    notes: tuple[str, ...] = ()


# ---------------------------------------------------------------- text


def read_text_table(path: Path, columns: str | None) -> SampleTable:
    """Read a text table; `columns` names the magnetometer's three, by heading or number from 1.

    Raises:
        ConfigError: unreadable, no table, or the columns are not to be found.
    """
    try:
        text = _text(path.read_bytes())
    except OSError as error:
        raise cannot_read(path, error) from error
    lines = [line for line in text.splitlines() if line.strip()]
    rows, first = _best_split(lines)
    if rows is None or "\0" in text[:4096]:
        raise ConfigError(f"{path}: no table in it; expected rows of three numbers or more, as CSV has them")
    width = Counter(len(row) for row in rows[first:] if _is_data(row)).most_common(1)[0][0]
    heading = next((row for row in reversed(rows[:first]) if len(row) == width), None)
    names = [word.strip().strip("\"'# ") for word in heading] if heading else _labels(rows[first])
    data = [row for row in rows[first:] if len(row) == width and _is_data(row)]
    values = np.array([[_number(word) for word in row] for row in data])
    notes = []
    if (broken := len(rows) - first - len(data)) > 0:
        notes.append(f"{broken} lines that are no rows of {width} columns were passed over")
    chosen = _chosen(path, columns, names, width) if columns else _found(path, names, values, notes)
    force = _triple(names, _ACCELEROMETER)
    units = {_unit_of(names[k]) for k in chosen} if names else {None}
    return SampleTable(
        raw=values[:, chosen],
        force=None if force is None or set(force) & set(chosen) else values[:, force],
        unit=units.pop() if len(units) == 1 else None,
        notes=tuple(notes),
    )


def _text(data: bytes) -> str:
    """As text; Excel's "Unicode text" and PowerShell write UTF-16, some without its byte order mark."""
    encoding = "utf-8-sig"
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif data[:2].count(0) == 1:  # the first character is ASCII
        encoding = "utf-16-le" if data[1] == 0 else "utf-16-be"
    return data.decode(encoding, errors="replace")


def _labels(row: list[str]) -> list[str]:
    """What stands before the numbers of a row, cell by cell; nothing unless each has a name of its own."""
    found = [_BEFORE.match(word.strip(_AROUND + _QUOTES)) for word in row]
    labels = [
        match[1].rpartition("(")[2].strip(_AROUND + _QUOTES)
        for match in found
        if match is not None and match[1]
    ]
    return labels if len(labels) == len(set(labels)) == len(row) else []


def _best_split(lines: list[str]) -> tuple[list[list[str]] | None, int]:
    """The lines as words, split where most of them become rows of numbers, and the first row's index."""
    best: tuple[int, list[list[str]] | None, int] = (_LEAST_ROWS - 1, None, 0)
    for separator in _SEPARATORS:
        ends = _AROUND + (",;\t" if separator else "")
        rows = [line.lstrip(_AROUND).rstrip(ends).split(separator) for line in lines]
        data = [k for k, row in enumerate(rows) if _is_data(row)]
        widths = Counter(len(rows[k]) for k in data)
        if widths and widths.most_common(1)[0][1] > best[0]:
            width, count = widths.most_common(1)[0]
            best = (count, rows, next(k for k in data if len(rows[k]) == width))
    return best[1], best[2]


def _is_data(row: list[str]) -> bool:
    return sum(math.isfinite(_number(word)) for word in row) >= 3


def _number(word: str) -> float:
    bare = word.strip(_AROUND + _QUOTES).replace(",", ".")
    try:
        return float(bare)
    except ValueError:
        pass
    try:
        return float(_BEFORE.sub("", bare, count=1).lstrip(_AROUND))
    except ValueError:
        return math.nan


# ---------------------------------------------------------------- columns


def _chosen(path: Path, columns: str, names: list[str], width: int) -> list[int]:
    """The columns that the user names."""
    chosen = []
    for word in (part.strip() for part in columns.split(",")):
        if word in names:
            chosen.append(names.index(word))
        elif word.isdecimal() and 1 <= int(word) <= width:
            chosen.append(int(word) - 1)
        else:
            known = f"one of {', '.join(names)}" if names else "a number"
            raise ConfigError(f"{path}: --columns: no column '{word}'; expected {known}, or 1 to {width}")
    if len(set(chosen)) != 3:
        raise ConfigError(f"{path}: --columns {columns}: expected three columns: x, y and z")
    return chosen


def _found(path: Path, names: list[str], values: FloatArray, notes: list[str]) -> list[int]:
    """The magnetometer's columns by their names, or by their places when there are none."""
    numeric = np.flatnonzero(np.isfinite(values).mean(axis=0) > 0.5).tolist()
    for wanted in (_RAW_MAGNETOMETER, _MAGNETOMETER, _NAMELESS):
        if (found := _triple(names, wanted)) is not None:
            return found
    if names and (len(numeric) != 3 or _triple(names, _OTHER) is not None):
        raise ConfigError(
            f"{path}: no magnetometer's columns among {', '.join(names)}; expected mx, my, mz or alike, "
            "or --columns"
        )
    if len(numeric) > 3:
        notes.append("no heading: the last three columns were taken; --columns takes others")
    return numeric[-3:]


def _triple(names: list[str], wanted: re.Pattern[str]) -> list[int] | None:
    """The first x, y and z whose names are otherwise the same, and as wanted."""
    groups: dict[str, dict[str, int]] = {}
    for index, name in enumerate(names):
        rest, axis = _axis_of(name)
        if axis is not None and wanted.match(rest):
            groups.setdefault(rest, {}).setdefault(axis, index)
    return next(([g["x"], g["y"], g["z"]] for g in groups.values() if len(g) == 3), None)


def _axis_of(name: str) -> tuple[str, str | None]:
    """What is left of a heading without unit and axis, and the axis: "Mag X (uT)" -> ("mag", "x")."""
    words = _WORD.findall(_BRACKETS.sub(" ", name).lower())
    if len(words) > 1 and unit_called(words[-1]) is not None:
        words = words[:-1]
    for k in range(len(words) - 1, -1, -1):
        if words[k] in ("x", "y", "z"):
            return "".join(words[:k] + words[k + 1 :]), words[k]
    for k, word in enumerate(words):
        rest = words[:k] + words[k + 1 :]
        if word[-1] in "xyz" and not word[:-1].endswith("axi"):
            return "".join([*rest, word[:-1]]), word[-1]
        if word[0] in "xyz" and len(word) > 1:
            return "".join([*rest, word[1:]]), word[0]
    return "".join(words), None


def _unit_of(name: str) -> str | None:
    bracketed = _BRACKETS.search(name)
    words = [bracketed[1]] if bracketed else _WORD.findall(name.lower())[1:]
    return unit_called(words[-1]) if words else None


# ---------------------------------------------------------------- numpy


def read_numpy_table(path: Path) -> SampleTable:
    """Read a .npz (mag, and acc if it is there; or mx, my, mz) or a .npy of (n, 3).

    Raises:
        ConfigError: unreadable, or no magnetometer's array in it.
    """
    try:
        loaded = np.load(path, allow_pickle=False)
        arrays = dict(loaded) if path.suffix.lower() == ".npz" else {"mag": loaded}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ConfigError(f"{path}: cannot be read as numpy's arrays: {error}") from error
    lowered: dict[str, Any] = {name.lower(): array for name, array in arrays.items()}
    raw = _array(lowered, _NPZ_MAGNETOMETER, "m")
    if raw is None:
        raise ConfigError(
            f"{path}: no magnetometer among {', '.join(arrays)}; expected mag (n, 3) or mx, my, mz"
        )
    force = _array(lowered, _NPZ_ACCELEROMETER, "a")
    unit = str(lowered["unit"]) if "unit" in lowered else ""
    return SampleTable(
        raw, force if force is not None and len(force) == len(raw) else None, unit_called(unit)
    )


def _array(arrays: dict[str, Any], names: tuple[str, ...], letter: str) -> FloatArray | None:
    """An (n, 3) array by one of the names, or of three by axis."""
    single = [arrays.get(f"{letter}{axis}") for axis in "xyz"]
    columns = [np.asarray(each, dtype=float) for each in single if _is_numbers(each, 1)]
    if len(columns) == 3 and len({len(column) for column in columns}) == 1:
        return np.stack(columns, axis=1)
    for name in names:
        array = arrays.get(name)
        if not _is_numbers(array, 2) or 3 not in np.shape(array):
            continue
        rows: FloatArray = np.asarray(array, dtype=float)
        return rows if rows.shape[1] == 3 else rows.T
    return None


def _is_numbers(array: Any, dimensions: int) -> TypeGuard[NDArray[Any]]:
    """Whether an array is there, of so many dimensions and of real numbers."""
    return array is not None and np.ndim(array) == dimensions and np.asarray(array).dtype.kind in "iuf"


# ---------------------------------------------------------------- units
# Units of the magnetic field: by name, by a column's heading, or worked out from the field's size.
#
# The Earth's field is between 22 and 67 µT everywhere on the ground.

# µT in one of each
UT_PER: Final = {"T": 1e6, "G": 100.0, "mT": 1e3, "uT": 1.0, "mG": 0.1, "nT": 1e-3}
_SPELLINGS: Final = {
    "t": "T", "tesla": "T", "g": "G", "gs": "G", "gauss": "G", "ga": "G", "mt": "mT", "millitesla": "mT",
    "ut": "uT", "µt": "uT", "μt": "uT", "microtesla": "uT", "mg": "mG", "mgauss": "mG", "mga": "mG",
    "milligauss": "mG", "nt": "nT", "nanotesla": "nT",
    "counts": "counts", "count": "counts", "lsb": "counts", "raw": "counts", "adc": "counts",
}  # fmt: skip
COUNTS: Final = "counts"
EARTH_UT: Final = (22.0, 67.0)
_SENSOR_TOLERANCE: Final = 1.3  # a sensor's own scale may be off by so much


def unit_called(name: str) -> str | None:
    """The unit of a spelling ("µT", "gauss", "LSB"); None when it is none."""
    return _SPELLINGS.get(name.strip().lower())


def infer_unit(radius: float, field_ut: float | None, *, whole_numbers: bool) -> str:
    """The unit in which a field of this size (the ellipsoid's mean radius) is the Earth's; else counts.

    Whole numbers are an ADC's as likely as anything's: without `field_ut`, the field's known size, they stay
    counts.
    """
    low, high = (field_ut, field_ut) if field_ut is not None else EARTH_UT
    if whole_numbers and field_ut is None:
        return COUNTS
    for unit in ("uT", "G", "mG", "nT", "T", "mT"):
        if low / _SENSOR_TOLERANCE <= radius * UT_PER[unit] <= high * _SENSOR_TOLERANCE:
            return unit
    return COUNTS
