"""Where the accelerometer is: learnt from what it feels across the thrust while the vehicle turns."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3, add, cross, scale, subtract, vector3
from companion.estimate.vehicle.lever_arm import LeverArm

STEP_S = 0.005
NOISE_M_S2 = 0.5
RATE_NOISE_RAD_S = 0.01


@dataclass
class SwingFlight:
    """Swings under its own thrust in a turbulent wind: 0.3 m2/s5 of random walk, an x500's in 8 m/s."""

    imu_body_m: Vector3
    swing_rad: float = 0.08
    in_air: bool = True
    pivot_body_m: Vector3 | None = None  # what it turns about instead, and gravity is felt across

    def fly(self, arm: LeverArm, duration_s: float) -> Vector3:
        """The arm is fed; returns the largest force (m/s2) of turning that is left in the last second."""
        rng, wind, last, largest = np.random.default_rng(5), np.zeros(3), None, np.zeros(3)
        arm.in_air = self.in_air
        for k in range(round(duration_s / STEP_S)):
            t = k * STEP_S
            w = np.array([10.0, 8.0, 1.0])
            angle = self.swing_rad * np.array([math.sin(10.0 * t), math.sin(8.0 * t), math.sin(t)])
            rate = self.swing_rad * w * np.array([math.cos(10.0 * t), math.cos(8.0 * t), math.cos(t)])
            alpha, rate_m = vector3(-(w**2) * angle), vector3(rate)
            wind = wind + math.sqrt(0.3 * STEP_S) * rng.standard_normal(3) * (1.0, 1.0, 5.0)
            felt = (0.0, 0.0, -GRAVITY_M_S2) if self.pivot_body_m is None else self._held(angle, alpha)
            turning = add(cross(alpha, self.imu_body_m), cross(rate_m, cross(rate_m, self.imu_body_m)))
            noise = NOISE_M_S2 * rng.standard_normal(3)
            force = vector3(np.array(add(felt, turning)) + wind + noise)
            seen = vector3(rate + RATE_NOISE_RAD_S * rng.standard_normal(3))
            if last is not None:
                density, turn_density = NOISE_M_S2**2 * STEP_S, RATE_NOISE_RAD_S**2 * STEP_S
                middle = scale(add(last, seen), 0.5)
                arm.add(middle, force, STEP_S, density, turn_density)
                if t > duration_s - 1.0:
                    left = subtract(
                        turning, arm.felt_m_s2(vector3(rate - STEP_S * np.array(alpha)), rate_m, STEP_S)
                    )
                    largest = np.maximum(largest, np.abs(left))
            last = seen
        return vector3(largest)

    def _held(self, angle: np.ndarray, alpha: Vector3) -> Vector3:
        assert self.pivot_body_m is not None
        x, y, _ = angle
        up = (GRAVITY_M_S2 * y, -GRAVITY_M_S2 * x, -GRAVITY_M_S2)
        return add(up, cross(alpha, scale(self.pivot_body_m, -1.0)))


@pytest.mark.parametrize("imu_body_m", [(0.0, 0.0, 0.08), (0.05, -0.06, -0.05), ZERO3], ids=str)
def test_an_arm_that_nobody_told_is_learnt_within_seconds_of_a_swing(imu_body_m: Vector3) -> None:
    arm = LeverArm(ZERO3)
    left = SwingFlight(imu_body_m).fly(arm, 10.0)
    error = np.array(subtract(arm.position_body_m, imu_body_m))
    std = np.sqrt(np.diag(arm.covariance_m2))
    assert np.abs(error / std).max() < 3.0
    assert std[2] < 0.01  # by what is felt across the thrust, which closes the loop; 0.08 m there is 0.6 m/s2
    assert max(left[:2]) < 0.06


def test_what_is_told_counts_where_nothing_turns() -> None:
    arm = LeverArm((0.0, 0.0, 0.04))
    SwingFlight((0.0, 0.0, 0.04), swing_rad=0.0).fly(arm, 5.0)
    assert arm.position_body_m == pytest.approx((0.0, 0.0, 0.04), abs=0.03)
    assert min(np.diag(arm.covariance_m2)) > 0.04**2


def test_in_somebodys_hands_or_on_a_rocking_deck_nothing_is_learnt() -> None:
    arm = LeverArm(ZERO3)
    SwingFlight(ZERO3, swing_rad=0.2, in_air=False, pivot_body_m=(0.0, 0.0, 0.8)).fly(arm, 5.0)
    assert arm.position_body_m == ZERO3


def test_a_blow_teaches_nothing() -> None:
    """The feet strike: 30 m/s2 across for 40 ms while it turns."""
    arm = LeverArm(ZERO3)
    SwingFlight((0.0, 0.0, 0.05)).fly(arm, 10.0)
    before = arm.position_body_m
    for k in range(24):
        struck = 30.0 if 8 <= k < 16 else 0.0
        arm.add((0.3 - 0.05 * k, 0.0, 0.0), (0.0, struck, -GRAVITY_M_S2), STEP_S, 0.001, 1e-7)
    assert arm.position_body_m == pytest.approx(before, abs=0.005)
