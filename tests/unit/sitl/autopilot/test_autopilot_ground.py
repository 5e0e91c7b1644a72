"""The simulated flight controller notices the ground as the real ones do, and nothing else for it."""

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import LandedState
from sitl.autopilot.control.estimator import EstimatorErrors
from sitl.autopilot.flight.modes import CommandResult
from tests.unit.sitl.autopilot.autopilot_flight import (
    AUTOPILOT_KINDS,
    PX4_OFFBOARD,
    STAND_STILL,
    AutopilotFlight,
    in_the_air,
    landed_state,
    ready,
    velocity,
)

BOTH = pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])


@BOTH
def test_a_landing_by_setpoints_is_noticed_and_then_disarming_is_allowed(
    autopilot_kind: AutopilotKind,
) -> None:
    flight = in_the_air(autopilot_kind)
    while flight.vehicle.height_m > 0.0:
        flight.run(0.1, velocity(0.0, 0.0, 0.5))
    assert landed_state(flight) is not LandedState.ON_GROUND
    flight.run(1.0 if autopilot_kind == "ardupilot" else 5.0, velocity(0.0, 0.0, 0.3))
    assert landed_state(flight) is not LandedState.ON_GROUND  # as in the recordings: 2 s, and 6 s and more
    flight.run(1.5 if autopilot_kind == "ardupilot" else 4.5, velocity(0.0, 0.0, 0.3))
    assert landed_state(flight) is LandedState.ON_GROUND
    assert flight.autopilot.disarm() is CommandResult.ACCEPTED


def test_in_offboard_px4_is_ready_to_arm_while_setpoints_come_and_ardupilot_in_guided_without() -> None:
    for kind in AUTOPILOT_KINDS:
        flight = AutopilotFlight(kind)
        flight.run(5.0)
        flight.take_control()
        flight.autopilot.set_mode(PX4_OFFBOARD if kind == "px4" else 4)
        flight.run(1.0, STAND_STILL)
        assert ready(flight)
        flight.run(1.5)
        assert ready(flight) is (kind == "ardupilot")
        flight.run(0.5, STAND_STILL)
        assert ready(flight)


@BOTH
def test_a_slow_descent_in_the_air_is_not_taken_for_the_ground(autopilot_kind: AutopilotKind) -> None:
    flight = in_the_air(autopilot_kind, errors=EstimatorErrors())
    for _ in range(20):
        flight.run(0.5, velocity(0.0, 0.0, 0.15))
        assert landed_state(flight) is LandedState.IN_AIR
    assert flight.vehicle.velocity[2] == pytest.approx(0.15, abs=0.15)


@BOTH
def test_it_rides_a_moving_pad_once_landed(autopilot_kind: AutopilotKind) -> None:
    flight = in_the_air(autopilot_kind)
    flight.vehicle.floor_velocity_ned_m_s = (1.0, 0.0, 0.0)
    while flight.vehicle.height_m > 0.0:
        flight.run(0.1, velocity(1.0, 0.0, 0.5))
    flight.run(10.0, velocity(1.0, 0.0, 0.3))
    assert landed_state(flight) is LandedState.ON_GROUND
    assert flight.vehicle.height_m == 0.0
