"""The motion that a recording still lacks, as a hint to the person who holds the vehicle over the pad.

Pure: samples in, hints out. Only motion with the pad in view counts: the total rotation about each body axis
(extrinsic rotation is observable with rotation about two axes at least), and the time of fast rotation (a
time offset of one millisecond is a rotation of 0.06° at 60°/s).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from companion.base.geometry import norm
from companion.base.messages import ImuSample, PadSighting

IN_VIEW_S: Final = 0.25
SHORTEST_S: Final = 30.0
FEWEST_SIGHTINGS: Final = 300
ENOUGH_TURN_RAD: Final = math.radians(360.0)
QUICK_RAD_S: Final = math.radians(25.0)
ENOUGH_QUICK_S: Final = 8.0
UNSEEN_S: Final = 1.5
AXES: Final = (
    "roll it left and right",
    "dip its nose up and down",
    "turn it left and right about the vertical",
)


@dataclass(frozen=True, slots=True)
class MotionProgress:
    """Progress of a recording: shares 0..1 of what is needed, what to do now, and whether it is complete."""

    seconds: float
    sightings: int
    turned: tuple[float, float, float]
    quick: float
    advice: str
    complete: bool

    def line(self) -> str:
        """One line for a terminal."""
        roll, pitch, yaw = (f"{100.0 * share:.0f}%" for share in self.turned)
        return (
            f"{self.seconds:3.0f} s, pad seen {self.sightings} times; roll {roll}, pitch {pitch}, yaw {yaw}, "
            f"quick {100.0 * self.quick:.0f}%: {self.advice}"
        )


class MotionCoverage:
    """Adds up what has been recorded."""

    def __init__(self) -> None:
        self._start_s: float | None = None
        self._now_s = self._seen_s = -math.inf
        self._sightings = 0
        self._turned = [0.0, 0.0, 0.0]
        self._quick_s = 0.0

    def add_imu(self, sample: ImuSample) -> None:
        """Take an inertial sample, in order of time."""
        dt_s = sample.time_s - self._now_s
        self._now_s = sample.time_s
        if self._start_s is None:
            self._start_s = sample.time_s
        if not 0.0 < dt_s < IN_VIEW_S or sample.time_s - self._seen_s > IN_VIEW_S:
            return
        for axis, rate in enumerate(sample.rate_body_rad_s):
            self._turned[axis] += abs(rate) * dt_s
        if norm(sample.rate_body_rad_s) > QUICK_RAD_S:
            self._quick_s += dt_s

    def add_sighting(self, sighting: PadSighting) -> None:
        """Take a sighting."""
        self._sightings += 1
        self._seen_s = max(self._seen_s, sighting.time_s)

    def progress(self) -> MotionProgress:
        """The progress now."""
        seconds = 0.0 if self._start_s is None else self._now_s - self._start_s
        roll, pitch, yaw = (min(1.0, turned / ENOUGH_TURN_RAD) for turned in self._turned)
        quick = min(1.0, self._quick_s / ENOUGH_QUICK_S)
        moved = min(roll, pitch, yaw, quick) >= 1.0
        complete = moved and seconds >= SHORTEST_S and self._sightings >= FEWEST_SIGHTINGS
        advice = self._advice((roll, pitch, yaw), quick, complete=complete)
        return MotionProgress(seconds, self._sightings, (roll, pitch, yaw), quick, advice, complete)

    def _advice(self, turned: tuple[float, float, float], quick: float, *, complete: bool) -> str:
        if complete:
            return "enough"
        if self._start_s is None:
            return "waiting for the inertial sensor"
        if self._now_s - self._seen_s > UNSEEN_S:
            return "the pad is not seen: hold the camera over it"
        least = min(turned)
        if least < 1.0:
            return AXES[turned.index(least)]
        if quick < 1.0:
            return "the same again, more quickly"
        return "go on moving a little: roll, dip, turn, and sideways"
