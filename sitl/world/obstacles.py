"""The scenario's obstacles as they are: whether the vehicle touches one, and how far it is from the nearest.

The vehicle counts as a sphere about its centre that reaches to the farthest rotor's tip, so that no tilt
hides a blade. NED from home, m. Independent of the app's planner, so that no mistake is shared.
They are solid to the ground and touched is crashed; a pad drives through, pictures and echoes show none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.base.geometry import Vector3
from companion.config import Box, Shape
from sitl.vehicle.quadrotor import QuadrotorParameters


def reach_m(body: QuadrotorParameters) -> float:
    """From the centre to the farthest rotor's tip."""
    return body.arm_length_m + body.rotor_radius_m


def distance_m(place_ned_m: Vector3, shape: Shape) -> float:
    """From a point to an obstacle's surface; 0 inside."""
    north, east = (p - c for p, c in zip(place_ned_m[:2], shape.centre_ned_m, strict=True))
    if isinstance(shape, Box):
        heading = math.radians(shape.heading_deg)
        away, bearing = math.hypot(north, east), math.atan2(east, north) - heading
        along = max(0.0, abs(away * math.cos(bearing)) - 0.5 * shape.length_m)
        across = max(0.0, abs(away * math.sin(bearing)) - 0.5 * shape.width_m)
        aside = math.hypot(along, across)
    else:
        aside = max(0.0, math.hypot(north, east) - shape.radius_m)
    return math.hypot(aside, max(0.0, -place_ned_m[2] - shape.height_m))


class Obstacles:
    """All of a scenario's, about a vehicle of a size."""

    def __init__(self, shapes: Sequence[Shape], body: QuadrotorParameters) -> None:
        self._shapes, self._reach_m = tuple(shapes), reach_m(body)

    def clearance_m(self, place_ned_m: Vector3) -> float | None:
        """From the rotors' tips to the nearest obstacle, 0 or less touching it; None without any."""
        if not self._shapes:
            return None
        return min(distance_m(place_ned_m, shape) for shape in self._shapes) - self._reach_m
