"""Leading a person through the six faces, and the samples of it. Pure but for the samples' growing.

A face counts once the vehicle has lain on it for HOLD_S, whichever was asked for: the calibration does not
need an order. That what was asked and what is felt differ tells something else: how the chip is mounted.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from calibration.mount.imu.rest import StaticInterval, find_rests
from calibration.mount.imu.six_faces import ASKED, FACES, face_of
from calibration.mount.record.samples import ImuSamples
from companion.base.geometry import FloatArray
from companion.base.messages import ImuSample

HOLD_S: Final = 3.0
# between two rests the vehicle has been turned by this at least
TURNED_RAD: Final = 0.8


class ImuBuffer:
    """Inertial samples as they come, turned back into the sensor's own axes."""

    def __init__(self, body_from_sensor: FloatArray) -> None:
        self._turn = body_from_sensor
        self._rows: list[tuple[float, ...]] = []

    def add(self, sample: ImuSample) -> None:
        """Take one, in body axes."""
        self._rows.append(
            (
                sample.time_s,
                *sample.rate_body_rad_s,
                *sample.specific_force_body_m_s2,
                sample.temperature_c,
            )
        )

    def since(self, time_s: float) -> ImuSamples:
        """Those from a time on."""
        rows = np.array([row for row in self._rows if row[0] >= time_s]).reshape(-1, 8)
        return ImuSamples(rows[:, 0], rows[:, 1:4] @ self._turn, rows[:, 4:7] @ self._turn, rows[:, 7])


class FaceGuide:
    """Knows which face to ask for next."""

    def __init__(self, body_from_sensor: FloatArray) -> None:
        self._turn = body_from_sensor
        self._left = list(FACES)
        self.asked: list[str] = []
        self.rests: list[StaticInterval] = []

    @property
    def done(self) -> bool:
        """Whether there was a rest for every question."""
        return not self._left

    @property
    def advice(self) -> str:
        """What to do now."""
        if self.done:
            return "enough"
        return f"{len(self.rests) + 1} of {len(FACES)}: {ASKED[self._left[0]]}, and let go of it"

    @property
    def after_s(self) -> float:
        """From when on samples are of interest."""
        return self.rests[-1].to_s if self.rests else -np.inf

    def take(self, inertial: ImuSamples) -> str | None:
        """Look for the next rest in samples after the last one; returns what to tell when there is one."""
        for rest in find_rests(inertial):
            if self.done or rest.to_s - rest.from_s < HOLD_S - 1.0 or not self._another(rest):
                continue
            asked = self._left.pop(0)
            self.asked.append(asked)
            self.rests.append(rest)
            felt = face_of(rest.force, self._turn)
            if felt == asked:
                return f"{asked}: taken"
            return f"taken, but the sensor feels {felt or 'an edge'} where {asked} was asked"
        return None

    def _another(self, rest: StaticInterval) -> bool:
        if not self.rests:
            return True
        last = self.rests[-1].force
        cosine = float(rest.force @ last / np.linalg.norm(rest.force) / np.linalg.norm(last))
        return cosine < math.cos(TURNED_RAD)
