"""The autopilot's own pose in the last second: where in its local NED, and how turned. Pure, our clock."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from companion.base.geometry import (
    Quaternion,
    Vector3,
    add,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    rotation_vector_from_quat,
    scale,
    subtract,
)

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
