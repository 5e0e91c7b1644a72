"""What is known of the pad right now: the estimate predicted to now, and whether the pad is seen steadily.

Relative quantities are pad minus vehicle, NED axes, as in `PadState`. Metres, seconds, radians.
"""

from __future__ import annotations

import math
from dataclasses import replace

from companion.base.geometry import add, scale, wrap_angle, yaw_from_quat
from companion.base.messages import PadState, VehicleState
from companion.base.motion import Motion
from companion.plan.landing.contact import KNOWN_S, UNSEEN_S

# the prediction's longest step: an estimate that is older shows in `seen_time_s` instead
_LONGEST_STEP_S = 0.3
# A heading farther off the pad's is told; so is a pad that turns faster.
_HEADING_OFF_DEG = 15.0
_TURNS_DEG_S = 10.0


def predicted(pad: PadState | None, now_s: float) -> PadState | None:
    """The newest estimate predicted to now: at constant relative velocity, turning at constant rate."""
    if pad is None:
        return None
    step_s = min(_LONGEST_STEP_S, max(0.0, now_s - pad.time_s))
    return replace(
        pad,
        time_s=now_s,
        relative_position_ned_m=add(
            pad.relative_position_ned_m, scale(pad.relative_velocity_ned_m_s, step_s)
        ),
        heading_rad=pad.heading_rad + pad.heading_rate_rad_s * step_s,
    )


def pad_motion(vehicle: VehicleState, pad: PadState, now_s: float) -> Motion:
    """The pad in the EKF's NED, predicted to now; `pad` is predicted to now already."""
    return Motion(
        add(vehicle_motion(vehicle, now_s).position_m, pad.relative_position_ned_m),
        pad.velocity_ned_m_s,
        pad.acceleration_ned_m_s2,
    )


def vehicle_motion(vehicle: VehicleState, now_s: float) -> Motion:
    """The vehicle in the EKF's NED, predicted to now, without acceleration."""
    step_s = min(_LONGEST_STEP_S, max(0.0, now_s - vehicle.time_s))
    p, d = vehicle.position_ned_m, scale(vehicle.velocity_ned_m_s, step_s)
    return Motion((p[0] + d[0], p[1] + d[1], p[2] + d[2]), vehicle.velocity_ned_m_s)


def misaligned_heading(pad: PadState | None, vehicle: VehicleState | None) -> str:
    """In words, how far the vehicle's heading is off the pad's; "" when it is near."""
    if pad is None or vehicle is None:
        return ""
    off_deg = abs(math.degrees(wrap_angle(pad.heading_rad - yaw_from_quat(vehicle.attitude))))
    rate_deg_s = abs(math.degrees(pad.heading_rate_rad_s))
    turns = f"; the pad turns at {rate_deg_s:.0f} deg/s" if rate_deg_s > _TURNS_DEG_S else ""
    return f"heading {off_deg:.0f} deg off the pad's{turns}" if off_deg > _HEADING_OFF_DEG else ""


class SteadySightings:
    """Whether the pad is seen steadily: so many sightings, none longer than a gap after the one before.

    They are counted, whatever time they take: a slow computer sees the pad in every frame of fewer.
    """

    def __init__(self, count: int, gap_s: float) -> None:
        self._needed, self._gap_s = count, gap_s
        self._count = 0
        self._seen_s = -math.inf
        self.delay_s = 0.0  # of the newest one: from its exposure until it came

    def note(self, pad: PadState | None, now_s: float) -> None:
        """Count the newest sighting, which has come by now."""
        if pad is None or pad.seen_time_s <= self._seen_s:
            return
        self._count = self._count + 1 if pad.seen_time_s - self._seen_s <= self._gap_s else 1
        # how long ago the first one came is not known; one that comes later than a pad is known for is old
        delay_s = now_s - pad.seen_time_s if math.isfinite(self._seen_s) else 0.0
        self.delay_s = min(max(0.0, delay_s), KNOWN_S - UNSEEN_S)
        self._seen_s = pad.seen_time_s

    def forget(self) -> None:
        """Count from zero again."""
        self._count = 0

    def steady(self, now_s: float) -> bool:
        """Whether enough have come, the newest one not long ago."""
        return self._count >= self._needed and now_s - self._seen_s <= self._gap_s


class PadTrack:
    """What the planner holds of the pad: `sight`, predicted to now, and its motion in the EKF's NED."""

    def __init__(self, sightings: int, gap_s: float) -> None:
        self._sightings = SteadySightings(sightings, gap_s)
        self.sight: PadState | None = None
        self.motion: Motion | None = None

    def update(self, pad: PadState | None, vehicle: VehicleState | None, now_s: float) -> None:
        """Take in a cycle's estimates; the motion of the last cycle that had both is kept."""
        self._sightings.note(pad, now_s)
        sight = predicted(pad, now_s)
        self.sight = None if sight is None else replace(sight, delay_s=self._sightings.delay_s)
        if self.sight is not None and vehicle is not None:
            self.motion = pad_motion(vehicle, self.sight, now_s)

    def steady(self, now_s: float) -> bool:
        """Whether the pad is in view, not just for a frame."""
        return self.motion is not None and self._sightings.steady(now_s)

    def distrust(self) -> None:
        """What was seen proved wrong: only new sightings count."""
        self._sightings.forget()

    def in_words(self) -> str:
        """Where it is, for a notice."""
        if self.sight is None:
            return "in sight"
        return f"lateral offset {self.sight.lateral_m:.1f} m, {self.sight.height_m:.1f} m below"
