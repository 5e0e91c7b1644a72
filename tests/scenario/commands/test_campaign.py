"""Campaigns by the command a user types, flown by the app itself."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from sitl.campaign.rows import CSV_NAME, RESULT_KEYS, Row, read_rows
from tests.scenario.flying import COMMAND, FLIGHT_TIMEOUT_S, ROOT, SharedFlights, environment, scenario_file

pytestmark = pytest.mark.slow


def campaign(*words: str | int | Path) -> subprocess.CompletedProcess[str]:
    """Run `companion-sitl campaign` to its end."""
    return subprocess.run(
        (sys.executable, "-m", "sitl.cli", "campaign", *map(str, words)),
        cwd=ROOT,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=FLIGHT_TIMEOUT_S,
        check=False,
    )


def figures(row: Row) -> dict[str, Any]:
    """What a row has of the flight's result, but for what depends on the machine."""
    kept = row.model_dump(include={"scenario", "seed", "outcome", "reason", *RESULT_KEYS})
    return {name: value for name, value in kept.items() if name != "real_time_factor"}


def expected(result: dict[str, Any]) -> dict[str, Any]:
    """The same of a result file."""
    values = {
        "scenario": result["scenario"],
        "seed": result["seed"],
        "outcome": result["outcome"],
        "reason": "",
    }
    for name, key in RESULT_KEYS.items():
        part, _, field = key.partition(".")
        values[name] = result[part][field]
    del values["real_time_factor"]
    return values


def test_a_row_is_the_flight_that_its_command_flies(tmp_path: Path, shared_flights: SharedFlights) -> None:
    # one process flies another flight first: nothing of it may be left
    cut = scenario_file(tmp_path, "figure_8", {"time_limit_s": 6.0})
    done = campaign("--scenarios", cut, "static", "--runs", 1, "--jobs", 1, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    first, second = read_rows(tmp_path / "out" / CSV_NAME)
    assert (first.scenario, first.outcome, first.reason) == (
        "figure_8_changed",
        "timeout",
        "never touched down",
    )
    assert second.command == "companion --sitl --fast --scenario static --seed 0"
    assert figures(second) == expected(shared_flights.flown("static", 0).landing)
    along, across, off = second.touchdown_along_m, second.touchdown_across_m, second.touchdown_lateral_m
    assert along is not None
    assert across is not None
    assert (along**2 + across**2) ** 0.5 == pytest.approx(off, abs=2e-6)


def test_what_the_app_refuses_is_one_line(tmp_path: Path) -> None:
    # the scenario by itself is right: only the app knows that the two do not go together
    path = scenario_file(tmp_path, "static", {"companion": {"camera": str(other_camera(tmp_path))}})
    done = campaign("--scenarios", path, "--runs", 3, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "expected the same size" in done.stderr
    assert read_rows(tmp_path / "out" / CSV_NAME) == []


def test_a_process_ends_with_its_input_whatever_it_flies() -> None:
    done = subprocess.run(
        (*COMMAND, "flights"),
        cwd=ROOT,
        env=environment(),
        input='{"scenario": "static", "seed": 0}\n',
        capture_output=True,
        text=True,
        timeout=FLIGHT_TIMEOUT_S,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


def other_camera(folder: Path) -> Path:
    """A camera of another size."""
    path = folder / "wide.yaml"
    text = (ROOT / "configs" / "cameras" / "sitl_640x480.yaml").read_text()
    path.write_text(text.replace("width_px: 640", "width_px: 600"))
    return path


CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


def test_a_cluster_of_other_processes_flies(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    program = tmp_path / "cluster.py"
    program.write_text(CLUSTER)
    cut = scenario_file(tmp_path, "line", {"time_limit_s": 5.0})
    cluster = subprocess.Popen(
        (sys.executable, str(program)),
        cwd=ROOT,
        env={**environment(), "PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with cluster:
        assert cluster.stdout is not None
        address = cluster.stdout.readline().strip()
        done = campaign("--scenarios", cut, "--runs", 1, "--scheduler", address, "--out", tmp_path / "out")
        cluster.communicate()
    assert done.returncode == 0, done.stderr
    (row,) = read_rows(tmp_path / "out" / CSV_NAME)
    assert (row.scenario, row.outcome, row.error) == ("line_changed", "timeout", "")
    assert row.total_s == pytest.approx(5.0, abs=0.2)
    assert row.frames is not None
    assert row.frames > 20, "five pictures a second are searched on the ground"
