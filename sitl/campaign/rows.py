"""One row a run: its columns, and the file that holds them (`runs.csv`, at the end also `runs.parquet`).

A row is one line, written at once and flushed to the disk before the next, so a campaign that is killed has
lost no run that had ended; half a line, which only a full disk or a power cut leaves, is cut off when the
file is opened again. SI units, as the names say; angles in degrees.
"""

import csv
import fcntl
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, get_args

from pydantic import Field

from companion.base.files import replaced
from companion.config import ConfigError, StrictModel, validate
from sitl.campaign.manifest import CampaignRun
from sitl.campaign.worker import RunResult

RowOutcome = Literal["landed", "missed", "aborted", "timeout", "crashed", "failed"]
OUTCOMES: Final[tuple[RowOutcome, ...]] = get_args(RowOutcome)
CSV_NAME: Final = "runs.csv"
PARQUET_NAME: Final = "runs.parquet"


def _at(key: str) -> Any:
    """A column that `result.json` has under a key."""
    return Field(default=None, json_schema_extra={"at": key})


class Row(StrictModel):
    """One run. None (an empty field) where there was nothing to measure.

    `failed` is a run without a result: its process died or hung, and `error` has its last words. `reason` is
    why a flight that has a result did not land. Along is along the pad's heading, across to its right.
    `unplanned_contacts` are those that make a flight a failed one.
    """

    scenario: str
    seed: int
    outcome: RowOutcome
    reason: str = ""
    touchdown_lateral_m: float | None = _at("touchdown.lateral_error_m")
    touchdown_along_m: float | None = None
    touchdown_across_m: float | None = None
    vertical_speed_m_s: float | None = _at("touchdown.vertical_speed_m_s")
    horizontal_speed_m_s: float | None = _at("touchdown.horizontal_speed_m_s")
    tilt_deg: float | None = _at("touchdown.tilt_deg")
    yaw_error_deg: float | None = _at("touchdown.yaw_error_deg")
    pad_speed_m_s: float | None = _at("pad.speed_m_s")
    unplanned_contacts: int | None = None
    search_s: float | None = _at("time.search_s")
    approach_s: float | None = _at("time.approach_s")
    descent_s: float | None = _at("time.descent_s")
    total_s: float | None = _at("time.total_s")
    frames: int | None = _at("vision.frames")
    frames_with_pad: int | None = _at("vision.frames_with_pad")
    sighting_rmse_m: float | None = _at("vision.relative_position_rmse_m")
    attitude_rmse_deg: float | None = _at("estimate.attitude_rmse_deg")
    velocity_rmse_m_s: float | None = _at("estimate.velocity_rmse_m_s")
    pad_velocity_rmse_m_s: float | None = _at("estimate.pad_velocity_rmse_m_s")
    latency_p50_ms: float | None = _at("latency_ms.exposure_to_setpoint_p50")
    latency_p99_ms: float | None = _at("latency_ms.exposure_to_setpoint_p99")
    cycle_late_p50_ms: float | None = _at("latency_ms.cycle_late_p50")
    cycle_late_p99_ms: float | None = _at("latency_ms.cycle_late_p99")
    control_cycles: int | None = _at("control.cycles")
    control_unsolved: int | None = _at("control.unsolved")
    control_late: int | None = _at("control.late")
    control_stopped: int | None = _at("control.stopped")
    control_blind: int | None = _at("control.blind")
    control_limited: int | None = _at("control.limited")
    control_iterations_p99: float | None = _at("control.iterations_p99")
    real_time_factor: float | None = _at("sim.real_time_factor")
    wall_s: float
    version: str
    command: str
    error: str = ""

    @property
    def landed(self) -> bool:
        """Whether it landed within its scenario's bounds."""
        return self.outcome == "landed"


COLUMNS: Final = tuple(Row.model_fields)
RESULT_KEYS: Final = {
    name: str(field.json_schema_extra["at"])
    for name, field in Row.model_fields.items()
    if isinstance(field.json_schema_extra, dict)
}


def make_row(flown: RunResult, version: str) -> Row:
    flight, result = flown.flight, flown.result
    along, across = flown.touchdown_pad_m or (None, None)
    return Row(
        scenario=flight.scenario,
        seed=flight.seed,
        outcome="failed" if result is None else result["outcome"],
        reason=_one_line(flown.reason),
        touchdown_along_m=None if along is None else round(along, 6),
        touchdown_across_m=None if across is None else round(across, 6),
        wall_s=round(flown.wall_s, 2),
        unplanned_contacts=None
        if result is None
        else sum(bool(contact["violations"]) for contact in result["contacts"]),
        version=version,
        command=flight.command,
        error=_one_line(flown.error),
        **{} if result is None else {name: _value(result, key) for name, key in RESULT_KEYS.items()},
    )


def _value(result: Mapping[str, Any], key: str) -> Any:
    value: Any = result
    for part in key.split("."):
        value = None if value is None else value[part]
    return value


def _one_line(text: str) -> str:
    return " ".join(text.split())


# ---------------------------------------------------------------- the file


class RunsFile:
    """`runs.csv` of a campaign, held by one process at a time."""

    def __init__(self, folder: Path) -> None:
        """Open it, or begin it, and read what it holds.

        Raises:
            ConfigError: it cannot be written, another campaign writes it, or it holds something else.
        """
        self.path = folder / CSV_NAME
        try:
            self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot be written: {error.strerror}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _cut_half_line(self._file, self.path)
            if os.fstat(self._file).st_size == 0:
                self._write(COLUMNS)
            self.rows = read_rows(self.path)
        except BlockingIOError as error:
            self.close()
            raise ConfigError(
                f"{self.path}: another campaign writes it; expected it to have ended"
            ) from error
        except BaseException:
            self.close()
            raise

    def append(self, row: Row) -> None:
        """Add a row; when this returns it is on the disk.

        Raises:
            ConfigError: it cannot be written; what was written before stays.
        """
        self._write(list(row.model_dump().values()))
        self.rows.append(row)

    def close(self) -> None:
        os.close(self._file)

    def _write(self, values: Sequence[object]) -> None:
        line = io.StringIO(newline="")
        csv.writer(line, lineterminator="\n").writerow(values)
        data = line.getvalue().encode()
        before = os.fstat(self._file).st_size
        try:
            if os.write(self._file, data) < len(data):
                raise OSError(0, "no space for a whole line")
            os.fsync(self._file)
        except OSError as error:
            os.ftruncate(self._file, before)
            raise ConfigError(f"{self.path}: cannot be written: {error.strerror}") from error


def _cut_half_line(file: int, path: Path) -> None:
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole < len(data):
        os.ftruncate(file, whole)


def read_rows(path: Path) -> list[Row]:
    """The rows of a `runs.csv`.

    Raises:
        ConfigError: other columns, or a line that is no row; the message names it.
    """
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            lines = list(csv.reader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    if not lines or tuple(lines[0]) != COLUMNS:
        raise ConfigError(f"{path}: expected the columns {', '.join(COLUMNS[:3])} and so on")
    return [_parse(line, f"{path}:{number}") for number, line in enumerate(lines[1:], start=2)]


def _parse(line: Sequence[str], where: str) -> Row:
    if len(line) != len(COLUMNS):
        raise ConfigError(f"{where}: expected {len(COLUMNS)} fields, found {len(line)}")
    return validate(Row, {name: text for name, text in zip(COLUMNS, line, strict=True) if text}, where)


def write_parquet(rows: Sequence[Row], folder: Path) -> Path | None:
    """Write `runs.parquet`; None when pyarrow (the extra `campaign`) is not installed."""
    try:
        import pyarrow as pa  # noqa: PLC0415 - an extra
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        return None
    whole = [
        name
        for name, field in Row.model_fields.items()
        if int in {field.annotation, *get_args(field.annotation)}
    ]
    kinds = dict.fromkeys(whole, pa.int64())
    texts = {name for name, field in Row.model_fields.items() if field.annotation in {str, RowOutcome}}
    schema = pa.schema(
        [(name, kinds.get(name, pa.string() if name in texts else pa.float64())) for name in COLUMNS]
    )
    path = folder / PARQUET_NAME
    with replaced(path) as part:
        parquet.write_table(pa.Table.from_pylist([row.model_dump() for row in rows], schema=schema), part)
    return path


def pending(flights: Sequence[CampaignRun], rows: Sequence[Row]) -> list[CampaignRun]:
    """The runs that have no row yet."""
    flown = {(row.scenario, row.seed) for row in rows}
    return [flight for flight in flights if (flight.scenario, flight.seed) not in flown]
