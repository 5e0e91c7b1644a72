"""The delay of the camera's stamps, learnt from how a swaying vehicle sees a pad."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    Quaternion,
    Vector3,
    quat_from_euler,
    quat_rotate,
    quat_rotate_inverse,
    subtract,
)
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.camera_delay import LARGEST_S, CameraDelay

IMU_S = 0.005
FRAME_S = 1.0 / 30.0
LATENCY_S = 0.1


@dataclass(frozen=True)
class Sway:
    """A vehicle that rolls and pitches under its own thrust over a pad that drives, seen `late_s` late."""

    late_s: float
    height_m: float = 3.0
    roll_rad: float = 0.06
    noise_m: float = 0.005
    pad_speed_m_s: float = 1.0
    pad_acceleration_m_s2: float = 0.0

    def attitude(self, time_s: float) -> Quaternion:
        return quat_from_euler(
            self.roll_rad * math.sin(6.0 * time_s), 0.5 * self.roll_rad * math.sin(8.0 * time_s), 0.3
        )

    def acceleration(self, time_s: float) -> Vector3:
        x, y, z = quat_rotate(self.attitude(time_s), (0.0, 0.0, -GRAVITY_M_S2))
        return (x, y, z + GRAVITY_M_S2)

    def pad(self, time_s: float) -> Vector3:
        return (self.pad_speed_m_s * time_s + 0.5 * self.pad_acceleration_m_s2 * time_s**2, 0.0, 0.0)


def learnt(sway: Sway, duration_s: float = 12.0, frame_s: float = FRAME_S) -> CameraDelay:
    """What is learnt of one flight."""
    rng, motion = np.random.default_rng(7), MotionHistory(3.0)
    delay = CameraDelay(motion, 0.01)
    position = np.array([0.0, 0.0, -sway.height_m])
    velocity = np.zeros(3)
    places: list[Vector3] = []
    exposed_s = 0.1
    for k in range(round(duration_s / IMU_S)):
        now_s = k * IMU_S
        motion.add(now_s, sway.attitude(now_s), sway.acceleration(now_s))
        places.append((float(position[0]), float(position[1]), float(position[2])))
        acceleration = np.array(sway.acceleration(now_s))
        position = position + velocity * IMU_S + 0.5 * acceleration * IMU_S**2
        velocity = velocity + acceleration * IMU_S
        if now_s >= exposed_s + LATENCY_S:
            truly = round((exposed_s + sway.late_s) / IMU_S)
            relative = subtract(sway.pad(truly * IMU_S), places[truly])
            seen = np.array(quat_rotate_inverse(sway.attitude(truly * IMU_S), relative))
            x, y, z = (seen + sway.noise_m * rng.standard_normal(3)).tolist()
            delay.take(exposed_s + delay.delay_s, (x, y, z), sway.noise_m**2)
            exposed_s += frame_s
    return delay


@pytest.mark.parametrize("late_s", [-0.03, -0.01, 0.0, 0.01, 0.03])
@pytest.mark.parametrize("height_m", [0.6, 3.0, 7.0])
def test_a_delay_either_way_is_learnt_to_two_milliseconds(late_s: float, height_m: float) -> None:
    delay = learnt(Sway(late_s, height_m, noise_m=0.002 * height_m))
    assert delay.delay_s == pytest.approx(late_s, abs=0.002)


def test_a_vehicle_that_does_not_turn_learns_nothing() -> None:
    delay = learnt(Sway(0.02, roll_rad=0.0))
    assert abs(delay.delay_s) < 0.001
    assert delay.std_s == pytest.approx(0.01, rel=0.1)


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
    assert abs(learnt(Sway(0.09), duration_s=20.0).delay_s) <= LARGEST_S
