"""Orders to a planner in standby: followed where nothing stands against it, else refused with the reason."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from companion.base.messages import ActionKind, LandedState, Order, OrderKind, Phase
from companion.config import Cylinder, MissionConfig, PlanConfig
from companion.plan.mission.inputs import ComputerLoad
from companion.plan.mission.mode_monitor import TAKES_S
from companion.plan.planner import Planner
from tests.unit.plan.pad_paths import line, still
from tests.unit.plan.plan_harness import TABLE, VEHICLE, PlanWorld

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
    "no estimate": (lambda w: setattr(w, "vehicle_known", False), "no current vehicle estimate"),
    "battery": (lambda w: setattr(w.autopilot, "battery_share", 0.1), "battery critical: 10 % left"),
    "fence": (
        lambda w: setattr(w, "position", (500.0, 0.0, -6.0)),
        "fence: 500 m from home, limit 150 m",
    ),
    "ceiling": (
        lambda w: setattr(w, "position", (0.0, 0.0, -70.0)),
        "ceiling: 70 m over home, limit 60 m",
    ),
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


def test_granted_but_never_obeyed_it_gives_up_and_the_pilot_has_it() -> None:
    w = flown_by_a_pilot()
    assert order(w) is None
    w.each = lambda w, _step: setattr(w.autopilot, "mode", "POSCTL")
    w.fly(2.0 + 2.0 * TAKES_S)
    assert w.flight.phase is Phase.ABORT
    assert "POSCTL" in w.flight.told("phase")[-1]


def test_a_link_that_is_lost_before_control_is_ours_ends_the_order() -> None:
    w = flown_by_a_pilot()
    w.autopilot.silent = {ActionKind.TAKE_CONTROL}
    assert order(w) is None
    w.fly(0.3)
    w.autopilot.connected = False
    w.fly(1.0)
    assert w.flight.phase is Phase.ABORT
    assert math.isnan(w.flight.touch_lateral_m)
