"""Rows: what they hold, and that the file never has half of one."""

import os
import re
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import BaseModel

from companion.config import CONFIG_FOLDER, ConfigError
from companion.config.catalogue import inner_model
from companion.flightlog.result import Result
from sitl.campaign import SCENARIOS
from sitl.campaign.manifest import MANIFEST_NAME, Manifest, check_goes_on, make_plan, read_manifest
from sitl.campaign.rows import (
    COLUMNS,
    CSV_NAME,
    OUTCOMES,
    RESULT_KEYS,
    Row,
    RunsFile,
    make_row,
    pending,
    read_rows,
    write_parquet,
)
from sitl.campaign.worker import RunResult
from tests.unit.sitl.campaign.campaign_parts import flight, row, scenario_file
from tests.unit.sitl.campaign.fake_flights import result

VERSION = "0.1.0+abc"


def result_keys(model: type[BaseModel], prefix: str = "") -> set[str]:
    keys = set()
    for name, field in model.model_fields.items():
        inner = inner_model(field.annotation)
        keys |= {f"{prefix}{name}"} if inner is None else result_keys(inner, f"{prefix}{name}.")
    return keys


def test_every_figure_of_the_result_has_its_column() -> None:
    others = {"scenario", "seed", "as_built", "outcome", "contacts", "events"}
    assert set(RESULT_KEYS.values()) == result_keys(Result) - others
    assert set(RESULT_KEYS) <= set(COLUMNS)


def test_every_column_is_documented() -> None:
    page = (CONFIG_FOLDER.parent / "docs" / "how-to" / "campaigns.md").read_text(encoding="utf-8")
    table = page.partition("| Column | |")[2].partition("\n\n")[0]
    told = re.findall(r"`(\w+)`", "".join(line.split("|")[1] for line in table.splitlines() if line))
    assert told == list(COLUMNS)


def test_a_landing_fills_its_row_and_what_never_came_down_or_failed_has_no_touchdown() -> None:
    flown = RunResult(flight(40), 9.876, result(40, "static", "landed"), "", [0.01, -0.02])
    made = make_row(flown, VERSION)
    assert made.landed
    assert (made.touchdown_lateral_m, made.touchdown_along_m, made.touchdown_across_m) == (0.04, 0.01, -0.02)
    assert made.unplanned_contacts == 1
    assert (made.frames, made.total_s, made.pad_velocity_rmse_m_s) == (900, 30.0, None)
    assert (made.wall_s, made.version, made.error) == (9.88, VERSION, "")
    assert made.command == "companion --sitl --fast --scenario static --seed 40"
    ended = {**result(1, "static", "timeout"), "touchdown": None}
    made = make_row(RunResult(flight(1), 9.0, ended, "never touched down"), VERSION)
    assert (made.outcome, made.reason, made.touchdown_lateral_m) == ("timeout", "never touched down", None)
    made = make_row(RunResult(flight(1), 9.0, error="killed by SIGKILL:\n  no memory\n"), VERSION)
    assert (made.outcome, made.error, made.total_s) == ("failed", "killed by SIGKILL: no memory", None)


# ---------------------------------------------------------------- the file


ROWS = [row(seed=s, outcome=OUTCOMES[s], lateral_m=0.01 * s, reason='"beside", it') for s in range(3)]


@pytest.fixture
def filled(tmp_path: Path) -> Path:
    append(tmp_path, *ROWS)
    return tmp_path / CSV_NAME


def append(folder: Path, *rows: Row) -> None:
    with closing(RunsFile(folder)) as file:
        for each in rows:
            file.append(each)


def test_rows_come_back_as_they_were_written_and_two_campaigns_do_not_write_one_file(
    filled: Path, tmp_path: Path
) -> None:
    assert read_rows(filled) == ROWS
    with closing(RunsFile(tmp_path)) as again:
        assert again.rows == ROWS
        with pytest.raises(ConfigError, match="another campaign writes it"):
            RunsFile(tmp_path)
    RunsFile(tmp_path).close()


@pytest.mark.parametrize("left_over", ["static,3,land", "static", '"'])
def test_half_a_line_is_cut_off(left_over: str, filled: Path, tmp_path: Path) -> None:
    whole = filled.read_bytes()
    filled.write_bytes(whole + left_over.encode())
    append(tmp_path, row(seed=3))
    assert filled.read_bytes().startswith(whole)
    assert [each.seed for each in read_rows(filled)] == [0, 1, 2, 3]


def test_half_a_heading_is_begun_anew(tmp_path: Path) -> None:
    (tmp_path / CSV_NAME).write_text("scenario,se")
    append(tmp_path)
    assert (tmp_path / CSV_NAME).read_text() == ",".join(COLUMNS) + "\n"


def test_a_full_disk_leaves_whole_rows_and_says_so(
    filled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, write = filled.read_bytes(), os.write
    with closing(RunsFile(tmp_path)) as file:
        monkeypatch.setattr(os, "write", lambda descriptor, data: write(descriptor, data[:10]))
        with pytest.raises(ConfigError, match=r"runs\.csv: cannot be written: no space"):
            file.append(row(seed=9))
        monkeypatch.undo()
        assert filled.read_bytes() == before
        file.append(row(seed=9))
    assert [each.seed for each in read_rows(filled)] == [0, 1, 2, 9]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n1,2\n", r"runs\.csv: expected the columns scenario, seed, outcome"),
        (",".join(COLUMNS) + "\nstatic,1\n", rf"runs\.csv:2: expected {len(COLUMNS)} fields, found 2"),
        (",".join(COLUMNS) + "\nstatic,x,landed" + "," * (len(COLUMNS) - 3) + "\n", r"runs\.csv:2: seed: "),
    ],
)
def test_what_is_no_row_is_refused_with_its_line(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / CSV_NAME).write_text(text)
    with pytest.raises(ConfigError, match=words):
        RunsFile(tmp_path)
    (tmp_path / CSV_NAME).unlink()
    RunsFile(tmp_path).close()


def test_only_runs_without_a_row_are_left() -> None:
    flights = [flight(0), flight(1), flight(0, "line")]
    assert pending(flights, [row(seed=0)]) == [flight(1), flight(0, "line")]


def test_parquet_holds_the_same(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [row(seed=0, lateral_m=0.03, frames=9), row(seed=1, outcome="failed", error="hung")]
    path = write_parquet(rows, tmp_path)
    assert path == tmp_path / "runs.parquet"
    table = parquet.read_table(path)
    assert tuple(table.column_names) == COLUMNS
    assert table.to_pylist() == [each.model_dump() for each in rows]
    kinds: dict[str, Any] = {name: str(table.schema.field(name).type) for name in COLUMNS}
    assert (kinds["seed"], kinds["tilt_deg"], kinds["outcome"]) == ("int64", "double", "string")


def test_without_pyarrow_there_is_the_csv_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    assert write_parquet([row()], tmp_path) is None
    assert list(tmp_path.iterdir()) == []


# ---------------- What makes a campaign the same one, and what another


def manifest(
    *sources: str | Path, runs: int = 3, first_seed: int = 0, config: Path | None = None
) -> Manifest:
    return make_plan([str(source) for source in sources], first_seed, runs, config).manifest


def test_every_scenario_is_flown_once_under_a_seed_before_the_next_seed() -> None:
    plan = make_plan(["static", "line", "line"], 5, 2, None)
    flown = [(run.scenario, run.seed) for run in plan.flights()]
    assert flown == [("static", 5), ("line", 5), ("static", 6), ("line", 6)]
    assert {run.time_limit_s for run in plan.flights()} == {s.time_limit_s for s in plan.scenarios.values()}


def test_all_is_every_shipped_scenario_and_may_stand_beside_files_of_ones_own(tmp_path: Path) -> None:
    shipped = {path.stem for path in (CONFIG_FOLDER / "scenarios").glob("*.yaml")}
    assert set(make_plan(["all"], 0, 1, None).scenarios) == shipped
    assert set(SCENARIOS) <= shipped
    both = make_plan(["all", str(scenario_file(tmp_path, "mine"))], 0, 1, None).scenarios
    assert set(both) == shipped | {"mine"}


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


def test_the_same_words_are_the_same_campaign_and_more_seeds_and_scenarios_go_on_with_it(
    tmp_path: Path,
) -> None:
    assert manifest("static", "line") == manifest("static", "line")
    check_goes_on(manifest("static", "line"), manifest("static", "line"), tmp_path)
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
