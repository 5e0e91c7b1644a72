"""What vibration and turns add to the IMU's noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3
from companion.config import EkfConfig
from companion.estimate.vehicle.imu_noise import ImuNoise

DT_S = 0.005
RESTING: Vector3 = (0.0, 0.0, -GRAVITY_M_S2)


def density_of(force_m_s2: np.ndarray) -> float:
    """Of forces (n, 3), in (m/s²)² s."""
    noise = ImuNoise(EkfConfig())
    for sample in force_m_s2.tolist():
        noise.add(ZERO3, tuple(sample), DT_S)
    return noise.now.force_density_m2_s3


def test_white_vibration_leaves_its_own_density() -> None:
    forces = RESTING + 0.5 * np.random.default_rng(3).standard_normal((4000, 3))
    assert density_of(forces) == pytest.approx(0.5**2 * DT_S, rel=0.35)


def test_a_tone_leaves_little_in_the_velocity() -> None:
    times = DT_S * np.arange(4000)
    tone = math.sqrt(2.0) * 0.5 * np.sin(math.tau * 92.0 * times)
    forces = RESTING + tone[:, None] * np.ones(3)
    assert density_of(forces) < 0.05 * 0.5**2 * DT_S


def test_a_vehicle_that_speeds_up_and_brakes_does_not_vibrate() -> None:
    times = DT_S * np.arange(4000)
    forces = RESTING + 3.0 * np.sin(math.tau * 0.5 * times)[:, None] * np.array([1.0, 0.0, 0.0])
    assert density_of(forces) < 0.02**2 * DT_S


@pytest.mark.parametrize(("period_s", "least", "most"), [(math.inf, 0.95, 1.0), (4.0, 0.0, 0.35)])
def test_only_a_turn_that_lasts_counts(period_s: float, least: float, most: float) -> None:
    noise, largest = ImuNoise(EkfConfig()), 0.0
    for k in range(4000):
        rate = math.cos(math.tau * k * DT_S / period_s)
        noise.add((rate, 0.0, 0.0), RESTING, DT_S)
        largest = max(largest, noise.now.lasting_rate_rad_s[0])
    assert least <= largest <= most
