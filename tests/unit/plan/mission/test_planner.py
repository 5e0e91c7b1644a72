"""The planner in a closed loop: whole missions that go well."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import Vector3, ned_from_geodetic
from companion.base.messages import ActionKind, LandedState, Order, OrderKind, Phase, PlanStep
from companion.config import Cylinder, MissionConfig, PlanConfig
from companion.plan.inputs import ComputerLoad
from companion.plan.mission.mode_monitor import TAKES_S
from companion.plan.planner import Planner
from tests.unit.plan.mission.planner_world import GOOD, world
from tests.unit.plan.pad_paths import Path, circle, figure_eight, heave, line, still
from tests.unit.plan.plan_autopilot import HOME, PlanAutopilot
from tests.unit.plan.plan_harness import LEG_M, ORIGIN_NED_M, TABLE, VEHICLE, PlanFlight, PlanWorld

PADS: dict[str, Path] = {
    "still": still(),
    "line": line(),
    "circle": circle(),
    "figure eight": figure_eight(),
    "heave": heave(),
}


def breeze(t: float) -> Vector3:
    """Gusts as a disturbance of acceleration (m/s²), after what a controller already takes out."""
    return (
        0.12 * math.sin(1.3 * t + 0.4) + 0.1 * math.sin(3.1 * t),
        0.12 * math.sin(1.1 * t + 2.0),
        0.1 * math.sin(2.0 * t + 1.0),
    )


def continuous(flight: PlanFlight) -> tuple[float, float, float]:
    """Largest steps of the reference's position, velocity and acceleration between cycles of one phase.

    Rows lie 0.1 s apart, cycles 0.033 s: what lies between is interpolated, hence not quite 0.
    """
    worst = [0.0, 0.0, 0.0]
    for before, after in zip(flight.steps, flight.steps[1:], strict=False):
        a, b = before.reference, after.reference
        if a is None or b is None or a.origin != b.origin or before.on_ground != after.on_ground:
            continue
        k = (b.time_s - a.time_s) / a.step_s
        for i, name in enumerate(("position_m", "velocity_m_s", "acceleration_m_s2")):
            rows = getattr(a, name)
            expected = rows[0] * (1.0 - k) + rows[1] * k
            worst[i] = max(worst[i], float(np.linalg.norm(getattr(b, name)[0] - expected)))
    return worst[0], worst[1], worst[2]


@pytest.mark.parametrize("name", list(PADS))
def test_it_lands_softly_on_the_middle_of_a_pad(name: str) -> None:
    flight = world(PADS[name]).fly(90.0)
    assert [phase for _, phase in flight.phases] == GOOD
    assert flight.touch_lateral_m < 0.03
    assert 0.1 < flight.touch_down_m_s < 0.3
    assert flight.touch_across_m_s < 0.05
    assert flight.end_s < 60.0


@pytest.mark.parametrize("name", list(PADS))
def test_it_lands_with_noise_and_gusts(name: str) -> None:
    w = world(PADS[name])
    w.noise_m, w.gust, w.rng = 0.02, breeze, np.random.default_rng(7)
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    assert flight.touch_lateral_m < 0.12
    assert flight.touch_down_m_s < 0.4
    assert flight.touch_across_m_s < 0.3


def test_it_lands_under_ardupilot_where_setpoints_are_obeyed_at_once() -> None:
    w = world()
    w.autopilot = PlanAutopilot(autopilot_kind="ardupilot", mode="STABILIZE")
    assert w.fly(90.0).phase is Phase.LANDED


def test_the_same_flight_twice_gives_the_same_references_to_the_bit() -> None:
    flights = []
    for _ in range(2):
        w = world(figure_eight())
        w.noise_m, w.rng = 0.02, np.random.default_rng(5)
        flights.append(w.fly(60.0))
    for a, b in zip(flights[0].steps, flights[1].steps, strict=True):
        assert a.phase is b.phase
        assert (a.reference is None) == (b.reference is None)
        if a.reference is not None and b.reference is not None:
            assert np.array_equal(a.reference.position_m, b.reference.position_m)


def test_the_reference_never_steps_once_over_the_pad() -> None:
    flight = world().fly(90.0)
    flight.steps = [s for s in flight.steps if s.time_s > flight.entered(Phase.APPROACH) + 0.05]
    position, velocity, acceleration = continuous(flight)
    assert position < 0.02
    assert velocity < 0.03
    assert acceleration < 0.08


def test_the_vehicle_goes_where_the_waypoint_is_from_home_not_from_our_origin() -> None:
    asked: list[Vector3] = []
    w = world(still(200.0, 200.0))

    def each(_: PlanWorld, step: PlanStep) -> None:
        asked.extend(a.position for a in step.actions if a.kind is ActionKind.GO_TO and a.position)

    w.each = each
    w.fly(40.0, until=lambda x: x.flight.phases != [] and x.flight.phase is Phase.SEARCH)
    latitude, longitude, height = asked[0]
    assert ned_from_geodetic(latitude, longitude, HOME[2], HOME)[:2] == pytest.approx((10.0, 0.0), abs=1e-3)
    assert height == 7.0
    assert math.hypot(w.position[0] - 10.0, w.position[1]) < 1.5
    assert math.hypot(*ORIGIN_NED_M) > 2.0


def test_setpoints_stream_before_control_is_asked_and_none_before_the_search() -> None:
    flight = world().fly(90.0)
    first = next(s.time_s for s in flight.steps if s.reference is not None)
    asked = next(s.time_s for s in flight.steps for a in s.actions if a.kind is ActionKind.TAKE_CONTROL)
    assert first == pytest.approx(flight.entered(Phase.SEARCH), abs=0.04)
    assert asked - first >= 0.5


def test_over_the_pad_it_stays_above_the_floor_it_tells_the_controller() -> None:
    flight = world(heave()).fly(90.0)
    for step, height in zip(flight.steps, flight.heights_m, strict=True):
        if step.phase in {Phase.APPROACH, Phase.DESCEND}:
            assert step.reference is not None
            assert step.reference.minimum_height_m is not None
            assert LEG_M < step.reference.minimum_height_m < height
        elif step.reference is not None:
            assert step.reference.minimum_height_m is None


def test_a_descent_tells_the_controller_its_cone_until_it_is_committed() -> None:
    flight = world(line()).fly(90.0)
    told = {
        phase: [s.reference.cone for s in flight.steps if s.phase is phase and s.reference is not None]
        for phase in (Phase.SEARCH, Phase.APPROACH, Phase.DESCEND, Phase.TOUCHDOWN)
    }
    assert not any(told[Phase.SEARCH] + told[Phase.APPROACH])
    # the cycle in which a phase ends is already steered by the next
    assert all(told[Phase.DESCEND])
    assert told[Phase.TOUCHDOWN][0] is not None
    assert told[Phase.TOUCHDOWN][-1] is None


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0, 270.0])
def test_it_lands_in_the_pads_heading(heading_deg: float) -> None:
    w = PlanWorld(still(), heading=lambda _t: math.radians(heading_deg))
    flight = w.fly(90.0)
    last = next(s.reference for s in reversed(flight.steps) if s.reference is not None)
    assert math.remainder(last.heading_rad - math.radians(heading_deg), math.tau) == pytest.approx(
        0.0, abs=0.02
    )


def test_it_keeps_its_heading_when_it_shall_not_align() -> None:
    flight = world(still(), PlanConfig(mission=MissionConfig(align_heading=False))).fly(90.0)
    headings = [s.reference.heading_rad for s in flight.steps if s.reference]
    assert headings == pytest.approx([1.2] * len(headings))


def test_on_the_pad_it_says_so_and_disarms_once_the_autopilot_agrees() -> None:
    w = world()
    flight = w.fly(90.0)
    contact = next(s.time_s for s in flight.steps if s.on_ground)
    assert flight.touch_s is not None
    assert abs(contact - flight.touch_s) < 0.25
    disarm = next(t for t, kind in w.autopilot.heard if kind is ActionKind.DISARM)
    assert disarm > contact
    assert not w.autopilot.armed
    assert flight.steps[-1].reference is None
    assert flight.told("contact")


def test_an_autopilot_that_never_finds_itself_landed_is_disarmed_by_force_and_never_ordered_to_land() -> None:
    w = world(heave())
    flight = w.fly(60.0, until=lambda x: x.flight.told("commit") != [])
    w.autopilot.doubts = True
    w.fly(30.0)
    assert flight.phase is Phase.LANDED
    contact = next(s.time_s for s in flight.steps if s.on_ground)
    last = {a.kind: (s.time_s, a.force) for s in flight.steps for a in s.actions}
    assert ActionKind.LAND not in last  # PX4's brakes against a pad that moves, and tips over
    assert last[ActionKind.DISARM][0] - contact == pytest.approx(1.0, abs=0.1)
    assert last[ActionKind.DISARM][1]


def test_a_pad_that_jolts_the_vehicle_now_and_then_is_stood_on_all_the_same() -> None:
    w = world(heave())
    flight = w.fly(60.0, until=lambda x: x.flight.told("commit") != [])
    w.autopilot.doubts = True
    w.jolted = lambda now_s: math.fmod(now_s, 1.8) < 0.05
    w.fly(30.0)
    assert flight.phase is Phase.LANDED
    assert ActionKind.LAND not in {a.kind for s in flight.steps for a in s.actions}


def test_an_autopilot_that_nothing_shows_to_be_down_is_let_land() -> None:
    w = world(still())
    flight = w.fly(60.0, until=lambda x: bool(x.flight.steps) and x.flight.steps[-1].on_ground)
    w.autopilot.doubts = True
    w.blind = lambda _t, _h: True
    w.echo_m = 1.0
    contact = w.now_s
    w.fly(10.0)
    last = {a.kind: s.time_s for s in flight.steps for a in s.actions}
    assert last[ActionKind.LAND] - contact == pytest.approx(4.0, abs=0.1)
    assert ActionKind.DISARM not in last


# ----------------
# Orders to a planner in standby: followed where nothing stands against it, else refused with the reason.

ALLOWED = PlanConfig(mission=MissionConfig(may_arm=True))


def flown_by_a_pilot(config: PlanConfig | None = None, pad: Callable[..., object] = still) -> PlanWorld:
    """In the air in POSCTL, and the planner waits for an order."""
    w = PlanWorld(pad())  # type: ignore[arg-type]
    w.planner = Planner(config or PlanConfig(), VEHICLE, 20, 0.1, TABLE, standby="")
    w.position, w.now_s = (9.0, -1.0, -6.0), 5.0
    w.autopilot.armed, w.autopilot.mode, w.autopilot.landed = True, "POSCTL", LandedState.IN_AIR
    w.fly(2.0)
    return w


def order(w: PlanWorld, kind: OrderKind = OrderKind.LAND) -> str | None:
    """Give an order for one cycle; returns why it is refused."""
    w.order = Order(w.now_s, kind, "the test")
    w.cycle()
    refused = w.planner.refused
    return None if refused is None else refused.text


def asked(w: PlanWorld) -> list[ActionKind]:
    return [kind for _, kind in w.autopilot.heard if kind is not ActionKind.REQUEST_PAD_POSITION]


@pytest.mark.parametrize("pad", [still, line])
def test_ordered_in_the_air_it_takes_over_lands_and_disarms(pad: Callable[..., object]) -> None:
    w = flown_by_a_pilot(pad=pad if pad is still else lambda: line(start=-12.0))
    assert asked(w) == []
    assert order(w) is None
    flight = w.fly(90.0)
    assert flight.phase is Phase.LANDED
    assert flight.touch_lateral_m < 0.15
    assert asked(w)[0] is ActionKind.TAKE_CONTROL
    assert asked(w)[-2:] == [ActionKind.DISARM, ActionKind.LEAVE_OFFBOARD]


def test_its_own_setpoints_are_no_other_programs() -> None:
    w = flown_by_a_pilot()
    said = set[str]()

    def look(world: PlanWorld) -> bool:
        said.update(world.planner.not_ready(world.inputs(), world.now_s))
        return False

    assert order(w) is None
    assert w.fly(90.0, until=look).phase is Phase.LANDED
    assert said == set()


def test_control_granted_late_begins_where_the_pilot_has_flown_meanwhile() -> None:
    w = flown_by_a_pilot()
    w.blind = lambda _t, _height: True
    w.autopilot.refuse[ActionKind.TAKE_CONTROL] = 2
    assert order(w) is None
    w.fly(1.0)
    w.position = (34.0, 5.0, -3.0)  # 26 m away and lower than the search is
    w.fly(20.0, until=lambda w: w.autopilot.mode == "OFFBOARD")
    granted_s = w.now_s
    assert asked(w).count(ActionKind.TAKE_CONTROL) == 3
    w.fly(2.5)
    assert math.dist(w.position[:2], (34.0, 5.0)) < 1.0
    climbs = [notice for notice in w.flight.notices if notice.kind == "climb"]
    assert [notice.text[:11] for notice in climbs] == ["climbing 4."]
    assert 0.0 <= climbs[0].time_s - granted_s < 0.2


def test_an_order_is_for_the_moment_it_is_not_kept() -> None:
    w = flown_by_a_pilot()
    w.camera_problem = "no frame for 2.0 s"
    assert order(w) == "no pad camera: no frame for 2.0 s"
    w.camera_problem = None
    w.fly(5.0)
    assert w.flight.phase is Phase.STANDBY
    assert asked(w) == []


def test_a_vehicle_of_which_nobody_says_that_it_flies_is_not_lifted_off_by_an_order_to_land() -> None:
    """GIVEN a pilot who has armed a vehicle that stands, and an autopilot that does not say so."""
    w = flown_by_a_pilot()
    w.position = (0.0, 0.0, -LEG_M)
    hear = w._autopilot
    w._autopilot = lambda: replace(hear(), landed=LandedState.UNDEFINED)  # type: ignore[method-assign]
    why = "the autopilot does not tell whether it is in the air (EXTENDED_SYS_STATE)"
    assert order(w) == why
    w.fly(5.0)
    assert w.flight.phase is Phase.STANDBY
    assert asked(w) == []


def test_too_slow_a_computer_refuses_an_order_and_holds_a_departure() -> None:
    computer, why = ComputerLoad("computer too slow"), "computer too slow"
    w = flown_by_a_pilot()
    given = replace(w.inputs(), computer=computer, order=Order(w.now_s, OrderKind.LAND, "the test"))
    w.planner.step(given, w.now_s)
    assert w.planner.refused is not None
    assert w.planner.refused.text == why
    ground = PlanWorld(still())
    ground.now_s = 3.0
    step = ground.planner.step(replace(ground.inputs(), computer=computer), ground.now_s)
    assert why in next(notice.text for notice in step.notices if notice.kind == "waiting")


def on_the_ground(w: PlanWorld) -> None:
    w.autopilot.landed = LandedState.ON_GROUND
    w.position = (9.0, -1.0, -0.18)


def untold(w: PlanWorld, field: str) -> None:
    w.autopilot.untold = frozenset({field})


REFUSALS: dict[str, tuple[Callable[[PlanWorld], None], str]] = {
    "no link": (lambda w: setattr(w.autopilot, "connected", False), "no heartbeat"),
    "disarmed": (lambda w: setattr(w.autopilot, "armed", False), "not armed"),
    "on the ground": (on_the_ground, "on the ground"),
    "a rival": (
        lambda w: setattr(w.autopilot, "rival", (1, 150)),
        "foreign setpoints: setpoints of system 1, component 150",
    ),
    "another's OFFBOARD": (
        lambda w: setattr(w.autopilot, "mode", "OFFBOARD"),
        "already in OFFBOARD by another program's setpoints",
    ),
    "a twin": (lambda w: setattr(w.autopilot, "twin_until_s", 1e9), "duplicate companion on the link"),
    "no home": (lambda w: setattr(w, "home", lambda _t: None), "no home position"),
    "parameters": (lambda w: setattr(w, "setup_problem", "GUID_TIMEOUT is 3: too long"), "GUID_TIMEOUT is 3"),
    "attitude": (lambda w: untold(w, "attitude_time_s"), "does not tell its attitude (ATTITUDE)"),
    "status": (lambda w: untold(w, "status_time_s"), "does not tell its checks and battery (SYS_STATUS)"),
    "no answer": (lambda w: untold(w, "round_trip_time_s"), "does not tell its time (TIMESYNC)"),
    "never answered": (
        lambda w: setattr(w.autopilot, "round_trip_s", None),
        "does not tell its time (TIMESYNC)",
    ),
    "no estimate": (lambda w: setattr(w, "vehicle_known", False), "no current vehicle estimate"),
    "battery": (lambda w: setattr(w.autopilot, "battery_share", 0.1), "battery critical: 10 % left"),
    "fence": (lambda w: setattr(w, "position", (500.0, 0.0, -6.0)), "fence: 500 m from home, limit 150 m"),
    "ceiling": (lambda w: setattr(w, "position", (0.0, 0.0, -70.0)), "ceiling: 70 m over home, limit 60 m"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_what_stands_against_a_landing_is_said(case: str) -> None:
    w = flown_by_a_pilot()
    assert w.planner.not_ready(w.inputs(), w.now_s) == []
    change, words = REFUSALS[case]
    change(w)
    refused = order(w)
    assert refused is not None
    assert words in refused
    # what an operator is told beforehand; on the ground a vehicle can be ready
    beforehand = [refused] if case not in {"disarmed", "on the ground", "fence", "ceiling"} else []
    assert w.planner.not_ready(w.inputs(), w.now_s) == beforehand
    assert w.planner.phase is Phase.STANDBY
    assert asked(w) == []


def test_a_velocity_that_is_not_known_is_refused() -> None:
    w = flown_by_a_pilot(PlanConfig(mission=MissionConfig(largest_speed_std_m_s=0.01)))
    assert "velocity uncertain" in (order(w) or "")


def test_obstacles_whose_place_is_not_known_are_refused() -> None:
    tree = Cylinder(kind="cylinder", centre_ned_m=(30.0, 30.0), radius_m=1.0, height_m=8.0)
    assert "plan.obstacles" in (order(flown_by_a_pilot(PlanConfig(obstacles=(tree,)))) or "")


def test_the_whole_flight_needs_permission_and_a_vehicle_that_is_not_armed() -> None:
    w = flown_by_a_pilot()
    assert order(w, OrderKind.FLY) == "not allowed: plan.mission.may_arm is false"
    assert w.planner.refused is not None
    assert w.planner.refused.lasting
    assert "armed already" in (order(flown_by_a_pilot(ALLOWED), OrderKind.FLY) or "")
    w = PlanWorld(still(), config=ALLOWED)
    w.planner = Planner(ALLOWED, VEHICLE, 20, 0.1, TABLE, standby="")
    w.fly(3.0)
    assert order(w, OrderKind.FLY) is None
    assert w.fly(90.0).phase is Phase.LANDED


def test_a_stop_in_standby_has_nothing_to_stop() -> None:
    w = flown_by_a_pilot()
    assert "nothing to stop" in (order(w, OrderKind.STOP) or "")
    assert w.planner.phase is Phase.STANDBY


def test_standby_with_a_reason_follows_no_order() -> None:
    w = flown_by_a_pilot()
    w.planner = Planner(PlanConfig(), VEHICLE, 20, 0.1, TABLE, standby="nobody permitted it")
    w.fly(1.0)
    assert order(w) == "nobody permitted it"


def test_a_pilot_who_changes_the_mode_before_control_is_ours_keeps_the_vehicle() -> None:
    w = flown_by_a_pilot()
    w.autopilot.silent = {ActionKind.TAKE_CONTROL}
    assert order(w) is None
    w.fly(1.0)
    w.autopilot.mode = "LOITER"
    w.fly(1.0)
    assert w.flight.phase is Phase.ABORT
    assert set(asked(w)) == {ActionKind.TAKE_CONTROL}


def test_refused_control_leaves_the_pilot_s_mode_alone() -> None:
    w = flown_by_a_pilot()
    w.autopilot.refuse = {ActionKind.TAKE_CONTROL: 99}
    assert order(w) is None
    w.fly(30.0)
    assert w.flight.phase is Phase.ABORT
    assert set(asked(w)) == {ActionKind.TAKE_CONTROL}
    assert w.autopilot.mode == "POSCTL"


@pytest.mark.parametrize(("kind", "streams"), [("px4", True), ("ardupilot", False)])
def test_only_an_autopilot_that_wants_a_stream_for_it_gets_setpoints_before_the_grant(
    kind: str, streams: bool
) -> None:
    """GIVEN a vehicle that is in GUIDED already, it would obey them."""
    w = flown_by_a_pilot()
    if kind == "ardupilot":
        w.autopilot.autopilot_kind, w.autopilot.mode, w.autopilot.target_ned_m = kind, "GUIDED", w.position
        w.fly(0.5)
    w.autopilot.refuse = {ActionKind.TAKE_CONTROL: 99}
    began, first = w.position, len(w.flight.steps)
    assert order(w) is None
    w.fly(30.0)
    assert w.flight.phase is Phase.ABORT
    sent = [step for step in w.flight.steps[first:] if step.reference is not None]
    assert bool(sent) is streams
    assert math.dist(w.position, began) < 0.05
    # AND once it is granted, there are
    w = flown_by_a_pilot()
    w.autopilot.autopilot_kind = kind
    w.autopilot.mode = "POSCTL" if kind == "px4" else "LOITER"
    w.fly(0.5)
    assert order(w) is None
    assert w.fly(90.0).phase is Phase.LANDED


def test_granted_but_never_obeyed_it_gives_up_and_the_pilot_has_it() -> None:
    w = flown_by_a_pilot()
    assert order(w) is None
    w.each = lambda w, _step: setattr(w.autopilot, "mode", "POSCTL")
    w.fly(2.0 + 2.0 * TAKES_S)
    assert w.flight.phase is Phase.ABORT
    assert "POSCTL" in w.flight.told("phase")[-1]


def stopped(w: PlanWorld) -> None:
    w.stop = True


def exhausted(w: PlanWorld) -> None:
    w.autopilot.battery_share = 0.05


@pytest.mark.parametrize("end", [stopped, exhausted])
@pytest.mark.parametrize(
    ("kind", "found", "control"), [("ardupilot", "LOITER", "GUIDED"), ("px4", "POSCTL", "OFFBOARD")]
)
def test_control_that_is_obeyed_but_not_answered_yet_as_the_mission_ends_is_returned(
    kind: str, found: str, control: str, end: Callable[[PlanWorld], None]
) -> None:
    w = flown_by_a_pilot()
    w.autopilot.autopilot_kind, w.autopilot.mode = kind, found
    w.autopilot.silent = {ActionKind.TAKE_CONTROL}
    w.fly(1.0)
    assert order(w) is None
    w.fly(10.0, until=lambda w: ActionKind.TAKE_CONTROL in asked(w))
    end(w)
    w.cycle()
    assert (w.flight.phase, w.planner.withdraws) == (Phase.ABORT, True)
    w.autopilot.mode = control  # the next heartbeat shows it
    w.fly(10.0, until=lambda w: not w.planner.waiting)
    assert set(asked(w)) == {ActionKind.TAKE_CONTROL, ActionKind.HOLD_IF_OBEYED}
    assert w.autopilot.mode == "LOITER"
    assert w.flight.told("hold_if_obeyed") != []


def test_control_whose_answers_are_all_lost_is_returned() -> None:
    w = flown_by_a_pilot()
    w.autopilot.silent = {ActionKind.TAKE_CONTROL}
    assert order(w) is None
    w.fly(10.0, until=lambda w: ActionKind.TAKE_CONTROL in asked(w))
    w.autopilot.mode = "OFFBOARD"
    w.fly(60.0)
    w.fly(1.0, until=lambda w: not w.planner.waiting)
    assert (w.flight.phase, w.autopilot.mode) == (Phase.ABORT, "LOITER")


def test_a_pilots_vehicle_whose_control_was_obeyed_after_it_was_given_up_is_returned() -> None:
    w = flown_by_a_pilot()
    w.autopilot.silent = {ActionKind.TAKE_CONTROL}
    assert order(w) is None
    w.fly(60.0)
    assert asked(w).count(ActionKind.TAKE_CONTROL) == MissionConfig().action_attempts
    assert asked(w)[-1] is ActionKind.HOLD_IF_OBEYED
    w.autopilot.mode = "OFFBOARD"  # the next heartbeat shows it
    w.fly(10.0, until=lambda w: not w.planner.waiting)
    assert w.autopilot.mode == "LOITER"


def test_a_link_that_is_lost_before_control_is_ours_ends_the_order() -> None:
    w = flown_by_a_pilot()
    w.autopilot.silent = {ActionKind.TAKE_CONTROL}
    assert order(w) is None
    w.fly(0.3)
    w.autopilot.connected = False
    w.fly(1.0)
    assert w.flight.phase is Phase.ABORT
    assert math.isnan(w.flight.touch_lateral_m)


# ---------------- A vehicle that may not fly is left alone; a battery that is low begins nothing new


def in_standby() -> PlanWorld:
    w = world(still())
    w.planner = Planner(PlanConfig(), VEHICLE, 20, 0.1, TABLE, standby="nobody permitted it")
    return w


@pytest.mark.parametrize("armed", [False, True])
def test_in_standby_nothing_is_asked_and_no_setpoint_leaves_whatever_the_time(armed: bool) -> None:
    w = in_standby()
    w.autopilot.armed, w.autopilot.mode = armed, "POSCTL"
    flight = w.fly(200.0)
    assert {phase for _, phase in flight.phases} == {Phase.STANDBY}
    assert w.autopilot.heard == []
    assert all(step.reference is None and not step.actions for step in flight.steps)
    assert flight.told("standby")


def test_standby_ends_when_the_operator_says_so() -> None:
    w = in_standby()
    w.stop = True
    w.fly(1.0)
    assert w.flight.phase is Phase.ABORT
    assert w.autopilot.heard == []


def test_a_battery_that_gets_low_over_the_pad_makes_the_try_the_last_with_wider_limits_aside() -> None:
    """GIVEN a wind that holds the vehicle 10 cm aside, beyond the 7 cm of a try that others may follow."""
    w = world(still())
    w.fly(60.0, until=lambda w: w.flight.phase is Phase.TOUCHDOWN)
    w.gust = lambda _t: (0.3, 0.0, 0.0)
    w.autopilot.battery_share = 0.2
    flight = w.fly(60.0)
    assert flight.phase is Phase.LANDED
    assert 0.07 < flight.touch_lateral_m < 0.11


def test_low_in_flight_the_try_under_way_is_the_last() -> None:
    w = world(still())
    w.blind = lambda _t, height: height < 0.9 and w.now_s < 60.0  # the first try fails
    w.fly(60.0, until=lambda w: w.flight.phase is Phase.DESCEND)
    w.autopilot.battery_share = 0.2
    w.fly(60.0, until=lambda w: w.flight.phase in {Phase.HOLD, Phase.LANDED, Phase.ABORT})
    assert w.flight.phase is Phase.HOLD
    assert w.flight.told("battery") == ["battery low: 20 % left, no new try"]


@pytest.mark.parametrize("finishes", [True, False])
def test_critical_in_the_descent_it_is_finished_as_the_settings_say(finishes: bool) -> None:
    config = PlanConfig.model_validate({"mission": {"battery": {"finish_descent": finishes}}})
    w = world(still(), config)
    w.fly(60.0, until=lambda w: w.flight.phase is Phase.DESCEND)
    w.autopilot.battery_share = 0.1
    w.fly(40.0)
    assert w.flight.phase is (Phase.LANDED if finishes else Phase.ABORT)


def test_the_feet_are_near_while_they_may_stand_unseen() -> None:
    w, stood = world(still()), list[bool]()
    lost_s = 0.0

    def note(w: PlanWorld, step: PlanStep) -> None:
        nonlocal lost_s
        over_m = w.pad(w.now_s)[2] - w.position[2] - LEG_M
        if step.phase is Phase.TOUCHDOWN and over_m < 0.12 and not lost_s:
            lost_s, w.range_lost = w.now_s, True
        if step.unloading > 0.0 or (lost_s and w.now_s - lost_s > 0.5 and step.phase is Phase.TOUCHDOWN):
            stood.append(step.feet_near)

    w.each = note
    w.blind = lambda _t, _height: lost_s > 0.0
    w.fly(120.0, until=lambda w: w.flight.phase is Phase.LANDED)
    assert stood
    assert all(stood)


@pytest.mark.parametrize("echo_m", [None, 0.06])
def test_the_feet_are_near_low_over_the_pad_alone_whatever_a_stuck_echo_says(echo_m: float | None) -> None:
    w, near = world(), set[bool]()
    heights_m: dict[bool, list[float]] = {True: [], False: []}

    def note(w: PlanWorld, step: PlanStep) -> None:
        if step.phase in {Phase.APPROACH, Phase.DESCEND, Phase.TOUCHDOWN} and not step.on_ground:
            heights_m[step.feet_near].append(w.pad(w.now_s)[2] - w.position[2] - LEG_M)
        elif step.phase in {Phase.SEARCH, Phase.WAYPOINT}:
            near.add(step.feet_near)
        if step.phase is Phase.TOUCHDOWN:
            w.echo_m = echo_m

    w.each = note
    assert w.fly(120.0).phase is Phase.LANDED
    assert near == {False}
    assert 0.08 < max(heights_m[True]) < (0.13 if echo_m is None else 0.4)
    assert min(heights_m[False]) > 0.05
