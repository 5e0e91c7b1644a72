"""What is expected of the autopilot's parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.config import CONFIG_FOLDER, CompanionConfig, VehicleConfig, find_file, load_model, validate
from companion.tools.preflight.findings import FindingState
from companion.tools.preflight.parameters import Wanted, judge_parameters, parameter_names

VEHICLE = load_model(VehicleConfig, find_file("vehicles", "x500"))
GOOD: dict[AutopilotKind, dict[str, float | None]] = {
    "px4": {
        "COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 4, "COM_RC_OVERRIDE": 3, "COM_RCL_EXCEPT": 0,
        "COM_DISARM_LAND": 2.0, "MPC_TILTMAX_AIR": 45.0, "MPC_THR_HOVER": 0.5, "MPC_USE_HTE": 1,
        "MPC_Z_VEL_MAX_DN": 1.5, "MPC_Z_VEL_MAX_UP": 3.0,
    },
    "ardupilot": {
        "GUID_TIMEOUT": 1.0, "GUID_OPTIONS": 8, "ANGLE_MAX": 3000, "MOT_THST_HOVER": 0.5, "FS_THR_ENABLE": 1,
        "FS_OPTIONS": 16, "DISARM_DELAY": 10, "LAND_SPEED": 50, "WPNAV_ACCEL": 250.0, "PSC_JERK_XY": 5.0,
        "FENCE_ENABLE": 1, "FENCE_TYPE": 7, "FENCE_ACTION": 1, "FS_GCS_ENABLE": 0, "SYSID_MYGCS": 255,
    },
}  # fmt: skip


def states(
    kind: AutopilotKind, changed: Mapping[str, float | None], settings: dict[str, Any] | None = None
) -> dict[str, FindingState]:
    """The states of all that are not well."""
    config = validate(CompanionConfig, settings or {}, "test")
    found = judge_parameters(kind, {**GOOD[kind], **changed}, Wanted.of(config, VEHICLE, kind))
    return {finding.name: finding.state for finding in found if finding.state is not FindingState.OK}


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_good_values_are_well_and_all_are_asked_for(kind: AutopilotKind) -> None:
    assert states(kind, {}) == {}
    assert set(parameter_names(kind)) >= set(GOOD[kind])


RENAMED: dict[AutopilotKind, dict[str, tuple[str, float, float]]] = {  # new name, a good value, a bad one
    "px4": {"COM_RC_OVERRIDE": ("COM_RC_OVR_SPEED", 10.0, 0.0)},
    "ardupilot": {
        "ANGLE_MAX": ("ATC_ANGLE_MAX", 30.0, 10.0),
        "LAND_SPEED": ("LAND_SPD_MS", 0.5, 2.0),
        "WPNAV_ACCEL": ("WP_ACC", 2.5, 0.0),
        "PSC_JERK_XY": ("PSC_NE_JERK", 5.0, 0.0),
    },
}


@pytest.mark.parametrize(
    ("kind", "old", "new", "good", "bad"),
    [(kind, old, *rest) for kind, renamed in RENAMED.items() for old, rest in renamed.items()],
)
def test_another_version_s_name_and_unit_are_known(
    kind: AutopilotKind, old: str, new: str, good: float, bad: float
) -> None:
    assert new in parameter_names(kind)
    velocity = {"control": {"setpoint": "velocity"}} if old in ("WPNAV_ACCEL", "PSC_JERK_XY") else {}
    assert states(kind, {old: None, new: good}, velocity) == {}
    assert states(kind, {old: None, new: bad}, velocity) == {new: FindingState.WARNING}


@pytest.mark.parametrize(
    ("kind", "name", "value", "state"),
    [
        ("px4", "COM_OF_LOSS_T", 5.0, FindingState.FAIL),
        ("px4", "COM_OF_LOSS_T", 0.1, FindingState.FAIL),
        ("px4", "COM_OF_LOSS_T", 1.5, FindingState.FAIL),
        ("px4", "COM_OBL_RC_ACT", 6, FindingState.FAIL),
        ("px4", "COM_OBL_RC_ACT", 7, FindingState.FAIL),
        ("px4", "COM_OBL_RC_ACT", 2, FindingState.WARNING),
        ("px4", "COM_OBL_RC_ACT", 0, FindingState.WARNING),
        ("px4", "COM_RC_OVERRIDE", 1, FindingState.WARNING),
        ("px4", "COM_RCL_EXCEPT", 4, FindingState.WARNING),
        ("px4", "COM_DISARM_LAND", -1.0, FindingState.WARNING),
        ("px4", "MPC_TILTMAX_AIR", 20.0, FindingState.WARNING),
        ("px4", "MPC_THR_HOVER", 0.3, FindingState.WARNING),
        ("px4", "MPC_USE_HTE", 0, FindingState.WARNING),
        ("px4", "MPC_Z_VEL_MAX_DN", 0.5, FindingState.WARNING),
        ("px4", "MPC_Z_VEL_MAX_UP", 0.5, FindingState.WARNING),
        ("ardupilot", "GUID_TIMEOUT", 5.0, FindingState.FAIL),
        ("ardupilot", "GUID_TIMEOUT", 3.0, FindingState.FAIL),
        ("ardupilot", "GUID_OPTIONS", 0, FindingState.FAIL),
        ("ardupilot", "GUID_OPTIONS", 7, FindingState.FAIL),
        ("ardupilot", "ANGLE_MAX", 2000, FindingState.WARNING),
        ("ardupilot", "MOT_THST_HOVER", 0.3, FindingState.WARNING),
        ("ardupilot", "FS_THR_ENABLE", 0, FindingState.WARNING),
        ("ardupilot", "FS_OPTIONS", 4, FindingState.WARNING),
        ("ardupilot", "DISARM_DELAY", 0, FindingState.WARNING),
        ("ardupilot", "LAND_SPEED", 150, FindingState.WARNING),
        ("px4", "COM_OBL_RC_ACT", None, FindingState.FAIL),
        ("px4", "COM_OF_LOSS_T", None, FindingState.FAIL),
        ("ardupilot", "GUID_TIMEOUT", None, FindingState.FAIL),
        ("ardupilot", "FENCE_ENABLE", 0, FindingState.WARNING),
        ("ardupilot", "FENCE_TYPE", 5, FindingState.WARNING),
        ("ardupilot", "FENCE_ACTION", 0, FindingState.WARNING),
        ("px4", "MPC_USE_HTE", None, FindingState.NOT_CHECKED),
    ],
)
def test_a_value_that_differs_is_found_alone(
    kind: AutopilotKind, name: str, value: float | None, state: FindingState
) -> None:
    assert states(kind, {name: value}) == {name: state}


def test_how_short_the_time_out_may_be_depends_on_what_follows_it() -> None:
    assert states("px4", {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 4}) == {}
    assert states("px4", {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 5}) == {"COM_OF_LOSS_T": FindingState.FAIL}


def test_what_is_expected_follows_the_settings() -> None:
    steep = {"control": {"limits": {"tilt_deg": 45.0}}}
    assert states("ardupilot", {}, steep) == {"ANGLE_MAX": FindingState.WARNING}
    velocity = {"control": {"setpoint": "velocity"}}
    assert states("ardupilot", {"GUID_OPTIONS": 0}, velocity) == {}
    assert states("ardupilot", {"PSC_JERK_XY": 0.0}, velocity) == {"PSC_JERK_XY": FindingState.WARNING}
    may_set = {"link": {"set_parameters": True}}
    assert states("ardupilot", {"GUID_OPTIONS": 0}, may_set) == {"GUID_OPTIONS": FindingState.WARNING}


def test_every_hint_says_what_was_expected() -> None:
    bad: dict[str, float | None] = dict.fromkeys(GOOD["px4"], -1.0)
    config = CompanionConfig()
    for finding in judge_parameters("px4", bad, Wanted.of(config, VEHICLE, "px4")):
        assert finding.state in (FindingState.OK, FindingState.NOT_CHECKED) or finding.hint.startswith(
            ("expected", "the vehicle")
        )


def test_each_is_in_its_page() -> None:
    page = (CONFIG_FOLDER.parent / "docs" / "reference" / "autopilot-parameters.md").read_text()
    names = {name for kind in GOOD for name in parameter_names(kind)}
    assert [name for name in names if f"| `{name}` |" not in page] == []


# ---------------------------------------------------------------- vision only

TELLS: dict[str, Any] = {"control": {"output": "landing_target"}}
TARGET_GOOD: dict[AutopilotKind, dict[str, float | None]] = {
    "px4": {"RTL_PLD_MD": 2},
    "ardupilot": {
        "PLND_ENABLED": 1, "PLND_TYPE": 1, "PLND_LAG": 0.09, "PLND_OPTIONS": 1, "PLND_YAW_ALIGN": 0,
        "PLND_CAM_POS_X": 0.0, "PLND_CAM_POS_Y": 0.0, "PLND_CAM_POS_Z": 0.0,
    },
}  # fmt: skip


def target_states(
    kind: AutopilotKind, changed: Mapping[str, float | None], settings: dict[str, Any] | None = None
) -> dict[str, FindingState]:
    return states(kind, {**TARGET_GOOD[kind], **changed}, {**TELLS, **(settings or {})})


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_vision_only_asks_for_the_landing_s_own_parameters_and_for_no_other(kind: AutopilotKind) -> None:
    assert set(parameter_names(kind, "landing_target")) == set(TARGET_GOOD[kind])
    assert target_states(kind, {}) == {}


@pytest.mark.parametrize(
    ("kind", "name", "value", "state"),
    [
        ("ardupilot", "PLND_ENABLED", 0, FindingState.FAIL),
        ("ardupilot", "PLND_TYPE", 2, FindingState.FAIL),
        ("ardupilot", "PLND_LAG", 0.02, FindingState.WARNING),
        ("ardupilot", "PLND_YAW_ALIGN", 9000, FindingState.FAIL),
        ("ardupilot", "PLND_CAM_POS_X", 0.1, FindingState.FAIL),
        ("px4", "RTL_PLD_MD", 0, FindingState.WARNING),
    ],
)
def test_what_keeps_a_target_from_being_used_is_said(
    kind: AutopilotKind, name: str, value: float, state: FindingState
) -> None:
    assert target_states(kind, {name: value}) == {name: state}


def test_a_pad_that_moves_wants_moving_targets() -> None:
    assert target_states("ardupilot", {"PLND_OPTIONS": 0}) == {}
    moves = {"sense": {"vision": {"pad_on": "vehicle"}}}
    assert target_states("ardupilot", {"PLND_OPTIONS": 0}, moves) == {"PLND_OPTIONS": FindingState.WARNING}
