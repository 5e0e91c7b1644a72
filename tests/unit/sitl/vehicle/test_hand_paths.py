"""The motion of a vehicle that is carried by hand: plausible, and repeated by its seed."""

import math
from typing import get_args

import numpy as np
import pytest

from companion.base.geometry import (
    FloatArray,
    add,
    matrix_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    rotation_vector_from_quat,
    scale,
    subtract,
)
from sitl.vehicle.hand_motion import HandMotion
from sitl.vehicle.hand_paths import FACES
from sitl.world.hand_held import HandHeldWorld
from tests.unit.sitl.vehicle.hand_scenario import MAGNETIC_FIELD_NED_UT, STATIC, STEP_S, STOPPED


@pytest.mark.parametrize("motion", get_args(HandMotion))
def test_forces_and_rates_are_those_of_the_motion(motion: HandMotion) -> None:
    world = HandHeldWorld(STATIC, 4, motion)
    largest = 0.0
    for _ in range(4000):
        before = world.state
        world.step(STOPPED, STEP_S)
        after = world.state
        mean = scale(add(before.velocity_ned_m_s, after.velocity_ned_m_s), 0.5 * STEP_S)
        moved = subtract(after.position_ned_m, before.position_ned_m)
        assert subtract(moved, mean) == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)
        turned = rotation_vector_from_quat(quat_multiply(quat_conjugate(before.attitude), after.attitude))
        rate = scale(add(before.rate_body_rad_s, after.rate_body_rad_s), 0.5)
        assert scale(turned, 1.0 / STEP_S) == pytest.approx(rate, abs=2e-4)
        felt = quat_rotate(after.attitude, after.specific_force_body_m_s2)
        gained = subtract(after.velocity_ned_m_s, before.velocity_ned_m_s)
        felt_gain = scale(add(felt, (0.0, 0.0, 9.80665)), STEP_S)
        # half a step's turn lies between the two
        assert gained == pytest.approx(felt_gain, abs=1e-4)
        jump = subtract(after.specific_force_body_m_s2, before.specific_force_body_m_s2)
        largest = max(largest, float(np.linalg.norm(jump)))
    assert largest < 0.2, "the force jumps"


def poses(
    motion: HandMotion, seed: int, length_s: float, every_s: float = 0.05
) -> list[tuple[FloatArray, FloatArray]]:
    """Position over the pad (m) and rotation (3, 3), again and again."""
    world = HandHeldWorld(STATIC, seed, motion)
    steps, found = round(every_s / STEP_S), []
    for k in range(round(length_s / STEP_S)):
        world.step(STOPPED, STEP_S)
        if k % steps == 0:
            offset = subtract(world.state.position_ned_m, world.pad_state.position_ned_m)
            found.append((np.array(offset), matrix_from_quat(world.state.attitude)))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_tumbling_shows_the_field_every_side(seed: int) -> None:
    field = np.array(MAGNETIC_FIELD_NED_UT) / np.linalg.norm(MAGNETIC_FIELD_NED_UT)
    directions = np.array([rotation.T @ field for _, rotation in poses("tumble", seed, 60.0)])
    probes = np.random.default_rng(0).standard_normal((300, 3))
    probes /= np.linalg.norm(probes, axis=1, keepdims=True)
    nearest_deg = np.degrees(np.arccos((probes @ directions.T).clip(-1.0, 1.0))).min(axis=1)
    assert (nearest_deg < 25.0).mean() > 0.9


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("already_s", [0.0, 60.0])
def test_each_face_is_laid_down_in_a_round(seed: int, already_s: float) -> None:
    """Whenever one begins to look on."""
    seen = poses("faces", seed, already_s + 48.0)[round(already_s / 0.05) :]
    downs = np.array([rotation.T @ (0.0, 0.0, 1.0) for _, rotation in seen])
    for roll, pitch in FACES:
        own = matrix_from_quat(quat_from_euler(math.radians(roll), math.radians(pitch), 0.0)).T @ (0, 0, 1)
        assert (downs @ own > math.cos(math.radians(5.0))).sum() * 0.05 > 4.0


def test_seeds_differ_and_repeat() -> None:
    first, again, other = (poses("sway", seed, 2.0)[-1][0] for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other, atol=0.01)
