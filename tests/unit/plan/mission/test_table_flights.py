"""The mission's table, walked: what flights go through in which order."""

from itertools import product

import numpy as np
import pytest

from companion.base.messages import ActionKind
from companion.plan.mission.state_machine import StateMachine
from companion.plan.mission.states import Authority, Circumstances, Effect, MissionEvent, State
from companion.plan.mission.table import (
    COMMITTED,
    IN_AIR,
    LIVE,
    LOW,
    ON_PAD,
    TABLE,
    follows,
    impossible,
)
from tests.unit.plan.mission.table_walk import E, S, kinds, taken


def test_a_good_flight_goes_through_in_order() -> None:
    machine, passed = StateMachine(retries=3), []
    for name in (
        *("READY", "ARMED", "AIRBORNE", "ARRIVED", "STREAMING", "CONTROL_GRANTED", "PAD_SEEN", "CENTRED"),
        *("LOW", "COMMIT", "BREAK_OFF", "RISEN", "COMMIT", "CONTACT", "LANDING_DETECTED", "DISARMED"),
    ):
        before = machine.state
        assert not impossible(before, E[name])
        branch = machine.follows(E[name], Circumstances())
        assert branch is not None
        machine.take(branch)
        if machine.state is not before:
            passed.append(machine.state.value)
    assert passed == [
        *("arm", "take_off", "waypoint", "search", "approach", "descend"),
        *("wait", "sink", "rise", "wait", "sink", "stand", "landed"),
    ]


@pytest.mark.parametrize("state", sorted(LIVE - {S.STANDBY, S.CONNECT}))
def test_a_pilot_who_takes_over_keeps_the_vehicle(state: State) -> None:
    branch = taken(state, E.TAKEN_OVER)
    assert (branch.to, branch.actions, branch.authority) == (S.ABORT, (), Authority.RELEASED)
    assert Effect.STOP_SETPOINTS in branch.effects


CLIMBS_CLEAR = {E.STOP, E.OVERTIME, E.OUT_OF_BOUNDS, E.PAD_DISPUTED, E.PAD_TOO_FAST}


@pytest.mark.parametrize(
    "event",
    [
        *(E.STOP, E.OVERTIME, E.ESTIMATE_LOST, E.ESTIMATE_DISPUTED, E.CONTROL_FAILED),
        *(E.VELOCITY_UNCERTAIN, E.OUT_OF_BOUNDS, E.PAD_DISPUTED, E.PAD_TOO_FAST),
    ],
)
@pytest.mark.parametrize("state", sorted(IN_AIR - COMMITTED))
def test_stop_overtime_and_a_lost_estimate_return_control_holding(state: State, event: MissionEvent) -> None:
    if TABLE[state, event]:
        if not (state in LOW and event in CLIMBS_CLEAR):
            assert taken(state, event).to is S.ABORT
            assert kinds(taken(state, event)) == [ActionKind.HOLD]
        # one that stands would lift off to hold a position
        assert kinds(taken(state, event, Circumstances(Authority.OURS, on_surface=True))) == [ActionKind.LAND]


def test_stopped_on_the_ground_it_disarms_or_does_nothing() -> None:
    assert taken(S.CONNECT, E.STOP).actions == ()
    assert kinds(taken(S.ARM, E.STOP)) == [ActionKind.DISARM]


@pytest.mark.parametrize("state", [S.APPROACH, S.DESCEND])
def test_losing_the_pad_asks_for_a_new_position(state: State) -> None:
    branch = taken(state, E.PAD_LOST)
    assert branch.to is S.SEARCH
    assert branch.effects == (Effect.ASK_PAD_POSITION,)


@pytest.mark.parametrize(
    ("state", "event"),
    [
        *product((S.WAIT, S.RISE, S.SINK), (E.MISALIGNED, E.PAD_LOST)),
        *((S.STAND, E.OFF_PAD), (S.AUTO_LAND, E.OFF_PAD), (S.DESCEND, E.TIMEOUT)),
    ],
)
def test_a_missed_touchdown_goes_round_again_until_its_tries_are_used_up(
    state: State, event: MissionEvent
) -> None:
    again, last = taken(state, event), taken(state, event, Circumstances(Authority.OURS, tries_left=False))
    assert (again.to, last.to) == (S.APPROACH, S.HOLD)
    assert Effect.COUNT_TRY in again.effects


def test_so_many_tries_more_than_the_first() -> None:
    machine, ends = StateMachine(retries=2), []
    for _ in range(3):
        machine.state = S.WAIT
        ends.append(machine.last_try)
        branch = machine.follows(E.MISALIGNED, Circumstances())
        assert branch is not None
        machine.take(branch)
    assert ends == [False, False, True]
    assert machine.state is S.HOLD


def test_motors_off_on_the_pad_are_a_landing_and_before_that_none() -> None:
    for state in IN_AIR:
        assert taken(state, E.DISARMED).to is (S.LANDED if state in ON_PAD | {S.SET_DOWN} else S.ABORT)


def test_disarmed_it_leaves_offboard_where_control_was_ours_and_asks_for_nothing_else() -> None:
    for state in IN_AIR:
        for authority in Authority:
            branch = taken(state, E.DISARMED, Circumstances(authority, in_offboard=True))
            ours = authority is Authority.OURS
            assert kinds(branch) == ([ActionKind.LEAVE_OFFBOARD] if ours else [])
        assert kinds(taken(state, E.DISARMED)) == []


def test_land_is_asked_on_the_pad_only_where_no_disarm_is_open() -> None:
    assert kinds(taken(S.STAND, E.UNPROVEN)) == [ActionKind.LAND]
    assert follows(S.STAND, E.UNPROVEN, Circumstances(Authority.OURS, disarm_asked=True)) is None


def test_a_link_that_is_back_is_of_use_while_control_is_ours_or_the_vehicle_flies() -> None:
    assert taken(S.AWAIT_LINK, E.LINK_UP).to is S.SEARCH
    assert taken(S.AWAIT_LINK, E.LINK_UP, Circumstances(airborne=True)).to is S.SEARCH
    assert follows(S.AWAIT_LINK, E.LINK_UP, Circumstances(Authority.RELEASED, airborne=True)) is None
    for authority in (Authority.NONE, Authority.RELEASED):
        assert follows(S.AWAIT_LINK, E.LINK_UP, Circumstances(authority)) is None


def test_what_the_autopilot_cannot_fly_straight_to_and_further_waypoints_are_flown_by_us() -> None:
    assert taken(S.TAKE_OFF, E.BLOCKED).to is S.ROUTE
    assert taken(S.TAKE_OFF, E.BLOCKED).actions == ()
    assert taken(S.WAYPOINT, E.ONWARD).to is S.ROUTE
    for event in (E.ARRIVED, E.PAD_SEEN, E.TIMEOUT):
        assert taken(S.ROUTE, event).to is S.SEARCH
    assert kinds(taken(S.ROUTE, E.REFUSED)) == [ActionKind.HOLD]


@pytest.mark.parametrize("seed", range(20))
def test_whatever_happens_in_whatever_order_a_released_vehicle_stays_released(seed: int) -> None:
    rng = np.random.default_rng(seed)
    machine = StateMachine(retries=2)
    for _ in range(300):
        possible = [event for event in MissionEvent if not impossible(machine.state, event)]
        event = possible[int(rng.integers(len(possible)))]
        released = machine.authority is Authority.RELEASED
        asked, on_surface, land, airborne = (bool(n) for n in rng.integers(2, size=4))
        circumstances = Circumstances(
            on_surface=on_surface, disarm_asked=asked, land_granted=land, airborne=airborne
        )
        branch = machine.follows(event, circumstances)
        if branch is None:
            continue
        machine.take(branch)
        if released:
            assert branch.actions == ()
            assert machine.authority is Authority.RELEASED
