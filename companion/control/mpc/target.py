"""The plan's reference as the MPC's target.

It is resampled to the time at which the command takes effect, and the pad's own motion is added if the
reference is relative to the pad. Frames: in, the reference's (pad's or EKF's origin); out, NED axes that do
not accelerate, with the origin at the pad's estimated position. SI units.
"""

import math
from dataclasses import replace

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, FloatArray, Vector3, subtract, vector3
from companion.base.messages import LevelOff, Reference
from companion.control.pad_prediction import PadPrediction
from companion.control.tracking import Cone, Target


def sample(reference: Reference, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration (n, 3) of the reference at `times_s` (n,).

    Beyond its last row the reference goes straight on; before its first it is at rest at that row.
    """
    last_row = len(reference.position_m) - 1
    rows = np.concatenate((reference.position_m, reference.velocity_m_s, reference.acceleration_m_s2), axis=1)
    place = (times_s - reference.time_s) / reference.step_s
    inside = np.minimum(np.maximum(place, 0.0), last_row)
    below = np.minimum(inside.astype(int), max(last_row - 1, 0))
    above = np.minimum(below + 1, last_row)
    share = (inside - below)[:, None]
    values = rows[below] * (1.0 - share) + rows[above] * share
    beyond_s = np.maximum(place - last_row, 0.0)[:, None] * reference.step_s
    values[:, :3] += values[:, 3:6] * beyond_s
    values[:, 6:] *= beyond_s <= 0.0
    return values[:, :3], values[:, 3:6], values[:, 6:]


def within_reach(
    target: Target, position_m: Vector3, horizontal_reach_m: float, vertical_reach_m: float
) -> Target:
    """The target, moved as a whole until its start is within reach of the vehicle.

    A quadratic cost pulls the harder the farther the goal is, past all soft bounds; drawn near, a far goal is
    approached at a steady speed.
    """
    x, y, z = subtract(vector3(target.position_m[0]), position_m)
    distance = math.hypot(x, y)
    excess = max(0.0, 1.0 - horizontal_reach_m / distance) if distance > 0.0 else 0.0
    down = z - max(-vertical_reach_m, min(vertical_reach_m, z))
    if excess == 0.0 and down == 0.0:
        return target
    shift = np.array([x * excess, y * excess, down])
    return replace(target, position_m=target.position_m - shift)


def make_target(
    reference: Reference, times_s: FloatArray, origin: PadPrediction, hover_thrust: float | None = None
) -> Target:
    """The target at `times_s` (N+1,): the reference on top of how its origin moves."""
    position, velocity, acceleration = sample(reference, times_s)
    position += origin.displacement_m
    floor = cone = None
    if reference.origin == "pad" and reference.minimum_height_m is not None:
        floor = origin.displacement_m[:, 2] - reference.minimum_height_m
        position[:, 2] = np.minimum(position[:, 2], floor)
    if reference.origin == "pad" and reference.cone is not None:
        apex = origin.displacement_m - np.array([0.0, 0.0, reference.cone.apex_height_m])
        cone = Cone(reference.cone.slope, reference.cone.radius_m, apex)
    return Target(
        position,
        velocity + origin.velocity_m_s,
        acceleration + origin.acceleration_m_s2,
        floor,
        cone,
        hover_thrust,
        horizontal_bound_m_s2=_horizontal_bound(reference.level_off, times_s),
    )


def _horizontal_bound(level_off: LevelOff | None, times_s: FloatArray) -> FloatArray | None:
    """The greatest horizontal input (N,) over each of the steps between `times_s` (N+1,); None: no bound."""
    if level_off is None or times_s[-1] < level_off.from_s:
        return None
    middle_s = 0.5 * (times_s[1:] + times_s[:-1])
    within = (middle_s >= level_off.from_s) & (middle_s <= level_off.until_s)
    return np.where(within, GRAVITY_M_S2 * math.tan(level_off.tilt_rad), np.inf)


def stop_reference(time_s: float, position_ned_m: Vector3, heading_rad: float) -> Reference:
    """A local reference that stands still at a position."""
    still = np.zeros((1, 3))
    return Reference(time_s, "local", 1.0, np.array([position_ned_m]), still, still, heading_rad)
