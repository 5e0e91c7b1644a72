"""The delay of the camera's stamps, learnt from how a swaying vehicle sees a pad."""

from typing import Any

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    Quaternion,
    Vector3,
    add,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    rotation_vector_from_quat,
    subtract,
)
from companion.base.messages import Quantity
from companion.config.estimate import PadFilterConfig
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.camera_check import LARGEST_DELAY_S, CameraCheck
from tests.unit.estimate.pad.pad_sway import FRAME_S, Sway, sightings


def learnt(sway: Sway, duration_s: float = 12.0, frame_s: float = FRAME_S) -> CameraCheck:
    """What is learnt of one flight."""
    motion = MotionHistory(3.0)
    delay = CameraCheck(motion, PadFilterConfig(), 0.65)
    for exposed_s, seen in sightings(sway, motion, duration_s, frame_s):
        delay.take(exposed_s + delay.delay_s, seen, sway.noise_m**2)
    return delay


@pytest.mark.parametrize("late_s", [-0.04, -0.01, 0.0, 0.01, 0.03, 0.09])
@pytest.mark.parametrize("height_m", [0.6, 3.0, 7.0])
def test_a_delay_either_way_is_learnt_to_two_milliseconds(late_s: float, height_m: float) -> None:
    delay = learnt(Sway(late_s, height_m, noise_m=0.002 * height_m))
    assert delay.delay_s == pytest.approx(late_s, abs=0.002)


def test_a_vehicle_that_does_not_turn_learns_nothing() -> None:
    delay = learnt(Sway(0.02, roll_rad=0.0))
    assert abs(delay.delay_s) < 0.001
    assert delay.delay_std_s == pytest.approx(0.03, rel=0.1)


def test_a_pad_that_accelerates_is_no_delay() -> None:
    assert abs(learnt(Sway(0.0, pad_acceleration_m_s2=1.5)).delay_s) < 0.003


def test_half_the_frames_are_enough() -> None:
    assert learnt(Sway(0.02), frame_s=2.0 * FRAME_S).delay_s == pytest.approx(0.02, abs=0.003)


def test_a_sighting_of_something_else_is_passed_over() -> None:
    delay = learnt(Sway(0.01))
    before_s = delay.delay_s
    delay.take(11.95, (5.0, -4.0, 3.0), 0.005**2)
    assert abs(delay.delay_s - before_s) < 0.0005


def test_the_correction_stays_within_its_bound() -> None:
    assert abs(learnt(Sway(-0.13), duration_s=20.0).delay_s) <= LARGEST_DELAY_S


class CorrectedMotion(MotionHistory):
    """Five times a second a fix corrects the attitude, which errs by so much about the axes (rad, NED)."""

    def __init__(self, error_rad: Vector3) -> None:
        super().__init__(3.0)
        self._error_rad, self._rng = error_rad, np.random.default_rng(3)
        self._error, self._next_s = IDENTITY, 0.2

    def add(self, time_s: float, attitude: Quaternion, acceleration_ned_m_s2: Vector3, *rest: Any) -> None:
        if time_s >= self._next_s:
            self._next_s += 0.2
            x, y, z = (self._rng.standard_normal(3) * self._error_rad).tolist()
            error = quat_from_rotation_vector((x, y, z))
            self.correct(rotation_vector_from_quat(quat_multiply(error, quat_conjugate(self._error))))
            self._error = error
        gravity = (0.0, 0.0, GRAVITY_M_S2)
        felt = quat_rotate(self._error, subtract(acceleration_ned_m_s2, gravity))
        super().add(time_s, quat_multiply(self._error, attitude), add(felt, gravity), *rest)


@pytest.mark.parametrize("late_s", [0.0, 0.02])
@pytest.mark.parametrize("error_rad", [(0.0, 0.0, 0.02), (0.01, 0.01, 0.0)], ids=["heading", "horizon"])
def test_a_fix_that_corrects_the_attitude_is_neither_delay_nor_scale(
    late_s: float, error_rad: Vector3
) -> None:
    motion, sway = CorrectedMotion(error_rad), Sway(late_s, height_m=5.0)
    check = CameraCheck(motion, PadFilterConfig(), 0.65)
    for exposed_s, seen in sightings(sway, motion, 12.0):
        check.take(exposed_s + check.delay_s, seen, sway.noise_m**2)
    assert check.delay_s == pytest.approx(late_s, abs=0.001)
    scale, std = check.scale
    assert abs(scale - 1.0) <= std


class LateMotion(MotionHistory):
    """Samples that a link dates late by so much; what the check takes off it is taken off."""

    def __init__(self, late_s: float) -> None:
        super().__init__(3.0)
        self.late_s = late_s
        self.check: CameraCheck | None = None

    def add(self, time_s: float, attitude: Quaternion, acceleration_ned_m_s2: Vector3, *rest: Any) -> None:
        corrected_s = 0.0 if self.check is None else self.check.link_delay_s
        super().add(time_s + self.late_s - corrected_s, attitude, acceleration_ned_m_s2, *rest)


@pytest.mark.parametrize(
    ("by_link", "late_s", "half_trip_s", "links_s", "quantity"),
    [
        (True, 0.04, 0.045, 0.04, Quantity.LINK_DELAY),
        (True, 0.06, 0.1, 0.06, Quantity.LINK_DELAY),
        # what a link of 20 ms cannot be late by is the camera's, and what it hears sooner delays nothing
        (True, 0.04, 0.01, 0.01, Quantity.CAMERA_DELAY),
        (True, -0.03, 0.1, 0.0, Quantity.LINK_DELAY),
        (True, 0.04, 0.0, 0.0, Quantity.CAMERA_DELAY),  # a link whose round trip nobody has measured
        (False, 0.04, 0.1, 0.0, Quantity.CAMERA_DELAY),
    ],
)
def test_what_the_link_dates_late_is_dated_anew_as_far_as_its_round_trip_can_explain_it(
    by_link: bool, late_s: float, half_trip_s: float, links_s: float, quantity: Quantity
) -> None:
    motion = LateMotion(late_s)
    check = motion.check = CameraCheck(motion, PadFilterConfig(), 0.65)
    check.imu_by_link, check.half_trip_s = by_link, half_trip_s
    for exposed_s, seen in sightings(Sway(0.0), motion, 16.0):
        check.take(exposed_s + check.frame_delay_s, seen, 0.005**2)
    assert check.link_delay_s == pytest.approx(links_s, abs=0.003)
    assert check.frame_delay_s == pytest.approx(late_s - links_s, abs=0.003)
    assert quantity in [comparison.quantity for comparison in check.comparisons]
