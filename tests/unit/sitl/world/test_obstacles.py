import math

import numpy as np
import pytest

from companion.base.messages import Outcome, Phase
from companion.config import Box, ConfigError, Cylinder, Shape, validate
from sitl.scenario.scenario import PassBounds, Scenario, load_airframe, load_scenario
from sitl.vehicle.quadrotor import resting_state
from sitl.world.ground import Obstacles, distance_m, reach_m
from sitl.world.score import judge
from sitl.world.world import World

POLE = Cylinder(kind="cylinder", centre_ned_m=(3.0, 4.0), radius_m=1.0, height_m=2.0)
WALL = Box(kind="box", centre_ned_m=(3.0, 4.0), length_m=4.0, width_m=1.0, heading_deg=30.0, height_m=2.0)


@pytest.mark.parametrize("shape", [POLE, WALL])
def test_the_distance_is_that_to_the_nearest_point_of_the_surface(shape: Shape) -> None:
    # against a cloud of points within the obstacle, which the simulator knows nothing of
    rng = np.random.default_rng(0)
    if isinstance(shape, Cylinder):
        r, turn = shape.radius_m * np.sqrt(rng.random(60_000)), rng.uniform(0.0, 2.0 * np.pi, 60_000)
        north, east = 3.0 + r * np.cos(turn), 4.0 + r * np.sin(turn)
    else:
        along, across = rng.uniform(-2.0, 2.0, 60_000), rng.uniform(-0.5, 0.5, 60_000)
        c, s = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
        north, east = 3.0 + c * along - s * across, 4.0 + s * along + c * across
    cloud = np.stack((north, east, -rng.uniform(0.0, 2.0, 60_000)), axis=1)
    for place in ((0.0, 0.0, -1.0), (6.0, 7.0, -4.0), (3.0, 4.0, -5.0), (2.0, 9.0, -0.5), (3.0, 4.0, -1.0)):
        nearest = float(np.min(np.linalg.norm(cloud - np.array(place), axis=1)))
        assert distance_m(place, shape) == pytest.approx(nearest, abs=0.12)


def test_the_clearance_counts_from_the_rotors_tips() -> None:
    body = load_airframe("x500").body
    assert reach_m(body) == pytest.approx(0.377)
    assert Obstacles((POLE, WALL), body).clearance_m((3.0, 4.0, -5.0)) == pytest.approx(3.0 - 0.377)
    assert Obstacles((), body).clearance_m((3.0, 4.0, -5.0)) is None


def world_at(east_m: float) -> World:
    pole = Cylinder(kind="cylinder", centre_ned_m=(0.0, 2.0), radius_m=0.5, height_m=9.0)
    world = World(Scenario(name="poles", description="one pole", obstacles=(pole,)), 0)
    world.place(resting_state((0.0, east_m, -5.0), 0.0))
    world.step((0.5, 0.5, 0.5, 0.5), 0.0025)
    return world


def test_touching_one_is_a_crash_and_passing_close_by_is_not() -> None:
    near, touched = world_at(1.1), world_at(1.13)
    assert not near.crashed
    assert near.truth().obstacle_clearance_m == pytest.approx(1.5 - 1.1 - 0.377, abs=1e-3)
    assert touched.crashed
    assert touched.nearest_obstacle_m is not None
    assert touched.nearest_obstacle_m < 0.0


def test_the_verdict_says_what_it_was() -> None:
    verdict = judge(
        None,
        PassBounds(),
        contacts=(),
        crashed=True,
        at_rest_on_pad=False,
        disarmed=False,
        final_phase=Phase.SEARCH,
        nearest_obstacle_m=-0.1,
    )
    assert (verdict.outcome, verdict.failures) == (Outcome.CRASHED, ("touched an obstacle",))


def test_an_obstacle_of_no_kind_is_refused_in_one_line() -> None:
    with pytest.raises(
        ConfigError, match=r"obstacles.0.kind: expected one of 'cylinder', 'box', found 'cone'"
    ):
        validate(
            Scenario,
            {"name": "x", "description": "y", "obstacles": [{"kind": "cone", "centre_ned_m": [0, 0]}]},
            "file",
        )


@pytest.mark.parametrize("name", ["obstacles", "gate", "roadside"])
def test_the_app_knows_of_a_shipped_scenarios_obstacles_because_its_settings_list_them(name: str) -> None:
    scenario = load_scenario(name)
    listed = scenario.companion["plan"]["obstacles"]
    assert [shape.model_dump(exclude_defaults=True, mode="json") for shape in scenario.obstacles] == listed
