"""Which settings are read when nobody names any: an installed service's, else the shipped ones."""

from pathlib import Path

import pytest

from companion.base import files


@pytest.mark.parametrize(
    ("installed", "there", "service"), [(True, True, True), (True, False, False), (False, True, False)]
)
def test_the_services_settings_are_those_of_its_own_program(
    installed: bool, there: bool, service: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prefix, system = tmp_path / "opt", tmp_path / "etc" / "companion.yaml"
    system.parent.mkdir()
    if there:
        system.touch()
    package = prefix / "versions" / "0.2.0" / ".venv" / "lib" / "companion" if installed else tmp_path
    shipped = package / "configs"
    monkeypatch.setattr(files, "CONFIG_FOLDER", shipped)
    monkeypatch.setattr(files, "_SERVICE_PREFIX", prefix)
    monkeypatch.setattr(files, "_SERVICE_SETTINGS", system)
    assert files.default_settings() == (system if service else shipped / "companion.yaml")
