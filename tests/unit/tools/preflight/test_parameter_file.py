"""The parameters that differ, as a file: both ground stations load it, and it sets what is expected."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import typer

from companion.base.autopilot_kind import AutopilotKind
from companion.config import CompanionConfig, ConfigError, VehicleConfig, find_file, load_model
from companion.link.codec import mavlink
from companion.link.commands import ParameterRequest, ParameterRequests
from companion.tools.commands import check_command
from companion.tools.pad_check import job
from companion.tools.preflight.findings import Finding, FindingState, findings_json
from companion.tools.preflight.parameters import (
    GROUP,
    RULES,
    ParameterReadings,
    Wanted,
    judge_parameters,
    parameter_file,
    with_change,
)

VEHICLE = load_model(VehicleConfig, find_file("vehicles", "x500"))
REAL, INT32, INT16 = mavlink.MAV_PARAM_TYPE_REAL32, mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_INT16
# all differ, with the bits that others need set beside
BAD: dict[AutopilotKind, dict[str, float]] = {
    "px4": {
        "COM_OF_LOSS_T": 5.0,
        "COM_OBL_RC_ACT": 0.0,
        "COM_RC_OVERRIDE": 1.0,
        "COM_RCL_EXCEPT": 5.0,
        "COM_DISARM_LAND": -1.0,
        "MPC_TILTMAX_AIR": 5.0,
        "MPC_THR_HOVER": 0.9,
        "MPC_USE_HTE": 0.0,
        "MPC_Z_VEL_MAX_DN": 0.1,
        "MPC_Z_VEL_MAX_UP": 0.1,
    },
    "ardupilot": {
        "GUID_TIMEOUT": 5.0,
        "FENCE_ENABLE": 0.0,
        "FENCE_TYPE": 5.0,
        "FENCE_ACTION": 0.0,
        "GUID_OPTIONS": 1.0,
        "ANGLE_MAX": 500.0,
        "MOT_THST_HOVER": 0.9,
        "FS_THR_ENABLE": 0.0,
        "FS_OPTIONS": 20.0,
        "DISARM_DELAY": 0.0,
        "LAND_SPEED": 200.0,
        "WPNAV_ACCEL": 0.0,
        "PSC_JERK_XY": 0.0,
    },
}
KINDS: tuple[AutopilotKind, ...] = ("px4", "ardupilot")
UNSETTLED = {"MPC_THR_HOVER", "MOT_THST_HOVER"}


def wanted(kind: AutopilotKind) -> Wanted:
    config = CompanionConfig()
    if kind == "ardupilot":
        config = config.model_copy(
            update={"control": config.control.model_copy(update={"setpoint": "velocity"})}
        )
        # velocity setpoints are shaped by more parameters; attitude ones by GUID_OPTIONS
        return replace(Wanted.of(config, VEHICLE, kind), setpoints=frozenset({"attitude", "velocity"}))
    return Wanted.of(config, VEHICLE, kind)


def found(
    kind: AutopilotKind, values: dict[str, float], types: dict[str, int] | None = None
) -> list[Finding]:
    read = ParameterReadings(7, values, types or {})
    judged = judge_parameters(kind, values, wanted(kind))
    return [with_change(finding, read, wanted(kind)) for finding in judged]


def as_qgroundcontrol(text: str) -> dict[str, tuple[int, int, float, int]]:
    """What its ParameterManager takes: five columns between tabs, no '#' first."""
    taken = {}
    for line in text.splitlines():
        columns = line.split("\t")
        if not line.startswith("#") and len(columns) == 5:
            system, component, name, value, mav_type = columns
            taken[name] = (int(system), int(component), float(value), int(mav_type))
    return taken


def as_mission_planner(text: str) -> dict[str, float]:
    """What its ParamFile takes: two words between blanks, commas or tabs, no '#' first."""
    taken = {}
    for line in text.splitlines():
        words = line.replace(",", " ").replace("\t", " ").split()
        if not line.startswith("#") and len(words) == 2:
            taken[words[0]] = float(words[1])
    return taken


@pytest.mark.parametrize("kind", KINDS)
def test_both_ground_stations_take_the_same_and_what_they_set_is_expected(kind: AutopilotKind) -> None:
    assert BAD[kind].keys() == RULES[kind].keys()
    text = parameter_file(found(kind, BAD[kind]))
    theirs = as_mission_planner(text)
    assert theirs.keys() == BAD[kind].keys() - UNSETTLED
    assert {name: value for name, (_, _, value, _) in as_qgroundcontrol(text).items()} == theirs
    after = {**BAD[kind], **theirs}
    states = {item.name: item.state for item in found(kind, after)}
    assert {name for name, state in states.items() if state is not FindingState.OK} <= UNSETTLED


@pytest.mark.parametrize("kind", KINDS)
def test_a_reason_stands_over_each(kind: AutopilotKind) -> None:
    lines = parameter_file(found(kind, BAD[kind])).splitlines()
    hints = {item.name: item.hint for item in found(kind, BAD[kind])}
    for index, line in enumerate(lines):
        if not line.startswith("#") and "\t" in line:
            name = line.split("\t")[2]
            assert lines[index - 1] == f"# {name} is {BAD[kind][name]:g}; {hints[name]}"


def test_other_bits_stay_and_the_type_and_system_are_the_autopilots() -> None:
    types = {"GUID_OPTIONS": INT32, "ANGLE_MAX": INT16}
    taken = as_qgroundcontrol(parameter_file(found("ardupilot", BAD["ardupilot"], types)))
    assert taken["GUID_OPTIONS"] == (7, 1, 9.0, INT32)
    assert taken["FS_OPTIONS"][2] == 16.0
    assert taken["ANGLE_MAX"][3] == INT16
    assert taken["LAND_SPEED"][3] == REAL


def test_a_hover_thrust_that_differs_is_told_and_not_set() -> None:
    text = parameter_file(found("px4", {"MPC_THR_HOVER": 0.9}))
    assert "# not set here: MPC_THR_HOVER is 0.9; the vehicle's file says" in text
    assert not as_qgroundcontrol(text)
    assert not as_mission_planner(text)


def test_what_does_not_differ_or_was_not_read_is_left_out() -> None:
    text = parameter_file(found("px4", {"MPC_USE_HTE": 1.0}))
    assert text.endswith("# no parameter differs\n")


def test_with_land_as_the_failsafe_the_time_before_it_is_shorter() -> None:
    text = parameter_file(found("px4", {"COM_OF_LOSS_T": 2.0, "COM_OBL_RC_ACT": 4.0}))
    assert as_mission_planner(text) == {"COM_OF_LOSS_T": 0.5}


def test_the_json_of_findings_without_a_change_is_as_before() -> None:
    plain = json.loads(findings_json(found("px4", {"MPC_USE_HTE": 1.0, "COM_DISARM_LAND": 0.0})))["findings"]
    assert [sorted(item) for item in plain if item["name"] == "MPC_USE_HTE"] == [
        ["detail", "group", "hint", "name", "state"]
    ]
    [change] = [item["change"] for item in plain if item["name"] == "COM_DISARM_LAND"]
    assert change == {"system_id": 7, "value": 0.0, "expected": 2.0, "mav_type": REAL}


def test_the_type_is_the_one_that_the_autopilot_reports() -> None:
    requests, request = ParameterRequests(), ParameterRequest("LAND_SPEED")
    requests.submit(request)
    requests.to_send(0.0, 1)
    requests.heard(mavlink.MAVLink_param_value_message(b"LAND_SPEED", 50.0, INT16, 1, 0), "ardupilot")
    assert (request.value, request.mav_type) == (50.0, INT16)


@pytest.mark.parametrize("read", [True, False])
def test_the_file_is_written_or_the_reason_why_not_is_said(
    read: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    findings = (
        found("px4", BAD["px4"])
        if read
        else [Finding(GROUP, "parameters", FindingState.NOT_CHECKED, "the service has it", "stop it")]
    )

    async def checked(*_words: object, **_options: object) -> list[Finding]:
        return findings

    monkeypatch.setattr(job, "preflight", checked)
    target = tmp_path / "changes.params"
    path = find_file("cameras", "sitl_640x480").parents[1] / "companion.yaml"
    if read:
        with pytest.raises(typer.Exit):
            job.check_vehicle(path, None, None, linked=True, params_file=target)
        assert as_mission_planner(target.read_text())["COM_OBL_RC_ACT"] == 5.0
    else:
        with pytest.raises(
            ConfigError, match=r"since no parameter was read: the service has it; expected stop it$"
        ):
            job.check_vehicle(path, None, None, linked=True, params_file=target)
        assert not target.exists()


def test_only_what_a_hover_settles_has_no_target() -> None:
    rules = {name: rule for kind in RULES for name, rule in RULES[kind].items()}
    assert {name for name, rule in rules.items() if rule.target is None} == UNSETTLED


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"pad": True}, "expected it without --pad"),
        ({"no_link": True}, "expected it without --no-link"),
        ({"params_file": Path("/nowhere/at/all.params")}, "expected a file in an existing folder"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    options: dict[str, object], words: str, tmp_path: Path
) -> None:
    shipped = find_file("cameras", "sitl_640x480").parents[1] / "companion.yaml"
    given: dict[str, object] = {"config": shipped, "params_file": tmp_path / "a.params", **options}
    with pytest.raises(ConfigError, match=words):
        check_command(**given)  # type: ignore[arg-type]
