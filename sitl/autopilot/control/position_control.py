"""Motion setpoints to an attitude and a thrust: what the control laws of both autopilots share.

A law (`px4.control`, `ardupilot.control`) makes an acceleration of a setpoint; here that becomes tilt and
thrust. Tilt follows the horizontal acceleration against gravity alone, thrust the vertical one over the
tilt's cosine: both autopilots decouple them so. What a setpoint does not give is NaN; north and east go
together. NED in the autopilot's own heading frame, SI units.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import isnan, nan
from typing import Final

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Quaternion,
    Vector3,
    quat_from_euler,
    tilt_from_quat,
    wrap_angle,
)
from sitl.autopilot.control.setpoints import MotionSetpoint

# position, velocity and acceleration of the vehicle, as the autopilot estimates them
Motion = tuple[Vector3, Vector3, Vector3]
_STEEPEST_COSINE: Final = 0.5  # below it there is no further tilt compensation
SLEW_RAD_S: Final = math.radians(60.0)  # of headings in autonomous modes: MPC_YAWRAUTO_MAX, ATC_SLEW_YAW


def tilt_cosine(attitude: Quaternion) -> float:
    """Divisor of the tilt compensation of thrust; bounded below."""
    return max(_STEEPEST_COSINE, math.cos(tilt_from_quat(attitude)))


@dataclass(frozen=True, slots=True)
class OutputLimits:
    """Limits of a law's output: tilt, share of full thrust."""

    tilt_rad: float
    thrust_range: tuple[float, float]


class PositionControl(ABC):
    """Base of the control laws; holds the heading. Results are in the public fields.

    `velocity_reference` is the present velocity setpoint, `saturated` means that the tilt is at its
    limit. `thrust` is `upward`, its vertical share, over the cosine of the tilt setpoint. `hover` is the
    share of full thrust that is believed to carry the weight.
    """

    def __init__(self, hover_thrust: float, limits: OutputLimits) -> None:
        self._limits = limits
        self.hover = hover_thrust
        self.reset(0.0, ZERO3)

    def reset(self, yaw_rad: float, velocity_ned_m_s: Vector3) -> None:
        """Restart from the present heading and velocity with zero integrals."""
        self.yaw_rad = yaw_rad
        self.yaw_rate_rad_s = 0.0
        self.attitude: Quaternion = quat_from_euler(0.0, 0.0, yaw_rad)
        self.thrust = self.upward = self.hover
        self.velocity_reference = velocity_ned_m_s
        self.saturated = False
        self._forget(velocity_ned_m_s)

    def step(self, motion: Motion, setpoint: MotionSetpoint, dt_s: float, frozen: bool = False) -> None:
        """One outer step; `frozen` holds the integrals (before lift-off)."""
        self._turn(setpoint, dt_s)
        wanted = self._wanted(motion, setpoint, dt_s, frozen)
        self._point_thrust(*wanted)

    def step_climb(
        self, motion: Motion, attitude: Quaternion, climb_m_s: float, dt_s: float, frozen: bool = False
    ) -> None:
        """Height only: thrust for a climb rate at an externally commanded attitude."""
        setpoint = MotionSetpoint(velocity_ned_m_s=(nan, nan, -climb_m_s))
        down = self._wanted_down(motion, setpoint, dt_s, frozen)
        self.upward = self.hover * (1.0 - down / GRAVITY_M_S2)
        self.thrust = self._bounded_thrust(self.upward / tilt_cosine(attitude))

    def follow(self, yaw_rad: float, velocity_ned_m_s: Vector3) -> None:
        """The attitude is commanded externally: track the present heading and velocity."""
        self.yaw_rad, self.yaw_rate_rad_s, self.saturated = yaw_rad, 0.0, False
        vx, vy, _ = velocity_ned_m_s
        self.velocity_reference = (vx, vy, self.velocity_reference[2])
        self._let_go_sideways()

    def start_height(self, position: Vector3, velocity: Vector3, upward: float) -> None:
        """The height is ours again after a thrust that was commanded externally; `upward` is its share."""
        self.upward = upward

    # ------------------------------------------------------------ the law

    @abstractmethod
    def _forget(self, velocity: Vector3) -> None:
        """Reset the law's states."""

    @abstractmethod
    def _let_go_sideways(self) -> None:
        """The tilt is commanded externally: reset the horizontal states."""

    @abstractmethod
    def _wanted(self, motion: Motion, setpoint: MotionSetpoint, dt_s: float, frozen: bool) -> Vector3:
        """The acceleration setpoint (NED, without gravity); sets `velocity_reference`."""

    @abstractmethod
    def _wanted_down(self, motion: Motion, setpoint: MotionSetpoint, dt_s: float, frozen: bool) -> float:
        """The vertical acceleration setpoint alone."""

    # ------------------------------------------------------------ heading, tilt and thrust

    def _turn(self, sp: MotionSetpoint, dt_s: float) -> None:
        """Advance the heading: a streamed one passes unchanged, autonomous modes turn at SLEW_RAD_S."""
        limit = math.inf if sp.streamed else SLEW_RAD_S
        rate = 0.0 if isnan(sp.yaw_rate_rad_s) else min(max(sp.yaw_rate_rad_s, -limit), limit)
        self.yaw_rate_rad_s = rate
        step = rate * dt_s
        if not isnan(sp.yaw_rad):
            step = wrap_angle(sp.yaw_rad - self.yaw_rad)
            step = min(max(step, -limit * dt_s), limit * dt_s)
        self.yaw_rad = wrap_angle(self.yaw_rad + step)

    def _point_thrust(self, ax: float, ay: float, az: float) -> None:
        """Tilt and thrust for an acceleration; the vertical part has priority."""
        high = self._limits.thrust_range[1] / self.hover * GRAVITY_M_S2
        up = max(GRAVITY_M_S2 - az, 0.0)
        # as much tilt as leaves the vertical share, but at least a little
        steepest = min(self._limits.tilt_rad, max(math.acos(min(1.0, up / high)), 0.3))
        sideways, limit = math.hypot(ax, ay), math.tan(steepest) * GRAVITY_M_S2
        self.saturated = sideways > limit
        if self.saturated:
            ax, ay, sideways = ax * limit / sideways, ay * limit / sideways, limit
        force = math.hypot(sideways, GRAVITY_M_S2)
        self.upward = self.hover * up / GRAVITY_M_S2
        self.thrust = self._bounded_thrust(self.upward * force / GRAVITY_M_S2)
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        forward, right = c * ax + s * ay, c * ay - s * ax
        pitch = math.atan2(-forward, GRAVITY_M_S2)
        self.attitude = quat_from_euler(math.asin(right / force), pitch, self.yaw_rad)

    def _bounded_thrust(self, thrust: float) -> float:
        low, high = self._limits.thrust_range
        return min(max(thrust, low), high)
