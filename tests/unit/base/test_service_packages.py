"""The service's set of packages (docs/reference/package.md) is all that a landing imports."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from companion.config import CONFIG_FOLDER

ROOT = CONFIG_FOLDER.parent
OURS = {"companion", "sitl", "calibration"}
# hides every module of `argv[1]`, then is `companion` with the rest
HIDING = """
import sys
hidden = set(sys.argv[1].split())
class Hiding:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in hidden:
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
sys.meta_path.insert(0, Hiding())
from companion.cli import main
sys.argv = ['companion', *sys.argv[2:]]
main()
"""


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def listed() -> set[str]:
    lines = (ROOT / "systemd" / "service-packages.txt").read_text().splitlines()
    return {normal(line) for line in lines if line and not line.startswith("#")}


# what may be left out beside: MAVSDK with `link.actions: pymavlink`, and the live page's server
OPTIONAL = {"mavsdk", "aiohttp"}


def companion_without_the_rest(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """`companion` where the modules of no other package can be imported."""
    hidden = {
        module
        for module, owners in packages_distributions().items()
        if module not in OURS and not {normal(owner) for owner in owners} & (listed() - OPTIONAL)
    }
    assert {"matplotlib", "lxml", "pygments", "plotly", "pytest", *OPTIONAL} <= hidden
    return subprocess.run(
        [sys.executable, "-c", HIDING, " ".join(hidden), *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300.0,
        check=False,
    )


def test_the_set_holds_the_packages_that_the_app_is_built_on() -> None:
    fixed = {"pymavlink", "mavsdk", "numpy", "opencv-python-headless", "filterpy", "scikit-fuzzy", "osqp"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    core = {normal(re.split(r"[<>=]", requirement)[0]) for requirement in project["dependencies"]}
    assert fixed | {"pyserial"} <= listed() & core
    # what the core requires, and the service does not import
    assert core - listed() == {"matplotlib", "plotly", "pyulog"}


@pytest.mark.slow
def test_it_lands_with_the_service_s_set_alone(tmp_path: Path) -> None:
    record = tmp_path / "flight"
    words = ("--sitl", "--fast", "--scenario", "static", "--no-ui", "--record", str(record))
    done = companion_without_the_rest(tmp_path, *words)
    (no_page,) = done.stderr.splitlines()
    assert done.returncode == 0
    assert no_page.startswith("companion: no page: the report needs plotly; expected it installed")
    assert (record / "flight.mcap").stat().st_size > 1_000_000


def test_what_is_missing_is_reported_in_one_line(tmp_path: Path) -> None:
    done = companion_without_the_rest(tmp_path, "pad", "indoor_400", "-o", "pad.pdf")
    assert (done.returncode, done.stderr) == (
        2,
        "companion: needs matplotlib; expected it installed, see docs/reference/package.md\n",
    )
