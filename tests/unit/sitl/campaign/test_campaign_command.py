"""`companion-sitl campaign`: what it leaves, tells and returns, and how it goes on."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from companion.config import ConfigError
from sitl.campaign.manifest import CampaignRun
from sitl.campaign.plots import write_plots
from sitl.campaign.rows import CSV_NAME, read_rows
from sitl.campaign.run import CampaignMeter
from tests.unit.sitl.campaign.campaign_command import options, run, seeds
from tests.unit.sitl.campaign.campaign_parts import row
from tests.unit.sitl.campaign.fake_flights import DIES, IS_REFUSED, MISSES

LEFT = {"campaign.json", CSV_NAME, "summary.txt", "outcomes.png", "lateral.png", "vertical_speed.png"} | {
    "touchdowns.png"
}


# ---------------------------------------------------------------- from start to end


def test_a_campaign_leaves_rows_tables_and_plots(
    tmp_path: Path, asked: list[CampaignRun], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sitl.campaign.plots.write_plots", write_plots)
    folder = tmp_path / "new" / "deep"
    code, text = run(options(folder, "static", "line"))
    assert code == 0
    assert {path.name for path in folder.iterdir()} - {"runs.parquet"} == LEFT
    assert len(read_rows(folder / CSV_NAME)) == len(asked) == 4
    assert "100 % (51.0 to 100.0)" in text
    assert "100 % (51.0 to 100.0)" in (folder / "summary.txt").read_text()


def test_the_same_command_again_flies_nothing_and_tells_the_same(
    tmp_path: Path, asked: list[CampaignRun]
) -> None:
    first = run(options(tmp_path))[1]
    asked.clear()
    code, again = run(options(tmp_path))
    assert (code, asked) == (0, [])
    assert again.partition("How the runs ended")[2] == first.partition("How the runs ended")[2]


def test_more_seeds_and_scenarios_fly_only_the_new_ones(tmp_path: Path, asked: list[CampaignRun]) -> None:
    run(options(tmp_path))
    asked.clear()
    assert run(options(tmp_path, "static", "line", runs=3))[0] == 0
    assert {(each.scenario, each.seed) for each in asked} == {
        ("static", 2),
        ("line", 0),
        ("line", 1),
        ("line", 2),
    }


def test_a_row_that_is_deleted_is_flown_again(tmp_path: Path, asked: list[CampaignRun]) -> None:
    run(options(tmp_path, runs=3))
    lines = (tmp_path / CSV_NAME).read_text().splitlines(keepends=True)
    (tmp_path / CSV_NAME).write_text("".join(line for line in lines if not line.startswith("static,1,")))
    asked.clear()
    run(options(tmp_path, runs=3))
    assert [each.seed for each in asked] == [1]


def test_without_a_folder_nothing_is_kept(
    tmp_path: Path, asked: list[CampaignRun], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    code, text = run(options(None))
    assert (code, len(asked), list(tmp_path.iterdir())) == (0, 2, [])
    assert "tables and plots in" not in text


# ---------------------------------------------------------------- runs that fail


def test_a_run_that_fails_has_a_row_and_the_status_says_so(tmp_path: Path, asked: list[CampaignRun]) -> None:
    code, text = run(options(tmp_path, first_seed=DIES - 1))
    assert code == 1
    failed = next(each for each in read_rows(tmp_path / CSV_NAME) if each.seed == DIES)
    assert (failed.outcome, failed.error) == ("failed", f"killed by SIGKILL: last words of {DIES}")
    assert f"companion --sitl --fast --scenario static --seed {DIES}" in text


def test_a_run_that_misses_is_no_failure_but_breaks_the_bars(
    tmp_path: Path, asked: list[CampaignRun]
) -> None:
    assert run(options(tmp_path, first_seed=MISSES, runs=1))[0] == 0
    code, text = run(options(tmp_path, first_seed=MISSES, runs=1, bars=True))
    assert code == 1
    assert text.splitlines()[-1].startswith("bars: landed 0 of 1 FAILS, ")


def test_bars_that_hold_end_in_0(tmp_path: Path, asked: list[CampaignRun]) -> None:
    code, text = run(options(tmp_path, runs=5, bars=True))
    assert code == 0
    assert "FAILS" not in text.splitlines()[-1]


def test_a_refusal_of_the_apps_ends_it_with_what_is_flown_kept(
    tmp_path: Path, asked: list[CampaignRun]
) -> None:
    chosen = options(tmp_path, first_seed=IS_REFUSED, runs=1)
    with pytest.raises(ConfigError, match=r"a\.yaml: no"):
        run(chosen)
    assert seeds(tmp_path) == []


# ---------------------------------------------------------------- progress


def test_a_log_gets_a_line_a_tenth_and_every_run_that_did_not_land() -> None:
    out = io.StringIO()
    with CampaignMeter(Console(file=out, width=80), [row(seed=0)], 41, quiet=True) as meter:
        for seed in range(1, 41):
            meter.take(row(seed=seed, outcome="aborted" if seed == 20 else "landed", reason="why"))
    lines = out.getvalue().splitlines()
    assert lines[-1] == "41 of 41 runs, 40 landed (98 %)"
    assert [line for line in lines if " of 41 runs" not in line] == [
        "aborted: why: companion --scenario static --seed 20"
    ]
    assert len(lines) == 11


def test_a_terminal_gets_a_bar_with_the_landings() -> None:
    out = io.StringIO()
    console = Console(file=out, width=100, force_terminal=True)
    with CampaignMeter(console, [], 4, quiet=False) as meter:
        meter.take(row(seed=0))
    assert "1/4" in out.getvalue()
    assert "1 landed (100 %)" in out.getvalue()
