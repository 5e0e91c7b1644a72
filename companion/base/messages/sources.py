"""Two sources of one number, side by side."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Quantity(StrEnum):
    """What holds the vehicle up, and is not believed on one word; see `companion.base.second_sources`."""

    HOVER_THRUST = "hover thrust"
    ATTITUDE = "attitude"
    HEADING = "heading"
    DECLINATION = "magnetic declination"
    HEIGHT_OVER_PAD = "height over the pad"
    PAD_SCALE = "pad's scale"
    CAMERA_ROTATION = "camera's rotation"
    CAMERA_DELAY = "camera's delay"
    IMU_DELAY = "IMU's delay"
    LEG_HEIGHT = "leg height"
    LINK_DELAY = "link's delay"
    CLOCK_RATE = "clock rate"
    VISION_RATE = "vision's rate"
    BATTERY = "battery"


@dataclass(frozen=True, slots=True)
class SourceComparison:
    """What two sources say of a quantity at time_s, in words with their units, and how far they are apart.

    `difference` (not negative) and its standard deviation `std` are in the unit of the quantity's row.
    """

    time_s: float
    quantity: Quantity
    first: str
    second: str
    difference: float
    std: float
