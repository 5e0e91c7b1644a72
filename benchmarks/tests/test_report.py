"""What a benchmark's results hold, and what exit status they give."""

from pathlib import Path

import pytest
from rich.table import Table

from benchmarks.report import BenchReport, commit
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
