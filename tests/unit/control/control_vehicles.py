"""Vehicles under an autopilot for the control tests, from simple to like the real thing.

They differ from the controller's model on purpose: other lag, other gains, an integral, biased velocity
estimates. Written from the description of autopilots, not from the controller's code. NED, SI units.
"""

import math
from dataclasses import dataclass

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    add,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    rotation_vector_from_quat,
    scale,
    subtract,
)
from companion.base.messages import Setpoint
from companion.control.attitude import attitude_from_acceleration


@dataclass
class PointMass:
    """A point mass with an attitude; `push` is the acceleration that wind makes."""

    position: Vector3
    velocity: Vector3 = ZERO3
    acceleration: Vector3 = ZERO3
    attitude: Quaternion = IDENTITY

    def move(self, force: Vector3, push: Vector3, dt_s: float) -> None:
        self.acceleration = add(force, push)
        self.velocity = add(self.velocity, scale(self.acceleration, dt_s))
        self.position = add(self.position, scale(self.velocity, dt_s))


@dataclass
class VelocityAutopilot:
    """Horizontal and vertical velocity loops with an integral, then attitude and motors as a lag."""

    gain: Vector3 = (2.5, 2.5, 3.0)
    integral_gain: Vector3 = (0.5, 0.5, 1.0)
    lag_s: float = 0.15
    bias_m_s: float = 0.05
    _integral: Vector3 = ZERO3
    _flown: Vector3 = ZERO3

    def force(self, vehicle: PointMass, setpoint: Setpoint, time_s: float, dt_s: float) -> Vector3:
        wander = math.tau * time_s / 30.0
        estimate = add(
            vehicle.velocity,
            (self.bias_m_s * math.cos(wander), self.bias_m_s * math.sin(wander), 0.5 * self.bias_m_s),
        )
        error = subtract(setpoint.velocity_ned_m_s, estimate)
        heard = [2] if not setpoint.holds_horizontal_velocity else [0, 1, 2]
        gained = (self.integral_gain[i] * error[i] * dt_s if i in heard else 0.0 for i in range(3))
        self._integral = add(self._integral, tuple(gained))  # type: ignore[arg-type]
        wanted = tuple(
            setpoint.acceleration_ned_m_s2[i]
            + (self.gain[i] * error[i] + self._integral[i] if i in heard else 0.0)
            for i in range(3)
        )
        change = scale(subtract(wanted, self._flown), dt_s / self.lag_s)  # type: ignore[arg-type]
        self._flown = add(self._flown, change)
        vehicle.attitude = attitude_from_acceleration(self._flown, 0.0)
        return self._flown


@dataclass
class AttitudeAutopilot:
    """Attitude and thrust followed with a lag; the thrust is worth `thrust_scale` times what is asked."""

    hover_thrust: float = 0.5
    thrust_scale: float = 0.9
    lag_s: float = 0.15
    _thrust: float = 0.5

    def force(self, vehicle: PointMass, setpoint: Setpoint, _time_s: float, dt_s: float) -> Vector3:
        assert setpoint.attitude is not None
        assert setpoint.thrust is not None
        error = quat_multiply(quat_conjugate(vehicle.attitude), setpoint.attitude)
        turn = scale(rotation_vector_from_quat(error), dt_s / self.lag_s)
        vehicle.attitude = quat_normalise(quat_multiply(vehicle.attitude, quat_from_rotation_vector(turn)))
        self._thrust += (setpoint.thrust - self._thrust) * dt_s / 0.05
        push = self._thrust / self.hover_thrust * self.thrust_scale * GRAVITY_M_S2
        return add(quat_rotate(vehicle.attitude, (0.0, 0.0, -push)), (0.0, 0.0, GRAVITY_M_S2))


@dataclass
class SwayingAutopilot:
    """Like a real autopilot on a real airframe, as far as it matters to what may sway.

    Outer loop at 100 Hz (velocity P and I, and the acceleration fed forward), the tilt it asks for followed
    at second order by rate and attitude loops, motors that lag behind both torque and thrust. Attitude
    setpoints skip the outer loop. The tilt is kept as the acceleration that it gives.
    """

    gain: Vector3 = (1.8, 1.8, 4.0)
    integral_gain: Vector3 = (0.5, 0.5, 2.0)
    attitude_gain_1_s: float = 6.5
    rate_gain_1_s: float = 20.0
    motor_lag_s: float = 0.04
    slowness: float = 1.0  # stretches attitude and motors in time
    _integral: Vector3 = ZERO3
    _wanted: Vector3 = ZERO3
    _tilt: tuple[float, float] = (0.0, 0.0)
    _turn: tuple[float, float] = (0.0, 0.0)
    _torque: tuple[float, float] = (0.0, 0.0)
    _lift: float = 0.0
    _due_s: float = 0.0

    def force(self, vehicle: PointMass, setpoint: Setpoint, time_s: float, dt_s: float) -> Vector3:
        if time_s >= self._due_s - 1e-9:
            self._due_s += 0.01
            self._wanted = self._outer(vehicle, setpoint)
        dt = dt_s / self.slowness
        flown = [self._follow(axis, dt) for axis in (0, 1)]
        self._lift += (self._wanted[2] - self._lift) * dt / self.motor_lag_s
        x, y = flown
        vehicle.attitude = attitude_from_acceleration((x, y, 0.0), 0.0)
        return (x, y, self._lift)

    def _outer(self, vehicle: PointMass, setpoint: Setpoint) -> Vector3:
        if setpoint.attitude is not None and setpoint.thrust is not None:
            push = setpoint.thrust / 0.5 * GRAVITY_M_S2
            return add(quat_rotate(setpoint.attitude, (0.0, 0.0, -push)), (0.0, 0.0, GRAVITY_M_S2))
        error = subtract(setpoint.velocity_ned_m_s, vehicle.velocity)
        i, e, k, a = self._integral, error, self.gain, setpoint.acceleration_ned_m_s2
        kx, ky, kz = self.integral_gain
        if not setpoint.holds_horizontal_velocity:
            self._integral = (i[0], i[1], i[2] + 0.01 * kz * e[2])
            return (a[0], a[1], a[2] + k[2] * e[2] + self._integral[2])
        self._integral = (i[0] + 0.01 * kx * e[0], i[1] + 0.01 * ky * e[1], i[2] + 0.01 * kz * e[2])
        x, y, z = add(a, self._integral)
        return (x + k[0] * e[0], y + k[1] * e[1], z + k[2] * e[2])

    def _follow(self, axis: int, dt_s: float) -> float:
        """One step of attitude, rate and motors of one axis; returns the acceleration that the tilt gives."""
        tilt, turn, torque = list(self._tilt), list(self._turn), list(self._torque)
        rate = self.attitude_gain_1_s * (self._wanted[axis] - tilt[axis])
        torque[axis] += (self.rate_gain_1_s * (rate - turn[axis]) - torque[axis]) * dt_s / self.motor_lag_s
        turn[axis] += torque[axis] * dt_s
        tilt[axis] += turn[axis] * dt_s
        self._tilt, self._turn, self._torque = (tilt[0], tilt[1]), (turn[0], turn[1]), (torque[0], torque[1])
        return tilt[axis]
