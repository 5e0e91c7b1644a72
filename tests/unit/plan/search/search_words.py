"""Sights and beacons for the search."""

from companion.base.geometry import geodetic_from_ned
from companion.base.messages import PadBeacon
from companion.config import SearchConfig
from companion.plan.landing.relative_state import PadTrack

ORIGIN = (47.0, 8.0, 400.0)
CONFIG = SearchConfig()
UNSEEN = PadTrack(1, 0.5)


def beacon(time_s: float, north: float, east: float, velocity: tuple[float, float, float]) -> PadBeacon:
    latitude, longitude, altitude = geodetic_from_ned((north, east, 0.0), ORIGIN)
    return PadBeacon(time_s, latitude, longitude, altitude, velocity, 1.5)
