"""A flight's log as tables, one a topic: CSV for a spreadsheet, Parquet for pandas, polars and DuckDB.

Columns are the fields' names, dotted within an object, `name[k]` within an array of fixed length. What has no
fixed length (a reference's rows, a scene) stands as JSON in one column. Pictures are left out.
"""

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal

from companion.base.files import replaced
from companion.config import ConfigError
from companion.flightlog.log_file import LogReader

TIME_COLUMN: Final = "log_time_s"
IMAGE_SCHEMA: Final = "foxglove.CompressedImage"
# an array that is longer stays JSON, as does one whose length changes
LONGEST_SPREAD: Final = 16
Row = dict[str, Any]
TableFormat = Literal["csv", "parquet"]


def convert(source: Path, folder: Path, form: TableFormat) -> dict[str, int]:
    """Write a table a topic into a folder, which is made; returns the rows by file name."""
    tables = read_tables(source)
    if not tables:
        raise ConfigError(f"{source}: holds no message that can be read; expected an MCAP log")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return {_write(folder, topic, rows, form): len(rows) for topic, rows in sorted(tables.items())}
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from error


def read_tables(source: Path) -> dict[str, list[Row]]:
    """The rows of each topic, in the order of writing; a log that was cut short as far as it goes."""
    reader, tables = LogReader(source), dict[str, list[Row]]()
    schemas: dict[str, Any] = {}
    for topic, message in reader.messages():
        if topic not in schemas:
            schemas[topic] = reader.schema(topic)
        if schemas[topic].get("title") == IMAGE_SCHEMA:
            continue
        row = {TIME_COLUMN: 1e-9 * message.log_time}
        row.update(_flat(reader.content(topic, message), schemas[topic], ""))
        tables.setdefault(topic, []).append(row)
    return tables


def _flat(value: Any, schema: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Columns and values of what a message holds; the schema tells an array of fixed length."""
    kind = schema.get("type") if isinstance(schema, dict) else None
    if isinstance(value, dict):
        properties = schema.get("properties", {}) if kind == "object" else {}
        for key, inner in value.items():
            yield from _flat(inner, properties.get(key, {}), f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        fixed = schema.get("minItems", -1) == schema.get("maxItems")
        if fixed and len(value) <= LONGEST_SPREAD:
            for k, inner in enumerate(value):
                yield f"{name}[{k}]", inner
        else:
            yield name, json.dumps(value)
    else:
        yield name, value


def _write(folder: Path, topic: str, rows: list[Row], form: TableFormat) -> str:
    path = folder / f"{topic.replace('/', '_')}.{form}"
    columns = list(dict.fromkeys(name for row in rows for name in row))
    if form == "csv":
        with replaced(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.DictWriter(stream, columns)
            writer.writeheader()
            writer.writerows(rows)
        return path.name
    try:
        import pyarrow  # noqa: PLC0415 - an extra
        from pyarrow import parquet  # noqa: PLC0415
    except ModuleNotFoundError:
        raise ConfigError("--to parquet needs pyarrow: pip install 'companion-landing[campaign]'") from None
    with replaced(path) as part:
        parquet.write_table(pyarrow.table({name: [row.get(name) for row in rows] for name in columns}), part)
    return path.name
