"""Which turns a recording lacks: named by the vehicle's faces, and carried out they make the calibration."""

from __future__ import annotations

import re

import numpy as np
import pytest

from calibration.magnetometer.calibrate import UnfitError, calibrate
from calibration.magnetometer.quality import beside_plane, suggest_next_rotation
from calibration.magnetometer.recording import MagnetometerRecording
from companion.base.geometry import FloatArray, matrix_from_quat, quat_from_rotation_vector, vector3

FIELD_NED_UT = np.array([21.0, 0.0, 43.0])
HARD_IRON_UT = np.array([12.0, -30.0, 8.0])
FACES = {
    "nose down": (1.0, 0.0, 0.0),
    "nose up": (-1.0, 0.0, 0.0),
    "right side down": (0.0, 1.0, 0.0),
    "left side down": (0.0, -1.0, 0.0),
    "upright": (0.0, 0.0, 1.0),
    "upside down": (0.0, 0.0, -1.0),
}
SIDEWAYS = matrix_from_quat(quat_from_rotation_vector(vector3([2.0, -1.0, 0.5])))


def held(face: str, rng: np.random.Generator) -> FloatArray:
    """The field (n, 3) in body axes, of a vehicle that a hand turns once right round with a face down."""
    down = np.array(FACES[face]) + 0.06 * rng.standard_normal((300, 3))
    down /= np.linalg.norm(down, axis=1)[:, None]
    north = np.cross(down, np.roll(FACES[face], 1))
    north /= np.linalg.norm(north, axis=1)[:, None]
    east = np.cross(down, north)
    angle = np.linspace(0.0, 2.0 * np.pi, 300)[:, None]
    across = np.cos(angle) * north + np.sin(angle) * east
    field: FloatArray = FIELD_NED_UT[0] * across + FIELD_NED_UT[2] * down
    return field


def faces(words: str) -> list[str]:
    """What the words have a person do, in their order."""
    found = re.findall("|".join(FACES), words)
    assert words.count("once right round") == len(found) / 2
    return found


def recording(
    field: FloatArray, body_from_sensor: FloatArray, rng: np.random.Generator
) -> MagnetometerRecording:
    raw = field @ body_from_sensor + HARD_IRON_UT + 0.3 * rng.standard_normal(field.shape)
    return MagnetometerRecording("test", "mpu9250", raw, body_from_sensor=body_from_sensor)


def refusal(made: MagnetometerRecording, rng: np.random.Generator) -> str:
    """Why no good calibration comes of it; empty where one does."""
    try:
        done = calibrate(made, rng, field=None, aligned=False, objective=None, tool="test", date="")
    except UnfitError as error:
        return str(error)
    quality = done.file.quality
    return "; ".join(quality.reasons) if quality.verdict == "refused" else ""


@pytest.mark.parametrize("mounting", [np.eye(3), SIDEWAYS], ids=["square", "sideways"])
@pytest.mark.parametrize("face", ["nose down", "right side down", "upright"])
def test_after_a_turn_about_one_axis_the_other_two_are_named_and_enough(
    face: str, mounting: FloatArray
) -> None:
    rng = np.random.default_rng(3)
    field = held(face, rng)
    words = refusal(recording(field, mounting, rng), rng)
    assert "one plane or on a narrow band; next: " in words
    turns = faces(words)
    assert len(turns) == 4
    assert face not in turns
    for turn in turns:
        field = np.vstack((field, held(turn, rng)))
    assert refusal(recording(field, mounting, rng), rng) == ""


def test_a_vehicle_that_was_not_turned_is_to_be_turned_about_all_axes() -> None:
    line = np.outer(np.linspace(-1.0, 1.0, 100), (1.0, 2.0, 3.0))
    assert faces(beside_plane(line, np.eye(3))) == list(FACES)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("mounting", [np.eye(3), SIDEWAYS], ids=["square", "sideways"])
def test_the_axis_that_the_field_was_never_near_is_turned_about_next(axis: int, mounting: FloatArray) -> None:
    directions = np.random.default_rng(5).standard_normal((2000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    seen = directions[np.abs(directions[:, axis]) < 0.6]
    assert faces(suggest_next_rotation(seen @ mounting, mounting)) == list(FACES)[2 * axis : 2 * axis + 2]
