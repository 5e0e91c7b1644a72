"""Motors that stop are a landing only where the vehicle stands upright on the pad."""

import math
from dataclasses import replace

import pytest

from companion.base.geometry import IDENTITY, Vector3, quat_from_euler
from companion.base.messages import LandedState, PadState, Phase
from companion.plan.events import MissionEvent
from companion.plan.inputs import PlanInputs
from companion.plan.landing.contact import not_standing
from companion.plan.mission.states import State
from companion.plan.mission.table import TABLE
from tests.unit.plan.landing.touchdown_attempt import CYCLE_S, sinking
from tests.unit.plan.landing.touchdown_attempt import sight as seen_over
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import line, still
from tests.unit.plan.plan_harness import LEG_M, VEHICLE, PlanWorld

REACH_M = 0.7
ZERO = (0.0, 0.0, 0.0)


def standing() -> PlanInputs:
    w = PlanWorld(still())
    w.now_s = 50.0
    return w.inputs()


def sight(
    aside_m: float = 0.1, below_m: float = VEHICLE.leg_height_m, age_s: float = 0.1, std_m: float = 0.01
) -> PadState:
    """As the feet met it, up to a time before the verdict."""
    variances = tuple(tuple(std_m**2 * (row == column) for column in range(6)) for row in range(6))
    return PadState(
        50.0, (aside_m, 0.0, below_m), ZERO, ZERO, ZERO, 0.0, 0.0, 0.1, 0.1,
        seen_time_s=50.0 - age_s, covariance=variances,
    )  # fmt: skip


def judged(
    inputs: PlanInputs, pad: PadState | None, *, surface_m: float | None = None, touched: bool = True
) -> str:
    return not_standing(pad, inputs, VEHICLE, REACH_M, 50.0, surface_m=surface_m, touched=touched)


def tilted(inputs: PlanInputs, ours_deg: float, theirs_deg: float) -> PlanInputs:
    assert inputs.vehicle is not None
    theirs = quat_from_euler(math.radians(theirs_deg), 0.0, 1.0)
    return replace(
        inputs,
        vehicle=replace(inputs.vehicle, attitude=quat_from_euler(0.0, math.radians(ours_deg), 2.0)),
        autopilot=replace(inputs.autopilot, attitude=theirs, attitude_time_s=49.9),
    )


def test_upright_on_the_pad_it_has_landed() -> None:
    assert judged(standing(), sight()) == ""
    assert judged(tilted(standing(), 12.0, 12.0), sight()) == ""  # on a deck that swings
    assert judged(standing(), sight(age_s=5.0)) == ""  # the pad is not seen from so near


@pytest.mark.parametrize(("ours_deg", "theirs_deg"), [(40.0, 40.0), (0.0, 90.0), (170.0, 0.0)])
def test_toppled_it_has_not_by_whichever_attitude(ours_deg: float, theirs_deg: float) -> None:
    assert f"tilted by {max(ours_deg, theirs_deg):.0f} deg" in judged(
        tilted(standing(), ours_deg, theirs_deg), sight()
    )


def test_without_any_attitude_it_is_not_known_to_have() -> None:
    inputs = standing()
    unknown = replace(inputs, vehicle=None, autopilot=replace(inputs.autopilot, attitude=None))
    assert judged(unknown, sight()) == "attitude unknown"
    old = replace(unknown, autopilot=replace(inputs.autopilot, attitude=IDENTITY, attitude_time_s=40.0))
    assert judged(old, sight()) == "attitude unknown"


def test_beside_the_pad_or_above_it_it_has_not() -> None:
    assert judged(standing(), sight(aside_m=0.9)) == "0.9 m beside the pad's centre"
    assert judged(standing(), sight(below_m=1.4)) == "the pad is 1.4 m below"
    assert judged(standing(), sight(below_m=-1.4)) == "the pad is 1.4 m above"
    assert judged(standing(), sight(age_s=5.0), surface_m=1.4) == "surface 1.4 m below"
    assert judged(standing(), sight(), surface_m=1.4) == ""  # the pad is seen at the feet


@pytest.mark.parametrize(
    ("unseen", "why"),
    [
        pytest.param(sight(age_s=2.0, std_m=0.3), "", id="rather at the feet"),
        pytest.param(
            sight(age_s=4.0, std_m=0.6), "0.9 m beside the pad's centre, unseen for 4.0 s", id="may be"
        ),
        pytest.param(sight(0.9, age_s=1.5), "0.9 m beside the pad's centre, unseen for 1.5 s", id="drove on"),
        pytest.param(sight(below_m=-1.4, age_s=2.0, std_m=0.45), "", id="its height is not known so well"),
        pytest.param(None, "the pad was out of view for too long", id="long"),
    ],
)
def test_a_pad_that_the_feet_met_unseen_is_where_its_track_has_it_by_what_that_knows(
    unseen: PadState | None, why: str
) -> None:
    assert judged(standing(), unseen) == why


def test_where_nothing_has_shown_the_feet_down_it_has_not() -> None:
    up = standing()
    up = replace(up, autopilot=replace(up.autopilot, landed=LandedState.IN_AIR))
    assert judged(up, sight(), touched=False) == "contact never confirmed"
    down = replace(up, autopilot=replace(up.autopilot, landed=LandedState.ON_GROUND))
    assert judged(down, sight(), touched=False) == ""


@pytest.mark.parametrize("echoes", [True, False])
def test_without_its_imu_the_feet_met_the_pad_where_it_was_as_their_echoes_became_short(echoes: bool) -> None:
    """What nothing feels is soon anywhere by its prediction: also a vehicle that has stood for a second."""
    touchdown = sinking()
    for k in range(45):
        std_m = 0.1 + 0.1 * k
        variances = tuple(tuple(std_m**2 * (row == column) for column in range(6)) for row in range(6))
        over_m = max(0.0, 0.03 - 0.2 * k * CYCLE_S)
        unfelt = replace(seen_over(height=LEG_M + over_m, age=0.3 + k * CYCLE_S), covariance=variances)
        echo_m = LEG_M + over_m - 0.08 if echoes else None
        if not touchdown.on_pad:
            touchdown.cycles([unfelt], echo_m=echo_m, imu_age_s=0.4 + k * CYCLE_S)
    met = touchdown.met
    assert met is not None
    assert (judged(standing(), met) == "") == echoes


@pytest.mark.parametrize("state", [State.STAND, State.SET_DOWN, State.AUTO_LAND])
def test_the_table_ends_in_abort_there(state: State) -> None:
    branches = TABLE[state, MissionEvent.DISARMED]
    assert (branches[0].to, branches[0].actions) == (State.ABORT, ())


@pytest.mark.parametrize(
    ("surface_m", "leaves_at_m_s", "end"),
    [
        pytest.param(0.0, 0.0, "landed: disarmed", id="still"),
        pytest.param(3.0, 12.0, "no landing: the pad is 3.1 m above", id="on a truck that drives off"),
    ],
)
def test_a_pad_that_is_unseen_to_the_end_is_stood_on_where_its_track_has_it_at_the_contact(
    surface_m: float, leaves_at_m_s: float, end: str
) -> None:
    # GIVEN no echo, and a camera that sees nothing from 13 cm over the pad on
    at_rest, gone_s = still(), [math.inf]

    def pad(t: float) -> Vector3:
        north, east, down = at_rest(t)
        return north + leaves_at_m_s * max(0.0, t - gone_s[0]), east, down - surface_m

    w = world(pad)
    w.range_lost = True
    w.fly(60.0, until=lambda w: bool(w.flight.told("commit")) and w.flight.heights_m[-1] < LEG_M + 0.13)
    w.blind, gone_s[0] = lambda _t, _height: True, w.now_s
    # WHEN the vehicle stands with its motors off THEN that is a landing on the pad, or told not to be one
    w.fly(40.0)
    assert not w.autopilot.armed
    assert end in w.flight.told("phase")[-1]


@pytest.mark.parametrize("stops", [False, True])
def test_feet_that_meet_a_pad_unseen_are_not_said_to_be_on_it(stops: bool) -> None:
    # GIVEN a pad that may stop as the camera is covered in the final descent: it is on its track or beside it
    covered_s = [math.inf]

    def pad(t: float) -> Vector3:
        return 10.0, -15.0 + (min(t, covered_s[0]) if stops else t), -0.3

    w = world(pad)
    w.fly(60.0, until=lambda w: bool(w.flight.told("commit")) and w.flight.heights_m[-1] < LEG_M + 0.13)
    w.blind, covered_s[0] = lambda _t, _height: True, w.now_s
    w.fly(40.0)
    # THEN it has landed, and nobody can tell where
    assert (w.flight.phase, w.flight.touch_lateral_m > 0.6) == (Phase.LANDED, stops)
    assert w.flight.told("contact")[-1].startswith("down: ")
    doubt = "landed: disarmed: motors off, not shown to be on the pad, unseen for 0."
    assert w.flight.told("phase")[-1].startswith(doubt)


def test_feet_that_meet_a_pad_in_view_are_said_to_be_on_it() -> None:
    w = world(line())
    w.fly(90.0)
    assert w.flight.told("contact")[-1].startswith("on the pad: ")
    assert w.flight.told("phase")[-1] == "landed: disarmed: motors off"


def test_a_vehicle_that_topples_as_it_stands_is_no_landing_and_the_reason_is_said() -> None:
    w = world(still())
    w.autopilot.doubts = True
    w.fly(60.0, until=lambda w: bool(w.flight.told("contact")))
    w.tilt_rad = math.radians(80.0)
    w.autopilot.armed = False
    w.cycle()
    assert w.flight.phase is Phase.ABORT
    assert w.flight.told("phase")[-1] == "abort: disarmed: motors off, no landing: tilted by 80 deg"
