import pytest

from companion.base.messages import ActionKind, Phase
from companion.plan.mission.table import FINAL, TRANSITIONS, Event, transition

UNENDING = [phase for phase in Phase if phase not in FINAL]
AIRBORNE = [p for p in UNENDING if p not in {Phase.CONNECT, Phase.ARM}]


def test_every_pair_of_phase_and_event_is_defined() -> None:
    assert set(TRANSITIONS) == {(phase, event) for phase in Phase for event in Event}


def test_a_good_flight_goes_through_in_order() -> None:
    events = ["READY", "ARMED", "AIRBORNE", "ARRIVED", "PAD_SEEN", "CENTRED", "LOW", "CONTACT", "DISARMED"]
    phase, passed = Phase.CONNECT, []
    for name in events:
        step = transition(phase, Event[name])
        assert step.legal
        phase = step.phase
        passed.append(phase.value)
    assert passed == [
        "arm", "take_off", "waypoint", "search", "approach", "descend", "touchdown", "touchdown", "landed",
    ]  # fmt: skip


@pytest.mark.parametrize("phase", UNENDING)
def test_every_phase_ends_by_time(phase: Phase) -> None:
    # following TIMEOUT alone, at most six times, the mission is over; OVERTIME ends it at once
    step, now = transition(phase, Event.TIMEOUT), phase
    assert step.legal
    assert transition(phase, Event.OVERTIME).phase is Phase.ABORT
    for _ in range(3):
        assert step.phase is not now
        if step.phase in FINAL:
            return
        now, step = step.phase, transition(step.phase, Event.TIMEOUT)
    pytest.fail(f"{phase} does not end by time")


@pytest.mark.parametrize("phase", sorted(FINAL))
@pytest.mark.parametrize("event", list(Event))
def test_what_has_ended_stays_ended_and_asks_nothing(phase: Phase, event: Event) -> None:
    step = transition(phase, event)
    assert step.phase is phase
    assert step.actions == ()


@pytest.mark.parametrize("phase", UNENDING)
def test_a_pilot_who_takes_over_is_let_go_without_a_word(phase: Phase) -> None:
    step = transition(phase, Event.PILOT_TOOK_OVER)
    assert step.phase is Phase.ABORT
    assert step.actions == ()


@pytest.mark.parametrize("phase", AIRBORNE)
@pytest.mark.parametrize("event", [Event.STOP, Event.OVERTIME, Event.ESTIMATE_LOST])
def test_stop_overtime_and_a_lost_estimate_hand_the_vehicle_back_holding(phase: Phase, event: Event) -> None:
    step = transition(phase, event)
    assert step.phase is Phase.ABORT
    assert step.actions == (ActionKind.HOLD,)


def test_stopped_on_the_ground_it_disarms_or_does_nothing() -> None:
    assert transition(Phase.CONNECT, Event.STOP).actions == ()
    assert transition(Phase.ARM, Event.STOP).actions == (ActionKind.DISARM,)


def test_what_should_not_happen_ends_in_a_safe_hold() -> None:
    illegal = [(pair, step) for pair, step in TRANSITIONS.items() if not step.legal]
    assert illegal
    for _, step in illegal:
        assert step.phase is Phase.HOLD
        assert step.actions == (ActionKind.HOLD,)
    for pair in (
        (Phase.CONNECT, Event.CONTACT),
        (Phase.TAKE_OFF, Event.LOW),
        (Phase.APPROACH, Event.ARMED),
        (Phase.TOUCHDOWN, Event.AIRBORNE),
        (Phase.HOLD, Event.PAD_SEEN),
    ):
        assert not transition(*pair).legal


@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.DESCEND])
def test_losing_the_pad_asks_for_a_new_position(phase: Phase) -> None:
    step = transition(phase, Event.PAD_LOST)
    assert step.phase is Phase.SEARCH
    assert step.actions == (ActionKind.REQUEST_PAD_POSITION,)


def test_a_missed_touchdown_goes_round_again_and_the_last_one_holds() -> None:
    assert transition(Phase.TOUCHDOWN, Event.MISALIGNED).phase is Phase.APPROACH
    assert transition(Phase.TOUCHDOWN, Event.OUT_OF_TRIES).phase is Phase.HOLD


def test_nothing_but_connecting_arms_and_nothing_but_arming_takes_off() -> None:
    for (phase, _), step in TRANSITIONS.items():
        if ActionKind.ARM in step.actions:
            assert phase is Phase.CONNECT
        if ActionKind.TAKE_OFF in step.actions:
            assert phase is Phase.ARM


def test_what_the_autopilot_cannot_fly_straight_to_and_further_waypoints_are_flown_by_us() -> None:
    assert transition(Phase.TAKE_OFF, Event.BLOCKED).phase is Phase.ROUTE
    assert transition(Phase.TAKE_OFF, Event.BLOCKED).actions == ()
    assert transition(Phase.WAYPOINT, Event.ONWARD).phase is Phase.ROUTE
    for event in (Event.ARRIVED, Event.PAD_SEEN, Event.TIMEOUT):
        assert transition(Phase.ROUTE, event).phase is Phase.SEARCH
    assert transition(Phase.ROUTE, Event.REFUSED).actions == (ActionKind.HOLD,)
    assert not transition(Phase.DESCEND, Event.ONWARD).legal
