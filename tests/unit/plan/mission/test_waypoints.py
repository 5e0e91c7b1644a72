"""Whole missions among obstacles and through waypoints, by the planner alone."""

import math
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import Vector3
from companion.base.messages import ActionKind, Phase
from companion.config import Box, ConfigError, Cylinder, MissionConfig, PhaseTimesConfig, PlanConfig, Shape
from companion.plan.obstacles.obstacles import Obstacle, clearance_m
from tests.unit.plan.pad_paths import line, still
from tests.unit.plan.plan_harness import VEHICLE, PlanWorld


def pole(north: float, east: float, radius: float = 0.3, height: float = 15.0) -> Cylinder:
    return Cylinder(kind="cylinder", centre_ned_m=(north, east), radius_m=radius, height_m=height)


def gantry(north: float, east: float, height: float = 4.0) -> Box:
    return Box(
        kind="box", centre_ned_m=(north, east), length_m=8.0, width_m=0.5, heading_deg=0.0, height_m=height
    )


class TrueTrack:
    """Where the vehicle truly was in each cycle, NED from home."""

    def __init__(self, world: PlanWorld) -> None:
        self.places: list[Vector3] = []
        world.each = lambda w, _step: self.places.append(w.position)

    def clearance_m(self, *shapes: Shape) -> float:
        return float(np.min(clearance_m(np.array(self.places), [Obstacle.of(shape) for shape in shapes])))

    def nearest_m(self, point: Vector3) -> float:
        return min(math.dist(place, point) for place in self.places)


def phases(world: PlanWorld) -> list[Phase]:
    return [phase for _, phase in world.flight.phases]


def test_a_single_waypoint_is_the_autopilots_as_ever() -> None:
    world = PlanWorld(still())
    world.fly(60.0)
    assert Phase.ROUTE not in phases(world)
    assert world.flight.phase is Phase.LANDED


@pytest.mark.parametrize("further", [(), ((14.0, 0.0),)])
def test_it_has_arrived_where_the_autopilot_took_it_though_our_estimate_differs(
    further: tuple[tuple[float, float], ...],
) -> None:
    config = PlanConfig(mission=MissionConfig(waypoints_ned_m=further))
    world = PlanWorld(still(200.0, 200.0), config=config)
    world.estimate_off_m = (1.6, -1.6, 0.0)
    world.fly(40.0, until=lambda w: bool(w.flight.phases) and w.flight.phase is Phase.SEARCH)
    assert world.flight.phase is Phase.SEARCH


def test_further_waypoints_are_flown_through_by_our_own_setpoints() -> None:
    mission = MissionConfig(waypoints_ned_m=((14.0, 8.0), (20.0, 8.0, 9.0)))
    world = PlanWorld(still(26.0, 6.0), config=PlanConfig(mission=mission))
    track = TrueTrack(world)
    world.fly(120.0)
    order = phases(world)
    assert order[order.index(Phase.WAYPOINT) :][:3] == [Phase.WAYPOINT, Phase.ROUTE, Phase.SEARCH]
    assert world.flight.phase is Phase.LANDED
    assert track.nearest_m((10.0, 0.0, -7.0)) < 1.5
    assert track.nearest_m((14.0, 8.0, -7.0)) < 0.5
    assert track.nearest_m((20.0, 8.0, -9.0)) < 0.5


def test_the_pad_in_view_ends_the_route() -> None:
    mission = MissionConfig(waypoints_ned_m=((10.0, 12.0), (30.0, 12.0)))
    world = PlanWorld(still(10.0, 6.0), config=PlanConfig(mission=mission))
    world.fly(90.0)
    assert world.flight.phase is Phase.LANDED
    assert any("between the waypoints" in text for text in world.flight.told("phase"))


def test_an_obstacle_in_the_autopilots_straight_way_makes_the_first_waypoint_ours() -> None:
    shapes = (pole(5.0, 0.1),)
    world = PlanWorld(still(), config=PlanConfig(obstacles=shapes))
    track = TrueTrack(world)
    world.fly(90.0)
    order = phases(world)
    assert Phase.WAYPOINT not in order
    assert order[order.index(Phase.TAKE_OFF) + 1] is Phase.ROUTE
    assert ActionKind.GO_TO not in {kind for _, kind in world.autopilot.heard}
    assert world.flight.phase is Phase.LANDED
    assert track.clearance_m(*shapes) > PlanConfig().obstacle_margin_m + VEHICLE.radius_m - 0.15


def test_an_obstacle_between_waypoint_and_pad_is_flown_round() -> None:
    shapes = (gantry(14.0, 3.0, height=12.0).model_copy(update={"heading_deg": 90.0}),)
    world = PlanWorld(still(19.0, 2.0), config=PlanConfig(obstacles=shapes, obstacle_ceiling_m=9.0))
    world.beacon_after_s = 0.5
    track = TrueTrack(world)
    world.fly(120.0)
    assert world.flight.phase is Phase.LANDED
    assert world.flight.told("detour")
    assert track.clearance_m(*shapes) > PlanConfig().obstacle_margin_m + VEHICLE.radius_m - 0.15


def shut_in(north: float, east: float) -> tuple[Box, ...]:
    """Four walls about a place."""
    around = ((4.0, 0.0, 90.0), (-4.0, 0.0, 90.0), (0.0, 4.0, 0.0), (0.0, -4.0, 0.0))
    return tuple(
        Box(
            kind="box",
            centre_ned_m=(north + n, east + e),
            length_m=9.0,
            width_m=0.4,
            heading_deg=heading,
            height_m=20.0,
        )
        for n, e, heading in around
    )


def test_a_waypoint_to_which_no_way_leads_is_held_before_and_reported_and_ends_by_time() -> None:
    phase_times = PhaseTimesConfig(route_s=8.0, search_s=10.0)
    config = PlanConfig(obstacles=shut_in(10.0, 0.0), mission=MissionConfig(phases=phase_times))
    world = PlanWorld(still(60.0, 60.0), config=config)
    track = TrueTrack(world)
    world.fly(60.0)
    assert any("no clear path" in text for text in world.flight.told("blocked"))
    assert phases(world)[-3:] == [Phase.ROUTE, Phase.SEARCH, Phase.ABORT]
    assert track.clearance_m(*config.obstacles) > 1.8


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"obstacles": (pole(10.0, 0.5),)}, r"plan.mission.waypoint_ned_m: 0.2 m from plan.obstacles.0"),
        (
            {
                "obstacles": (pole(50.0, 0.0), pole(14.0, 8.0, height=6.0)),
                "mission": MissionConfig(waypoints_ned_m=((14.0, 2.0), (14.0, 8.0))),
            },
            r"plan.mission.waypoints_ned_m.1: 1.0 m from plan.obstacles.1, expected at least 1.9 m",
        ),
        ({"obstacles": (pole(0.0, 0.5),)}, r"plan.obstacles.0: 0.2 m from the take-off place"),
    ],
)
def test_what_could_never_be_flown_is_refused_at_the_start_in_one_line(
    settings: dict[str, Any], said: str
) -> None:
    with pytest.raises(ConfigError, match=said) as refused:
        PlanWorld(still(), config=PlanConfig(**settings))
    assert "\n" not in str(refused.value)


def test_a_waypoint_over_an_obstacle_is_flown_to() -> None:
    low = pole(14.0, 8.0, height=6.0)
    mission = MissionConfig(waypoints_ned_m=((14.0, 8.0, 9.0),))
    world = PlanWorld(still(20.0, 6.0), config=PlanConfig(obstacles=(low,), mission=mission))
    track = TrueTrack(world)
    world.fly(60.0, until=lambda w: w.flight.phase is Phase.SEARCH)
    assert world.flight.phase is Phase.SEARCH
    assert track.nearest_m((14.0, 8.0, -9.0)) < 0.5
    assert track.clearance_m(low) > 1.0


def test_with_no_estimate_at_the_take_off_obstacles_have_no_place_and_it_lands() -> None:
    world = PlanWorld(still(), config=PlanConfig(obstacles=(pole(5.0, 0.1),)))
    world.fly(10.0, until=lambda w: phases(w)[-1:] == [Phase.TAKE_OFF])
    world.vehicle_known = False
    world.fly(40.0)
    assert phases(world)[-2:] == [Phase.TAKE_OFF, Phase.ABORT]
    assert ActionKind.LAND in {kind for _, kind in world.autopilot.heard}
    assert any("position of the obstacles unknown" in text for text in world.flight.told("phase"))


def test_an_estimate_that_is_lost_before_the_motors_turn_is_not_flown_by() -> None:
    world = PlanWorld(still())
    world.fly(10.0, until=lambda w: w.autopilot.armed)
    world.vehicle_known = False
    world.fly(10.0)
    assert phases(world)[-2:] == [Phase.ARM, Phase.ABORT]
    assert not world.autopilot.armed


@pytest.mark.parametrize("start_m", [-15.0, -22.0])
def test_a_pad_that_passes_beneath_a_gantry_is_landed_on_beside_it(start_m: float) -> None:
    shapes = (gantry(10.0, 3.0), pole(8.8, 7.0, radius=0.1, height=4.0))
    config = PlanConfig(obstacles=shapes)
    world = PlanWorld(line(1.0, start_m), config=config)
    track = TrueTrack(world)
    world.fly(120.0)
    assert world.flight.phase is Phase.LANDED
    assert world.flight.touch_lateral_m < 0.12
    assert track.clearance_m(*shapes) > config.obstacle_margin_m + VEHICLE.radius_m - 0.3


def test_a_pad_that_stands_beneath_an_obstacle_is_waited_for_within_the_time_limits() -> None:
    shapes = (gantry(10.6, 0.8),)
    mission = MissionConfig(total_timeout_s=80.0)
    world = PlanWorld(still(), config=PlanConfig(obstacles=shapes, obstacle_ceiling_m=10.0, mission=mission))
    track = TrueTrack(world)
    world.fly(200.0)
    assert world.flight.phase is Phase.ABORT
    assert world.flight.told("waiting_over")
    assert world.flight.touch_s is None
    assert track.clearance_m(*shapes) > 1.6
