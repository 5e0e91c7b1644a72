"""The one way in for the autopilot's attitude: each report is paired with ours at its time, and shows a step.

A report is another filter's estimate, and how its errors go on is unknown. So it is not fused as it comes,
which would count many times what is alike in all reports. It shows

- a reset of ours, if both use the same IMU;
- at rest, from other sensors and once, a second compass and a second horizon (`at_rest`);
- of another IMU, how far it has turned: a second gyroscope (`gyro_bias_check`);
- and always how far the two are apart (`attitude_check`), which changes nothing.

With the autopilot's own sensors by telemetry, its filter has every sample, and ours only those that the
link delivers. After a gap in the stream ours has missed a rotation, so it is reset to the autopilot's. The
same happens if our attitude is poorly known, as after a start in motion, and if the horizons differ by more
than both errors for longer than a manoeuvre explains. Each filter finds north itself: the difference of the
headings (`attitude_check`) is kept; by itself it is no fault.

Rotations about NED axes, rad, s.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Final, NamedTuple

from companion.base.geometry import (
    FloatArray,
    Quaternion,
    Vector3,
    dot,
    down_in_body,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
)
from companion.base.messages import AutopilotAttitude
from companion.estimate.motion import WRONG_FOR_S, MotionHistory
from companion.estimate.vehicle.attitude_check import AttitudeCheck, heading_between
from companion.estimate.vehicle.ekf_inputs import AttitudeStep, SecondAttitudeStep, at_rest
from companion.estimate.vehicle.gyro_bias_check import BiasStep, SecondGyro

THEIR_STD_RAD: Final = math.radians(1.0)  # of their horizon, in flight
DEVIATIONS: Final = 4.0  # of what is compared in every report of a flight: one in 16000
SURELY_RAD: Final = DEVIATIONS * THEIR_STD_RAD
AFTER_GAP_RAD: Final = math.radians(1.5)  # after a gap, or of an uncertain attitude of ours; judged
# their reports and our samples: a turn makes that much; by the second gyroscope's 0.05 s a reset at 10 deg/s
# is late
MISTIMED_S: Final = 0.03
REPORTS_KEPT: Final = 50  # two seconds of them at 25 Hz: after that ours begins again


class OwnAttitude(NamedTuple):
    """Ours at a report's time, and what is known of it; `covariance_rad2` (3, 3) is about NED axes.

    `compared`: the autopilot's at rest has been taken already.
    """

    attitude: Quaternion
    covariance_rad2: FloatArray
    gyro_bias_rad_s: Vector3
    turning_rad_s: float
    resting: bool = False
    compared: bool = False


class AttitudeFinding(NamedTuple):
    """A step for the EKF, to be taken at `time_s`.

    Since `since_s` our attitudes are wrong by what the step turns them by; `words` tell of that.
    """

    step: AttitudeStep | BiasStep | SecondAttitudeStep
    time_s: float = math.inf
    since_s: float = math.inf
    words: str = ""


class AutopilotAttitudes:
    """Feed it every report (`due`), then of each that is due what is ours (`shown_by`)."""

    def __init__(self, motion: MotionHistory, since_s: float) -> None:
        """`since_s`: when the alignment was; what `motion` held before is of another."""
        self._motion, self._since_s = motion, since_s
        self._waiting: deque[AutopilotAttitude] = deque(maxlen=REPORTS_KEPT)
        self.check, self._reset = AttitudeCheck(motion), AttitudeReset(motion, since_s)
        self._second_gyro = SecondGyro(motion)

    def due(self, report: AutopilotAttitude) -> Iterator[tuple[AutopilotAttitude, Quaternion]]:
        """Take a report; those that our own samples have come up to, each with ours at its time."""
        self._waiting.append(report)
        newest_s = self._motion.newest_s
        while newest_s is not None and self._waiting and self._waiting[0].time_s <= newest_s:
            come = self._waiting.popleft()
            ours = self._motion.attitude(come.time_s)
            if ours is not None and come.time_s > self._since_s:
                yield come, ours

    def shown_by(self, report: AutopilotAttitude, own: OwnAttitude) -> AttitudeFinding | None:
        """What a report that is due shows of ours, if anything; of one within a gap ours is not known."""
        if self._motion.in_gap(report.time_s):
            return None
        found = self._reset.compare(report, own, self.check.heading_rad) if report.same_imu else None
        if found is not None:
            return found
        self.check.compare(report, own.attitude)
        if report.same_imu:
            return None
        if own.resting and not own.compared:
            return AttitudeFinding(at_rest(own.attitude, report.attitude))
        step = self._second_gyro.add_attitude(report, own.gyro_bias_rad_s)
        return None if step is None else AttitudeFinding(step)


class AttitudeReset:
    """Resets ours to the autopilot's, report by report, where both use the same IMU."""

    def __init__(self, motion: MotionHistory, since_s: float = -math.inf) -> None:
        self._motion = motion
        self._compared_s = since_s
        self._wrong_since_s: float | None = None

    def compare(
        self, report: AutopilotAttitude, own: OwnAttitude, ahead_rad: float | None
    ) -> AttitudeFinding | None:
        """The reset that a report makes necessary, if any; our heading is usually `ahead_rad` of theirs."""
        tilt_rad, now_rad = apart(own.attitude, report.attitude)
        ahead_rad = now_rad if ahead_rad is None else ahead_rad
        off_rad = math.remainder(now_rad - ahead_rad, math.tau)
        north, east, down = own.covariance_rad2.diagonal().tolist()
        std_rad = math.sqrt(north + east)
        limit_rad = DEVIATIONS * math.hypot(std_rad, THEIR_STD_RAD) + MISTIMED_S * own.turning_rad_s
        wrong_since_s, self._wrong_since_s = self._wrong_since_s, None
        compared_s, self._compared_s = self._compared_s, max(self._compared_s, report.time_s)
        missing_s = self._motion.missing_s(compared_s, report.time_s)
        since_s, apart_rad = report.time_s, tilt_rad
        if missing_s > 0.0:
            since_s, apart_rad = compared_s, math.hypot(tilt_rad, off_rad)
            why = f"{1e3 * missing_s:.0f} ms of IMU data missing"
            wrong = tilt_rad > AFTER_GAP_RAD or abs(off_rad) > SURELY_RAD
        elif std_rad > SURELY_RAD:
            wrong, why = tilt_rad > AFTER_GAP_RAD, "ours was uncertain"
        else:
            since_s = report.time_s if wrong_since_s is None else wrong_since_s
            differs = tilt_rad > limit_rad
            wrong, why = differs and report.time_s - since_s >= WRONG_FOR_S, "its horizon differs"
            if differs and not wrong:
                self._wrong_since_s = since_s
        if not wrong:
            return None
        theirs = quat_multiply(quat_from_euler(0.0, 0.0, ahead_rad), report.attitude)
        turn = quat_multiply(theirs, quat_conjugate(own.attitude))
        step = AttitudeStep(turn, THEIR_STD_RAD, max(math.sqrt(down), 2.0 * THEIR_STD_RAD))
        words = f"attitude corrected by {math.degrees(apart_rad):.0f} deg to the autopilot's: {why}"
        return AttitudeFinding(step, report.time_s, since_s, words)


def apart(ours: Quaternion, theirs: Quaternion) -> tuple[float, float]:
    """How far the horizons are apart (rad, 0 to pi), and by how much our heading is ahead of theirs (rad)."""
    cosine = dot(down_in_body(ours), down_in_body(theirs))
    return math.acos(max(-1.0, min(1.0, cosine))), heading_between(ours, theirs)
