"""Files are written whole."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from companion.base.files import write_atomically
from companion.config import CONFIG_FOLDER, ConfigError


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text("old")
    write_atomically(path, "new\n")
    assert path.read_text() == "new\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none/result.json: cannot be written: No such file"):
        write_atomically(tmp_path / "none" / "result.json", "new\n")


@pytest.mark.parametrize("installed", [True, False])
def test_the_shipped_settings_are_in_the_installed_package_and_beside_it_in_a_checkout(
    installed: bool, tmp_path: Path
) -> None:
    base = tmp_path / "companion" / "base"
    base.mkdir(parents=True)
    for package in (base, base.parent):
        (package / "__init__.py").touch()
    for module in ("files.py", "errors.py"):
        shutil.copy(CONFIG_FOLDER.parent / "companion" / "base" / module, base)
    for folder in (base.parent, tmp_path) if installed else (tmp_path,):
        (folder / "configs").mkdir()
    said = subprocess.run(
        [sys.executable, "-c", "from companion.base.files import CONFIG_FOLDER; print(CONFIG_FOLDER)"],
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert Path(said.strip()) == (base.parent if installed else tmp_path) / "configs"


def test_the_wheel_puts_the_settings_into_the_package() -> None:
    project = tomllib.loads((CONFIG_FOLDER.parent / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["packages"] == ["companion", "sitl", "calibration"]
    assert wheel["force-include"] == {"configs": "companion/configs"}
