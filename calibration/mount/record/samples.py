"""The input of the mount calibration: IMU samples and sightings of one recording, as arrays.

Body axes are FRD; camera axes OpenCV's; the pad's frame has x along its heading, y to its right, z down.
Times are seconds of the recording's clock: a sighting's is its frame's stamp (plus its rows' share of the
readout); the calibration finds its time offset.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray

LONGEST_IMU_GAP_S = 0.05
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ImuSamples:
    """Inertial samples: times (n,), rates (n, 3) rad/s, specific forces (n, 3) m/s², temperatures (n,) °C."""

    time_s: FloatArray
    rate: FloatArray
    force: FloatArray
    temperature_c: FloatArray

    @property
    def period_s(self) -> float:
        """The usual time from one sample to the next."""
        return float(np.median(np.diff(self.time_s)))

    def gaps(self) -> FloatArray:
        """Segments (k, 2) without samples, from and to (s)."""
        wide = np.flatnonzero(np.diff(self.time_s) > LONGEST_IMU_GAP_S)
        return np.column_stack((self.time_s[wide], self.time_s[wide + 1]))


@dataclass(frozen=True, slots=True)
class PadObservations:
    """The pad in camera axes: stamps (k,), rotations (k, 3, 3) of pad into camera axes, positions (k, 3) m.

    `covariance` (k, 6, 6) is that of position, then of a small rotation about the camera's axes.
    """

    time_s: FloatArray
    camera_from_pad: FloatArray
    position_m: FloatArray
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)

    def taken(self, which: Indices | Mask) -> PadObservations:
        """Some of them: a mask or indices."""
        return replace(
            self,
            time_s=self.time_s[which],
            camera_from_pad=self.camera_from_pad[which],
            position_m=self.position_m[which],
            covariance=self.covariance[which],
        )
