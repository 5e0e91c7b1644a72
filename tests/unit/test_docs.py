"""The documentation is true: its commands work, its links and names lead somewhere, its tables are fresh.

A page's ```console commands run in order in an empty folder, with the page's example files in it. Those
that would take real time, a vehicle, root or the whole tool chain are only checked: that program, options,
scenario and target exist.
"""

import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from mcap.reader import make_reader
from pydantic import BaseModel

from benchmarks.command import discover
from calibration.camera.command import app as camera_cli
from calibration.magnetometer.command import cli as magnetometer_cli
from calibration.mount.command import cli as mount_cli
from companion.app.command import EXIT_CODES
from companion.cli import COMMANDS, cli
from companion.config import CONFIG_FOLDER, CompanionConfig, load_config, validate
from companion.config.catalogue import inner_model, settings_of
from companion.flightlog.result import Result
from docs import results, settings_table
from experiments.command import app as experiments_cli
from sitl.campaign import SCENARIOS
from sitl.cli import cli as sitl_cli
from sitl.scenario.scenario import Scenario, load_scenario
from tests.scenario.flying import SharedFlights, figures

ROOT = CONFIG_FOLDER.parent
FILES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]
PAGES = {page.name: page for page in FILES}
TEXTS = {name: page.read_text(encoding="utf-8") for name, page in PAGES.items()}
# also indented, in a list
FENCE = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
# "Put this into `barge.yaml`: ..." and the block that follows
EXAMPLE_FILE = re.compile(r"into `(\w+\.yaml)`[^`]*```yaml\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"`([^`\n]+)`")
PACKAGES = ("benchmarks", "calibration", "companion", "docs", "experiments", "sitl", "tests")
FOREIGN_MODULES = {"sim_vehicle.py"}  # ArduPilot's
COMMAND_TIMEOUT_S = 300.0
MOST_GIF_BYTES = 2_000_000
# what each program has, as the README says
EVERYWHERE = {"-h", "--help", "--version", "--install-completion", "--show-completion"}
PROGRAMS = {
    "companion": cli,
    "companion-sitl": sitl_cli,
    "calibrate-magnetometer": magnetometer_cli,
    "calibrate-mount": mount_cli,
    "calibrate-camera": camera_cli,
}
BENCHMARKS = discover()
FOLDERS = (
    *("companion/", "sitl/", "calibration/", "configs/", "docs/", "tests/", "systemd/"),
    *("benchmarks/", "experiments/"),
)


def commands(text: str) -> list[list[str]]:
    """The console commands of a page, each split into words."""
    blocks = [body for kind, body in FENCE.findall(text) if kind == "console"]
    return [shlex.split(line) for block in blocks for line in block.splitlines() if line.strip()]


def prose(text: str) -> str:
    """A page without its fenced blocks."""
    return FENCE.sub("", text)


def code_words(text: str) -> list[str]:
    """What stands in backticks within the text."""
    return CODE.findall(prose(text))


# ---------------------------------------------------------------- commands


def run(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command of ours with this interpreter and this tree."""
    ours = {
        "companion": "companion.cli",
        "companion-sitl": "sitl.cli",
        "calibrate-magnetometer": "calibration.magnetometer.command",
        "calibrate-mount": "calibration.mount.command",
        "calibrate-camera": "calibration.camera.command",
    }
    module = [ours[words[0]], *words[1:]] if words[0] in ours else words[2:]
    return subprocess.run(
        [sys.executable, "-m", *module],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=COMMAND_TIMEOUT_S,
        check=False,
    )


def is_run(words: list[str], page: str) -> bool:
    """Whether a command is run here, rather than only checked; of the tour every one."""
    if page == "tour.md":
        return True
    if words[0] == "companion":
        flies = "--fast" in words and "--firmware" not in words
        runs = flies or "--help" in words or words[1:] == ["replay", "flights/circle"]
        return runs or words[1:3] == ["pad", "indoor_400"] or words[1] == "settings"
    if words[0].startswith("calibrate-"):
        return "--help" in words or "--make-board" in words
    if words[0] == "companion-sitl":
        return words[1:2] in (["scenarios"], ["schema"])
    if words[:3] == ["python", "-m", "experiments"]:
        return "--help" in words
    return words[:3] == ["python", "-m", "docs.pictures"]


def command_of(program: typer.Typer, name: str) -> Any:
    """One command of a program, imported as when it runs."""
    group: Any = typer.main.get_command(program)
    return group.resolve_command(group.make_context("", [name]), [name])[1]


def check_options(program: typer.Typer, words: list[str]) -> None:
    """Raise when a command of a program names an option or a scenario that does not exist."""
    command = typer.main.get_command(program)
    context = command.make_context(None, words)
    if words[:1] and words[0] in getattr(command, "commands", {}):
        command_of(program, words[0]).make_context(words[0], words[1:])
    if context.params.get("scenario") is not None:
        load_scenario(context.params["scenario"])


def check_without_running(words: list[str]) -> None:
    """Raise when a command names an option, module, target or file that does not exist."""
    if words[0] in PROGRAMS:
        check_options(PROGRAMS[words[0]], words[1:])
    elif words[:3] == ["python", "-m", "experiments"] and words[3:]:
        check_options(experiments_cli, words[3:])
    elif words[:2] == ["python", "-m"]:
        assert importlib.util.find_spec(words[2]) is not None
        named = 4 if words[2] == "benchmarks" else 3
        assert named == 3 or words[3:4] == [] or words[3] in BENCHMARKS
        options = [word for word in words[named:] if word.startswith("--")]
        known = run([*words[:named], "--help"], ROOT).stdout if options else ""
        assert [option for option in options if option not in known] == []
    elif words[0] == "make":
        makefile = (ROOT / "Makefile").read_text().replace("$(VENV)", ".venv")
        targets = {
            *re.findall(r"^([\w./-]+):", makefile, re.MULTILINE),
            *(f"bench-{name}" for name in BENCHMARKS),
        }
        assert words[1] in targets
    elif words[0] == "sudo" and "/" in words[1]:
        assert os.access(ROOT / words[1], os.X_OK)
    elif words[0] == "pip":
        files = [words[k + 1] for k, word in enumerate(words) if word in ("-c", "-r")]
        assert [file for file in files if not (ROOT / file).is_file()] == []
    else:
        assert words[0] in {"sudo", "journalctl", "mkdir", "dask", "companion-rollback"}


@pytest.mark.parametrize("name", [name for name in PAGES if commands(TEXTS[name])])
def test_every_command_of_a_page_works(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shared_flights: SharedFlights
) -> None:
    monkeypatch.chdir(tmp_path)
    for file_name, body in EXAMPLE_FILE.findall(TEXTS[name]):
        (tmp_path / file_name).write_text(body)
    for words in commands(TEXTS[name]):
        if not is_run(words, name):
            check_without_running(words)
            continue
        done = run(words, tmp_path)
        assert done.returncode == 0, f"{shlex.join(words)}\n{done.stdout}{done.stderr}"
    if name == "README.md":
        assert_flight_is_as_documented(tmp_path)
        # the same seed gives the same flight, to the bit, also in another process
        here = shared_flights.flown("circle", 0)
        circle = json.loads((tmp_path / "circle.json").read_text())
        assert figures(replace(here, result=circle)) == figures(here)


def assert_flight_is_as_documented(folder: Path) -> None:
    """The flight of the README left the files and topics that the pages list, and the pictures."""
    page = TEXTS["flight-log.md"]
    left = {path.name for path in (folder / "flights" / "circle").iterdir()}
    assert left == set(re.findall(r"^\| `([\w.]+\.(?:mcap|tlog|json|yaml|png|html))` \|", page, re.MULTILINE))
    with (folder / "flights" / "circle" / "flight.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    logged = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    told = re.findall(r"^\| (`/[^|]+`) \| ([\w.]+) \|", page, re.MULTILINE)
    assert logged == {topic: kind for topics, kind in told for topic in re.findall(r"`([\w/]+)`", topics)}
    pictures = {path.name for path in (folder / "pictures").iterdir()}
    assert (folder / "pictures" / "landing.gif").stat().st_size < MOST_GIF_BYTES
    assert pictures | {
        *("live-page.png", "margins.png", "qgroundcontrol.svg", "state-machine.svg", "wiring.svg")
    } == {path.name for path in (ROOT / "docs" / "images").iterdir()}


# ---------------------------------------------------------------- what the pages name


def test_no_two_pages_have_one_name() -> None:
    assert len(FILES) == len(PAGES)


@pytest.mark.parametrize("name", PAGES)
def test_every_relative_link_leads_to_a_file(name: str) -> None:
    links = [link.partition("#")[0] for link in LINK.findall(prose(TEXTS[name]))]
    relative = [link for link in links if link and "://" not in link]
    assert [link for link in relative if not (PAGES[name].parent / link).exists()] == []


@pytest.mark.parametrize("name", PAGES)
def test_every_path_of_the_tree_that_is_named_exists(name: str) -> None:
    paths = [word for word in code_words(TEXTS[name]) if word.startswith(FOLDERS) and "NAME" not in word]
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_every_module_that_is_named_exists() -> None:
    modules = {path.name for folder in PACKAGES for path in (ROOT / folder).rglob("*.py")} | FOREIGN_MODULES
    named = {(code, page) for page, text in TEXTS.items() for code in re.findall(r"`(\w+\.py)`", text)}
    assert [pair for pair in sorted(named) if pair[0] not in modules] == []


@pytest.mark.parametrize("name", PAGES)
def test_every_setting_that_is_named_exists(name: str) -> None:
    keys = {setting.key for setting in settings_of(CompanionConfig)}
    parents = {key.rsplit(".", depth)[0] for key in keys for depth in range(1, key.count(".") + 1)}
    sections = tuple(f"{section}." for section in CompanionConfig.model_fields)
    named = [word for word in code_words(TEXTS[name]) if re.fullmatch(r"[a-z]+(\.[a-z_0-9]+)+", word)]
    # a scenario's own sections and the result's share some of these words
    scenario = {setting.key for setting in settings_of(Scenario)}
    scenario |= {key.rpartition(".")[0] for key in scenario} | {"pad.motion"}
    known = keys | parents | scenario | set(result_keys(Result))
    assert [word for word in named if word.startswith(sections) and word not in known] == []


def test_every_shipped_scenario_is_in_the_readme() -> None:
    shipped = {path.stem for path in (CONFIG_FOLDER / "scenarios").glob("*.yaml")}
    assert set(SCENARIOS) <= shipped
    assert [name for name in SCENARIOS if f"`{name}`" not in TEXTS["README.md"]] == []


def test_the_exit_codes_are_in_their_page() -> None:
    text = TEXTS["command-line.md"].partition("Exit codes:")[2].partition("\n\n")[0]
    told = {word: int(code) for code, word in re.findall(r"`(\d)` (\w+)", text)}
    assert {str(outcome): code for outcome, code in EXIT_CODES.items()}.items() <= told.items()


def test_the_options_and_commands_are_in_their_page() -> None:
    page = TEXTS["command-line.md"]
    options = {option for parameter in typer.main.get_command(cli).params for option in parameter.opts}
    assert options - {"-h", "--help"} == set(re.findall(r"^\| `(--[\w-]+)", page, re.MULTILINE))
    assert "`-h`" in page
    table = page.partition("## Commands")[2]
    told = {name for row in re.findall(r"^\| (`[^|]+) \|", table, re.MULTILINE) for name in CODE.findall(row)}
    assert {name for name, command in COMMANDS.items() if not command.hidden} == told


@pytest.mark.parametrize(
    ("page", "program", "command"),
    [
        ("simulator.md", sitl_cli, None),
        ("fuzzy.md", cli, "fuzzy"),
        ("pads.md", cli, "pad"),
        ("detect.md", cli, "detect"),
        ("calibrate-magnetometer.md", magnetometer_cli, None),
    ],
)
def test_a_command_s_options_are_in_its_page(page: str, program: typer.Typer, command: str | None) -> None:
    run = typer.main.get_command(program) if command is None else command_of(program, command)
    shown = [parameter for parameter in run.params if not getattr(parameter, "hidden", False)]
    options = {option for parameter in shown for option in parameter.opts if option.startswith("--")}
    assert options - EVERYWHERE == set(re.findall(r"^\| `(--[\w-]+)", TEXTS[page], re.MULTILINE))


def test_every_experiment_is_in_its_page() -> None:
    experiments = typer.main.get_command(experiments_cli).commands  # type: ignore[attr-defined]
    assert set(experiments) <= set(re.findall(r"^## ([\w-]+)", TEXTS["experiments.md"], re.MULTILINE))


def result_keys(model: type[BaseModel], prefix: str = "") -> list[str]:
    """The dotted keys of result.json; a list of events is one key."""
    keys = []
    for name, field in model.model_fields.items():
        inner = inner_model(field.annotation)
        keys += [f"{prefix}{name}"] if inner is None else result_keys(inner, f"{prefix}{name}.")
    return keys


def test_every_key_of_the_result_is_documented() -> None:
    table = TEXTS["flight-log.md"].partition("## `result.json`")[2]
    told = {
        key for row in table.splitlines() if row.startswith("| `") for key in CODE.findall(row.split("|")[1])
    }
    assert set(result_keys(Result)) == told - {"touchdown"}


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize("name", settings_table.PAGES)
def test_the_tables_are_up_to_date(name: str) -> None:
    page = TEXTS[Path(name).name]
    assert settings_table.page_text(page, name) == page, "run: python -m docs.settings_table"


def test_the_results_are_up_to_date_and_say_where_they_are_from() -> None:
    assert results.page_text() == TEXTS["measured.md"], "run: python -m docs.results"
    kept = [json.loads(path.read_text(encoding="utf-8")) for path in results.KEPT.glob("*.json")]
    assert kept
    assert [result for result in kept if results.refusal(result) is not None] == []


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"commit": "0123abc+"}, "files differed from it"),
        ({"commit": None}, "no commit; expected"),
        ({"date": "", "machine": {}}, "no machine, date; expected"),
    ],
)
def test_a_result_without_its_origin_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, Any], why: str
) -> None:
    good = json.loads((results.KEPT / "mpc.json").read_text(encoding="utf-8"))
    path = tmp_path / "mpc.json"
    path.write_text(json.dumps(good | change))
    assert results.main([str(path)]) == 2
    assert why in capsys.readouterr().err


def yaml_examples() -> list[tuple[str, dict[str, Any]]]:
    """The pages' YAML blocks, and the settings that the shipped file shows as a comment."""
    blocks = [
        (name, body) for name, text in TEXTS.items() for kind, body in FENCE.findall(text) if kind == "yaml"
    ]
    shown = re.search(r"^# link:\n(?:# .*\n)*", (CONFIG_FOLDER / "companion.yaml").read_text(), re.MULTILINE)
    assert shown is not None
    blocks.append(("companion.yaml", re.sub("^# ", "", shown[0], flags=re.MULTILINE)))
    return [(name, yaml.safe_load(body)) for name, body in blocks]


@pytest.mark.parametrize(("name", "example"), yaml_examples())
def test_every_example_in_yaml_is_valid(name: str, example: dict[str, Any]) -> None:
    model: type[BaseModel] = Scenario if "description" in example else CompanionConfig
    assert validate(model, example, name).model_fields_set == example.keys() != set()


def test_the_shipped_settings_file_sets_nothing_but_defaults() -> None:
    assert load_config(CONFIG_FOLDER / "companion.yaml") == CompanionConfig()
