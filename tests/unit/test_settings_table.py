"""The tables of the settings: each setting has its unit, its meaning, and when one would change it."""

import pytest
from pydantic import BaseModel, Field

from companion.config import CameraConfig, CompanionConfig, ConfigError, VehicleConfig
from companion.config.catalogue import Setting, settings_of
from docs import settings_table
from sitl.scenario.scenario import Scenario


def test_every_setting_of_the_app_says_when_one_would_change_it() -> None:
    assert settings_table.without_advice() == []
    assert settings_table.ADVICE.search("Tries after the first; more is worse") is None


@pytest.mark.parametrize("model", [CompanionConfig, CameraConfig, VehicleConfig, Scenario])
def test_every_setting_with_a_unit_in_its_name_shows_it(model: type[BaseModel]) -> None:
    names = {s.key.rsplit(".")[-1]: s.unit for s in settings_of(model)}
    assert names.get("connection", "") == ""
    assert [
        name for name, unit in names.items() if name.endswith(("_m", "_s", "_deg", "_hz", "_px")) and not unit
    ] == []


def test_a_setting_without_a_meaning_stops_the_writing() -> None:
    class Dumb(BaseModel):
        height_m: float = Field(default=1.0, ge=0.5)

    (setting,) = settings_of(Dumb)
    assert setting == Setting("height_m", "m", "1", "≥ 0.5", "")
    with pytest.raises(ConfigError, match="height_m"):
        settings_table.markdown("companion", {"": [setting]}, "reference/settings.md")


def test_a_page_that_a_meaning_names_is_a_link() -> None:
    setting = Setting("fuzzy", "", "landing", "", "Rules (docs/explanation/fuzzy.md)", for_operators=True)
    table = settings_table.markdown("companion", {"": [setting]}, "reference/settings.md")
    assert "| operator | Rules ([fuzzy](../explanation/fuzzy.md)) |" in table


def test_a_few_settings_are_the_operator_s() -> None:
    audience = [setting.for_operators for setting in settings_of(CompanionConfig)]
    assert 35 <= sum(audience) <= 50 < len(audience) / 5
