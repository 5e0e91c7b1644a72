"""The pad's own position over MAVLink: FOLLOW_TARGET or GLOBAL_POSITION_INT to PadBeacon. Pure.

Metres, or centimetres with RTK; velocity in NED, m/s. Whoever sends it leads the vehicle, so what cannot be
is refused, and so is what was not asked for: ground stations stream their operator's own position as
FOLLOW_TARGET, too (QGroundControl's Follow Me), and every vehicle its own as GLOBAL_POSITION_INT.
"""

import math
from typing import Final

from companion.base.geometry import ZERO3, norm, vector3
from companion.base.messages import PadBeacon
from companion.config import LinkConfig
from companion.link.codec import Message, mavlink

_HAS_POSITION: Final = 0b01
_HAS_VELOCITY: Final = 0b10
_UNKNOWN_STD_M: Final = 5.0
_VELOCITY_STD_M_S: Final = 0.3  # neither message tells it: a receiver's 0.1, and what a pad turns meanwhile
_POLE_E7: Final = 900_000_000
_DATE_LINE_E7: Final = 1_800_000_000
SYSTEM_BEACON_MESSAGES: Final = frozenset(
    {mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT}
)
# The fix, the answer, and a slow radio: so long after COMMAND_ACK what comes is the answer.
ANSWER_S: Final = 8.0
ACCURACY_LASTS_S: Final = 3.0


class BeaconListener:
    """Which position is the pad's: the newest one is `beacon`.

    FOLLOW_TARGET has to come from the ground station: as the answer to our request, which its component has
    accepted by COMMAND_ACK, or from the component that the settings name, and then from no other. Of a system
    that the settings name GLOBAL_POSITION_INT is the pad's, as accurate as its GPS_RAW_INT says, and then
    nothing else is.
    """

    def __init__(self, config: LinkConfig) -> None:
        self._config = config
        self._accepted_s: dict[int, float] = {}  # by component
        self.beacon: PadBeacon | None = None
        self.ignored: tuple[int, int] | None = None
        # by its GPS_RAW_INT; a system that sends none has a fix for all that is known
        self._stds_m: tuple[float, float | None] = (_UNKNOWN_STD_M, None)
        self._told_s, self._has_fix = -math.inf, True

    def is_beacons(self, message: Message) -> bool:
        """Whether it comes from the system that is the pad's."""
        system_id: int = message.get_srcSystem()
        return system_id == self._config.beacon_system_id

    def hear_system(self, message: Message, now_s: float) -> None:
        """Anything of the system that is the pad's."""
        message_id = message.get_msgId()
        if message_id == mavlink.MAVLINK_MSG_ID_GPS_RAW_INT:
            across_m, up_m = 1e-3 * message.h_acc, 1e-3 * message.v_acc
            self._stds_m, self._told_s = (across_m or _UNKNOWN_STD_M, up_m or None), now_s
            self._has_fix = message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX
        elif message_id == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT and self._has_fix:
            if now_s - self._told_s > ACCURACY_LASTS_S:
                self._stds_m = (_UNKNOWN_STD_M, None)
            most_m_s = self._config.maximum_pad_speed_m_s
            self.beacon = system_beacon(message, now_s, most_m_s, self._stds_m) or self.beacon

    def accepted(self, component_id: int, now_s: float) -> None:
        """A component of the ground station's will answer our request."""
        self._accepted_s[component_id] = now_s

    def hear(self, message: Message, now_s: float) -> None:
        """A FOLLOW_TARGET."""
        system_id, component_id = message.get_srcSystem(), message.get_srcComponent()
        named, config = self._config.beacon_component_id, self._config
        if named is None:
            wanted = now_s - self._accepted_s.get(component_id, -math.inf) <= ANSWER_S
        else:
            wanted = component_id == named
        wanted = wanted and config.beacon_system_id is None
        if wanted and system_id == config.ground_system_id:
            self.beacon = pad_beacon(message, now_s, config.maximum_pad_speed_m_s) or self.beacon
        else:
            self.ignored = (system_id, component_id)

    def hint(self) -> str:
        """What may be the reason for no answer, in words to follow other words; "" when nothing is known."""
        if self.ignored is None:
            return ""
        system_id, component_id = self.ignored
        if system_id != self._config.ground_system_id:
            return f" (system {system_id} has one; link.ground_system_id is another)"
        return f" (component {component_id} sends one unasked: see link.beacon_component_id)"


def pad_beacon(message: Message, time_s: float, maximum_speed_m_s: float) -> PadBeacon | None:
    """The beacon in a FOLLOW_TARGET that came at `time_s`; None when it holds nothing plausible.

    That is: no position, the zero of a receiver without a fix, a place that is not on Earth, a number that
    is none, a speed that no pad has. The sender's clock is not ours, so the time of arrival counts. An
    accuracy that is not given is 5 m.
    """
    if not message.est_capabilities & _HAS_POSITION or not _is_a_place(message.lat, message.lon):
        return None
    velocity = vector3(message.vel) if message.est_capabilities & _HAS_VELOCITY else ZERO3
    std_m, up_m = max(message.position_cov[:2]), message.position_cov[2]
    values = (*velocity, message.alt, *message.position_cov)
    if not all(math.isfinite(value) for value in values) or norm(velocity) > maximum_speed_m_s:
        return None
    return PadBeacon(
        time_s=time_s,
        latitude_deg=message.lat * 1e-7,
        longitude_deg=message.lon * 1e-7,
        altitude_m=message.alt,
        velocity_ned_m_s=velocity,
        position_std_m=std_m if std_m > 0.0 else _UNKNOWN_STD_M,
        vertical_std_m=up_m if up_m > 0.0 else None,
        velocity_std_m_s=_VELOCITY_STD_M_S if message.est_capabilities & _HAS_VELOCITY else None,
        fix_time_s=1e-3 * message.timestamp,
    )


def system_beacon(
    message: Message, time_s: float, maximum_speed_m_s: float, stds_m: tuple[float, float | None]
) -> PadBeacon | None:
    """The beacon in a GLOBAL_POSITION_INT that came at `time_s`; None when it holds nothing plausible.

    `stds_m`: of its position across and up (None: unknown).
    """
    velocity = (0.01 * message.vx, 0.01 * message.vy, 0.01 * message.vz)
    if not _is_a_place(message.lat, message.lon) or norm(velocity) > maximum_speed_m_s:
        return None
    return PadBeacon(
        time_s=time_s,
        latitude_deg=message.lat * 1e-7,
        longitude_deg=message.lon * 1e-7,
        altitude_m=1e-3 * message.alt,
        velocity_ned_m_s=velocity,
        position_std_m=stds_m[0],
        vertical_std_m=stds_m[1],
        velocity_std_m_s=_VELOCITY_STD_M_S,
        fix_time_s=1e-3 * message.time_boot_ms,
    )


def _is_a_place(latitude_e7: int, longitude_e7: int) -> bool:
    if latitude_e7 == 0 and longitude_e7 == 0:
        return False
    return abs(latitude_e7) <= _POLE_E7 and abs(longitude_e7) <= _DATE_LINE_E7
