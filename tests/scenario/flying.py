"""Flights as a user starts them: the command with its exit code and its files.

`run` is a process of its own; `fly` runs the same command in this process, which saves seconds of imports.
That it is the same flight, to the bit, test_docs.py shows.
"""

import fcntl
import gc
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import pytest
import yaml

from companion.base.command_line import run_program
from companion.cli import PROGRAM, cli
from companion.config import CONFIG_FOLDER, merge
from companion.flightlog.record import FlightLog
from companion.sim.runner import SitlFlight
from companion.sim.runner import fly as fly_here
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial

COMMAND = (sys.executable, "-m", "companion.cli")
# a flight of a minute takes a quarter of it in virtual time; the rest is for a busy machine
FLIGHT_TIMEOUT_S = 300.0
ROOT = CONFIG_FOLDER.parent
# of the flights that tests share the one that is recorded
RECORDED: Final = ("static", 0)
RECORD, FLOWN = Path("flights") / "first", "flown.json"
# changes to a scenario whose flight is not about vision: drawing and reading pictures takes 40 % of its time
FEW_PICTURES: Final[dict[str, Any]] = {"camera": {"rate_hz": 10.0}}


@dataclass(frozen=True)
class FlownCommand:
    """How a command ended. `str()` of it says what repeats it and what it said."""

    arguments: tuple[str, ...]
    code: int
    stdout: str
    stderr: str
    result: dict[str, Any] | None

    def __str__(self) -> str:
        command = f"companion {' '.join(self.arguments)}"
        return f"{command}\nexit code {self.code}: {self.stderr.strip()}\n{self.stdout}"

    @property
    def landing(self) -> dict[str, Any]:
        """The result of a flight that must have landed."""
        assert self.code == 0, self
        assert self.result is not None, self
        assert self.result["outcome"] == "landed", self
        return self.result


def run(
    *arguments: str | Path, result: Path | None = None, variables: dict[str, str] | None = None
) -> FlownCommand:
    """Run `companion` with these arguments (and environment variables) to its end."""
    words = tuple(str(argument) for argument in arguments)
    done = subprocess.run(
        (*COMMAND, *words),
        cwd=ROOT,
        env=environment() | (variables or {}),
        capture_output=True,
        text=True,
        timeout=FLIGHT_TIMEOUT_S,
        check=False,
    )
    return FlownCommand(words, done.returncode, done.stdout, done.stderr, read_result(result))


def read_result(path: Path | None) -> dict[str, Any] | None:
    """A result file's content, if there is one."""
    return None if path is None or not path.exists() else json.loads(path.read_text())


def run_here(*arguments: str | Path, result: Path | None = None) -> FlownCommand:
    """Run `companion` in this process."""
    words = tuple(str(argument) for argument in arguments)
    with (
        redirect_stdout(io.StringIO()) as stdout,
        redirect_stderr(io.StringIO()) as stderr,
        patch.dict(os.environ, environment()),
        pytest.raises(SystemExit) as ended,
    ):
        run_program(cli, PROGRAM, words)
    gc.collect()  # a flight's tasks refer to one another: its world of 30 MB goes now, or many pile up
    assert isinstance(ended.value.code, int)
    return FlownCommand(words, ended.value.code, stdout.getvalue(), stderr.getvalue(), read_result(result))


def flight_words(scenario: str | Path, seed: int, result: Path) -> tuple[str | Path, ...]:
    """The arguments of a flight in virtual time that leaves its result in a file."""
    return ("--sitl", "--fast", "--no-ui", "--scenario", scenario, "--seed", str(seed), "--json", result)


def fly(scenario: str | Path, seed: int, folder: Path, *options: str | Path) -> FlownCommand:
    """Fly a scenario in virtual time, in this process; its result is left in `folder`."""
    path = folder / f"result-{Path(scenario).stem}-{seed}.json"
    return run_here(*flight_words(scenario, seed, path), *options, result=path)


def fly_logged(scenario: str | Path, log: FlightLog | None = None) -> tuple[SitlFlight, FlightLog]:
    """Fly a scenario in virtual time under seed 0, in this process; with its log, which stays in memory."""
    trial = Trial.load(str(scenario), 0)
    log = log or FlightLog(None, start_unix_s=0.0)
    settings = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    return fly_here(settings, trial, log, lambda _status: None, fast=True), log


def notices(log: FlightLog) -> str:
    """What the app said in a flight, a line each."""
    return "\n".join(notice.text for notice in log.kept["notice"])


class SharedFlights:
    """Flights of shipped scenarios that tests of several files look at: each is flown once in a run.

    A lock on a file beside lets the other workers wait for the one that flies it.
    """

    def __init__(self, folder: Path) -> None:
        """`folder` is there, and the same for all workers."""
        self._folder = folder

    def flown(self, scenario: str, seed: int) -> FlownCommand:
        """A flight in virtual time."""
        if (scenario, seed) == RECORDED:
            return self.recorded()[1]
        folder = self._once(f"{scenario}-{seed}", lambda folder: fly(scenario, seed, folder))
        return read_flown(folder)

    def recorded(self) -> tuple[Path, FlownCommand]:
        """The folder that `--record` made, and the flight: as a user flies it, in a process of its own."""

        def record(folder: Path) -> FlownCommand:
            result = folder / "result.json"
            return run(*flight_words(*RECORDED, result), "--record", folder / RECORD, result=result)

        folder = self._once("recorded", record)
        return folder / RECORD, read_flown(folder)

    def _once(self, name: str, make: Callable[[Path], FlownCommand]) -> Path:
        folder = self._folder / name
        with (self._folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (folder / FLOWN).exists():
                folder.mkdir(exist_ok=True)
                flown = json.dumps(asdict(make(folder)))
                (folder / FLOWN).write_text(flown)
        return folder


def read_flown(folder: Path) -> FlownCommand:
    """The flight that a worker left in a folder."""
    kept = json.loads((folder / FLOWN).read_text())
    return FlownCommand(**(kept | {"arguments": tuple(kept["arguments"])}))


def figures(flight: FlownCommand) -> dict[str, Any]:
    """The result of a flight but for what depends on the machine."""
    assert flight.result is not None, flight
    result = dict(flight.result)
    assert result.pop("sim").keys() == {"real_time_factor"}
    return result


def environment() -> dict[str, str]:
    """The environment of a user whose terminal is wide."""
    return {**os.environ, "COLUMNS": "200", "OPENBLAS_NUM_THREADS": "1"}


def scenario_file(folder: Path, base: str, changes: dict[str, Any]) -> Path:
    """A shipped scenario with changes, as a file."""
    shipped = yaml.safe_load((CONFIG_FOLDER / "scenarios" / f"{base}.yaml").read_text())
    path = folder / f"{base}_changed.yaml"
    path.write_text(yaml.safe_dump(merge(shipped, {"name": f"{base}_changed", **changes})))
    return path


@contextmanager
def started(
    *arguments: str | Path, variables: dict[str, str] | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A running `companion`; killed at the end if it has not ended by then."""
    process = subprocess.Popen(
        (*COMMAND, *(str(argument) for argument in arguments)),
        cwd=ROOT,
        env=environment() | {"PYTHONUNBUFFERED": "1"} | (variables or {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_for_line(process: subprocess.Popen[str], words: str) -> str:
    """Read the standard output up to a line that holds `words`; returns all of it."""
    assert process.stdout is not None
    seen = ""
    for line in process.stdout:
        seen += line
        if words in line:
            return seen
    raise AssertionError(f"'{words}' was not said in:\n{seen}")


def children(pid: int) -> list[int]:
    """The processes that a process has started and that are alive."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def alive(pid: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
