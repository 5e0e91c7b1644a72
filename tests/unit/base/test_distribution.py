"""The distribution's name and version: stated once, and used wherever somebody is told to install."""

from __future__ import annotations

import re
import tomllib

from companion import __version__
from companion.config import CONFIG_FOLDER

ROOT = CONFIG_FOLDER.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRA = re.compile(r"pip install\s+'?([\w.-]+)\[([\w,]+)\]")


def texts() -> dict[str, str]:
    folders = ("companion", "sitl", "calibration", "docs")
    paths = [
        path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in {".py", ".md"}
    ]
    return {str(path.relative_to(ROOT)): path.read_text() for path in [ROOT / "README.md", *paths]}


def test_an_extra_is_never_one_of_another_project_of_the_packages_name() -> None:
    named = {
        (where, name, extra)
        for where, text in texts().items()
        for name, extras in EXTRA.findall(text)
        for extra in extras.split(",")
    }
    assert len(named) >= 5
    assert PROJECT["name"] not in {"companion", "sitl", "calibration"}
    wrong = {(where, name) for where, name, extra in named if name != PROJECT["name"]}
    assert not wrong
    assert {extra for _, _, extra in named} <= set(PROJECT["optional-dependencies"])


def test_the_version_is_stated_once_and_stands_first_in_the_change_log() -> None:
    assert "version" in PROJECT["dynamic"]
    log = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert log[0] == __version__
