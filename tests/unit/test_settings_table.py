"""The tables of the settings: each setting has its unit, its meaning, and when one would change it."""

from __future__ import annotations

import pytest
from pydantic import BaseModel

from companion.config import CameraConfig, CompanionConfig, VehicleConfig, read_yaml
from docs import settings_table
from sitl.scenario.scenario import Scenario


def test_every_setting_of_the_app_says_when_one_would_change_it() -> None:
    meanings = read_yaml(settings_table.MEANINGS)
    assert settings_table.without_advice(meanings) == []
    meanings["companion"]["plan.landing.retries"] = "Tries after the first; more is worse"
    assert settings_table.without_advice(meanings) == ["plan.landing.retries"]


@pytest.mark.parametrize("model", [CompanionConfig, CameraConfig, VehicleConfig, Scenario])
def test_every_setting_with_a_unit_in_its_name_shows_it(model: type[BaseModel]) -> None:
    names = {s.key.rsplit(".")[-1]: s.unit for s in settings_table.settings_of(model)}
    assert names.get("connection", "") == ""
    assert [
        name for name, unit in names.items() if name.endswith(("_m", "_s", "_deg", "_hz", "_px")) and not unit
    ] == []


def test_a_comment_beside_a_field_is_found() -> None:
    comments = settings_table.field_comments(CameraConfig)
    assert comments["exposure_s"].startswith("short and fixed")
    assert "name" not in comments
