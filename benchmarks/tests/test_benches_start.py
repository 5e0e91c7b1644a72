"""Every benchmark is found, imports and knows its words: one that nobody runs dies unseen."""

import json
import os
import re
import shutil
import subprocess
import sys
from datetime import datetime
from importlib import import_module
from pathlib import Path

import pytest

from benchmarks.command import discover, main
from benchmarks.report import ROOT, commit
from benchmarks.service import bench_page


@pytest.mark.fast
@pytest.mark.parametrize("name", discover())
def test_a_benchmark_says_what_it_is_for(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [])
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    assert f"python -m benchmarks {name}" in capsys.readouterr().out


def test_without_a_name_all_are_listed_each_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()[2:]
    assert [line.split()[0] for line in lines] == list(discover())
    assert [line for line in lines if len(line.split()) < 5] == []


@pytest.mark.parametrize("name", discover())
def test_a_smoke_run_leaves_results_with_commit_machine_and_date(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needs = getattr(import_module(discover()[name]), "NEEDS", None)
    if needs is not None:
        pytest.skip(f"needs {needs}")
    monkeypatch.chdir(tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", name, "--smoke", "--json", "results.json"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=580,
        check=False,
    )
    # a crash ends in 1 too, but leaves nothing
    path = tmp_path / "results.json"
    assert path.exists(), done.stderr
    results = json.loads(path.read_text())
    assert done.returncode == int(not results["holds"])
    assert results["benchmark"] == name
    assert results["commit"] == commit()
    assert results["machine"]["cores"] >= 1
    assert datetime.fromisoformat(results["date"]).tzinfo is not None
    rows = [row for table in results["tables"] for row in table["rows"]]
    assert [*rows, *results["lines"], *results["bars"]] != []


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_a_checkouts_commit_is_marked_where_files_differ_from_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.report.ROOT", tmp_path)
    assert commit() is None
    figures, author = tmp_path / "figures", ("-c", "user.name=a", "-c", "user.email=a@b.c")
    figures.write_text("1")
    for words in (("init", "--quiet"), ("add", "."), (*author, "commit", "--quiet", "--message", "first")):
        subprocess.run(("git", *words), cwd=tmp_path, check=True)
    assert re.fullmatch(r"[0-9a-f]{40}", commit() or "")
    figures.write_text("2")
    assert re.fullmatch(r"[0-9a-f]{40}\+", commit() or "")


def test_results_that_cannot_be_written_are_said_before_anything_is_measured(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", [])
    assert main(["mpc", "--json", "nowhere/results.json"]) == 2
    assert "mpc: --json nowhere/results.json: expected" in capsys.readouterr().err


def test_a_name_that_is_none_is_answered_with_those_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["wings"]) == 2
    assert "wings: no such benchmark; expected one of" in capsys.readouterr().err


def test_without_chromium_the_delay_is_not_measured_and_the_bench_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench_page, "program", lambda: None)
    assert bench_page.main(["--part", "pixel"]).exit_status == 1
    *_, last = capsys.readouterr().out.splitlines()
    pixel = "from exposure to pixel, {} NOT MEASURED FAILS"
    assert last == f"bars: {pixel.format('p50')}, {pixel.format('p99')}"
