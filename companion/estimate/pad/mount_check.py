"""Whether the camera sits as the vehicle's file says: the pad's apparent motion against the vehicle's own.

A camera that is turned about the vehicle's vertical axis by psi, against its file, shows a pad to the front
as one to the right, and its way likewise. Rz(psi) turns each sighting back. Over three sightings a < b < c,
what is left of the pad's positions

    p_b - (1 - s) p_a - s p_c,    s = (t_b - t_a) / (t_c - t_a),    p = R (Rz(psi) q_xy + q_z),

and of the vehicle's own motion between them, which the IMU has measured, is the pad's acceleration and noise
(q: the sighting from the camera's place, body axes; R: attitude). It is linear in x = (cos psi, sin psi), so
that x is a least-squares estimate: (1, 0) for a camera that sits right. Its length is nobody's assumption:
one that is far from 1 says that something else is wrong, and then there is no angle. A vehicle that
neither tilts nor moves against the pad shows nothing. NED, SI units.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from companion.base.geometry import Vector3, add, norm, quat_rotate, scale, subtract, wrap_angle
from companion.base.messages import Quantity, SourceComparison
from companion.estimate.gating import CHI_SQUARE_999
from companion.estimate.motion import MotionHistory

# long against a sighting's noise, short against a pad's manoeuvres; then what a glimpse of the pad allows
APART_S: Final = (0.2, 0.1)
NEAR: Final = 0.25  # a sighting this near to that distance, as a share of it, will do
PAD_ACCELERATION_M_S2: Final = 1.0  # of a pad between three sightings; judged, not measured
NOISE_M: Final = 0.01  # of a sighting's, at least
# the pad's way against the vehicle is measured too: less of it than this many standard deviations is noise
LEAST_SIGNAL: Final = 4.0
# three tell the same; and the pad's acceleration goes on from one to the next
SHARED: Final = 3.0
FORGETTING_S: Final = 120.0  # a mount keeps; a pad that manoeuvred is to fade
# an angle is of a vector of about the length 1, by so many comparisons
LENGTH: Final = (0.6, 1.5)
FEWEST: Final = 2.5  # three, the first of which may be fading


class _Seen(NamedTuple):
    time_s: float
    across_ned_m: Vector3  # R q_xy
    turned_ned_m: Vector3  # R J q_xy, J the turn by a right angle
    along_ned_m: Vector3  # R q_z
    variance_m2: float


class MountCheck:
    """Feed it every sighting; `comparisons` is what they show."""

    def __init__(
        self, motion: MotionHistory, camera_position_body_m: Vector3, camera_yaw_deg: float = 0.0
    ) -> None:
        self._motion = motion
        self._camera, self._camera_yaw_deg = camera_position_body_m, camera_yaw_deg
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget what was compared: another mission, before which the camera may have been mended."""
        self._seen: list[_Seen] = []
        self._compared_s = self._updated_s = -math.inf
        self._n11 = self._n12 = self._n22 = self._b1 = self._b2 = 0.0
        self._count = 0.0
        # the camera's yaw of the vehicle's file against the one that the pad's motion shows (deg); none: not
        # known
        self.comparisons: tuple[SourceComparison, ...] = ()

    def begin_motion(self) -> None:
        """Forget the last sightings, which were turned by attitudes that were wrong."""
        self._seen.clear()

    def take(self, time_s: float, pad_position_body_m: Vector3, variance_m2: float) -> None:
        """Take in a sighting at its corrected time; `variance_m2` is its position's, an axis."""
        attitude = self._motion.attitude(time_s)
        if attitude is None or (self._seen and time_s <= self._seen[-1].time_s):
            return
        x, y, z = subtract(pad_position_body_m, self._camera)
        self._seen.append(
            _Seen(
                time_s,
                quat_rotate(attitude, (x, y, 0.0)),
                quat_rotate(attitude, (-y, x, 0.0)),
                quat_rotate(attitude, (0.0, 0.0, z)),
                variance_m2 + NOISE_M**2,
            )
        )
        while self._seen[0].time_s < time_s - 2.0 * (1.0 + NEAR) * APART_S[0]:
            del self._seen[0]
        if time_s - self._compared_s < min(APART_S):
            return
        for apart_s in APART_S:
            first, middle = (self._before(time_s, k * apart_s, apart_s) for k in (2.0, 1.0))
            if first is None or middle is None or not first.time_s < middle.time_s < time_s:
                continue
            if time_s - self._compared_s >= apart_s:
                self._compared_s = time_s
                self._compare(first, middle, self._seen[-1])
                self.comparisons = self._found()
            return

    def _before(self, time_s: float, before_s: float, apart_s: float) -> _Seen | None:
        nearest = min(self._seen, key=lambda seen: abs(time_s - before_s - seen.time_s))
        return nearest if abs(time_s - before_s - nearest.time_s) <= NEAR * apart_s else None

    def _compare(self, a: _Seen, b: _Seen, c: _Seen) -> None:
        share = (b.time_s - a.time_s) / (c.time_s - a.time_s)
        moved_b, *_ = self._motion.moved(a.time_s, b.time_s)
        moved_c, *_ = self._motion.moved(a.time_s, c.time_s)
        across = second_difference(a.across_ned_m, b.across_ned_m, c.across_ned_m, share)
        turned = second_difference(a.turned_ned_m, b.turned_ned_m, c.turned_ned_m, share)
        along = second_difference(a.along_ned_m, b.along_ned_m, c.along_ned_m, share)
        wanted = scale(add(along, subtract(moved_b, scale(moved_c, share))), -1.0)
        noise = b.variance_m2 + (1.0 - share) ** 2 * a.variance_m2 + share**2 * c.variance_m2
        if norm(across) < LEAST_SIGNAL * math.sqrt(noise):
            return
        noise += (0.5 * PAD_ACCELERATION_M_S2 * (b.time_s - a.time_s) * (c.time_s - b.time_s)) ** 2
        # a turned pad's way keeps its length; of a sighting of something else it does not
        way_m, reach_m = math.hypot(*across[:2]), math.sqrt(CHI_SQUARE_999[2] * noise)
        if not LENGTH[0] * way_m - reach_m <= math.hypot(*wanted[:2]) <= LENGTH[1] * way_m + reach_m:
            return
        self._forget(c.time_s)
        weight = 1.0 / (SHARED * noise)
        # of the plane alone: what a climb shows does not depend on the yaw
        for p, q, w in zip(across[:2], turned[:2], wanted[:2], strict=True):
            self._n11 += weight * p * p
            self._n12 += weight * p * q
            self._n22 += weight * q * q
            self._b1 += weight * p * w
            self._b2 += weight * q * w
        self._count += 1.0

    def _found(self) -> tuple[SourceComparison, ...]:
        determinant = self._n11 * self._n22 - self._n12 * self._n12
        if self._count < FEWEST or determinant <= 0.0:
            return ()
        cosine = (self._n22 * self._b1 - self._n12 * self._b2) / determinant
        sine = (self._n11 * self._b2 - self._n12 * self._b1) / determinant
        length, error_rad = math.hypot(cosine, sine), math.atan2(sine, cosine)
        if not LENGTH[0] <= length <= LENGTH[1]:
            return ()
        # of the angle: across the vector, over its length
        u, v = -sine / length, cosine / length
        variance = (u * u * self._n22 - 2.0 * u * v * self._n12 + v * v * self._n11) / determinant
        shown_rad = wrap_angle(math.radians(self._camera_yaw_deg) + error_rad)
        found = SourceComparison(
            self._compared_s,
            Quantity.CAMERA_ROTATION,
            f"{self._camera_yaw_deg:.0f} deg",
            f"{math.degrees(shown_rad):.0f} deg",
            difference=math.degrees(abs(error_rad)),
            std=math.degrees(math.sqrt(variance) / length),
        )
        return (found,)

    def _forget(self, time_s: float) -> None:
        kept = math.exp(-max(0.0, time_s - self._updated_s) / FORGETTING_S)
        self._updated_s = time_s
        self._n11, self._n12, self._n22 = (kept * n for n in (self._n11, self._n12, self._n22))
        self._b1, self._b2, self._count = kept * self._b1, kept * self._b2, kept * self._count


def second_difference(a: Vector3, b: Vector3, c: Vector3, share: float) -> Vector3:
    """How far b is from the line from a to c, of which it is at this share."""
    return subtract(b, add(scale(a, 1.0 - share), scale(c, share)))
