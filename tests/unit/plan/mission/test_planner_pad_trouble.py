"""The planner in a closed loop: the pad is away, unseen, contradicted or missed."""

import math

import numpy as np
import pytest

from companion.base.geometry import Vector3
from companion.base.messages import Phase, PlanStep, RangeSample
from companion.config import LandingConfig, PlanConfig
from companion.plan.planner import Planner
from tests.unit.plan.mission.planner_world import GOOD, world
from tests.unit.plan.pad_paths import circle, line, still
from tests.unit.plan.plan_autopilot import HOME
from tests.unit.plan.plan_harness import LEG_M, TABLE, VEHICLE, PlanWorld


def test_a_pad_that_is_not_at_the_waypoint_is_found_by_its_beacon() -> None:
    w = world(line(0.8, -25.0))
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    first = flight.told("pad_lost")[0]
    assert first.startswith("pad lost: holding")
    assert first.endswith("position requested")
    assert any("by its beacon" in text for text in flight.told("pad_lost"))


def test_a_beacon_outside_the_fence_is_ignored_and_announced() -> None:
    w = world(still(0.0, 200.0))
    flight = w.fly(60.0)
    assert flight.told("fence") == ["pad beacon ignored: 200 m from home, fence 150 m"]
    assert w.position[1] < 20.0  # by the beacon it would be at 48 m


def test_without_a_home_position_the_fence_is_closed() -> None:
    w = world(still(0.0, 200.0))
    w.home = lambda _t: HOME if w.autopilot.mode != "OFFBOARD" else None  # known until the search
    flight = w.fly(60.0)
    assert flight.told("fence") == []
    assert w.position[1] < 20.0  # by the beacon it would be at 48 m


def test_a_pad_without_a_beacon_is_found_by_the_spiral() -> None:
    w = PlanWorld(still(6.0, 6.0))
    flight = w.fly(150.0)
    assert flight.phase is Phase.LANDED


def test_a_pad_that_is_nowhere_ends_the_mission_holding() -> None:
    w = PlanWorld(still(300.0, 300.0))
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


def test_a_pad_that_gets_away_below_it_is_followed_upward_and_that_is_said_once() -> None:
    w = world(still())
    w.fly(60.0, until=lambda x: x.flight.phases != [] and x.flight.phase is Phase.DESCEND)
    w.fly(20.0, until=lambda x: -x.position[2] < 1.4)
    assert w.flight.told("climb") == []
    begin_s, (north, east, down) = w.now_s, w.pad(w.now_s)
    w.pad = lambda t: (north, east + 1.5 * min(max(0.0, t - begin_s), 2.0), down)
    w.fly(2.0)
    told = w.flight.told("climb")
    assert len(told) == 1
    assert "to keep the pad in view" in told[0]
    assert w.fly(60.0).phase is Phase.LANDED


@pytest.mark.parametrize("lie_m", [1.5, 4.0])
def test_echoes_that_contradict_the_pads_height_break_the_landing_off(lie_m: float) -> None:
    # GIVEN a pad that is seen, but believed to lie far lower than it does, until the first alarm
    w = world(still())
    w.lie_m = lambda t: lie_m if t > 12.0 and not w.flight.told("climb") else 0.0
    lowest_m = 9.0

    def each(x: PlanWorld, _: PlanStep) -> None:
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


@pytest.mark.parametrize("for_s", [60.0, 0.5])
def test_a_pad_that_echoes_contradict_is_not_flown_to_in_a_pause_between_them(for_s: float) -> None:
    # GIVEN something that swings 0.5 m before the ultrasonic from the descent on (what stays there is a stuck
    # sensor), and a pause after every third echo
    w = world(still())
    w.fly(60.0, until=lambda x: x.flight.phase is Phase.DESCEND)
    number, echo, begun_s = 0, w._echo, w.now_s

    def other() -> RangeSample | None:
        nonlocal number
        number += 1
        if w.now_s - begun_s > for_s:
            return echo()
        swings_m = 0.5 + 0.12 * math.sin(5.0 * w.now_s)
        return RangeSample(w.now_s, swings_m) if number // 6 % 2 else None

    w._echo = other  # type: ignore[method-assign]
    w.fly(10.0, until=lambda x: x.flight.phase is Phase.SEARCH)
    height_m = w.flight.heights_m[-1]
    flight = w.fly(4.0, until=lambda _w: False)
    # THEN it climbs as it says, and does not come back before the echoes agree with the pad
    assert "climbing" in flight.told("climb")[0]
    assert max(flight.heights_m) > height_m + 1.5
    if for_s > 10.0:
        flight = w.fly(6.0, until=lambda _w: False)
        assert flight.phase is Phase.SEARCH
    else:
        assert w.fly(60.0).phase is Phase.LANDED
    assert len([text for text in flight.told("phase") if "ground near" in text]) == 1


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


@pytest.mark.parametrize("wrong_m", [0.08, -0.05])
def test_a_wrong_leg_height_cuts_no_thrust_before_the_feet_stand(wrong_m: float) -> None:
    w = world(line(1.0))
    told = VEHICLE.model_copy(update={"leg_height_m": LEG_M + wrong_m})
    w.planner = Planner(w.config, told, 20, 0.1, TABLE)
    w.fly(120.0, until=lambda w: any(step.on_ground for step in w.flight.steps[-1:]))
    assert w.flight.heights_m[-1] == pytest.approx(LEG_M, abs=0.005)
    assert w.fly(20.0).phase is Phase.LANDED
    assert w.flight.touch_down_m_s < 0.4


def test_a_pad_that_a_slow_vision_sees_in_every_frame_is_landed_on() -> None:
    w = world(line(1.0))
    w.frame_s, w.vision_s = 0.13, 0.17
    flight = w.fly(120.0)
    assert [phase for _, phase in flight.phases] == GOOD
    assert flight.touch_lateral_m < 0.1
    assert flight.touch_down_m_s < 0.4
