"""The conditions that the pace goes by: what raises each of the three, and what does not."""

import math
from dataclasses import replace

import pytest

from companion.base.messages import Conditions, Phase
from companion.plan.planner import Planner
from companion.plan.speed.conditions import ConditionMonitor, PaceLaw, constant_pace
from companion.plan.speed.laws import by_conditions
from tests.unit.control.controller_inputs import pad_state, vehicle_state
from tests.unit.plan.pad_paths import still
from tests.unit.plan.plan_harness import TABLE, VEHICLE, PlanFlight, PlanWorld

STEP_S = 0.05


def felt(
    seconds: float, *, gust_m_s2: float = 0.0, off_m_s: float = 0.0, height_m: float = 5.0
) -> Conditions:
    """Over a pad in a steady wind with gusts once a second, at a speed over the pad beyond the planned."""
    monitor = ConditionMonitor()
    for k in range(round(seconds / STEP_S)):
        now_s = k * STEP_S
        swing = gust_m_s2 * math.sqrt(2.0) * math.sin(2.0 * math.pi * now_s)
        vehicle = replace(vehicle_state(now_s), side_force_ned_m_s2=(2.0 + swing, -1.0, 0.0))
        # the plan flies to the west by 1 m/s, the pad comes nearer by that and the speed off it
        sight = pad_state(now_s, (0.0, 0.0, height_m), (off_m_s, 1.0, 0.3))
        monitor.update(sight, vehicle, (0.0, -1.0, 0.3), now_s)
    assert monitor.now is not None
    return monitor.now


def test_a_steady_wind_and_a_planned_speed_are_no_bad_conditions() -> None:
    conditions = felt(6.0)
    assert conditions.gust_m_s2 == pytest.approx(0.0, abs=1e-6)
    assert conditions.relative_speed_m_s == pytest.approx(0.0, abs=1e-9)
    assert by_conditions(TABLE)(conditions) == pytest.approx(1.25, abs=0.01)


def test_gusts_are_the_spread_of_the_winds_force() -> None:
    assert felt(12.0, gust_m_s2=1.0).gust_m_s2 == pytest.approx(1.0, rel=0.1)


def test_the_relative_speed_is_what_the_plan_does_not_mean() -> None:
    assert felt(4.0, off_m_s=0.6).relative_speed_m_s == pytest.approx(0.6, abs=0.01)


def test_sight_is_the_error_as_seen_from_the_vehicle() -> None:
    near, far = felt(0.5, height_m=1.0), felt(0.5, height_m=10.0)
    assert near.sight_rad == pytest.approx(0.01, rel=0.01)
    assert far.sight_rad == pytest.approx(0.001, rel=0.01)


def test_there_are_no_conditions_before_a_pad_is_seen() -> None:
    monitor = ConditionMonitor()
    monitor.update(None, vehicle_state(0.0), None, 0.0)
    assert monitor.now is None


def flown(pace: PaceLaw) -> PlanFlight:
    world = PlanWorld(still())
    world.planner = Planner(world.config, VEHICLE, 20, 0.1, TABLE, pace=pace)
    return world.fly(90.0)


def test_the_pace_sets_the_way_to_the_pad_and_leaves_the_final_descent_alone() -> None:
    usual, slow = flown(constant_pace), flown(lambda _conditions: 0.5)
    assert usual.phase is slow.phase is Phase.LANDED

    def took_s(flight: PlanFlight, begins: Phase, ends: Phase) -> float:
        return flight.entered(ends) - flight.entered(begins)

    way = (Phase.APPROACH, Phase.TOUCHDOWN)
    assert took_s(slow, *way) > 1.3 * took_s(usual, *way)
    final = (Phase.TOUCHDOWN, Phase.LANDED)
    assert took_s(slow, *final) == pytest.approx(took_s(usual, *final), abs=0.5)
    told = {step.phase for step in slow.steps if step.conditions is not None}
    assert told == {Phase.APPROACH, Phase.DESCEND}
