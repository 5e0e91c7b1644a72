"""Guides a person through the six faces, and buffers the samples. Pure except for the growing buffer.

A face counts once the vehicle has lain on it for HOLD_S, whichever face was asked for: the calibration needs
no order. If the face asked for and the face measured differ, the configured mounting of the chip is wrong.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from calibration.mount.imu import FACES
from calibration.mount.imu.six_faces import ASKED, face_of
from calibration.mount.imu.static_intervals import StaticInterval, find_static_intervals
from calibration.mount.record.samples import ImuSamples
from companion.base.geometry import FloatArray
from companion.base.messages import ImuSample

HOLD_S: Final = 3.0
# minimum rotation between two static intervals
TURNED_RAD: Final = 0.8


class ImuBuffer:
    """IMU samples as they come, rotated back into sensor axes."""

    def __init__(self, body_from_sensor: FloatArray) -> None:
        self._turn = body_from_sensor
        self._rows: list[tuple[float, ...]] = []

    def add(self, sample: ImuSample) -> None:
        """Add one sample, in body axes."""
        self._rows.append(
            (
                sample.time_s,
                *sample.rate_body_rad_s,
                *sample.specific_force_body_m_s2,
                sample.temperature_c,
            )
        )

    def since(self, time_s: float) -> ImuSamples:
        """The samples from a time on."""
        rows = np.array([row for row in self._rows if row[0] >= time_s]).reshape(-1, 8)
        return ImuSamples(rows[:, 0], rows[:, 1:4] @ self._turn, rows[:, 4:7] @ self._turn, rows[:, 7])


class FaceGuide:
    """Chooses the face to ask for next."""

    def __init__(self, body_from_sensor: FloatArray) -> None:
        self._turn = body_from_sensor
        self._left = list(FACES)
        self.asked: list[str] = []
        self.rests: list[StaticInterval] = []

    @property
    def done(self) -> bool:
        """Whether every face asked for has its static interval."""
        return not self._left

    @property
    def advice(self) -> str:
        """What to do now."""
        if self.done:
            return "enough"
        return f"{len(self.rests) + 1} of {len(FACES)}: {ASKED[self._left[0]]}, and let go of it"

    @property
    def after_s(self) -> float:
        """The end of the last static interval; earlier samples are not needed."""
        return self.rests[-1].to_s if self.rests else -np.inf

    def take(self, inertial: ImuSamples) -> str | None:
        """Look for the next static interval in samples; returns the message to show if there is one."""
        for rest in find_static_intervals(inertial):
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
