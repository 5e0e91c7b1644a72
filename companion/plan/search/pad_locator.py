"""Where the pad is likely to be: by the ground station's beacon, the last sighting, or where a search began.

Each is a `Lead`; the newest counts, and is predicted along its arc for a while only. The pad's own GPS is off
by metres, but its error changes slowly: a sighting shows it. EKF's NED, m, s and rad.
"""

import math
from dataclasses import dataclass

from companion.base.geometry import ZERO3, Vector3, add, ned_from_geodetic, wrap_angle
from companion.base.messages import CarriedPad, PadBeacon
from companion.base.motion import COURSE_M_S, Motion
from companion.base.second_sources import SIGMA_THRESHOLD
from companion.config import SearchConfig
from companion.plan.trajectory.coordinate_frames import FASTEST_TURN_RAD_S, along_arc

# Courses are compared over this time: over less they differ by noise, over more it may have circled.
_TURN_OVER_S = 1.0
_LONGEST_TURN_OVER_S = 3.0
# A turn that accelerates more is followed in part: the vehicle has to tilt for it as well.
_MOST_ACCELERATION_M_S2 = 2.0
# A sighting this much older still gives the beacon's offset; a larger one is no offset.
_COMPARABLE_S = 1.5
_LARGEST_OFFSET_M = 10.0


@dataclass(frozen=True, slots=True)
class Lead:
    """Where the pad was at a time, and how it moved; horizontal, EKF's NED."""

    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3 = ZERO3
    turn_rate_rad_s: float = 0.0

    def at(self, now_s: float, longest_s: float) -> Motion:
        """Where it should be now, along an arc; after longest_s it is taken to stand where it was by then."""
        age_s = now_s - self.time_s
        t = max(0.0, min(age_s, longest_s))
        p, v, w = self.position_ned_m, self.velocity_ned_m_s, self.turn_rate_rad_s
        place = (*along_arc(p, v, w, t), 0.0)
        if age_s >= longest_s:
            return Motion(place)
        c, s = math.cos(w * t), math.sin(w * t)
        vx, vy = c * v[0] - s * v[1], s * v[0] + c * v[1]
        followed = math.copysign(min(abs(w), _MOST_ACCELERATION_M_S2 / max(math.hypot(vx, vy), 1e-6)), w)
        return Motion(place, (vx, vy, 0.0), (-followed * vy, followed * vx, 0.0))


def turn_rate(before: Lead | None, time_s: float, velocity: Vector3) -> float:
    """Rate (rad/s, clockwise from above) at which the course turned since an earlier beacon.

    One that is too recent keeps the rate that there was; 0 where none can be computed.
    """
    if before is None or time_s - before.time_s < _TURN_OVER_S:
        return 0.0 if before is None else before.turn_rate_rad_s
    if time_s - before.time_s > _LONGEST_TURN_OVER_S:
        return 0.0
    old = before.velocity_ned_m_s
    if min(math.hypot(old[0], old[1]), math.hypot(velocity[0], velocity[1])) < COURSE_M_S:
        return 0.0
    turned = wrap_angle(math.atan2(velocity[1], velocity[0]) - math.atan2(old[1], old[0]))
    return _believed(turned / (time_s - before.time_s))


def _believed(rate_rad_s: float) -> float:
    return rate_rad_s if abs(rate_rad_s) <= FASTEST_TURN_RAD_S else 0.0


@dataclass(frozen=True, slots=True)
class CarriedLead:
    """The pad filter's own word while the camera does not see it; std (m) of an axis, EKF's NED."""

    observed_s: float
    pad: Motion
    std_m: float


class PadLocator:
    """The newest lead to the pad; while the pad filter goes on without the camera, its word is better."""

    def __init__(self, config: SearchConfig) -> None:
        self._config = config
        self._beacon: Lead | None = None
        self._compared: Lead | None = None  # the beacon whose course the next one is compared with
        self._sight: Lead | None = None
        self._offset_m: tuple[float, float] | None = None
        self._carried: CarriedLead | None = None
        self.start = Lead(-math.inf, ZERO3)

    def hear(self, beacon: PadBeacon | None, origin: Vector3 | None) -> bool:
        """Take in the beacon; `origin` is the EKF's (deg, deg, m). Returns whether it was a surprise."""
        if beacon is None or origin is None:
            return False
        if self._beacon is not None and beacon.time_s == self._beacon.time_s:
            return False
        position = self._corrected(
            beacon.time_s,
            ned_from_geodetic(beacon.latitude_deg, beacon.longitude_deg, beacon.altitude_m, origin),
        )
        velocity = beacon.velocity_ned_m_s
        rate = turn_rate(self._compared, beacon.time_s, velocity)
        expected = self.likely(beacon.time_s).position_m
        self._beacon = word = Lead(beacon.time_s, position, velocity, rate)
        if self._compared is None or word.time_s - self._compared.time_s >= _TURN_OVER_S:
            self._compared = word
        # while the filter takes its fixes it judges them itself
        carried = self._carried_by(beacon.time_s) is not None
        return not carried and math.dist(expected[:2], position[:2]) > self._config.spacing_m

    def remember(self, pad: Motion, seen_s: float, now_s: float) -> None:
        """Keep the last sighting of the pad; `pad` is the filter's prediction for now.

        One that is kept already is not predicted back again: the filter has predicted it straight on since.
        """
        if self._sight is not None and seen_s <= self._sight.time_s:
            return
        p, v, a = pad.position_m, pad.velocity_m_s, pad.acceleration_m_s2
        age_s = now_s - seen_s
        flat = v[0] * v[0] + v[1] * v[1]
        rate = _believed((v[0] * a[1] - v[1] * a[0]) / flat) if flat > COURSE_M_S**2 else 0.0
        self._sight = Lead(seen_s, (p[0] - v[0] * age_s, p[1] - v[1] * age_s, 0.0), v, rate)

    def carry(self, carried: CarriedPad | None, vehicle_ned_m: Vector3) -> None:
        """Take in this cycle's estimate of an unseen pad, if something carries it."""
        if carried is None:
            self._carried = None
            return
        north, east, _ = add(vehicle_ned_m, carried.relative_position_ned_m)
        (vn, ve, _), (an, ae, _) = carried.velocity_ned_m_s, carried.acceleration_ned_m_s2
        share = min(1.0, _MOST_ACCELERATION_M_S2 / max(math.hypot(an, ae), 1e-6))
        pad = Motion((north, east, 0.0), (vn, ve, 0.0), (share * an, share * ae, 0.0))
        self._carried = CarriedLead(carried.observed_time_s, pad, carried.lateral_std_m)

    def reach_m(self, now_s: float) -> float:
        """How far from its likely place the pad may be; inf when nobody knows."""
        carried = self._carried_by(now_s)
        return math.inf if carried is None else SIGMA_THRESHOLD * carried.std_m

    def _carried_by(self, now_s: float) -> CarriedLead | None:
        carried = self._carried
        return carried if carried and now_s - carried.observed_s <= self._config.lead_s else None

    @property
    def beacon_compared(self) -> bool:
        return self._offset_m is not None

    def seen_lately(self, now_s: float) -> bool:
        return self._sight is not None and now_s - self._sight.time_s <= self._config.lead_s

    def _corrected(self, time_s: float, position: Vector3) -> Vector3:
        """The beacon's position less its offset: a GPS is off by metres, but its error changes slowly."""
        if self._sight is not None and abs(time_s - self._sight.time_s) <= _COMPARABLE_S:
            seen = self._sight.at(time_s, self._config.lead_s).position_m
            offset = (seen[0] - position[0], seen[1] - position[1])
            if math.hypot(*offset) <= _LARGEST_OFFSET_M:
                self._offset_m = offset
        if self._offset_m is None:
            return position
        return (position[0] + self._offset_m[0], position[1] + self._offset_m[1], position[2])

    def distrust(self) -> None:
        """Drop the last sighting: it proved wrong."""
        self._sight = None

    def likely(self, now_s: float) -> Motion:
        """Where the pad should be now; at rest where the search began when nothing is known."""
        if (carried := self._carried_by(now_s)) is not None:
            return carried.pad
        newest = self._newest(now_s)
        if newest is self.start:
            return Motion(newest.position_ned_m)
        return newest.at(now_s, self._config.lead_s)

    def source(self, now_s: float) -> str:
        if self._carried_by(now_s) is not None:
            return "by its beacon"
        newest = self._newest(now_s)
        if newest is self.start:
            return "no position known"
        return "by its beacon" if newest is self._beacon else "by the last sighting"

    def _newest(self, now_s: float) -> Lead:
        words = [w for w in (self._beacon, self._sight) if w and now_s - w.time_s <= self._config.trust_s]
        return max(words, key=lambda word: word.time_s, default=self.start)
