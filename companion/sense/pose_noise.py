"""How the corners of one frame err: what of it is independent, and what corners have in common.

A marker's corners are where its sides meet, and it is the sides that are measured. What the rotors shake is
the same for all corners of a row, however many there are, and white that is over-exposed eats into all
markers alike. Rays are ideal image coordinates (x/z, y/z), stacked as all u and then all v.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.config import VisionConfig
from companion.geometry import FloatArray
from companion.sense.aruco import Detection

# corners of a marker that is large in the image err by this share of its side beyond what its sides tell
LARGE_SHARE: Final = 1e-4
# how far all sides of all markers may lie too far in or out: black and white blur unlike
EDGE_STD_PX: Final = 0.006
# a shift of the whole picture that no corner tells, and how hard the camera is pushed during the readout
SHIFT_STD_PX: Final = 0.008
PUSH_STD_M_S2: Final = 0.7
# the rotors' shaking is told apart at knots of this distance in the readout, at most so many
KNOT_S: Final = 0.0025
MOST_KNOTS: Final = 8
# places along a side, as shares of it, at which a fitted line errs independently
_SHARES: Final = (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0))


def corner_noise_px(detection: Detection, config: VisionConfig) -> float:
    """Of each corner in each direction: what its marker's sides tell, and what they cannot."""
    large = LARGE_SHARE * detection.side_px
    return math.sqrt(detection.corner_std_px**2 + config.corner_noise_px**2 + large**2)


def edge_std_px(detection: Detection) -> float:
    """Of how far all sides of all markers lie too far in."""
    return math.hypot(EDGE_STD_PX, detection.shrunk_std_px)


def whitening(rays: FloatArray, sigma: FloatArray) -> FloatArray:
    """What makes the rays' errors independent and of unit variance: (2n, 2n), rows of all u, then of all v.

    Corners are where sides meet, and the sides are what is measured: a straight line through independent
    places is independent at +-1/sqrt(3) of its half length. There each side's offset counts, and a corner
    errs by sqrt(2) times as much.
    """
    m = len(sigma)
    corners = rays.reshape(m, 4, 2)
    along = corners[:, (1, 2, 3, 0)] - corners
    along /= np.sqrt((along**2).sum(axis=2))[..., None]
    k, side = np.arange(m)[:, None], np.arange(4)
    white = np.zeros((m, 4, 2, 2, m, 4))  # marker, side, place | direction, marker, corner
    for direction, normal in enumerate((along[..., 1], -along[..., 0])):
        scaled = normal * (math.sqrt(2.0) / sigma)[:, None]
        for place, share in enumerate(_SHARES):
            white[k, side, place, direction, k, side] = scaled * (1.0 - share)
            white[k, side, place, direction, k, (side + 1) % 4] = scaled * share
    return white.reshape(8 * m, 8 * m)


def shrinking(rays: FloatArray, std: FloatArray) -> FloatArray:
    """How each ray moves (2n, 1) when all sides lie in by one standard deviation (m,) of their marker."""
    corners = rays.reshape(-1, 4, 2)
    along = corners[:, (1, 2, 3, 0)] - corners
    along /= np.sqrt((along**2).sum(axis=2))[..., None]
    inward = np.stack((-along[..., 1], along[..., 0]), axis=2)
    both = std[:, None, None] * (inward + inward[:, (3, 0, 1, 2)])
    return np.asarray(both.reshape(-1, 2).T.reshape(-1, 1))


def unseen_m2(distance_m: float, delay_s: FloatArray, focal_px: float) -> float:
    """Variance (m2) of the place, along each axis, of what no fit to the corners can tell.

    The picture as a whole may be shifted. And what is pushed by a does not keep its velocity through the
    readout: about its mean over rows that are read in a time T, a t^2 / 2 comes to a T^2 / 24.
    """
    span_s = float(delay_s.max() - delay_s.min())
    return (SHIFT_STD_PX * distance_m / focal_px) ** 2 + (PUSH_STD_M_S2 * span_s**2 / 24.0) ** 2


def shaking(delay_s: FloatArray) -> FloatArray:
    """How shifts at the knots, right and down, move the rays (2n, 2k), straight between knots.

    The shift at the mean row is not among them: the pose holds at its time, shaken as the camera is then.
    """
    first, span_s = float(delay_s.min()), float(delay_s.max() - delay_s.min())
    count = min(2 + int(span_s / KNOT_S), MOST_KNOTS)
    step_s = max(KNOT_S, span_s / (count - 1))
    times = np.append(delay_s, 0.0)
    hats = np.maximum(1.0 - np.abs((times[:, None] - first) / step_s - np.arange(count)), 0.0)
    n = len(delay_s)
    both = np.zeros((2 * n, 2 * count))
    both[:n, :count] = both[n:, count:] = hats[:n] - hats[n]
    return both
