"""How corners err: what is whitened, and what the rotors shake."""

import math

import numpy as np
import pytest

from companion.config import VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import Detection
from companion.sense.vision.edges import normals
from companion.sense.vision.pose_noise import side_noise_px, vibration, whitening


def test_errors_of_sides_are_white_after_whitening() -> None:
    rng = np.random.default_rng(1)
    angle = 0.3 + 0.5 * math.pi * np.arange(4)
    rays = 0.1 * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    along = np.roll(rays, -1, axis=0) - rays
    along /= np.linalg.norm(along, axis=1)[:, None]
    outward = np.stack((along[:, 1], -along[:, 0]), axis=1)
    sigma = np.array([[0.03, 0.01]])
    white = []
    for _ in range(4000):
        offset, turn = rng.normal(0.0, 0.03, 4), rng.normal(0.0, 0.01, 4)
        # a corner is off by what the side that it starts and the one that it ends are
        misses = (offset - turn)[:, None] * outward + np.roll((offset + turn)[:, None] * outward, 1, axis=0)
        white.append(whitening(normals(rays[None]), sigma) @ misses.T.reshape(-1))
    assert np.cov(np.array(white).T) == pytest.approx(np.eye(8), abs=0.08)


def test_a_sides_noise_is_what_it_tells_and_a_little_more(pad: Pad) -> None:
    marker = pad.markers[0]
    found = Detection(
        marker, marker.corners_pad_m(), np.zeros((4, 2)), 20.0, corner_std_px=0.05, offset_share=0.64
    )
    offset, turn = side_noise_px(found, VisionConfig(corner_noise_px=1e-6))
    assert (offset, turn) == pytest.approx((0.04, 0.03), rel=0.01)
    offset, turn = side_noise_px(found, VisionConfig(corner_noise_px=0.1))
    assert math.hypot(offset, turn) == pytest.approx(math.hypot(0.05, 0.1), rel=0.01)


@pytest.mark.parametrize("span_s", [0.004, 0.008, 0.012, 0.018])
def test_what_rotors_shake_is_as_large_between_rows_as_it_is_at_them(span_s: float) -> None:
    delay_s = np.linspace(-0.5, 0.5, 61) * span_s
    columns = vibration(delay_s)[: len(delay_s)]
    variance = (columns**2).sum(axis=1)
    # from the mean row's: nothing there, and twice its own variance half a wave later
    assert variance[30] == pytest.approx(0.0)
    assert (np.diff(variance[30:42]) > 0.0).all()
    assert variance == pytest.approx(variance[::-1])
    if span_s > 0.01:
        assert variance.max() > 1.8


@pytest.mark.parametrize("rotor_hz", [60.0, 75.0, 92.0, 110.0, 140.0])
@pytest.mark.parametrize("span_s", [0.004, 0.012, 0.018])
def test_shaking_at_any_frequency_of_rotors_is_fitted(rotor_hz: float, span_s: float) -> None:
    delay_s = np.linspace(-0.5, 0.5, 61) * span_s
    columns = vibration(delay_s)
    for phase in np.linspace(0.0, math.pi, 7):
        shaken = np.sin(math.tau * rotor_hz * delay_s + phase) - math.sin(phase)
        told = np.concatenate((shaken, 0.5 * shaken))
        # as the pose fits it: a wave of the stated size, known to 0.03 of that
        gain = columns.T @ np.linalg.inv(columns @ columns.T + 0.03**2 * np.eye(len(told)))
        left = told - columns @ (gain @ told)
        assert np.sqrt((left**2).mean()) < 0.06
