"""When the final descent is broken off, and how it climbs then."""

import math
from dataclasses import replace

import pytest

from companion.base.geometry import quat_from_euler
from companion.base.messages import PadState
from companion.base.motion import Motion
from companion.plan.events import MissionEvent
from companion.plan.trajectory.course import Course
from companion.plan.trajectory.min_jerk import plan
from tests.unit.plan.landing.touchdown_attempt import (
    CONFIG,
    CYCLE_S,
    WAIT_M,
    fresh,
    sight,
    sinking,
    wait,
    waited,
)
from tests.unit.plan.plan_harness import LEG_M


@pytest.mark.parametrize(
    ("height", "sink_m_s", "broken"),
    [
        (LEG_M + 0.2, 0.5, True),
        (LEG_M + 0.2, 0.4, False),
        # it needs some 18 cm to stop from half a metre a second, foot and all
        (LEG_M + 0.17, 0.5, False),
        # so high up it will sink as is planned by the contact
        (LEG_M + 0.4, 0.5, False),
    ],
)
def test_sinking_too_fast_it_breaks_off_unless_it_is_down_already(
    height: float, sink_m_s: float, broken: bool
) -> None:
    touchdown = sinking()
    fast = sight(height=height, velocity=(0.0, 0.0, sink_m_s))
    for k in range(6):
        assert touchdown.step(fast, 1.0 + k * CYCLE_S) is None
        if not touchdown.committed:
            break
    assert touchdown.committed is not broken
    if broken:
        # and rises to where it waits, without a step, and may commit again
        before = touchdown._generator.at(1.2)
        touchdown.cycles([sight(height=height)] * 74)
        after = touchdown._generator.at(3.5)
        assert before.velocity_m_s[2] > 0.0
        assert after.position_m[2] == pytest.approx(-WAIT_M, abs=0.01)
        assert wait(touchdown, sight(), 9.0)[1] is None


def test_it_goes_on_down_after_a_gust_that_held_it_up_and_not_when_held_for_good() -> None:
    touchdown, height_m, found, now_s = sinking(), WAIT_M, None, 0.5
    # sinks to 12 cm over the pad, is held up, sinks a little, is held up again
    for sink_m_s, lasts_s in ((0.19, 1.1), (-0.02, 1.2), (0.15, 0.3), (-0.02, 1.2), (0.15, 0.2)):
        for _ in range(round(lasts_s / CYCLE_S)):
            now_s, height_m = now_s + CYCLE_S, height_m - sink_m_s * CYCLE_S
            seen = sight(height=height_m, velocity=(0.0, 0.0, sink_m_s))
            assert touchdown.step(seen, now_s) is None
            assert touchdown.committed
    held_s = now_s
    # swaying in the gusts it comes no lower: that puts nothing off
    while found is None and now_s < held_s + 5.0:
        now_s += CYCLE_S
        swing, rate = 0.02 * math.sin(6.0 * (now_s - held_s)), 0.12 * math.cos(6.0 * (now_s - held_s))
        seen = sight(height=height_m + 0.02 + swing, velocity=(0.0, 0.0, -rate))
        found = touchdown.step(seen, now_s)
    assert found == (MissionEvent.MISALIGNED, "no contact 1.5 s after the expected time")
    assert now_s - held_s == pytest.approx(CONFIG.overdue_s, abs=0.5)


def test_a_break_off_climbs_at_once() -> None:
    touchdown = sinking()
    now_s, low = 1.0, sight(0.15, LEG_M + 0.25, velocity=(0.0, 0.0, 0.19))
    while touchdown.committed:
        touchdown.step(low, now_s)
        now_s += CYCLE_S
    begun_s = now_s - CYCLE_S
    start = touchdown._generator.at(begun_s)
    lowest_m = start.position_m[2]
    while now_s < begun_s + 0.3:
        touchdown.step(low, now_s)
        lowest_m = max(lowest_m, touchdown._generator.at(now_s).position_m[2])
        now_s += CYCLE_S
    assert start.velocity_m_s[2] == pytest.approx(CONFIG.contact_speed_m_s, abs=0.02)
    assert lowest_m - start.position_m[2] < 0.03
    assert touchdown._generator.at(now_s).velocity_m_s[2] < -0.25
    # and comes to rest where it waits, not far over it
    highest_m = 0.0
    while now_s < begun_s + 3.0:
        touchdown.step(sight(0.1), now_s)
        highest_m = min(highest_m, touchdown._generator.at(now_s).position_m[2])
        now_s += CYCLE_S
    assert -highest_m < WAIT_M + 0.1
    assert touchdown._generator.at(now_s).position_m[2] == pytest.approx(-WAIT_M, abs=0.01)


@pytest.mark.parametrize(
    ("off", "good"),
    [
        pytest.param(*(sight(height=0.4, velocity=(0.0, 0.0, v)) for v in (0.5, 0.2)), id="a fast sample"),
        pytest.param(*(sight(aside, LEG_M + 0.2) for aside in (0.17, 0.05)), id="aside for a moment"),
    ],
)
def test_what_does_not_last_is_no_reason_to_break_off(off: PadState, good: PadState) -> None:
    touchdown = sinking()
    touchdown.cycles([off, good, good] * 3)
    assert touchdown.committed


@pytest.mark.parametrize(
    ("aside", "back_m_s", "height", "broken"),
    [
        (CONFIG.break_off_lateral_m, 0.0, LEG_M + 0.09, False),
        (CONFIG.break_off_lateral_m + 0.02, 0.0, LEG_M + 0.09, True),
        # one that is on its way is back by the contact, one that stays there is not
        (CONFIG.break_off_lateral_m + 0.02, 0.1, LEG_M + 0.2, False),
        (CONFIG.break_off_lateral_m + 0.02, 0.0, LEG_M + 0.2, True),
        (CONFIG.break_off_lateral_m + 0.02, 0.0, LEG_M + CONFIG.break_off_above_m - 0.01, False),
    ],
)
def test_aside_on_the_final_descent_it_waits_again_over_the_pad(
    aside: float, back_m_s: float, height: float, broken: bool
) -> None:
    touchdown = sinking()
    assert touchdown.cycles([sight(aside, height, velocity=(-back_m_s, 0.0, 0.0))] * 6) == []
    assert touchdown.committed is not broken
    assert ("lateral offset" in touchdown.broken_off_by) is broken


@pytest.mark.parametrize(("tilt_deg", "broken"), [(0.0, True), (5.0, True), (12.0, False)])
def test_a_break_off_keeps_room_for_the_foot_that_hangs_lower(tilt_deg: float, broken: bool) -> None:
    touchdown = sinking()
    # GIVEN 9 cm under the feet, of which a sink of 0.2 m/s takes 5 before it ends
    low = sight(0.1, LEG_M + 0.09, velocity=(0.0, 0.0, 0.2))
    for k in range(6):
        touchdown.note_tilt(quat_from_euler(math.radians(tilt_deg), 0.0, 0.0), 1.0 + k * CYCLE_S)
        touchdown.step(low, 1.0 + k * CYCLE_S)
    assert touchdown.committed is not broken


@pytest.mark.parametrize(
    ("aside", "speed_m_s", "broken"),
    [(0.04, 0.12, False), (0.04, 0.3, True), (0.0, 0.5, True), (-0.06, 0.4, False), (-0.06, -0.3, True)],
)
def test_a_gust_that_will_carry_it_aside_breaks_it_off_before_it_has(
    aside: float, speed_m_s: float, broken: bool
) -> None:
    touchdown = sinking()
    drifting = sight(aside, LEG_M + 0.12, velocity=(speed_m_s, 0.0, 0.19))
    assert touchdown.cycles([drifting] * 6) == []
    assert touchdown.committed is not broken
    assert ("lateral offset" in touchdown.broken_off_by) is broken


def test_each_break_off_uses_up_the_same_try() -> None:
    touchdown, commits, found, k = fresh(), 0, None, 0
    while found is None and k * CYCLE_S < 60.0:
        was = touchdown.committed
        seen = sight(0.2, LEG_M + 0.2) if was else sight()
        found = touchdown.step(seen, k * CYCLE_S)
        found = None if found and found[0] is MissionEvent.MISALIGNED and was else found
        commits += touchdown.committed and not was
        k += 1
    assert commits > 3
    assert found is not None
    assert found[0] is MissionEvent.MISALIGNED
    assert k * CYCLE_S == pytest.approx(CONFIG.giving_up_s, abs=0.6)


def test_a_gust_on_the_way_down_breaks_it_off() -> None:
    touchdown = fresh()
    waited(touchdown, 0.0, 0.0, 0.5)
    before = touchdown.committed
    waited(touchdown, 6.0, 0.5, 1.2)
    assert (before, touchdown.committed) == (True, False)
    assert "lateral speed within its limit" in touchdown.broken_off_by
    assert touchdown.level_off() is None


@pytest.mark.parametrize("lateral_m", [0.0, 0.19])
def test_who_gives_the_final_descent_up_climbs_at_once(lateral_m: float) -> None:
    touchdown = sinking()
    late_s = 1.0 if lateral_m else 20.0
    low = sight(lateral_m, LEG_M + 0.05, velocity=(0.0, 0.0, 0.19))
    found = touchdown.step(low, late_s)
    assert found is not None
    assert found[0] is MissionEvent.MISALIGNED
    # WHEN the landing flies back to over the pad from the next cycle on
    before = touchdown._generator.at(late_s)
    touchdown._generator.fly_to(Motion((0.0, 0.0, -LEG_M - 1.5)), late_s + CYCLE_S)
    lowest_m = max(touchdown._generator.at(late_s + 0.01 * k).position_m[2] for k in range(30))
    assert lowest_m < before.position_m[2] + 0.03
    assert touchdown._generator.at(late_s + 0.3).velocity_m_s[2] == pytest.approx(-0.3, abs=0.01)


def test_a_turning_pad_that_is_lost_right_after_the_commit_does_not_end_the_descent() -> None:
    # no fresh sighting has told by then when the contact is due
    touchdown, lost = sinking(), replace(sight(age=0.3), turn_rate_rad_s=0.3)
    for k in range(3):
        assert touchdown.step(lost, 1.0 + k * CYCLE_S, imu_age_s=0.0) is None
    assert touchdown.committed


@pytest.mark.parametrize(("north_m", "goes_on"), [(-0.25, True), (0.0, True), (0.25, False)])
def test_far_aside_for_a_lead_it_does_not_miss_the_pad(north_m: float, goes_on: bool) -> None:
    touchdown = sinking()
    low = LEG_M + 0.06
    lead = plan(Motion((-0.25, 0.0, 0.0)), Motion((-0.25, 0.0, 0.0)), touchdown.now_s, 1.0)
    touchdown.reference.lead(Course((lead,)))
    found = touchdown.cycles([sight(north_m, low, (0.0, 0.0, 0.19))] * 2)
    assert (found == []) is goes_on
    assert goes_on or found[0] is MissionEvent.MISALIGNED
