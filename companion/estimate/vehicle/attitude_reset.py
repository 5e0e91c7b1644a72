"""Resets our attitude to the autopilot's if both use the same IMU.

With the autopilot's own sensors by telemetry, its filter has every sample, and ours only those that the
link delivers. After a gap in the stream ours has missed a rotation, so it is reset to the autopilot's. The
same happens if our attitude is poorly known, as after a start in motion, and if the horizons differ by more
than both errors for longer than a manoeuvre explains. Each filter finds north itself: the difference of the
headings is learnt in normal operation and kept; by itself it is no fault.

Rotations about NED axes, rad, s.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Final, NamedTuple

from companion.base.geometry import (
    Quaternion,
    dot,
    down_in_body,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
)
from companion.base.messages import AutopilotAttitude

GAP_S: Final = 0.05  # between two samples: more is a gap
THEIR_STD_RAD: Final = math.radians(1.0)  # of their horizon, in flight
DEVIATIONS: Final = 4.0
LEAST_APART_RAD: Final = math.radians(5.0)  # in a steady stream
AFTER_GAP_RAD: Final = math.radians(1.5)
POORLY_KNOWN_RAD: Final = math.radians(4.0)  # our horizon's deviation, as after a start in motion
HEADING_AFTER_GAP_RAD: Final = math.radians(4.0)
MISTIMED_S: Final = 0.03  # their reports and our samples: a turn makes that much of difference
PERSISTS_S: Final = 0.2
LEARNING_S: Final = 5.0
REPORTS_KEPT: Final = 50


class Correction(NamedTuple):
    """The attitude to take at a time, since when ours was wrong, and why."""

    time_s: float
    since_s: float
    attitude: Quaternion
    apart_rad: float
    why: str


class ReportQueue(deque[AutopilotAttitude]):
    """The autopilot's reports, each of which waits until our own samples have come as far."""

    def __init__(self) -> None:
        super().__init__(maxlen=REPORTS_KEPT)

    def due(self, newest_s: float | None) -> Iterator[AutopilotAttitude]:
        """Take out those that our samples have come up to."""
        while newest_s is not None and self and self[0].time_s <= newest_s:
            yield self.popleft()


class AttitudeReset:
    """Compares report by report; `reports` are those to come."""

    def __init__(self) -> None:
        self.reports = ReportQueue()
        self._heading_rad: float | None = None  # ours less theirs
        self._learnt_s = 0.0
        self._wrong_since_s: float | None = None
        self._gap: tuple[float, float] | None = None  # its end, and how long it was

    def note_gap(self, time_s: float, lasted_s: float) -> None:
        """Our stream goes on at time_s, after nothing had come for so long."""
        self._gap = (time_s, lasted_s)

    def compare(
        self, report: AutopilotAttitude, ours: Quaternion, tilt_std_rad: float, turning_rad_s: float
    ) -> Correction | None:
        """Ours corrected by a report, if that has to be.

        Args:
            report: theirs.
            ours: at its time.
            tilt_std_rad: the standard deviation of our horizon.
            turning_rad_s: how fast we turned.
        """
        tilt_rad, heading_rad = apart(ours, report.attitude)
        if self._heading_rad is None:
            self._heading_rad, self._learnt_s = heading_rad, report.time_s
        off_rad = math.remainder(heading_rad - self._heading_rad, math.tau)
        limit_rad = DEVIATIONS * math.hypot(tilt_std_rad, THEIR_STD_RAD) + MISTIMED_S * turning_rad_s
        if self._gap is not None:
            return self._after_gap(report, tilt_rad, off_rad)
        if tilt_std_rad > POORLY_KNOWN_RAD and tilt_rad > AFTER_GAP_RAD:
            return self._correction(report, report.time_s, tilt_rad, "ours was uncertain")
        if tilt_rad <= max(limit_rad, LEAST_APART_RAD):
            self._wrong_since_s = None
            self._learn(report.time_s, off_rad)
            return None
        self._wrong_since_s = report.time_s if self._wrong_since_s is None else self._wrong_since_s
        if report.time_s - self._wrong_since_s < PERSISTS_S:
            return None
        return self._correction(report, self._wrong_since_s, tilt_rad, "its horizon differs")

    def _after_gap(self, report: AutopilotAttitude, tilt_rad: float, off_rad: float) -> Correction | None:
        assert self._gap is not None
        end_s, lasted_s = self._gap
        if report.time_s < end_s:
            return None
        self._gap = None
        if tilt_rad <= AFTER_GAP_RAD and abs(off_rad) <= HEADING_AFTER_GAP_RAD:
            return None
        why = f"{1e3 * lasted_s:.0f} ms of IMU data missing"
        return self._correction(report, end_s, math.hypot(tilt_rad, off_rad), why)

    def _correction(
        self, report: AutopilotAttitude, since_s: float, apart_rad: float, why: str
    ) -> Correction:
        self._wrong_since_s = None
        turned = quat_from_euler(0.0, 0.0, self._heading_rad or 0.0)
        return Correction(report.time_s, since_s, quat_multiply(turned, report.attitude), apart_rad, why)

    def _learn(self, time_s: float, off_rad: float) -> None:
        assert self._heading_rad is not None
        share = min(max(time_s - self._learnt_s, 0.0) / LEARNING_S, 1.0)
        self._heading_rad, self._learnt_s = self._heading_rad + share * off_rad, time_s


def apart(ours: Quaternion, theirs: Quaternion) -> tuple[float, float]:
    """How far the horizons are apart (rad, 0 to pi), and by how much our heading is ahead of theirs (rad)."""
    cosine = dot(down_in_body(ours), down_in_body(theirs))
    return math.acos(max(-1.0, min(1.0, cosine))), heading_between(ours, theirs)


def heading_between(ours: Quaternion, theirs: Quaternion) -> float:
    """By how much our heading is ahead of theirs (rad)."""
    w, _, _, z = quat_multiply(ours, quat_conjugate(theirs))
    return math.remainder(2.0 * math.atan2(z, w), math.tau)
