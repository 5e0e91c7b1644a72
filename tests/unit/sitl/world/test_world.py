"""The world: its parts together, what its sensors see and what it remembers."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    add,
    euler_from_quat,
    quat_from_euler,
    quat_rotate_inverse,
    wrap_angle,
    yaw_from_quat,
)
from companion.base.messages import Outcome, Phase
from companion.config import Box, ConfigError, Cylinder, Shape, validate
from companion.pad import load_pad
from sitl.pad.motion import PadTruth
from sitl.scenario.scenario import PassBounds, Scenario, load_airframe, load_scenario
from sitl.vehicle.quadrotor import QuadrotorState, RotorValues, resting_state
from sitl.world.ground import Obstacles, PadBoard, distance_m, reach_m, rotor_ratios, thrust_ratio
from sitl.world.score import TouchdownDetector, judge
from sitl.world.wind import shear
from sitl.world.world import Effects, World

DT = 0.0025
OFF: RotorValues = (0.0, 0.0, 0.0, 0.0)
STAND = 0.18


def scenario(**values: Any) -> Scenario:
    return validate(Scenario, {"name": "test", "description": "a test", **values}, "test")


def pad_at(north: float, east: float, height: float = 0.3, **motion: Any) -> dict[str, Any]:
    meet = {"point_ned_m": [north, east], "time_s": 0.0, "spread_m": 0.0}
    return {"surface_height_m": height, "motion": {"kind": "static", "meet": meet, **motion}, "heading": 0.0}


def run(world: World, seconds: float, commands: RotorValues = OFF) -> World:
    for _ in range(round(seconds / DT)):
        world.step(commands, DT)
    return world


def put(world: World, height: float, sideways: float = 0.0, **values: Any) -> World:
    """Over the pad, `height` between feet and surface."""
    n, e, d = world.pad_state.position_ned_m
    world.place(QuadrotorState(position_ned_m=(n, e + sideways, d - STAND - height), **values))
    return world


def test_starts_standing_at_home_with_a_drawn_heading() -> None:
    worlds = [World(scenario(), seed) for seed in range(4)]
    for world in worlds:
        assert run(world, 1.0).truth().vehicle_position_ned_m == pytest.approx((0.0, 0.0, -STAND), abs=1e-6)
        assert world.truth().in_contact
        assert world.watch.touchdown is None
        assert not world.watch.crashed
        assert world.state.specific_force_body_m_s2 == pytest.approx((0.0, 0.0, -GRAVITY_M_S2), abs=1e-3)
    headings = {round(yaw_from_quat(world.truth().vehicle_attitude), 3) for world in worlds}
    assert len(headings) == 4


def test_a_disturbance_is_one_more_function() -> None:
    def magnet(effects: Effects, dt_s: float) -> None:
        effects.force_ned_n = add(effects.force_ned_n, (0.0, 2.0 * world.airframe.body.mass_kg, 0.0))

    world = put(World(scenario(), 0), 20.0)
    world.disturbances.append(magnet)
    assert run(world, 0.1).state.velocity_ned_m_s[1] == pytest.approx(0.2, rel=0.02)


def test_starts_on_the_pad_when_the_pad_is_at_home_and_what_moves_at_no_number_is_not_at_rest() -> None:
    world = run(World(scenario(pad=pad_at(0.0, 0.0, 0.3)), 0), 0.5)
    assert world.truth().vehicle_position_ned_m[2] == pytest.approx(-0.3 - STAND, abs=1e-4)
    assert world.at_rest_on_pad
    resting = world.state
    for field in ("velocity_ned_m_s", "rate_body_rad_s"):
        world.state = replace(resting, **{field: (0.0, math.nan, 0.0)})  # type: ignore[arg-type]
        assert not world.at_rest_on_pad


def test_the_same_seed_gives_the_same_flight_to_the_bit_and_another_seed_another() -> None:
    windy = scenario(
        wind={"mean_m_s": 5.0, "turbulence": "light", "gusts": {"amplitude_m_s": 3.0}},
        pad={"motion": {"kind": "random_turns", "speed_m_s": 1.0}},
    )

    def flown(seed: int) -> Any:
        return run(World(windy, seed), 2.0, (0.6, 0.6, 0.6, 0.6)).truth()

    assert flown(7) == flown(7)
    assert flown(7) != flown(8)


def test_a_fixed_start_heading_is_kept_and_leaves_the_wind_as_it_is() -> None:
    wind = {"mean_m_s": 5.0, "turbulence": "light"}
    drawn = World(scenario(wind=wind), 5)
    fixed = World(scenario(wind=wind, start_heading_deg=90.0), 5)
    assert yaw_from_quat(fixed.truth().vehicle_attitude) == pytest.approx(math.pi / 2)
    assert run(drawn, 0.1).wind_ned_m_s == pytest.approx(run(fixed, 0.1).wind_ned_m_s, abs=1e-6)


def test_a_touchdown_is_measured_just_before_contact_and_relative_to_the_pad() -> None:
    pad = pad_at(20.0, 0.0, kind="line", speed_m_s=2.0, course_deg=90.0)
    pad["heading"] = 30.0
    world = World(scenario(pad=pad), 0)
    put(
        world, 0.05, sideways=0.06, velocity_ned_m_s=(0.1, 2.0, 0.2), attitude=quat_from_euler(0.05, 0.0, 0.8)
    )
    world.watch.airborne(2.0)  # as if it had come down from there
    fall_to = math.hypot(0.2, math.sqrt(2 * GRAVITY_M_S2 * 0.05))
    while world.watch.touchdown is None:
        world.step(OFF, DT)
    touchdown = world.watch.touchdown
    assert touchdown.on_pad
    assert touchdown.lateral_error_m == pytest.approx(0.06, abs=0.02)
    assert touchdown.vertical_speed_m_s == pytest.approx(fall_to, abs=0.12)
    assert touchdown.horizontal_speed_m_s == pytest.approx(0.1, abs=0.03)
    assert touchdown.tilt_deg == pytest.approx(math.degrees(0.05), abs=0.1)
    assert touchdown.yaw_error_deg == pytest.approx(math.degrees(0.8) - 30.0, abs=0.1)
    assert touchdown.pad_speed_m_s == pytest.approx(2.0)
    assert not world.watch.crashed
    # what came after contact did not change it
    assert run(world, 2.0).watch.touchdown == touchdown
    assert world.at_rest_on_pad


def test_a_hop_below_a_metre_is_no_flight_and_a_later_flight_replaces_the_touchdown() -> None:
    world = put(World(scenario(pad=pad_at(20.0, 0.0)), 0), 0.1)
    assert run(world, 1.0).watch.touchdown is None
    full: RotorValues = (0.9, 0.9, 0.9, 0.9)
    while world.height_m < 1.5:
        world.step(full, DT)
    run(world, 3.0, (0.46, 0.46, 0.46, 0.46))
    run(world, 3.0)
    assert world.watch.touchdown is not None
    first = world.watch.touchdown.time_s
    while world.height_m < 1.5:
        world.step(full, DT)
    run(world, 6.0)
    assert world.watch.touchdown is not None
    assert world.watch.touchdown.time_s > first


def test_feet_that_touch_the_pad_are_not_above_it_however_little_they_bear() -> None:
    world = put(World(scenario(pad=pad_at(5.0, 5.0)), 0), 1.1)
    assert world.feet_over_pad_m == pytest.approx(1.1)
    most = 0.95 * world.airframe.body.hover_share()
    heights = []
    for _ in range(2000):
        world.step((most,) * 4, DT)
        heights.append((world.contact.on_board > 0, world.feet_over_pad_m))
    assert any(touching for touching, _ in heights)
    assert {height for touching, height in heights if touching} == {0.0}
    assert min(height for touching, height in heights if not touching and height is not None) > 0.0


def test_over_the_pad_and_in_flight_alone_there_is_a_height_over_it() -> None:
    assert World(scenario(pad=pad_at(0.0, 0.0, 0.3)), 0).feet_over_pad_m is None
    assert put(World(scenario(pad=pad_at(5.0, 5.0)), 0), 2.0, sideways=1.0).feet_over_pad_m is None


def test_touching_the_ground_beside_the_pad_is_not_on_the_pad() -> None:
    world = World(scenario(pad=pad_at(20.0, 0.0)), 0)
    world.place(QuadrotorState((17.0, 0.0, -1.3)))
    run(world, 1.0)
    assert world.watch.touchdown is not None
    assert not world.watch.touchdown.on_pad
    assert world.watch.touchdown.lateral_error_m == pytest.approx(3.0, abs=0.05)
    assert not world.at_rest_on_pad


def test_a_fall_from_two_metres_is_a_crash() -> None:
    world = run(put(World(scenario(pad=pad_at(20.0, 0.0)), 0), 2.0), 2.0)
    assert world.watch.crashed
    assert world.watch.touchdown is not None
    assert world.watch.touchdown.impact_speed_m_s > 2.0


def test_lying_on_its_side_or_back_is_a_crash() -> None:
    world = World(scenario(), 0)
    for roll_deg in (70.0, 180.0):
        attitude = quat_from_euler(math.radians(roll_deg), 0.0, 0.0)
        world.place(QuadrotorState((0.0, 0.0, -0.2), attitude=attitude))
        assert run(world, 0.5).watch.crashed
    # tilting that far in the air is only bad style
    world.place(QuadrotorState((0.0, 0.0, -20.0), attitude=quat_from_euler(math.radians(70.0), 0.0, 0.0)))
    assert not run(world, 0.1).watch.crashed


def test_hovering_low_over_the_pad_takes_less_thrust() -> None:
    world = World(scenario(pad=pad_at(20.0, 0.0)), 0)
    share = world.airframe.body.hover_share()
    hover: RotorValues = (share, share, share, share)
    gained = []
    for height in (5.0, 0.05):
        put(world, height, thrust_share=hover)
        world.step(hover, DT)
        gained.append(-world.state.specific_force_body_m_s2[2] / GRAVITY_M_S2)
    assert gained[0] == pytest.approx(1.0, abs=1e-6)
    assert 1.01 < gained[1] < 1.05


def test_wind_tilts_on_the_vehicle() -> None:
    world = World(scenario(wind={"mean_m_s": 8.0, "from_deg": 0.0}, start_heading_deg=0.0), 0)
    share = world.airframe.body.hover_share()
    world.place(QuadrotorState((0.0, 0.0, -20.0), thrust_share=(share, share, share, share)))
    run(world, 0.5, (share, share, share, share))
    assert world.truth().vehicle_velocity_ned_m_s[0] < -0.5
    assert world.truth().wind_ned_m_s == pytest.approx((-8.0 * shear(20.0), 0.0, 0.0), abs=0.1)


@pytest.mark.parametrize("heading_deg", [0, 90, 180, 270])
def test_the_range_is_the_plumb_distance_within_the_cone(heading_deg: int) -> None:
    world = World(scenario(pad=pad_at(20.0, 0.0, 0.5)), 0)
    for roll, distance in (
        (0.0, pytest.approx(2.0 + STAND - 0.08)),
        (0.2, pytest.approx(2.18 - 0.08 * math.cos(0.2), abs=1e-9)),
        (0.3, None),
    ):
        put(world, 2.0, attitude=quat_from_euler(roll, 0.0, math.radians(heading_deg)))
        assert world.ranging((-0.03, 0.0, 0.08), math.radians(15.0))() == distance


def test_the_range_beside_the_pad_is_to_the_ground_or_to_the_boards_edge_whichever_answers_first() -> None:
    world = World(scenario(pad=pad_at(20.0, 0.0, 0.5)), 0)
    sensor = (0.0, 0.0, 0.08)
    put(world, 2.0, sideways=0.65 + 0.3)
    wide, narrow = math.radians(20.0), math.radians(5.0)
    assert world.ranging(sensor, wide)() == pytest.approx(math.hypot(2.1, 0.3))
    assert world.ranging(sensor, narrow)() == pytest.approx(2.6)


def test_truth_a_moment_ago_lies_between_the_steps() -> None:
    pad = {"motion": {"kind": "circle", "speed_m_s": 1.5, "radius_m": 5.0}}
    world = World(scenario(pad=pad), 2)
    world.place(QuadrotorState((0.0, 0.0, -50.0), rate_body_rad_s=(0.0, 0.0, 1.0)))
    told = {}
    for i in range(200):
        world.step((0.5, 0.5, 0.5, 0.5), DT)
        told[i + 1] = world.truth()
    at_step = world.truth_at(160 * DT)
    assert at_step.vehicle_position_ned_m == pytest.approx(told[160].vehicle_position_ned_m, abs=1e-9)
    between = world.truth_at(160.5 * DT)
    assert between.time_s == pytest.approx(160.5 * DT)
    middle = 0.5 * (told[160].vehicle_position_ned_m[2] + told[161].vehicle_position_ned_m[2])
    assert between.vehicle_position_ned_m[2] == pytest.approx(middle, abs=1e-9)
    yaw = [euler_from_quat(t.vehicle_attitude)[2] for t in (told[160], between, told[161])]
    assert wrap_angle(yaw[1] - 0.5 * (yaw[0] + yaw[2])) == pytest.approx(0.0, abs=1e-7)
    assert between.pad_position_ned_m == pytest.approx(
        world.pad_motion.at(160.5 * DT).position_ned_m, abs=1e-5
    )


def test_truth_is_kept_for_three_tenths_of_a_second_and_not_foretold() -> None:
    world = run(World(scenario(), 0), 1.0)
    world.truth_at(world.time_s)
    world.truth_at(world.time_s - 0.3)
    with pytest.raises(ValueError, match="no truth"):
        world.truth_at(world.time_s - 0.5)
    with pytest.raises(ValueError, match="no truth"):
        world.truth_at(world.time_s + 0.01)
    assert World(scenario(), 0).truth_at(-0.05).vehicle_position_ned_m[2] == pytest.approx(-STAND)


def test_an_off_centre_accelerometer_can_be_built_from_what_it_tells() -> None:
    """a = f + w' x r + w x (w x r): the foot of a vehicle that turns about its heading feels the pull."""
    world = World(scenario(), 0)
    world.place(QuadrotorState((0.0, 0.0, -50.0), rate_body_rad_s=(0.0, 0.0, 2.0)))
    world.step(OFF, DT)
    p, q, r = world.state.rate_body_rad_s
    assert (p, q) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert r == pytest.approx(2.0, abs=0.01)
    assert world.state.angular_acceleration_body_rad_s2[2] == pytest.approx(0.0, abs=1e-6)
    down = quat_rotate_inverse(world.truth().vehicle_attitude, (0.0, 0.0, 1.0))
    assert down == pytest.approx((0.0, 0.0, 1.0), abs=1e-9)


# ---------------- What lies under the vehicle, and what it does to the rotors

R = 0.127
ROTORS = ((0.25, 0.0, -0.05), (0.0, 0.25, -0.05), (-0.25, 0.0, -0.05), (0.0, -0.25, -0.05))


def pad_truth(position: Vector3 = (0.0, 0.0, -1.0), heading: float = 0.0) -> PadTruth:
    return PadTruth(0.0, position, ZERO3, ZERO3, heading, 0.0)


def test_thrust_follows_cheeseman_and_bennett_and_is_bounded_where_their_formula_ends() -> None:
    for radii, ratio in ((0.5, 4.0 / 3.0), (1.0, 16.0 / 15.0), (2.0, 64.0 / 63.0), (4.0, 256.0 / 255.0)):
        assert thrust_ratio(radii * R, R) == pytest.approx(ratio)
    for height in (0.4 * R, 0.01, 0.0, -0.2):
        assert thrust_ratio(height, R) == pytest.approx(4.0 / 3.0)
    ratios = [thrust_ratio(0.02 * i, R) for i in range(100)]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[-1] == pytest.approx(1.0, abs=1e-3)


def test_only_rotors_over_the_board_feel_it_and_none_high_up() -> None:
    board = PadBoard(0.5, 0.5)
    # the front rotor's hub is over the rear edge of a high board, the others over the ground
    state = QuadrotorState((-0.6, 0.0, -1.2))
    ratios = rotor_ratios(state, ROTORS, R, board, pad_truth())
    assert ratios[0] == pytest.approx(thrust_ratio(0.25, R))
    assert ratios[1:] == pytest.approx((thrust_ratio(1.25, R),) * 3)
    assert rotor_ratios(QuadrotorState((0.0, 0.0, -5.0)), ROTORS, R, PadBoard(1, 1), pad_truth()) == (1,) * 4


def test_a_tilted_vehicle_has_its_low_rotor_deeper_in_ground_effect() -> None:
    state = QuadrotorState((0.0, 0.0, -0.4), attitude=quat_from_euler(0.2, 0.0, 1.0))
    ratios = rotor_ratios(state, ROTORS, R, PadBoard(0.5, 0.5), pad_truth((50.0, 0.0, -0.1)))
    assert ratios[1] > ratios[0] == pytest.approx(ratios[2])
    assert ratios[0] > ratios[3]


@pytest.mark.parametrize("heading_deg", [0, 90, 180, 270])
def test_the_board_turns_with_the_heading(heading_deg: int) -> None:
    board, heading = PadBoard(2.0, 0.5), math.radians(heading_deg)
    pad = pad_truth((3.0, 4.0, -0.2), heading)
    ahead = (3.0 + 1.5 * math.cos(heading), 4.0 + 1.5 * math.sin(heading))
    aside = (3.0 - 1.5 * math.sin(heading), 4.0 + 1.5 * math.cos(heading))
    assert board.local(pad, (*ahead, -0.2)) == pytest.approx((1.5, 0.0, 0.0), abs=1e-12)
    assert board.local(pad, (*aside, -0.3)) == pytest.approx((0.0, 1.5, -0.1), abs=1e-12)
    assert board.surface_down_m(pad, *ahead) == -0.2
    assert board.surface_down_m(pad, *aside) == 0.0


def test_the_board_has_the_pads_size_and_its_distance_is_to_its_nearest_point() -> None:
    assert PadBoard.of(load_pad("moving_1300")) == PadBoard(0.65, 0.65)
    board, pad = PadBoard(0.5, 0.5), pad_truth()
    assert board.distance_m(pad, (0.2, 0.1, -3.0)) == pytest.approx((0.0, 2.0))
    assert board.distance_m(pad, (0.8, 0.9, -3.0)) == pytest.approx((0.5, 2.0))


# ---------------- test_obstacles

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
    assert not near.watch.crashed
    assert near.truth().obstacle_clearance_m == pytest.approx(1.5 - 1.1 - 0.377, abs=1e-3)
    assert touched.watch.crashed
    assert touched.watch.nearest_obstacle_m is not None
    assert touched.watch.nearest_obstacle_m < 0.0


def test_the_verdict_says_what_it_was() -> None:
    watch = TouchdownDetector()
    watch.beside(-0.1)
    verdict = judge(watch, PassBounds(), at_rest_on_pad=False, disarmed=False, final_phase=Phase.SEARCH)
    assert (verdict.outcome, verdict.failures) == (Outcome.CRASHED, ("touched an obstacle",))


def test_an_obstacle_of_no_kind_is_refused_in_one_line() -> None:
    words = r"obstacles.0.kind: expected one of 'cylinder', 'box', found 'cone'"
    with pytest.raises(ConfigError, match=words):
        scenario(obstacles=[{"kind": "cone", "centre_ned_m": [0, 0]}])


@pytest.mark.parametrize("name", ["obstacles", "gate", "roadside"])
def test_the_app_knows_of_a_shipped_scenarios_obstacles_because_its_settings_list_them(name: str) -> None:
    scenario = load_scenario(name)
    listed = scenario.companion["plan"]["obstacles"]
    assert [shape.model_dump(exclude_defaults=True, mode="json") for shape in scenario.obstacles] == listed
