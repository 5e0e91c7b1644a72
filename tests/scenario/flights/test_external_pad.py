"""Landings on a pad that does not carry the vehicle, whose own ground stops it: as on other people's SITL."""

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import Outcome
from tests.scenario.external_flight import fly_external

TRIES_AGAIN = "to try again"


@pytest.mark.parametrize(("scenario", "kind"), [("line", "px4"), ("circle", "px4"), ("line", "ardupilot")])
def test_a_landing_on_a_moving_pad_is_not_thrown_away_at_the_contact(
    scenario: str, kind: AutopilotKind
) -> None:
    flight = fly_external(scenario, 0, kind)
    assert flight.result.outcome is Outcome.LANDED, flight
    assert flight.result.touchdown is not None
    assert flight.result.touchdown.lateral_error_m <= 0.06, flight
    assert not any(TRIES_AGAIN in text for text in flight.told), flight
