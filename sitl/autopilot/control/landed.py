"""Landed detection, as real autopilots do it, from thrust and vertical motion alone.

Contact is suspected when a descent is commanded, thrust is clearly below hover thrust, and the vehicle still
neither moves nor accelerates vertically. The autopilot then reduces its thrust: in the air the vehicle would
start to fall, which ends the suspicion; on the ground nothing happens, and after `landed_time_s` it has
landed.
"""

from __future__ import annotations

from dataclasses import dataclass

_CONTACT_AFTER_S = 0.35
_ACCELERATION_LIMIT_M_S2 = 1.0
_ACCELERATION_FILTER_S = 0.1


@dataclass(slots=True)
class LandedDetector:
    """`landed` and `contact` after each `update`; starts on the ground.

    `low_thrust_share` of the hover thrust is what a descent in the air never falls below for long.
    """

    landed_time_s: float
    low_thrust_share: float = 0.85
    landed: bool = True
    contact: bool = False
    _sign_for_s: float = 0.0
    _acceleration: float = 0.0
    _last_speed: float = 0.0

    def update(
        self, descending: bool, thrust_share: float, speed_m_s: float, speed_limit_m_s: float, dt_s: float
    ) -> None:
        """Take in one outer step: is a descent commanded, the thrust over the hover's, the vertical speed."""
        share = dt_s / (dt_s + _ACCELERATION_FILTER_S)
        self._acceleration += share * ((speed_m_s - self._last_speed) / dt_s - self._acceleration)
        self._last_speed = speed_m_s
        if self.landed:
            return
        still = abs(speed_m_s) < speed_limit_m_s and abs(self._acceleration) < _ACCELERATION_LIMIT_M_S2
        if not (descending and still and (self.contact or thrust_share < self.low_thrust_share)):
            self._sign_for_s, self.contact = 0.0, False
            return
        self._sign_for_s += dt_s
        self.contact = self._sign_for_s >= _CONTACT_AFTER_S
        self.landed = self._sign_for_s >= self.landed_time_s

    def lift_off(self) -> None:
        """Take-off: no longer on the ground."""
        self.landed = self.contact = False
        self._sign_for_s = 0.0
