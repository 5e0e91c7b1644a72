"""Both autopilots, one after the other: standing, in the air, and at the other end of a link."""

import pytest

from companion.base.autopilot_kind import AutopilotKind
from tests.unit.sitl.autopilot.autopilot_flight import AUTOPILOT_KINDS, AutopilotFlight, in_the_air
from tests.unit.sitl.autopilot.missions.mission_desk import Station


@pytest.fixture(params=AUTOPILOT_KINDS)
def autopilot_kind(request: pytest.FixtureRequest) -> AutopilotKind:
    kind: AutopilotKind = request.param
    return kind


@pytest.fixture
def flight(autopilot_kind: AutopilotKind) -> AutopilotFlight:
    return AutopilotFlight(autopilot_kind)


@pytest.fixture
def airborne(autopilot_kind: AutopilotKind) -> AutopilotFlight:
    return in_the_air(autopilot_kind)


@pytest.fixture
def station(autopilot_kind: AutopilotKind) -> Station:
    return Station(autopilot_kind)
