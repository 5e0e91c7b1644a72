"""`companion-sitl campaign`: what it refuses, in one line."""

import os
import sys
from pathlib import Path

import pytest
from rich.console import Console

from sitl.campaign import SCENARIOS
from sitl.campaign import run as running
from sitl.campaign.manifest import CampaignRun
from sitl.campaign.rows import CSV_NAME, RunsFile
from sitl.campaign.run import Options
from sitl.cli import main
from tests.unit.sitl.campaign.campaign_command import options, run
from tests.unit.sitl.campaign.campaign_parts import row, scenario_file


def refused(capsys: pytest.CaptureFixture[str], *words: str | Path) -> str:
    """The one line of a command that exits with 2."""
    with pytest.raises(SystemExit) as ended:
        main(["campaign", *map(str, words)])
    assert ended.value.code == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    return line


def test_another_campaigns_folder_is_refused(
    tmp_path: Path, asked: list[CampaignRun], capsys: pytest.CaptureFixture[str]
) -> None:
    run(options(tmp_path))
    before = (tmp_path / CSV_NAME).read_bytes()
    line = refused(capsys, "--scenarios", "line", "--runs", "2", "--out", tmp_path)
    assert line.startswith(f"companion-sitl: --out {tmp_path}: holds another campaign: it flies 'static' too")
    assert (tmp_path / CSV_NAME).read_bytes() == before


@pytest.mark.parametrize("wrong", ["static,0,", "elsewhere,0,"])
def test_rows_that_come_twice_or_from_elsewhere_are_refused(
    wrong: str, tmp_path: Path, asked: list[CampaignRun], capsys: pytest.CaptureFixture[str]
) -> None:
    run(options(tmp_path))
    path = tmp_path / CSV_NAME
    first = next(line for line in path.read_text().splitlines() if line.startswith("static,0,"))
    path.write_text(path.read_text() + first.replace("static,0,", wrong) + "\n")
    line = refused(capsys, "--scenarios", "static", "--runs", "2", "--out", tmp_path)
    assert "runs.csv:4: " in line
    assert "expected one row a run" in line


def test_a_folder_that_another_writes_keeps_its_manifest(
    tmp_path: Path, asked: list[CampaignRun], capsys: pytest.CaptureFixture[str]
) -> None:
    run(options(tmp_path))
    before = (tmp_path / "campaign.json").read_bytes()
    held = RunsFile(tmp_path)
    assert "another campaign writes it" in refused(capsys, "--scenarios", "static", "--out", tmp_path)
    held.close()
    assert (tmp_path / "campaign.json").read_bytes() == before


def test_rows_without_a_manifest_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    held = RunsFile(tmp_path)
    held.append(row())
    held.close()
    assert "without its campaign.json" in refused(capsys, "--scenarios", "static", "--out", tmp_path)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scenarios", "nosuch"], "scenarios: no 'nosuch'"),
        (["--scenarios", "static", "nosuch"], "scenarios: no 'nosuch'"),
        (["--runs", "0"], "--runs"),
        (["--jobs", "0"], "--jobs"),
        (["--config", "nosuch.yaml"], "nosuch.yaml: cannot be read"),
        (["--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"], "--jobs: the cluster has its own"),
        (["--out", "/dev/null/here"], "--out /dev/null/here: cannot be written"),
    ],
)
def test_what_a_user_gets_wrong_is_one_line(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said in refused(capsys, *words)


def test_without_dask_the_line_names_the_extra(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "sitl.campaign.cluster", raising=False)
    line = refused(capsys, "--scenarios", "static", "--scheduler", "tcp://127.0.0.1:1", "--out", tmp_path)
    assert "needs Dask" in line
    assert "pip install 'companion-landing[campaign]'" in line


def test_the_words_of_the_command_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[Options] = []

    def take(chosen: Options, _console: Console) -> int:
        taken.append(chosen)
        return 0

    monkeypatch.setattr(running, "run_campaign", take)
    for words in (
        ["--scenarios", "line", "circle", "--runs", "3", "--bars"],
        ["--quiet", "--first-seed", "7"],
    ):
        with pytest.raises(SystemExit) as ended:
            main(["campaign", *words])
        assert not ended.value.code
    assert (taken[0].sources, taken[0].runs, taken[0].bars, taken[0].folder) == (
        ("line", "circle"),
        3,
        True,
        None,
    )
    assert taken[0].jobs == len(os.sched_getaffinity(0))
    assert (taken[1].sources, taken[1].first_seed, taken[1].quiet) == (SCENARIOS, 7, True)


def test_what_goes_on_is_the_command_that_was_given(tmp_path: Path) -> None:
    path = scenario_file(tmp_path, "my barge")
    chosen = Options((str(path),), 3, 0, 2, Path("out"), Path("a.yaml"), "tcp://h:1", bars=True, quiet=False)
    assert chosen.command == (
        f"companion-sitl campaign --scenarios '{path}' --runs 3 --out out --config a.yaml "
        "--scheduler tcp://h:1 --bars"
    )
