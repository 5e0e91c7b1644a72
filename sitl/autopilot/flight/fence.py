"""A geofence: polygons and circles that the vehicle has to stay in or out of, as MAVLink's mission items.

Places are latitude and longitude in degrees, radii in metres. The autopilots' own cylinders
about home are not part of it. Sources: MAVLink's mission protocol (plan type "fence"); PX4
1.16 `geofence.cpp`; ArduPilot 4.6 `AC_PolyFence_loader`.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

from companion.base.geometry import ned_from_geodetic
from sitl.autopilot.flight.mission_items import ItemFrame, MissionItem, MissionResult, wrong_place

Place = tuple[float, float]
_LEAST_CORNERS: Final = 3


class FenceCommand(IntEnum):
    """MAV_CMD of a fence's items; parameter 1 is a polygon's number of corners, or a circle's radius."""

    RETURN_POINT = 5000
    STAY_IN_POLYGON = 5001
    STAY_OUT_OF_POLYGON = 5002
    STAY_IN_CIRCLE = 5003
    STAY_OUT_OF_CIRCLE = 5004


FENCE_COMMANDS: Final = frozenset(FenceCommand)
_CIRCLES: Final = (FenceCommand.STAY_IN_CIRCLE, FenceCommand.STAY_OUT_OF_CIRCLE)
_STAY_IN: Final = (FenceCommand.STAY_IN_POLYGON, FenceCommand.STAY_IN_CIRCLE)


@dataclass(frozen=True, slots=True)
class _Area:
    """One polygon (`corners`), or a circle about its only corner."""

    stay_in: bool
    corners: tuple[Place, ...]
    radius_m: float = 0.0

    def holds(self, latitude_deg: float, longitude_deg: float) -> bool:
        """Whether the place is inside."""
        if len(self.corners) == 1:
            north_m, east_m, _ = ned_from_geodetic(latitude_deg, longitude_deg, 0.0, (*self.corners[0], 0.0))
            return math.hypot(north_m, east_m) < self.radius_m
        inside = False
        for (a_lat, a_lon), (b_lat, b_lon) in zip(
            self.corners, (*self.corners[1:], self.corners[0]), strict=True
        ):
            # the edges that a line to the north crosses, odd for a place inside
            if (a_lon > longitude_deg) != (b_lon > longitude_deg):
                share = (longitude_deg - a_lon) / (b_lon - a_lon)
                inside ^= latitude_deg < a_lat + share * (b_lat - a_lat)
        return inside


@dataclass(slots=True)
class Fence:
    """The list as it was uploaded, and what it means.

    With PX4 areas `unite`: one to stay in is enough. With ArduPilot they do not: the vehicle has to be in all
    of them, and a circle without a radius is an error.
    """

    unite: bool
    items: list[MissionItem] = field(default_factory=list)
    _areas: tuple[_Area, ...] = ()

    def check(self, item: MissionItem, frame: ItemFrame | None) -> MissionResult:
        """May an item with that frame be uploaded?"""
        if item.command not in FENCE_COMMANDS:
            return MissionResult.UNSUPPORTED
        if frame is None:
            return MissionResult.UNSUPPORTED_FRAME
        if item.command in _CIRCLES and not item.parameter(1, -1.0) >= 0.0:
            return MissionResult.INVALID_PARAM1
        return wrong_place(item.x, item.y, 0.0) or MissionResult.ACCEPTED

    def replace(self, items: Sequence[MissionItem]) -> bool:
        """Take a complete list; False, and nothing changes, where a polygon or circle is not whole."""
        areas = tuple(_areas(items))
        sizes = (i.parameter(1) for i in items if i.command in _CIRCLES)
        if None in areas or not (self.unite or all(size > 0.0 for size in sizes)):
            return False
        self.items = list(items)
        self._areas = tuple(area for area in areas if area is not None)
        return True

    def broken_at(self, latitude_deg: float, longitude_deg: float) -> bool:
        """Whether a vehicle there is where it must not be."""
        held = [(area.stay_in, area.holds(latitude_deg, longitude_deg)) for area in self._areas]
        stays_in = [inside for stay_in, inside in held if stay_in]
        kept_in = not stays_in or (any(stays_in) if self.unite else all(stays_in))
        return not kept_in or any(inside for stay_in, inside in held if not stay_in)


def _areas(items: Sequence[MissionItem]) -> Iterator[_Area | None]:
    """The areas of a list; None for a polygon that is not whole."""
    rest = [item for item in items if item.command != FenceCommand.RETURN_POINT]
    while rest:
        first = rest[0]
        stay_in = first.command in _STAY_IN
        if first.command in _CIRCLES:
            yield _Area(stay_in, ((first.x, first.y),), first.parameter(1))
            del rest[0]
            continue
        count = first.whole(1)
        corners = rest[: max(1, count)]
        whole = len(corners) == count >= _LEAST_CORNERS
        alike = all(i.command == first.command and i.whole(1) == count for i in corners)
        yield _Area(stay_in, tuple((i.x, i.y) for i in corners)) if whole and alike else None
        del rest[: len(corners)]
