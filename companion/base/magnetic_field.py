"""The Earth's magnetic field by place and date: the World Magnetic Model (WMM), NED, µT.

The model is fitted anew every five years; the coefficients of 2010 to 2029 come with the library. Beyond
those years the nearest model is carried on, which errs by a degree or so in ten years.

The heading takes its declination from the model at the first fix (`field_here`), or from the setting of the
field, which `compare_declination` checks by the model.
"""

import math
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, Final

from pygeomag import GeoMag

from companion.base.geometry import Vector3, wrap_angle
from companion.base.messages import Quantity, SourceComparison

FIRST_YEAR: Final = 2010.0
LAST_YEAR: Final = 2029.99
# of the newest coefficients: a computer whose clock shows an earlier date has not set it yet
NEWEST_EPOCH: Final = 2025.0
# of the model's declination, the crust's field included: the constant part (deg), and the part that grows as
# the horizontal field (nT) becomes weaker (deg nT); World Magnetic Model 2025, technical report, error model
MODEL_STD_DEG: Final = 0.26
MODEL_STD_DEG_NT: Final = 5417.0
_UT_PER_NT: Final = 1e-3


def field_ned_ut(latitude_deg: float, longitude_deg: float, altitude_m: float, year: float) -> Vector3:
    """The field (µT, NED) at a place on WGS-84 and a date as a decimal year."""
    model = _model(int(min(max(year, FIRST_YEAR), LAST_YEAR)))
    field = model.calculate(
        glat=latitude_deg,
        glon=longitude_deg,
        alt=1e-3 * altitude_m,
        time=year,
        allow_date_outside_lifespan=True,
    )
    return (_UT_PER_NT * field.x, _UT_PER_NT * field.y, _UT_PER_NT * field.z)


def field_here(place: Vector3) -> Vector3:
    """The field (µT, NED) at latitude, longitude (deg) and altitude (m), in the newest model's middle year.

    Without a clock: a computer's may not be set yet, and the declination changes by 0.1 to 0.2 deg a year.
    """
    return field_ned_ut(*place, NEWEST_EPOCH + 2.5)


def compare_declination(
    told_ned_ut: Vector3, told_std_ut: float, place: Vector3, unix_s: float
) -> SourceComparison:
    """The declination (deg) of a field that was told (µT, NED) against the model's.

    `told_std_ut`: of each of its components; `place`: latitude and longitude (deg), altitude (m); `unix_s`:
    today, in seconds since 1970.
    """
    year = max(datetime.fromtimestamp(unix_s, UTC).year + 0.5, NEWEST_EPOCH)
    model_ned_ut = field_ned_ut(*place, year)
    told_rad, model_rad = (math.atan2(east, north) for north, east, _ in (told_ned_ut, model_ned_ut))
    told_ut, model_ut = (math.hypot(north, east) for north, east, _ in (told_ned_ut, model_ned_ut))
    model_std_deg = math.hypot(MODEL_STD_DEG, MODEL_STD_DEG_NT * _UT_PER_NT / model_ut)
    return SourceComparison(
        0.0,
        Quantity.DECLINATION,
        f"{math.degrees(told_rad):.1f} deg",
        f"{math.degrees(model_rad):.1f} deg [{', '.join(f'{part:.1f}' for part in model_ned_ut)}] µT",
        difference=math.degrees(abs(wrap_angle(told_rad - model_rad))),
        std=math.hypot(model_std_deg, math.degrees(told_std_ut / told_ut)),
    )


@lru_cache(maxsize=4)
def _model(year: int) -> Any:
    return GeoMag(base_year=year)
