"""How the corners of one frame err: what of it is independent, and what corners have in common.

A marker's corners are where its sides meet, and it is the sides that are measured. The rotors' vibration
is the same for all corners of a row, however many there are, and white that is over-exposed eats into
all markers alike. Rays are ideal image coordinates (x/z, y/z), stacked as all u and then all v.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray
from companion.config import VisionConfig
from companion.sense.vision.aruco import STRAIGHT_SHARE, Detection
from companion.sense.vision.edges import NEXT, ComplexArray, outwards, pixels_from_complex

# how far all sides of all markers may lie too far in or out: black and white blur unlike
EDGE_STD_PX: Final = 0.006
# a shift of the whole picture that no corner shows, and how hard the camera is accelerated during the readout
SHIFT_STD_PX: Final = 0.003
ACCELERATION_STD_M_S2: Final = 0.4
# rotors vibrate at some frequency between 40 and 160 Hz: more are distinguished the longer the readout is
ROTOR_HZ: Final = ((100.0,), (70.0, 130.0), (60.0, 100.0, 140.0))
APART_S: Final = 0.005
# what of a side's misses is that of its ends: sides, kinds (alike, opposite), -, corners
_ENDS: Final = 0.5 * np.stack((np.eye(4) + np.eye(4)[NEXT], np.eye(4) - np.eye(4)[NEXT]), axis=1)[:, :, None]


def side_noise_px(detection: Detection, config: VisionConfig) -> tuple[float, float]:
    """By which a side errs as a whole, and its ends by its turn: what it shows, and what it cannot."""
    share, stated = detection.offset_share, detection.corner_std_px**2
    unstated = config.corner_noise_px**2
    offset = share * stated + STRAIGHT_SHARE * unstated
    return math.sqrt(offset), math.sqrt(stated + unstated - offset)


def edge_std_px(detection: Detection) -> list[float]:
    """Of how far each side of a marker lies too far in, all of all markers alike."""
    return [math.hypot(EDGE_STD_PX, std) for std in detection.shrunk_std_px]


def whitening(
    normal: ComplexArray, sigma: FloatArray, covariances: Sequence[FloatArray | None] = ()
) -> FloatArray:
    """What makes the rays' errors independent and of unit variance: (2n, 2n), rows of all u, then of all v.

    Corners are where sides meet, and the sides, with these normals (m, 4), are what is measured: what both
    ends of one are off by, and what they are off by with opposite signs, err independently by `sigma` (m, 2),
    that of a side as a whole and that of its ends by its turn. Markers that have a covariance of their
    corners (8, 8), u and v of each in turn, err by that.
    """
    m, k = len(sigma), np.arange(len(sigma))
    across = pixels_from_complex(normal)[:, :, None, :, None]
    white = np.zeros((m, 8, 2, m, 4))  # marker, side and kind | direction, marker, corner
    white[k, :, :, k] = (_ENDS * across / sigma[:, None, :, None, None]).reshape(m, 8, 2, 4)
    for number, covariance in enumerate(covariances):
        if covariance is not None:
            own = np.linalg.inv(np.linalg.cholesky(covariance)).reshape(8, 4, 2)
            white[number, :, :, number] = own.transpose(0, 2, 1)
    return white.reshape(8 * m, 8 * m)


def corner_covariance_px2(detection: Detection, config: VisionConfig) -> FloatArray | None:
    """Of a marker (8, 8) that was measured by its whole print: what it shows, and what it cannot."""
    shown = detection.covariance_px2
    return None if shown is None else shown + config.corner_noise_px**2 * np.eye(len(shown))


def shrinking(normal: ComplexArray, std: FloatArray) -> FloatArray:
    """How each ray (n, 2) moves when all sides, of normals (m, 4), lie in by a standard deviation (m, 4)."""
    return outwards(normal, -std).reshape(-1, 2)


def unseen_m2(distance_m: float, delay_s: FloatArray, focal_px: float) -> float:
    """Variance (m2) of the place, along each axis, of what no fit to the corners can show.

    The picture as a whole may be shifted. And a camera accelerated by a does not keep its velocity through
    the readout: about its mean over rows that are read in a time T, a t^2 / 2 comes to a T^2 / 24.
    """
    span_s = float(delay_s.max() - delay_s.min())
    return (SHIFT_STD_PX * distance_m / focal_px) ** 2 + (ACCELERATION_STD_M_S2 * span_s**2 / 24.0) ** 2


def vibration(delay_s: FloatArray) -> FloatArray:
    """How the rotors' vibration moves the rays (2n, 4k): sine and cosine of k frequencies, right and down.

    At each moment they add up to the variance that each column is given. The shift at the mean row is not
    among them: the pose holds at its time, with the camera displaced as it is then.
    """
    span_s = float(delay_s.max() - delay_s.min())
    frequencies = ROTOR_HZ[min(int(span_s / APART_S), len(ROTOR_HZ) - 1)]
    angle = math.tau * delay_s[:, None] * np.array(frequencies)
    waves = np.concatenate((np.sin(angle), np.cos(angle) - 1.0), axis=1) / math.sqrt(len(frequencies))
    n, count = waves.shape
    both = np.zeros((2 * n, 2 * count))
    both[:n, :count] = both[n:, count:] = waves
    return both
