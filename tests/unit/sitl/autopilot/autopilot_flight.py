"""A rigid body with four lagging rotors, drag and a floor: enough to fly the simulated autopilot in tests.

Deliberately apart from the simulator's own plant, so that a sign that is wrong in both cannot hide. NED, FRD.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import GRAVITY_M_S2, ZERO3, Quaternion, Vector3, quat_integrate, quat_rotate
from companion.base.messages import LandedState
from sitl.autopilot.control.attitude_control import RateGains
from sitl.autopilot.control.estimator import NO_ERRORS, EstimatorErrors
from sitl.autopilot.control.setpoints import AttitudeSetpoint, MotionSetpoint
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.autopilot.flight.modes import CommandResult
from sitl.scenario.scenario import load_airframe
from sitl.vehicle.quadrotor import QuadrotorParameters, QuadrotorState, RotorValues

HOME: Vector3 = (47.0, 8.0, 400.0)
RATE_HZ = 400
Streamed = MotionSetpoint | AttitudeSetpoint | Callable[[float], MotionSetpoint | AttitudeSetpoint]


class MotionSample(NamedTuple):
    """The true motion at one time."""

    time_s: float
    position: Vector3
    velocity: Vector3
    attitude: Quaternion


def frame_450(**other: Any) -> QuadrotorParameters:
    """An airframe of 1.5 kg that hovers at half throttle."""
    numbers: dict[str, Any] = {
        "mass_kg": 1.5,
        "inertia_kg_m2": (0.016, 0.016, 0.03),
        "arm_length_m": 0.25,
        "max_thrust_n": 7.36,
        "torque_to_thrust_m": 0.016,
    }
    return load_airframe("x500").body.model_copy(update=numbers | other)


class SimpleVehicle:
    """Stands on a floor until it flies; `floor_velocity_ned_m_s` lets the floor move like a pad."""

    def __init__(self, airframe: QuadrotorParameters, heading_rad: float = 0.0) -> None:
        self.airframe = airframe
        self.wind_ned_m_s: Vector3 = ZERO3
        self.floor_velocity_ned_m_s: Vector3 = ZERO3
        self.floor_z_m = -0.18
        self.position: Vector3 = (0.0, 0.0, self.floor_z_m)
        self.velocity: Vector3 = ZERO3
        self.attitude: Quaternion = (math.cos(heading_rad / 2), 0.0, 0.0, math.sin(heading_rad / 2))
        self.rate: Vector3 = ZERO3
        self._motors: RotorValues = (0.0, 0.0, 0.0, 0.0)

    @property
    def height_m(self) -> float:
        """Feet over the floor."""
        return self.floor_z_m - self.position[2]

    @property
    def state(self) -> QuadrotorState:
        """The true motion."""
        return QuadrotorState(self.position, self.velocity, self.attitude, self.rate)

    def step(self, commands: RotorValues, dt_s: float) -> None:
        """Semi-implicit Euler; at 400 Hz that is plenty for a controller's test."""
        a, lag = self.airframe, 1.0 - math.exp(-dt_s / 0.04)
        m1, m2, m3, m4 = self._motors = tuple(
            m + lag * (c - m) for m, c in zip(self._motors, commands, strict=True)
        )
        full, arm, k = a.max_thrust_n, a.arm_length_m, a.torque_to_thrust_m
        torque = (full * arm * (m4 - m2), full * arm * (m1 - m3), full * k * (m1 - m2 + m3 - m4))
        jx, jy, jz = a.inertia_kg_m2
        p, q, r = self.rate
        self.rate = (
            p + dt_s * (torque[0] + (jy - jz) * q * r) / jx,
            q + dt_s * (torque[1] + (jz - jx) * r * p) / jy,
            r + dt_s * (torque[2] + (jx - jy) * p * q) / jz,
        )
        self.attitude = quat_integrate(self.attitude, self.rate, dt_s)
        lift = quat_rotate(self.attitude, (0.0, 0.0, -full * (m1 + m2 + m3 + m4) / a.mass_kg))
        self.velocity = tuple(  # type: ignore[assignment]
            v + dt_s * (f + g - 0.25 * (v - w))
            for v, f, g, w in zip(
                self.velocity, lift, (0.0, 0.0, GRAVITY_M_S2), self.wind_ned_m_s, strict=True
            )
        )
        x, y, z = self.position
        vx, vy, vz = self.velocity
        self.floor_z_m += self.floor_velocity_ned_m_s[2] * dt_s
        self.position = (x + vx * dt_s, y + vy * dt_s, z + vz * dt_s)
        if self.position[2] >= self.floor_z_m:
            self._stand()

    def _stand(self) -> None:
        x, y, _ = self.position
        fx, fy, fz = self.floor_velocity_ned_m_s
        self.position, self.rate = (x, y, self.floor_z_m), ZERO3
        self.velocity = (fx, fy, min(self.velocity[2], fz))
        heading = math.atan2(self.attitude[3], self.attitude[0])
        self.attitude = (math.cos(heading), 0.0, 0.0, math.sin(heading))


class AutopilotFlight:
    """A vehicle and its autopilot stepped together; `texts` collects what the autopilot says."""

    def __init__(
        self,
        autopilot_kind: AutopilotKind,
        errors: EstimatorErrors = NO_ERRORS,
        seed: int = 1,
        heading_rad: float = 0.0,
    ) -> None:
        airframe = frame_450()
        self.vehicle = SimpleVehicle(airframe, heading_rad)
        # tuned to it: by the autopilots' defaults the yaw of a vehicle without any drag hardly settles
        self.autopilot = SimulatedAutopilot(
            autopilot_kind, airframe, np.random.default_rng(seed), HOME, errors, rates=RateGains()
        )
        self.texts: list[str] = []
        self._steps = 0

    @property
    def now_s(self) -> float:
        """Time since boot."""
        return self._steps / RATE_HZ

    def run(self, duration_s: float, setpoint: Streamed | None = None) -> list[MotionSample]:
        """Fly on, streaming the setpoint (or what it gives for the time) at 30 Hz; samples at 50 Hz."""
        samples = []
        for _ in range(round(duration_s * RATE_HZ)):
            if setpoint is not None and self._steps % 13 == 0:
                wanted = setpoint(self.now_s) if callable(setpoint) else setpoint
                self.autopilot.stream(wanted, self.now_s)
            vehicle = self.vehicle
            motors = self.autopilot.step(vehicle.state, 1.0 / RATE_HZ, self.now_s)
            vehicle.step(motors, 1.0 / RATE_HZ)
            self._steps += 1
            if self._steps % 8 == 0:
                samples.append(MotionSample(self.now_s, vehicle.position, vehicle.velocity, vehicle.attitude))
                self.texts.extend(text for _, text in self.autopilot.take_texts())
        return samples

    def take_off(self, height_m: float = 6.0) -> None:
        """From boot to a hover under external control (OFFBOARD or GUIDED)."""
        self.run(6.0)
        autopilot = self.autopilot
        if autopilot.profile.name == "px4":
            assert autopilot.arm() is CommandResult.ACCEPTED
            assert autopilot.take_off(HOME[2] + 0.18 + height_m) is CommandResult.ACCEPTED
        else:
            assert autopilot.set_mode(4) is CommandResult.ACCEPTED
            assert autopilot.arm() is CommandResult.ACCEPTED
            assert autopilot.take_off(height_m) is CommandResult.ACCEPTED
        self.run(4.0 + height_m / 1.5)

    def take_control(self) -> None:
        """Stream "stand still" and enter OFFBOARD (GUIDED already is)."""
        self.run(0.2, STAND_STILL)
        if self.autopilot.profile.name == "px4":
            assert self.autopilot.set_mode(PX4_OFFBOARD) is CommandResult.ACCEPTED
        self.run(2.0, STAND_STILL)


PX4_OFFBOARD = 6 << 16
STAND_STILL = MotionSetpoint(velocity_ned_m_s=(0.0, 0.0, 0.0))
ZERO: Vector3 = (0.0, 0.0, 0.0)


def velocity(north: float, east: float = 0.0, down: float = 0.0) -> MotionSetpoint:
    return MotionSetpoint(velocity_ned_m_s=(north, east, down))


def reached_s(samples: list[MotionSample], quantity: Callable[[MotionSample], float], level: float) -> float:
    """Seconds from the first sample until the quantity passes the level."""
    return next(s.time_s for s in samples if quantity(s) > level) - samples[0].time_s


def landed_state(flight: AutopilotFlight) -> LandedState:
    """Through a function, because it changes behind the type checker's back."""
    return flight.autopilot.landed_state


def ready(flight: AutopilotFlight) -> bool:
    """As `landed_state`."""
    return flight.autopilot.ready_to_arm


AUTOPILOT_KINDS: tuple[AutopilotKind, ...] = ("px4", "ardupilot")


def in_the_air(autopilot_kind: AutopilotKind, **options: object) -> AutopilotFlight:
    flight = AutopilotFlight(autopilot_kind, **options)  # type: ignore[arg-type]
    flight.take_off()
    flight.take_control()
    return flight


def set_down(flight: AutopilotFlight, north: float = 0.0) -> None:
    """Sink by setpoints until the feet touch."""
    while flight.vehicle.height_m > 0.0:
        flight.run(0.1, velocity(north, 0.0, 0.5))
