"""The surfaces under the vehicle: ground and the pad's board, and their ground effect on the rotors.

NED, metres; the ground is the plane z = 0, the board a rectangle above it, level or tilting as a deck does.

Ground effect after Cheeseman and Bennett (ARC R&M 3021, 1955): a rotor of radius R at height z over a plane
gives, at the same power, 1 / (1 - (R / 4z)^2) times its thrust in free air.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from companion.base.geometry import Quaternion, Vector3, add, dot, quat_rotate, subtract, tilt_from_quat
from companion.config import Box, Shape
from companion.pad import Pad
from sitl.pad.motion import PadTruth
from sitl.vehicle.quadrotor import QuadrotorParameters, QuadrotorState, RotorValues

# The formula mirrors a source in the plane and is taken to hold for z / R > 0.5; nearer it is frozen.
LOWEST_HEIGHT_IN_RADII: Final = 0.5
# beyond ten radii the thrust gained is below one thousandth
NEGLIGIBLE_HEIGHT_IN_RADII: Final = 10.0


@dataclass(frozen=True)
class PadBoard:
    """The pad's rectangle: half its length along the heading, half its width across."""

    half_length_m: float
    half_width_m: float

    @cached_property
    def half_diagonal_m(self) -> float:
        """From the centre to a corner."""
        return math.hypot(self.half_length_m, self.half_width_m)

    @classmethod
    def of(cls, pad: Pad) -> PadBoard:
        return cls(0.5 * pad.length_m, 0.5 * pad.width_m)

    def local(self, pad: PadTruth, point_ned_m: Vector3) -> Vector3:
        """Coordinates of a point forward and right of the pad's centre, and down through its surface."""
        return pad.axes().from_ned(subtract(point_ned_m, pad.position_ned_m))

    def contains(self, local_m: Vector3) -> bool:
        """Whether the board is above or below a point given in its own axes."""
        return abs(local_m[0]) <= self.half_length_m and abs(local_m[1]) <= self.half_width_m

    def is_under(self, pad: PadTruth, point_ned_m: Vector3) -> bool:
        """Whether the board is under a point (or over it)."""
        dn, de = point_ned_m[0] - pad.position_ned_m[0], point_ned_m[1] - pad.position_ned_m[1]
        near = pad.is_there and math.hypot(dn, de) <= self.half_diagonal_m
        return near and self.contains(self.local(pad, point_ned_m))

    def surface_down_m(self, pad: PadTruth, north_m: float, east_m: float) -> float:
        """Down coordinate of what lies under a point: the board's top or the ground."""
        dn, de = north_m - pad.position_ned_m[0], east_m - pad.position_ned_m[1]
        if not pad.is_there or math.hypot(dn, de) > self.half_diagonal_m:
            return 0.0
        axes = pad.axes()
        normal = axes.down
        dd = -(normal[0] * dn + normal[1] * de) / normal[2]
        return pad.position_ned_m[2] + dd if self.contains(axes.from_ned((dn, de, dd))) else 0.0

    def distance_m(self, pad: PadTruth, point_ned_m: Vector3) -> tuple[float, float]:
        """Distance along the surface to the board's nearest point, and height over the surface (m)."""
        forward, right, down = self.local(pad, point_ned_m)
        beyond = math.hypot(
            max(0.0, abs(forward) - self.half_length_m), max(0.0, abs(right) - self.half_width_m)
        )
        return beyond, -down

    def ceiling_down_m(self, pad: PadTruth) -> float:
        """Down coordinate above which there is neither board nor ground: an angle is more than its sine."""
        lift = self.half_diagonal_m * (abs(pad.roll_rad) + abs(pad.pitch_rad))
        return min(0.0, pad.position_ned_m[2] - lift)


def echo_distance_m(
    board: PadBoard,
    pad: PadTruth,
    state: QuadrotorState,
    sensor_position_body_m: Vector3,
    half_angle_rad: float,
) -> float | None:
    """Distance (m) of the first echo in a cone about the body's down axis, None if none comes back.

    A smooth surface throws sound back from its nearest point alone, so that point has to lie in the
    cone: the plumb point, or the board's nearest edge beside it.
    """
    sensor = add(state.position_ned_m, quat_rotate(state.attitude, sensor_position_body_m))
    echoes = []
    if sensor[2] < 0.0 and tilt_from_quat(state.attitude) <= half_angle_rad:
        echoes.append(-sensor[2])
    sideways, height = board.distance_m(pad, sensor)
    # next to the board its edge is in the cone by the angle from its normal alone: tilts are small
    tilt = max(tilt_from_normal(pad, state.attitude), math.atan2(sideways, height))
    if pad.is_there and height > 0.0 and tilt <= half_angle_rad:
        echoes.append(math.hypot(sideways, height))
    return min(echoes, default=None)


def tilt_from_normal(pad: PadTruth, attitude: Quaternion) -> float:
    """Angle (rad) between the body's down axis and the board's normal."""
    axes = pad.axes()
    return math.acos(max(-1.0, min(1.0, dot(quat_rotate(attitude, (0.0, 0.0, 1.0)), axes.down))))


def thrust_ratio(height_m: float, radius_m: float) -> float:
    """Thrust near a plane over thrust in free air; from 1 up to 4/3 at half a radius and below."""
    lowest = LOWEST_HEIGHT_IN_RADII * radius_m
    share = radius_m / (4.0 * (height_m if height_m > lowest else lowest))
    return 1.0 / (1.0 - share * share)


def rotor_ratios(
    state: QuadrotorState, rotors_body_m: tuple[Vector3, ...], radius_m: float, board: PadBoard, pad: PadTruth
) -> RotorValues:
    """Ground effect of each rotor over what lies under its own hub."""
    position = state.position_ned_m
    if board.ceiling_down_m(pad) - position[2] > NEGLIGIBLE_HEIGHT_IN_RADII * radius_m:
        return (1.0,) * len(rotors_body_m)
    ratios = []
    for rotor in rotors_body_m:
        arm = quat_rotate(state.attitude, rotor)
        north, east = position[0] + arm[0], position[1] + arm[1]
        height = board.surface_down_m(pad, north, east) - position[2] - arm[2]
        ratios.append(thrust_ratio(height, radius_m))
    return tuple(ratios)


# ---------------------------------------------------------------- obstacles
# The vehicle counts as a sphere about its centre that reaches to the farthest rotor's tip, so that no tilt
# hides a blade. NED from home, m. Independent of the app's planner, so that no mistake is shared.
# They are solid to the ground and touched is crashed; a pad drives through, pictures and echoes show none.


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
