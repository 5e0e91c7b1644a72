"""The deployment scripts, which fetch a Debian root: run where COMPANION_DEPLOY names a folder for them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from companion.config import load_config
from tests.deploy import pilot

HERE = Path(__file__).resolve().parent
SCRIPTS = sorted(path.name for path in HERE.glob("*.sh"))
SKIPPED = 77
LONGEST_S = 5400.0
FOLDER = os.environ.get("COMPANION_DEPLOY", "")


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_is_sound_bash_and_says_how_it_is_called(name: str) -> None:
    path = HERE / name
    done = subprocess.run(["bash", "-n", str(path)], capture_output=True, text=True, timeout=20, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert os.access(path, os.X_OK)
    assert f"sudo tests/deploy/{name} [FOLDER]" in path.read_text()


@pytest.mark.parametrize("name", SCRIPTS)
def test_without_what_it_needs_a_script_skips_in_one_line(name: str, tmp_path: Path) -> None:
    # no program at all but bash's own and what it is told apart by
    for program in ("dirname", "realpath", "id"):
        (tmp_path / program).symlink_to(str(shutil.which(program)))
    done = subprocess.run(
        ["/bin/bash", str(HERE / name), str(tmp_path / "work")],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=20,
        check=False,
    )
    assert done.returncode == SKIPPED, done.stderr
    (line,) = done.stdout.splitlines()
    assert line.startswith(f"{name.removesuffix('.sh')}: skipped: n")  # no ..., needs ...
    assert not (tmp_path / "work").exists()


def test_the_pilots_settings_lead_to_devices_that_are_plugged_in_later(tmp_path: Path) -> None:
    path = tmp_path / "companion.yaml"
    path.write_text(pilot.settings_text())
    config = load_config(path)
    assert not config.plan.mission.may_arm
    assert config.sense.gps.port == f"{pilot.PLUGGED}/gps"
    assert config.sense.vision.source == f"socket:{pilot.PLUGGED}/camera"


@pytest.mark.timeout(LONGEST_S)
@pytest.mark.skipif(not FOLDER, reason="COMPANION_DEPLOY names no folder for its Debian root")
@pytest.mark.parametrize("name", SCRIPTS)
def test_it_is_deployed(name: str) -> None:
    done = subprocess.run(
        [str(HERE / name), str(Path(FOLDER) / name.removesuffix(".sh"))],
        env={**os.environ, "PYTHON": sys.executable},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == SKIPPED:
        pytest.skip(done.stdout.splitlines()[-1])
    assert done.returncode == 0, done.stdout + done.stderr
