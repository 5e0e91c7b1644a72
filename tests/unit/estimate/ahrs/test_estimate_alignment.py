"""Standing still is recognised, and yields attitude and gyroscope bias."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, Vector3, vector3
from companion.config import AlignmentConfig
from companion.estimate.ahrs.alignment import Block, InitialAlignment, StaticAligner, StillnessDetector

CONFIG = AlignmentConfig(still_s=1.0, timeout_s=4.0)
BIAS = (0.02, -0.01, 0.005)


def run(
    duration_s: float,
    force_noise: float = 0.03,
    rate_noise: float = 0.002,
    moving_until_s: float = 0.0,
    field: bool = True,
) -> tuple[float, InitialAlignment] | None:
    rng = np.random.default_rng(1)
    detector, aligner = StillnessDetector(CONFIG), StaticAligner(CONFIG)
    for k in range(int(duration_s * 200)):
        t = k / 200
        shake = 1.0 if t < moving_until_s else 0.0
        rate = vector3(BIAS + (rate_noise + 0.3 * shake) * rng.normal(size=3))
        force = vector3((0.0, 0.0, -GRAVITY_M_S2) + (force_noise + shake) * rng.normal(size=3))
        if field:
            aligner.add_field((20.0, 0.0, 40.0))
        block = detector.add(t, rate, force)
        found = aligner.add_block(t, block) if block else None
        if found:
            return t, found
    return None


def test_still_vehicle_is_aligned_after_the_asked_time() -> None:
    result = run(3.0)
    assert result is not None
    time_s, found = result
    assert 1.0 <= time_s < 1.2
    assert found.still
    assert found.rate_body_rad_s == pytest.approx(BIAS, abs=5e-4)
    assert found.specific_force_body_m_s2 == pytest.approx((0.0, 0.0, -GRAVITY_M_S2), abs=0.01)
    assert found.field_body_ut == pytest.approx((20.0, 0.0, 40.0))


def test_motion_starts_the_count_again() -> None:
    result = run(5.0, moving_until_s=1.5)
    assert result is not None
    assert result[0] >= 2.5
    assert result[1].rate_body_rad_s == pytest.approx(BIAS, abs=5e-4)


def test_vibration_is_not_standing_still() -> None:
    assert run(3.5, force_noise=1.0) is None


def test_when_it_never_stands_still_the_time_runs_out() -> None:
    result = run(7.0, force_noise=1.0)
    assert result is not None
    assert result[0] > CONFIG.timeout_s
    assert not result[1].still


def test_without_a_magnetometer_there_is_no_alignment() -> None:
    assert run(8.0, field=False) is None


@pytest.mark.parametrize("rate", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0)])
def test_block_judges_spread_and_not_size(rate: Vector3) -> None:
    detector = StillnessDetector(CONFIG)
    blocks = [detector.add(k / 200, rate, (0.0, 0.0, -9.8)) for k in range(30)]
    finished = [block for block in blocks if block]
    assert len(finished) == 1
    assert finished[0].still
    assert finished[0].rate_body_rad_s == pytest.approx(rate)


def run_tilting(
    rate_rad_s: float, period_s: float, seconds: float, config: AlignmentConfig = CONFIG
) -> tuple[float, InitialAlignment] | None:
    """A deck that rolls to and fro without noise, its greatest rate as given; the field tells the time."""
    detector, aligner = StillnessDetector(config), StaticAligner(config)
    w = math.tau / period_s
    for k in range(int(seconds * 200)):
        t = k / 200
        roll = rate_rad_s / w * math.sin(w * t)
        force = (0.0, -GRAVITY_M_S2 * math.sin(roll), -GRAVITY_M_S2 * math.cos(roll))
        aligner.add_field((20.0, t, 40.0))
        block = detector.add(t, (rate_rad_s * math.cos(w * t), 0.0, 0.0), force)
        found = aligner.add_block(t, block) if block else None
        if found:
            return t, found
    return None


@pytest.mark.parametrize(("rate_rad_s", "period_s"), [(0.05, 3.0), (0.06, 6.0), (0.07, 8.0)])
def test_a_slow_sway_is_not_standing_still(rate_rad_s: float, period_s: float) -> None:
    config = AlignmentConfig()
    assert run_tilting(rate_rad_s, period_s, config.timeout_s, config) is None


def test_each_block_of_a_slow_sway_is_still() -> None:
    detector = StillnessDetector(CONFIG)
    rates = [0.06 * math.cos(math.tau * k / 1200) for k in range(1200)]
    blocks = [detector.add(k / 200, (rate, 0.0, 0.0), (0.0, 0.0, -9.8)) for k, rate in enumerate(rates)]
    assert all(block.still for block in blocks if block), "only blocks side by side tell the sway"


def test_a_start_in_motion_uses_what_is_felt_last() -> None:
    result = run_tilting(0.3, 5.0, 10.0)
    assert result is not None
    time_s, found = result
    assert not found.still
    assert CONFIG.timeout_s < time_s < CONFIG.timeout_s + 0.5
    roll = 0.3 * 5.0 / math.tau * math.sin(math.tau * (time_s - 0.05) / 5.0)
    assert found.specific_force_body_m_s2[1] == pytest.approx(-GRAVITY_M_S2 * math.sin(roll), abs=0.05)
    assert found.rate_body_rad_s[0] == pytest.approx(
        0.3 * math.cos(math.tau * (time_s - 0.05) / 5.0), abs=0.01
    )
    assert found.field_body_ut == (20.0, time_s, 40.0)
    assert found.samples <= 21


def test_a_steady_turn_is_not_standing_still() -> None:
    aligner = StaticAligner(CONFIG)
    aligner.add_field((20.0, 0.0, 40.0))
    turn = Block((0.0, 0.0, 0.3), (0.0, 0.0, -9.8), 20, still=True)
    assert [aligner.add_block(0.1 * k, turn) for k in range(39)] == [None] * 39
