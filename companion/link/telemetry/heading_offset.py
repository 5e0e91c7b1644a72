"""Heading offset: our NED against the autopilot's.

Both estimate north for themselves and differ by a few degrees, and by more after the autopilot resets its
heading in flight. A velocity sent unrotated would drift off the pad to one side, so what is sent is turned by
the autopilot's heading minus ours, both at the same moment, filtered.

The difference is the twist about the down axis of q_autopilot * conj(q_ours) (swing-twist), which does not
mix in roll and pitch the way a difference of Euler yaw angles does when the vehicle is tilted.
"""

import math
from collections import deque
from dataclasses import replace
from itertools import pairwise
from typing import Final

from companion.base.geometry import (
    Quaternion,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_normalise,
    rotate_yaw,
    wrap_angle,
)
from companion.base.messages import Setpoint

TIME_CONSTANT_S: Final = 2.0
# it jumps after so many samples in a row, all off by over so much
JUMP_SAMPLES: Final = 5
JUMP_RAD: Final = math.radians(6.0)

_Stamped = tuple[float, Quaternion]


class HeadingOffset:
    """Estimates autopilot heading minus our heading, and turns setpoints by it."""

    def __init__(self) -> None:
        self._ours: deque[_Stamped] = deque(maxlen=64)
        self._waiting: deque[_Stamped] = deque(maxlen=16)
        self._newest_autopilot_s = -math.inf
        self.offset_rad = 0.0  # the autopilot's heading minus ours, in (-pi, pi]
        self._samples = 0
        self._sample_time_s = -math.inf
        self._strays: list[float] = []

    @property
    def ready(self) -> bool:
        """Whether there has been a pair of attitudes to compare; before it nothing is turned."""
        return self._samples > 0

    def update(
        self,
        autopilot_attitude: Quaternion,
        autopilot_time_s: float,
        our_attitude: Quaternion,
        our_time_s: float,
    ) -> None:
        """Take the newest attitude of both sides; the same one given twice counts once.

        Telemetry and estimate never carry the same time: ours is interpolated to the autopilot's, which waits
        until ours has caught up.
        """
        if not self._ours or our_time_s > self._ours[-1][0]:
            self._ours.append((our_time_s, our_attitude))
        if autopilot_time_s > self._newest_autopilot_s:
            self._newest_autopilot_s = autopilot_time_s
            self._waiting.append((autopilot_time_s, autopilot_attitude))
        while self._waiting and self._waiting[0][0] <= self._ours[-1][0]:
            time_s, attitude = self._waiting.popleft()
            ours = self._our_attitude_at(time_s)
            if ours is not None:
                self._take(time_s, _twist_about_down(quat_multiply(attitude, quat_conjugate(ours))))

    def rotate(self, setpoint: Setpoint) -> Setpoint:
        """The setpoint in the autopilot's heading: velocity, acceleration, heading, attitude are turned."""
        turn = self.offset_rad
        attitude = setpoint.attitude
        if attitude is not None:
            attitude = quat_multiply(quat_from_euler(0.0, 0.0, turn), attitude)
        return replace(
            setpoint,
            velocity_ned_m_s=rotate_yaw(setpoint.velocity_ned_m_s, turn),
            acceleration_ned_m_s2=rotate_yaw(setpoint.acceleration_ned_m_s2, turn),
            heading_rad=wrap_angle(setpoint.heading_rad + turn),
            attitude=attitude,
        )

    def _our_attitude_at(self, time_s: float) -> Quaternion | None:
        """Our attitude at a time within the history, None when it is older than that."""
        if self._ours[-1][0] == time_s:
            return self._ours[-1][1]
        # what is asked for is among the newest
        for (late_s, late), (early_s, early) in pairwise(reversed(self._ours)):
            if early_s <= time_s < late_s:
                return _interpolate(early, late, (time_s - early_s) / (late_s - early_s))
        return None

    def _take(self, time_s: float, difference_rad: float) -> None:
        error = wrap_angle(difference_rad - self.offset_rad)
        if self._samples and abs(error) > JUMP_RAD:
            self._take_stray(time_s, error)
            return
        self._strays.clear()
        self._samples += 1
        # an average at first, so that it is right at once; then a low-pass
        low_pass = -math.expm1(-max(time_s - self._sample_time_s, 0.0) / TIME_CONSTANT_S)
        gain = max(low_pass if self._samples > 1 else 1.0, 1.0 / self._samples)
        self.offset_rad = wrap_angle(self.offset_rad + min(gain, 1.0) * error)
        self._sample_time_s = time_s

    def _take_stray(self, time_s: float, error: float) -> None:
        """One that is far off is dropped; several in a row that agree are the autopilot's heading reset."""
        if self._strays and abs(wrap_angle(error - self._strays[-1])) > JUMP_RAD:
            self._strays.clear()
        self._strays.append(error)
        if len(self._strays) < JUMP_SAMPLES:
            return
        first = self._strays[0]
        mean = first + sum(wrap_angle(stray - first) for stray in self._strays) / len(self._strays)
        self.offset_rad = wrap_angle(self.offset_rad + mean)
        self._samples = len(self._strays)
        self._sample_time_s = time_s
        self._strays.clear()


def _twist_about_down(q: Quaternion) -> float:
    return wrap_angle(2.0 * math.atan2(q[3], q[0]))


def _interpolate(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    """Between two attitudes a few degrees apart: the chord, normalised."""
    sign = 1.0 if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] >= 0.0 else -1.0
    u, v = 1.0 - share, sign * share
    return quat_normalise(
        (u * a[0] + v * b[0], u * a[1] + v * b[1], u * a[2] + v * b[2], u * a[3] + v * b[3])
    )
