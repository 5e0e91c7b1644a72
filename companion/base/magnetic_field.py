"""The Earth's magnetic field by place and date: the World Magnetic Model (WMM), NED, µT.

The model is fitted anew every five years; the coefficients of 2010 to 2029 come with the library. Beyond
those years the nearest model is carried on, which errs by a degree or so in ten years.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

from pygeomag import GeoMag

from companion.base.geometry import Vector3

FIRST_YEAR: Final = 2010.0
LAST_YEAR: Final = 2029.99
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


@lru_cache(maxsize=4)
def _model(year: int) -> Any:
    return GeoMag(base_year=year)
