"""What the builder got wrong: drawn by the seed, given to the world, and to nobody who believed otherwise."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, norm
from companion.config import ConfigError, validate
from companion.pad import load_pad
from sitl.faults.faulty_link import LinkSettings
from sitl.scenario.as_built import AS_BELIEVED, NOTHING_ELSE, AsBuiltSettings, BuiltVehicle, draw
from sitl.scenario.scenario import Scenario, load_airframe
from sitl.sensors.inertial import felt_at
from sitl.vehicle.quadrotor import Motors, QuadrotorState
from sitl.vehicle.rotors import RotorValues
from sitl.world.world import World

SEEDS = range(200)
BODY = load_airframe("x500").body


def scenario(**section: Any) -> Scenario:
    return Scenario.model_validate({"name": "t", "description": "t", "as_built": section})


def test_every_error_is_drawn_within_its_size_on_both_sides_and_by_the_seed() -> None:
    drawn = [draw(AsBuiltSettings(), seed) for seed in SEEDS]
    assert drawn[3] == draw(AsBuiltSettings(), 3)
    bounds = {
        "hover_thrust": (0.65, 1.35), "thrust_exponent": (0.6, 2.0), "mass": (0.8, 1.2),
        "leg_height_m": (-0.03, 0.03), "focal_length": (0.985, 1.015), "pad_print": (0.985, 1.015),
        "stamp_s": (-0.02, 0.02), "delay_to_app_s": (0.0, 0.04), "delay_to_vehicle_s": (0.0, 0.04),
        "vibration": (1.0, 15.0), "yaw_reset_deg": (-15.0, 15.0),
    }  # fmt: skip
    for name, (low, high) in bounds.items():
        found = [getattr(built, name) for built in drawn]
        assert low <= min(found) < low + 0.1 * (high - low), name
        assert high - 0.1 * (high - low) < max(found) <= high, name
    assert max(norm(built.imu_offset_body_m) for built in drawn) <= 0.1
    assert all(min(built.delay_to_app_s, built.delay_to_vehicle_s) == 0.0 for built in drawn)


def test_the_size_of_one_error_leaves_the_others_as_they_are() -> None:
    usual, other = draw(AsBuiltSettings(), 7), draw(AsBuiltSettings(mass=0.0), 7)
    changed = {f.name for f in fields(BuiltVehicle) if getattr(usual, f.name) != getattr(other, f.name)}
    assert (changed, other.mass) == ({"mass"}, 1.0)


def test_without_the_section_and_with_all_left_out_all_is_as_believed() -> None:
    assert draw(None, 5) == AS_BELIEVED
    left_out = draw(AsBuiltSettings(**NOTHING_ELSE), 5)
    when = {"yaw_reset_s"}  # of a reset by nothing
    assert all(
        np.all(np.equal(getattr(left_out, f.name), getattr(AS_BELIEVED, f.name)))
        for f in fields(BuiltVehicle)
        if f.name not in when
    )


def test_a_value_that_is_set_is_not_drawn_and_a_wrong_one_is_refused_in_one_line() -> None:
    section = {**NOTHING_ELSE, "exactly": {"hover_thrust": 0.6, "imu_offset_body_m": [0.1, 0.0, 0.0]}}
    built = scenario(**section).built(1)
    assert (built.hover_thrust, built.imu_offset_body_m, built.mass) == (0.6, (0.1, 0.0, 0.0), 1.0)
    for wrong in ({"hover": 0.6}, {"hover_thrust": [0.6, 0.7]}, {"place_deg": 3.0}):
        with pytest.raises(ConfigError, match="exactly: "):
            validate(AsBuiltSettings, {"exactly": wrong}, "a.yaml")


@pytest.mark.parametrize("seed", range(20))
def test_what_it_hovers_at_is_what_was_told_over_the_error(seed: int) -> None:
    """The world's rotors at the true command carry the true weight; the autopilot believes the told one."""
    built = draw(AsBuiltSettings(), seed)
    body = built.body(BODY)
    true = BODY.hover_share() / built.hover_thrust
    (thrust, *_) = Motors(built.thrust_exponent).given((true,) * 4)
    assert 4.0 * thrust * body.max_thrust_n == pytest.approx(built.mass * BODY.mass_kg * GRAVITY_M_S2)
    assert built.told_body(BODY).hover_share() == pytest.approx(BODY.hover_share())


@pytest.mark.parametrize("seed", range(20))
def test_the_rate_loops_are_tuned_on_what_was_built(seed: int) -> None:
    """A change of command about hover gives the torque that the autopilot's mixer takes it for."""
    built = draw(AsBuiltSettings(), seed)
    true, step = BODY.hover_share() / built.hover_thrust, 1e-4
    motors, full_n = Motors(built.thrust_exponent), built.body(BODY).max_thrust_n
    low, high = (motors.given((true + by,) * 4)[0] * full_n for by in (-step, step))
    assert (high - low) / (2.0 * step) == pytest.approx(built.told_body(BODY).max_thrust_n, rel=1e-4)
    assert built.rate_scale(BODY) == pytest.approx(BODY.max_thrust_n / built.told_body(BODY).max_thrust_n)


def test_the_world_stands_on_its_own_legs_and_its_own_print() -> None:
    exactly = {"leg_height_m": 0.03, "pad_print": 0.985, "mass": 1.2}
    world = World(scenario(**{**NOTHING_ELSE, "exactly": exactly}), 0)
    assert world.landed_reference_height_m == pytest.approx(0.21)
    assert world.board.half_length_m == pytest.approx(0.5 * 0.985 * load_pad("moving_1300").length_m)
    assert world.airframe.body.mass_kg == pytest.approx(1.2 * world.believed_airframe.body.mass_kg)
    world.step((0.0,) * 4, 0.0025)
    assert world.truth().in_contact or world.height_m == pytest.approx(0.21, abs=1e-3)


def test_the_app_is_told_nothing_of_it() -> None:
    """Its field is that of the place in the scenario, wherever it flies."""
    believed = Scenario.model_validate({"name": "t", "description": "t"})
    as_built = scenario()
    assert as_built.operator_settings == believed.operator_settings
    assert as_built.built(0).home(as_built.place)[:2] != believed.place[:2]


def test_an_imu_off_the_centre_feels_the_turning() -> None:
    spinning = QuadrotorState((0.0, 0.0, 0.0), rate_body_rad_s=(0.0, 0.0, 3.0))
    ahead = felt_at((0.1, 0.0, 0.0), spinning)
    assert ahead == pytest.approx((-0.9, 0.0, -GRAVITY_M_S2))  # centripetal
    turning = QuadrotorState((0.0, 0.0, 0.0), angular_acceleration_body_rad_s2=(0.0, 5.0, 0.0))
    assert felt_at((0.1, 0.0, 0.0), turning) == pytest.approx((0.0, 0.0, -GRAVITY_M_S2 - 0.5))
    assert felt_at(ZERO3, spinning) is spinning.specific_force_body_m_s2


def test_a_delay_is_on_one_side_of_the_line() -> None:
    line = LinkSettings(delay_s=0.01)
    to_app, to_vehicle = BuiltVehicle(delay_to_app_s=0.03).links(line)
    assert to_app.delay_s == pytest.approx(0.04)
    assert to_vehicle.delay_s == 0.01
    assert to_vehicle is line


def test_motors_that_are_believed_rightly_pass_the_command_on() -> None:
    command: RotorValues = (0.1, 0.2, 0.3, 0.4)
    assert Motors().given(command) is command
    assert Motors(2.0).given((0.5, 0.5, -0.1, 1.2)) == pytest.approx((0.25, 0.25, 0.0, 1.0))
