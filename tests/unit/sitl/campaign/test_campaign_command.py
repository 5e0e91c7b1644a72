"""`companion-sitl campaign`: what it leaves, tells and returns, and how it goes on."""

import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import pytest
from rich.console import Console

from companion.config import CONFIG_FOLDER, ConfigError
from sitl.campaign import SCENARIOS
from sitl.campaign import run as running
from sitl.campaign.manifest import CampaignRun
from sitl.campaign.plots import write_plots
from sitl.campaign.rows import CSV_NAME, RunsFile, read_rows
from sitl.campaign.run import INTERRUPTED, CampaignMeter, Options, run_campaign
from sitl.campaign.worker import RunResult, Worker, fly_locally
from tests.programs import ProgramHere, exit_code
from tests.scenario.flying import alive
from tests.unit.sitl.campaign.campaign_parts import PLOTS, row, scenario_file
from tests.unit.sitl.campaign.fake_flights import COMMAND, DIES, HANGS, IS_REFUSED, MISSES
from tests.waiting import soon


def options(
    folder: Path | None, *sources: str, first_seed: int = 0, runs: int = 2, bars: bool = False
) -> Options:
    return Options(sources or ("static",), runs, first_seed, 2, folder, None, None, bars, quiet=True)


def run(chosen: Options) -> tuple[int, str]:
    out = io.StringIO()
    code = run_campaign(chosen, Console(file=out, width=80))
    return code, out.getvalue()


def seeds(folder: Path) -> list[int]:
    return [each.seed for each in read_rows(folder / CSV_NAME)]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[CampaignRun]:
    """Stand-ins fly and nothing is drawn, which takes seconds; what was asked for is kept."""
    monkeypatch.setattr("sitl.campaign.plots.write_plots", lambda *_: [])
    flights: list[CampaignRun] = []

    def fly(wanted: Sequence[CampaignRun], jobs: int) -> Iterator[RunResult]:
        flights.extend(wanted)
        return fly_locally(wanted, jobs, partial(Worker, COMMAND))

    monkeypatch.setattr(running, "fly_locally", fly)
    return flights


# ---------------------------------------------------------------- from start to end


def test_a_campaign_leaves_rows_tables_and_plots(
    tmp_path: Path, asked: list[CampaignRun], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sitl.campaign.plots.write_plots", write_plots)
    folder = tmp_path / "new" / "deep"
    code, text = run(options(folder, "static", "line"))
    assert code == 0
    assert {path.name for path in folder.iterdir()} - {"runs.parquet"} == PLOTS | {
        "campaign.json",
        CSV_NAME,
        "summary.txt",
    }
    assert len(read_rows(folder / CSV_NAME)) == len(asked) == 4
    assert "100 % (51.0 to 100.0)" in text
    assert "100 % (51.0 to 100.0)" in (folder / "summary.txt").read_text()


def test_the_command_again_flies_only_what_has_no_row(tmp_path: Path, asked: list[CampaignRun]) -> None:
    def flown(*sources: str, runs: int = 2) -> tuple[set[tuple[str, int]], str]:
        asked.clear()
        code, text = run(options(tmp_path, *sources, runs=runs))
        assert code == 0
        return {(each.scenario, each.seed) for each in asked}, text.partition("How the runs ended")[2]

    _, first = flown()
    assert flown() == (set(), first)  # and tells the same
    lines = (tmp_path / CSV_NAME).read_text().splitlines(keepends=True)
    (tmp_path / CSV_NAME).write_text("".join(line for line in lines if not line.startswith("static,1,")))
    assert flown()[0] == {("static", 1)}
    assert flown("static", "line", runs=3)[0] == {("static", 2), ("line", 0), ("line", 1), ("line", 2)}


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


def test_a_run_that_misses_is_no_failure_but_breaks_the_bars_which_else_hold(
    tmp_path: Path, asked: list[CampaignRun]
) -> None:
    assert run(options(tmp_path, first_seed=MISSES, runs=1))[0] == 0
    code, text = run(options(tmp_path, first_seed=MISSES, runs=1, bars=True))
    assert code == 1
    assert text.splitlines()[-1].startswith("bars: landed 0 of 1 FAILS, ")
    code, text = run(options(tmp_path / "good", runs=5, bars=True))
    assert code == 0
    assert "FAILS" not in text.splitlines()[-1]


def test_a_refusal_of_the_apps_ends_it_with_what_is_flown_kept(
    tmp_path: Path, asked: list[CampaignRun]
) -> None:
    with pytest.raises(ConfigError, match=r"a\.yaml: no"):
        run(options(tmp_path, first_seed=IS_REFUSED, runs=1))
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


# ---------------- `companion-sitl campaign`: what it refuses, in one line


def refused(program: ProgramHere, *words: object) -> str:
    """The one line of a command that exits with 2."""
    return program("companion-sitl", "campaign", *words).refusal


def test_a_folder_of_another_campaign_or_that_another_writes_is_refused_and_stays(
    tmp_path: Path, asked: list[CampaignRun], program: ProgramHere
) -> None:
    run(options(tmp_path))
    before = [(tmp_path / name).read_bytes() for name in (CSV_NAME, "campaign.json")]
    line = refused(program, "--scenarios", "line", "--runs", "2", "--out", tmp_path)
    assert line.startswith(f"companion-sitl: --out {tmp_path}: holds another campaign: it flies 'static' too")
    held = RunsFile(tmp_path)
    assert "another campaign writes it" in refused(program, "--scenarios", "static", "--out", tmp_path)
    held.close()
    assert [(tmp_path / name).read_bytes() for name in (CSV_NAME, "campaign.json")] == before


@pytest.mark.parametrize("wrong", ["static,0,", "elsewhere,0,"])
def test_rows_that_come_twice_or_from_elsewhere_are_refused(
    wrong: str, tmp_path: Path, asked: list[CampaignRun], program: ProgramHere
) -> None:
    run(options(tmp_path))
    path = tmp_path / CSV_NAME
    first = next(line for line in path.read_text().splitlines() if line.startswith("static,0,"))
    path.write_text(path.read_text() + first.replace("static,0,", wrong) + "\n")
    line = refused(program, "--scenarios", "static", "--runs", "2", "--out", tmp_path)
    assert "runs.csv:4: " in line
    assert "expected one row a run" in line


def test_rows_without_a_manifest_are_refused(tmp_path: Path, program: ProgramHere) -> None:
    held = RunsFile(tmp_path)
    held.append(row())
    held.close()
    assert "without its campaign.json" in refused(program, "--scenarios", "static", "--out", tmp_path)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scenarios", "nosuch"], "scenarios: no 'nosuch'"),
        (["--scenarios", "static", "nosuch"], "scenarios: no 'nosuch'"),
        (["--runs", "0"], "--runs"),
        (["--jobs", "0"], "--jobs"),
        (["--config", "nosuch.yaml"], "nosuch.yaml: cannot be read"),
        (["--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"], "--jobs: the cluster has its own"),
        (["--out", "/dev/null/here"], "--out /dev/null/here: cannot be made"),
    ],
)
def test_what_a_user_gets_wrong_is_one_line(words: list[str], said: str, program: ProgramHere) -> None:
    assert said in refused(program, *words)


def test_without_dask_the_line_names_the_extra(
    tmp_path: Path, program: ProgramHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "sitl.campaign.cluster", raising=False)
    line = refused(program, "--scenarios", "static", "--scheduler", "tcp://127.0.0.1:1", "--out", tmp_path)
    assert "needs Dask" in line
    assert "pip install 'companion-landing[campaign]'" in line


def test_the_words_of_the_command_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[Options] = []

    def take(chosen: Options, _console: Console) -> int:
        taken.append(chosen)
        return 0

    monkeypatch.setattr(running, "run_campaign", take)
    for words in ("--scenarios line circle --runs 3 --bars", "--quiet --first-seed 7"):
        assert exit_code("companion-sitl", "campaign", *words.split()) == 0
    first, second = taken
    assert (first.sources, first.runs, first.bars, first.folder) == (("line", "circle"), 3, True, None)
    assert first.jobs == len(os.sched_getaffinity(0))
    assert (second.sources, second.first_seed, second.quiet) == (SCENARIOS, 7, True)


def test_what_goes_on_is_the_command_that_was_given(tmp_path: Path) -> None:
    path = scenario_file(tmp_path, "my barge")
    chosen = Options((str(path),), 3, 0, 2, Path("out"), Path("a.yaml"), "tcp://h:1", bars=True, quiet=False)
    assert chosen.command == (
        f"companion-sitl campaign --scenarios '{path}' --runs 3 --out out --config a.yaml "
        "--scheduler tcp://h:1 --bars"
    )


# ---------------- `companion-sitl campaign` that is killed or interrupted: nothing is lost, and it goes on


def started(folder: Path, *words: str) -> subprocess.Popen[str]:
    """A campaign that flies up to the run that hangs, 22 rows on."""
    process = subprocess.Popen(
        (
            *(sys.executable, "-m", "tests.unit.sitl.campaign.fake_campaign"),
            *("campaign", "--scenarios", "static"),
            *("--first-seed", str(HANGS - 22), "--runs", "25", "--jobs", "1", "--out", str(folder), *words),
        ),
        cwd=CONFIG_FOLDER.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        # tests started in a script's background have it ignored, and so would all that they start
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509 - no threads here
    )
    path = folder / CSV_NAME
    assert soon(lambda: path.exists() and path.read_text().count("\n") == 23, 60.0)
    return process


def workers_of(process: subprocess.Popen[str]) -> list[int]:
    tasks = Path(f"/proc/{process.pid}/task").iterdir()
    return [int(pid) for task in tasks for pid in (task / "children").read_text().split()]


def test_killed_it_has_lost_nothing_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    process = started(tmp_path)
    process.kill()
    process.communicate()
    expected = list(range(HANGS - 22, HANGS))
    assert seeds(tmp_path) == expected
    with (tmp_path / CSV_NAME).open("a") as stream:
        stream.write(f"static,{HANGS},lan")
    flown: list[int] = []

    def fly(wanted: Sequence[CampaignRun], _jobs: int) -> Iterator[RunResult]:
        for each in wanted:
            flown.append(each.seed)
            yield RunResult(each, 1.0, error="not flown")

    monkeypatch.setattr(running, "fly_locally", fly)
    monkeypatch.setattr("sitl.campaign.plots.write_plots", lambda *_: [])
    run(options(tmp_path, first_seed=HANGS - 22, runs=25))
    assert flown == [HANGS, HANGS + 1, HANGS + 2]
    assert seeds(tmp_path) == expected + flown


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_it_ends_cleanly_and_says_how_to_go_on(number: signal.Signals, tmp_path: Path) -> None:
    process = started(tmp_path)
    workers = workers_of(process)
    assert workers
    process.send_signal(number)
    text = process.communicate(timeout=30.0)[0]
    assert process.returncode == INTERRUPTED
    assert f"stopped: 22 of 25 runs are in {tmp_path}/{CSV_NAME}; to continue:" in text
    assert text.splitlines()[-1] == (
        f"  companion-sitl campaign --scenarios static --runs 25 --first-seed {HANGS - 22} "
        f"--jobs 1 --out {tmp_path}"
    )
    assert "Traceback" not in text
    assert len(seeds(tmp_path)) == 22
    assert not any(alive(pid) for pid in workers)
