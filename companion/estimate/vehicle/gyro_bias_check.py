"""Detects a step of our gyroscope's bias by the autopilot's attitude, which serves as a second gyroscope.

A step of 2 deg/s (a shock, a supply that sags) turns the attitude faster than GPS and magnetometer correct
it, because they expect slow corrections. The autopilot has its own IMU, and its attitude shows how far the
vehicle has turned in a window of time. Compared with our gyroscope this gives our bias to 0.3 deg/s within
a second. Only rotations are compared: the autopilot's heading and horizon may differ. With `sense.source:
autopilot` both use the same sensor, and nothing is detected.

Other errors resemble a bias: a wrong time while the rate changes, and a misalignment of the two IMUs in a
turn. What these can explain does not count. A reset of the heading turns at once by what a bias turns
gradually. A repeated attitude is ignored, since the noise of a working sensor never repeats.

Body FRD, rad/s, plain floats.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple

from companion.base.geometry import (
    Quaternion,
    Vector3,
    add,
    dot,
    norm,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    rotation_vector_from_quat,
    scale,
    subtract,
)
from companion.base.messages import AutopilotAttitude
from companion.estimate.ahrs.alignment import LARGEST_BIAS_RAD_S
from companion.estimate.motion import MotionHistory, turn_between

WINDOW_S: Final = 0.75  # a step of 2 deg/s is found within a second (decision 40)
STRIDE_S: Final = WINDOW_S / 3.0  # from one window's start to the next's
# what two windows differ by at most to agree, and from the present bias at least; each finds it to 0.3 deg/s
STEP_RAD_S: Final = math.radians(0.7)
# of the autopilot's reports, beside our samples: a turn makes that much of difference
WRONG_TIME_S: Final = 0.05
SKEW: Final = 0.02  # of a turn: how far the two IMUs may lie askew (rad), and differ in scale
LEAST_SHARE: Final = 0.25  # of a window's change, in each of its strides


class BiasStep(NamedTuple):
    """The bias that two windows agree on, and for how long it has turned the attitude."""

    gyro_bias_rad_s: Vector3
    for_s: float


class _Anchor(NamedTuple):
    """The autopilot's attitude at a time, and the bias that our samples were less."""

    time_s: float
    attitude: Quaternion
    gyro_bias_rad_s: Vector3


class SecondGyro:
    """Compares the turns of both in overlapping windows; ours is what `motion` has without corrections."""

    def __init__(self, motion: MotionHistory) -> None:
        self._motion = motion
        self._anchors: list[_Anchor] = []
        self._heard: Quaternion | None = None
        self._last: Vector3 | None = None

    def add_attitude(self, report: AutopilotAttitude, gyro_bias_rad_s: Vector3) -> BiasStep | None:
        """Take the autopilot's attitude, which our samples have come up to, and the bias that ours are less.

        The step, when two windows agree that the bias is another.
        """
        if report.attitude == self._heard:
            return None
        self._heard = report.attitude
        return self._compare(_Anchor(report.time_s, report.attitude, gyro_bias_rad_s))

    def _compare(self, anchor: _Anchor) -> BiasStep | None:
        (time_s, _, gyro_bias_rad_s), anchors = anchor, self._anchors
        if anchors and abs(time_s - anchors[-1].time_s) >= WINDOW_S:
            anchors.clear()
            self._last = None
        if anchors and time_s - anchors[-1].time_s < STRIDE_S:
            return None
        anchors.append(anchor)
        if time_s - anchors[0].time_s < WINDOW_S:
            return None
        window = anchors.copy()
        del anchors[0]
        bias = self._bias(window[0], window[-1])
        last, self._last = self._last, bias
        if last is None or not self._is_step(window, last, bias, gyro_bias_rad_s):
            return None
        anchors.clear()
        self._last = None
        return BiasStep(bias, time_s - window[0].time_s + STRIDE_S)

    def _is_step(self, window: list[_Anchor], last: Vector3, bias: Vector3, assumed: Vector3) -> bool:
        if norm(subtract(bias, last)) > STEP_RAD_S or norm(bias) > LARGEST_BIAS_RAD_S:
            return False
        change, earlier = subtract(bias, assumed), subtract(last, assumed)
        if min(norm(change), norm(earlier)) < STEP_RAD_S:
            return False
        return self._unexplained_rad_s(window, change) > STEP_RAD_S and self._goes_on(window, change, assumed)

    def _unexplained_rad_s(self, window: list[_Anchor], change: Vector3) -> float:
        """How much of a change a wrong time and IMUs that lie askew do not make of the motion."""
        start_s, end_s = window[0].time_s, window[-1].time_s
        ours = self._turned_between(start_s, end_s)
        earlier = self._turned_between(start_s - WRONG_TIME_S, end_s - WRONG_TIME_S)
        delay = scale(turn_between(earlier, ours), 1.0 / (end_s - start_s))
        share = dot(change, delay) / max(dot(delay, delay), 1e-12)
        left = subtract(change, scale(delay, min(max(share, -1.0), 1.0)))
        return norm(left) - SKEW * norm(rotation_vector_from_quat(ours)) / (end_s - start_s)

    def _goes_on(self, window: list[_Anchor], change: Vector3, assumed: Vector3) -> bool:
        """Whether each stride has its share of the change."""
        for start, end in pairwise(window):
            bias = self._bias(start, end)
            if dot(subtract(bias, assumed), change) < LEAST_SHARE * dot(change, change):
                return False
        return True

    def _bias(self, start: _Anchor, end: _Anchor) -> Vector3:
        """Our gyroscope's, by how much faster we turned than the autopilot."""
        ours = self._turned_between(start.time_s, end.time_s)
        theirs = quat_multiply(quat_conjugate(start.attitude), end.attitude)
        excess = turn_between(theirs, ours)
        # it is in the axes of the end, a constant bias in those of the middle
        middle = quat_from_rotation_vector(scale(rotation_vector_from_quat(ours), 0.5))
        more = scale(quat_rotate(middle, excess), 1.0 / (end.time_s - start.time_s))
        return add(more, scale(add(start.gyro_bias_rad_s, end.gyro_bias_rad_s), 0.5))

    def _turned_between(self, start_s: float, end_s: float) -> Quaternion:
        """Our turn by the gyroscope alone: corrections turn about NED axes, so they go off from the left."""
        before, after = self._motion.attitude(start_s), self._motion.attitude(end_s)
        assert before is not None
        assert after is not None
        corrected = quat_from_rotation_vector(self._motion.corrected(start_s, end_s))
        return quat_multiply(quat_conjugate(quat_multiply(corrected, before)), after)
