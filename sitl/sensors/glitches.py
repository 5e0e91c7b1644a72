"""Faults of a three-axis sensor's output: spikes and stuck readings.

Pure; the sensor's own axes and units. It has its own random numbers, so that a fault changes no other noise.
"""

from __future__ import annotations

import numpy as np

from companion.base.geometry import ZERO3, Vector3


class Glitches:
    """Between a sensor's element and its output. `stuck`: the last reading before stays."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._last: Vector3 = ZERO3
        self.clear_faults()

    def clear_faults(self) -> None:
        """Clear all faults."""
        self.stuck = False
        self.spike_share = 0.0
        self.spike_size = 0.0

    def spike(self, share: float, size: float) -> None:
        """A share of the readings is off by up to `size` on one axis; the worse of two faults counts."""
        self.spike_share = max(self.spike_share, share)
        self.spike_size = max(self.spike_size, size)

    def out(self, value: Vector3) -> Vector3:
        """The output for a reading."""
        if self.stuck:
            return self._last
        self._last = value
        if self.spike_share == 0.0 or float(self._rng.random()) >= self.spike_share:
            return value
        axis, off = int(self._rng.integers(3)), float(self._rng.uniform(-self.spike_size, self.spike_size))
        x, y, z = value
        return ((x + off, y, z), (x, y + off, z), (x, y, z + off))[axis]
