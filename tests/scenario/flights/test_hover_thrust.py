"""An ArduPilot that was told a hover thrust far off is taken over without a fall, and lands."""

from pathlib import Path
from typing import Any

import pytest

from companion.base.messages import Outcome, PadState, PlanStep, VehicleState
from companion.flightlog.record import FlightLog
from tests.scenario.flying import FEW_PICTURES, fly_logged, notices, scenario_file

MOST_FALL_M = 0.3


class PlannedHeight(FlightLog):
    """Keeps how far below its reference (m, by our own estimate) the vehicle was while setpoints left."""

    def __init__(self) -> None:
        super().__init__(None, start_unix_s=0.0)
        self._vehicle: VehicleState | None = None
        self._pad: PadState | None = None
        self.below_m: list[float] = []

    def write(self, topic: str, message: Any, time_s: float) -> None:
        super().write(topic, message, time_s)
        if isinstance(message, VehicleState):
            self._vehicle = message
        elif isinstance(message, PadState):
            self._pad = message
        elif isinstance(message, PlanStep) and message.reference is not None and not message.on_ground:
            by_pad = message.reference.origin == "pad"
            if self._vehicle is None or (by_pad and self._pad is None):
                return
            down_m = self._vehicle.position_ned_m[2]
            if by_pad and self._pad is not None:
                down_m = -self._pad.relative_position_ned_m[2]
            self.below_m.append(down_m - float(message.reference.position_m[0, 2]))


@pytest.mark.parametrize(
    ("told", "mass_factor"),
    [
        (0.35, 1.3),  # ArduPilot's default for a vehicle that needs 0.65
        (0.6875, 0.7),  # half of it carries the weight
    ],
)
def test_it_is_taken_over_with_the_thrust_that_holds_it(
    tmp_path: Path, told: float, mass_factor: float
) -> None:
    changes = {
        "autopilot": "ardupilot",
        "autopilot_parameters": {"MOT_THST_HOVER": told},
        "mass_factor": mass_factor,
        "wind": {"mean_m_s": 5.0},
    }
    log = PlannedHeight()
    flight, _ = fly_logged(scenario_file(tmp_path, "line", {**changes, **FEW_PICTURES}), log)
    assert flight.report.outcome is Outcome.LANDED, notices(log)
    assert max(log.below_m) <= MOST_FALL_M
