"""The vehicle under its autopilot, as far as control knows it.

What was commanded, what pushes, what thrust is worth: joins the command history, the disturbance observer and
the thrust scale. NED and FRD, SI units.
"""

from __future__ import annotations

import math

from companion.config import ControlConfig, VehicleConfig
from companion.control.disturbance import (
    DISTURBANCE_WALK,
    LEANING_DISTURBANCE_WALKS,
    DisturbanceObserver,
    GustObserver,
    ThrustScale,
)
from companion.control.flight_model import Motion
from companion.control.history import Command, CommandHistory
from companion.control.setpoints import velocity_gains
from companion.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    add,
    level_acceleration,
    quat_rotate,
    scale,
    subtract,
)
from companion.messages import Setpoint, VehicleState


class Plant:
    """Learns from each estimate how the vehicle answers, and carries motions forward through that answer."""

    def __init__(self, config: ControlConfig, vehicle: VehicleConfig, lags_s: Vector3) -> None:
        """`lags_s` are `flight_model.lags`."""
        self._by_attitude = config.setpoint == "attitude"
        self._by_lean = config.setpoint != "velocity"
        self._config, self._lags_s = config, lags_s
        self._nominal_hover_thrust = vehicle.hover_thrust
        self._history = CommandHistory(config.command_delay_s)
        self._observer = DisturbanceObserver(
            1.0 / config.rate_hz,
            self._lags_s,
            config.acceleration_estimate_lag_s,
            config.maximum_disturbance_m_s2,
            LEANING_DISTURBANCE_WALKS if self._by_lean else (DISTURBANCE_WALK,) * 3,
        )
        self._maximum_m_s2 = config.maximum_disturbance_m_s2
        self._gusts = GustObserver(config.acceleration_estimate_lag_s)
        self._thrust_scale = ThrustScale()
        self._lasting_s = config.lasting_disturbance_s
        self._lasting: Vector3 = ZERO3
        self._observed_s = 0.0

    @property
    def disturbance_ned_m_s2(self) -> Vector3:
        """What pushes besides the command (m/s2, NED)."""
        return self._gusts.added_to(self._observer.disturbance_ned_m_s2, self._maximum_m_s2)

    @property
    def lasting_disturbance_ned_m_s2(self) -> Vector3:
        """The part of the disturbance that has lasted (m/s2, NED)."""
        return self._lasting

    @property
    def acceleration_ned_m_s2(self) -> Vector3:
        """Flown acceleration (m/s2, NED)."""
        return self._observer.acceleration_ned_m_s2

    @property
    def hover_thrust(self) -> float:
        """Share of full thrust that carries the weight, as learnt."""
        return self._nominal_hover_thrust * self._thrust_scale.factor

    def begin(self, vehicle: VehicleState) -> None:
        """Begin anew, nothing commanded. A leaning vehicle that does not accelerate leans against wind.

        With velocity setpoints the autopilot's own integral goes on to meet that wind.
        """
        disturbance = ZERO3
        acceleration = vehicle.acceleration_ned_m_s2
        if self._by_lean:
            lean = level_acceleration(vehicle.attitude)
            disturbance = (acceleration[0] - lean[0], acceleration[1] - lean[1], 0.0)
        self._lasting = ZERO3
        self._observer.start(vehicle.velocity_ned_m_s, acceleration, disturbance)
        self._gusts.reset()
        self._observed_s = vehicle.time_s
        self._history.clear()

    def observe(self, vehicle: VehicleState, elapsed_s: float) -> None:
        """Compare what the vehicle does with what was commanded; the last call was `elapsed_s` ago."""
        gust = self._gust(vehicle, elapsed_s)
        for duration_s, command in self._history.segments(self._observed_s, vehicle.time_s):
            self._observer.predict(add(self._wanted(command, duration_s), gust), duration_s)
        self._observed_s = max(self._observed_s, vehicle.time_s)
        self._observer.correct(vehicle.velocity_ned_m_s, vehicle.acceleration_ned_m_s2)
        share = -math.expm1(-elapsed_s / self._lasting_s)
        fresh = subtract(self._observer.disturbance_ned_m_s2, self._lasting)
        self._lasting = add(self._lasting, scale(fresh, share))
        if self._by_attitude:
            down = self._observer.disturbance_ned_m_s2[2]
            self._observer.relieve_vertical(self._thrust_scale.learn(down, elapsed_s))

    def _gust(self, vehicle: VehicleState, elapsed_s: float) -> Vector3:
        """The quick part of the wind's push.

        Nothing by velocity setpoints: there the autopilot answers gusts by itself, and what it does leans the
        vehicle besides what was commanded.
        """
        if not self._by_lean:
            return ZERO3
        return self._gusts.step(vehicle.attitude, vehicle.acceleration_ned_m_s2, elapsed_s)

    def carry(self, motion: Motion, from_s: float, to_s: float) -> Motion:
        """The motion at `to_s` from that at `from_s`, under what is under way to the autopilot."""
        return self._history.carry(motion, from_s, to_s, self.disturbance_ned_m_s2, self._lags_s)

    def last_input(self, motion: Motion) -> Vector3:
        """The input (m/s2) that is in effect; before the first command, what explains the motion."""
        effect = self._history.last_effect(motion.velocity_m_s)
        if effect is not None:
            return effect
        return subtract(motion.acceleration_m_s2, self.disturbance_ned_m_s2)

    def remember(self, setpoint: Setpoint) -> None:
        """Take note of what left, after all limits."""
        if setpoint.attitude is None or setpoint.thrust is None:
            gains = velocity_gains(self._config, sideways=setpoint.holds_horizontal_velocity)
            acceleration, velocity = setpoint.acceleration_ned_m_s2, setpoint.velocity_ned_m_s
            command = Command(setpoint.time_s, acceleration, velocity, gains)
        else:
            push = setpoint.thrust / self.hover_thrust * GRAVITY_M_S2
            force = quat_rotate(setpoint.attitude, (0.0, 0.0, -push))
            command = Command(setpoint.time_s, add(force, (0.0, 0.0, GRAVITY_M_S2)))
        self._history.add(command)

    def _wanted(self, command: Command | None, duration_s: float) -> Vector3:
        """What the autopilot wants in a piece of time; before the first command, what the vehicle does."""
        acceleration = self._observer.acceleration_ned_m_s2
        if command is None:
            return subtract(acceleration, self.disturbance_ned_m_s2)
        halfway = add(self._observer.velocity_ned_m_s, scale(acceleration, 0.5 * duration_s))
        return self._history.effect(command, halfway)
