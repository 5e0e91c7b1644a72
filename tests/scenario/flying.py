"""Flights as a user starts them: the command in a process of its own, with its exit code and its files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from companion.config import CONFIG_FOLDER, merge

COMMAND = (sys.executable, "-m", "companion.cli")
# a flight of a minute takes a quarter of it in virtual time; the rest is for a busy machine
FLIGHT_TIMEOUT_S = 300.0
ROOT = CONFIG_FOLDER.parent


@dataclass(frozen=True)
class Flown:
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


def run(*arguments: str | Path, result: Path | None = None, variables: dict[str, str] | None = None) -> Flown:
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
    content = None if result is None or not result.exists() else json.loads(result.read_text())
    return Flown(words, done.returncode, done.stdout, done.stderr, content)


def fly(scenario: str | Path, seed: int, folder: Path, *options: str | Path) -> Flown:
    """Fly a scenario in virtual time; its result is left in `folder`."""
    path = folder / f"result-{Path(scenario).stem}-{seed}.json"
    where = ("--sitl", "--fast", "--no-ui", "--scenario", scenario, "--seed", str(seed), "--json", path)
    return run(*where, *options, result=path)


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
