"""Breaks devices as a scenario's faults say, at their times, one function a fault.

`FaultSchedule` asks once a step whether a fault begins or ends; then everything is mended and what is active
is broken anew, so that faults may overlap. SI units, body axes (FRD).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from companion.geometry import GRAVITY_M_S2, ZERO3, add
from sitl.devices.rack import SensorRack
from sitl.faults import (
    AccelClips,
    Fault,
    FrameLate,
    FrameLost,
    GpsLost,
    GyroBiasStep,
    ImuBusError,
    MagDisturbed,
    RangeSpikes,
)
from sitl.onboard import OnboardSensors


class FrameLine:
    """The way of frames from the camera to the app: what is held up on it, and what is lost."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self.mend()

    def mend(self) -> None:
        """Let everything through at once."""
        self.late_s = 0.0
        self.late_every = 1
        self.lost_share = 0.0

    def delay_s(self, sequence: int) -> float | None:
        """How much longer than usual a frame takes (s); None: it never comes."""
        if self.lost_share > 0.0 and float(self._rng.random()) < self.lost_share:
            return None
        return self.late_s if sequence % self.late_every == 0 else 0.0


class Breakable:
    """The devices and what may be broken about them."""

    def __init__(self, rack: SensorRack, frames: FrameLine, onboard: OnboardSensors | None = None) -> None:
        """`onboard` are the autopilot's own, which the world around does the same to."""
        self.inertial, self.magnetometer, self.echo = rack.inertial, rack.magnetometer, rack.echo
        self.gps, self.bus = rack.gps, rack.imu
        self.frames = frames
        self.onboard = onboard

    def mend(self) -> None:
        """Everything as it should be."""
        self.inertial.rate_offset_rad_s = ZERO3
        self.inertial.accel_limit_m_s2 = math.inf
        self.inertial.vibration_factor = 1.0
        self.magnetometer.stray_field_ut = ZERO3
        self.echo.extra_spikes = 0.0
        self.gps.has_fix, self.gps.silent = True, False
        self.bus.nack_every = 0
        if self.onboard is not None:
            self.onboard.has_sky, self.onboard.stray_field_ut = True, ZERO3
        self.frames.mend()


# ---------------------------------------------------------------- one function a fault


def lose_gps(fault: GpsLost, parts: Breakable) -> None:
    """No fix any more, or silence."""
    if fault.unplugged:
        parts.gps.silent = True
    else:
        parts.gps.has_fix = False
        if parts.onboard is not None:
            parts.onboard.has_sky = False


def disturb_magnetometer(fault: MagDisturbed, parts: Breakable) -> None:
    """Another field on top."""
    parts.magnetometer.stray_field_ut = add(parts.magnetometer.stray_field_ut, fault.field_body_ut)
    if parts.onboard is not None:
        parts.onboard.stray_field_ut = add(parts.onboard.stray_field_ut, fault.field_body_ut)


def step_gyro_bias(fault: GyroBiasStep, parts: Breakable) -> None:
    """A rate that is not there."""
    x, y, z = fault.rate_body_deg_s
    step = (math.radians(x), math.radians(y), math.radians(z))
    parts.inertial.rate_offset_rad_s = add(parts.inertial.rate_offset_rad_s, step)


def clip_accelerometer(fault: AccelClips, parts: Breakable) -> None:
    """Less range, more vibration."""
    limit_m_s2 = fault.range_g * GRAVITY_M_S2
    parts.inertial.accel_limit_m_s2 = min(parts.inertial.accel_limit_m_s2, limit_m_s2)
    parts.inertial.vibration_factor *= fault.vibration_factor


def spike_range(fault: RangeSpikes, parts: Breakable) -> None:
    """More wrong echoes."""
    parts.echo.extra_spikes = max(parts.echo.extra_spikes, fault.share)


def hold_frames_up(fault: FrameLate, parts: Breakable) -> None:
    """A longer way for some frames."""
    parts.frames.late_s, parts.frames.late_every = fault.extra_s, fault.every


def lose_frames(fault: FrameLost, parts: Breakable) -> None:
    """No way for some frames."""
    parts.frames.lost_share = max(parts.frames.lost_share, fault.share)


def disturb_bus(fault: ImuBusError, parts: Breakable) -> None:
    """Transactions that fail."""
    parts.bus.nack_every = fault.every


BREAK: Final[dict[str, Callable[[Any, Breakable], None]]] = {
    "gps_lost": lose_gps,
    "mag_disturbed": disturb_magnetometer,
    "gyro_bias_step": step_gyro_bias,
    "accel_clips": clip_accelerometer,
    "range_spikes": spike_range,
    "frame_late": hold_frames_up,
    "frame_lost": lose_frames,
    "imu_bus_error": disturb_bus,
}


class FaultSchedule:
    """Breaks and mends at the right times."""

    def __init__(self, faults: Sequence[Fault], parts: Breakable) -> None:
        self._faults = faults
        self._parts = parts
        self._changes_s = sorted({time_s for fault in faults for time_s in (fault.start_s, fault.end_s)})

    def step(self, now_s: float) -> None:
        """Once a physics step, before the sensors feel it."""
        if not self._changes_s or now_s < self._changes_s[0]:
            return
        while self._changes_s and now_s >= self._changes_s[0]:
            self._changes_s.pop(0)
        self._parts.mend()
        for fault in self._faults:
            if fault.start_s <= now_s < fault.end_s:
                BREAK[fault.kind](fault, self._parts)
