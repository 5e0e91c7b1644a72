"""The planner in a closed loop: whole missions, and what can befall them."""

import math

import numpy as np
import pytest

from companion.base.geometry import Vector3, ned_from_geodetic
from companion.base.messages import Action, ActionKind, ActionResult, Phase, PlanStep, RangeSample
from companion.config import LandingConfig, MissionConfig, PlanConfig
from tests.unit.plan.plan_harness import (
    HOME,
    LEG_M,
    ORIGIN_NED_M,
    FakeAutopilot,
    Flight,
    Path,
    World,
    circle,
    figure_eight,
    heave,
    line,
    still,
)

PADS: dict[str, Path] = {
    "still": still(),
    "line": line(),
    "circle": circle(),
    "figure eight": figure_eight(),
    "heave": heave(),
}
GOOD = [
    Phase.CONNECT,
    Phase.ARM,
    Phase.TAKE_OFF,
    Phase.WAYPOINT,
    Phase.SEARCH,
    Phase.APPROACH,
    Phase.DESCEND,
    Phase.TOUCHDOWN,
    Phase.LANDED,
]


def breeze(t: float) -> Vector3:
    """Gusts as a disturbance of acceleration (m/s²), after what a controller already takes out."""
    return (
        0.12 * math.sin(1.3 * t + 0.4) + 0.1 * math.sin(3.1 * t),
        0.12 * math.sin(1.1 * t + 2.0),
        0.1 * math.sin(2.0 * t + 1.0),
    )


def world(pad: Path | None = None, config: PlanConfig | None = None) -> World:
    w = World(pad or circle(), config=config)
    w.beacon_after_s = 0.5
    return w


def continuous(flight: Flight) -> tuple[float, float, float]:
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


# ---------------------------------------------------------------- the good flight


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
    w.autopilot = FakeAutopilot(autopilot_kind="ardupilot", mode="STABILIZE")
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

    def each(_: World, step: PlanStep) -> None:
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
    w = World(still(), heading=lambda _t: math.radians(heading_deg))
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


def test_an_autopilot_that_never_finds_itself_landed_is_disarmed_by_force_and_never_told_to_land() -> None:
    w = world(heave())
    flight = w.fly(60.0, until=lambda x: x.flight.told("commit") != [])
    w.autopilot.doubts = True
    w.fly(30.0)
    assert flight.phase is Phase.LANDED
    contact = next(s.time_s for s in flight.steps if s.on_ground)
    last = {a.kind: (s.time_s, a.force) for s in flight.steps for a in s.actions}
    assert ActionKind.LAND not in last  # PX4's brakes against a pad that moves, and tips over
    assert last[ActionKind.DISARM][0] - contact == pytest.approx(2.0, abs=0.1)
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


# ---------------------------------------------------------------- trouble on the way


def test_a_pad_that_is_not_at_the_waypoint_is_found_by_its_beacon() -> None:
    w = world(line(0.8, -25.0))
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    first = flight.told("pad_lost")[0]
    assert first.startswith("pad not seen: holding")
    assert first.endswith("new position requested")
    assert any("by its beacon" in text for text in flight.told("pad_lost"))


def test_a_beacon_outside_the_fence_is_ignored_and_announced() -> None:
    w = world(still(0.0, 200.0))
    flight = w.fly(60.0)
    assert flight.told("fence") == ["pad beacon 200 m from home, outside the fence of 150 m: ignored"]
    assert w.position[1] < 20.0  # by the beacon it would be at 48 m


def test_without_a_home_position_the_fence_is_closed() -> None:
    w = world(still(0.0, 200.0))
    w.home = lambda _t: HOME if w.autopilot.mode != "OFFBOARD" else None  # known until the search
    flight = w.fly(60.0)
    assert flight.told("fence") == []
    assert w.position[1] < 20.0  # by the beacon it would be at 48 m


def test_a_pad_without_a_beacon_is_found_by_the_spiral() -> None:
    w = World(still(6.0, 6.0))
    flight = w.fly(150.0)
    assert flight.phase is Phase.LANDED


def test_a_pad_that_is_nowhere_ends_the_mission_holding() -> None:
    w = World(still(300.0, 300.0))
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


@pytest.mark.parametrize("lie_m", [1.5, 4.0])
def test_echoes_that_contradict_the_pads_height_break_the_landing_off(lie_m: float) -> None:
    # GIVEN a pad that is seen, but believed to lie far lower than it does, until the first alarm
    w = world(still())
    w.lie_m = lambda t: lie_m if t > 12.0 and not w.flight.told("climb") else 0.0
    lowest_m = 9.0

    def each(x: World, _: PlanStep) -> None:
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


def test_an_autopilot_that_arms_only_after_half_a_minute_is_waited_for() -> None:
    w = world()
    w.autopilot.refuse = {ActionKind.ARM: 15}
    assert w.fly(180.0).phase is Phase.LANDED


def test_an_autopilot_whose_filter_does_not_know_where_it_is_is_not_asked_to_arm() -> None:
    w = world()
    w.autopilot.ekf_ready_from_s = 30.0
    flight = w.fly(60.0)
    assert min(t for t, kind in w.autopilot.heard if kind is ActionKind.ARM) > 30.0
    assert "waiting for its estimate of position" in flight.told("waiting")


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


def test_an_autopilot_that_is_not_ready_is_not_asked_and_what_is_missing_is_told() -> None:
    w = world()
    w.autopilot.ready_from_s = 1e9
    flight = w.fly(120.0)
    assert flight.phase is Phase.ABORT
    assert w.autopilot.heard == []
    assert flight.told("waiting")[-1] == "waiting for it to be ready to arm"
    assert len(flight.told("waiting")) <= 10


def test_a_refused_waypoint_does_not_end_the_mission() -> None:
    w = world(still(2.0, 1.0))
    w.autopilot.refuse = {ActionKind.GO_TO: 99}
    assert w.fly(120.0).phase is Phase.LANDED


@pytest.mark.parametrize("at_s", [8.0, 12.0, 20.0, 24.0, 26.5])
def test_a_pilot_who_takes_over_keeps_the_vehicle(at_s: float) -> None:
    w = world()

    def pilot(x: World, _: PlanStep) -> None:
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


def test_without_our_own_estimate_the_autopilot_gets_the_vehicle() -> None:
    w = world()
    w.each = lambda x, _s: setattr(x, "vehicle_known", x.now_s < 20.0)
    w.fly(25.0, until=lambda _w: False)
    assert w.flight.phase is Phase.ABORT
    assert w.autopilot.mode == "LOITER"
    assert w.flight.steps[-1].reference is None


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


def test_every_change_of_phase_is_told() -> None:
    flight = world().fly(90.0)
    told = [text.split(":")[0].replace(" ", "_") for text in flight.told("phase")]
    assert told == [phase.value for _, phase in flight.phases[1:]]
