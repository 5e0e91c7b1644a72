"""What a correction of the vehicle's attitude does to the pad's relative state.

A sighting says where the pad is in the body's frame; the attitude turns that to NED. A fix that corrects the
attitude by a small rotation d (about NED axes) turns all that was seen before with it: 0.3 deg move a pad
7 m below by 4 cm at once. A filter that takes that for the pad's motion sees it swing by 0.2 m/s. So the
state turns with its frame, with relative position r and velocity v and the pad's own acceleration a:

    r += d x (r + v dt),    v += d x v,    a += d x (0, 0, -g)

where r and v are those before a step of dt, whenever in it the attitude was corrected. The last since a is
the relative acceleration that is seen plus the vehicle's own, R f + (0, 0, g) with the measured force f:
together a - (0, 0, g) turns. That holds for an a that sightings have taught lately; unseen it fades, and with
it what it has learnt of the old horizon. What d x a itself adds is small and left out. NED, SI units.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, FloatArray, Vector3

_TAUGHT_S: Final = 0.3  # a pad's acceleration is as sightings have taught it for so long
_PLANE, _CLIMB = 0, -1  # a model of each group: all of a group are at about the same place


def frame_rotation_increment(
    moved: tuple[Vector3, Vector3], correction_rad: Vector3, means: FloatArray, dt_s: float, unseen_s: float
) -> FloatArray:
    """What a step of dt_s adds to the plane's and the vertical's means (2, 8), beyond the models' own motion.

    Args:
        moved: the vehicle's motion within the step, as of `MotionHistory.moved`.
        correction_rad: the corrections of the attitude within it; when, is not told: evenly.
        means: (m, 8) of all models before the step.
        dt_s: how long it lasts.
        unseen_s: since the last sighting, at the step's end.
    """
    (x, y, z), (vx, vy, vz) = moved
    i, j, k = correction_rad
    px, py, ux, uy = means[_PLANE, :4].tolist()
    pz, _, uz, _ = means[_CLIMB, :4].tolist()
    px, py, pz = px + ux * dt_s, py + uy * dt_s, pz + uz * dt_s
    ax, ay = (-GRAVITY_M_S2 * j, GRAVITY_M_S2 * i) if unseen_s <= _TAUGHT_S else (0.0, 0.0)
    h, s = 0.5 * dt_s, dt_s * dt_s / 6.0
    north = j * pz - k * py + s * ax - x
    east = k * px - i * pz + s * ay - y
    north_m_s = j * uz - k * uy + h * ax - vx
    east_m_s = k * ux - i * uz + h * ay - vy
    down, down_m_s = i * py - j * px - z, i * uy - j * ux - vz
    plane = (north, east, north_m_s, east_m_s, ax, ay, 0.0, 0.0)
    return np.array((plane, (down, 0.0, down_m_s, 0.0, 0.0, 0.0, 0.0, 0.0)))
