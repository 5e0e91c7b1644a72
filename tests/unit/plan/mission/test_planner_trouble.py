"""The planner in a closed loop: refusals, pilots, stops, lost links and lost estimates."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import ZERO3, Vector3, geodetic_from_ned
from companion.base.messages import Action, ActionKind, ActionResult, Phase, PlanStep, Quantity, RangeSample
from companion.config import LandingConfig, MissionConfig, PlanConfig
from companion.plan.planner import Planner
from tests.unit.plan.compared import differ
from tests.unit.plan.mission.planner_world import GOOD, world
from tests.unit.plan.pad_paths import circle, heave, line, still
from tests.unit.plan.plan_autopilot import HOME
from tests.unit.plan.plan_harness import LEG_M, STEP_S, TABLE, VEHICLE, PlanWorld


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


@pytest.mark.parametrize(
    ("kind", "mode"), [("px4", "POSCTL"), ("ardupilot", "STABILIZE"), ("ardupilot", "LOITER")]
)
def test_a_vehicle_that_its_pilot_arms_while_arming_is_refused_is_the_pilots(kind: str, mode: str) -> None:
    w = world()
    w.autopilot.autopilot_kind, w.autopilot.mode = kind, mode
    w.autopilot.refuse[ActionKind.ARM] = 99
    w.fly(12.0)
    w.autopilot.armed = True
    w.fly(10.0)
    assert w.flight.phase is Phase.ABORT
    assert {kind for _, kind in w.autopilot.heard} == {ActionKind.ARM}
    assert w.autopilot.mode == mode
    assert "already armed" in w.flight.told("phase")[-1]


@pytest.mark.parametrize(
    ("kind", "mode"),
    [("px4", "LOITER"), ("px4", "POSCTL"), ("ardupilot", "GUIDED"), ("ardupilot", "STABILIZE")],
)
@pytest.mark.parametrize("after_s", [0.0, 1.0, 3.0, 9.0])
def test_a_vehicle_that_our_lost_answer_or_its_pilot_has_armed_does_not_take_off_and_is_disarmed(
    kind: str, mode: str, after_s: float
) -> None:
    w = world()
    w.autopilot.autopilot_kind, w.autopilot.mode = kind, mode
    w.autopilot.silent = {ActionKind.ARM}
    w.fly(10.0, until=lambda x: x.autopilot.heard != [])
    w.fly(after_s)
    w.autopilot.armed, armed_s = True, w.now_s
    w.fly(20.0)
    assert w.now_s - armed_s < 0.1
    w.fly(1.0, until=lambda x: not x.planner.waiting)
    assert {kind for _, kind in w.autopilot.heard} == {ActionKind.ARM, ActionKind.DISARM}
    assert w.flight.phase is Phase.ABORT
    assert not w.autopilot.armed


def test_what_our_first_request_has_armed_is_disarmed_though_the_second_did_not_leave() -> None:
    w, asked_s = world(), list[float]()
    answer = w.autopilot.answer

    def loses(action: Action, position: Vector3, now_s: float) -> ActionResult | None:
        if action.kind is not ActionKind.ARM:
            return answer(action, position, now_s)
        asked_s.append(now_s)
        lost = len(asked_s) == 1
        words = "the autopilot does not answer" if lost else "no autopilot on the link"
        return ActionResult(now_s + (2.2 if lost else 0.2), action.kind, False, words, True if lost else None)

    w.autopilot.answer = loses  # type: ignore[method-assign]
    w.fly(20.0, until=lambda _w: len(asked_s) > 1)
    w.fly(0.5, until=lambda _w: False)
    w.autopilot.armed = True
    w.fly(20.0)
    w.fly(1.0, until=lambda w: not w.planner.waiting)
    assert [kind for _, kind in w.autopilot.heard] == [ActionKind.DISARM]
    assert not w.autopilot.armed


@pytest.mark.parametrize("late_s", [1.0, 6.5, 7.9, 11.0])
def test_as_long_as_arming_is_not_answered_nobody_is_said_to_have_armed_and_a_late_answer_counts(
    late_s: float,
) -> None:
    w = world()
    arm = w.autopilot.answer

    def late(action: Action, position: Vector3, now_s: float) -> ActionResult | None:
        result = arm(action, position, now_s)
        is_arm = action.kind is ActionKind.ARM
        return replace(result, time_s=now_s + late_s) if result and is_arm else result

    def shows_armed_first(result: ActionResult) -> bool:
        return result.time_s <= w.now_s

    w._has_ended = shows_armed_first  # type: ignore[method-assign]
    w.autopilot.answer = late  # type: ignore[method-assign]
    w.fly(3.0)
    assert (w.flight.phase, w.autopilot.armed) == (Phase.ARM, True)
    assert w.fly(120.0).phase is Phase.LANDED


def test_control_that_is_obeyed_after_it_was_given_up_is_no_pilots_and_the_hold_goes_on() -> None:
    w = world()
    w.autopilot.silent = {ActionKind.TAKE_CONTROL, ActionKind.HOLD}
    w.fly(90.0)
    assert w.flight.phase is Phase.ABORT
    assert [kind for _, kind in w.autopilot.heard][-1] is ActionKind.HOLD
    w.autopilot.mode, w.autopilot.silent = "OFFBOARD", set()
    w.fly(10.0, until=lambda w: not w.planner.waiting)
    assert w.autopilot.mode == "LOITER"


def test_an_autopilot_whose_filter_does_not_know_where_it_is_is_not_asked_to_arm() -> None:
    w = world()
    w.autopilot.ekf_ready_from_s = 30.0
    flight = w.fly(60.0)
    assert min(t for t, kind in w.autopilot.heard if kind is ActionKind.ARM) > 30.0
    assert "waiting: autopilot has no position estimate" in flight.told("waiting")


def test_a_take_off_whose_answers_are_lost_is_landed_not_left_in_the_air() -> None:
    # GIVEN an autopilot that climbs, slowly, and never says that it agreed to
    w = world(line(0.8, -25.0), config=PlanConfig(mission=MissionConfig(take_off_height_m=50.0)))
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
    assert flight.told("leave_offboard") == ["mode changed to Hold: PX4 does not arm in OFFBOARD"]


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


def test_once_somebody_else_flies_what_the_end_asked_for_is_withdrawn_too() -> None:
    w = world(still())
    w.autopilot.refuse[ActionKind.TAKE_OFF] = 99
    w.autopilot.silent = {ActionKind.LAND, ActionKind.DISARM}
    w.fly(60.0)
    assert [kind for _, kind in w.autopilot.heard][-2:] == [ActionKind.LAND, ActionKind.DISARM]
    withdrawn = []
    for mode in (w.autopilot.mode, "POSCTL", "POSCTL"):
        w.autopilot.mode = mode
        w.cycle()
        withdrawn.append(w.planner.withdraws)
    assert withdrawn == [False, True, False]
    assert w.flight.told("pilot") == ["mode POSCTL: no further requests"]


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


def test_what_waits_to_be_sent_is_withdrawn_as_it_holds_and_as_it_ends() -> None:
    w, withdrawn = world(still()), list[Phase]()
    w.each = lambda w, step: withdrawn.extend([step.phase] * w.planner.withdraws)
    w.fly(90.0, until=lambda w: w.flight.phase is Phase.TOUCHDOWN)
    assert withdrawn == []
    w.stop = True
    w.fly(20.0)
    assert withdrawn == [Phase.HOLD, Phase.ABORT]


def test_what_was_asked_for_on_the_pad_is_withdrawn_where_nothing_shows_that_it_stands_there() -> None:
    w = world(still())
    w.fly(90.0, until=lambda w: bool(w.flight.steps) and w.flight.steps[-1].on_ground)
    stood_s, withdrawn = w.now_s, w.planner.withdraws
    w.silent_from_s, w.blind = w.now_s - 2.0, lambda _t, _height: True
    w.fly(5.0, until=lambda w: not w.flight.steps[-1].on_ground)
    assert 0.0 < w.now_s - stood_s < 5.0
    assert (withdrawn, w.planner.withdraws) == (False, True)


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
        ({"round_trip_s": 0.5}, "link late: round trip 0.50 s, limit 0.3"),
        ({"battery_share": 0.25}, "battery low: 25 % left, limit 25 %"),
        ({"ready_from_s": 1e9}, "waiting: autopilot not ready to arm"),
        ({"ready_from_s": 1e9, "mode": "OFFBOARD"}, "PX4 does not arm in OFFBOARD without setpoints"),
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
    assert any("duplicate companion on the link" in text for text in flight.told("waiting"))
    arms = [t for t, kind in w.autopilot.heard if kind is ActionKind.ARM]
    assert min(arms) > 12.0 + 5.0


# ---------------- The planner in a closed loop: the pad is away, unseen, contradicted or missed


def test_a_pad_that_is_not_at_the_waypoint_is_found_by_its_beacon() -> None:
    w = world(line(0.8, -25.0))
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    first = flight.told("pad_lost")[0]
    assert first.startswith("pad not in view: holding")
    assert first.endswith("position requested")
    assert any("by its beacon" in text for text in flight.told("pad_lost"))
    told_s = [n.time_s for n in flight.notices if n.kind == "pad_lost"]
    assert min(later_s - s for s, later_s in pairwise(told_s)) >= 5.0  # not at every request


def test_a_beacon_outside_the_fence_is_ignored_and_announced() -> None:
    w = world(still(0.0, 200.0))
    flight = w.fly(60.0)
    assert flight.told("fence") == ["pad beacon ignored: 200 m from home, fence 150 m"]
    assert w.position[1] < 20.0  # by the beacon it would be at 48 m


def test_without_a_home_position_the_fence_is_closed() -> None:
    w = world(still(0.0, 200.0))
    w.home = lambda _t: HOME if w.autopilot.mode != "OFFBOARD" else None  # known until the search
    flight = w.fly(60.0)
    assert flight.told("fence") == []
    assert w.position[1] < 20.0  # by the beacon it would be at 48 m


def test_a_pad_without_a_beacon_is_found_by_the_spiral() -> None:
    w = PlanWorld(still(6.0, 6.0))
    flight = w.fly(150.0)
    assert flight.phase is Phase.LANDED


def test_a_pad_that_is_nowhere_ends_the_mission_holding() -> None:
    w = PlanWorld(still(300.0, 300.0))
    flight = w.fly(200.0)
    assert flight.phase is Phase.ABORT
    assert flight.end_s < 120.0
    w.fly(2.0, until=lambda _w: False)
    assert w.autopilot.mode == "LOITER"
    assert flight.steps[-1].reference is None


def test_unseen_for_a_second_it_stops_descending_and_goes_on_afterwards() -> None:
    w = world(still())
    w.blind = lambda t, _h: 15.0 < t < 16.5
    flight = w.fly(90.0)
    assert [phase for _, phase in flight.phases] == GOOD
    heights = {round(s.time_s, 1): h for s, h in zip(flight.steps, flight.heights_m, strict=True)}
    # braked within a second, then level
    assert heights[16.4] == pytest.approx(heights[16.6], abs=0.04)
    assert heights[14.5] - heights[15.0] > 0.2


def test_unseen_for_long_it_holds_asks_and_climbs_no_more_than_announced() -> None:
    w = world(circle())
    w.blind = lambda t, _h: 24.0 < t < 30.0
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    order = [phase for _, phase in flight.phases]
    assert order.count(Phase.SEARCH) == 2
    announced = next(
        float(text.split()[1]) for text in flight.told("climb") if text.endswith("look for the pad")
    )
    lost = [i for i, s in enumerate(flight.steps) if s.phase is Phase.SEARCH and s.time_s > 24.0]
    climbed = max(flight.heights_m[i] for i in lost) - flight.heights_m[lost[0]]
    assert climbed <= announced + 0.3
    assert max(flight.heights_m[i] for i in lost) < 7.5


@pytest.mark.parametrize("drift_m_s", [-0.8, 0.8])
@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.DESCEND])
def test_unseen_it_keeps_its_height_whatever_is_believed_of_the_pads(phase: Phase, drift_m_s: float) -> None:
    # GIVEN a pad that seems to rise or fall ever on while it is unseen
    w = world(circle())
    w.blind_drift_m_s = drift_m_s
    w.fly(60.0, until=lambda x: x.flight.phases != [] and x.flight.phase is phase)
    blind_s = w.now_s + 1.0
    w.blind = lambda t, _h: blind_s < t < blind_s + 1.9
    w.fly(1.5, until=lambda _w: False)
    before_m, aside_m = w.position[2], []
    # WHEN it has been so for longer than is borne in silence
    while w.now_s < blind_s + 1.9:
        w.cycle()
        # THEN it comes to rest in height
        assert -0.35 < w.position[2] - before_m < 1.3
        pad = w.pad(w.now_s)
        aside_m.append(math.hypot(w.position[0] - pad[0], w.position[1] - pad[1]))
    assert w.velocity[2] < 0.15
    # over the place where the pad goes on to, and lands once it is seen again
    assert aside_m[-1] < aside_m[0] + 1.0
    assert w.fly(120.0).phase is Phase.LANDED


@pytest.mark.parametrize("gust_m_s2", [0.0, 5.0])
def test_unseen_just_over_a_pad_that_seems_to_fall_it_climbs_at_once(gust_m_s2: float) -> None:
    # GIVEN a vehicle that waits over the pad, without a rangefinder
    w = world(circle())
    w.fly(60.0, until=lambda x: x.flight.phases != [] and x.flight.phase is Phase.TOUCHDOWN)
    w.range_lost, w.blind_drift_m_s = True, 0.4
    gone_s, waits_m = w.now_s, w.flight.heights_m[-1]
    # WHEN the pad is unseen and seems to fall, and a gust blows the vehicle off its way
    w.blind = lambda _t, _h: True
    w.gust = lambda t: (gust_m_s2, 0.0, 0.0) if t > gone_s + 0.5 else (0.0, 0.0, 0.0)
    w.fly(3.5, until=lambda _w: False)
    # THEN it sinks after the pad no longer than the descent would, and climbs whatever the wind does
    heights_m = w.flight.heights_m[-round(3.5 / STEP_S) :]
    assert min(heights_m) > LEG_M + 0.1
    assert heights_m[-1] > waits_m + 0.5


def test_unseen_low_over_the_ground_it_climbs_to_the_floor_and_says_so() -> None:
    w = world(still(), PlanConfig(landing=LandingConfig(lost_unseen_s=9.0)))
    w.fly(60.0, until=lambda x: x.flight.phases != [] and x.flight.phase is Phase.DESCEND)
    w.fly(20.0, until=lambda x: -x.position[2] < 1.4)
    gone_s = w.now_s
    w.blind = lambda t, _h: gone_s < t < gone_s + 6.0
    lowest_m = 9.0
    while w.now_s < gone_s + 6.0:
        w.cycle()
        lowest_m = min(lowest_m, -w.position[2])
    # no echo disturbs: over the pad the echoes' surface is the higher one
    assert lowest_m > 0.7
    assert w.flight.heights_m[-1] == pytest.approx(1.5, abs=0.2)
    assert w.flight.told("climb") == [w.flight.told("climb")[0]]
    assert w.flight.told("climb")[0].endswith("m while the pad is unseen")
    assert w.fly(120.0).phase is Phase.LANDED


def test_a_pad_that_gets_away_below_it_is_followed_upward_and_that_is_said_once() -> None:
    w = world(still())
    w.fly(60.0, until=lambda x: x.flight.phases != [] and x.flight.phase is Phase.DESCEND)
    w.fly(20.0, until=lambda x: -x.position[2] < 1.4)
    assert w.flight.told("climb") == []
    begin_s, (north, east, down) = w.now_s, w.pad(w.now_s)
    w.pad = lambda t: (north, east + 1.5 * min(max(0.0, t - begin_s), 2.0), down)
    w.fly(2.0)
    told = w.flight.told("climb")
    assert len(told) == 1
    assert "to keep the pad in view" in told[0]
    assert w.fly(60.0).phase is Phase.LANDED


@pytest.mark.parametrize("lie_m", [1.5, 4.0])
def test_echoes_that_contradict_the_pads_height_break_the_landing_off(lie_m: float) -> None:
    # GIVEN a pad that is seen, but believed to lie far lower than it does, until the first alarm
    w = world(still())
    w.lie_m = lambda t: lie_m if t > 12.0 and not w.flight.told("climb") else 0.0
    lowest_m = 9.0

    def each(x: PlanWorld, _: PlanStep) -> None:
        nonlocal lowest_m
        if (x.flight.told("climb") and x.flight.phase is Phase.SEARCH) or x.flight.phase is Phase.DESCEND:
            lowest_m = min(lowest_m, x.flight.heights_m[-1] - LEG_M)

    w.each = each
    flight = w.fly(60.0, until=lambda x: x.flight.told("climb") != [])
    # THEN it stops clear of the surface, says what is wrong and that it climbs
    assert flight.phase is Phase.SEARCH
    assert "ground near" in flight.told("phase")[-1]
    w.fly(1.5, until=lambda _w: False)
    assert lowest_m > 0.3
    w.fly(5.0, until=lambda _w: False)
    # and once the estimate is right, it lands
    assert w.fly(120.0).phase is Phase.LANDED


@pytest.mark.parametrize("for_s", [60.0, 0.5])
def test_a_pad_that_echoes_contradict_is_not_flown_to_in_a_pause_between_them(for_s: float) -> None:
    # GIVEN something that swings 0.5 m before the ultrasonic from the descent on (what stays there is a stuck
    # sensor), and a pause after every third echo
    w = world(still())
    w.fly(60.0, until=lambda x: x.flight.phase is Phase.DESCEND)
    number, echo, begun_s = 0, w._echo, w.now_s

    def other() -> RangeSample | None:
        nonlocal number
        number += 1
        if w.now_s - begun_s > for_s:
            return echo()
        swings_m = 0.5 + 0.12 * math.sin(5.0 * w.now_s)
        return RangeSample(w.now_s, swings_m) if number // 6 % 2 else None

    w._echo = other  # type: ignore[method-assign]
    w.fly(10.0, until=lambda x: x.flight.phase is Phase.SEARCH)
    height_m = w.flight.heights_m[-1]
    flight = w.fly(4.0, until=lambda _w: False)
    # THEN it climbs as it says, and does not come back before the echoes agree with the pad
    assert "climbing" in flight.told("climb")[0]
    assert max(flight.heights_m) > height_m + 1.5
    if for_s > 10.0:
        flight = w.fly(6.0, until=lambda _w: False)
        assert flight.phase is Phase.SEARCH
    else:
        assert w.fly(60.0).phase is Phase.LANDED
    assert len([text for text in flight.told("phase") if "ground near" in text]) == 1


def test_one_false_echo_does_not_break_the_landing_off() -> None:
    w = world(still())
    rng = np.random.default_rng(3)
    echo = w._echo

    def spiky() -> RangeSample | None:
        sample = echo()
        return RangeSample(w.now_s, 0.3) if rng.random() < 0.02 else sample

    w._echo = spiky  # type: ignore[method-assign]
    flight = w.fly(120.0)
    assert [phase for _, phase in flight.phases] == GOOD


def test_blind_for_the_last_centimetres_it_still_lands() -> None:
    w = world(line())
    w.blind = lambda _t, height: height < 0.40
    flight = w.fly(90.0)
    assert [phase for _, phase in flight.phases] == GOOD
    assert flight.touch_lateral_m < 0.05


def test_shoved_aside_above_the_pad_it_climbs_a_little_and_tries_again() -> None:
    w = world(still())

    def shove(t: float) -> Vector3:
        committed = bool(w.flight.told("commit"))
        return (2.5, 0.0, 0.0) if committed and not w.flight.told("climb") else (0.0, 0.0, 0.0)

    w.gust = shove
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    assert "back to 1.5 m over the pad to try again" in flight.told("climb")[0]
    start = next(i for i, s in enumerate(flight.steps) if s.time_s >= flight.notices[-1].time_s - 60.0)
    retry = [
        h
        for s, h in zip(flight.steps[start:], flight.heights_m[start:], strict=True)
        if s.time_s > [t for t, p in flight.phases if p is Phase.APPROACH][1]
    ]
    assert max(retry) < LEG_M + 1.5 + 0.3


def test_never_aligned_it_gives_up_clear_of_the_pad_after_its_tries() -> None:
    w = world(still())
    # a fast shake that no controller takes out
    w.gust = lambda t: (
        (3.0 * math.sin(4.0 * t), 3.0 * math.cos(4.0 * t), 0.0) if t > 15.0 else (0.0, 0.0, 0.0)
    )
    flight = w.fly(200.0)
    assert flight.phase is Phase.ABORT
    assert flight.touch_s is None
    assert flight.heights_m[-1] > LEG_M + 0.3


@pytest.mark.parametrize("wrong_m", [0.08, -0.05])
def test_a_wrong_leg_height_cuts_no_thrust_before_the_feet_stand(wrong_m: float) -> None:
    w = world(line(1.0))
    told = VEHICLE.model_copy(update={"leg_height_m": LEG_M + wrong_m})
    w.planner = Planner(w.config, told, 20, 0.1, TABLE)
    w.fly(120.0, until=lambda w: any(step.on_ground for step in w.flight.steps[-1:]))
    assert w.flight.heights_m[-1] == pytest.approx(LEG_M, abs=0.005)
    assert w.fly(20.0).phase is Phase.LANDED
    assert w.flight.touch_down_m_s < 0.4


def test_a_pad_that_a_slow_vision_sees_in_every_frame_is_landed_on() -> None:
    w = world(line(1.0))
    w.frame_s, w.vision_s = 0.13, 0.17
    flight = w.fly(120.0)
    assert [phase for _, phase in flight.phases] == GOOD
    assert flight.touch_lateral_m < 0.1
    assert flight.touch_down_m_s < 0.4


# ---------------- The planner in a closed loop: low over the pad it climbs clear before control is returned


def low_over_the_pad(config: PlanConfig | None = None) -> PlanWorld:
    w = world(still(), config)
    w.fly(90.0, until=lambda w: w.flight.phase is Phase.TOUCHDOWN)
    assert w.flight.heights_m[-1] < 0.7
    return w


def ended_by_hold(w: PlanWorld) -> None:
    assert w.flight.phase is Phase.ABORT
    assert [kind for _, kind in w.autopilot.heard][-1] is ActionKind.HOLD


def test_stopped_where_nothing_is_to_be_climbed_it_is_returned_once_at_rest() -> None:
    w = world(still())
    w.fly(90.0, until=lambda w: w.flight.phase is Phase.DESCEND)
    assert w.flight.heights_m[-1] > 1.7
    w.stop = True
    w.fly(20.0)
    ended_by_hold(w)
    assert w.flight.entered(Phase.ABORT) - w.flight.entered(Phase.HOLD) < 4.0
    assert w.flight.told("climb") == []


def test_a_camera_that_shows_turned_just_over_the_pad_climbs_clear_first() -> None:
    w = low_over_the_pad()
    w.comparisons = (differ(Quantity.CAMERA_ROTATION, 86.0),)
    w.fly(20.0)
    ended_by_hold(w)
    assert any("pad disputed: camera's rotation: " in said for said in w.flight.told("phase"))
    assert w.flight.heights_m[-1] > 1.0


def after_a_failed_try() -> PlanWorld:
    """The pad has turned aside, out of view: the next try begins a hand over it."""
    w = world(line())
    w.fly(60.0, until=lambda w: w.flight.told("commit") != [])
    pad = w.pad
    w.pad = lambda t: (pad(t)[0] + 0.4, *pad(t)[1:])
    w.fly(20.0, until=lambda w: w.flight.phase is Phase.APPROACH)
    assert w.flight.heights_m[-1] < LEG_M + 0.3
    return w


def test_stopped_just_after_a_failed_try_it_climbs_clear_before_it_is_returned() -> None:
    w = after_a_failed_try()
    w.stop = True
    w.fly(20.0)
    ended_by_hold(w)
    assert w.flight.told("climb")[-1].endswith("clear of the pad")
    assert w.flight.heights_m[-1] > LEG_M + 1.0


def test_a_link_lost_just_after_a_failed_try_is_awaited_clear_of_the_pad() -> None:
    w = after_a_failed_try()
    w.autopilot.connected = False
    w.fly(6.0)
    assert w.flight.phase is Phase.HOLD
    assert w.flight.heights_m[-1] > LEG_M + 1.0
    assert w.flight.told("climb")[-1].endswith("clear of the pad")


def test_a_pad_that_is_only_believed_to_be_above_is_cleared_like_one_at_the_feet() -> None:
    w = world(line())
    w.fly(60.0, until=lambda w: w.flight.phase is Phase.APPROACH)
    w.fly(1.0, until=lambda _w: False)
    # GIVEN a pad out of view, whose prediction rises above the vehicle
    w.blind, w.blind_drift_m_s = lambda _t, _h: True, -2.0
    w.fly(4.0, until=lambda _w: False)
    before_m = w.flight.heights_m[-1]
    w.autopilot.connected = False
    w.fly(8.0)
    assert w.flight.told("climb")[-1].endswith("clear of the pad")
    assert max(w.flight.heights_m) - before_m < LEG_M + PlanConfig().landing.retry_height_m + 0.3


def test_at_the_fence_just_over_the_pad_it_climbs_clear_first() -> None:
    w = low_over_the_pad(PlanConfig.model_validate({"mission": {"fence_m": 30.0}}))
    w.home = lambda _t: geodetic_from_ned((60.0, 0.0, 0.0), HOME)  # the autopilot has set another home
    w.fly(20.0)
    ended_by_hold(w)
    assert w.flight.heights_m[-1] > 1.0


def test_at_the_ceiling_it_climbs_no_higher() -> None:
    w = low_over_the_pad(PlanConfig.model_validate({"mission": {"ceiling_m": 30.0}}))
    w.home = lambda _t: geodetic_from_ned((0.0, 0.0, 29.5), HOME)  # 30 m over home, and more
    flown, at_m = len(w.flight.heights_m), w.flight.heights_m[-1]
    w.fly(20.0)
    ended_by_hold(w)
    assert max(w.flight.heights_m[flown:]) < at_m + 0.3


def test_a_pad_that_grows_too_fast_just_below_is_left_upward() -> None:
    mission, waits = {"pad_speed_m_s": 0.5}, {"settled_s": 5.0}
    w = low_over_the_pad(PlanConfig.model_validate({"mission": mission, "touchdown": waits}))
    begin_s, (north, east, down) = w.now_s, w.pad(w.now_s)
    w.pad = lambda t: (north, east + max(0.0, t - begin_s) ** 2, down)
    w.fly(20.0, until=lambda w: w.flight.phase is Phase.HOLD)
    assert w.flight.phase is Phase.HOLD
    assert any("clear of the pad" in text for text in w.flight.told("climb"))
    w.fly(20.0)
    ended_by_hold(w)
    assert w.flight.heights_m[-1] > 1.0


def test_it_is_clear_of_a_fast_pad_long_before_it_has_come_to_rest() -> None:
    mission, waits = {"pad_speed_m_s": 3.0}, {"settled_s": 5.0}
    w = low_over_the_pad(PlanConfig.model_validate({"mission": mission, "touchdown": waits}))
    begin_s, (north, east, down) = w.now_s, w.pad(w.now_s)
    w.pad = lambda t: (north, east + max(0.0, t - begin_s) ** 2, down)
    w.fly(20.0, until=lambda w: w.flight.phase is Phase.HOLD)
    low_m = w.flight.heights_m[-1]
    w.fly(3.0)
    assert w.flight.heights_m[-1] > low_m + 0.8


def test_land_that_is_asked_for_in_a_gap_of_the_link_is_asked_again_after_it() -> None:
    # GIVEN a vehicle that stands on the pad and is not disarmed, until the phase's time is nearly up
    w = low_over_the_pad()
    w.autopilot.refuse = {ActionKind.DISARM: 99}
    w.autopilot.doubts = True
    w.fly(w.flight.entered(Phase.TOUCHDOWN) + 44.0 - w.now_s)
    assert w.flight.phase is Phase.TOUCHDOWN
    assert ActionKind.LAND not in [kind for _, kind in w.autopilot.heard]
    # WHEN the link is gone while LAND is asked for
    w.autopilot.connected, w.autopilot.silent = False, {ActionKind.LAND, ActionKind.DISARM}
    w.fly(5.0)
    w.autopilot.connected, w.autopilot.silent = True, set()
    w.autopilot.refuse, w.autopilot.doubts = {}, False
    # THEN it is not given up
    assert w.fly(30.0).phase is Phase.LANDED


def test_what_has_met_nothing_is_not_said_to_have_landed() -> None:
    w = low_over_the_pad()
    w.fly(20.0, until=lambda w: w.flight.told("commit") != [])
    # GIVEN a vehicle without an estimate that is not set down: LAND is refused
    w.vehicle_known, w.autopilot.refuse = False, {ActionKind.LAND: 999}
    w.autopilot.doubts, w.range_lost, w.blind = True, True, lambda _t, _h: True
    w.fly(60.0)
    # THEN it goes on to ask for LAND, and claims no landing
    assert set(w.flight.told("motors_on")) == {"no contact yet: LAND requested again"}


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_a_vehicle_on_its_side_is_disarmed_though_the_first_answer_is_lost(kind: Any) -> None:
    w, forced, thrust = world(), list[float](), set[bool]()
    w.autopilot.autopilot_kind, w.autopilot.doubts = kind, True
    w.fly(90.0, until=lambda w: bool(w.flight.phases) and w.flight.phase is Phase.APPROACH)
    # GIVEN that it lies on the ground, where its link is bad at first; PX4 needs setpoints to stay as it is
    began_s = sent_s = w.now_s
    w.tilt_rad = math.radians(92.0)
    answer = w.autopilot.answer

    def lost(action: Action, position: Vector3, now_s: float) -> ActionResult | None:
        if action.kind is ActionKind.DISARM and action.force:
            forced.append(now_s - began_s)
        return None if now_s - began_s < 2.5 else answer(action, position, now_s)

    def lies(w: PlanWorld, step: PlanStep) -> None:
        nonlocal sent_s
        w.velocity = w.acceleration = ZERO3
        if step.reference is not None:
            sent_s = w.now_s
        elif kind == "px4" and w.autopilot.armed and w.now_s - sent_s > 1.0:
            w.autopilot.mode = "LOITER"
        if w.now_s - began_s > 1.2 and w.autopilot.armed:
            thrust.add(step.on_ground)

    w.autopilot.answer, w.each = lost, lies  # type: ignore[method-assign]
    w.fly(30.0)
    # THEN it is asked again until the motors are off, and no thrust is asked for meanwhile
    assert len(forced) == 2
    assert not w.autopilot.armed
    assert thrust == {True}
    assert w.flight.told("phase")[-1] == "abort: disarmed: motors off, tipped over"


def on_its_side(phase: Phase) -> tuple[PlanWorld, set[bool]]:
    """It lies on the ground, its motors drag it hard, and its autopilot refuses to turn them off."""
    w, thrustless = world(), set[bool]()
    w.autopilot.doubts, w.autopilot.refuse = True, {ActionKind.DISARM: 99}
    w.fly(90.0, until=lambda w: bool(w.flight.phases) and w.flight.phase is phase)
    began_s, w.tilt_rad = w.now_s, math.radians(92.0)
    w.jolted = lambda t: t - began_s > 1.2

    def lies(w: PlanWorld, step: PlanStep) -> None:
        w.velocity = w.acceleration = ZERO3
        if w.now_s - began_s > 1.1:
            thrustless.add(step.on_ground)

    w.each = lies
    return w, thrustless


@pytest.mark.parametrize("phase", [Phase.SEARCH, Phase.APPROACH])
def test_a_vehicle_that_is_dragged_on_its_side_is_disarmed_on(phase: Phase) -> None:
    w, thrustless = on_its_side(phase)
    w.fly(15.0)
    assert len([kind for _, kind in w.autopilot.heard if kind is ActionKind.DISARM]) > 6
    assert (w.flight.phase, thrustless) == (phase, {True})


def test_a_refused_disarming_of_a_vehicle_that_lies_no_longer_means_nothing() -> None:
    w, _ = on_its_side(Phase.APPROACH)
    w.fly(15.0, until=lambda w: w.flight.told("refused") != [])
    w.tilt_rad, w.jolted = 0.0, lambda _t: False
    w.fly(5.0)
    assert w.flight.told("refused") == ["disarm refused 4 times: Denied: not now"]
    assert w.flight.told("unexpected") == []
    assert not w.ended


@pytest.mark.parametrize("phase", [Phase.SEARCH, Phase.APPROACH])
def test_a_vehicle_that_is_upright_again_is_not_disarmed(phase: Phase) -> None:
    # GIVEN a disarming that is asked for because it lies on its side, and that the autopilot refuses at first
    w, _ = on_its_side(phase)
    w.fly(2.0)
    asked = [kind for _, kind in w.autopilot.heard].count(ActionKind.DISARM)
    assert asked > 0
    # WHEN it is upright again
    w.tilt_rad, w.jolted, w.autopilot.refuse = 0.0, lambda _t: False, {}
    withdrawn = list[bool]()
    w.each = lambda w, _step: withdrawn.append(w.planner.withdraws)
    w.fly(5.0)
    # THEN what was asked for is withdrawn at once, and not repeated
    assert any(withdrawn[:3])
    assert [kind for _, kind in w.autopilot.heard].count(ActionKind.DISARM) == asked
    assert w.autopilot.armed
    assert not w.ended


@pytest.mark.parametrize("retries", [0, 2])
def test_a_slide_over_the_pad_ends_in_a_climb_on_the_last_try_too(retries: int) -> None:
    w = world(config=PlanConfig.model_validate({"landing": {"retries": retries}}))
    slid_s, climbs, level = math.inf, list[float](), list[bool]()
    believed = w._believed

    def slides(w: PlanWorld, step: PlanStep) -> None:
        nonlocal slid_s
        feet_m = w.pad(w.now_s)[2] - w.position[2] - LEG_M
        if step.phase is Phase.TOUCHDOWN and feet_m < 0.03 and slid_s == math.inf:
            w.velocity, w.acceleration, slid_s = (1.9, 0.0, 0.15), ZERO3, w.now_s
        if step.reference is not None and 0.15 < w.now_s - slid_s < 0.25:
            level.append(step.reference.level_off is not None)
        if step.reference is not None and 0.3 < w.now_s - slid_s < 1.2:
            climbs.append(float(step.reference.velocity_m_s[0, 2]))

    def as_seen(*args: Any) -> Any:
        pad = believed(*args)
        return replace(pad, seen_velocity_ned_m_s=pad.relative_velocity_ned_m_s)

    w.each = slides
    w._believed = as_seen  # type: ignore[method-assign,assignment]
    w.fly(120.0, until=lambda w: w.now_s - slid_s > 1.2)
    assert level
    assert all(level)
    assert max(climbs) < -0.1
    assert climbs[-1] < -0.25
