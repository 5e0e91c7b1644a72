"""Opening a recording: what it is by its first bytes, else by its name, else a table of text."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from calibration.magnetometer.ellipsoid import NoEllipsoidError, robust_start
from calibration.magnetometer.logs import read_dataflash_compass, read_own_log, read_tlog, read_ulog_compass
from calibration.magnetometer.recording import MagnetometerRecording
from calibration.magnetometer.tables import (
    COUNTS,
    EARTH_UT,
    UT_PER,
    SampleTable,
    infer_unit,
    read_numpy_table,
    read_text_table,
    unit_called,
)
from companion.base.files import cannot_read
from companion.base.geometry import FloatArray
from companion.config import ConfigError
from companion.config.magnetometer import Sensor
from companion.flightlog.log_file import log_file

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
        known = _by_size(recording.raw, radius, field_ut)
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


def _by_size(raw: FloatArray, radius: float | None, field_ut: float | None) -> str:
    if radius is None:
        return COUNTS
    return infer_unit(radius, field_ut, whole_numbers=bool(np.array_equal(raw, np.round(raw))))


def _must_be_the_earths(source: str, radius: float, unit: str, *, by_option: bool) -> None:
    """Units differ by ten at least: a field that is the Earth's in another one is in that.

    Raises:
        ConfigError: it is.
    """
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
