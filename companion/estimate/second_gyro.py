"""The autopilot as a second gyroscope: has the bias of ours stepped?

A step of 2 deg/s (a shock, a supply that sags) turns the attitude away faster than GPS and magnetometer
mend it: their own errors want slow corrections. The autopilot has an IMU of its own, and what it says of
its attitude holds how far the vehicle has turned in a window of time. Compared with our gyroscope that
gives our bias to 0.3 deg/s within a second. Only turns are compared: the autopilot's heading and horizon
are its own. With `sense.source: autopilot` both are the same sensor, and nothing is found.

Body FRD, rad/s, plain floats.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import Final, NamedTuple

from companion.geometry import (
    IDENTITY,
    Quaternion,
    Vector3,
    add,
    norm,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_integrate,
    quat_multiply,
    rotation_vector_from_quat,
    scale,
    subtract,
)

WINDOW_S: Final = 0.75
STRIDE_S: Final = 0.25  # from one window's start to the next's
LONGEST_GAP_S: Final = 0.6  # in the autopilot's words
REMEMBER_S: Final = 2.0
STEP_RAD_S: Final = math.radians(0.7)  # from the bias believed, to be a step
AGREE_RAD_S: Final = math.radians(0.5)  # of two windows, one after the other
LARGEST_RAD_S: Final = math.radians(10.0)  # more is no bias but a heading set anew, or a wrong time


class BiasStep(NamedTuple):
    """The bias that two windows agree on, and what it has turned the attitude by (body, rad)."""

    gyro_bias_rad_s: Vector3
    turned_rad: Vector3


class SecondGyro:
    """Compares the turns of both in overlapping windows."""

    def __init__(self) -> None:
        self._turn: Quaternion = IDENTITY
        self._times_s: list[float] = []
        self._turns: list[Quaternion] = []
        self._anchors: list[tuple[float, Quaternion]] = []
        self._last: Vector3 | None = None
        self._waiting: tuple[float, Quaternion] | None = None

    def add_rate(self, time_s: float, rate_body_rad_s: Vector3, dt_s: float) -> None:
        """Take our gyroscope's mean rate, bias and all, over the dt_s up to time_s."""
        self._turn = quat_integrate(self._turn, rate_body_rad_s, dt_s)
        self._times_s.append(time_s)
        self._turns.append(self._turn)
        if time_s - self._times_s[0] > 2.0 * REMEMBER_S:
            old = bisect_left(self._times_s, time_s - REMEMBER_S)
            del self._times_s[:old], self._turns[:old]

    def add_attitude(self, time_s: float, attitude: Quaternion, gyro_bias_rad_s: Vector3) -> BiasStep | None:
        """Take the autopilot's attitude; the step, when two windows agree that the bias is another.

        One waits for the next: it may be newer than our newest sample, which comes in batches.
        """
        waiting, self._waiting = self._waiting, (time_s, attitude)
        return None if waiting is None else self._compare(*waiting, gyro_bias_rad_s)

    def _compare(self, time_s: float, attitude: Quaternion, gyro_bias_rad_s: Vector3) -> BiasStep | None:
        anchors = self._anchors
        if anchors and not 0.0 <= time_s - anchors[-1][0] < LONGEST_GAP_S:
            anchors.clear()
            self._last = None
        if anchors and time_s - anchors[-1][0] < STRIDE_S:
            return None
        anchors.append((time_s, attitude))
        start_s, start = anchors[0]
        if time_s - start_s < WINDOW_S:
            return None
        del anchors[0]
        bias = self._bias(start_s, start, time_s, attitude)
        last, self._last = self._last, bias
        if bias is None or last is None:
            return None
        return self._judge(last, bias, time_s - start_s, gyro_bias_rad_s)

    def _bias(self, start_s: float, start: Quaternion, end_s: float, end: Quaternion) -> Vector3 | None:
        """By how much faster our gyroscope turned than the autopilot; None when too old or too new."""
        before, after = self._turned(start_s), self._turned(end_s)
        if before is None or after is None:
            return None
        ours = quat_multiply(quat_conjugate(before), after)
        theirs = quat_multiply(quat_conjugate(start), end)
        excess = rotation_vector_from_quat(quat_multiply(quat_conjugate(theirs), ours))
        return scale(excess, 1.0 / (end_s - start_s))

    def _judge(self, last: Vector3, bias: Vector3, span_s: float, believed: Vector3) -> BiasStep | None:
        if norm(subtract(bias, last)) > AGREE_RAD_S or norm(bias) > LARGEST_RAD_S:
            return None
        change, earlier = subtract(bias, believed), subtract(last, believed)
        if min(norm(change), norm(earlier)) < STEP_RAD_S:
            return None
        self._anchors.clear()
        self._last = None
        # over the newest window, and before it over what the window before has more
        return BiasStep(bias, add(scale(change, span_s), scale(earlier, STRIDE_S)))

    def _turned(self, time_s: float) -> Quaternion | None:
        """Our turn since the start at a time within the history."""
        place = bisect_left(self._times_s, time_s)
        if place == 0 or place == len(self._times_s):
            return None
        before_s, after_s = self._times_s[place - 1], self._times_s[place]
        turn = quat_multiply(quat_conjugate(self._turns[place - 1]), self._turns[place])
        share = (time_s - before_s) / (after_s - before_s)
        part = quat_from_rotation_vector(scale(rotation_vector_from_quat(turn), share))
        return quat_multiply(self._turns[place - 1], part)
