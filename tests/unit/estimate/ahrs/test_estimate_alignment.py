"""Standing still is recognised, and yields attitude and gyroscope bias."""

import math

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    quat_from_euler,
    quat_rotate_inverse,
    vector3,
)
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
    at_rest_only: bool = True,
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
        if found and (found.still or not at_rest_only):
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


def test_what_never_stands_still_starts_in_motion_after_the_time_of_a_rest() -> None:
    result = run(7.0, force_noise=1.0, at_rest_only=False)
    assert result is not None
    assert CONFIG.still_s - 0.2 < result[0] <= CONFIG.still_s
    assert not result[1].still


def test_a_rest_after_a_start_in_motion_is_looked_for_until_the_time_runs_out() -> None:
    aligner = StaticAligner(CONFIG)
    assert not aligner.expired(0.0)
    aligner.add_block(0.1, Block((0.0, 0.0, 0.0), (0.0, 0.0, -9.8), 20, still=False))
    assert not aligner.expired(CONFIG.timeout_s)
    assert aligner.expired(CONFIG.timeout_s + 0.1)


def test_without_a_magnetometer_there_is_no_alignment() -> None:
    assert run(8.0, field=False, at_rest_only=False) is None


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
) -> list[tuple[float, InitialAlignment]]:
    """A deck that rolls to and fro without noise, at most at this rate; the field is (20, 0, 40) in NED."""
    detector, aligner = StillnessDetector(config), StaticAligner(config)
    w, results = math.tau / period_s, []
    for k in range(int(seconds * 200)):
        t = k / 200
        level = quat_from_euler(roll_at(t, rate_rad_s, period_s), 0.0, 0.0)
        aligner.add_field(quat_rotate_inverse(level, (20.0, 0.0, 40.0)))
        force = quat_rotate_inverse(level, (0.0, 0.0, -GRAVITY_M_S2))
        block = detector.add(t, (rate_rad_s * math.cos(w * t), 0.0, 0.0), force)
        found = aligner.add_block(t, block) if block else None
        if found:
            results.append((t, found))
    return results


def roll_at(time_s: float, rate_rad_s: float, period_s: float) -> float:
    w = math.tau / period_s
    return rate_rad_s / w * math.sin(w * time_s)


@pytest.mark.parametrize(("rate_rad_s", "period_s"), [(0.05, 3.0), (0.06, 6.0), (0.07, 8.0)])
def test_a_slow_sway_is_not_standing_still(rate_rad_s: float, period_s: float) -> None:
    config = AlignmentConfig()
    assert not any(found.still for _, found in run_tilting(rate_rad_s, period_s, config.timeout_s, config))


def test_each_block_of_a_slow_sway_is_still() -> None:
    detector = StillnessDetector(CONFIG)
    rates = [0.06 * math.cos(math.tau * k / 1200) for k in range(1200)]
    blocks = [detector.add(k / 200, (rate, 0.0, 0.0), (0.0, 0.0, -9.8)) for k, rate in enumerate(rates)]
    assert all(block.still for block in blocks if block), "only blocks side by side tell the sway"


def test_a_start_in_motion_turns_what_was_felt_into_the_present_axes() -> None:
    """The roll goes through 14 deg and back meanwhile: a plain mean would be the attitude of no instant."""
    time_s, found = run_tilting(0.3, 5.0, 10.0)[0]
    assert not found.still
    assert CONFIG.still_s - 0.2 < time_s <= CONFIG.still_s
    level = quat_from_euler(roll_at(time_s, 0.3, 5.0), 0.0, 0.0)
    force = quat_rotate_inverse(level, (0.0, 0.0, -GRAVITY_M_S2))
    assert found.specific_force_body_m_s2 == pytest.approx(force, abs=0.05)
    assert found.field_body_ut == pytest.approx(quat_rotate_inverse(level, (20.0, 0.0, 40.0)), abs=0.5)


def test_a_start_in_motion_averages_what_the_vehicle_accelerates_by() -> None:
    """It swings by 3 m/s^2 to and fro, twice a second: the last sample alone is 17 deg off."""
    detector, aligner = StillnessDetector(CONFIG), StaticAligner(CONFIG)
    for k in range(400):
        t = k / 200
        aligner.add_field((20.0, 0.0, 40.0))
        force = (3.0 * math.cos(4.0 * math.pi * t), 0.0, -GRAVITY_M_S2)
        block = detector.add(t, ZERO3, force)
        if block and (found := aligner.add_block(t, block)):
            x, _, z = found.specific_force_body_m_s2
            assert math.degrees(math.atan2(x, -z)) == pytest.approx(0.0, abs=2.0)
            return
    pytest.fail("no start")


def test_a_steady_turn_is_not_standing_still() -> None:
    aligner = StaticAligner(CONFIG)
    aligner.add_field((20.0, 0.0, 40.0))
    turn = Block((0.0, 0.0, 0.3), (0.0, 0.0, -9.8), 20, still=True)
    found = [aligner.add_block(0.1 * k, turn) for k in range(39)]
    assert not any(result.still for result in found if result)
