"""What a magnetometer measured while it was turned about, wherever it comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from calibration.magnetometer.read.onboard import Onboard
from companion.base.geometry import FloatArray, Vector3, matrix_from_quat, quat_from_euler
from companion.base.messages import ImuSample, MagSample
from companion.config import ConfigError
from companion.config.magnetometer import AXES_OF, Axes, RawUnit, Sensor
from companion.flightlog.replay.flight_record import RecordingPlace

MOST_FIELD: Final = 1e9  # in whatever unit: beyond it stands what no sensor measured
# what drivers give in the place of a reading: least and most of 16 and 32 bits, the HMC5883L's overflow
NO_READING: Final = (-(2.0**31), 2.0**31 - 1.0, -(2.0**15), 2.0**15 - 1.0, -4096.0)
LEAST_SAMPLES: Final = 50  # fewer are no recording of a turn at all
_PAIRED_S: Final = 0.1  # an accelerometer's sample this near in time is the magnetometer's


@dataclass(slots=True)
class MagnetometerRecording:
    """Samples in the order in which they were taken.

    Attributes:
        source: file, device or connection.
        raw: (n, 3) in `unit`, in `axes`.
        force: (n, 3) specific force in the same axes (+g upwards at rest), in any unit; None: not measured.
        place: where and when, if the recording says so.
        body_from_sensor: (3, 3) how the sensor is mounted, from `axes` to FRD; None: not known.
        onboard: what the autopilot does to its compass before anybody hears it; None: it is no autopilot's,
            or not known.
        notes: what a reader of the result should know.
    """

    source: str
    sensor: Sensor
    raw: FloatArray
    unit: RawUnit = "uT"
    force: FloatArray | None = None
    place: RecordingPlace | None = None
    body_from_sensor: FloatArray | None = None
    onboard: Onboard | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def axes(self) -> Axes:
        """Which axes `raw` is in."""
        return AXES_OF[self.sensor]

    def checked(self) -> MagnetometerRecording:
        """Itself, without the samples that are no readings, which is noted.

        Raises:
            ConfigError: too few are left.
        """
        # a comparison with no number is false
        finite = (np.abs(self.raw) < MOST_FIELD).all(axis=1)
        read = finite & ~np.isin(self.raw, NO_READING).any(axis=1)
        if self.force is not None and not np.isfinite(self.force).all(axis=1).any():
            self.force = None
        passed_over = _passed_over(self.raw[~read])
        self.raw = self.raw[read]
        self.force = None if self.force is None else self.force[read]
        if len(self.raw) < LEAST_SAMPLES:
            more = f", {passed_over}" if passed_over else ""
            raise ConfigError(
                f"{self.source}: {len(self.raw)} magnetometer samples{more}; expected {LEAST_SAMPLES} or more"
            )
        if passed_over:
            self.notes.append(passed_over)
        return self


def _passed_over(raw: FloatArray) -> str:
    """How many samples (n, 3) are no readings, and what stands in them; nothing for none."""
    if len(raw) == 0:
        return ""
    odd = raw[~(np.abs(raw) < MOST_FIELD) | np.isin(raw, NO_READING)]
    example = "no number" if np.isnan(odd[0]) else f"{odd[0]:.10g}"
    return f"{len(raw)} samples passed over, in which a reading is {example}"


def paired(mags: list[MagSample], imus: list[ImuSample]) -> tuple[FloatArray, FloatArray | None]:
    """Fields (n, 3) and, beside each, the specific force (n, 3) nearest in time; NaN: none is near."""
    raw = np.array([mag.field_body_ut for mag in mags], dtype=float).reshape(-1, 3)
    if not imus or not mags:
        return raw, None
    times = np.array([imu.time_s for imu in imus])
    order = np.argsort(times, kind="stable")
    times, forces = times[order], np.array([imu.specific_force_body_m_s2 for imu in imus])[order]
    wanted = np.array([mag.time_s for mag in mags])
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    nearest = np.where(
        np.abs(times[after - 1] - wanted) <= np.abs(times[np.minimum(after, len(times) - 1)] - wanted),
        after - 1,
        np.minimum(after, len(times) - 1),
    )
    force = forces[nearest]
    force[np.abs(times[nearest] - wanted) > _PAIRED_S] = np.nan
    return raw, force


def mounting(body_from_sensor_deg: Vector3) -> FloatArray:
    """Rotation (3, 3) from a chip's axes into the body's (FRD), of its roll, pitch and yaw."""
    angles = (math.radians(angle) for angle in body_from_sensor_deg)
    return matrix_from_quat(quat_from_euler(*angles))
