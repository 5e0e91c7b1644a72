"""`companion-sitl campaign` that is killed or interrupted: nothing is lost, and it goes on."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from companion.config import CONFIG_FOLDER
from sitl.campaign import run as running
from sitl.campaign.manifest import CampaignRun
from sitl.campaign.rows import CSV_NAME
from sitl.campaign.run import INTERRUPTED
from sitl.campaign.worker import RunResult
from tests.unit.sitl.campaign.campaign_command import options, run, seeds
from tests.unit.sitl.campaign.fake_flights import HANGS


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
    wait(lambda: path.exists() and path.read_text().count("\n") == 23)
    return process


def wait(until: Callable[[], bool], timeout_s: float = 60.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not until():
        assert time.monotonic() < end_s, "it did not come"
        time.sleep(0.02)


def workers_of(process: subprocess.Popen[str]) -> list[int]:
    tasks = Path(f"/proc/{process.pid}/task").iterdir()
    return [int(pid) for task in tasks for pid in (task / "children").read_text().split()]


def gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def test_killed_it_has_lost_nothing_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    process = started(tmp_path)
    process.kill()
    process.communicate()
    expected = list(range(HANGS - 22, HANGS))
    assert seeds(tmp_path) == expected
    with (tmp_path / CSV_NAME).open("a") as stream:
        stream.write(f"static,{HANGS},lan")
    flown: list[CampaignRun] = []

    def fly(wanted: Sequence[CampaignRun], _jobs: int) -> Iterator[RunResult]:
        flown.extend(wanted)
        for each in wanted:
            yield RunResult(each, 1.0, error="not flown")

    monkeypatch.setattr(running, "fly_locally", fly)
    monkeypatch.setattr("sitl.campaign.plots.write_plots", lambda *_: [])
    run(options(tmp_path, first_seed=HANGS - 22, runs=25))
    assert [each.seed for each in flown] == [HANGS, HANGS + 1, HANGS + 2]
    assert seeds(tmp_path) == [*expected, HANGS, HANGS + 1, HANGS + 2]


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
    assert all(gone(pid) for pid in workers)
