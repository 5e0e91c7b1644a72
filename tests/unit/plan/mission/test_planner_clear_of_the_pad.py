"""The planner in a closed loop: low over the pad it climbs clear before control is returned."""

from companion.base.geometry import geodetic_from_ned
from companion.base.messages import ActionKind, Phase, Quantity
from companion.config import PlanConfig
from tests.unit.plan.compared import differ
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import still
from tests.unit.plan.plan_autopilot import HOME
from tests.unit.plan.plan_harness import PlanWorld


def low_over_the_pad(config: PlanConfig | None = None) -> PlanWorld:
    w = world(still(), config)
    w.fly(90.0, until=lambda w: w.flight.phase is Phase.TOUCHDOWN)
    assert w.flight.heights_m[-1] < 0.7
    return w


def ended_by_hold(w: PlanWorld) -> None:
    assert w.flight.phase is Phase.ABORT
    assert [kind for _, kind in w.autopilot.heard][-1] is ActionKind.HOLD


def test_stopped_where_nothing_is_to_be_climbed_it_is_returned_once_at_rest() -> None:
    w = world(still())
    w.fly(90.0, until=lambda w: w.flight.phase is Phase.DESCEND)
    assert w.flight.heights_m[-1] > 1.7
    w.stop = True
    w.fly(20.0)
    ended_by_hold(w)
    assert w.flight.entered(Phase.ABORT) - w.flight.entered(Phase.HOLD) < 4.0
    assert w.flight.told("climb") == []


def test_a_camera_that_shows_turned_just_over_the_pad_climbs_clear_first() -> None:
    w = low_over_the_pad()
    w.comparisons = (differ(Quantity.CAMERA_ROTATION, 86.0),)
    w.fly(20.0)
    ended_by_hold(w)
    assert any("pad disputed: camera's rotation: " in said for said in w.flight.told("phase"))
    assert w.flight.heights_m[-1] > 1.0


def test_at_the_fence_just_over_the_pad_it_climbs_clear_first() -> None:
    w = low_over_the_pad(PlanConfig.model_validate({"mission": {"fence_m": 30.0}}))
    w.home = lambda _t: geodetic_from_ned((60.0, 0.0, 0.0), HOME)  # the autopilot has set another home
    w.fly(20.0)
    ended_by_hold(w)
    assert w.flight.heights_m[-1] > 1.0


def test_at_the_ceiling_it_climbs_no_higher() -> None:
    w = low_over_the_pad(PlanConfig.model_validate({"mission": {"ceiling_m": 30.0}}))
    w.home = lambda _t: geodetic_from_ned((0.0, 0.0, 29.5), HOME)  # 30 m over home, and more
    flown, at_m = len(w.flight.heights_m), w.flight.heights_m[-1]
    w.fly(20.0)
    ended_by_hold(w)
    assert max(w.flight.heights_m[flown:]) < at_m + 0.3


def test_a_pad_that_grows_too_fast_just_below_is_left_upward() -> None:
    w = low_over_the_pad(PlanConfig.model_validate({"mission": {"pad_speed_m_s": 0.5}}))
    begin_s, (north, east, down) = w.now_s, w.pad(w.now_s)
    w.pad = lambda t: (north, east + max(0.0, t - begin_s) ** 2, down)
    w.fly(20.0, until=lambda w: w.flight.phase is Phase.HOLD)
    assert w.flight.phase is Phase.HOLD
    assert any("clear of the pad" in text for text in w.flight.told("climb"))
    w.fly(20.0)
    ended_by_hold(w)
    assert w.flight.heights_m[-1] > 1.0


def test_it_is_clear_of_a_fast_pad_long_before_it_has_come_to_rest() -> None:
    w = low_over_the_pad(PlanConfig.model_validate({"mission": {"pad_speed_m_s": 3.0}}))
    begin_s, (north, east, down) = w.now_s, w.pad(w.now_s)
    w.pad = lambda t: (north, east + max(0.0, t - begin_s) ** 2, down)
    w.fly(20.0, until=lambda w: w.flight.phase is Phase.HOLD)
    low_m = w.flight.heights_m[-1]
    w.fly(3.0)
    assert w.flight.heights_m[-1] > low_m + 0.8


def test_land_that_is_asked_for_in_a_gap_of_the_link_is_asked_again_after_it() -> None:
    # GIVEN a vehicle that stands on the pad and is not disarmed, until the phase's time is nearly up
    w = low_over_the_pad()
    w.autopilot.refuse = {ActionKind.DISARM: 99}
    w.autopilot.doubts = True
    w.fly(w.flight.entered(Phase.TOUCHDOWN) + 44.0 - w.now_s)
    assert w.flight.phase is Phase.TOUCHDOWN
    assert ActionKind.LAND not in [kind for _, kind in w.autopilot.heard]
    # WHEN the link is gone while LAND is asked for
    w.autopilot.connected, w.autopilot.silent = False, {ActionKind.LAND, ActionKind.DISARM}
    w.fly(5.0)
    w.autopilot.connected, w.autopilot.silent = True, set()
    w.autopilot.refuse, w.autopilot.doubts = {}, False
    # THEN it is not given up
    assert w.fly(30.0).phase is Phase.LANDED
