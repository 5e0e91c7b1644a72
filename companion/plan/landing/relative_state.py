"""What is known of the pad right now: where the vehicle is relative to it, and how old that is.

Vehicle minus pad, NED axes: straight above the pad the position is (0, 0, -height). Heights here are of
the vehicle's reference point over the pad's surface. Metres, seconds, radians.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from companion.base.geometry import Vector3, scale, subtract
from companion.base.messages import PadState, VehicleState
from companion.plan.trajectory.min_jerk import Motion

# A filter that lags by more than this is not led further: its age shows in `seen_time_s` instead.
_LONGEST_LEAD_S = 0.3


@dataclass(frozen=True, slots=True)
class Sight:
    """The vehicle relative to the pad, led to now."""

    position_m: Vector3
    velocity_m_s: Vector3
    pad_velocity_ned_m_s: Vector3
    pad_acceleration_ned_m_s2: Vector3
    pad_heading_rad: float
    age_s: float  # since the pad was last seen
    position_std_m: float = 0.0
    velocity_std_m_s: float = 0.0

    @property
    def height_m(self) -> float:
        """Height of the reference point over the pad."""
        return -self.position_m[2]

    @property
    def lateral_m(self) -> float:
        """Horizontal distance from the point above the pad's centre."""
        return math.hypot(self.position_m[0], self.position_m[1])

    @property
    def lateral_speed_m_s(self) -> float:
        """Horizontal speed relative to the pad."""
        return math.hypot(self.velocity_m_s[0], self.velocity_m_s[1])

    @property
    def motion(self) -> Motion:
        """Position and velocity relative to the pad, without acceleration."""
        return Motion(self.position_m, self.velocity_m_s)


def look(pad: PadState | None, now_s: float) -> Sight | None:
    """The pad filter's newest word, led to now by its relative velocity."""
    if pad is None:
        return None
    lead_s = min(_LONGEST_LEAD_S, max(0.0, now_s - pad.time_s))
    p, v = pad.relative_position_ned_m, pad.relative_velocity_ned_m_s
    return Sight(
        position_m=(-p[0] - v[0] * lead_s, -p[1] - v[1] * lead_s, -p[2] - v[2] * lead_s),
        velocity_m_s=(-v[0], -v[1], -v[2]),
        pad_velocity_ned_m_s=pad.velocity_ned_m_s,
        pad_acceleration_ned_m_s2=pad.acceleration_ned_m_s2,
        pad_heading_rad=pad.heading_rad + pad.heading_rate_rad_s * lead_s,
        age_s=max(0.0, now_s - pad.seen_time_s),
        position_std_m=pad.position_std_m,
        velocity_std_m_s=pad.velocity_std_m_s,
    )


def pad_motion(vehicle: VehicleState, sight: Sight, now_s: float) -> Motion:
    """The pad in the EKF's NED, led to now."""
    return Motion(
        subtract(vehicle_motion(vehicle, now_s).position_m, sight.position_m),
        sight.pad_velocity_ned_m_s,
        sight.pad_acceleration_ned_m_s2,
    )


def vehicle_motion(vehicle: VehicleState, now_s: float) -> Motion:
    """The vehicle in the EKF's NED, led to now, without acceleration."""
    lead_s = min(_LONGEST_LEAD_S, max(0.0, now_s - vehicle.time_s))
    p, d = vehicle.position_ned_m, scale(vehicle.velocity_ned_m_s, lead_s)
    return Motion((p[0] + d[0], p[1] + d[1], p[2] + d[2]), vehicle.velocity_ned_m_s)


class Sightings:
    """Whether the pad is seen steadily: so many sightings within a window."""

    def __init__(self, count: int, window_s: float) -> None:
        self._window_s = window_s
        self._times_s: deque[float] = deque(maxlen=count)

    def note(self, pad: PadState | None) -> None:
        """Remember the time of the newest sighting."""
        if pad is not None and (not self._times_s or pad.seen_time_s > self._times_s[-1]):
            self._times_s.append(pad.seen_time_s)

    def forget(self) -> None:
        """Begin to count anew."""
        self._times_s.clear()

    def steady(self, now_s: float) -> bool:
        """Whether the last `count` sightings all lie within the window before now."""
        times = self._times_s
        return len(times) == times.maxlen and now_s - times[0] <= self._window_s


class PadKnowledge:
    """What the planner holds of the pad: the sight of this cycle, and its motion in the EKF's NED."""

    def __init__(self, sightings: int, window_s: float) -> None:
        self._sightings = Sightings(sightings, window_s)
        self.sight: Sight | None = None
        self.motion: Motion | None = None

    def update(self, pad: PadState | None, vehicle: VehicleState | None, now_s: float) -> None:
        """Take in a cycle's estimates; the motion of the last cycle that had both is kept."""
        self._sightings.note(pad)
        self.sight = look(pad, now_s)
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
        return f"{self.sight.lateral_m:.1f} m aside, {self.sight.height_m:.1f} m below"
