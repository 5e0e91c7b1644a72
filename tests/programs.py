"""Our programs in this process, which saves the imports of one more: the fixture `program` of conftest.py."""

import sys
from dataclasses import dataclass
from importlib import import_module
from typing import Final, Protocol

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


def program_here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> ProgramHere:
    """For the fixture."""

    def run(name: str, *words: object) -> EndedProgram:
        monkeypatch.setattr(sys, "argv", [name, *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            import_module(MODULES[name]).main()
        said = capsys.readouterr()
        return EndedProgram(int(ended.value.code or 0), said.out, said.err)

    return run
