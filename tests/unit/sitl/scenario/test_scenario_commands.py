"""`companion-sitl scenarios` and `schema`."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.config import CONFIG_FOLDER
from sitl.scenario.listing import listing, schema_text, shipped
from sitl.scenario.scenario import load_scenario
from tests.programs import ProgramHere

FIRST_LINE = "# yaml-language-server: $schema=scenario.schema.json"


def test_every_shipped_scenario_has_a_line_of_what_it_is(program: ProgramHere) -> None:
    ended = program("companion-sitl", "scenarios")
    lines = ended.out.splitlines()
    assert ended.code == 0
    assert lines[0].split() == ["name", "pad", "wind", "faults", "description"]
    assert [line.split()[0] for line in lines[1:]] == shipped()
    by_name = {line.split()[0]: line for line in lines[1:]}
    for name, words in {
        "deck": ["line 0.5 m/s, at sea", "4 m/s, light", "A ship's deck"],
        "static": ["static", "calm", " - "],
        "gps_loss": ["gps_jump, gps_lost"],
        "gust": ["2 m/s, gusts"],
    }.items():
        assert [word for word in words if word not in by_name[name]] == []


def test_a_name_prints_settings_that_give_the_same_scenario_again(
    tmp_path: Path, program: ProgramHere
) -> None:
    for name in ("deck", "figure_8", "lossy_link"):
        out = program("companion-sitl", "scenarios", name).out
        copy = tmp_path / f"{name}.yaml"
        copy.write_text(out)
        assert load_scenario(copy) == load_scenario(name)
        assert yaml.safe_load(out)["camera"]["exposure"]["longest_s"] == 0.01


def test_an_unknown_name_is_one_line_and_exit_code_2(program: ProgramHere) -> None:
    err = program("companion-sitl", "scenarios", "nowhere").refusal
    assert "nowhere" in err
    assert "figure_8" in err


def test_the_shipped_schema_is_current(program: ProgramHere) -> None:
    out = program("companion-sitl", "schema").out
    assert out == schema_text()
    path = CONFIG_FOLDER / "scenarios" / "scenario.schema.json"
    assert path.read_text(encoding="utf-8") == out, (
        "run: companion-sitl schema > configs/scenarios/scenario.schema.json"
    )


@pytest.mark.parametrize("name", shipped())
def test_a_shipped_scenario_names_the_schema_and_uses_its_words(name: str) -> None:
    text = (CONFIG_FOLDER / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8")
    assert text.splitlines()[0] == FIRST_LINE
    schema = read_schema()
    assert unknown_words(yaml.safe_load(text), schema, schema) == []


@cache
def read_schema() -> dict[str, Any]:
    """The schema, made once."""
    schema: dict[str, Any] = json.loads(schema_text())
    return schema


def unknown_words(data: dict[str, Any], part: dict[str, Any], schema: dict[str, Any]) -> list[str]:
    """Keys of a file, and of the mappings in it, that the schema does not have."""
    unknown = []
    for key, value in data.items():
        known = part.get("properties", {}).get(key)
        if known is None:
            unknown.append(key)
        elif isinstance(value, dict) and (inner := referred(known, schema, value)) is not None:
            unknown += unknown_words(value, inner, schema)
    return unknown


def referred(known: dict[str, Any], schema: dict[str, Any], value: dict[str, Any]) -> dict[str, Any] | None:
    """The definition that a property leads to, of several the one of the value's kind."""
    leads = [known, *known.get("anyOf", ()), *known.get("oneOf", ()), *known.get("allOf", ())]
    for lead in leads:
        if "$ref" in lead:
            definition: dict[str, Any] = schema["$defs"][lead["$ref"].rpartition("/")[2]]
            kind = definition["properties"].get("kind", {}).get("const")
            if kind in (None, value.get("kind")):
                return definition
    return None


def test_the_list_fits_a_narrow_terminal() -> None:
    narrow = listing(80)
    assert max(map(len, narrow.splitlines())) <= 80
    for scenario in map(load_scenario, shipped()):
        assert f"{scenario.name}\n  {scenario.description[:20]}" in narrow
    assert listing(1000) == listing()
