"""Where the pose's fit starts: from a level pad, or from the two poses in which a square looks alike.

Points (n, 3) are on the pad, rays (n, 2) ideal image coordinates; a start is the rotation (3, 3) of the pad's
axes into the camera's and the place (3,) of its centre.
"""

from __future__ import annotations

import cv2
import numpy as np

from companion.base.geometry import FloatArray

Start = tuple[FloatArray, FloatArray]


def level_start(points: FloatArray, rays: FloatArray, down: FloatArray) -> tuple[Start, ...]:
    """The pose of an exactly level pad, if there is one: in levelled axes the pad's image is a similarity.

    With the rays turned so that z is down, pad point (X, Y) at depth t_z obeys
    z u = t_x + c X - s Y, z v = t_y + s X + c Y: as complex numbers w = t + k p, with p = X + iY, all over
    t_z, and k by least squares about the means.
    """
    level_from_camera = _shortest_turn(down)
    x, y, depth = level_from_camera[:, :2] @ rays.T + level_from_camera[:, 2:]
    if depth.min() < 0.05:
        return ()
    seen, printed = (x + 1j * y) / depth, points[:, 0] + 1j * points[:, 1]
    mean_seen, mean_printed = complex(seen.sum()) / len(seen), complex(printed.sum()) / len(printed)
    about = printed - mean_printed
    k = complex(np.vdot(about, seen)) / np.vdot(about, about).real
    scale = abs(k)
    if scale < 1e-6:
        return ()
    t = mean_seen - k * mean_printed
    c, s = k.real / scale, k.imag / scale
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    position = np.array([t.real, t.imag, 1.0]) / scale
    return ((level_from_camera.T @ turn, level_from_camera.T @ position),)


def _shortest_turn(down: FloatArray) -> FloatArray:
    """The rotation (3, 3) that takes `down` (unit, not straight up) to the z axis."""
    x, y, z = down.tolist()
    k = 1.0 / (1.0 + max(z, -0.999))
    return np.array([[1.0 - k * x * x, -k * x * y, -x], [-k * x * y, 1.0 - k * y * y, -y], [x, y, z]])


def planar_starts(points: FloatArray, rays: FloatArray) -> tuple[Start, ...]:
    """The two planar solutions (IPPE), the better one first."""
    solved, turns, places, _ = cv2.solvePnPGeneric(
        points, rays, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
    )
    if not solved:
        return ()
    return tuple(
        (np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64), np.asarray(place, dtype=np.float64).reshape(3))
        for turn, place in zip(turns, places, strict=True)
    )
