"""What is known of the ground without eyes: echoes that agree, and the height over home."""

import math
from dataclasses import replace

import pytest

from companion.base.geometry import quat_from_euler
from companion.base.messages import AutopilotState, RangeSample, VehicleState
from companion.plan.landing.height_above_ground import HeightAboveGround
from tests.unit.plan.pad_paths import still
from tests.unit.plan.plan_harness import PlanWorld

SENSOR_M = (-0.03, 0.0, 0.08)
SILENT = AutopilotState(0.0)


def state(down_m: float = -5.0, roll_rad: float = 0.0) -> VehicleState:
    vehicle = PlanWorld(still()).inputs().vehicle
    assert vehicle is not None
    return replace(vehicle, position_ned_m=(0.0, 0.0, down_m), attitude=quat_from_euler(roll_rad, 0.0, 0.7))


def after(*distances_m: float, roll_rad: float = 0.0, late_s: float = 0.0) -> HeightAboveGround:
    ground = HeightAboveGround(SENSOR_M)
    for k, distance_m in enumerate(distances_m):
        for _ in range(3):  # the same echo is there for several cycles
            ground.update(state(roll_rad=roll_rad), SILENT, RangeSample(k / 15.0, distance_m), k / 15.0)
    ground.update(state(roll_rad=roll_rad), SILENT, None, (len(distances_m) - 1) / 15.0 + late_s)
    return ground


def test_three_echoes_that_agree_tell_the_height_over_what_lies_below() -> None:
    assert after(1.0, 1.1, 0.9).surface_m == pytest.approx(1.08)
    assert after(1.0, 1.1).surface_m is None


def test_a_spike_is_not_believed_until_it_is_gone() -> None:
    assert after(3.0, 3.0, 0.3).surface_m is None
    assert after(3.0, 0.3, 3.0, 3.0).surface_m is None
    assert after(0.3, 3.0, 3.0, 3.0).surface_m == pytest.approx(3.08)


def test_old_echoes_say_nothing() -> None:
    assert after(1.0, 1.0, 1.0, late_s=0.3).surface_m is not None
    assert after(1.0, 1.0, 1.0, late_s=0.4).surface_m is None


@pytest.mark.parametrize("roll_deg", [-25.0, 25.0])
def test_a_slanted_echo_is_shortened_to_the_vertical(roll_deg: float) -> None:
    roll = math.radians(roll_deg)
    assert after(2.0, 2.0, 2.0, roll_rad=roll).surface_m == pytest.approx(2.08 * math.cos(roll))


def test_the_height_over_home_is_the_autopilots_else_our_own_climb() -> None:
    ground = HeightAboveGround(SENSOR_M)
    ground.update(state(-5.0), SILENT, None, 0.0)
    assert ground.over_home_m is None
    assert ground.floor_down_m(1.5) == math.inf
    ground.stands_here(state(-2.0))
    ground.update(state(-5.0), SILENT, None, 0.0)
    assert ground.over_home_m == pytest.approx(3.0)
    told = replace(SILENT, home=(47.0, 8.0, 400.0), global_position=(47.0, 8.0, 404.0))
    ground.update(state(-5.0), told, None, 0.0)
    assert ground.over_home_m == pytest.approx(4.0)


def test_the_floor_is_over_the_higher_of_home_and_the_echoes_surface() -> None:
    ground = HeightAboveGround(SENSOR_M)
    told = replace(SILENT, home=(47.0, 8.0, 400.0), global_position=(47.0, 8.0, 404.0))
    ground.update(state(-5.0), told, None, 0.0)
    assert ground.floor_down_m(1.5) == pytest.approx(-5.0 + 4.0 - 1.5)
    for k in range(3):
        ground.update(state(-5.0), told, RangeSample(k / 15.0, 1.0), k / 15.0)
    assert ground.clearance_m == pytest.approx(1.08)
    assert ground.floor_down_m(1.5) == pytest.approx(-5.0 + 1.08 - 1.5)
