"""When it commits to the final descent: alignment, tilt, drift, and how much of them a long wait bears."""

import math
from dataclasses import replace

import pytest

from companion.base.messages import PadState
from companion.config import LandingConfig, TouchdownConfig
from companion.control.attitude import attitude_from_acceleration
from companion.plan.events import MissionEvent
from companion.plan.landing.tolerance import Tolerance, aligned, gentle
from tests.unit.plan.landing.touchdown_attempt import (
    CONFIG,
    CYCLE_S,
    WAIT_M,
    fresh,
    sight,
    sinking,
    tilting,
    wait,
    waited,
)
from tests.unit.plan.plan_harness import LEG_M


@pytest.mark.parametrize(
    ("good", "bad"),
    [
        (sight(aside=0.059), sight(aside=0.061)),
        (sight(velocity=(0.119, 0.0, 0.0)), sight(velocity=(0.121, 0.0, 0.0))),
        (sight(height=WAIT_M + 0.099), sight(height=WAIT_M + 0.101)),
        (sight(height=WAIT_M - 0.099), sight(height=WAIT_M - 0.101)),
        (sight(velocity=(0.0, 0.0, 0.149)), sight(velocity=(0.0, 0.0, 0.151))),
        (sight(age=0.2), sight(age=0.21)),
    ],
)
def test_aligned_on_both_sides_of_each_bound(good: PadState, bad: PadState) -> None:
    assert aligned(good, WAIT_M, 1.0, CONFIG)
    assert not aligned(bad, WAIT_M, 1.0, CONFIG)


def test_gentle_on_both_sides_of_each_bound() -> None:
    assert gentle(sight(pad_acceleration=(0.0, 1.19, 0.19)), CONFIG)
    assert not gentle(sight(pad_acceleration=(0.86, 0.86, 0.0)), CONFIG)
    assert not gentle(sight(pad_acceleration=(0.0, 0.0, -0.21)), CONFIG)


def test_it_commits_once_aligned_for_a_moment() -> None:
    at, found = wait(fresh(), sight(), 5.0)
    assert found is None
    assert at == pytest.approx(CONFIG.settled_s, abs=0.04)


def test_a_break_in_alignment_starts_the_moment_again() -> None:
    touchdown = fresh()
    touchdown.cycles([*[sight()] * 5, sight(aside=0.2), *[sight()] * 5])
    assert not touchdown.committed


def test_a_restless_pad_is_waited_for_but_not_forever() -> None:
    at, found = wait(fresh(), sight(pad_acceleration=(1.5, 0.0, 0.0)), 20.0)
    assert found is None
    assert at == pytest.approx(CONFIG.gentle_wait_s + CONFIG.settled_s, abs=0.08)


def test_a_little_aside_is_accepted_late_and_far_aside_never() -> None:
    at, found = wait(fresh(), sight(aside=0.085), 30.0)
    assert found is None
    assert at == pytest.approx(2.0 * CONFIG.gentle_wait_s + CONFIG.settled_s, abs=0.08)
    at, found = wait(fresh(), sight(aside=0.2), 40.0)
    assert found is MissionEvent.MISALIGNED
    assert at == pytest.approx(6.0 * CONFIG.gentle_wait_s, abs=0.08)


def test_the_last_try_has_more_slack() -> None:
    assert wait(fresh(tolerance_scale=1.6), sight(aside=0.085), 30.0)[0] < 1.0


def test_a_pad_unseen_while_waiting_is_lost_as_soon_as_the_descent_would_not_go_by_it() -> None:
    pause_s = LandingConfig().pause_unseen_s
    assert pause_s < CONFIG.blind_s
    assert wait(fresh(), sight(age=pause_s + 0.01), 5.0) == (0.0, MissionEvent.PAD_LOST)
    assert wait(fresh(), sight(age=pause_s - 0.1), 0.05)[1] is None
    # what camera and vision take is no gap
    late = replace(sight(age=pause_s + 0.1), delay_s=0.15)
    assert wait(fresh(), late, 0.05)[1] is None


@pytest.mark.parametrize(("share", "commits"), [(0.95, True), (1.05, False)])
def test_it_waits_while_it_tilts_further_than_it_can_level_off(share: float, commits: bool) -> None:
    touchdown = fresh()
    waited(touchdown, share * CONFIG.gentle_tilt_m_s2, 0.0, 2.0)
    assert touchdown.committed is commits


def test_a_long_wait_bears_more_tilt_by_and_by() -> None:
    touchdown = fresh()
    # GIVEN that it tilts little only while it is aside
    tilt, k = tilting(1.35 * CONFIG.gentle_tilt_m_s2), 0
    while not touchdown.committed and k * CYCLE_S < 29.0:
        since_calm_s = k * CYCLE_S % 4.0
        touchdown.note_tilt(tilting(0.0) if since_calm_s < 1.0 else tilt, k * CYCLE_S)
        touchdown.step(sight(0.2 if since_calm_s < 3.0 else 0.0), k * CYCLE_S)
        k += 1
    # THEN 1.35 times what is gentle is borne once nearly three waits are over
    assert 2.9 * CONFIG.gentle_wait_s < k * CYCLE_S < 3.0 * CONFIG.gentle_wait_s + 4.0


@pytest.mark.parametrize(
    ("pad_m_s2", "tilt_m_s2", "turn_deg_s", "commits"),
    [
        # 1.2 m/s2 with the pad and 0.8 against the wind, now in one direction, at contact about opposite
        pytest.param(1.2, 2.0, 0.0, False, id="it does not turn"),
        pytest.param(1.2, 2.0, 80.0, True, id="the turn takes the tilt back"),
        pytest.param(1.2, 2.0, -80.0, True, id="the turn the other way too"),
        pytest.param(-1.0, 0.2, 80.0, False, id="the turn brings the tilt"),
    ],
)
def test_a_tilt_that_the_pads_turn_takes_back_by_the_contact_is_borne(
    pad_m_s2: float, tilt_m_s2: float, turn_deg_s: float, commits: bool
) -> None:
    touchdown, turn_rate_rad_s = fresh(), math.radians(turn_deg_s)
    turning = replace(sight(), acceleration_ned_m_s2=(0.0, pad_m_s2, 0.0), turn_rate_rad_s=turn_rate_rad_s)
    for k in range(round(0.9 * CONFIG.gentle_wait_s / CYCLE_S)):
        touchdown.note_tilt(attitude_from_acceleration((0.0, tilt_m_s2, 0.0), 1.0), k * CYCLE_S, turning)
        touchdown.cycles([turning])
    assert touchdown.committed is commits


@pytest.mark.parametrize(
    ("seen", "tilt_m_s2", "tolerance_scale", "waits"),
    [
        pytest.param(sight(), 2.4, 1.0, 1.0, id="a tilt"),
        pytest.param(sight(0.088, velocity=(0.17, 0.0, 0.0)), 0.0, 1.6, 2.0, id="a drift"),
    ],
)
def test_what_would_break_it_off_at_once_is_no_moment_to_commit(
    seen: PadState, tilt_m_s2: float, tolerance_scale: float, waits: float
) -> None:
    touchdown = fresh(tolerance_scale)
    while not touchdown.committed and touchdown.now_s < 29.0:
        touchdown.note_tilt(tilting(tilt_m_s2), touchdown.now_s + CYCLE_S)
        touchdown.cycles([seen])
    assert (touchdown.committed, touchdown.broken_off_by) == (True, "")
    assert touchdown.now_s > waits * CONFIG.gentle_wait_s


def test_drift_that_does_not_get_less_is_borne_by_and_by() -> None:
    committed = []
    for waited_s in (0.0, 4.0 * CONFIG.gentle_wait_s):
        touchdown, now_s = fresh(), 0.0
        while not touchdown.committed and now_s < waited_s + 1.0:
            touchdown.step(sight(0.2 if now_s < waited_s else 0.0), now_s)
            now_s += CYCLE_S
        # 13 cm in 0.22 s
        touchdown.cycles([sight(0.06, LEG_M + 0.2, velocity=(0.3, 0.0, 0.19))] * 6)
        committed.append(touchdown.committed)
    assert committed == [False, True]


WIDE = TouchdownConfig(lateral_m=0.2, break_off_lateral_m=0.25, escape_lateral_m=0.5)


@pytest.mark.parametrize(
    ("config", "tolerance_scale", "aside", "goes_on"),
    [
        pytest.param(CONFIG, 2.0, 0.115, True, id="the most patient try"),
        pytest.param(CONFIG, 2.0, 0.125, False, id="not beyond 12 cm"),
        pytest.param(WIDE, 1.0, 0.24, True, id="a larger pad"),
        pytest.param(WIDE, 1.0, 0.26, False, id="not beyond its 25 cm"),
    ],
)
def test_how_far_aside_it_goes_on_down(
    config: TouchdownConfig, tolerance_scale: float, aside: float, goes_on: bool
) -> None:
    touchdown = sinking(config=config, tolerance_scale=tolerance_scale)
    touchdown.cycles([sight(aside, LEG_M + 0.2)] * 6)
    assert touchdown.committed is goes_on


def test_it_does_not_start_down_from_where_it_would_break_off() -> None:
    touchdown = fresh(tolerance_scale=1.6)
    at, found = wait(touchdown, sight(0.13), 40.0)
    assert found is MissionEvent.MISALIGNED
    assert at == pytest.approx(CONFIG.giving_up_s, abs=0.08)


def test_after_one_wait_a_lull_of_the_wind_is_taken() -> None:
    config = TouchdownConfig()
    tolerance = Tolerance(config, since_s=0.0, tolerance_scale=1.0)
    gentle = config.gentle_tilt_m_s2
    for tenth in range(120):
        now_s = 0.1 * tenth
        tolerance.note_tilt(4.0 if 40 <= tenth < 45 else 2.5, now_s)
        if now_s < config.gentle_wait_s:
            assert tolerance.max_horizontal_acceleration_m_s2(now_s) == gentle  # a gentler moment may come
        else:
            assert tolerance.max_horizontal_acceleration_m_s2(now_s) == pytest.approx(
                2.7
            )  # no more than the least, and a little
    # the least is that of the last seconds: a wind that has grown is met by what it grants now
    for tenth in range(120, 180):
        tolerance.note_tilt(3.0, 0.1 * tenth)
    assert tolerance.max_horizontal_acceleration_m_s2(17.9) == pytest.approx(3.2)
