"""How the camera is mounted on the airframe.

Derived here independently of the app's code: a sign that is wrong on one side shows.
"""

from __future__ import annotations

import math

import numpy as np

from companion.base.geometry import ZERO3, FloatArray, Vector3, matrix_from_quat, quat_from_euler
from companion.config import VehicleConfig


def mounted_camera(vehicle: VehicleConfig, error_deg: Vector3 = ZERO3) -> FloatArray:
    """Rotation (3, 3) of camera axes into body axes (FRD).

    `error_deg` is a further rotation (roll, pitch, yaw) about the body's axes that `vehicle` lacks.
    """
    nominal = body_from_camera(
        math.radians(vehicle.camera_yaw_deg),
        math.radians(vehicle.camera_tilt_deg),
        math.radians(vehicle.camera_roll_deg),
    )
    if error_deg == ZERO3:
        return nominal
    roll, pitch, yaw = (math.radians(angle) for angle in error_deg)
    return np.asarray(matrix_from_quat(quat_from_euler(roll, pitch, yaw)) @ nominal)


def body_from_camera(yaw_rad: float, tilt_rad: float, roll_rad: float = 0.0) -> FloatArray:
    """How the camera sits on the airframe: rotation (3, 3) of camera axes into body axes (FRD).

    The columns are what the camera's axes are on the vehicle: the image's right, the image's down, and
    where the lens looks. Untilted and unturned, the lens looks down and the image's top edge is forward:
    right is right, the image's down is back. Tilted, the lens rises from down towards forward and the
    image's down from back towards down. Turned, forward becomes (cos, sin, 0) and right (-sin, cos, 0):
    clockwise seen from above. Rolled, before all that, the lens swings from down towards the left.
    """
    st, ct = math.sin(tilt_rad), math.cos(tilt_rad)
    sy, cy = math.sin(yaw_rad), math.cos(yaw_rad)
    tilted = np.array(
        [
            # image right, image down, lens
            [0.0, -ct, st],  # forward
            [1.0, 0.0, 0.0],  # right
            [0.0, st, ct],  # down
        ]
    )
    if roll_rad != 0.0:
        sr, cr = math.sin(roll_rad), math.cos(roll_rad)
        rolled = np.array([[0.0, -1.0, 0.0], [cr, 0.0, -sr], [sr, 0.0, cr]])
        tilted = np.array([[ct, 0.0, st], [0.0, 1.0, 0.0], [-st, 0.0, ct]]) @ rolled
    turned = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turned @ tilted)
