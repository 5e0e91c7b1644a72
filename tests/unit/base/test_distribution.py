"""The distribution's name and version: stated once, and used wherever somebody is told to install."""

import re
import tomllib

import pytest
import yaml

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
    assert len(named) >= 4
    assert PROJECT["name"] not in {"companion", "sitl", "calibration"}
    wrong = {(where, name) for where, name, extra in named if name != PROJECT["name"]}
    assert not wrong
    assert {extra for _, _, extra in named} <= set(PROJECT["optional-dependencies"])


def test_the_version_is_stated_once_and_stands_first_in_the_change_log() -> None:
    assert "version" in PROJECT["dynamic"]
    log = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert log[0] == __version__
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == __version__


def test_what_a_hosting_site_reads_is_well_formed_and_calls_our_make_targets() -> None:
    files = [*(ROOT / ".github").rglob("*.yml"), ROOT / ".pre-commit-config.yaml"]
    content = {path.name: yaml.safe_load(path.read_text()) for path in files}
    steps = [step for job in content["checks.yml"]["jobs"].values() for step in job["steps"]]
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    ran = [step["run"] for step in steps if "run" in step]
    assert {"make test", "make test-all", "make docs"} == set(ran)
    assert {words.removeprefix("make ") for words in ran} <= set(targets)
    for form in ("bug.yml", "idea.yml"):
        assert all(field["type"] in {"input", "textarea"} for field in content[form]["body"])


@pytest.mark.parametrize("package", ["companion", "sitl", "calibration"])
def test_a_package_says_that_it_is_typed(package: str) -> None:
    assert (ROOT / package / "py.typed").read_bytes() == b""
