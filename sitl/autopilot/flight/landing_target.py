"""LANDING_TARGET, and ArduPilot's filter of it: two states per axis.

NED in the autopilot's own frame, FRD, SI units. Source: ArduPilot 4.6 `AC_PrecLand` and its `PosVelEKF`.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol

from companion.base.geometry import Quaternion, Vector3
from sitl.autopilot.control.setpoints import MotionSetpoint
from sitl.autopilot.flight.modes import Severity


class LandingTargetFrame(IntEnum):
    """MAV_FRAME of a target's position, of the supported ones."""

    LOCAL_NED = 1
    BODY_FRD = 12


@dataclass(frozen=True, slots=True)
class LandingTarget:
    """One LANDING_TARGET: a position in `frame` (a MAV_FRAME), or None and the angles off the camera's axis.

    `angles_rad`: to the right, and backwards (angle_y = -forward); `distance_m` 0: unknown.
    """

    frame: int
    position_m: Vector3 | None
    angles_rad: tuple[float, float]
    distance_m: float


class VehicleEstimate(NamedTuple):
    """The autopilot's estimate of the vehicle at one outer step; height over home (m)."""

    now_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    attitude: Quaternion
    height_m: float
    landing_speed_m_s: float


class PrecisionLanding(Protocol):
    """An autopilot's own precision landing."""

    texts: list[tuple[Severity, str]]

    def update_target(self, target: LandingTarget) -> None:
        """Take a LANDING_TARGET message."""
        ...

    def watch(self, estimate: VehicleEstimate, dt_s: float) -> None:
        """Update the target's estimate at each outer step, landing or not."""
        ...

    def begin(self, *, required: bool) -> None:
        """Start a landing; `required`: without a target it searches instead of landing at once."""
        ...

    def fly(self, estimate: VehicleEstimate, dt_s: float) -> MotionSetpoint | None:
        """The setpoint; None: land as without a target."""
        ...


class AxisFilter:
    """Position and velocity of the target relative to the vehicle along one axis."""

    def __init__(self, position_m: float, velocity_m_s: float, position_var: float, velocity_var: float):
        self.position_m = position_m
        self.velocity_m_s = velocity_m_s
        self._pp, self._pv, self._vv = position_var, 0.0, velocity_var

    def predict(self, dt_s: float, own_change_m_s: float, velocity_var: float) -> None:
        """Predict by dt; the vehicle's velocity changes by the given amount, the target's by noise."""
        self.position_m += (self.velocity_m_s - 0.5 * own_change_m_s) * dt_s
        self.velocity_m_s -= own_change_m_s
        self._pp += dt_s * (2.0 * self._pv + dt_s * self._vv)
        self._pv += dt_s * self._vv
        self._vv += velocity_var

    def surprise(self, position_m: float, variance: float) -> float:
        """Normalised innovation squared of a measurement."""
        return (position_m - self.position_m) ** 2 / (self._pp + variance)

    def fuse(self, position_m: float, variance: float) -> None:
        """Fuse a measured position."""
        innovation, total = position_m - self.position_m, self._pp + variance
        gain_p, gain_v = self._pp / total, self._pv / total
        self.position_m += gain_p * innovation
        self.velocity_m_s += gain_v * innovation
        self._vv -= gain_v * self._pv
        self._pv -= gain_v * self._pp
        self._pp -= gain_p * self._pp


def direction_from_angles(angles_rad: tuple[float, float]) -> Vector3 | None:
    """Unit vector (FRD) to a target seen by a downward camera; None when it is not below."""
    right, backwards = angles_rad
    if not (abs(right) < 1.5 and abs(backwards) < 1.5):
        return None
    x, y = -math.tan(backwards), math.tan(right)
    length = math.sqrt(x * x + y * y + 1.0)
    return (x / length, y / length, 1.0 / length)
