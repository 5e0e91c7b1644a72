from dataclasses import replace

import pytest

from companion.base.messages import AutopilotState, Manner, Phase
from companion.config import MissionConfig, PhaseTimesConfig
from companion.plan.mission.failsafe_monitor import Watch, is_pilots
from companion.plan.mission.inputs import PlanInputs
from companion.plan.mission.table import Event
from tests.unit.plan.plan_harness import World, still

CONFIG = MissionConfig(total_timeout_s=100.0, phases=PhaseTimesConfig(approach_s=30.0))
FLYING = AutopilotState(0.0, connected=True, manner="px4", armed=True, mode="OFFBOARD", offboard=True)


def inputs(autopilot: AutopilotState = FLYING, stop: bool = False, vehicle: bool = True) -> PlanInputs:
    w = World(still())
    w.now_s = 50.0
    known = w.inputs().vehicle if vehicle else None
    return PlanInputs(vehicle=known, pad=None, autopilot=autopilot, stop_requested=stop)


def found(
    watch: Watch,
    given: PlanInputs,
    phase: Phase = Phase.APPROACH,
    *,
    taken_over: bool = False,
    on_pad: bool = False,
    committed: bool = False,
) -> Event | None:
    finding = watch.event(phase, 45.0, given, 50.0, taken_over=taken_over, on_pad=on_pad, committed=committed)
    return finding[0] if finding else None


@pytest.mark.parametrize(
    ("manner", "mode", "pilots"),
    [
        ("px4", "POSCTL", True),
        ("px4", "posctl", True),
        ("px4", "AUTO.RTL", True),
        ("px4", "OFFBOARD", False),
        ("px4", "LOITER", False),
        ("px4", "TAKEOFF", False),
        ("ardupilot", "LOITER", True),
        ("ardupilot", "Alt Hold", True),
        ("ardupilot", "GUIDED", False),
        (None, "MANUAL", False),
    ],
)
def test_which_modes_are_a_pilots(manner: Manner | None, mode: str, pilots: bool) -> None:
    assert is_pilots(mode, manner) is pilots


def test_all_is_well_is_nothing() -> None:
    assert found(Watch(CONFIG), inputs()) is None


def test_control_begins_when_granted_and_obeyed_and_ends_when_the_mode_is_left() -> None:
    watch = Watch(CONFIG)
    before = replace(FLYING, mode="LOITER", offboard=False)
    assert not watch.note(before, control_granted=True)
    granted_only = watch.in_control
    assert not granted_only
    assert not watch.note(FLYING, control_granted=True)
    assert watch.in_control
    # any other mode, even one that is nobody's
    assert watch.note(before, control_granted=False)


def test_handing_back_makes_a_change_of_mode_ours() -> None:
    watch = Watch(CONFIG)
    watch.note(FLYING, control_granted=True)
    watch.let_go()
    assert not watch.note(replace(FLYING, mode="LOITER", offboard=False), control_granted=False)


def test_before_control_only_the_change_into_a_pilots_mode_counts() -> None:
    watch = Watch(CONFIG)
    manual = replace(FLYING, mode="POSCTL", offboard=False)
    assert watch.note(manual, control_granted=False)
    assert not watch.note(manual, control_granted=False)  # as found: it was like that already
    assert not watch.note(replace(manual, mode="TAKEOFF"), control_granted=False)
    assert watch.note(manual, control_granted=False)


@pytest.mark.parametrize(
    ("given", "taken_over", "on_pad", "event"),
    [
        (inputs(replace(FLYING, armed=False)), False, False, Event.DISARMED),
        (inputs(), True, False, Event.PILOT_TOOK_OVER),
        (inputs(stop=True), False, False, Event.STOP),
        (inputs(replace(FLYING, connected=False)), False, False, Event.LINK_LOST),
        (inputs(vehicle=False), False, False, Event.ESTIMATE_LOST),
        (inputs(replace(FLYING, connected=False)), False, True, None),
        (inputs(vehicle=False), False, True, None),
        # a pilot is asked before the one at the keyboard, and a lost link knows no mode
        (inputs(stop=True), True, False, Event.PILOT_TOOK_OVER),
        (inputs(replace(FLYING, connected=False)), True, False, Event.LINK_LOST),
    ],
)
def test_each_trouble_in_flight(
    given: PlanInputs, taken_over: bool, on_pad: bool, event: Event | None
) -> None:
    assert found(Watch(CONFIG), given, taken_over=taken_over, on_pad=on_pad) is event


def test_a_stop_on_the_last_way_down_waits_for_the_touchdown() -> None:
    given = inputs(stop=True)
    assert found(Watch(CONFIG), given, Phase.TOUCHDOWN) is Event.STOP
    assert found(Watch(CONFIG), given, Phase.TOUCHDOWN, committed=True) is None


def test_motors_that_stop_before_the_touchdown_are_no_landing() -> None:
    off = inputs(replace(FLYING, armed=False))
    assert found(Watch(CONFIG), off, Phase.TOUCHDOWN) is Event.PILOT_TOOK_OVER
    assert found(Watch(CONFIG), off, Phase.TOUCHDOWN, on_pad=True) is Event.DISARMED


def test_a_pilot_is_heeded_on_the_pad_too_and_our_own_land_is_not_a_pilot() -> None:
    watch = Watch(CONFIG)
    watch.note(FLYING, control_granted=True)
    watch.let_go()
    assert not watch.note(replace(FLYING, mode="AUTO.LAND", offboard=False), control_granted=False)
    watch.note(replace(FLYING, mode="OFFBOARD"), control_granted=False)
    assert watch.note(replace(FLYING, mode="POSCTL", offboard=False), control_granted=False)


def test_a_velocity_that_nobody_knows_ends_a_search_but_not_a_descent() -> None:
    given = inputs()
    assert given.vehicle is not None
    lost = replace(given, vehicle=replace(given.vehicle, velocity_std_m_s=2.0))
    assert found(Watch(CONFIG), lost, Phase.SEARCH) is Event.ESTIMATE_LOST
    assert found(Watch(CONFIG), lost, Phase.DESCEND) is None


def test_on_the_ground_before_take_off_being_disarmed_is_no_event() -> None:
    assert found(Watch(CONFIG), inputs(replace(FLYING, armed=False)), Phase.ARM) is None


def test_a_mission_that_has_ended_sees_nothing_more() -> None:
    for phase in (Phase.LANDED, Phase.ABORT):
        assert found(Watch(CONFIG), inputs(stop=True), phase, taken_over=True) is None


def test_time_on_both_sides_of_its_bounds() -> None:
    watch = Watch(CONFIG)
    w = World(still())

    def at(now_s: float, since_s: float) -> Event | None:
        w.now_s = now_s
        given = replace(inputs(), vehicle=w.inputs().vehicle)
        finding = watch.event(
            Phase.APPROACH, since_s, given, now_s, taken_over=False, on_pad=False, committed=False
        )
        return finding[0] if finding else None

    assert at(10.0, 10.0) is None
    assert at(39.9, 10.0) is None
    assert at(40.1, 10.0) is Event.TIMEOUT
    assert at(109.9, 109.0) is None
    assert at(110.1, 109.0) is Event.OVERTIME


def test_an_estimate_that_is_old_counts_as_lost() -> None:
    given = inputs()
    assert given.vehicle is not None
    old = replace(given, vehicle=replace(given.vehicle, time_s=49.4))
    assert found(Watch(CONFIG), old) is Event.ESTIMATE_LOST
    unaligned = replace(given, vehicle=replace(given.vehicle, aligned=False))
    assert found(Watch(CONFIG), unaligned) is Event.ESTIMATE_LOST
    # not needed where the autopilot navigates
    assert found(Watch(CONFIG), old, Phase.WAYPOINT) is None
