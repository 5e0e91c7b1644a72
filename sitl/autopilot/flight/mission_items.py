"""Mission data: the items, the stored list, and which items each autopilot accepts.

Latitude and longitude in degrees, altitude in metres over `frame`'s datum; parameters 1 to 4 as MAVLink
gives them (degrees, seconds). Sources: MAVLink's mission protocol; PX4 1.16 `mavlink_mission.cpp`;
ArduPilot 4.6 `MissionItemProtocol` and `AP_Mission`.

A geofence: polygons and circles that the vehicle has to stay in or out of, as MAVLink's mission items.

Places are latitude and longitude in degrees, radii in metres. The autopilots' own cylinders
about home are not part of it. Sources: MAVLink's mission protocol (plan type "fence"); PX4
1.16 `geofence.cpp`; ArduPilot 4.6 `AC_PolyFence_loader`.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from math import isfinite, nan
from typing import Final

from companion.base.geometry import ned_from_geodetic
from sitl.autopilot.flight.modes import Severity


class MissionCommand(IntEnum):
    """MAV_CMD of the items that are flown, and of those that are read for their position."""

    WAYPOINT = 16
    LOITER_UNLIM = 17
    LOITER_TURNS = 18
    LOITER_TIME = 19
    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    SPLINE_WAYPOINT = 82
    DELAY = 93
    CONDITION_DELAY = 112
    CONDITION_YAW = 115
    DO_JUMP = 177
    DO_CHANGE_SPEED = 178
    DO_SET_HOME = 179
    DO_LAND_START = 189


class MissionResult(IntEnum):
    """MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID_PARAM1 = 6
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


# the largest latitude and longitude (deg) and altitude (m), and the answers to others
_MOST = (90.0, 180.0, 30_000.0)
_OUT_OF_PLACE = (MissionResult.INVALID_PARAM5_X, MissionResult.INVALID_PARAM6_Y, MissionResult.INVALID_PARAM7)


class ItemFrame(IntEnum):
    """MAV_FRAME of an item, without the difference between a float's and an integer's."""

    GLOBAL = 0
    MISSION = 2
    RELATIVE = 3


NAVIGATION: frozenset[int] = frozenset(c for c in MissionCommand if c < 95)  # MAV_CMD_NAV_LAST
# their x and y are a latitude and a longitude, all others' plain numbers
PLACES: frozenset[int] = frozenset(
    (NAVIGATION - {MissionCommand.RETURN_TO_LAUNCH, MissionCommand.DELAY})
    | {MissionCommand.DO_SET_HOME, MissionCommand.DO_LAND_START}
    | {31, 195, 201}  # LOITER_TO_ALT, DO_SET_ROI(_LOCATION)
)


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One item; `parameters` are 1 to 4, x and y degrees where the command has a place."""

    command: int
    frame: ItemFrame = ItemFrame.MISSION
    parameters: tuple[float, float, float, float] = (nan, nan, nan, nan)
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    autocontinue: bool = True

    @property
    def has_place(self) -> bool:
        """Latitude and longitude are given; both 0 means "here", as the real ones take it."""
        return self.command in PLACES and (self.x != 0.0 or self.y != 0.0)

    def parameter(self, number: int, otherwise: float = 0.0) -> float:
        """Parameter 1..4, `otherwise` when it is not finite."""
        value = self.parameters[number - 1]
        return value if isfinite(value) else otherwise

    def whole(self, number: int, otherwise: int = 0) -> int:
        """Parameter 1..4 as an integer within 32 bits."""
        return int(min(max(self.parameter(number, otherwise), -(2.0**31)), 2.0**31 - 1.0))


@dataclass(frozen=True, slots=True)
class MissionRules:
    """How one autopilot handles missions.

    `without_effect` are items it accepts that have no effect here (cameras, gimbals, servos).
    `home_first`: item 0 is home whatever is sent for it. `writes_in_place`: an upload overwrites the list
    item by item, else the old one stands until the new one is complete. `restarts`: a second MISSION_COUNT of
    the same client restarts it at any time, else only before the first item. `takes_off_before_mission`: on
    the ground it climbs to its take-off height before a first item that is none. `waits_for_start`: armed on
    the ground it waits for MISSION_START or a raised throttle. `uses_yaw_parameter`: parameter 4 of a
    waypoint is a heading. `guided_items`: a waypoint sent with current = 2 belongs to no mission, it is flown
    to at once. `fences_unite`: to be in one of a fence's areas is enough, else in all.
    """

    flown: frozenset[int]
    without_effect: frozenset[int]
    max_items: int
    retry_s: float
    timeout_s: float
    home_first: bool = False
    asks_for_integers: bool = False
    writes_in_place: bool = False
    restarts: bool = False
    partial_lists: bool = False
    guided_items: bool = False
    takes_off_before_mission: bool = False
    waits_for_start: bool = False
    uses_yaw_parameter: bool = False
    fences_unite: bool = False
    rewinds_on_disarm: bool = False
    received_text: str = ""
    timeout_text: str = ""
    unknown_current_text: str = ""
    item_text: str = ""
    reached_text: str = ""
    finished_text: str = ""

    @property
    def first(self) -> int:
        return 1 if self.home_first else 0

    def check(self, item: MissionItem, frame: int) -> MissionResult:
        if item.command not in self.flown and item.command not in self.without_effect:
            return MissionResult.UNSUPPORTED
        if item_frame(frame) is None:
            return MissionResult.UNSUPPORTED_FRAME
        if item.command not in PLACES:
            jump = item.command == MissionCommand.DO_JUMP
            return MissionResult.INVALID_PARAM1 if jump and item.whole(1, -1) < 0 else MissionResult.ACCEPTED
        return wrong_place(item.x, item.y, item.z) or MissionResult.ACCEPTED


def wrong_place(latitude_deg: float, longitude_deg: float, altitude_m: float) -> MissionResult | None:
    """The answer to a place that is none; None to one that is."""
    coordinates = zip((latitude_deg, longitude_deg, altitude_m), _MOST, _OUT_OF_PLACE, strict=True)
    return next((result for value, most, result in coordinates if not abs(value) <= most), None)


def item_frame(frame: int) -> ItemFrame | None:
    """An item's frame from MAV_FRAME; None for one that missions here do not take (terrain, local)."""
    return {
        0: ItemFrame.GLOBAL,
        2: ItemFrame.MISSION,
        3: ItemFrame.RELATIVE,
        5: ItemFrame.GLOBAL,
        6: ItemFrame.RELATIVE,
    }.get(frame)


@dataclass(slots=True)
class MissionStore:
    """The list an autopilot keeps, which item is current, and what has been reached.

    `version` goes up with every new list. `reached_total` counts the items reached, of which `reached` holds
    the last ones, so that each link can report them. `uploader` is the client that uploads at present,
    received last at `uploader_heard_s`: one at a time, over all links. `texts` are for the ground, severity
    first.
    """

    rules: MissionRules
    items: list[MissionItem] = field(default_factory=list)
    current: int = 0
    version: int = 0
    finished: bool = False
    reached_total: int = 0
    reached: deque[int] = field(default_factory=lambda: deque(maxlen=32))
    texts: list[tuple[Severity, str]] = field(default_factory=list)
    uploader: object | None = None
    uploader_heard_s: float = -math.inf
    home: Callable[[], MissionItem] = lambda: MissionItem(MissionCommand.WAYPOINT, ItemFrame.GLOBAL)

    def __len__(self) -> int:
        return len(self.items)

    @property
    def flyable(self) -> bool:
        return any(item.command in NAVIGATION for item in self.items[self.rules.first :])

    def item(self, number: int) -> MissionItem:
        """The item of that number; item 0 is where home is now, for an autopilot that keeps it there: it
        can be read even without a mission.

        Raises:
            IndexError: there is none.
        """
        if number == 0 and self.rules.home_first:
            return self.home()
        if number < 0:
            raise IndexError(number)
        return self.items[number]

    def begin_upload(self, count: int) -> list[MissionItem]:
        """The list that an upload of that many items writes to."""
        if not self.rules.writes_in_place:
            return []
        del self.items[count:]
        self._renewed()
        return self.items

    def finish_upload(self, items: list[MissionItem]) -> None:
        """The list is complete."""
        self.items = items
        self._renewed()
        if not self.rules.writes_in_place:
            self.current = 0
        self.send_text(Severity.INFO, self.rules.received_text)

    def clear(self) -> None:
        self.items = []
        self._renewed()

    def select(self, number: int) -> bool:
        """Make an item the current one; False (and a text) when there is none of that number."""
        if not 0 <= number < len(self.items):
            self.send_text(Severity.CRITICAL, self.rules.unknown_current_text)
            return False
        self.current, self.finished = number, False
        self.version += 1
        return True

    def rewind(self) -> None:
        """Back to the beginning, as after landing."""
        self.current, self.finished = 0, False

    def reach(self, number: int) -> None:
        """An item is done: report it on all links."""
        self.reached.append(number)
        self.reached_total += 1
        self.send_text(
            Severity.INFO, self.rules.reached_text.format(number=number) if self.rules.reached_text else ""
        )

    def send_text(self, severity: Severity, text: str) -> None:
        """Queue a text for the ground; an empty one is not sent."""
        if text:
            self.texts.append((severity, text))

    def landing_start(self) -> int | None:
        """Number of the item DO_LAND_START, None without."""
        numbered = enumerate(self.items)
        return next((k for k, item in numbered if item.command == MissionCommand.DO_LAND_START), None)

    def starts_with_take_off(self) -> bool:
        flown = (item for item in self.items[self.rules.first :] if item.command in NAVIGATION)
        first = next(flown, None)
        return first is not None and first.command == MissionCommand.TAKEOFF

    def _renewed(self) -> None:
        self.finished = False
        self.current = min(self.current, max(0, len(self.items) - 1))
        self.version += 1


def heading_rad(degrees: float) -> float:
    """A heading parameter in radians; NaN stays NaN and means "not given"."""
    return math.radians(math.fmod(degrees, 360.0)) if isfinite(degrees) else nan


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
