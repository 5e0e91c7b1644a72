"""Where on Earth a vehicle stands: the origin of the world's NED, and the magnetic field there."""

from typing import Final

from pydantic import Field

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import Vector3
from companion.base.magnetic_field import field_ned_ut
from companion.config import ConfigError, StrictModel, validate

# latitude (deg), longitude (deg), altitude (m AMSL) at which the autopilots' own simulators start
USUAL_HOMES: Final[dict[AutopilotKind, Vector3]] = {
    "px4": (47.397742, 8.545594, 488.0),
    "ardupilot": (-35.363262, 149.165237, 584.0),
}
# of the magnetic model, whatever the date: the same seed gives the same flight
FIELD_YEAR: Final = 2026.0
_FIELD_DIGITS: Final = 2  # to 10 nT, as calculators of the model give it
_OPTION: Final = "--home"
_EXPECTED: Final = (
    "expected LAT,LON,ALT,HEADING (deg, deg, m above sea level, deg), as in 47.397742,8.545594,488,90"
)


class HomeSettings(StrictModel):
    """The world's origin."""

    latitude_deg: float = Field(
        ge=-85.0,
        le=85.0,
        description=(
            "Latitude of the world's origin. Without `home` it is where the autopilot's own simulator "
            "starts: 47.397742, 8.545594, 488 m (PX4), -35.363262, 149.165237, 584 m (ArduPilot). The "
            "magnetic field follows the place"
        ),
    )
    longitude_deg: float = Field(ge=-180.0, le=180.0, description="Longitude of the world's origin")
    altitude_m: float = Field(
        default=0.0, ge=-500.0, le=9000.0, description="Altitude of the world's origin above sea level"
    )

    @property
    def place(self) -> Vector3:
        """Latitude (deg), longitude (deg), altitude (m AMSL)."""
        return self.latitude_deg, self.longitude_deg, self.altitude_m


def magnetic_field_ned_ut(place: Vector3) -> Vector3:
    """The Earth's field (µT, NED) at a place (deg, deg, m), as one reads it from the magnetic model."""
    north, east, down = field_ned_ut(*place, FIELD_YEAR)
    return round(north, _FIELD_DIGITS), round(east, _FIELD_DIGITS), round(down, _FIELD_DIGITS)


def read_home(text: str) -> tuple[HomeSettings, float]:
    """Place and heading (deg) in LAT,LON,ALT,HEADING.

    Raises:
        ConfigError: it is something else, or there is no such place.
    """
    try:
        latitude, longitude, altitude, heading = (float(word) for word in text.split(","))
    except ValueError:
        raise ConfigError(f"{_OPTION}: {_EXPECTED}, found '{text}'") from None
    if not -360.0 <= heading <= 360.0:
        raise ConfigError(f"{_OPTION}: expected a heading of -360 to 360 degrees, found {heading:g}")
    place = {"latitude_deg": latitude, "longitude_deg": longitude, "altitude_m": altitude}
    return validate(HomeSettings, place, _OPTION), heading
