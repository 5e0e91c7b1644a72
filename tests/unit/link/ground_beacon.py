"""What a ground station sends of the pad's own GPS."""

from companion.base.geometry import IDENTITY, ZERO3
from companion.base.messages import PadBeacon
from companion.link.codec import Message, mavlink

_HAS_POSITION_AND_VELOCITY = 0b11


def follow_target(beacon: PadBeacon) -> Message:
    """FOLLOW_TARGET of a pad's own GPS, as the ground station sends it, stamped with its own time."""
    return mavlink.MAVLink_follow_target_message(
        int(beacon.time_s * 1000.0), _HAS_POSITION_AND_VELOCITY,
        round(beacon.latitude_deg * 1e7), round(beacon.longitude_deg * 1e7), beacon.altitude_m,
        list(beacon.velocity_ned_m_s), list(ZERO3), list(IDENTITY), list(ZERO3),
        [beacon.position_std_m, beacon.position_std_m, beacon.position_std_m], 0,
    )  # fmt: skip
