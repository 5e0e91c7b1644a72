"""What `companion check` says of two horizons of one vehicle that stands."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from companion.tools.preflight.findings import Finding, FindingGroup, FindingState
from companion.tools.preflight.second_sources import compared


def with_horizon(roll_deg: float, pitch_deg: float) -> list[Finding]:
    finding = FindingGroup("somebody").ok("at rest", "still")
    return [finding, replace(finding, horizon_rad=(math.radians(roll_deg), math.radians(pitch_deg)))]


@pytest.mark.parametrize(
    ("pitch_deg", "state"),
    [(0.5, FindingState.OK), (4.5, FindingState.WARNING), (-12.0, FindingState.FAIL)],
)
def test_two_horizons_are_judged_by_the_table(pitch_deg: float, state: FindingState) -> None:
    (found,) = compared(with_horizon(2.0, pitch_deg), with_horizon(2.0, 0.0))
    assert (found.name, found.state) == ("attitude", state)
    assert f"roll 2.0, pitch {pitch_deg:.1f} deg" in found.detail
    assert "the autopilot's roll 2.0, pitch 0.0 deg" in found.detail


@pytest.mark.parametrize("known", [0, 1])
def test_one_horizon_alone_is_not_compared(known: int) -> None:
    both = [with_horizon(0.0, 0.0), with_horizon(0.0, 0.0)[:1]]
    (found,) = compared(both[known], both[1 - known])
    assert found.state is FindingState.NOT_CHECKED
