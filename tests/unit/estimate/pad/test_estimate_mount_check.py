"""A camera that is turned against the vehicle's file is noticed by how the pad seems to move."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import Vector3, add, quat_from_euler, quat_rotate, subtract
from companion.base.messages import PadSighting, Quantity, SourceComparison
from companion.base.second_sources import TABLE, refused
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.mount_check import MountCheck
from tests.unit.estimate.estimate_flight import VEHICLE, EstimateFlight, feed, new_estimator, sprint
from tests.unit.estimate.pad.pad_sway import FRAME_S, Sway, sightings

CAMERA: Vector3 = (0.03, 0.0, 0.08)
ROW = TABLE[Quantity.CAMERA_ROTATION]


def checked(
    sway: Sway, turned_deg: float = 0.0, duration_s: float = 12.0, scale: float = 1.0
) -> SourceComparison | None:
    """The mount's comparison after a flight whose camera is turned so far, if it is announced.

    The file says 0, so the app takes what is towards the image's top for ahead.
    """
    motion = MotionHistory(3.0)
    check = MountCheck(motion, CAMERA)
    turn = quat_from_euler(0.0, 0.0, -math.radians(turned_deg))
    for exposed_s, (x, y, z) in sightings(sway, motion, duration_s, FRAME_S):
        taken = quat_rotate(turn, (x - CAMERA[0], y - CAMERA[1], z - CAMERA[2]))
        check.take(exposed_s, add(taken, CAMERA), sway.noise_m**2)
    return next((found for found in check.comparisons if ROW.announces(found)), None)


@pytest.mark.parametrize("turned_deg", [0.0, 90.0])
def test_sightings_of_something_else_take_no_verdict_away(turned_deg: float) -> None:
    """Five in ten seconds, some metres beside the pad: their way is no pad's, turned or not."""
    sway, motion, rng = Sway(0.0, height_m=7.0, noise_m=0.014), MotionHistory(3.0), np.random.default_rng(4)
    check, turn = MountCheck(motion, CAMERA), quat_from_euler(0.0, 0.0, -math.radians(turned_deg))
    for k, (exposed_s, seen) in enumerate(sightings(sway, motion, 12.0, FRAME_S)):
        taken = quat_rotate(turn, subtract(seen, CAMERA))
        if k >= 100 and k % 40 == 0:
            taken = add(taken, (*rng.uniform(-3.0, 3.0, 2).tolist(), 0.0))
        check.take(exposed_s, add(taken, CAMERA), sway.noise_m**2)
    (found,) = check.comparisons
    assert found.difference == pytest.approx(turned_deg, abs=5.0)


@pytest.mark.parametrize("turned_deg", [90.0, -90.0, 179.0, 45.0])
@pytest.mark.parametrize("height_m", [1.5, 7.0])
def test_a_camera_that_is_turned_is_reported_with_its_angle(turned_deg: float, height_m: float) -> None:
    told = checked(Sway(0.0, height_m, noise_m=0.002 * height_m), turned_deg)
    assert told is not None
    assert told.difference == pytest.approx(abs(turned_deg), abs=8.0)
    assert (told.first, ROW.refuses(told)) == ("0 deg", True)
    assert float(told.second.removesuffix(" deg")) == pytest.approx(turned_deg, abs=8.0)


@pytest.mark.parametrize(
    "sway",
    [
        Sway(0.0),
        Sway(0.0, height_m=7.0, noise_m=0.03),
        Sway(0.03),
        Sway(0.0, pad_speed_m_s=4.0),
        Sway(0.0, pad_acceleration_m_s2=1.5),
        Sway(0.0, roll_rad=0.0),
        Sway(0.0, roll_rad=0.0, pad_acceleration_m_s2=1.5),
        Sway(0.0, roll_rad=0.01, noise_m=0.05),
    ],
    ids=str,
)
def test_a_camera_that_sits_right_is_not_reported(sway: Sway) -> None:
    assert checked(sway) is None


def test_what_a_calibration_leaves_is_not_reported() -> None:
    assert checked(Sway(0.0), turned_deg=5.0) is None


def test_a_vehicle_that_does_not_turn_shows_nothing() -> None:
    assert checked(Sway(0.0, roll_rad=0.0), turned_deg=90.0) is None


def test_a_small_turn_shows_from_high_up() -> None:
    told = checked(Sway(0.0, height_m=7.0, noise_m=0.014), turned_deg=-18.0)
    assert told is not None
    assert told.difference == pytest.approx(18.0, abs=5.0)
    assert not ROW.refuses(told)


@pytest.mark.parametrize("late_s", [0.09, -0.09])
def test_stamps_that_are_late_are_no_turn(late_s: float) -> None:
    assert checked(Sway(late_s, height_m=7.0)) is None


def test_another_mission_is_not_refused_by_what_the_last_one_has_shown() -> None:
    """The camera may have been mended, and nothing new is compared before the pad is seen again."""
    estimator = new_estimator()
    for _, sample in EstimateFlight(path=sprint, duration_s=16.0).samples:
        if isinstance(sample, PadSighting):  # by a camera that is turned by a right angle
            x, y, z = subtract(sample.pad_position_body_m, VEHICLE.camera_position_body_m)
            turned = add((-y, x, z), VEHICLE.camera_position_body_m)
            feed(estimator, replace(sample, pad_position_body_m=turned))
        else:
            feed(estimator, sample)
        if Quantity.CAMERA_ROTATION in dict(refused(estimator.comparisons)):
            break
    assert Quantity.CAMERA_ROTATION in dict(refused(estimator.comparisons))
    estimator.begin_checks()
    assert list(refused(estimator.comparisons)) == []
