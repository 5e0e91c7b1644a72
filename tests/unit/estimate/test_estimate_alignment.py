"""Standing still is recognised, and yields attitude and gyroscope bias."""

from __future__ import annotations

import numpy as np
import pytest

from companion.config import AlignmentConfig
from companion.estimate.alignment import Alignment, StaticAligner, StillnessDetector
from companion.geometry import GRAVITY_M_S2, Vector3, vector3

CONFIG = AlignmentConfig(still_s=1.0, timeout_s=4.0)
BIAS = (0.02, -0.01, 0.005)


def run(
    duration_s: float,
    force_noise: float = 0.03,
    rate_noise: float = 0.002,
    moving_until_s: float = 0.0,
    field: bool = True,
) -> tuple[float, Alignment] | None:
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
