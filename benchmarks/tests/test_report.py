"""What a benchmark's results hold, what exit status they give, and what is kept of a bench that goes on."""

from dataclasses import dataclass
from pathlib import Path

import pytest
from rich.table import Table

from benchmarks.report import BenchReport, commit
from benchmarks.rows_file import RowsFile
from sitl.campaign.tables import Bar


def test_results_hold_the_tables_the_lines_and_the_bars(capsys: pytest.CaptureFixture[str]) -> None:
    report = BenchReport(width=100)
    table = Table("case", "landed", title="landings")
    table.add_row("line", "[bold]20[/bold] of 20")
    report.show(table, "median [1.3] cm")
    report.progress("1 of 20")
    assert report.judge([Bar("landed", "100 %", holds=True)]).exit_status == 0
    found = report.as_json("landing", ["--runs", "20"])
    assert (found["benchmark"], found["arguments"], found["holds"]) == ("landing", ["--runs", "20"], True)
    assert found["tables"] == [{"title": "landings", "rows": [{"case": "line", "landed": "20 of 20"}]}]
    assert found["lines"] == ["median [1.3] cm"]
    assert found["bars"] == [{"name": "landed", "holds": True, "text": "landed 100 % holds"}]
    said = capsys.readouterr().out
    assert "median [1.3] cm" in said
    assert said.endswith("bars: landed 100 % holds\n")


@pytest.mark.parametrize(
    ("bars", "status"), [(None, 0), ({}, 1), ({"a": True}, 0), ({"a": True, "b": False}, 1)]
)
def test_the_exit_status_needs_bars_that_hold(bars: dict[str, bool] | None, status: int) -> None:
    report = BenchReport()
    assert (report if bars is None else report.judge(bars)).exit_status == status


def test_without_git_there_is_no_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.report.ROOT", Path("/"))
    assert commit() is None


@dataclass(frozen=True)
class Kept:
    code: str
    seed: int
    said: str = ""
    found: tuple[str, ...] = ()
    after_s: float | None = None


def test_what_is_written_is_read_again_and_a_torn_line_is_not(tmp_path: Path) -> None:
    path = tmp_path / "there" / "rows.jsonl"
    file, rows = RowsFile(path, Kept), [Kept("abc", 0, found=("armed",)), Kept("abc", 1, 'crash; "µ",\ny')]
    assert file.read("abc") == []
    for one in rows:
        file.append(one)
    path.write_bytes(path.read_bytes()[:-40])
    assert file.read("abc") == rows[:1]
    file.append(rows[1])
    file.append(Kept("another state of the code", 2, after_s=1.5))
    assert file.read("abc") == rows
    assert [row.after_s for row in file.read("another state of the code")] == [1.5]
