"""When it commits to the final descent: to a contact that is likely within the limits, and likely enough."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from companion.base.geometry import GRAVITY_M_S2
from companion.base.messages import PadState
from companion.config import LandingConfig
from companion.control.attitude import attitude_from_acceleration
from companion.plan.events import MissionEvent
from tests.unit.plan.landing.touchdown_attempt import (
    CONFIG,
    CYCLE_S,
    Attempt,
    fresh,
    sight,
    tilting,
    wait,
)

# it tells what the vehicle has done for seconds: seen in one cycle more, it has been seen for so long
MOMENT_S = CONFIG.settled_s + 0.04
LEVEL_M_S2 = GRAVITY_M_S2 * math.tan(math.radians(CONFIG.contact_tilt_deg))


def waits(seen_at: Callable[[float], PadState], slack: float = 1.0) -> float:
    """How long it waits over a pad that it has seen like that until it commits; inf when it gives up."""
    return waited(fresh(slack, seen_at=seen_at), seen_at)


def in_wind(tilt_m_s2: float) -> Attempt:
    """One that has tilted like that for long."""
    touchdown = fresh()
    for k in range(300):
        touchdown.note_tilt(tilting(tilt_m_s2), k * CYCLE_S - 10.0)
    return touchdown


def waited(touchdown: Attempt, seen_at: Callable[[float], PadState], tilt_m_s2: float = 0.0) -> float:
    while touchdown.now_s < 40.0:
        touchdown.note_tilt(tilting(tilt_m_s2), touchdown.now_s + CYCLE_S)
        found = touchdown.cycles([seen_at(touchdown.now_s + CYCLE_S)])
        if touchdown.committed:
            return touchdown.now_s
        if found:
            assert found == [MissionEvent.MISALIGNED]
            assert touchdown.now_s == pytest.approx(CONFIG.giving_up_s, abs=0.04)
            return math.inf
    raise AssertionError("neither commits nor gives up")


def swaying(by_m: float) -> Callable[[float], PadState]:
    """Aside and back in 2 s, as far to each side."""

    def at(now_s: float) -> PadState:
        turned = math.pi * now_s
        return sight(by_m * math.sin(turned), velocity=(math.pi * by_m * math.cos(turned), 0.0, 0.0))

    return at


def test_it_commits_once_it_has_been_likely_for_a_moment() -> None:
    at, found = wait(fresh(), sight(), 5.0)
    assert found is None
    assert at == pytest.approx(CONFIG.settled_s, abs=0.04)


def test_what_was_not_watched_before_is_watched_first() -> None:
    at, found = wait(fresh(watched_s=0.0), sight(), 9.0)
    assert found is None
    assert 1.0 < at < 5.0


@pytest.mark.parametrize(
    "off",
    [
        pytest.param(sight(aside=0.6), id="far aside"),
        pytest.param(sight(velocity=(4.0, 0.0, 0.0)), id="a fast slip"),
        pytest.param(sight(age=0.21), id="unseen"),
    ],
)
def test_a_break_starts_the_moment_again(off: PadState) -> None:
    touchdown = fresh()
    touchdown.cycles([*[sight()] * 5, off, *[sight()] * 5])
    assert not touchdown.committed


def test_the_more_it_sways_the_longer_it_waits_until_it_gives_up() -> None:
    waited_s = [waits(swaying(by_m)) for by_m in (0.02, 0.07, 0.2)]
    assert waited_s[0] == pytest.approx(CONFIG.settled_s, abs=0.04)
    assert 2.0 < waited_s[1] < CONFIG.giving_up_s
    assert waited_s[2] == math.inf


def test_one_that_stays_aside_is_not_committed() -> None:
    assert waits(lambda _: sight(aside=0.13)) == math.inf


def test_the_last_try_has_more_slack_aside() -> None:
    assert waits(swaying(0.07), slack=1.6) < 0.2 * waits(swaying(0.07))


@pytest.mark.parametrize(("heaves_m_s", "at_once"), [(0.1, True), (0.5, False)])
def test_a_deck_that_heaves_so_that_the_sink_scatters_is_waited_for(heaves_m_s: float, at_once: bool) -> None:
    def at(now_s: float) -> PadState:
        return sight(velocity=(0.0, 0.0, heaves_m_s * math.sin(math.pi * now_s)))

    assert (waits(at) < MOMENT_S) is at_once


def test_a_pad_that_accelerates_is_no_reason_to_wait_while_it_is_followed() -> None:
    assert waits(lambda _: sight(pad_acceleration=(1.5, 0.0, 0.3))) < MOMENT_S


def test_a_pad_unseen_while_waiting_is_lost_as_soon_as_the_descent_would_not_go_by_it() -> None:
    pause_s = LandingConfig().pause_unseen_s
    assert pause_s < CONFIG.blind_s
    assert wait(fresh(), sight(age=pause_s + 0.01), 5.0) == (0.0, MissionEvent.PAD_LOST)
    assert wait(fresh(), sight(age=pause_s - 0.1), 0.05)[1] is None
    # what camera and vision take is no gap
    late = replace(sight(age=pause_s + 0.1), delay_s=0.15)
    assert wait(fresh(), late, 0.05)[1] is None


def test_a_steady_wind_is_not_waited_out_unless_levelling_off_would_make_too_much_drift() -> None:
    tilts_m_s2 = [LEVEL_M_S2 + excess_m_s2 for excess_m_s2 in (0.5, 1.2, 2.2, 7.0)]
    waited_s = [waited(in_wind(tilt_m_s2), lambda _: sight(), tilt_m_s2) for tilt_m_s2 in tilts_m_s2]
    assert waited_s[:2] == pytest.approx([CONFIG.settled_s] * 2, abs=0.04)
    assert 2.0 < waited_s[2] < CONFIG.giving_up_s
    assert waited_s[3] == math.inf


@pytest.mark.parametrize(
    ("pad_m_s2", "tilt_m_s2", "turn_deg_s", "commits"),
    [
        # 2.2 m/s2 with the pad and 1.8 against the wind, now in one direction, at contact about opposite
        pytest.param(2.2, 4.0, 0.0, False, id="it does not turn"),
        pytest.param(2.2, 4.0, 80.0, True, id="the turn takes the tilt back"),
        pytest.param(2.2, 4.0, -80.0, True, id="the turn the other way too"),
        pytest.param(-2.0, 0.2, 80.0, False, id="the turn brings the tilt"),
    ],
)
def test_a_tilt_that_the_pads_turn_takes_back_by_the_contact_is_borne(
    pad_m_s2: float, tilt_m_s2: float, turn_deg_s: float, commits: bool
) -> None:
    touchdown, turn_rate_rad_s = fresh(), math.radians(turn_deg_s)
    turning = replace(sight(), acceleration_ned_m_s2=(0.0, pad_m_s2, 0.0), turn_rate_rad_s=turn_rate_rad_s)
    for k in range(round(4.0 / CYCLE_S)):
        touchdown.note_tilt(attitude_from_acceleration((0.0, tilt_m_s2, 0.0), 1.0), k * CYCLE_S, turning)
        touchdown.cycles([turning])
    assert touchdown.committed is commits


@pytest.mark.parametrize("tilt_m_s2", [3.1, 3.4])
def test_what_would_break_it_off_at_once_is_no_moment_to_commit(tilt_m_s2: float) -> None:
    """As unlikely as is borne after a long wait, it goes on down as long as nothing gets worse."""
    touchdown = in_wind(tilt_m_s2)
    assert 5.0 < waited(touchdown, lambda _: sight(), tilt_m_s2) < CONFIG.giving_up_s
    for _ in range(20):
        touchdown.note_tilt(tilting(tilt_m_s2), touchdown.now_s + CYCLE_S)
        reference = touchdown.reference.at(touchdown.now_s + CYCLE_S)
        north_m, east_m, down_m = reference.position_m
        touchdown.cycles([sight(north_m, -down_m, reference.velocity_m_s, east=east_m)])
    assert (touchdown.committed, touchdown.broken_off_by) == (True, "")
