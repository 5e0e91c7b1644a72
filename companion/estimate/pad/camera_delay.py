"""How much later than its stamp, by the IMU's clock, a frame was exposed: estimated in flight.

A stamp that is off by d takes the attitude of another moment, so that a turning vehicle sees the pad jump by
d w x r (w the rate of turn, r the pad's relative position, NED), although nothing moves. Over three sightings
at times a < b < c, each some hundred milliseconds apart, that jump is what is left of

    r_b - (1 - s) r_a - s r_c,    s = (t_b - t_a) / (t_c - t_a),

when the vehicle's own motion between them, which the IMU has measured, is taken off: a pad that drives
straight on has no part in it, one that accelerates little. The remainder is -d W, W the same difference of
w x r; d is its least-squares estimate with a prior, forgetting slowly. A vehicle that does not turn shows
nothing, and then nothing changes. SI units.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from companion.base.geometry import (
    Vector3,
    add,
    cross,
    dot,
    norm,
    quat_rotate,
    scale,
    subtract,
)
from companion.estimate.motion import MotionHistory

APART_S: Final = 0.13  # long against the noise of a sighting, short against a pad's manoeuvres
NEAR_S: Final = 0.04  # a sighting this near to that distance will do
RATE_SPAN_S: Final = 0.01
LARGEST_S: Final = 0.03  # a pad that oscillates at the vehicle's own period looks like more
FORGETTING_S: Final = 60.0
SLEW: Final = 0.01  # s a second: what is corrected moves slowly, so that sightings stay in order
PAD_ACCELERATION_M_S2: Final = 1.0
SHARED: Final = 3.0  # each sighting is in three differences: they show a third of what they seem to
OUTLIER: Final = 4.0  # standard deviations, with the prior's share


class _Seen(NamedTuple):
    time_s: float
    position_ned_m: Vector3
    sweep_m_s: Vector3  # w x r
    variance_m2: float


class CameraDelay:
    """Feed it every sighting; `delay_s` is to be added to the stamps."""

    def __init__(self, motion: MotionHistory, prior_std_s: float) -> None:
        """`prior_std_s`: how far off the stamps may be before anything is known (s); 0: not at all."""
        self._motion = motion
        self._prior_std_s = prior_std_s
        self._seen: list[_Seen] = []
        self._information = self._prior = 1.0 / max(prior_std_s, 1e-6) ** 2
        self._weighted_s = 0.0
        self._updated_s = -math.inf
        self.delay_s = 0.0

    @property
    def std_s(self) -> float:
        """Standard deviation of the estimate (s)."""
        return 1.0 / math.sqrt(self._information)

    def take(self, time_s: float, pad_position_body_m: Vector3, variance_m2: float) -> None:
        """Take in a sighting at its corrected time; `variance_m2` is its position's, an axis."""
        attitude = self._motion.attitude(time_s)
        if self._prior_std_s <= 0.0 or attitude is None or (self._seen and time_s <= self._seen[-1].time_s):
            return
        position = quat_rotate(attitude, pad_position_body_m)
        rate = quat_rotate(attitude, self._motion.rate_body_rad_s(time_s, RATE_SPAN_S))
        self._seen.append(_Seen(time_s, position, cross(rate, position), variance_m2))
        while self._seen[0].time_s < time_s - 2.0 * (APART_S + NEAR_S):
            del self._seen[0]
        first, middle = self._before(time_s, 2.0 * APART_S), self._before(time_s, APART_S)
        if first is not None and middle is not None and first.time_s < middle.time_s < time_s:
            self._compare(first, middle, self._seen[-1])
        self._follow(time_s)

    def _before(self, time_s: float, apart_s: float) -> _Seen | None:
        nearest = min(self._seen, key=lambda seen: abs(time_s - apart_s - seen.time_s))
        return nearest if abs(time_s - apart_s - nearest.time_s) <= NEAR_S else None

    def _compare(self, a: _Seen, b: _Seen, c: _Seen) -> None:
        share = (b.time_s - a.time_s) / (c.time_s - a.time_s)
        moved_b, _ = self._motion.moved(a.time_s, b.time_s)
        moved_c, _ = self._motion.moved(a.time_s, c.time_s)
        left = add(
            second_difference(a.position_ned_m, b.position_ned_m, c.position_ned_m, share),
            subtract(moved_b, scale(moved_c, share)),
        )
        sweep = second_difference(a.sweep_m_s, b.sweep_m_s, c.sweep_m_s, share)
        variance = b.variance_m2 + (1.0 - share) ** 2 * a.variance_m2 + share**2 * c.variance_m2
        variance += (0.5 * PAD_ACCELERATION_M_S2 * (b.time_s - a.time_s) * (c.time_s - b.time_s)) ** 2
        size = norm(sweep)
        if norm(left) > OUTLIER * math.sqrt(3.0 * variance + (size * self._prior_std_s) ** 2):
            return
        weight = 1.0 / (SHARED * variance)
        # what is left is measured with the correction in force: the estimate is of the whole
        self._weighted_s += weight * (size * size * self.delay_s - dot(sweep, left))
        self._information += weight * size * size

    def _follow(self, time_s: float) -> None:
        elapsed_s = min(1.0, time_s - self._updated_s)
        self._updated_s = time_s
        kept = math.exp(-elapsed_s / FORGETTING_S)
        self._weighted_s *= kept
        self._information = self._prior + kept * (self._information - self._prior)
        wanted_s = max(-LARGEST_S, min(LARGEST_S, self._weighted_s / self._information))
        reach_s = SLEW * elapsed_s
        self.delay_s += max(-reach_s, min(reach_s, wanted_s - self.delay_s))


def second_difference(a: Vector3, b: Vector3, c: Vector3, share: float) -> Vector3:
    """How far b is from the line from a to c, of which it is at this share."""
    return subtract(b, add(scale(a, 1.0 - share), scale(c, share)))
