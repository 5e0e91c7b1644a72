"""The options that name a firmware: what goes together, on every command that flies one."""

import json
import sys
from pathlib import Path

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.config import CONFIG_FOLDER, ConfigError
from companion.sim.flights import Request
from companion.sim.settings import sitl_settings
from companion.sim.trial import External, Trial
from sitl.campaign.manifest import CampaignRun, check_goes_on, make_plan
from sitl.campaign.worker import Worker
from sitl.firmware.spec import FirmwareSpec, number_text
from tests.programs import ProgramHere
from tests.unit.sitl.campaign.campaign_parts import flight
from tests.unit.sitl.firmware.fake_firmware import fake

FLOWN = ["--sitl", "--firmware", "px4", "--firmware-path", "BIN"]
SETTINGS = CONFIG_FOLDER / "companion.yaml"


@pytest.fixture(name="px4")
def px4_program(tmp_path: Path) -> FirmwareSpec:
    return fake("px4", tmp_path).spec


# ---------------------------------------------------------------- the options


def test_none_is_none_and_both_are_a_firmware(px4: FirmwareSpec) -> None:
    assert FirmwareSpec.of(None, None) is None
    assert FirmwareSpec.of("px4", px4.path, ["A=1", " B_2 = -0.5 "]) == FirmwareSpec(
        "px4", px4.path, (("A", 1.0), ("B_2", -0.5))
    )


def test_a_path_is_reported_from_wherever_the_command_was_given(
    px4: FirmwareSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(px4.path.parent)
    assert FirmwareSpec.of("px4", Path("px4")) == px4


def test_one_without_the_other_is_refused(px4: FirmwareSpec) -> None:
    given: list[tuple[AutopilotKind | None, Path | None]] = [("px4", None), (None, px4.path)]
    for kind, path in given:
        with pytest.raises(ConfigError, match="expected both, or neither"):
            FirmwareSpec.of(kind, path)


def test_a_parameter_of_no_firmware_is_refused() -> None:
    with pytest.raises(ConfigError, match="--firmware-param: expected it with --firmware and"):
        FirmwareSpec.of(None, None, ["A=1"])


@pytest.mark.parametrize(
    "text", ["A", "A=", "=1", "A=one", "A=nan", "A=inf", "A B=1", "1A=1", "A=1=2", "A;B=1"]
)
def test_a_parameter_of_another_form_is_refused(text: str, px4: FirmwareSpec) -> None:
    with pytest.raises(ConfigError) as caught:
        FirmwareSpec.of("px4", px4.path, [text])
    assert str(caught.value) == f"--firmware-param {text}: expected NAME=VALUE, a number"


def test_what_is_no_program_is_refused(px4: FirmwareSpec, tmp_path: Path) -> None:
    text = tmp_path / "text"
    text.write_text("no program")
    for path in (tmp_path, text, tmp_path / "nowhere"):
        with pytest.raises(ConfigError) as caught:
            FirmwareSpec.of("px4", path)
        assert str(caught.value) == f"--firmware-path {path}: expected the program that a SITL build made"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (-3.0, "-3"), (12345678.0, "12345678"), (0.1, "0.1"), (0.123456789, "0.123456789")],
)
def test_a_value_keeps_its_digits_and_a_whole_number_has_no_exponent(value: float, text: str) -> None:
    assert number_text(value) == text


def test_its_words_and_its_json_make_it_again(px4: FirmwareSpec) -> None:
    named = FirmwareSpec("px4", px4.path, (("A", 12345678.0), ("B", 0.1)))
    kind, path, *parameters = (
        word for word in named.options if word not in ("--firmware", "--firmware-path")
    )
    assert FirmwareSpec.of("px4", Path(path), [p.partition("=")[2] for p in parameters]) == named
    assert kind == "px4"
    asked = {"scenario": "static", "seed": 0, "firmware": named.as_json()}
    assert Request.model_validate_json(json.dumps(asked)).firmware == named


# ---------------------------------------------------------------- the commands


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--sitl", "--firmware", "px4"], "--firmware and --firmware-path: expected both, or neither"),
        (["--sitl", "--firmware-path", "BIN"], "--firmware and --firmware-path: expected both, or neither"),
        (["--sitl", "--firmware-param", "A=1"], "--firmware-param: expected it with --firmware and"),
        (["--sitl", "--firmware", "px4", "--firmware-path", "nowhere"], "--firmware-path nowhere: expected"),
        ([*FLOWN, "--firmware-param", "A"], "--firmware-param A: expected NAME=VALUE"),
        (
            [*FLOWN, "--autopilot", "external", "--connect", "udpin:127.0.0.1:1"],
            "--firmware: expected to be left out with --autopilot external",
        ),
        (["--sitl", "--firmware", "betaflight"], "Invalid value for '--firmware'"),
        (["--firmware", "px4"], "--firmware: needs --sitl"),
        (["--firmware-path", "BIN"], "--firmware-path: needs --sitl"),
        (["--firmware-param", "A=1"], "--firmware-param: needs --sitl"),
    ],
)
def test_the_app_refuses_in_one_line_what_does_not_go_together(
    words: list[str], text: str, px4: FirmwareSpec, program: ProgramHere
) -> None:
    said = program("companion", *(px4.path if word == "BIN" else word for word in words)).refusal
    assert said.startswith(f"companion: {text}")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--firmware", "px4"], "--firmware and --firmware-path: expected both, or neither"),
        (["--firmware-param", "A=1"], "--firmware-param: expected it with --firmware and"),
        (["campaign", "--firmware", "px4"], "--firmware and --firmware-path: expected both, or neither"),
        (["campaign", "--firmware-param", "A=1"], "--firmware-param: expected it with --firmware and"),
        (
            ["--external", "udp:127.0.0.1:9", "--firmware", "px4"],
            "--firmware: has no effect with an external vehicle",
        ),
        *(
            (
                ["--firmware", "px4", "--firmware-path", "BIN", *more],
                f"{more[0]}: applies to the bundled autopilot; expected it without --firmware",
            )
            for more in (["--serve-truth"], ["--signing-key", "key"], ["--autopilot", "px4"])
        ),
    ],
)
def test_the_simulator_refuses_in_one_line_what_does_not_go_together(
    words: list[str], text: str, px4: FirmwareSpec, program: ProgramHere
) -> None:
    said = program("companion-sitl", *(px4.path if word == "BIN" else word for word in words)).refusal
    assert said.startswith(f"companion-sitl: {text}")


# ---------------------------------------------------------------- what they make


def test_the_app_takes_the_system_that_it_hears_for_px4_numbers_itself(px4: FirmwareSpec) -> None:
    trial = Trial.load("static", 0, firmware=px4)
    assert sitl_settings(SETTINGS, trial, fast=True).link.system_id == 0
    assert sitl_settings(SETTINGS, Trial.load("static", 0), fast=True).link.system_id == 1


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_a_firmware_flies_as_itself_whatever_the_scenario_says(kind: AutopilotKind, tmp_path: Path) -> None:
    spec = fake(kind, tmp_path).spec
    for scenario in ("static", "line"):
        assert Trial.load(scenario, 0, firmware=spec).scenario.autopilot == kind


def test_nobodys_firmware_flies_somebody_elses_vehicle(px4: FirmwareSpec) -> None:
    with pytest.raises(ConfigError, match="--firmware: expected to be left out with"):
        Trial.load("static", 0, External("udpin:127.0.0.1:14540"), px4)


# ---------------------------------------------------------------- campaigns


def planned(firmware: FirmwareSpec | None) -> CampaignRun:
    return next(make_plan(["static"], 3, 1, None, firmware).flights())


def test_a_campaigns_runs_name_their_firmware(px4: FirmwareSpec) -> None:
    named = FirmwareSpec("px4", px4.path, (("A", 0.5),))
    assert planned(named).firmware == named
    assert planned(named).command == (
        f"companion --sitl --fast --scenario static --seed 3 --firmware px4 --firmware-path {px4.path} "
        "--firmware-param=A=0.5"
    )
    assert planned(None).firmware is None


def test_a_campaign_with_another_firmware_is_another_campaign(tmp_path: Path) -> None:
    one, other = fake("px4", tmp_path).spec, fake("ardupilot", tmp_path).spec
    changed = FirmwareSpec("px4", one.path, (("A", 1.0),))
    plans = [make_plan(["static"], 0, 1, None, spec).manifest for spec in (None, one, changed, other)]
    for mine in plans:
        check_goes_on(mine, mine, tmp_path)
        for another in plans:
            if another is not mine:
                with pytest.raises(ConfigError, match="holds another campaign: its firmware is ") as caught:
                    check_goes_on(mine, another, tmp_path)
                assert "\n" not in str(caught.value)
    with pytest.raises(ConfigError, match="its firmware is the bundled autopilot; expected the same"):
        check_goes_on(plans[0], plans[1], tmp_path)


def test_a_worker_asks_for_the_firmware(px4: FirmwareSpec, tmp_path: Path) -> None:
    heard = tmp_path / "heard"
    program = f"import sys; open({str(heard)!r}, 'w').write(sys.stdin.readline())"
    worker = Worker((sys.executable, "-c", program))
    worker.fly(flight(0, firmware=px4))
    worker.close()
    assert Request.model_validate_json(heard.read_bytes()).firmware == px4
