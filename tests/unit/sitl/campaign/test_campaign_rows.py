"""Rows: what they hold, and that the file never has half of one."""

import os
import re
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from companion.config import CONFIG_FOLDER, ConfigError
from companion.config.catalogue import inner_model
from companion.flightlog.result import Result
from sitl.campaign.rows import (
    COLUMNS,
    CSV_NAME,
    OUTCOMES,
    RESULT_KEYS,
    RunsFile,
    make_row,
    pending,
    read_rows,
    write_parquet,
)
from sitl.campaign.worker import RunResult
from tests.unit.sitl.campaign.campaign_parts import flight, row
from tests.unit.sitl.campaign.fake_flights import result

VERSION = "0.1.0+abc"


def result_keys(model: type[BaseModel], prefix: str = "") -> set[str]:
    keys = set()
    for name, field in model.model_fields.items():
        inner = inner_model(field.annotation)
        keys |= {f"{prefix}{name}"} if inner is None else result_keys(inner, f"{prefix}{name}.")
    return keys


def test_every_figure_of_the_result_has_its_column() -> None:
    assert set(RESULT_KEYS.values()) == result_keys(Result) - {
        "scenario",
        "seed",
        "as_built",
        "outcome",
        "contacts",
        "events",
    }
    assert set(RESULT_KEYS) <= set(COLUMNS)


def test_every_column_is_documented() -> None:
    page = (CONFIG_FOLDER.parent / "docs" / "how-to" / "campaigns.md").read_text(encoding="utf-8")
    table = page.partition("| Column | |")[2].partition("\n\n")[0]
    told = re.findall(r"`(\w+)`", "".join(line.split("|")[1] for line in table.splitlines() if line))
    assert told == list(COLUMNS)


def test_a_landing_fills_its_row() -> None:
    flown = RunResult(flight(40), 9.876, result(40, "static", "landed"), "", [0.01, -0.02])
    made = make_row(flown, VERSION)
    assert made.landed
    assert (made.touchdown_lateral_m, made.touchdown_along_m, made.touchdown_across_m) == (0.04, 0.01, -0.02)
    assert made.unplanned_contacts == 1
    assert (made.frames, made.total_s, made.pad_velocity_rmse_m_s) == (900, 30.0, None)
    assert (made.wall_s, made.version, made.error) == (9.88, VERSION, "")
    assert made.command == "companion --sitl --fast --scenario static --seed 40"


def test_a_run_that_never_came_down_has_no_touchdown() -> None:
    ended = {**result(1, "static", "timeout"), "touchdown": None}
    made = make_row(RunResult(flight(1), 9.0, ended, "never touched down"), VERSION)
    assert (made.outcome, made.reason, made.touchdown_lateral_m) == ("timeout", "never touched down", None)


def test_a_failed_run_has_its_last_words_on_one_line() -> None:
    made = make_row(RunResult(flight(1), 9.0, error="killed by SIGKILL:\n  no memory\n"), VERSION)
    assert (made.outcome, made.error, made.total_s) == ("failed", "killed by SIGKILL: no memory", None)


# ---------------------------------------------------------------- the file


def filled(folder: Path, count: int = 3) -> Path:
    file = RunsFile(folder)
    for seed in range(count):
        file.append(row(seed=seed, outcome=OUTCOMES[seed], lateral_m=0.01 * seed, reason='"beside", it'))
    file.close()
    return folder / CSV_NAME


def test_rows_come_back_as_they_were_written(tmp_path: Path) -> None:
    path = filled(tmp_path)
    expected = [row(seed=s, outcome=OUTCOMES[s], lateral_m=0.01 * s, reason='"beside", it') for s in range(3)]
    assert read_rows(path) == expected
    again = RunsFile(tmp_path)
    assert again.rows == expected
    again.close()


@pytest.mark.parametrize("left_over", ["static,3,land", "static", '"'])
def test_half_a_line_is_cut_off(left_over: str, tmp_path: Path) -> None:
    path = filled(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole + left_over.encode())
    file = RunsFile(tmp_path)
    file.append(row(seed=3))
    file.close()
    assert path.read_bytes().startswith(whole)
    assert [each.seed for each in read_rows(path)] == [0, 1, 2, 3]


def test_half_a_heading_is_begun_anew(tmp_path: Path) -> None:
    (tmp_path / CSV_NAME).write_text("scenario,se")
    file = RunsFile(tmp_path)
    file.close()
    assert (tmp_path / CSV_NAME).read_text() == ",".join(COLUMNS) + "\n"


def test_a_full_disk_leaves_whole_rows_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = filled(tmp_path)
    before = path.read_bytes()
    file = RunsFile(tmp_path)
    write = os.write
    monkeypatch.setattr(os, "write", lambda descriptor, data: write(descriptor, data[:10]))
    with pytest.raises(ConfigError, match=r"runs\.csv: cannot be written: no space"):
        file.append(row(seed=9))
    monkeypatch.undo()
    assert path.read_bytes() == before
    file.append(row(seed=9))
    file.close()
    assert [each.seed for each in read_rows(path)] == [0, 1, 2, 9]


def test_two_campaigns_do_not_write_one_file(tmp_path: Path) -> None:
    first = RunsFile(tmp_path)
    with pytest.raises(ConfigError, match="another campaign writes it"):
        RunsFile(tmp_path)
    first.close()
    RunsFile(tmp_path).close()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n1,2\n", r"runs\.csv: expected the columns scenario, seed, outcome"),
        (",".join(COLUMNS) + "\nstatic,1\n", rf"runs\.csv:2: expected {len(COLUMNS)} fields, found 2"),
        (",".join(COLUMNS) + "\nstatic,x,landed" + "," * (len(COLUMNS) - 3) + "\n", r"runs\.csv:2: seed: "),
    ],
)
def test_what_is_no_row_is_refused_with_its_line(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / CSV_NAME).write_text(text)
    with pytest.raises(ConfigError, match=words):
        RunsFile(tmp_path)
    (tmp_path / CSV_NAME).unlink()
    RunsFile(tmp_path).close()


def test_only_runs_without_a_row_are_left() -> None:
    flights = [flight(0), flight(1), flight(0, "line")]
    assert pending(flights, [row(seed=0)]) == [flight(1), flight(0, "line")]


def test_parquet_holds_the_same(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [row(seed=0, lateral_m=0.03, frames=9), row(seed=1, outcome="failed", error="hung")]
    path = write_parquet(rows, tmp_path)
    assert path == tmp_path / "runs.parquet"
    table = parquet.read_table(path)
    assert tuple(table.column_names) == COLUMNS
    assert table.to_pylist() == [each.model_dump() for each in rows]
    kinds: dict[str, Any] = {name: str(table.schema.field(name).type) for name in COLUMNS}
    assert (kinds["seed"], kinds["tilt_deg"], kinds["outcome"]) == ("int64", "double", "string")


def test_without_pyarrow_there_is_the_csv_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    assert write_parquet([row()], tmp_path) is None
    assert list(tmp_path.iterdir()) == []
