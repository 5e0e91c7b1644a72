"""The simulated flight controller notices the ground as the real ones do, and nothing else for it."""

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import LandedState
from sitl.autopilot.control.estimator import EstimatorErrors
from sitl.autopilot.flight.modes import CommandResult
from tests.unit.sitl.autopilot.autopilot_flight import (
    PX4_OFFBOARD,
    STAND_STILL,
    AutopilotFlight,
    in_the_air,
    landed_state,
    ready,
    set_down,
    velocity,
)


def test_a_landing_by_setpoints_is_noticed_and_then_disarming_is_allowed(
    airborne: AutopilotFlight, autopilot_kind: AutopilotKind
) -> None:
    set_down(airborne)
    assert landed_state(airborne) is not LandedState.ON_GROUND
    airborne.run(1.0 if autopilot_kind == "ardupilot" else 5.0, velocity(0.0, 0.0, 0.3))
    assert landed_state(airborne) is not LandedState.ON_GROUND  # as in the recordings: 2 s, and 6 s and more
    airborne.run(1.5 if autopilot_kind == "ardupilot" else 4.5, velocity(0.0, 0.0, 0.3))
    assert landed_state(airborne) is LandedState.ON_GROUND
    assert airborne.autopilot.disarm() is CommandResult.ACCEPTED


def test_in_offboard_px4_is_ready_to_arm_while_setpoints_come_and_ardupilot_in_guided_without(
    flight: AutopilotFlight, autopilot_kind: AutopilotKind
) -> None:
    flight.run(5.0)
    flight.take_control()
    flight.autopilot.set_mode(PX4_OFFBOARD if autopilot_kind == "px4" else 4)
    flight.run(1.0, STAND_STILL)
    assert ready(flight)
    flight.run(1.5)
    assert ready(flight) is (autopilot_kind == "ardupilot")
    flight.run(0.5, STAND_STILL)
    assert ready(flight)


def test_a_slow_descent_in_the_air_is_not_taken_for_the_ground(autopilot_kind: AutopilotKind) -> None:
    flight = in_the_air(autopilot_kind, errors=EstimatorErrors())
    for _ in range(20):
        flight.run(0.5, velocity(0.0, 0.0, 0.15))
        assert landed_state(flight) is LandedState.IN_AIR
    assert flight.vehicle.velocity[2] == pytest.approx(0.15, abs=0.15)


def test_it_rides_a_moving_pad_once_landed(airborne: AutopilotFlight) -> None:
    airborne.vehicle.floor_velocity_ned_m_s = (1.0, 0.0, 0.0)
    set_down(airborne, north=1.0)
    airborne.run(10.0, velocity(1.0, 0.0, 0.3))
    assert landed_state(airborne) is LandedState.ON_GROUND
    assert airborne.vehicle.height_m == 0.0
