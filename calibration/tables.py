"""Tables of samples as people have them: CSV and its relatives, .npz and .npy.

CSV is read liberally: any number of lines before the samples, a heading or none, comma, semicolon, tab or
blanks between the columns, decimal commas where the comma does not separate, columns of other things in
between, a serial monitor's time stamp or a label before a number, rows as Python and JSON print them, UTF-8
or UTF-16. What the columns are is up to the caller.
"""

import math
import re
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterable
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
# before a number in its cell: the time stamp of a serial monitor (it ends in ] or ->), a label, a type
_BEFORE: Final = re.compile(r"^(?:.*(?:->|\]))?\s*(?:([^\W\d][^:=]*)[:=])?\s*(?:[\w.]*\()?")
_AROUND: Final = " \r\n()[]{}"  # a row as Python and JSON print it
_QUOTES: Final = "\"'"


@dataclass(frozen=True, slots=True)
class TextTable:
    """The rows of numbers (n, columns), NaN where a cell is none; the headings, none at all without any."""

    names: list[str]
    values: FloatArray
    passed_over: int  # lines after the first row that are no rows


def read_text(path: Path, expected: str) -> TextTable:
    """Read a text table.

    Raises:
        ConfigError: unreadable, or no table; `expected` says what one has.
    """
    try:
        text = _text(path.read_bytes())
    except OSError as error:
        raise cannot_read(path, error, expected=expected) from error
    rows, first = _best_split([line for line in text.splitlines() if line.strip()])
    if rows is None or "\0" in text[:4096]:
        raise ConfigError(f"{path}: no table in it; expected {expected}, as CSV has them")
    width = Counter(len(row) for row in rows[first:] if _is_data(row)).most_common(1)[0][0]
    heading = next((row for row in reversed(rows[:first]) if len(row) == width), None)
    names = [word.strip().strip("\"'# ") for word in heading] if heading else _labels(rows[first])
    data = [row for row in rows[first:] if len(row) == width and _is_data(row)]
    values = np.array([[_number(word) for word in row] for row in data])
    return TextTable(names, values, len(rows) - first - len(data))


def read_arrays(path: Path) -> dict[str, Any]:
    """The arrays of a .npz by their names in lower case; of a .npy its own, by ""."""
    try:
        loaded = np.load(path, allow_pickle=False)
        arrays = dict(loaded) if path.suffix.lower() == ".npz" else {"": loaded}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ConfigError(f"{path}: cannot be read as numpy's arrays: {error}") from error
    return {name.lower(): array for name, array in arrays.items()}


def vectors(arrays: dict[str, Any], names: Iterable[str], letter: str) -> FloatArray | None:
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
