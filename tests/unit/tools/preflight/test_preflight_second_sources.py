"""What `companion check` says of two horizons of one vehicle that stands."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from companion.base.geometry import Vector3
from companion.config import EstimateConfig
from companion.tools.preflight.findings import Finding, FindingGroup, FindingState
from companion.tools.preflight.run import compared

NOW = datetime(2026, 6, 1, tzinfo=UTC)
ZURICH, CAPE_TOWN = (47.4, 8.5, 488.0), (-33.9, 18.4, 20.0)


def with_horizon(roll_deg: float, pitch_deg: float) -> list[Finding]:
    finding = FindingGroup("somebody").ok("at rest", "still")
    return [finding, replace(finding, horizon_rad=(math.radians(roll_deg), math.radians(pitch_deg)))]


@pytest.mark.parametrize(
    ("pitch_deg", "state"), [(0.5, FindingState.OK), (4.5, FindingState.WARNING), (-12.0, FindingState.FAIL)]
)
def test_two_horizons_are_judged_by_the_table(pitch_deg: float, state: FindingState) -> None:
    found, _ = compared(with_horizon(2.0, pitch_deg), with_horizon(2.0, 0.0), EstimateConfig(), NOW)
    assert (found.name, found.state) == ("attitude", state)
    assert f"roll 2.0, pitch {pitch_deg:.1f} deg" in found.detail
    assert "the autopilot's roll 2.0, pitch 0.0 deg" in found.detail


@pytest.mark.parametrize("known", [0, 1])
def test_one_horizon_alone_is_not_compared(known: int) -> None:
    both = [with_horizon(0.0, 0.0), with_horizon(0.0, 0.0)[:1]]
    found, _ = compared(both[known], both[1 - known], EstimateConfig(), NOW)
    assert found.state is FindingState.NOT_CHECKED


def with_place(place: Vector3 | None) -> list[Finding]:
    return [replace(FindingGroup("somebody").ok("fix", "good"), place=place)]


def declination(ours: Vector3 | None, autopilots: Vector3 | None) -> Finding:
    told = EstimateConfig(magnetic_field_ned_ut=(20.9, 0.6, 42.9))
    _, found = compared(with_place(ours), with_place(autopilots), told, NOW)
    assert found.name == "magnetic declination"
    return found


def test_the_field_that_is_set_is_judged_at_our_fix_before_the_autopilots_home() -> None:
    assert declination(ZURICH, CAPE_TOWN).state is FindingState.OK
    assert declination(None, None).state is FindingState.NOT_CHECKED
    for told in (declination(CAPE_TOWN, ZURICH), declination(None, CAPE_TOWN)):
        assert told.state is FindingState.WARNING
        assert "magnetic_field_ned_ut 1.6 deg, the World Magnetic Model" in told.detail
        assert " -26.7 deg [9.6, " in told.detail
        assert told.hint == "remove estimate.magnetic_field_ned_ut: the app then uses the model"
