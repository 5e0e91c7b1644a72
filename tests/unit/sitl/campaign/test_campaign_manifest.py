"""What makes a campaign the same one, and what another."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.config import CONFIG_FOLDER, ConfigError
from sitl.campaign import SCENARIOS
from sitl.campaign.manifest import (
    MANIFEST_NAME,
    Manifest,
    check_goes_on,
    make_plan,
    read_manifest,
)
from tests.unit.sitl.campaign.campaign_parts import flight, scenario_file


def manifest(
    *sources: str | Path, runs: int = 3, first_seed: int = 0, config: Path | None = None
) -> Manifest:
    return make_plan([str(source) for source in sources], first_seed, runs, config).manifest


def test_every_scenario_is_flown_under_a_seed_before_the_next_seed() -> None:
    plan = make_plan(["static", "line"], 5, 2, None)
    assert [(run.scenario, run.seed) for run in plan.flights()] == [
        ("static", 5),
        ("line", 5),
        ("static", 6),
        ("line", 6),
    ]
    assert {run.time_limit_s for run in plan.flights()} == {s.time_limit_s for s in plan.scenarios.values()}


def test_all_is_every_shipped_scenario() -> None:
    shipped = {path.stem for path in (CONFIG_FOLDER / "scenarios").glob("*.yaml")}
    assert set(make_plan(["all"], 0, 1, None).scenarios) == shipped
    assert set(SCENARIOS) <= shipped


def test_all_may_stand_beside_files_of_ones_own(tmp_path: Path) -> None:
    scenarios = make_plan(["all", str(scenario_file(tmp_path, "mine"))], 0, 1, None).scenarios
    assert {"static", "mine"} <= set(scenarios)


def test_a_scenario_named_twice_is_flown_once() -> None:
    assert list(make_plan(["line", "line"], 0, 1, None).scenarios) == ["line"]


def test_two_scenarios_of_one_name_are_refused(tmp_path: Path) -> None:
    path = scenario_file(tmp_path, "line")
    with pytest.raises(ConfigError, match=r"line and .*line\.yaml are both 'line'; expected two names"):
        make_plan(["line", str(path)], 0, 1, None)


def test_the_command_repeats_a_run_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario_file(tmp_path, "my barge")
    monkeypatch.chdir(tmp_path)
    Path("settings.yaml").write_text("plan: {}\n")
    run = next(make_plan(["my barge.yaml"], 4, 1, Path("settings.yaml")).flights())
    assert run.command == (
        f"companion --sitl --fast --scenario '{tmp_path}/my barge.yaml' --seed 4 "
        f"--config {tmp_path}/settings.yaml"
    )
    assert flight(2).command == "companion --sitl --fast --scenario static --seed 2"


# ---------------------------------------------------------------- the same or another


def test_the_same_words_are_the_same_campaign(tmp_path: Path) -> None:
    old, new = manifest("static", "line"), manifest("static", "line")
    assert new == old
    check_goes_on(old, new, tmp_path)


def test_more_seeds_and_scenarios_go_on_with_it(tmp_path: Path) -> None:
    old, new = manifest("static", runs=3, first_seed=2), manifest("static", "line", runs=6)
    check_goes_on(old, new, tmp_path)
    with pytest.raises(ConfigError, match="it flies 'line' too"):
        check_goes_on(new, old, tmp_path)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"runs": 2}, "its seeds are 0 to 2"),
        ({"first_seed": 1}, "its seeds are 0 to 2"),
        ({"code": "other"}, r"flown by version .* \(other\)"),
        ({"version": "0.0.9"}, "flown by version 0.0.9"),
        ({"settings": "other"}, "the app's settings were the shipped ones"),
        ({"scenarios": {}}, "'static' too"),
    ],
)
def test_another_campaign_is_refused_in_one_line(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    mine = manifest("static")
    other = mine.model_copy(update=changes)
    old, new = (other, mine) if {"code", "version", "settings"} & changes.keys() else (mine, other)
    with pytest.raises(ConfigError, match=words) as told:
        check_goes_on(old, new, tmp_path)
    assert str(told.value).startswith(f"--out {tmp_path}: holds another campaign: ")
    assert "\n" not in str(told.value)


def test_a_changed_scenario_is_another_campaign_but_a_comment_is_none(tmp_path: Path) -> None:
    path = scenario_file(tmp_path)
    old = manifest(path)
    path.write_text("# only said otherwise\n" + path.read_text())
    check_goes_on(old, manifest(path), tmp_path)
    scenario_file(tmp_path, time_limit_s=6.0)
    with pytest.raises(ConfigError, match=r"'short' \(.*short\.yaml\) or a file that it names has changed"):
        check_goes_on(old, manifest(path), tmp_path)


@pytest.mark.parametrize("file", ["airframe", "pad", "vehicle"])
def test_a_change_of_a_file_that_a_scenario_names_is_seen(file: str, tmp_path: Path) -> None:
    names = {"airframe": "airframes/x500", "pad": "pads/moving_1300", "vehicle": "vehicles/x500"}
    mine = tmp_path / f"{file}.yaml"
    mine.write_text((CONFIG_FOLDER / f"{names[file]}.yaml").read_text())
    values: dict[str, dict[str, Any]] = {
        "airframe": {"airframe": str(mine)},
        "pad": {"pad": {"name": str(mine)}, "companion": {"pad": str(mine)}},
        "vehicle": {"companion": {"vehicle": str(mine)}},
    }
    path = scenario_file(tmp_path, **values[file])
    old = manifest(path)
    mine.write_text(mine.read_text() + "\n# changed\n")
    with pytest.raises(ConfigError, match="has changed"):
        check_goes_on(old, manifest(path), tmp_path)


def test_other_settings_are_another_campaign(tmp_path: Path) -> None:
    config = tmp_path / "mine.yaml"
    config.write_text(yaml.safe_dump({"compute": {"vision_s": 0.05}}))
    with pytest.raises(ConfigError, match="the app's settings were the shipped ones"):
        check_goes_on(manifest("static"), manifest("static", config=config), tmp_path)


def test_a_manifest_survives_its_file_and_junk_is_refused(tmp_path: Path) -> None:
    assert read_manifest(tmp_path) is None
    mine = manifest("static")
    (tmp_path / MANIFEST_NAME).write_text(mine.model_dump_json())
    assert read_manifest(tmp_path) == mine
    (tmp_path / MANIFEST_NAME).write_text('{"format": 2}')
    with pytest.raises(ConfigError, match="is no campaign's manifest"):
        read_manifest(tmp_path)
