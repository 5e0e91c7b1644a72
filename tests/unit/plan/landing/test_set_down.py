"""The set-down under the autopilot's own LAND, and what an earlier stand leaves behind."""

from dataclasses import replace

from companion.base.messages import AutopilotState, LandedState, RangeSample
from companion.plan.events import MissionEvent
from companion.plan.inputs import PlanInputs
from companion.plan.landing.relative_state import PadTrack
from companion.plan.mission.states import Authority, Circumstances, State
from companion.plan.mission.table import follows
from companion.plan.steering import enter_touchdown, touch_down
from tests.unit.control.controller_inputs import vehicle_state
from tests.unit.plan.landing.touchdown_attempt import CYCLE_S, sight, sinking
from tests.unit.plan.plan_harness import LEG_M

LANDING = AutopilotState(0.0, connected=True, armed=True, offboard=False, landed=LandedState.LANDING)


def test_under_the_autopilots_land_the_contact_is_felt() -> None:
    """Feet down, the pad seen at the feet, short echoes: nothing sinks any more."""
    sequence, now_s = sinking()._sequence, 10.0
    enter_touchdown(sequence, State.SET_DOWN, None, vehicle_state(now_s), now_s)
    found = None
    for _ in range(60):
        now_s += CYCLE_S
        inputs = PlanInputs(vehicle_state(now_s), None, LANDING, range=RangeSample(now_s, 0.1))
        found = found or touch_down(sequence, State.SET_DOWN, sight(height=LEG_M), inputs, now_s)
    assert found is not None
    assert found[0] is MissionEvent.CONTACT


def test_set_down_out_of_view_the_pad_stays_where_the_feet_met_it() -> None:
    """While the autopilot takes its time to find a landing, no prediction takes it away."""
    sequence, now_s = sinking()._sequence, 10.0
    enter_touchdown(sequence, State.SET_DOWN, None, vehicle_state(now_s), now_s)
    touched_std_m = 0.0
    for k in range(90):
        now_s, std_m = now_s + CYCLE_S, 0.1 + 0.03 * k
        variances = tuple(tuple(std_m**2 * (row == column) for column in range(6)) for row in range(6))
        unseen = replace(sight(height=LEG_M, age=1.5 + k * CYCLE_S), covariance=variances)
        inputs = PlanInputs(vehicle_state(now_s), None, LANDING, range=RangeSample(now_s, 0.1))
        touch_down(sequence, State.SET_DOWN, unseen, inputs, now_s)
        touched_std_m = touched_std_m or (std_m if sequence.contact.touching else 0.0)
    assert touched_std_m > 0.0
    assert sequence.met is not None
    assert sequence.met.lateral_std_m() <= touched_std_m < 0.5 * std_m


def test_what_an_earlier_try_stood_does_not_cut_the_motors_of_a_later_one() -> None:
    sequence, now_s = sinking()._sequence, 10.0
    inputs = PlanInputs(vehicle_state(now_s), None, LANDING, range=RangeSample(now_s, 0.1))
    enter_touchdown(sequence, State.STAND, None, vehicle_state(now_s), now_s)
    for k in range(20):  # beyond its first moments, in which it may still slide
        at_s = now_s + k * CYCLE_S
        resting = replace(inputs, vehicle=vehicle_state(at_s), range=RangeSample(at_s, 0.1))
        touch_down(sequence, State.STAND, sight(height=LEG_M), resting, at_s)
    later_s = now_s + 20.0
    enter_touchdown(sequence, State.SET_DOWN, None, vehicle_state(later_s), later_s)
    landing = replace(inputs, vehicle=vehicle_state(later_s), range=RangeSample(later_s, 0.1))
    assert touch_down(sequence, State.AUTO_LAND, sight(height=LEG_M), landing, later_s) is None


def test_with_a_rival_low_over_the_pad_nothing_rises_in_the_mode_that_obeys_it() -> None:
    branch = follows(State.WAIT, MissionEvent.RIVAL, Circumstances(Authority.OURS, near=True))
    assert branch is not None
    assert [action.height_m for action in branch.actions] == [0.0]


def test_a_pad_whose_sightings_come_late_is_not_fresh() -> None:
    pad = PadTrack(5)
    for k in range(10):
        now_s = 50.0 + k * CYCLE_S
        late = replace(sight(), time_s=now_s, seen_time_s=now_s - 0.9)
        pad.update(late, None, now_s)
    assert pad.sight is not None
    assert pad.sight.unseen_s > 0.5


def test_what_a_set_down_took_for_contact_high_over_the_pad_is_no_rest() -> None:
    """However high it was when it began: echoes from there show no feet down."""
    sequence, now_s = sinking()._sequence, 10.0
    enter_touchdown(sequence, State.SET_DOWN, sight(height=LEG_M + 1.0), vehicle_state(now_s), now_s)
    found = []
    for k in range(60):
        at_s = now_s + k * CYCLE_S
        inputs = PlanInputs(vehicle_state(at_s), None, LANDING, range=RangeSample(at_s, 0.9))
        found.append(touch_down(sequence, State.AUTO_LAND, None, inputs, at_s))
    assert MissionEvent.AT_REST not in {event[0] for event in found if event is not None}


def test_a_cycle_without_an_estimate_makes_no_old_sighting_new() -> None:
    pad, now_s = PadTrack(5), 50.0
    for k in range(10):
        now_s = 50.0 + k * CYCLE_S
        pad.update(replace(sight(), time_s=now_s, seen_time_s=now_s - 0.15), vehicle_state(now_s), now_s)
    before = pad.sight
    assert before is not None
    pad.update(None, None, now_s + CYCLE_S)
    assert pad.steady(now_s + CYCLE_S)
    pad.update(replace(before, time_s=now_s + 2.0 * CYCLE_S), None, now_s + 2.0 * CYCLE_S)
    again = pad.sight
    assert again is not None
    assert again.delay_s == before.delay_s
    assert pad.steady(now_s + 2.0 * CYCLE_S)
