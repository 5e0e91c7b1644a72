"""`companion settings`: the meaning of any setting, offline."""

import json

import pytest
from typer.testing import CliRunner

from companion.cli import cli
from companion.config import CompanionConfig, ConfigError
from companion.config.catalogue import settings_of


def shown(*words: str) -> str:
    result = CliRunner().invoke(cli, ["settings", *words], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


def test_any_setting_is_explained_by_its_key() -> None:
    for setting in settings_of(CompanionConfig):
        text = shown(setting.key)
        assert text.startswith(f"{setting.key}  (")
        assert " ".join(text.split()).endswith(" ".join(setting.meaning.split()))


def test_without_a_word_those_of_an_operator_are_listed() -> None:
    listed = [line.split()[0] for line in shown().splitlines() if not line.startswith(" ")]
    assert listed == [setting.key for setting in settings_of(CompanionConfig) if setting.for_operators]
    assert "control.horizon" not in "".join(listed)
    assert len(shown("--all").splitlines()) > 3 * len(shown().splitlines())


def test_a_word_finds_keys_and_a_part_of_the_tree_is_listed() -> None:
    assert shown("fence").startswith("plan.mission.fence_m  (m, default 150, ≥ 10, ≤ 2000, operator)")
    listed = [line.split()[0] for line in shown("plan.mission.battery").splitlines() if line[0] != " "]
    assert listed == [f"plan.mission.battery.{name}" for name in ("low", "critical", "finish_descent")]
    assert shown("exposure", "--of", "camera").startswith("exposure_s  (")


def test_an_unknown_word_is_answered_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"fenze: no such setting; .*fence_m"):
        shown("fenze")


def test_the_schema_has_meaning_and_audience() -> None:
    schema = json.loads(shown("--schema"))
    fence = schema["$defs"]["MissionConfig"]["properties"]["fence_m"]
    assert fence["audience"] == "operator"
    assert fence["description"].startswith("Distance from home")
