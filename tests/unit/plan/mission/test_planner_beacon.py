"""The planner in a closed loop over a pad whose estimate something else than the camera carries."""

import math

from companion.base.geometry import ZERO3, Vector3
from companion.base.messages import Phase, PlanStep
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import Path, line, still
from tests.unit.plan.plan_harness import PlanWorld


def unseen_world(pad: Path, off: Vector3) -> PlanWorld:
    """One whose camera shows no pad, while a beacon carries it."""
    w = world(pad)
    w.blind, w.carried_off_m = lambda _t, _height: True, off
    return w


def aside_m(w: PlanWorld) -> float:
    pad = w.pad(w.now_s)
    return math.hypot(w.position[0] - pad[0], w.position[1] - pad[1])


def test_over_a_pad_that_only_a_beacon_carries_it_waits_and_never_commits() -> None:
    w = unseen_world(line(0.8, -25.0), (0.6, -0.4, 0.0))
    lowest, apart = math.inf, []

    def watch(w: PlanWorld, step: PlanStep) -> None:
        nonlocal lowest
        if step.phase is Phase.SEARCH:
            lowest = min(lowest, -w.position[2])
            apart.append(aside_m(w))

    w.each = watch
    flight = w.fly(200.0)
    assert flight.phase is Phase.ABORT  # the search's time is up: the autopilot has it back
    late, spacing_m = apart[len(apart) // 2 :], w.config.search.spacing_m
    # from over its place it looks round it, and comes back
    assert min(late) < 1.0
    assert max(late) < math.hypot(spacing_m, spacing_m) + 1.5
    assert lowest > 5.0
    assert not {Phase.APPROACH, Phase.DESCEND, Phase.TOUCHDOWN, Phase.LANDED} & {
        phase for _, phase in flight.phases
    }
    assert flight.told("commit") == []


def test_a_pad_that_is_not_where_its_beacon_surely_says_is_found() -> None:
    w = world(still(0.0, 20.0))
    # the antenna stands on a mast beside the pad, or the base is wrong; in view from near alone
    w.carried_off_m, w.carried_std_m = (4.0, 0.0, 0.0), 0.05
    w.blind = lambda _t, _height: aside_m(w) > 2.5
    assert w.fly(150.0).phase is Phase.LANDED


def test_a_beacon_that_is_not_sure_is_the_middle_of_a_search_no_wider_than_it_is_unsure() -> None:
    w = unseen_world(still(0.0, 20.0), ZERO3)
    w.carried_std_m = 1.5
    apart: list[float] = []
    w.each = lambda w, step: apart.append(aside_m(w)) if step.phase is Phase.SEARCH else None
    w.fly(200.0)
    late = apart[len(apart) // 2 :]
    spacing_m = w.config.search.spacing_m
    assert spacing_m - 1.0 < max(late) <= math.hypot(spacing_m, spacing_m) + 1.0


def test_the_camera_takes_over_from_the_beacon() -> None:
    w = world(line(0.8, -25.0))
    w.carried_off_m = (1.5, -1.0, 2.0)
    flight = w.fly(120.0)
    assert flight.phase is Phase.LANDED


def test_a_beacon_carries_the_vehicle_through_a_gap_and_it_lands_after_it() -> None:
    w = world(line(0.8, -6.0))
    w.carried_off_m = (0.3, 0.2, 0.0)
    began_s, apart = math.inf, list[float]()

    def watch(w: PlanWorld, step: PlanStep) -> None:
        nonlocal began_s
        if step.phase is Phase.APPROACH:
            began_s = min(began_s, w.now_s)
        if began_s + 8.0 < w.now_s < began_s + 12.0:
            apart.append(aside_m(w))

    w.each, w.blind = watch, lambda t, _height: began_s + 1.0 < t < began_s + 12.0
    flight = w.fly(150.0)
    assert flight.phase is Phase.LANDED
    assert Phase.SEARCH in [phase for t, phase in flight.phases if t > began_s]
    spacing_m = w.config.search.spacing_m
    assert min(apart) < 0.5
    assert max(apart) < math.hypot(spacing_m, spacing_m) + 1.0


def test_what_a_beacon_outside_the_fence_carries_is_not_followed() -> None:
    w = unseen_world(still(0.0, 200.0), ZERO3)
    flight = w.fly(60.0)
    assert flight.told("fence") == ["pad beacon ignored: 200 m from home, fence 150 m"]
    assert w.position[1] < 20.0
