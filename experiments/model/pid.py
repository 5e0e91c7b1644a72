"""Cascaded PID: what the MPC is compared with, and the app's `controller: pid`.

From outside inwards: position P gives a velocity, velocity PI an acceleration (`PositionPid`); that gives
thrust and tilt, attitude P gives rates, rate PID torques (`AttitudePid`, in the paper's axes and U1..U4).
Position, velocity and acceleration of the reference are fed forward, as autopilots do; of where the reference
will be later it knows nothing.

`PositionPid` works in any axes that do not turn, the third vertical; SI units. The gains in configs/control
come from `python -m experiments.tune_pid`.
"""

import math
from pathlib import Path

import numpy as np
from pydantic import Field

from companion.base.geometry import GRAVITY_M_S2, FloatArray, Vector3, wrap_angle
from companion.base.motion import Motion
from companion.config import StrictModel, find_file, load_model
from experiments.model.quadrotor import ANGLES, POSITION, RATES, VELOCITY, QuadrotorModel

FULLEST_TILT_COSINE = 0.2  # thrust is not raised for a tilt beyond


class AxisGains(StrictModel):
    """Of one direction of the outer loop."""

    position_1_s: float = Field(gt=0.0, le=20.0)  # velocity asked for a metre of error
    velocity_1_s: float = Field(gt=0.0, le=30.0)  # acceleration asked for a m/s of error
    integral_1_s2: float = Field(ge=0.0, le=60.0)  # the same for a metre of its integral


class AngleGains(StrictModel):
    """Of one direction of the inner loop."""

    attitude_1_s: float = Field(gt=0.0, le=40.0)  # rate asked for a radian of error
    rate_1_s: float = Field(gt=0.0, le=120.0)  # angular acceleration asked for a rad/s of error
    integral_1_s2: float = Field(ge=0.0, le=400.0)
    derivative: float = Field(ge=0.0, le=2.0)  # angular acceleration asked for one of the measured rate's


class CascadeGains(StrictModel):
    """A whole cascade, as configs/control/*.yaml has it."""

    horizontal: AxisGains
    vertical: AxisGains
    tilt: AngleGains
    heading: AngleGains
    derivative_filter_s: float = Field(default=0.02, ge=0.001, le=0.5)
    largest_integral_m_s2: float = Field(default=4.0, ge=0.0, le=20.0)
    largest_rate_integral_rad_s2: float = Field(default=10.0, ge=0.0, le=200.0)


def load_gains(name: str | Path) -> CascadeGains:
    """Gains by name (from configs/control) or path.

    Raises:
        ConfigError: the file is missing, not YAML, or a gain is out of range.
    """
    return load_model(CascadeGains, find_file("control", name))


class PositionPid:
    """Position and velocity to a commanded acceleration; keeps the integral, which the wind fills.

    `integral_m_s2` is the part of the command that stands against what lasts.
    """

    def __init__(self, horizontal: AxisGains, vertical: AxisGains, largest_integral_m_s2: float) -> None:
        self._gains = (horizontal, horizontal, vertical)
        self._largest = largest_integral_m_s2
        self.integral_m_s2 = [0.0, 0.0, 0.0]
        self._held = (0, 0, 0)

    def reset(self) -> None:
        """Forget the integral."""
        self.integral_m_s2 = [0.0, 0.0, 0.0]
        self._held = (0, 0, 0)

    def step(self, position_m: Vector3, velocity_m_s: Vector3, target: Motion, period_s: float) -> Vector3:
        """The acceleration to command (m/s²), before anybody's limits; `clipped` takes back what they cut."""
        command = [0.0, 0.0, 0.0]
        for axis, gains in enumerate(self._gains):
            error_m = target.position_m[axis] - position_m[axis]
            wanted_m_s = target.velocity_m_s[axis] + gains.position_1_s * error_m
            error_m_s = wanted_m_s - velocity_m_s[axis]
            growth = gains.integral_1_s2 * error_m_s * period_s
            if growth * self._held[axis] <= 0.0:
                grown = self.integral_m_s2[axis] + growth
                self.integral_m_s2[axis] = min(max(grown, -self._largest), self._largest)
            command[axis] = (
                target.acceleration_m_s2[axis] + gains.velocity_1_s * error_m_s + self.integral_m_s2[axis]
            )
        return (command[0], command[1], command[2])

    def clipped(self, asked_m_s2: Vector3, given_m_s2: Vector3) -> None:
        """Take what limits left of a command: the integral does not grow further towards what they cut."""
        cuts = [asked - given for asked, given in zip(asked_m_s2, given_m_s2, strict=True)]
        x, y, z = (0 if abs(cut) < 1e-9 else 1 if cut > 0.0 else -1 for cut in cuts)
        self._held = (x, y, z)


class AttitudePid:
    """Commanded acceleration and heading to U1..U4 of one airframe, in the paper's z-up axes."""

    def __init__(self, gains: CascadeGains, model: QuadrotorModel, largest_tilt_rad: float) -> None:
        self._gains = (gains.tilt, gains.tilt, gains.heading)
        self._largest = gains.largest_rate_integral_rad_s2
        self._filter_s = gains.derivative_filter_s
        self._model = model
        self._steepest = math.tan(largest_tilt_rad)
        self.integral_m_s2 = [0.0, 0.0, 0.0]
        self._before: list[float] | None = None
        self._slope = [0.0, 0.0, 0.0]

    def limited(self, acceleration_m_s2: Vector3) -> Vector3:
        """The acceleration that tilt and thrust allow; what carries the vehicle goes before."""
        ax, ay, az = acceleration_m_s2
        most = 0.95 * 4.0 * self._model.full_rotor_thrust_n / self._model.mass_kg
        lift = min(max(az + GRAVITY_M_S2, 0.3 * GRAVITY_M_S2), most)
        sideways = math.hypot(ax, ay)
        allowed = min(self._steepest * lift, math.sqrt(max(most * most - lift * lift, 0.0)))
        share = min(1.0, allowed / sideways) if sideways > 0.0 else 1.0
        return (ax * share, ay * share, lift - GRAVITY_M_S2)

    def step(
        self, state: FloatArray, acceleration_m_s2: Vector3, heading_rad: float, period_s: float
    ) -> FloatArray:
        """U (4,) for an acceleration within `limited` from a state (12,)."""
        angles, rates = state[ANGLES].tolist(), state[RATES].tolist()
        ax, ay, az = acceleration_m_s2
        lift = az + GRAVITY_M_S2
        cp, sp = math.cos(angles[2]), math.sin(angles[2])
        forward, left = cp * ax + sp * ay, -sp * ax + cp * ay
        theta = math.atan2(forward, lift)
        wanted = (math.atan2(-left, math.hypot(forward, lift)), theta, heading_rad)
        torques = self._torques(angles, rates, wanted, period_s)
        upright = max(math.cos(angles[0]) * math.cos(angles[1]), FULLEST_TILT_COSINE)
        return np.array([self._model.mass_kg * lift / upright, *torques])

    def _torques(self, angles: list[float], rates: list[float], wanted: Vector3, period_s: float) -> Vector3:
        before = rates if self._before is None else self._before
        share = period_s / (self._filter_s + period_s)
        torques = [0.0, 0.0, 0.0]
        for axis, gains in enumerate(self._gains):
            error_rad = wrap_angle(wanted[axis] - angles[axis])
            error_rad_s = gains.attitude_1_s * error_rad - rates[axis]
            grown = self.integral_m_s2[axis] + gains.integral_1_s2 * error_rad_s * period_s
            self.integral_m_s2[axis] = min(max(grown, -self._largest), self._largest)
            self._slope[axis] += share * ((rates[axis] - before[axis]) / period_s - self._slope[axis])
            turning = gains.rate_1_s * error_rad_s + self.integral_m_s2[axis]
            turning -= gains.derivative * self._slope[axis]
            torques[axis] = float(self._model.inertia_kg_m2[axis]) * turning
        self._before = rates
        return (torques[0], torques[1], torques[2])


class CascadedPid:
    """The whole cascade on the paper's 12 states."""

    def __init__(self, gains: CascadeGains, model: QuadrotorModel, largest_tilt_rad: float) -> None:
        self._outer = PositionPid(gains.horizontal, gains.vertical, gains.largest_integral_m_s2)
        self._inner = AttitudePid(gains, model, largest_tilt_rad)

    def step(self, state: FloatArray, target: Motion, heading_rad: float, period_s: float) -> FloatArray:
        """U (4,) from a state (12,) and a target in the paper's axes."""
        px, py, pz = state[POSITION].tolist()
        vx, vy, vz = state[VELOCITY].tolist()
        asked = self._outer.step((px, py, pz), (vx, vy, vz), target, period_s)
        given = self._inner.limited(asked)
        self._outer.clipped(asked, given)
        return self._inner.step(state, given, heading_rad, period_s)
