"""What is known of the pad right now, and whether it is seen steadily.

The estimates come predicted to the cycle's time. Relative quantities are pad minus vehicle, NED axes, as in
`PadState`. Metres, seconds, radians.
"""

from __future__ import annotations

import math
from dataclasses import replace

from companion.base.geometry import add, wrap_angle, yaw_from_quat
from companion.base.messages import PadState, VehicleState
from companion.base.motion import Motion
from companion.plan.landing.contact import KNOWN_S, UNSEEN_S

# A heading farther off the pad's is told; so is a pad that turns faster.
_HEADING_OFF_DEG = 15.0
_TURNS_DEG_S = 10.0


def vehicle_motion(vehicle: VehicleState) -> Motion:
    """The vehicle in the EKF's NED, without acceleration."""
    return Motion(vehicle.position_ned_m, vehicle.velocity_ned_m_s)


def misaligned_heading(pad: PadState | None, vehicle: VehicleState | None) -> str:
    """In words, how far the vehicle's heading is off the pad's; "" when it is near."""
    if pad is None or vehicle is None:
        return ""
    off_deg = abs(math.degrees(wrap_angle(pad.heading_rad - yaw_from_quat(vehicle.attitude))))
    rate_deg_s = abs(math.degrees(pad.heading_rate_rad_s))
    turns = f"; the pad turns at {rate_deg_s:.0f} deg/s" if rate_deg_s > _TURNS_DEG_S else ""
    return f"heading {off_deg:.0f} deg off the pad's{turns}" if off_deg > _HEADING_OFF_DEG else ""


class PadTrack:
    """What the planner holds of the pad: `sight`, and its motion in the EKF's NED.

    `sight` is the pad's estimate, seen or predicted, and None before the first sighting and `forget_s` (10 s)
    after the last. Whether the pad is seen says `sight.unseen_s`.

    It is seen steadily after so many sightings, none longer than `KNOWN_S` after the one before. They are
    counted, whatever time they take: a slow computer sees the pad in every frame of fewer.
    """

    def __init__(self, sightings: int) -> None:
        self._needed, self._count = sightings, 0
        self.sight: PadState | None = None
        self._last: PadState | None = None  # the same, kept while there is no estimate
        self.motion: Motion | None = None

    def update(self, pad: PadState | None, vehicle: VehicleState | None, now_s: float) -> None:
        """Take in a cycle's estimates; the motion of the last cycle that had both is kept."""
        if pad is None:
            self.sight = None
            return
        self.sight = self._last = replace(pad, delay_s=self._delay_s(pad.seen_time_s, now_s))
        if vehicle is not None:
            place = add(vehicle.position_ned_m, pad.relative_position_ned_m)
            self.motion = Motion(place, pad.velocity_ned_m_s, pad.acceleration_ned_m_s2)

    def _delay_s(self, seen_s: float, now_s: float) -> float:
        """From the exposure of the newest sighting until it came; one that has come by now is counted."""
        before = self._last
        if before is not None and seen_s <= before.seen_time_s:
            return before.delay_s
        follows = before is not None and seen_s - before.seen_time_s <= KNOWN_S
        self._count = self._count + 1 if follows else 1
        # how long ago the first one came is not known; one that comes later than a pad is known for is old
        return 0.0 if before is None else min(max(0.0, now_s - seen_s), KNOWN_S - UNSEEN_S)

    def steady(self, now_s: float) -> bool:
        """Whether the pad is in view, not just for a frame."""
        if self._last is None or self.motion is None:
            return False
        return self._count >= self._needed and now_s - self._last.seen_time_s <= KNOWN_S

    def distrust(self) -> None:
        """What was seen proved wrong: only new sightings count."""
        self._count = 0
