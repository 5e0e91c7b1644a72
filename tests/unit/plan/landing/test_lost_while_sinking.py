"""The pad gone in the last centimetres: up while there is room, else straight down; no old sign counts."""

import math
from dataclasses import replace

import pytest

from companion.base.geometry import Vector3
from companion.base.messages import ActionKind, PadState, Phase
from companion.plan.events import MissionEvent
from companion.plan.mission.states import State
from tests.unit.plan.landing.touchdown_attempt import CYCLE_S, sight, sinking
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import line, still
from tests.unit.plan.plan_harness import LEG_M, PlanWorld


def committed(w: PlanWorld) -> bool:
    return bool(w.flight.told("commit"))


def unseen_for(age_s: float, over_m: float, sink_m_s: float) -> PadState:
    """As the pad filter predicts a pad that rides no waves: ever less sure."""
    on_axis = *[(0.01 + 0.03 * age_s) ** 2] * 3, *[0.02**2] * 3
    covariance = tuple(tuple(on_axis[row] * (row == column) for column in range(6)) for row in range(6))
    predicted = sight(height=LEG_M + over_m, velocity=(0.0, 0.0, sink_m_s), age=age_s)
    return replace(predicted, covariance=covariance)


def sinking_to(w: PlanWorld, height_m: float) -> None:
    """Fly until the vehicle sinks and is so high over the pad."""
    w.fly(60.0, until=lambda w: committed(w) and w.flight.heights_m[-1] < height_m)
    assert committed(w)


@pytest.mark.parametrize("speed_m_s", [0.0, 1.0])
def test_a_pad_that_is_gone_by_the_echoes_is_left_upward_at_once(speed_m_s: float) -> None:
    w = world(line(speed_m_s) if speed_m_s else still())
    sinking_to(w, 0.40)
    w.blind = lambda _t, _height: True
    w.echo_m = 1.2
    gone_s, before = w.now_s, len(w.flight.heights_m)
    w.fly(8.0, until=lambda w: w.flight.phase is not Phase.TOUCHDOWN)
    assert w.now_s - gone_s < 1.0  # not the whole of blind_s
    w.fly(1.5, until=lambda _w: False)
    assert min(w.flight.heights_m[before:]) > LEG_M + 0.02
    assert w.velocity[2] < 0.1
    assert any("pad no longer below" in text for text in w.flight.told("phase"))


def test_one_far_echo_and_a_lost_one_after_it_are_no_pad_that_is_gone() -> None:
    """GIVEN ten echoes a second THEN the only far one is one sign, for as many cycles as it is the newest."""
    touchdown, unseen, far_m = sinking(), sight(height=LEG_M + 0.2, age=0.4), 1.0
    for k in range(6):
        assert touchdown.step(unseen, touchdown.now_s + CYCLE_S, echo_m=far_m, echo_age_s=k * CYCLE_S) is None
    # WHEN more of them come THEN it is left
    found = touchdown.cycles([unseen] * 8, echo_m=far_m)
    assert found[:1] == [MissionEvent.PAD_LOST]


def test_a_gust_that_holds_it_up_over_an_unseen_pad_is_no_contact_by_a_stuck_echo() -> None:
    """GIVEN a pad out of view from 25 cm up, and an echo that has said "standing" since
    WHEN a gust stops the sink 16 cm up THEN the thrust stays on."""
    touchdown, over_m = sinking(), 0.25
    for k in range(36):
        age_s = k * CYCLE_S
        sink_m_s = 0.2 if age_s < 0.5 or age_s > 0.8 else 0.0
        over_m -= sink_m_s * CYCLE_S
        touchdown.cycles([unseen_for(age_s, over_m, sink_m_s)], echo_m=LEG_M - 0.08, imu_age_s=0.0)
        assert touchdown.state is State.SINK
        assert touchdown.unloading == 0.0


@pytest.mark.parametrize(("blind_zone_m", "lifts"), [(0.22, False), (0.6, True)])
def test_an_echo_gives_no_room_where_the_pad_was_seen_to_be_at_the_feet(
    blind_zone_m: float, lifts: bool
) -> None:
    """GIVEN a rangefinder that shows 22 cm for all that is nearer, and a pad out of view from 20 cm up
    WHEN the vehicle stands THEN it is not lifted off, unless the echoes show that the pad is gone."""
    touchdown, found = sinking(), list[MissionEvent]()
    for k in range(50):
        over_m = max(0.0, 0.2 - 0.2 * k * CYCLE_S)
        unseen = unseen_for(k * CYCLE_S, over_m, 0.2 * (over_m > 0.0))
        if touchdown.state is State.SINK:
            found += touchdown.cycles([unseen], echo_m=max(blind_zone_m, LEG_M + over_m - 0.08))
    assert (found[:1] == [MissionEvent.PAD_LOST]) == lifts
    assert (touchdown.state is State.SET_DOWN) != lifts


def fall_away(w: PlanWorld) -> None:
    """Nothing is seen from now on, the pad drops from under the vehicle, and an echo says that it is near."""
    w.blind, driven = lambda _t, _height: True, w.pad

    def pad(t: float) -> Vector3:
        north, east, down = driven(t)
        return north, east, down + 5.0

    w.pad, w.echo_m = pad, 0.24 - 0.08


def test_unseen_for_too_long_with_no_room_to_rise_it_goes_straight_down_in_land() -> None:
    w = world(line(1.0))
    sinking_to(w, 0.30)
    fall_away(w)
    w.autopilot.refuse = {ActionKind.LAND: 1}
    w.fly(6.0, until=lambda w: bool(w.flight.told("set_down")))
    assert w.flight.told("set_down")
    # while LAND is refused our own setpoints bring it down, no more along with the pad
    references = [step.reference for step in w.flight.steps[-1:]]
    assert references[0] is not None
    assert references[0].origin == "local"
    x, y, z = references[0].velocity_m_s[-1]
    assert math.hypot(x, y) < 0.05
    assert 0.0 < z <= 0.5
    assert [kind for _, kind in w.autopilot.heard][-1] is ActionKind.LAND


def test_the_echo_of_the_ground_and_an_old_sighting_are_no_contact() -> None:
    w = world(still())
    sinking_to(w, 0.34)
    w.blind = lambda _t, _height: True
    w.lie_m = lambda _t: -0.2  # it believes the pad at its feet
    w.fly(0.6, until=lambda _w: False)
    assert not w.flight.told("contact")


def test_unseen_at_the_last_an_echo_that_agrees_brings_it_down_and_shows_the_contact() -> None:
    """LAND would brake over a pad that drives on, a few centimetres below."""
    w = world(line(1.0))
    sinking_to(w, 0.27)
    w.blind = lambda _t, _height: True
    w.fly(6.0, until=lambda w: bool(w.flight.told("contact") or w.flight.told("set_down")))
    assert w.flight.told("contact")
    assert not w.flight.told("set_down")


def hold_unheard(w: PlanWorld, silent_s: float) -> None:
    """The link is silent for so long; after a second PX4 holds where it is, and nothing is seen or echoes."""
    w.silent_from_s, w.autopilot.silent = w.now_s, {ActionKind.LAND, ActionKind.DISARM}
    w.fly(1.0, until=lambda _w: False)
    w.autopilot.mode, w.autopilot.target_ned_m = "LOITER", w.position
    w.blind, w.range_lost = lambda _t, _height: True, True
    w.fly(silent_s - 1.0, until=lambda _w: False)
    w.silent_from_s, w.autopilot.mode = math.inf, "OFFBOARD"


def fastest_m_s(w: PlanWorld, seconds: float) -> float:
    """How fast it comes down, at most."""
    speeds: list[float] = []
    w.each = lambda w, _step: speeds.append(w.velocity[2])
    w.fly(seconds, until=lambda _w: False)
    return max(speeds)


def test_a_set_down_that_was_not_obeyed_goes_on_from_where_the_vehicle_is() -> None:
    w = world(line(1.0))
    sinking_to(w, 0.30)
    fall_away(w)
    w.fly(6.0, until=lambda w: bool(w.flight.told("set_down")))
    w.pad = lambda _t: (900.0, 0.0, 0.0)  # it is gone, and the ground is far below
    w.position = (*w.position[:2], w.position[2] - 3.0)
    w.echo_m = 2.0
    hold_unheard(w, 4.0)
    assert fastest_m_s(w, 2.0) < 0.3


def test_a_set_down_that_lags_far_behind_does_not_catch_up() -> None:
    w = world(line(1.0))
    sinking_to(w, 0.30)
    fall_away(w)
    w.autopilot.silent = {ActionKind.LAND}
    w.fly(6.0, until=lambda w: bool(w.flight.told("set_down")))
    w.position = (*w.position[:2], w.position[2] - 3.0)  # a gust
    w.echo_m = 2.0
    assert fastest_m_s(w, 2.0) < 0.3


def test_a_vehicle_that_held_off_the_pad_unheard_is_not_pressed_down() -> None:
    w = world(line(1.0))
    sinking_to(w, 0.30)
    w.fly(6.0, until=lambda w: bool(w.flight.told("contact")))
    w.autopilot.doubts = True
    hold_unheard(w, 2.0)
    pressed: list[bool] = []
    w.each = lambda _w, step: pressed.append(step.on_ground)
    w.fly(1.0, until=lambda _w: False)
    assert not any(pressed)


def test_time_alone_cuts_no_thrust_where_nothing_shows_a_contact() -> None:
    # GIVEN a vehicle that goes straight down over a pad that drove off, its LAND refused ever again
    w = world(line(1.0))
    sinking_to(w, 0.30)
    fall_away(w)
    w.autopilot.refuse = {ActionKind.LAND: 10_000}
    w.fly(6.0, until=lambda w: bool(w.flight.told("set_down")))
    w.pad, w.range_lost = lambda _t: (900.0, 0.0, 0.0), True
    # WHEN the whole time of a touchdown is over before anything is below it
    w.position = (*w.position[:2], w.position[2] - 30.0)
    pressed: list[bool] = []
    w.each = lambda _w, step: pressed.append(step.on_ground)
    w.fly(60.0, until=lambda _w: False)
    # THEN it sinks on as slowly as before and asks again
    assert not any(pressed)
    assert w.flight.phase is Phase.TOUCHDOWN
    assert 0.1 < w.velocity[2] < 0.3
