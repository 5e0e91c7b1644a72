"""Compares our attitude with the autopilot's: horizon and heading of two boards on one airframe.

The down vector in our body axes differs from that in the autopilot's by the mounting of the two boards. In
body axes this is a constant for any heading and rotation, while wrong times and vibration average out. So
each report's difference enters a fading mean. Its standard deviation is the error that both filters may
have, which does not average out. A misaligned board shows at rest. A board that slips in flight shows
within the mean's time, since the autopilot has not turned with it.

Body FRD, rad.
"""

from __future__ import annotations

import math
from typing import Final

from companion.base.geometry import (
    FloatArray,
    Quaternion,
    cross,
    dot,
    down_in_body,
    euler_from_quat,
    quat_conjugate,
    quat_multiply,
)
from companion.base.messages import AutopilotAttitude, Quantity, SourceComparison
from companion.estimate.motion import MotionHistory
from companion.estimate.vehicle.ekf_inputs import OTHER_COMPASS_STD_RAD, OTHER_HORIZON_STD_RAD

# of the mean: a board that slips by 20 deg returns control after 0.4 s (decision 40)
TIME_CONSTANT_S: Final = 0.5
FULL_S: Final = 1.0  # of reports, before they say anything
FORGET_S: Final = 2.0  # without a report
# by the 10 ms of the camera's check a lag of 160 ms was found as 143
RATE_SPAN_S: Final = 0.02
LAG_STD_S: Final = 0.1  # of a report's stamp, before anything is known
LAG_NOISE_RAD: Final = math.radians(0.5)  # of one difference
LAG_FORGETTING_S: Final = 20.0  # a link's delay changes with what it carries; judged
SHARED: Final = 0.2  # of five reports in a row each tells a fifth; judged


class AttitudeCheck:
    """Feed it every report of the autopilot with ours at its time; `comparisons` is what they say."""

    def __init__(self, motion: MotionHistory) -> None:
        self._motion = motion
        self._since_s = self._last_s = -math.inf
        self._reports = 0
        self._askew = [0.0, 0.0]  # about forward and right: the horizons' difference
        self.heading_rad: float | None = None  # ours less theirs
        self._figures: tuple[Quaternion, Quaternion] | None = None
        # sums over reports: the rates' squares, and the rates times the differences
        self._turned = self._lagged = 0.0
        self._rate = [0.0, 0.0]  # the slow part of the rate of turn, about forward and right

    def comparisons(
        self, rotation_covariance: FloatArray | None, now_s: float
    ) -> tuple[SourceComparison, ...]:
        """Of horizons and headings (deg); none before a second of reports, or without any lately.

        `rotation_covariance` (3, 3): of our attitude, about NED axes (rad²).
        """
        if rotation_covariance is None or self._figures is None or self._last_s - self._since_s < FULL_S:
            return ()
        if now_s - self._last_s > FORGET_S:
            return ()
        north, east, down = rotation_covariance.diagonal().tolist()
        ours, theirs = (tuple(map(math.degrees, euler_from_quat(q))) for q in self._figures)
        ahead_s, ahead_std_s = self._ahead()
        return (
            SourceComparison(
                self._last_s,
                Quantity.IMU_DELAY,
                "0 ms",
                f"{-1e3 * ahead_s:.0f} ms old",
                difference=1e3 * abs(ahead_s),
                std=1e3 * ahead_std_s,
            ),
            SourceComparison(
                self._last_s,
                Quantity.ATTITUDE,
                f"roll {ours[0]:.1f}, pitch {ours[1]:.1f} deg",
                f"roll {theirs[0]:.1f}, pitch {theirs[1]:.1f} deg",
                difference=math.degrees(math.hypot(*self._askew)),
                std=math.degrees(math.hypot(math.sqrt(max(north, east)), OTHER_HORIZON_STD_RAD)),
            ),
            SourceComparison(
                self._last_s,
                Quantity.HEADING,
                f"{ours[2] % 360.0:.0f} deg",
                f"{theirs[2] % 360.0:.0f} deg",
                difference=math.degrees(abs(self.heading_rad or 0.0)),
                std=math.degrees(math.hypot(math.sqrt(down), OTHER_COMPASS_STD_RAD)),
            ),
        )

    def compare(self, report: AutopilotAttitude, ours: Quaternion) -> None:
        """Take a report with our attitude at its time."""
        time_s, theirs = report.time_s, report.attitude
        if time_s <= self._last_s:
            return
        if time_s - self._last_s > FORGET_S:
            self._since_s, self._reports = time_s, 0
        ours_down, theirs_down = down_in_body(ours), down_in_body(theirs)
        x, y, _ = cross(theirs_down, ours_down)
        sine = math.hypot(x, y)
        angle = math.atan2(sine, dot(theirs_down, ours_down)) / sine if sine > 1e-9 else 1.0
        heading_rad = heading_between(ours, theirs)
        # an average at first, so that it is right at once; then a low-pass
        self._reports += 1
        low_pass = -math.expm1(-(time_s - self._last_s) / TIME_CONSTANT_S)
        share = max(low_pass if self._reports > 1 else 1.0, 1.0 / self._reports)
        self._askew = [m + share * (angle * v - m) for m, v in zip(self._askew, (x, y), strict=True)]
        last_rad = heading_rad if self.heading_rad is None else self.heading_rad
        turn_rad = math.remainder(heading_rad - last_rad, math.tau)
        self._learn_lag(time_s, share, (angle * x - self._askew[0], angle * y - self._askew[1]))
        self.heading_rad = math.remainder(last_rad + share * turn_rad, math.tau)
        self._last_s, self._figures = time_s, (ours, theirs)

    def _learn_lag(self, time_s: float, share: float, apart_rad: tuple[float, float]) -> None:
        """A report of another moment differs by the lag times the rate at which the vehicle turns."""
        x, y, _ = self._motion.rate_body_rad_s(time_s, RATE_SPAN_S)
        # the slow part is left out of both alike
        u, v = self._rate = [m + share * (w - m) for m, w in zip(self._rate, (x, y), strict=True)]
        x, y = x - u, y - v
        kept = math.exp(-(time_s - self._last_s) / LAG_FORGETTING_S) if self._reports > 1 else 0.0
        # a report tells the same as those beside it
        self._turned = kept * self._turned + SHARED * (x * x + y * y)
        self._lagged = kept * self._lagged + SHARED * (x * apart_rad[0] + y * apart_rad[1])

    def _ahead(self) -> tuple[float, float]:
        """By how much ours is ahead of theirs (s), with its standard deviation."""
        information = self._turned / LAG_NOISE_RAD**2 + 1.0 / LAG_STD_S**2
        return self._lagged / LAG_NOISE_RAD**2 / information, math.sqrt(1.0 / information)


def heading_between(ours: Quaternion, theirs: Quaternion) -> float:
    """By how much our heading is ahead of theirs (rad)."""
    w, _, _, z = quat_multiply(ours, quat_conjugate(theirs))
    return math.remainder(2.0 * math.atan2(z, w), math.tau)
