"""Our programs in this process, which saves the imports of one more: the fixture `program` of conftest.py."""

import sys
from dataclasses import dataclass
from importlib import import_module
from typing import Final, Protocol
from unittest.mock import patch

import pytest

MODULES: Final = {
    "companion": "companion.cli",
    "companion-sitl": "sitl.cli",
    "calibrate-camera": "calibration.camera.command",
    "calibrate-magnetometer": "calibration.magnetometer.command",
    "calibrate-mount": "calibration.mount.command",
    "python -m experiments": "experiments.command",
}


@dataclass(frozen=True)
class EndedProgram:
    """Exit code, standard output and standard error."""

    code: int
    out: str
    err: str

    @property
    def refusal(self) -> str:
        """The one line of a command that was refused."""
        assert (self.code, self.out) == (2, ""), self
        assert self.err.count("\n") == 1, self
        return self.err


class ProgramHere(Protocol):
    """Runs a program by its name, with these words, until it exits."""

    def __call__(self, name: str, *words: object) -> EndedProgram:
        """The words may be paths and numbers."""


def exit_code(name: str, *words: object) -> int:
    """How a program ends that is run in this process, with these words."""
    with patch.object(sys, "argv", [name, *map(str, words)]), pytest.raises(SystemExit) as ended:
        import_module(MODULES[name]).main()
    return int(ended.value.code or 0)


def program_here(captured: pytest.CaptureFixture[str]) -> ProgramHere:
    """For the fixture."""

    def run(name: str, *words: object) -> EndedProgram:
        code, said = exit_code(name, *words), captured.readouterr()
        return EndedProgram(code, said.out, said.err)

    return run
