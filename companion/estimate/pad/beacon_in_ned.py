"""The pad's beacon in NED, as the pad filter takes it: its GPS minus ours. Pure.

Both are off by metres that wander over a minute: that is one error of all its fixes, not noise. So is what a
pad drives until its fix has come.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Final

import numpy as np

from companion.base.geometry import Vector3, ned_from_geodetic, subtract
from companion.base.messages import PadBeacon
from companion.estimate.pad.observation import (
    CommonError,
    ObservationKind,
    RelativeFix,
    RelativeVelocity,
    VehicleAtExposure,
)

WANDER_S: Final = 60.0  # as `estimate.ekf.gps_wander_s` has it of ours
NOISE_SHARE: Final = 0.3  # of what both are off by; the rest does not change from fix to fix
NOISE_M: Final = 0.05  # at least: RTK
DELAY_STD_S: Final = 0.5  # a fix's age on arrival: the answer's way, and a receiver of 1 Hz
VERTICAL_FACTOR: Final = 1.5  # of a receiver that tells its horizontal accuracy alone


def in_ned(beacon: PadBeacon, exposure: VehicleAtExposure) -> RelativeFix | None:
    """A beacon in NED; None while the vehicle's own place is unknown."""
    place = exposure.place()
    if place is None:
        return None
    across_m, up_m = beacon.position_std_m, beacon.vertical_std_m
    theirs = (across_m, across_m, VERTICAL_FACTOR * across_m if up_m is None else up_m)
    off_m = _each(math.hypot, theirs, place.position_std_m)
    late_m = (DELAY_STD_S * v for v in beacon.velocity_ned_m_s)
    noise = [max(NOISE_M, NOISE_SHARE * std) ** 2 for std in off_m]
    at = ned_from_geodetic(beacon.latitude_deg, beacon.longitude_deg, beacon.altitude_m, place.origin)
    velocity, speed_std = None, beacon.velocity_std_m_s
    if speed_std is not None:
        velocity = RelativeVelocity(
            subtract(beacon.velocity_ned_m_s, exposure.velocity_ned_m_s),
            _each(math.hypot, (speed_std, speed_std, speed_std), place.velocity_std_m_s),
        )
    return RelativeFix(
        gate="beacon",
        position_ned_m=subtract(at, place.position_ned_m),
        covariance_ned_m2=np.diag(noise),
        vehicle_velocity_ned_m_s=exposure.velocity_ned_m_s,
        vehicle_velocity_std_m_s=exposure.velocity_std_m_s,
        relative_velocity=velocity,
        common=CommonError("beacon", _each(math.hypot, off_m, late_m), WANDER_S),
    )


def numbers(beacon: PadBeacon) -> tuple[float, ...]:
    """All of a beacon that has to be finite."""
    place = (beacon.latitude_deg, beacon.longitude_deg, beacon.altitude_m)
    stds = (beacon.position_std_m, beacon.vertical_std_m or 0.0, beacon.velocity_std_m_s or 0.0)
    return (*place, *beacon.velocity_ned_m_s, *stds)


def _each(combine: Callable[[float, float], float], a: Iterable[float], b: Iterable[float]) -> Vector3:
    north, east, down = map(combine, a, b)
    return (north, east, down)


BEACON: Final = ObservationKind("beacon", PadBeacon, numbers, in_ned)
