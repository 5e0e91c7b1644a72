"""The planner in a closed loop whose EKF's position steps: the vehicle stays where it physically is."""

import math
from dataclasses import replace

import pytest

from companion.base.geometry import ZERO3, Vector3, add, norm, subtract
from companion.base.messages import ActionKind, Phase, Quantity, VehicleState
from companion.config import PlanConfig
from companion.plan.estimate_steps import EstimateSteps
from tests.unit.plan.compared import differ
from tests.unit.plan.pad_paths import still
from tests.unit.plan.plan_harness import LEG_M, PlanWorld

# GPS is back after an outage: metres aside, and lower or higher than the EKF thought
STEPS_M = [(0.0, 8.0, -5.0), (5.0, -6.0, 5.0), (0.0, 0.0, -2.0)]


class SteppingWorld(PlanWorld):
    """The EKF's position is off by `off_m`, its velocity is right."""

    off_m: Vector3 = ZERO3

    def _vehicle(self) -> VehicleState:
        vehicle = super()._vehicle()
        return replace(vehicle, position_ned_m=add(vehicle.position_ned_m, self.off_m))


def flown_to(phase: Phase) -> SteppingWorld:
    w = SteppingWorld(still())
    w.beacon_after_s = 0.5
    w.fly(90.0, until=lambda w: w.flight.phase is phase)
    assert w.flight.phase is phase
    return w


def strays_m(w: SteppingWorld, seconds: float) -> tuple[float, float]:
    """How far the vehicle goes aside and down from here within a time."""
    (north, east, down), aside_m, sinks_m = w.position, 0.0, 0.0
    for _ in range(round(seconds * 30.0)):
        w.cycle()
        aside_m = max(aside_m, math.hypot(w.position[0] - north, w.position[1] - east))
        sinks_m = max(sinks_m, w.position[2] - down)
    return aside_m, sinks_m


def test_what_the_velocity_does_not_explain_is_a_step_also_after_a_gap() -> None:
    w = SteppingWorld(still())
    w.velocity = (3.0, 0.0, 0.0)
    steps = EstimateSteps()
    steps.update(w.inputs().vehicle)
    assert steps.step_m is None
    w.now_s, w.position = 0.4, (1.2, 0.0, -LEG_M)
    steps.update(None)
    steps.update(w.inputs().vehicle)
    assert steps.step_m is None
    steps.update(None)
    w.now_s, w.position, w.off_m = 0.8, (2.4, 0.0, -LEG_M), (0.0, 5.0, -2.0)
    steps.update(w.inputs().vehicle)
    assert steps.step_m == pytest.approx((0.0, 5.0, -2.0))
    steps.update(w.inputs().vehicle)
    assert steps.step_m is None


@pytest.mark.parametrize("step_m", STEPS_M)
def test_a_hold_that_waits_for_the_link_stays_where_it_is(step_m: Vector3) -> None:
    w = flown_to(Phase.APPROACH)
    w.autopilot.connected = False
    w.fly(4.0)
    assert w.flight.phase is Phase.HOLD
    w.off_m = step_m
    aside_m, sinks_m = strays_m(w, 4.0)
    assert w.flight.phase is Phase.HOLD
    assert aside_m < 0.3
    assert sinks_m < 0.3
    assert w.flight.told("strayed") == [f"position reset by {norm(step_m):.1f} m: holding here"]


@pytest.mark.parametrize("step_m", STEPS_M)
def test_a_hold_that_climbs_clear_of_the_pad_climbs_as_far_as_it_said(step_m: Vector3) -> None:
    w = flown_to(Phase.TOUCHDOWN)
    begun_m = w.flight.heights_m[-1]
    w.comparisons = (differ(Quantity.CAMERA_ROTATION, 86.0),)
    w.fly(1.0)
    assert w.flight.phase is Phase.HOLD
    w.off_m = step_m
    aside_m, sinks_m = strays_m(w, 1.0)
    assert aside_m < 0.3
    assert sinks_m < 0.05
    assert w.fly(20.0).phase is Phase.ABORT  # at rest where it holds
    [climb] = w.flight.told("climb")
    assert w.flight.heights_m[-1] - begun_m == pytest.approx(float(climb.split()[1]), abs=0.3)


@pytest.mark.parametrize("step_m", STEPS_M)
def test_what_holds_until_the_autopilot_takes_over_stays_where_it_is(step_m: Vector3) -> None:
    w = flown_to(Phase.APPROACH)
    w.autopilot.silent = {ActionKind.HOLD}
    w.stop = True
    w.fly(10.0, until=lambda w: w.flight.phase is Phase.ABORT)
    for _ in range(90):  # it comes to rest
        w.cycle()
    w.off_m = step_m
    aside_m, sinks_m = strays_m(w, 3.0)
    assert w.autopilot.mode == "OFFBOARD"
    assert aside_m < 0.3
    assert sinks_m < 0.3


def test_a_gust_is_no_step_and_a_hold_comes_back_from_it() -> None:
    w = flown_to(Phase.APPROACH)
    w.autopilot.connected = False
    w.fly(6.0)
    place = w.position
    blown_s = w.now_s
    w.gust = lambda t: (0.0, 3.5 * (t - blown_s < 1.5), 2.5 * (t - blown_s < 1.5))
    aside_m, sinks_m = strays_m(w, 8.0)
    assert math.hypot(aside_m, sinks_m) > 1.0
    assert norm(subtract(w.position, place)) < 0.3
    assert w.flight.told("strayed") == []


@pytest.mark.parametrize("step_m", [(0.0, 8.0, -14.0), (0.0, 8.0, 5.0), (0.0, 0.0, -25.0)])
def test_a_search_keeps_its_height(step_m: Vector3) -> None:
    w = SteppingWorld(still())
    w.blind = lambda _t, _height: True
    w.fly(90.0, until=lambda w: w.flight.phase is Phase.SEARCH)
    w.fly(6.0)
    w.off_m = step_m
    height_m = w.flight.heights_m[-1]
    for _ in range(round(15.0 * 30.0)):
        w.cycle()
        assert w.flight.heights_m[-1] == pytest.approx(height_m, abs=0.3)
    assert w.flight.phase is Phase.SEARCH
    assert w.flight.told("climb") == []


def test_a_search_that_waits_for_a_pad_too_fast_waits_where_it_is() -> None:
    fastest = PlanConfig.model_validate({"mission": {"pad_speed_m_s": 0.5}})
    w = SteppingWorld(lambda t: (10.0 + 1.0 * t, 0.0, -0.3), config=fastest)
    w.beacon_after_s = 0.5
    w.blind = lambda _t, _height: True
    w.fly(90.0, until=lambda w: w.flight.phase is Phase.SEARCH)
    w.fly(8.0)
    assert norm(w.velocity) < 0.1
    w.off_m = (0.0, 8.0, -5.0)
    aside_m, sinks_m = strays_m(w, 4.0)
    assert aside_m < 0.3
    assert sinks_m < 0.3
