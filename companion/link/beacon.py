"""The pad's own position over MAVLink: FOLLOW_TARGET to PadBeacon. Pure.

Metres, not centimetres; velocity in NED, m/s. Whoever sends it leads the vehicle, so what cannot be is
refused here, and who is accepted is the session's business.
"""

from __future__ import annotations

import math
from typing import Final

from companion.base.geometry import ZERO3, norm, vector3
from companion.base.messages import PadBeacon
from companion.link.codec import Message

_HAS_POSITION: Final = 0b01
_HAS_VELOCITY: Final = 0b10
_UNKNOWN_STD_M: Final = 5.0
_POLE_E7: Final = 900_000_000
_DATE_LINE_E7: Final = 1_800_000_000


def pad_beacon(message: Message, time_s: float, maximum_speed_m_s: float) -> PadBeacon | None:
    """The beacon in a FOLLOW_TARGET that came at `time_s`; None when it holds nothing plausible.

    That is: no position, the zero of a receiver without a fix, a place that is not on Earth, a number that
    is none, a speed that no pad has. The sender's clock is not ours, so the time of arrival counts. An
    accuracy that is not given is 5 m.
    """
    if not message.est_capabilities & _HAS_POSITION or not _is_a_place(message.lat, message.lon):
        return None
    velocity = vector3(message.vel) if message.est_capabilities & _HAS_VELOCITY else ZERO3
    std_m = max(message.position_cov[:2])
    values = (*velocity, message.alt, *message.position_cov[:2])
    if not all(math.isfinite(value) for value in values) or norm(velocity) > maximum_speed_m_s:
        return None
    return PadBeacon(
        time_s=time_s,
        latitude_deg=message.lat * 1e-7,
        longitude_deg=message.lon * 1e-7,
        altitude_m=message.alt,
        velocity_ned_m_s=velocity,
        position_std_m=std_m if std_m > 0.0 else _UNKNOWN_STD_M,
    )


def _is_a_place(latitude_e7: int, longitude_e7: int) -> bool:
    if latitude_e7 == 0 and longitude_e7 == 0:
        return False
    return abs(latitude_e7) <= _POLE_E7 and abs(longitude_e7) <= _DATE_LINE_E7
