"""All programs end alike: one line, the right help, no traceback, whatever becomes of the output."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from companion import __version__
from companion.base.clock import sleep_s
from companion.base.command_line import PIPE_CLOSED, Ending, new_app, run_program
from companion.config import CONFIG_FOLDER, ConfigError
from tests.programs import MODULES, EndedProgram, ProgramHere


@pytest.mark.parametrize("name", MODULES)
def test_every_program_has_version_help_and_completion(name: str, program: ProgramHere) -> None:
    assert program(name, "--version") == EndedProgram(0, f"{__version__}\n", "")
    ended = program(name, "-h")
    assert (ended.code, ended) == (0, program(name, "--help"))
    short = ended.out
    # a shell completes the words of a program, not of a module that Python runs
    completion = () if name.startswith("python") else ("--install-completion", "--show-completion")
    for option in ("-h, --help", "--version", *completion):
        assert option in short
    assert short.startswith(f"Usage: {name} ")
    for line in short.partition("\nCommands:\n")[2].split("\n"):
        if line.startswith("  ") and not line.startswith("   "):
            ended = program(name, line.split()[0], "-h")
            assert ended.code == 0
            short += ended.out
    assert [line for line in short.splitlines() if len(line) > 80] == []


@pytest.mark.parametrize(
    ("name", "words", "asked"),
    [
        ("companion", ["--wings"], "companion"),
        ("companion", ["pad", "--wings"], "companion pad"),
        ("companion", ["pad", "moving_1300", "--tilt", "x"], "companion pad"),
        ("companion-sitl", ["campaign", "--wings"], "companion-sitl campaign"),
        ("companion-sitl", ["hand-held"], "companion-sitl hand-held"),
        ("python -m experiments", ["fig13", "--wings"], "python -m experiments fig13"),
        ("python -m experiments", ["fig99"], "python -m experiments"),
        ("calibrate-camera", ["--wings"], "calibrate-camera"),
        ("calibrate-mount", ["camera"], "calibrate-mount camera"),
        ("calibrate-magnetometer", ["--time-limit", "x"], "calibrate-magnetometer"),
    ],
)
def test_a_wrong_option_points_to_the_help_of_its_own_command(
    name: str, words: list[str], asked: str, program: ProgramHere
) -> None:
    said = program(name, *words).refusal
    assert said.startswith(f"{name}: ")
    assert said.endswith(f"; see {asked} --help\n")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("companion", ["--config", "FOLDER"]),
        ("companion", ["detect", "PHOTO", "--config", "FOLDER"]),
        ("companion-sitl", ["campaign", "--config", "FOLDER", "--runs", "1"]),
        ("calibrate-mount", ["accelerometer", "--config", "FOLDER"]),
        ("calibrate-magnetometer", ["--config", "FOLDER"]),
    ],
)
def test_a_folder_where_a_file_is_wanted_is_said(
    name: str, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: ProgramHere
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("photo.png").touch()
    here = {"FOLDER": ".", "PHOTO": "photo.png"}
    assert "a folder; expected a" in program(name, *(here.get(word, word) for word in words)).refusal


@pytest.mark.parametrize("text", ["[" * 5000, "[" * 100_000, "{a: " * 200 + "}" * 200, "- " * 200])
def test_a_file_that_is_nested_too_deeply_is_named(text: str, tmp_path: Path, program: ProgramHere) -> None:
    path = tmp_path / "deep.yaml"
    path.write_text(text)
    refusal = program("companion", "--config", path).refusal
    assert refusal == f"companion: {path}: nested too deeply; expected settings\n"


def shell(command: str) -> subprocess.CompletedProcess[str]:
    """A command line of a shell, in which PROGRAM is `companion`."""
    program = f"'{sys.executable}' -m companion.cli"
    return subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command.replace('PROGRAM', program)}"],
        env={**os.environ, "PYTHONPATH": str(CONFIG_FOLDER.parent)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("words", ["--help", "--version", "pad", "pad --help"])
def test_a_full_disk_is_said_without_a_traceback(words: str) -> None:
    done = shell(f"PROGRAM {words} >/dev/full")
    assert done.returncode == 2
    assert done.stderr == "companion: the output cannot be written: No space left on device\n"


@pytest.mark.parametrize("words", ["--help", "--version", "pad", "fuzzy", "logs --record FOLDER"])
def test_a_reader_that_goes_away_ends_it_quietly(words: str, tmp_path: Path) -> None:
    reads, writes = os.pipe()
    os.close(reads)
    done = subprocess.run(
        [sys.executable, "-m", "companion.cli", *words.replace("FOLDER", str(tmp_path)).split()],
        env={**os.environ, "PYTHONPATH": str(CONFIG_FOLDER.parent)},
        stdout=writes,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
        check=False,
    )
    os.close(writes)
    assert (done.returncode, done.stderr) == (PIPE_CLOSED, "")


class OwnError(Exception):
    """An error of one program's own."""


def ending(problem: BaseException, capsys: pytest.CaptureFixture[str]) -> tuple[object, str]:
    """How a program ends whose command raises this: exit code and what it says."""
    app = new_app()

    @app.command()
    def command() -> None:
        raise problem

    with pytest.raises(SystemExit) as ended:
        run_program(app, "prog", [], endings={OwnError: Ending(7, "own: ")})
    return ended.value.code, capsys.readouterr().err


@pytest.mark.parametrize(
    ("problem", "code", "said"),
    [
        (ConfigError("x.yaml: wrong"), 2, "prog: x.yaml: wrong\n"),
        (ConfigError("x.yaml: unknown key 'a\nb'"), 2, "prog: x.yaml: unknown key 'a b'\n"),
        (OwnError("no luck"), 7, "prog: own: no luck\n"),
        (KeyboardInterrupt(), 130, "prog: interrupted\n"),
        (typer.Abort(), 130, "prog: interrupted\n"),
        # what pydantic makes of Ctrl-C while it builds a model
        (
            RuntimeError("Error building `literal` serializer:\n  KeyboardInterrupt: "),
            130,
            "prog: interrupted\n",
        ),
        (RecursionError(), 2, "prog: a file that it read is nested too deeply\n"),
        (FileNotFoundError(2, "No such file", "a.bin"), 2, "prog: a.bin: No such file\n"),
        (typer.Exit(5), 5, ""),
    ],
)
def test_each_kind_of_end(
    problem: BaseException, code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ending(problem, capsys) == (code, said)


class _Interrupted:
    """Its destructor meets Ctrl-C: Python would print that, and go on."""

    def __del__(self) -> None:
        raise KeyboardInterrupt


def test_ctrl_c_that_falls_into_a_destructor_ends_the_program(capsys: pytest.CaptureFixture[str]) -> None:
    app = new_app()

    @app.command()
    def command() -> None:
        thing = _Interrupted()
        del thing
        sleep_s(5.0)

    with pytest.raises(SystemExit) as ended:
        run_program(app, "prog", [])
    assert (ended.value.code, capsys.readouterr().err) == (130, "prog: interrupted\n")


@pytest.mark.parametrize("fault", [ZeroDivisionError(), ConnectionRefusedError(111, "Connection refused")])
def test_a_fault_of_ours_keeps_its_traceback(fault: Exception, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(type(fault)):
        ending(fault, capsys)


def test_completion_completes_commands_and_their_options() -> None:
    for words, expected in (("companion pa", ["pad"]), ("companion pad --pa", ["--paper"])):
        done = subprocess.run(
            [
                sys.executable,
                "-c",
                "import sys; sys.argv = ['companion']; from companion.cli import main; main()",
            ],
            env={
                **os.environ,
                "PYTHONPATH": str(CONFIG_FOLDER.parent),
                "_COMPANION_COMPLETE": "complete_bash",
                "COMP_WORDS": words,
                "COMP_CWORD": str(len(words.split()) - 1),
            },
            capture_output=True,
            text=True,
            timeout=60,
            check=True,
        )
        assert done.stdout.split() == expected
