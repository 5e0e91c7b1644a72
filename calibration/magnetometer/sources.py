"""Opening a recording: what it is by its first bytes, else by its name, else a table of text."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from calibration.magnetometer.ellipsoid import NoEllipsoidError, robust_start
from calibration.magnetometer.logs import read_dataflash_compass, read_own_log, read_tlog, read_ulog_compass
from calibration.magnetometer.recording import MagnetometerRecording
from calibration.tables import read_arrays, read_text, vectors
from companion.base.files import cannot_read
from companion.base.geometry import FloatArray
from companion.config import ConfigError
from companion.config.magnetometer import Sensor
from companion.flightlog.log_file import log_file
from companion.flightlog.replay.flight_record import UT_PER

_MAGNETOMETER: Final = re.compile(r"^(m|b|h|mf|.*mag.*|.*compass.*)$")
# beside one that has been through a calibration
_RAW_MAGNETOMETER: Final = re.compile(r"^(?=.*(mag|compass))(?=.*(raw|uncal)).*$")
_NAMELESS: Final = re.compile(r"^$")
_OTHER: Final = re.compile(r"^(a|f|g|w|.*acc.*|.*specificforce.*|.*gyr.*|.*rate.*|.*vel.*|.*pos.*)$")
_ACCELEROMETER: Final = re.compile(r"^(a|f|.*acc.*|.*specificforce.*)$")
_WORD: Final = re.compile(r"[a-zµμ]+|\d+")
_BRACKETS: Final = re.compile(r"[\[({]([^\])}]*)[\])}]")
_NPZ_MAGNETOMETER: Final = (
    *("", "mag", "magnetometer", "m"),
    *("magnetic_field", "compass", "raw", "data", "arr_0"),
)
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
    table = read_text(path, "rows of three numbers or more")
    names, values = table.names, table.values
    notes = []
    width = values.shape[1]
    if table.passed_over > 0:
        notes.append(f"{table.passed_over} lines that are no rows of {width} columns were passed over")
    chosen = _chosen(path, columns, names, width) if columns else _found(path, names, values, notes)
    force = _triple(names, _ACCELEROMETER)
    units = {_unit_of(names[k]) for k in chosen} if names else {None}
    return SampleTable(
        raw=values[:, chosen],
        force=None if force is None or set(force) & set(chosen) else values[:, force],
        unit=units.pop() if len(units) == 1 else None,
        notes=tuple(notes),
    )


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
    arrays = read_arrays(path)
    raw = vectors(arrays, _NPZ_MAGNETOMETER, "m")
    if raw is None:
        raise ConfigError(
            f"{path}: no magnetometer among {', '.join(arrays)}; expected mag (n, 3) or mx, my, mz"
        )
    force = vectors(arrays, _NPZ_ACCELEROMETER, "a")
    unit = str(arrays.get("unit", ""))
    return SampleTable(
        raw, force if force is not None and len(force) == len(raw) else None, unit_called(unit)
    )


# ---------------------------------------------------------------- units
# The Earth's field is between 22 and 67 µT everywhere on the ground.

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


# ---------------------------------------------------------------- recordings

_LOGS: Final[dict[bytes, Callable[[Path], MagnetometerRecording]]] = {
    b"\x89MCAP0\r\n": read_own_log,
    b"\xa3\x95": read_dataflash_compass,
    b"ULog\x01\x12\x35": read_ulog_compass,
}
FAR_OFF: Final = 3.0  # a field nearer to the Earth's is a sensor's whose scale is wrong
_NUMPY: Final = (b"PK\x03\x04", b"\x93NUMPY")


def read_recording(
    path: Path,
    *,
    columns: str | None,
    unit: str | None,
    sensor: Sensor,
    field_ut: float | None,
    rng: np.random.Generator,
) -> MagnetometerRecording:
    """Read a file of samples.

    Args:
        path: of the file, or of a flight's folder.
        columns: the magnetometer's columns in a table of text; None: by their headings.
        unit: of a table's field; None: by the headings, else worked out from the field's size.
        sensor: what measured a table's samples; logs say so themselves.
        field_ut: the field's true size, where it is known, to work out the unit.
        rng: for the robust look at the field's size.

    Raises:
        ConfigError: it cannot be read, or holds no magnetometer.
    """
    path = log_file(path)
    try:
        with path.open("rb") as stream:
            start = stream.read(16)
        reader = next((read for magic, read in _LOGS.items() if start.startswith(magic)), None)
        if reader is None and path.suffix.lower() == ".tlog":
            reader = read_tlog
        if reader is not None:
            return reader(path).checked()
    except OSError as error:
        raise cannot_read(path, error, expected="a recording") from error
    table = read_numpy_table(path) if start.startswith(_NUMPY) else read_text_table(path, columns)
    return _of_table(str(path), table, unit, sensor, field_ut, rng)


def _of_table(
    source: str,
    table: SampleTable,
    unit: str | None,
    sensor: Sensor,
    field_ut: float | None,
    rng: np.random.Generator,
) -> MagnetometerRecording:
    recording = MagnetometerRecording(
        source, sensor, table.raw, force=table.force, notes=list(table.notes)
    ).checked()
    known = unit_called(unit) if unit is not None else table.unit
    if unit is not None and known is None:
        raise ConfigError(f"--unit {unit}: expected one of {', '.join(UT_PER)}, counts")
    radius = None if known == COUNTS else _radius(recording.raw, rng)
    if known is not None and radius is not None:
        _must_be_the_earths(source, radius, known, by_option=unit is not None)
    if known is None:
        whole = bool(np.array_equal(recording.raw, np.round(recording.raw)))
        known = COUNTS if radius is None else infer_unit(radius, field_ut, whole_numbers=whole)
        unit_text = "counts of the sensor, so nothing is said of its scale" if known == COUNTS else known
        recording.notes.append(f"unit by the field's size: {unit_text}; --unit takes another")
    if known == COUNTS:
        recording.unit = "counts"
    else:
        recording.raw = recording.raw * UT_PER[known]
    return recording


def _radius(raw: FloatArray, rng: np.random.Generator) -> float | None:
    """The ellipsoid's mean radius, as the numbers stand; None: they are on none."""
    try:
        matrix = robust_start(raw, rng).matrix
    except NoEllipsoidError:
        return None
    return 1.0 / float(np.cbrt(np.linalg.det(matrix)))


def _must_be_the_earths(source: str, radius: float, unit: str, *, by_option: bool) -> None:
    """Units differ by ten at least: a field that is the Earth's in another one is in that."""
    other = infer_unit(radius, None, whole_numbers=False)
    if COUNTS in (unit, other) or unit == other:
        return
    low, high = EARTH_UT
    if low / FAR_OFF <= radius * UT_PER[unit] <= high * FAR_OFF:
        return
    told = f"--unit {unit}" if by_option else f"the heading's {unit}"
    raise ConfigError(
        f"{source}: by {told} the field is {radius * UT_PER[unit]:.3g} µT; expected the Earth's, {low:g} to "
        f"{high:g} µT: in {other} it is {radius * UT_PER[other]:.3g} µT, see --unit {other}"
    )
