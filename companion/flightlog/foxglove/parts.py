"""The parts of Foxglove's messages from our own types. NED and FRD are kept; each frame has its name.

`map` is the root: east, north, up, as Foxglove's 3D panel expects it. Under it `local_ned` counts from the
EKF's origin; `vehicle` (FRD) and `pad` (forward, right, down) move in that, `camera` (OpenCV's axes) sits on
the vehicle.
"""

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from companion.base.geometry import IDENTITY, ZERO3, Quaternion, Vector3

MAP: Final = "map"
LOCAL: Final = "local_ned"
VEHICLE: Final = "vehicle"
CAMERA: Final = "camera"
PAD: Final = "pad"
# north, east, down to east, north, up: half a turn about the axis between north and east
ENU_FROM_NED: Final[Quaternion] = (0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0)
Plain = dict[str, Any]


class WellKnown(NamedTuple):
    """One message: its topic, the name of its schema, its fields, and its own time where it has one."""

    topic: str
    schema: str
    message: Plain


def stamp(unix_ns: int) -> Plain:
    seconds, nanoseconds = divmod(unix_ns, 1_000_000_000)
    return {"sec": seconds, "nsec": nanoseconds}


def vector(v: Sequence[float]) -> Plain:
    return {"x": float(v[0]), "y": float(v[1]), "z": float(v[2])}


def quaternion(q: Quaternion) -> Plain:
    """A rotation; ours begins with w."""
    return {"x": q[1], "y": q[2], "z": q[3], "w": q[0]}


def pose(position: Sequence[float] = ZERO3, orientation: Quaternion = IDENTITY) -> Plain:
    return {"position": vector(position), "orientation": quaternion(orientation)}


def colour(red: float, green: float, blue: float, alpha: float = 1.0) -> Plain:
    return {"r": red, "g": green, "b": blue, "a": alpha}


def transform(unix_ns: int, parent: str, child: str, translation: Vector3, rotation: Quaternion) -> WellKnown:
    """Where a frame is in another; a topic for each child, so that a jump in time finds them all."""
    message = {
        "timestamp": stamp(unix_ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": vector(translation),
        "rotation": quaternion(rotation),
    }
    return WellKnown(f"tf/{child}", "foxglove.FrameTransform", message)


def pose_in(unix_ns: int, topic: str, frame: str, position: Vector3, orientation: Quaternion) -> WellKnown:
    message = {"timestamp": stamp(unix_ns), "frame_id": frame, "pose": pose(position, orientation)}
    return WellKnown(topic, "foxglove.PoseInFrame", message)


def entity(unix_ns: int, frame: str, name: str, lifetime_s: float = 0.0, **primitives: list[Plain]) -> Plain:
    """Something in the scene; `lifetime_s` 0: until another of that name comes."""
    empty: dict[str, list[Plain]] = {"cubes": [], "spheres": [], "cylinders": [], "lines": []}
    return {
        "timestamp": stamp(unix_ns),
        "frame_id": frame,
        "id": name,
        "lifetime": stamp(round(1e9 * lifetime_s)),
        "frame_locked": True,
        **empty,
        **primitives,
    }
