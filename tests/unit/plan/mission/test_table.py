"""The mission's table: every pair of state and event, every guard, every action."""

from itertools import product

import numpy as np
import pytest

from companion.base.messages import ActionKind, Phase
from companion.plan.events import MissionEvent
from companion.plan.mission.states import Authority, Branch, Circumstances, Effect, Guard, State
from companion.plan.mission.table import (
    ANYWHERE,
    BEFORE_TAKE_OFF,
    COMMITTED,
    FINAL,
    HOLDING,
    IN_AIR,
    LIVE,
    ON_PAD,
    OVER_PAD_OR_DESCENDING,
    ROWS,
    TABLE,
    TOUCHDOWN,
    StateMachine,
    by_severity,
    follows,
    impossible,
)
from docs import state_machine

E, S = MissionEvent, State
FLYING = Circumstances(authority=Authority.OURS)


def taken(state: State, event: MissionEvent, circumstances: Circumstances = FLYING) -> Branch:
    branch = follows(state, event, circumstances)
    assert branch is not None
    return branch


def kinds(branch: Branch) -> list[ActionKind]:
    return [action.kind for action in branch.actions]


# ---------------- The mission's table: every pair of state and event, every guard, every action

AFTER_END = (S.ABORT, E.TAKEN_OVER)  # while the end still asks for something
# it waits for the operator; it goes down or stands, and asks for LAND on
NOT_BY_TIME = {S.STANDBY, S.SET_DOWN, S.AUTO_LAND}
EVERY_CIRCUMSTANCE = [
    Circumstances(authority, *flags) for authority in Authority for flags in product((False, True), repeat=9)
]


def test_every_pair_stands_in_exactly_one_row_or_is_impossible_or_the_mission_has_ended() -> None:
    assert set(TABLE) == set(product(State, MissionEvent))
    for state, event in TABLE:
        rows = [row for row in ROWS if row.event is event and state in (*row.states, *row.except_)]
        assert len(rows) <= 1
        assert bool(rows) is not (impossible(state, event) or state in FINAL) or (state, event) == AFTER_END
        assert not (rows and state in rows[0].states and state in rows[0].except_)


@pytest.mark.parametrize("event", ANYWHERE)
@pytest.mark.parametrize("state", sorted(LIVE))
def test_what_may_happen_anywhere_is_handled_in_every_state_or_excepted_with_a_reason(
    state: State, event: MissionEvent
) -> None:
    assert not impossible(state, event)
    if not TABLE[state, event]:
        [reason] = [r.except_[state] for r in ROWS if r.event is event and state in r.except_]
        assert reason


@pytest.mark.parametrize(
    ("event", "excepted"),
    [
        (E.STOP, COMMITTED | {S.HOLD}),
        (E.TAKEN_OVER, {S.STANDBY, S.CONNECT}),
        (E.LINK_LOST, BEFORE_TAKE_OFF | COMMITTED | {S.HOLD, S.AWAIT_LINK}),
        (E.ESTIMATE_LOST, BEFORE_TAKE_OFF | ON_PAD | {S.TAKE_OFF, S.WAYPOINT, S.SET_DOWN}),
        (E.ESTIMATE_DISPUTED, BEFORE_TAKE_OFF | ON_PAD | {S.TAKE_OFF, S.WAYPOINT, S.SET_DOWN}),
        (E.CONTROL_FAILED, BEFORE_TAKE_OFF | ON_PAD | {S.TAKE_OFF, S.WAYPOINT, S.SET_DOWN}),
        (E.DISARMED, BEFORE_TAKE_OFF),
        (E.OVERTIME, BEFORE_TAKE_OFF | COMMITTED | {S.HOLD}),
        (E.LINK_LATE, BEFORE_TAKE_OFF | COMMITTED | {S.TAKE_OFF, S.WAYPOINT}),
        (E.COMPUTER_LATE, BEFORE_TAKE_OFF | COMMITTED | {S.TAKE_OFF, S.WAYPOINT}),
        (E.BATTERY_CRITICAL, BEFORE_TAKE_OFF | COMMITTED | {S.HOLD}),
        (E.BATTERY_LOW, {S.STANDBY, S.CONNECT}),
        (E.SUSPENDED, COMMITTED | {S.STANDBY, S.DESCEND, S.WAIT, S.RISE, S.HOLD}),
        (E.OUT_OF_BOUNDS, BEFORE_TAKE_OFF | COMMITTED | {S.HOLD}),
        (E.PAD_DISPUTED, LIVE - {S.APPROACH, S.DESCEND, S.WAIT, S.RISE}),
        (E.PAD_TOO_FAST, LIVE - {S.APPROACH, S.DESCEND, S.WAIT, S.RISE}),
        (E.TIMEOUT, {S.STANDBY}),
    ],
)
def test_the_failsafes_mean_something_in_every_state_but_these(
    event: MissionEvent, excepted: set[State]
) -> None:
    assert {state for state in LIVE if not TABLE[state, event]} == excepted


@pytest.mark.parametrize("state", sorted(LIVE))
def test_every_state_can_be_reached_and_left_whatever_the_circumstances(state: State) -> None:
    reached, left = {State.STANDBY, State.CONNECT}, set()
    for (at, event), branches in TABLE.items():
        if not impossible(at, event) and at not in FINAL:
            reached |= {b.to for b in branches if b.to not in {None, at}}
            left |= {at for b in branches if b.to not in {None, at}}
    assert state in reached
    assert state in left
    for circumstances in EVERY_CIRCUMSTANCE if state not in NOT_BY_TIME else ():
        assert taken(state, E.TIMEOUT, circumstances).to not in {None, state}


@pytest.mark.parametrize("state", sorted(LIVE - NOT_BY_TIME))
def test_every_state_ends_by_time_or_asks_for_land_on(state: State) -> None:
    # following TIMEOUT alone the mission is over after a few phases
    machine = StateMachine(retries=2)
    machine.state, machine.authority = state, Authority.OURS
    for _ in range(5):
        if machine.state in FINAL | NOT_BY_TIME:
            return
        branch = machine.follows(E.TIMEOUT, Circumstances())
        assert branch is not None
        machine.take(branch)
    pytest.fail(f"{state} does not end by time")


def test_on_the_pad_with_the_motors_on_it_stays_and_asks_again() -> None:
    for event in (E.REFUSED, E.TIMEOUT):
        branch = taken(S.AUTO_LAND, event)
        assert branch.to is None
        assert ActionKind.LAND in kinds(branch)
    assert taken(S.AUTO_LAND, E.TIMEOUT).effects == (Effect.ASK_AFRESH,)
    assert taken(S.STAND, E.REFUSED).to is None
    assert kinds(taken(S.STAND, E.REFUSED)) == [ActionKind.DISARM]


def test_what_is_refused_means_something_where_more_is_asked_than_to_disarm_a_vehicle_on_its_side() -> None:
    # GIVEN what may be open in each state: a new phase drops what was asked before
    reached: set[tuple[State, frozenset[ActionKind]]] = {(S.STANDBY, frozenset()), (S.CONNECT, frozenset())}
    todo = list(reached)
    while todo:
        at, asked = todo.pop()
        followed = [b for event in MissionEvent if not impossible(at, event) for b in TABLE[at, event]]
        for branch in [b for b in followed if at not in FINAL]:
            to = branch.to or at
            kept = asked if to.phase is at.phase else frozenset()
            then = (to, kept | {action.kind for action in branch.actions})
            if then not in reached:
                reached.add(then)
                todo.append(then)
    opened = {state: {kind for at, kinds in reached if at is state for kind in kinds} for state in LIVE}
    # THEN it has a row, but for what a phase asks again by itself and for what lies, which has a reason
    for state in LIVE - {S.STANDBY, S.CONNECT, S.ARM} - HOLDING:
        only_lay = opened[state] == {ActionKind.DISARM} and state is not S.STAND
        assert bool(TABLE[state, E.REFUSED]) is not only_lay
        assert not impossible(state, E.REFUSED)


def test_in_standby_nothing_is_asked_whatever_happens() -> None:
    left = {}
    for event in MissionEvent:
        if not impossible(S.STANDBY, event):
            branch = follows(S.STANDBY, event, Circumstances())
            assert branch is None or branch.actions == ()
            if branch is not None:
                left[event] = branch.to
    assert left == {E.STOP: S.ABORT, E.LAND_ORDERED: S.SEARCH, E.FLY_ORDERED: S.CONNECT}


@pytest.mark.parametrize("event", list(MissionEvent))
def test_a_vehicle_that_was_never_ours_stays_in_its_pilot_s_mode(event: MissionEvent) -> None:
    machine = StateMachine(retries=3, may_fly=False)
    machine.take(taken(S.STANDBY, E.LAND_ORDERED))
    branch = machine.follows(event, Circumstances())
    asked = () if branch is None else branch.actions
    # the one thing that may be asked for is what the order is about
    assert [action.kind for action in asked] in ([], [ActionKind.TAKE_CONTROL])


@pytest.mark.parametrize("event", list(MissionEvent))
def test_however_it_ends_once_control_may_be_obeyed_it_is_returned_but_not_from_who_took_it(
    event: MissionEvent,
) -> None:
    branch = follows(S.SEARCH, event, Circumstances(Authority.PILOT, may_obey=True))
    if branch is not None and branch.to is S.ABORT:
        taken_or_off = event in {E.TAKEN_OVER, E.DISARMED}
        assert kinds(branch) == ([] if taken_or_off else [ActionKind.HOLD_IF_OBEYED])
    if branch is not None and impossible(S.SEARCH, event):
        assert branch.to is S.ABORT


@pytest.mark.parametrize(
    "event", [E.ESTIMATE_LOST, E.ESTIMATE_DISPUTED, E.CONTROL_FAILED, E.PAD_GONE, E.TIMEOUT]
)
def test_too_low_to_rise_and_nothing_to_follow_it_is_set_down_in_land(event: MissionEvent) -> None:
    branch = taken(S.SINK, event)
    assert branch.to is S.SET_DOWN
    assert kinds(branch) == [ActionKind.LAND]
    assert branch.authority is None  # our setpoints go on until LAND is active


@pytest.mark.parametrize("event", [E.ESTIMATE_LOST, E.ESTIMATE_DISPUTED, E.CONTROL_FAILED])
def test_blind_with_its_feet_down_it_stands_where_land_would_brake_against_the_pad(
    event: MissionEvent,
) -> None:
    branch = taken(S.SINK, event, Circumstances(Authority.OURS, feet_down=True))
    assert (branch.to, kinds(branch)) == (S.STAND, [])


@pytest.mark.parametrize("state", sorted({S.WAIT, S.RISE, S.DESCEND}))
def test_with_a_critical_battery_a_descent_is_finished_if_the_settings_say_so(state: State) -> None:
    finishing = taken(state, E.BATTERY_CRITICAL, Circumstances(Authority.OURS, may_finish=True))
    assert (finishing.to, finishing.actions) == (None, ())
    assert taken(state, E.BATTERY_CRITICAL).to is S.HOLD  # clear of the pad first


@pytest.mark.parametrize("ends", [E.CLEAR, E.TIMEOUT])
@pytest.mark.parametrize(
    "event", [E.STOP, E.OVERTIME, E.BATTERY_CRITICAL, E.OUT_OF_BOUNDS, E.PAD_DISPUTED, E.PAD_TOO_FAST]
)
@pytest.mark.parametrize("state", sorted({S.WAIT, S.RISE, S.DESCEND, S.APPROACH}))
def test_just_over_the_pad_it_climbs_clear_before_control_is_returned(
    state: State, event: MissionEvent, ends: MissionEvent
) -> None:
    machine = StateMachine(retries=2)
    machine.state, machine.authority = state, Authority.OURS
    branch = machine.follows(event, Circumstances(near=state is S.APPROACH))
    assert branch is not None
    assert (branch.to, branch.actions, branch.authority) == (S.HOLD, (), None)
    machine.take(branch)
    assert machine.follows(event, Circumstances()) is None  # it goes on for as long as it holds
    ending = machine.follows(ends, Circumstances())
    assert ending is not None
    assert (ending.to, ending.authority, kinds(ending)) == (S.ABORT, Authority.RELEASED, [ActionKind.HOLD])


@pytest.mark.parametrize("state", sorted({S.WAIT, S.RISE, S.DESCEND}))
def test_a_late_link_is_no_line_to_climb_by(state: State) -> None:
    branch = taken(state, E.LINK_LATE)
    assert (branch.to, branch.authority, kinds(branch)) == (S.ABORT, Authority.RELEASED, [ActionKind.HOLD])


@pytest.mark.parametrize(
    ("state", "event"),
    [
        *((state, E.TIMEOUT) for state in (S.SINK, S.STAND)),
        *((S.SINK, event) for event in (E.PAD_GONE, E.ESTIMATE_LOST)),
        (S.STAND, E.UNPROVEN),
    ],
)
def test_land_has_its_own_time_however_late_it_is_asked_for(state: State, event: MissionEvent) -> None:
    branch = taken(state, event)
    assert kinds(branch) == [ActionKind.LAND]
    assert Effect.COUNT_AFRESH in branch.effects


@pytest.mark.parametrize("state", [S.SET_DOWN, S.AUTO_LAND])
def test_without_a_link_it_asks_nobody_for_land_for_ever(state: State) -> None:
    branch = taken(state, E.TIMEOUT, Circumstances(Authority.OURS, heard=False))
    assert (branch.to, branch.authority, branch.actions) == (S.ABORT, Authority.RELEASED, ())


def test_no_time_makes_a_contact_of_going_down() -> None:
    branch = taken(S.SET_DOWN, E.TIMEOUT)
    assert (branch.to, kinds(branch)) == (None, [ActionKind.LAND])
    assert Effect.ASK_AFRESH in branch.effects


def test_seen_off_the_pad_in_land_it_comes_down_in_land() -> None:
    branch = taken(S.AUTO_LAND, E.OFF_PAD, Circumstances(Authority.OURS, land_granted=True))
    assert (branch.to, branch.authority) == (S.ABORT, Authority.RELEASED)
    assert taken(S.AUTO_LAND, E.OFF_PAD).to is S.APPROACH


@pytest.mark.parametrize("state", sorted(FINAL))
@pytest.mark.parametrize("event", list(MissionEvent))
def test_what_has_ended_stays_ended(state: State, event: MissionEvent) -> None:
    for circumstances in EVERY_CIRCUMSTANCE:
        branch = follows(state, event, circumstances)
        if (state, event) != AFTER_END:
            assert branch is None
        else:  # it ends what is still asked, and moves nothing
            assert branch == Branch(None, effects=(Effect.ASK_NOTHING,))


@pytest.mark.parametrize(("state", "event"), list(TABLE))
def test_once_released_nothing_is_asked_of_the_autopilot(state: State, event: MissionEvent) -> None:
    for circumstances in EVERY_CIRCUMSTANCE:
        branch = follows(state, event, circumstances)
        if branch is not None and circumstances.authority is Authority.RELEASED:
            assert branch.actions == ()
            assert branch.authority in {None, Authority.RELEASED}


def test_the_mission_ends_released_and_asks_for_no_position_on_the_ground() -> None:
    for (state, event), branches in TABLE.items():
        for branch in branches:
            if branch.to in FINAL:
                assert branch.authority is Authority.RELEASED
            if ActionKind.HOLD in kinds(branch) and state in ON_PAD:
                assert branch.guard is Guard.ALWAYS
                standing = taken(state, event, Circumstances(Authority.OURS, on_surface=True))
                assert ActionKind.HOLD not in kinds(standing)


def test_a_branch_without_a_guard_is_the_last() -> None:
    for branches in TABLE.values():
        assert all(branch.guard is not Guard.ALWAYS for branch in branches[:-1])


def test_each_action_is_asked_from_few_states_alone() -> None:
    asked: dict[tuple[ActionKind, bool], set[State]] = {}
    for (state, event), branches in TABLE.items():
        if impossible(state, event) or event is E.TIPPED_OVER:
            continue
        for action in [a for b in branches for a in b.actions]:
            asked.setdefault((action.kind, action.force), set()).add(state)
    assert asked[ActionKind.ARM, False] == {S.CONNECT}
    assert asked[ActionKind.TAKE_OFF, False] == {S.ARM}
    assert asked[ActionKind.GO_TO, False] == {S.TAKE_OFF}
    assert asked[ActionKind.TAKE_CONTROL, False] == {S.ROUTE, S.SEARCH}
    assert asked[ActionKind.DISARM, True] == ON_PAD  # in the air it drops the vehicle
    assert asked[ActionKind.DISARM, False] == {S.ARM, S.TAKE_OFF, S.SET_DOWN} | ON_PAD


def test_the_motors_of_a_vehicle_on_its_side_are_stopped_unless_a_pilot_flew_it() -> None:
    for state in IN_AIR:
        branch = taken(state, E.TIPPED_OVER, Circumstances(Authority.OURS))
        assert branch.to is None  # it is asked again as long as it lies there
        assert [(a.kind, a.force) for a in branch.actions] == [(ActionKind.DISARM, True)]
        flown = taken(state, E.TIPPED_OVER, Circumstances(Authority.PILOT))
        assert flown.to is S.ABORT
        assert not flown.actions


def test_what_should_not_happen_returns_control_to_the_autopilot() -> None:
    for pair in (
        (S.CONNECT, E.CONTACT),
        (S.TAKE_OFF, E.LOW),
        (S.APPROACH, E.ARMED),
        (S.WAIT, E.AIRBORNE),
        (S.HOLD, E.PAD_SEEN),
        (S.DESCEND, E.ONWARD),
    ):
        assert impossible(*pair)
        branch = taken(*pair)
        assert branch.to is S.HOLD
        assert kinds(branch) == [ActionKind.HOLD]
        assert branch.authority is Authority.RELEASED


def test_the_page_with_the_diagram_is_the_tables() -> None:
    page = state_machine.PAGE.read_text(encoding="utf-8")
    assert page == state_machine.page_text(), "run: python -m docs.state_machine"
    picture = state_machine.PICTURE.read_text(encoding="utf-8")
    assert picture == state_machine.picture(), "run: python -m docs.state_machine"


def test_the_diagram_shows_every_change_of_state_but_the_failsafes_from_each() -> None:
    drawn = set("\n".join(state_machine.diagram()).splitlines())
    for row in ROWS:
        for state, branch in product(row.states, row.branches):
            if branch.to is not None and row.event not in state_machine.FAILSAFES:
                arrow = f"    {state.value} --> {branch.to.value}: "
                assert any(row.event.replace("_", " ") in line for line in drawn if line.startswith(arrow))


def test_a_state_is_a_part_of_a_phase() -> None:
    assert {state.phase for state in State} == set(Phase)
    assert {state for state in State if state.phase is Phase.TOUCHDOWN} == TOUCHDOWN


# ---------------- The mission's table, walked: what flights go through in which order


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
        *(E.STOP, E.SUSPENDED, E.OVERTIME, E.ESTIMATE_LOST, E.ESTIMATE_DISPUTED, E.CONTROL_FAILED),
        *(E.VELOCITY_UNCERTAIN, E.OUT_OF_BOUNDS, E.PAD_DISPUTED, E.PAD_TOO_FAST),
    ],
)
@pytest.mark.parametrize("state", sorted(IN_AIR - COMMITTED))
def test_stop_overtime_and_a_lost_estimate_return_control_holding(state: State, event: MissionEvent) -> None:
    if TABLE[state, event]:
        if not (state in OVER_PAD_OR_DESCENDING and event in CLIMBS_CLEAR):
            assert taken(state, event).to is S.ABORT
            assert kinds(taken(state, event)) == [ActionKind.HOLD]
        # one that stands would lift off to hold a position
        assert kinds(taken(state, event, Circumstances(Authority.OURS, on_surface=True))) == [ActionKind.LAND]


def test_stopped_on_the_ground_it_disarms_or_does_nothing() -> None:
    for event in (E.STOP, E.SUSPENDED):
        assert taken(S.CONNECT, event).actions == ()
        assert kinds(taken(S.ARM, event)) == [ActionKind.DISARM]


def test_a_search_begins_anew_where_its_pilot_has_flown_until_control_is_granted() -> None:
    flown = Circumstances(Authority.PILOT)
    assert taken(S.SEARCH, E.CONTROL_GRANTED, flown).effects == (Effect.SEARCH_FROM_HERE,)
    assert taken(S.SEARCH, E.CONTROL_GRANTED, Circumstances(Authority.NONE)).effects == ()


def test_what_is_graver_acts_first_and_what_is_as_grave_in_the_order_in_which_it_was_found() -> None:
    found = [(event, "") for event in reversed(ANYWHERE)]
    assert [event for event, _ in by_severity(found)] == list(ANYWHERE)
    twice = [(E.TIMEOUT, "a"), (E.TAKEN_OVER, "b"), (E.TAKEN_OVER, "c"), (E.CONTROL_GRANTED, "d")]
    assert [reason for _, reason in by_severity(twice)] == ["d", "b", "c", "a"]


def test_a_low_battery_changes_no_state_and_begins_no_new_try() -> None:
    for state in LIVE - {S.STANDBY, S.CONNECT}:
        assert taken(state, E.BATTERY_LOW) == Branch(None, effects=(Effect.NO_NEW_TRY,))


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
