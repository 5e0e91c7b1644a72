"""One epoch's messages of a GPS receiver to one fix, and the epochs' times to ours.

Altitudes are above mean sea level, positions in degrees, velocities NED in m/s. Messages and their units:
u-blox 6 Receiver Description GPS.G6-SW-10018. What is no three-dimensional, valid fix gives None.
"""

import math
from typing import Any, Final

import pymap3d

from companion.base.messages import GpsFix

_FIX_3D: Final = (3, 4)  # 3D, and GPS with dead reckoning
_KNOT_M_S: Final = 1852.0 / 3600.0
_RANGE_ERROR_M: Final = 2.5  # NEO-6M data sheet: 2.5 m CEP; times the dilution of precision
_NMEA_SPEED_ACCURACY_M_S: Final = 2.0
_UNKNOWN_SPEED_M_S: Final = 50.0  # accuracy where none is given
_GEOID_UNCERTAINTY_M: Final = 50.0  # sea level is within 110 m of the ellipsoid
_SMALLEST_RADIUS_M: Final = 6.3e6
_CLOCK_DRIFT: Final = 50e-6
_DAY_S: Final = 86400.0  # where a time of day turns over, and a time of week too
_LATE_S: Final = 0.03
_LATE_EPOCHS: Final = 8


class EpochClock:
    """The receiver's time scale on the app's clock.

    Messages are sent and read late now and then, never early: the smallest delay seen is the one that
    counts, and it is let grow by the drift that two quartz clocks can have. So what comes early shows at once
    that the receiver has set its clock; what comes late only when it stays as late: what was held up, by
    whomever, comes in a heap, each epoch less late than the one before. Only epochs with a fix may come here:
    before that the receiver's clock is its own quartz, and steps.
    """

    def __init__(self) -> None:
        self._offset_s = math.inf
        self._epoch_s = 0.0  # the last one, counted on over the turn of day and week
        self._late_s: list[float] = []

    def local_s(self, epoch_s: float, began_s: float) -> float:
        """App time of the receiver's `epoch_s`, whose messages began at `began_s`, plus the least delay."""
        if math.isinf(self._offset_s):
            self._epoch_s = epoch_s
        step_s = math.remainder(epoch_s - self._epoch_s, _DAY_S)
        self._epoch_s += step_s
        offset_s = began_s - self._epoch_s
        grown_s = self._offset_s + _CLOCK_DRIFT * abs(step_s)
        if self._late_s and offset_s < min(self._late_s) - _LATE_S:
            self._late_s = []  # still catching up
        self._late_s = [*self._late_s, offset_s] if offset_s > grown_s + _LATE_S else []
        stepped = len(self._late_s) >= _LATE_EPOCHS
        self._offset_s = min(self._late_s) if stepped else min(offset_s, grown_s)
        return self._epoch_s + self._offset_s


def fix_from_ubx(time_s: float, posllh: Any, velned: Any, sol: Any) -> GpsFix | None:
    """One fix of an epoch's three messages (mm, cm/s and 1e-7 degrees in u-blox's units)."""
    return _fix(time_s, posllh, velned, 100.0, sol.numSV) if has_fix(sol) else None


def fix_from_sol(time_s: float, sol: Any, geoid_separation_m: float | None) -> GpsFix | None:
    """One fix of NAV-SOL alone (ECEF, cm), which knows the ellipsoid but not the sea.

    Without the geoid's separation the altitude is the ellipsoid's, and as uncertain as that.
    """
    ecef_m = (sol.ecefX / 100.0, sol.ecefY / 100.0, sol.ecefZ / 100.0)
    if not has_fix(sol) or math.hypot(*ecef_m) < _SMALLEST_RADIUS_M:
        return None
    latitude, longitude, height = (float(value) for value in pymap3d.ecef2geodetic(*ecef_m))
    velocity = (sol.ecefVX / 100.0, sol.ecefVY / 100.0, sol.ecefVZ / 100.0)
    east, north, up = (float(v) for v in pymap3d.uvw2enu(*velocity, latitude, longitude))
    accuracy_m = sol.pAcc / 100.0
    unknown_m = _GEOID_UNCERTAINTY_M if geoid_separation_m is None else 0.0
    return GpsFix(
        time_s=time_s,
        latitude_deg=latitude,
        longitude_deg=longitude,
        altitude_m=height - (geoid_separation_m or 0.0),
        velocity_ned_m_s=(north, east, -up),
        horizontal_accuracy_m=accuracy_m,
        vertical_accuracy_m=math.hypot(accuracy_m, unknown_m),
        speed_accuracy_m_s=sol.sAcc / 100.0,
        satellites=int(sol.numSV),
    )


def fix_from_pvt(time_s: float, pvt: Any) -> GpsFix | None:
    """One fix of NAV-PVT (mm, mm/s and 1e-7 degrees in u-blox's units)."""
    valid = pvt.fixType in _FIX_3D and pvt.gnssFixOk
    return _fix(time_s, pvt, pvt, 1000.0, pvt.numSV) if valid else None


def _fix(time_s: float, place: Any, motion: Any, units_m_s: float, satellites: int) -> GpsFix:
    """Of a place in mm and 1e-7 degrees, and a motion of which so many units are 1 m/s."""
    return GpsFix(
        time_s=time_s,
        latitude_deg=float(place.lat),
        longitude_deg=float(place.lon),
        altitude_m=place.hMSL / 1000.0,
        velocity_ned_m_s=(motion.velN / units_m_s, motion.velE / units_m_s, motion.velD / units_m_s),
        horizontal_accuracy_m=place.hAcc / 1000.0,
        vertical_accuracy_m=place.vAcc / 1000.0,
        speed_accuracy_m_s=motion.sAcc / units_m_s,
        satellites=int(satellites),
    )


def fix_from_nmea(time_s: float, rmc: Any, gga: Any) -> GpsFix | None:
    """One fix of RMC and GGA; the vertical speed is not in them: 0, and as good as unknown."""
    numbers = (gga.lat, gga.lon, gga.alt, gga.HDOP, gga.numSV, rmc.spd)
    if rmc.status != "A" or not gga.quality or not all(_is_finite(n) for n in numbers):
        return None
    # a receiver at rest leaves the course out
    course = math.radians(rmc.cog) if _is_finite(rmc.cog) else 0.0
    speed_m_s = rmc.spd * _KNOT_M_S if _is_finite(rmc.cog) else 0.0
    accuracy_m = _RANGE_ERROR_M * max(1.0, gga.HDOP)
    return GpsFix(
        time_s=time_s,
        latitude_deg=float(gga.lat),
        longitude_deg=float(gga.lon),
        altitude_m=float(gga.alt),
        velocity_ned_m_s=(speed_m_s * math.cos(course), speed_m_s * math.sin(course), 0.0),
        horizontal_accuracy_m=accuracy_m,
        vertical_accuracy_m=1.5 * accuracy_m,
        speed_accuracy_m_s=_NMEA_SPEED_ACCURACY_M_S,
        satellites=int(gga.numSV),
        vertical_speed_accuracy_m_s=_UNKNOWN_SPEED_M_S,
    )


def has_fix(sol: Any) -> bool:
    """Whether a NAV-SOL tells of a valid fix in three dimensions."""
    return sol.gpsFix in _FIX_3D and bool(sol.gpsfixOK)


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)
