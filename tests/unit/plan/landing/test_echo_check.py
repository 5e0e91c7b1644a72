"""A rangefinder that does not follow the vehicle's way up and down is not believed."""

import pytest

from companion.base.messages import Phase, RangeSample
from companion.plan.landing.height_above_ground import EchoCheck
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import still


def climbed(
    echo_m: float, follows: float, ours_m: float, theirs_m: float, *, seconds: float = 3.0
) -> EchoCheck:
    """After a climb of so much, by our estimate and by the autopilot; the echo follows by a share of it."""
    check, steps = EchoCheck(), round(30.0 * seconds)
    for step in range(steps + 1):
        share, now_s = step / steps, step / 30.0
        echo = RangeSample(now_s, echo_m + follows * share * ours_m)
        check.update(echo, share * ours_m, share * theirs_m, now_s)
    return check


@pytest.mark.parametrize("way_m", [0.8, -0.8])
def test_one_that_stays_while_two_others_move_is_stuck(way_m: float) -> None:
    assert climbed(0.06, 0.0, way_m, way_m).stuck


def test_one_that_follows_is_not_nor_one_that_only_one_other_contradicts() -> None:
    assert not climbed(0.4, 1.0, 0.8, 0.8).stuck
    assert not climbed(0.06, 0.0, 0.8, 0.0).stuck
    assert not climbed(0.06, 0.0, 0.0, 0.8).stuck


def test_drift_and_a_far_echo_say_nothing() -> None:
    assert not climbed(0.06, 0.0, 0.8, 0.8, seconds=60.0).stuck
    assert not climbed(3.0, 0.0, 2.0, 2.0).stuck


@pytest.mark.parametrize("gap_s", [0.0, 8.0])
def test_the_last_echo_before_it_fell_silent_contradicts_nothing(gap_s: float) -> None:
    check = EchoCheck()
    check.update(RangeSample(0.0, 1.2), 0.0, 0.0, 0.0)
    for step in range(1, 90):
        check.update(RangeSample(0.0, 1.2), 0.02 * step, 0.02 * step, step / 30.0)
    assert not check.stuck
    if gap_s:  # nor one of elsewhere, long after
        check.update(RangeSample(gap_s, 1.2), 2.0, 2.0, gap_s)
    assert not check.stuck


def test_one_that_moves_again_is_believed_again() -> None:
    check = climbed(0.06, 0.0, 0.8, 0.8)
    check.update(RangeSample(4.0, 0.5), 0.8, 0.8, 4.0)
    assert not check.stuck


def test_a_rangefinder_stuck_at_6_cm_does_not_keep_the_vehicle_up() -> None:
    w = world(still())
    w.echo_m = 0.06
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED
    assert len(flight.told("rangefinder")) == 1
    assert "stuck at 0.06 m" in flight.told("rangefinder")[0]
