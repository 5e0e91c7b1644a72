"""When rest alone proves a landing: the motors stop a second after the contact, and no sooner."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from companion.base.geometry import GRAVITY_M_S2
from companion.base.messages import (
    ActionKind,
    AutopilotState,
    LandedState,
    LinkHealth,
    PadState,
    Phase,
    RangeSample,
)
from companion.config import TouchdownConfig
from companion.plan.events import MissionEvent
from companion.plan.inputs import ComputerLoad, PlanInputs
from companion.plan.landing.contact import LandDetector
from tests.unit.control.controller_inputs import vehicle_state
from tests.unit.plan.landing.touchdown_attempt import CYCLE_S, sight
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import line
from tests.unit.plan.plan_harness import LEG_M, VEHICLE

Seen = Callable[[float], PadState | None]


def rests_at_s(
    seen: Seen, falls: Callable[[float], bool] = lambda _t: False, *, felt: bool = True, silent_s: float = 0.0
) -> float:
    """When standing since 0 s is proven by rest; inf when not within 5 s."""
    standing = LandDetector(TouchdownConfig(), VEHICLE, 0.0)
    for k in range(150):
        now_s = k * CYCLE_S
        acceleration = (0.0, 0.0, GRAVITY_M_S2 if falls(now_s) else 0.0)
        vehicle = (
            vehicle_state(now_s, acceleration_ned_m_s2=acceleration, imu_age_s=silent_s) if felt else None
        )
        inputs = PlanInputs(vehicle, None, AutopilotState(now_s, landed=LandedState.IN_AIR))
        found = standing.step(seen(now_s), inputs, now_s)
        if found is not None:
            return now_s if found[0] is MissionEvent.AT_REST else float("inf")
    return float("inf")


def test_a_second_of_rest_with_the_feet_seen_down_is_enough_and_less_is_not() -> None:
    assert rests_at_s(lambda _t: sight(height=LEG_M)) == pytest.approx(1.0, abs=CYCLE_S)


def test_the_second_begins_again_when_the_feet_are_not_shown_down() -> None:
    assert rests_at_s(lambda t: None if 0.4 < t < 0.6 else sight(height=LEG_M)) == pytest.approx(
        1.6, abs=0.05
    )
    assert rests_at_s(lambda _t: sight(height=LEG_M + 0.3)) == float("inf")
    assert rests_at_s(lambda _t: sight(height=LEG_M, age=2.0)) == float("inf")


def test_what_falls_does_not_rest_and_a_bump_of_the_pad_is_no_fall() -> None:
    seen = sight(height=LEG_M)
    assert rests_at_s(lambda _t: seen, lambda t: 0.4 < t < 0.7) == pytest.approx(1.7, abs=0.05)
    assert rests_at_s(lambda _t: seen, lambda t: 0.4 < t < 0.5) == pytest.approx(1.0, abs=CYCLE_S)


@pytest.mark.parametrize(("felt", "silent_s"), [(False, 0.0), (True, 0.5)])
def test_without_the_imu_the_feet_have_to_be_shown_down_for_three_seconds(
    felt: bool, silent_s: float
) -> None:
    at_s = rests_at_s(lambda _t: sight(height=LEG_M), felt=felt, silent_s=silent_s)
    assert at_s == pytest.approx(3.0, abs=CYCLE_S)


def test_a_single_high_sighting_in_a_silence_does_not_show_that_the_vehicle_left() -> None:
    standing = LandDetector(TouchdownConfig(), VEHICLE, 0.0)
    first = replace(sight(height=LEG_M), time_s=0.0, seen_time_s=0.0)
    standing.off_by_itself(first, heard(0.0), 0.0)
    high = replace(sight(height=LEG_M + 0.1), time_s=0.1, seen_time_s=0.1)
    for k in range(4):
        now_s = 0.1 + k * CYCLE_S
        assert standing.off_by_itself(replace(high, time_s=now_s), heard(now_s, 0.4), now_s) == ""
    again = replace(high, time_s=0.25, seen_time_s=0.2)
    assert "left the pad" in standing.off_by_itself(again, heard(0.25, 0.4), 0.25)


def heard(now_s: float, silent_s: float = 0.0) -> PlanInputs:
    """What a standing vehicle knows besides the pad, `silent_s` after the autopilot's last sign."""
    autopilot = AutopilotState(now_s, landed=LandedState.IN_AIR)
    return PlanInputs(vehicle_state(now_s), None, autopilot, link=LinkHealth(silent_s))


@pytest.mark.parametrize(("held_up_s", "leaves"), [(0.3, False), (0.5, True), (10.0, True)])
def test_an_app_that_was_held_up_on_the_pad_believes_no_echo_that_it_still_stands(
    held_up_s: float, leaves: bool
) -> None:
    standing, why = LandDetector(TouchdownConfig(), VEHICLE, 0.0), ""
    for k in range(30):
        now_s = k * CYCLE_S
        computer = ComputerLoad(held_up_s=held_up_s, late_s=held_up_s if k == 15 else 0.0)
        echo = RangeSample(now_s, LEG_M - VEHICLE.range_position_body_m[2])
        inputs = replace(heard(now_s), computer=computer, range=echo)
        why = why or standing.off_by_itself(None, inputs, now_s)
    assert (why != "") is leaves


def test_the_motors_are_stopped_a_second_after_the_contact_though_the_autopilot_doubts_it() -> None:
    w = world(line(1.0))
    w.autopilot.doubts = True
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    contact_s = next(step.time_s for step in flight.steps if step.on_ground)
    asked_s = next(time_s for time_s, kind in w.autopilot.heard if kind is ActionKind.DISARM)
    assert asked_s - contact_s == pytest.approx(1.0, abs=0.1)
