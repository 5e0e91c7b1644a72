"""The planner in a closed loop: refusals, pilots, stops, lost links and lost estimates."""

from typing import Any

import numpy as np
import pytest

from companion.base.geometry import Vector3
from companion.base.messages import Action, ActionKind, ActionResult, Phase, PlanStep
from companion.config import MissionConfig, PlanConfig
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import heave, still
from tests.unit.plan.plan_harness import LEG_M, PlanWorld


def test_refusals_are_waited_out() -> None:
    w = world()
    w.autopilot.refuse = {ActionKind.ARM: 2, ActionKind.TAKE_OFF: 1, ActionKind.TAKE_CONTROL: 1}
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    arms = [t for t, kind in w.autopilot.heard if kind is ActionKind.ARM]
    assert len(arms) == 3
    assert min(np.diff(arms)) >= 2.0


def test_an_autopilot_that_never_arms_ends_it_on_the_ground() -> None:
    w = world()
    w.autopilot.refuse = {ActionKind.ARM: 99}
    flight = w.fly(120.0)
    assert flight.phase is Phase.ABORT
    [reason] = flight.told("refused")
    assert "Denied: not now" in reason
    arms = [t for t, kind in w.autopilot.heard if kind is ActionKind.ARM]
    assert arms[-1] - arms[0] > 85.0
    assert min(np.diff(arms)) >= 2.0
    assert [kind for _, kind in w.autopilot.heard if kind is not ActionKind.ARM] == [ActionKind.DISARM]


def test_an_autopilot_whose_filter_does_not_know_where_it_is_is_not_asked_to_arm() -> None:
    w = world()
    w.autopilot.ekf_ready_from_s = 30.0
    flight = w.fly(60.0)
    assert min(t for t, kind in w.autopilot.heard if kind is ActionKind.ARM) > 30.0
    assert "waiting for the autopilot's position estimate" in flight.told("waiting")


def test_a_take_off_whose_answers_are_lost_is_landed_not_left_in_the_air() -> None:
    # GIVEN an autopilot that climbs, slowly, and never says that it agreed to
    w = world(config=PlanConfig(mission=MissionConfig(take_off_height_m=50.0)))
    w.autopilot.silent = {ActionKind.TAKE_OFF}
    answer = w.autopilot.answer

    def climbs(action: Action, position: Vector3, now_s: float) -> ActionResult | None:
        if action.kind is ActionKind.TAKE_OFF:
            w.autopilot._obey(action, position)
        return answer(action, position, now_s)

    w.autopilot.answer = climbs  # type: ignore[method-assign]
    flight = w.fly(60.0)
    assert flight.phase is Phase.ABORT
    w.fly(60.0, until=lambda x: not x.autopilot.armed)
    assert w.autopilot.mode == "LAND"
    assert not w.autopilot.armed
    assert w.position[2] == pytest.approx(-LEG_M, abs=0.01)


def test_a_px4_is_put_into_hold_once_it_is_disarmed_in_offboard() -> None:
    w = world()
    w.autopilot.refuse = {ActionKind.LEAVE_OFFBOARD: 1}
    flight = w.fly(90.0)
    assert (flight.phase, w.autopilot.mode) == (Phase.LANDED, "OFFBOARD")
    w.fly(5.0, until=lambda _w: False)
    assert w.autopilot.mode == "LOITER"
    assert [kind for _, kind in w.autopilot.heard][-2:] == [ActionKind.LEAVE_OFFBOARD] * 2
    assert flight.told("leave_offboard") == ["mode Hold instead of OFFBOARD, so that it can be armed"]


def test_after_the_landing_a_pilots_mode_stays_and_so_does_guided() -> None:
    for kind, mode in (("px4", "POSCTL"), ("ardupilot", "GUIDED")):
        w = world()
        w.autopilot.autopilot_kind = kind

        def pilot(x: PlanWorld, _: PlanStep, mode: str = mode) -> None:
            if not x.autopilot.armed and x.flight.phase is Phase.TOUCHDOWN:
                x.autopilot.mode = mode

        w.each = pilot
        w.fly(90.0)
        w.fly(5.0, until=lambda _w: False)
        assert not w.autopilot.armed
        assert w.autopilot.mode == mode
        assert ActionKind.LEAVE_OFFBOARD not in {kind for _, kind in w.autopilot.heard}


def test_a_refused_waypoint_does_not_end_the_mission() -> None:
    w = world(still(2.0, 1.0))
    w.autopilot.refuse = {ActionKind.GO_TO: 99}
    assert w.fly(120.0).phase is Phase.LANDED


@pytest.mark.parametrize("at_s", [8.0, 12.0, 20.0, 24.0, 26.5])
def test_a_pilot_who_takes_over_keeps_the_vehicle(at_s: float) -> None:
    w = world()

    def pilot(x: PlanWorld, _: PlanStep) -> None:
        if x.now_s > at_s:
            x.autopilot.mode = "POSCTL"

    w.each = pilot
    w.fly(at_s)
    before = len(w.autopilot.heard)
    w.fly(20.0, until=lambda _w: False)
    assert w.flight.phase is Phase.ABORT
    # from the cycle that saw it: no reference, and never an action again
    assert all(s.reference is None for s in w.flight.steps if s.time_s > at_s + 0.1)
    assert len(w.autopilot.heard) == before
    assert "POSCTL" in w.flight.told("phase")[-1]


@pytest.mark.parametrize("mode", ["POSCTL", "AUTO.RTL", "AUTO.LAND"])
def test_a_hold_that_is_still_asked_for_is_dropped_once_somebody_else_flies(mode: str) -> None:
    w = world()
    w.autopilot.refuse = {ActionKind.HOLD: 99}

    def pilot(x: PlanWorld, _: PlanStep) -> None:
        x.stop = x.now_s > 12.0
        if x.now_s > 13.0:
            x.autopilot.mode = mode

    w.each = pilot
    w.fly(13.0)
    assert w.flight.phase is Phase.ABORT
    before = len(w.autopilot.heard)
    assert w.flight.steps[-1].reference is not None  # it holds as long as nobody has the vehicle
    w.fly(10.0, until=lambda _w: False)
    assert len(w.autopilot.heard) == before
    assert all(s.reference is None for s in w.flight.steps if s.time_s > 13.2)
    assert w.flight.told("pilot") == [f"mode {mode}: no further requests"]


@pytest.mark.parametrize("at_s", [1.0, 4.0, 8.0, 12.0, 20.0])
def test_stopped_it_holds_hands_back_and_ends(at_s: float) -> None:
    w = world()
    w.each = lambda x, _s: setattr(x, "stop", x.now_s > at_s)
    w.fly(at_s + 8.0, until=lambda _w: False)
    flight = w.flight
    assert flight.phase is Phase.ABORT
    assert flight.entered(Phase.ABORT) == pytest.approx(at_s, abs=0.1)
    assert flight.told("phase")[-1] == "abort: stop requested: by the operator"
    if at_s < 2.0:
        assert w.autopilot.heard == []
        return
    assert w.autopilot.heard[-1][1] is ActionKind.HOLD
    assert w.autopilot.mode == "LOITER"
    assert flight.steps[-1].reference is None
    # streamed until the autopilot had it
    if at_s > 12.0:
        assert next(s for s in flight.steps if s.phase is Phase.ABORT).reference is not None


def test_stopped_on_the_pad_it_does_not_lift_off() -> None:
    w = world()
    w.each = lambda x, s: setattr(x, "stop", x.stop or s.on_ground)
    w.fly(90.0)
    w.fly(5.0, until=lambda _w: False)
    assert ActionKind.HOLD not in [kind for _, kind in w.autopilot.heard]
    assert not w.autopilot.armed
    assert w.flight.heights_m[-1] == pytest.approx(LEG_M, abs=0.02)


def test_a_hold_that_is_refused_is_held_by_our_own_setpoints() -> None:
    w = world()
    w.autopilot.refuse = {ActionKind.HOLD: 99}
    w.each = lambda x, _s: setattr(x, "stop", x.now_s > 20.0)
    w.fly(40.0, until=lambda _w: False)
    last = w.flight.steps[-1]
    assert last.reference is not None
    assert last.reference.origin == "local"
    assert np.linalg.norm(last.reference.velocity_m_s) < 1e-6
    assert w.flight.told("refused")


def test_a_lost_link_is_held_through_and_the_mission_goes_on() -> None:
    w = world()
    w.each = lambda x, _s: setattr(x.autopilot, "connected", not 18.0 < x.now_s < 21.0)
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    assert Phase.HOLD in [phase for _, phase in flight.phases]


def test_a_link_that_stays_away_ends_it() -> None:
    w = world()
    w.each = lambda x, _s: setattr(x.autopilot, "connected", x.now_s < 18.0)
    flight = w.fly(60.0)
    assert flight.phase is Phase.ABORT
    assert flight.end_s == pytest.approx(28.0, abs=0.3)


def test_motors_off_in_the_air_end_it_without_another_word() -> None:
    w = world()
    w.each = lambda x, _s: setattr(x.autopilot, "armed", x.autopilot.armed and x.now_s < 20.0)
    w.fly(20.2)
    before = len(w.autopilot.heard)
    w.fly(3.0, until=lambda _w: False)
    assert w.flight.phase is Phase.ABORT
    assert len(w.autopilot.heard) == before


def test_the_whole_mission_ends_by_time() -> None:
    w = world(config=PlanConfig(mission=MissionConfig(total_timeout_s=15.0)))
    flight = w.fly(60.0)
    assert flight.phase is Phase.ABORT
    assert flight.end_s == pytest.approx(flight.entered(Phase.ARM) + 15.0, abs=0.1)


def test_a_vehicle_that_is_found_armed_is_left_alone_even_when_it_is_disarmed_later() -> None:
    w = world()
    w.autopilot.armed = True
    w.each = lambda x, _s: setattr(x.autopilot, "armed", x.now_s < 5.0)
    flight = w.fly(20.0)
    assert flight.phase is Phase.ABORT
    assert w.autopilot.heard == []


def test_every_change_of_phase_is_reported() -> None:
    flight = world().fly(90.0)
    told = [text.split(":")[0].replace(" ", "_") for text in flight.told("phase")]
    assert told == [phase.value for _, phase in flight.phases[1:]]


def test_stopped_just_over_a_heaving_pad_it_climbs_clear_of_it_before_it_is_returned() -> None:
    w = world(heave(0.25))
    w.fly(90.0, until=lambda w: w.flight.phase is Phase.TOUCHDOWN)
    low_m = w.flight.heights_m[-1]
    w.stop = True
    w.fly(20.0)
    assert w.flight.phase is Phase.ABORT
    assert [kind for _, kind in w.autopilot.heard][-1] is ActionKind.HOLD
    assert low_m < 0.7
    # the pad heaves by 0.25 m either way beneath what the autopilot holds
    assert w.flight.heights_m[-1] > 1.0
    # clear of it and at rest, not when the hold's time is up
    assert w.flight.entered(Phase.ABORT) - w.flight.entered(Phase.HOLD) < 8.0
    assert any("clear of the pad" in text for text in w.flight.told("climb"))


@pytest.mark.parametrize("phase", [Phase.SEARCH, Phase.APPROACH, Phase.DESCEND])
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"round_trip_s": 1.0}, "link late: round trip 1.00 s, limit 0.3"),
        ({"battery_share": 0.1}, "battery critical: 10 % left"),
        ({"rival": (1, 150)}, "rival: setpoints of system 1, component 150"),
        ({"vehicle_known": False}, "estimate lost"),
    ],
)
def test_on_the_way_it_is_handed_back_and_said(change: dict[str, Any], said: str, phase: Phase) -> None:
    config = PlanConfig.model_validate({"mission": {"battery": {"finish_descent": False}}})
    w = world(still(), config)
    w.fly(60.0, until=lambda w: w.flight.phase is phase)
    for name, value in change.items():
        setattr(w if name == "vehicle_known" else w.autopilot, name, value)
    w.fly(2.0)
    assert w.flight.phase is Phase.ABORT
    assert [kind for _, kind in w.autopilot.heard][-1] is ActionKind.HOLD
    assert any(said in text for text in w.flight.told("phase"))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"round_trip_s": 0.5}, "a quicker link: round trip 0.50 s, limit 0.3"),
        ({"battery_share": 0.25}, "charged battery: 25 % left, limit 25 %"),
        ({"ready_from_s": 1e9}, "waiting for the autopilot to be ready to arm"),
        ({"ready_from_s": 1e9, "mode": "OFFBOARD"}, "in OFFBOARD PX4 is not, without setpoints"),
    ],
)
def test_with_what_stands_against_it_nobody_takes_off_and_it_is_said(
    change: dict[str, Any], said: str
) -> None:
    w = world()
    for name, value in change.items():
        setattr(w.autopilot, name, value)
    flight = w.fly(20.0)
    assert flight.phase is Phase.CONNECT
    assert said in flight.told("waiting")[-1]
    assert w.fly(100.0).phase is Phase.ABORT
    assert w.autopilot.heard == []
    assert len(flight.told("waiting")) <= 10


def test_the_autopilot_goes_on_to_the_waypoint_and_what_is_committed_lands() -> None:
    w = world(still())
    w.fly(60.0, until=lambda w: w.flight.phase is Phase.TAKE_OFF)
    w.autopilot.round_trip_s = 1.0
    w.fly(60.0, until=lambda w: w.flight.phase is Phase.WAYPOINT)
    assert w.flight.phase is Phase.WAYPOINT

    w = world(still())
    w.fly(60.0, until=lambda w: bool(w.flight.told("commit")))
    w.autopilot.round_trip_s = 1.0
    w.fly(20.0)
    assert w.flight.phase is Phase.LANDED


def test_nobody_takes_off_beside_another_companion_with_the_same_ids() -> None:
    w = world(still())
    w.autopilot.twin_until_s = 12.0
    flight = w.fly(20.0)
    assert any("the duplicate companion to leave" in text for text in flight.told("waiting"))
    arms = [t for t, kind in w.autopilot.heard if kind is ActionKind.ARM]
    assert min(arms) > 12.0 + 5.0
