"""The autopilot's own pose in its local NED, in the last second, and its heading against ours. Pure."""

import math
from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Generic, TypeVar

from companion.base.geometry import (
    Quaternion,
    Vector3,
    add,
    quat_between,
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    rotate_yaw,
    rotation_vector_from_quat,
    scale,
    subtract,
    wrap_angle,
)
from companion.base.messages import Setpoint

KEPT_S: Final = 1.0
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class AutopilotPose:
    """Position (m) in its local NED and attitude, body to NED, at `time_s`."""

    time_s: float
    position_ned_m: Vector3
    attitude: Quaternion


class _Track(Generic[T]):
    """Samples in order of time, of the last `KEPT_S`."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, T]] = deque()

    @property
    def newest_s(self) -> float:
        return self._samples[-1][0] if self._samples else -math.inf

    def take(self, time_s: float, value: T) -> None:
        samples = self._samples
        if samples and time_s <= samples[-1][0]:
            return
        samples.append((time_s, value))
        while samples[0][0] < time_s - KEPT_S:
            samples.popleft()

    def about(self, time_s: float) -> tuple[T, T, float] | None:
        """The samples before and after, and the share of the way between them; None where one is missing."""
        after: tuple[float, T] | None = None
        for before in reversed(self._samples):
            if before[0] == time_s:
                return before[1], before[1], 0.0
            if before[0] < time_s:
                if after is None:
                    return None
                return before[1], after[1], (time_s - before[0]) / (after[0] - before[0])
            after = before
        return None


class PoseHistory:
    """Positions and attitudes as they come; `at` is between two of each, and never beyond the newest."""

    def __init__(self) -> None:
        self._positions: _Track[Vector3] = _Track()
        self._attitudes: _Track[Quaternion] = _Track()

    def take_position(self, time_s: float, position_ned_m: Vector3) -> None:
        self._positions.take(time_s, position_ned_m)

    def take_attitude(self, time_s: float, attitude: Quaternion) -> None:
        self._attitudes.take(time_s, attitude)

    def fresh(self, now_s: float) -> bool:
        """Whether both have come lately."""
        return min(self._positions.newest_s, self._attitudes.newest_s) >= now_s - KEPT_S

    def at(self, time_s: float) -> AutopilotPose | None:
        """The pose at a time; None before both have come up to it, and when it is longer ago than is kept."""
        places, turns = self._positions.about(time_s), self._attitudes.about(time_s)
        if places is None or turns is None:
            return None
        (p, q, share), (a, b, way) = places, turns
        rotation = rotation_vector_from_quat(quat_multiply(quat_conjugate(a), b))
        return AutopilotPose(
            time_s,
            add(p, scale(subtract(q, p), share)),
            quat_multiply(a, quat_from_rotation_vector(scale(rotation, way))),
        )


# ---------------------------------------------------------------- its heading against ours
# Both estimate north for themselves and differ by a few degrees, and by more after the autopilot resets its
# heading in flight. A velocity sent unrotated would drift off the pad to one side, so what is sent is turned
# by the autopilot's heading minus ours, both at the same moment, filtered.
#
# The difference is the twist about the down axis of q_autopilot * conj(q_ours) (swing-twist), which does not
# mix in roll and pitch the way a difference of Euler yaw angles does when the vehicle is tilted.

TIME_CONSTANT_S: Final = 2.0
# it jumps after so many samples in a row, all off by over so much
JUMP_SAMPLES: Final = 5
JUMP_RAD: Final = math.radians(6.0)

_Stamped = tuple[float, Quaternion]


class HeadingOffset:
    """Estimates autopilot heading minus our heading, and turns setpoints by it; by nothing before a pair."""

    def __init__(self) -> None:
        self._ours: deque[_Stamped] = deque(maxlen=64)
        self._waiting: deque[_Stamped] = deque(maxlen=16)
        self._newest_autopilot_s = -math.inf
        self.offset_rad = 0.0  # the autopilot's heading minus ours, in (-pi, pi]
        self._samples = 0
        self._sample_time_s = -math.inf
        self._strays: list[float] = []

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
                return quat_between(early, late, (time_s - early_s) / (late_s - early_s))
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
