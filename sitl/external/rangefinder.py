"""A rangefinder for an external autopilot: DISTANCE_SENSOR of the height over pad and ground. Pure.

PX4 takes it as it is, ArduPilot with RNGFND1_TYPE 10. It is of the same make as the companion computer's
ultrasonic, with noise of its own.
"""

from __future__ import annotations

from typing import Any, Final

from sitl.mavlink.sensor_telemetry import distance_sensor
from sitl.sensors.sensors import RangeErrors, RangeSensor

PERIOD_S: Final = 0.05
Message = Any  # pymavlink's classes are generated without types


class RangefinderMessages:
    """The sensor and when its next message is due."""

    def __init__(self, sensor: RangeSensor, bounds: RangeErrors) -> None:
        """Of a sensor with these bounds."""
        self._sensor, self._bounds = sensor, bounds
        self._first_s: float | None = None
        self._due_s = 0.0

    def due(self, now_s: float, height_m: float, tilt_rad: float) -> Message | None:
        """The message that is due: `height_m` over what is below, tilting by `tilt_rad`."""
        if self._first_s is None:
            self._first_s = self._due_s = now_s
        if now_s < self._due_s:
            return None
        self._due_s = max(self._due_s + PERIOD_S, now_s)
        distance_m = self._sensor.sample(height_m, tilt_rad)
        return distance_sensor(round(1e3 * (now_s - self._first_s)), distance_m, self._bounds)
