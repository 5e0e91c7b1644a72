"""The command line's small decisions."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from companion.app.command import EXIT_CODES
from companion.base.messages import Outcome
from companion.config import CONFIG_FOLDER


def test_every_outcome_has_an_exit_code_of_its_own() -> None:
    assert EXIT_CODES.keys() == set(Outcome)
    assert len(set(EXIT_CODES.values())) == len(Outcome)
    assert EXIT_CODES[Outcome.LANDED] == 0


HEAVY = {
    "aiohttp",
    "cv2",
    "numpy",
    "scipy",
    "osqp",
    "pymavlink",
    "mavsdk",
    "matplotlib",
    "skfuzzy",
    "filterpy",
}
MOST_MODULES = 400  # Typer, pydantic beneath it and the standard library need some 270


NOT_FOUND = {
    "companion": [
        ["nope"],
        ["--config", "nope.yaml"],
        ["--sitl", "--scenario", "nope"],
        ["--sitl", "--config", "nope.yaml"],
        ["check", "--config", "nope.yaml"],
        ["check", "--pad", "--config", "nope.yaml"],
        ["detect", "nope.jpg"],
        ["detect", "photo.png", "--pad", "nope"],
        ["detect", "photo.png", "--camera", "nope.yaml"],
        ["fuzzy", "nope"],
        ["identify", "nope"],
        ["identify", "photo.png", "--check", "nope"],
        ["logs", "convert", "nope"],
        ["logs", "export", "nope"],
        ["logs", "repair", "nope"],
        ["pad", "nope"],
        ["pad", "--coverage", "--camera", "nope"],
        ["replay", "nope"],
        ["replay", "photo.png", "--config", "nope.yaml"],
        ["report", "nope"],
    ],
    "companion-sitl": [
        ["nope"],
        ["--scenario", "nope"],
        ["scenarios", "nope"],
        ["campaign", "--scenarios", "line", "nope"],
        ["campaign", "--config", "nope.yaml"],
        ["hand-held", "--motion", "still", "--scenario", "nope"],
        ["hold", "--motion", "still", "--scenario", "nope"],  # its earlier name, for scripts
        ["view", "nope"],
    ],
    "python -m experiments": [
        ["nope"],
        ["fig13", "--scenario", "nope"],
        ["profiles", "--scenario", "nope"],
        ["pad-recall", "--camera", "nope"],
        ["table1", "--pad", "nope"],
        ["fig14", "--case", "nope"],
        ["fig14", "--nope"],
    ],
    "calibrate-camera": [["nope"]],
    "calibrate-magnetometer": [["nope"], ["photo.png", "--config", "nope.yaml"]],
    "calibrate-mount": [
        ["nope"],
        ["accelerometer", "nope.csv"],
        ["camera", "nope"],
        ["camera", "photo.png", "--camera", "nope"],
        ["gyro", "--config", "nope.yaml"],
        ["record", "swayed", "--config", "nope.yaml"],
    ],
}
MODULES = {
    "companion": "companion.cli",
    "companion-sitl": "sitl.cli",
    "python -m experiments": "experiments.command",
    "calibrate-camera": "calibration.camera.command",
    "calibrate-magnetometer": "calibration.magnetometer.command",
    "calibrate-mount": "calibration.mount.command",
}
SCRIPT = """
import importlib, json, sys
program, module, runs = json.loads(sys.argv[1])
main = importlib.import_module(module).main
for words in runs:
    sys.argv = [program, *words]
    try:
        main()
    except SystemExit as end:
        print(json.dumps([words, end.code, sorted(sys.modules)]))
"""


def ended(program: str, runs: list[list[str]], folder: Path) -> list[tuple[list[str], int, set[str]]]:
    """The runs of a program one after another in one process: words, exit code, modules imported by then."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, json.dumps([program, MODULES[program], runs])],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(CONFIG_FOLDER.parent)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[[")]
    assert len(lines) == len(runs), done.stderr
    return [(words, code, set(modules)) for words, code, modules in lines]


@pytest.mark.parametrize("program", MODULES)
def test_help_and_version_import_no_library_of_the_flight(program: str, tmp_path: Path) -> None:
    for words, code, modules in ended(program, [["--help"], ["--version"]], tmp_path):
        assert (words, code, modules & HEAVY) == (words, 0, set())
        assert len(modules) < MOST_MODULES


@pytest.mark.parametrize("program", NOT_FOUND)
def test_what_is_not_found_is_reported_before_anything_heavy_is_imported(
    program: str, tmp_path: Path
) -> None:
    (tmp_path / "photo.png").touch()
    # modules add up from run to run, so what one imports is still seen after the last
    for words, code, modules in ended(program, NOT_FOUND[program], tmp_path):
        assert (words, code, modules & HEAVY) == (words, 2, set())
        assert len(modules) < MOST_MODULES
