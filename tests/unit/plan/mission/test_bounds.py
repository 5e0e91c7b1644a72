"""Fence, ceiling and the fastest pad: reached with room to stop, whatever is followed."""

import math
from dataclasses import replace

import pytest

from companion.base.geometry import Vector3, add, geodetic_from_ned
from companion.base.messages import ActionKind, AutopilotState, PadState, Phase, VehicleState
from companion.base.motion import Motion
from companion.config import MissionConfig, PlanConfig
from companion.plan.mission.bounds import Bounds, moved_m, stopping_m
from companion.plan.mission.states import MissionEvent
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import line, still
from tests.unit.plan.plan_autopilot import HOME
from tests.unit.plan.plan_harness import ORIGIN, ORIGIN_NED_M, PlanWorld

CONFIG = MissionConfig(fence_m=50.0, ceiling_m=20.0)


def vehicle_at(from_home_m: Vector3, velocity: Vector3) -> VehicleState:
    w = PlanWorld(still())
    w.now_s = 5.0
    known = w.inputs().vehicle
    assert known is not None
    position = add(from_home_m, tuple(-p for p in ORIGIN_NED_M))  # type: ignore[arg-type]
    return replace(known, position_ned_m=position, velocity_ned_m_s=velocity, origin=ORIGIN)


def found(vehicle: VehicleState | None, home: Vector3 | None = HOME) -> list[str]:
    autopilot = AutopilotState(5.0, connected=True, home=home)
    return [reason for _, reason in Bounds(CONFIG).detect(vehicle, None, autopilot, 5.0)]


@pytest.mark.parametrize("speed", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("course_deg", [0.0, 135.0, 250.0])
def test_the_fence_is_reached_so_early_that_it_can_stop_before_it(speed: float, course_deg: float) -> None:
    x, y = math.cos(math.radians(course_deg)), math.sin(math.radians(course_deg))
    edge_m = 50.0 - stopping_m(speed)
    outward = (speed * x, speed * y, 0.0)
    for away_m, reached in ((edge_m - 0.1, False), (edge_m + 0.1, True)):
        assert bool(found(vehicle_at((away_m * x, away_m * y, -5.0), outward))) is reached
    # flying home or along the fence, it may be nearer
    for velocity in ((-speed * x, -speed * y, 0.0), (-speed * y, speed * x, 0.0)):
        assert found(vehicle_at((49.8 * x, 49.8 * y, -5.0), velocity)) == []


def test_the_ceiling_likewise() -> None:
    assert found(vehicle_at((0.0, 0.0, -19.5), (0.0, 0.0, 1.0))) == []
    assert found(vehicle_at((0.0, 0.0, -19.5), (0.0, 0.0, -1.0))) == ["ceiling: 20 m over home, limit 20 m"]


def test_the_room_to_stop_in_is_that_of_a_late_and_gentle_brake() -> None:
    # 0.8 s straight on, then at 2 m/s²
    assert stopping_m(4.0) == pytest.approx(0.8 * 4.0 + 4.0**2 / 4.0)
    assert stopping_m(-3.0) == 0.0


@pytest.mark.parametrize(
    ("ours", "theirs", "reason"),
    [
        ((20.0, 0.0, -5.0), (0.0, 60.0, -5.0), "fence: 60 m from home, limit 50 m"),
        ((60.0, 0.0, -5.0), (0.0, 20.0, -5.0), "fence: 60 m from home, limit 50 m"),
        ((0.0, 0.0, -5.0), (0.0, 0.0, -22.0), "ceiling: 22 m over home, limit 20 m"),
    ],
)
def test_without_gps_the_autopilots_position_counts_as_well(
    ours: Vector3, theirs: Vector3, reason: str
) -> None:
    drifts = replace(vehicle_at(ours, (0.0, 0.0, 0.0)), has_gps=False)
    autopilot = AutopilotState(
        5.0, connected=True, home=HOME, global_position=geodetic_from_ned(theirs, HOME)
    )
    assert [words for _, words in Bounds(CONFIG).detect(drifts, None, autopilot, 5.0)] == [reason]
    fixed = replace(drifts, has_gps=True)
    assert bool([*Bounds(CONFIG).detect(fixed, None, autopilot, 5.0)]) is (ours[0] > 50.0)
    # and so where the pad will be
    pad = Motion(drifts.position_ned_m)
    inside = Bounds(CONFIG).inside_after(5.0, pad, 0.0, drifts, autopilot)
    assert inside is not reason.startswith("fence")


def test_without_home_or_an_estimate_there_is_nothing_to_count_from() -> None:
    assert found(vehicle_at((500.0, 0.0, -5.0), (0.0, 0.0, 0.0)), home=None) == []
    assert found(None) == []


@pytest.mark.parametrize(
    ("speed", "acceleration", "followed"),
    [(4.9, 0.0, True), (5.1, 0.0, False), (1.0, 4.9, True), (1.0, 5.1, False)],
)
def test_a_pad_that_is_too_fast_for_half_a_second_is_not_followed(
    speed: float, acceleration: float, followed: bool
) -> None:
    zero = (0.0, 0.0, 0.0)
    pad = PadState(
        0.0, zero, zero, (0.0, speed, 9.0), (acceleration, 0.0, 9.0), 0.0, 0.0, 0.1, 0.1, seen_time_s=0.0
    )
    bounds, autopilot = Bounds(CONFIG), AutopilotState(0.0)
    for step in range(18):
        events = list(bounds.detect(None, pad, autopilot, step / 30.0))
        if step / 30.0 < 0.5:
            assert events == []
    assert [event for event, _ in events] == ([] if followed else [MissionEvent.PAD_TOO_FAST])


def test_a_pad_that_leads_away_is_left_before_the_fence() -> None:
    config = PlanConfig.model_validate({"mission": {"fence_m": 30.0}})
    w = world(line(2.0, start=-20.0), config)
    w.blind = lambda _t, height: height < 1.0  # it is never landed on
    farthest_m = 0.0

    def watch(w: PlanWorld, _step: object) -> None:
        nonlocal farthest_m
        farthest_m = max(farthest_m, math.hypot(*w.position[:2]))

    w.each = watch
    flight = w.fly(120.0)
    w.fly(6.0, until=lambda _w: False)
    assert flight.phase is Phase.ABORT
    assert any("limit 30 m" in text for text in flight.told("phase"))
    assert [kind for _, kind in w.autopilot.heard][-1] is ActionKind.HOLD
    assert farthest_m <= 30.0


def test_no_landing_begins_on_a_pad_that_is_beyond_the_fence_before_it_ends() -> None:
    # low over a pad that drives away at 2 m/s, 5 m before the fence: the landing would end outside
    w = world(line(2.0))
    w.fly(90.0, until=lambda w: w.flight.phase is Phase.TOUCHDOWN)
    fence_m = math.hypot(*w.position[:2]) + 5.0
    low = world(line(2.0), PlanConfig.model_validate({"mission": {"fence_m": fence_m}}))
    flight = low.fly(120.0)
    low.fly(6.0, until=lambda _w: False)
    assert flight.phase is Phase.ABORT
    assert any("the pad leaves the fence" in text for text in flight.told("fence"))
    assert flight.told("commit") == []
    assert any(f"limit {fence_m:.0f} m" in text for text in flight.told("phase"))
    assert math.hypot(*low.position[:2]) <= fence_m


def test_a_pad_that_drives_home_is_landed_on_however_near_to_the_fence() -> None:
    bounds, autopilot = Bounds(CONFIG), AutopilotState(5.0, connected=True, home=HOME)
    vehicle = vehicle_at((49.0, 0.0, -0.5), (0.0, 0.0, 0.0))
    place = add((49.0, 0.0, 0.0), tuple(-p for p in ORIGIN_NED_M))  # type: ignore[arg-type]

    def inside(north_m_s: float, turn_rate_rad_s: float = 0.0) -> bool:
        pad = Motion(place, (north_m_s, 0.0, 0.0))
        return bounds.inside_after(4.0, pad, turn_rate_rad_s, vehicle, autopilot)

    assert inside(-2.0)
    assert inside(0.2)
    assert not inside(0.3)
    # once round in the time
    assert inside(2.0, math.tau / 4.0)
    assert bounds.inside_after(4.0, None, 0.0, vehicle, autopilot)
    assert bounds.inside_after(4.0, Motion(place, (9.0, 0.0, 0.0)), 0.0, vehicle, AutopilotState(5.0))


def test_what_turns_gets_as_far_as_its_arc() -> None:
    assert moved_m((3.0, 4.0, 9.0), 0.0, 2.0) == (6.0, 8.0)
    # a quarter of a circle of 2 m to the right of north
    north, east = moved_m((1.0, 0.0, 0.0), 0.5, math.pi)
    assert north == pytest.approx(2.0)
    assert east == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"ceiling_m": 14.0}, r"ceiling_m 14: expected at least 15"),
        ({"fence_m": 11.0}, r"a waypoint 10 m from home, expected at most fence_m - 2 = 9"),
    ],
)
def test_what_is_planned_outside_is_refused_at_the_start(settings: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        PlanConfig.model_validate({"mission": settings})
