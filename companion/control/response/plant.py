"""The vehicle under its autopilot as the controller models it.

It joins the command history, the disturbance observer and the estimate of the hover thrust. NED and FRD, SI
units.
"""

import math
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Vector3,
    add,
    quat_rotate,
    scale,
    subtract,
    tilt_from_quat,
)
from companion.base.messages import Setpoint, VehicleState
from companion.base.motion import Motion
from companion.config import ControlConfig, VehicleConfig
from companion.control.disturbance_observer import SlowDisturbanceObserver, WindObserver
from companion.control.limits import LONGEST_STEP_S
from companion.control.response.fitting import loop_rad_s
from companion.control.response.flight_model import flown_kind, velocity_gains
from companion.control.response.history import CommandHistory, SentCommand
from companion.control.response.hover_thrust import TOLD_STD, HeldThrust, HoverThrust

# how fast what no wind explains is trusted, as a share of the loop's own frequency: see `margins`
LASTING_SHARE: Final = 0.25
# along down that is all there is to meet the air under the rotors; the autopilot's own velocity loop damps it
# By attitude the hover thrust's estimate does it, as fast as this.
LASTING_DOWN_SHARE: Final = {"velocity": 0.25, "acceleration": 1.0, "attitude": 0.3}


class Plant:
    """Learns from each estimate how the vehicle answers, and carries motions forward through that answer."""

    def __init__(
        self,
        config: ControlConfig,
        vehicle: VehicleConfig,
        lags_s: Vector3,
        autopilot_kind: AutopilotKind = "px4",
        *,
        measures_thrust: bool = False,
    ) -> None:
        """`lags_s` are `flight_model.lags`; with `measures_thrust` the vehicle's hover thrust is hearsay."""
        self.by_attitude, self._by_velocity = config.setpoint == "attitude", config.setpoint == "velocity"
        self._lags_s, self._answers_s = lags_s, config.command_delay_s + lags_s[0]
        self._gains = {
            heard: velocity_gains(vehicle, config, autopilot_kind, sideways=heard) for heard in (True, False)
        }
        self.gains_1_s = self._gains[self._by_velocity]  # of the autopilot's loops, by our own setpoints
        self.raises_thrust = PROFILES[autopilot_kind].raises_thrust_by_tilt
        self._history = CommandHistory(config.command_delay_s)
        sensor_lag_s, most = config.acceleration_estimate_lag_s, config.maximum_disturbance_m_s2
        sideways = LASTING_SHARE * loop_rad_s(config.horizontal)
        down = LASTING_DOWN_SHARE[flown_kind(config)] * loop_rad_s(config.vertical)
        bandwidths = (sideways, sideways, 0.0 if self.by_attitude else down)
        self.lasting = SlowDisturbanceObserver(lags_s, sensor_lag_s, most, bandwidths)
        self._wind = WindObserver(sensor_lag_s, most)
        self.hover = HoverThrust(vehicle.hover_thrust, down, TOLD_STD if measures_thrust else 0.0)
        self._held = HeldThrust(lags_s[2], sensor_lag_s)
        self._history.full_thrust_m_s2 = GRAVITY_M_S2 / self.hover.value
        self._observed_s, self._weighed_s = 0.0, -math.inf
        self._feet_near = False

    @property
    def disturbance_ned_m_s2(self) -> Vector3:
        """What disturbs it besides the command (m/s2, NED)."""
        return add(self._wind.wind_ned_m_s2, self.lasting.lasting_ned_m_s2)

    @property
    def mean_disturbance_ned_m_s2(self) -> Vector3:
        """Its mean of late (m/s2, NED): all that is left to expect once nothing is measured any more.

        An IMU that hung in the middle of a vibration has hardly touched it.
        """
        return add(self._wind.mean_wind_ned_m_s2, self.lasting.lasting_ned_m_s2)

    @property
    def disturbance_ahead_ned_m_s2(self) -> Vector3:
        """The same (m/s2, NED) when what is commanded now is flown."""
        wind = self._wind.ahead_ned_m_s2(self._answers_s)
        return add(wind, self.lasting.lasting_ned_m_s2)

    @property
    def acceleration_ned_m_s2(self) -> Vector3:
        """Flown acceleration (m/s2, NED): sideways what tilt and wind make, as measured."""
        x, y, _ = subtract(
            add(self._wind.thrust_ned_m_s2, self._wind.wind_ned_m_s2), self.lasting.bias_ned_m_s2
        )
        down = add(self.lasting.made_ned_m_s2, self.lasting.lasting_ned_m_s2)[2]
        return (x, y, down)

    def begin(self, vehicle: VehicleState) -> None:
        """Start again, nothing commanded: the tilt it has is against the wind, or into a turn.

        With velocity setpoints the autopilot's own integral goes on to meet that wind.
        """
        self.hover.unexplained_m_s = 0.0
        self._wind.reset()
        self._wind.step(vehicle, 0.0)
        met = scale(self._wind.wind_ned_m_s2, -1.0) if self._by_velocity else ZERO3
        self.lasting.start(vehicle.velocity_ned_m_s, subtract(self._wind.thrust_ned_m_s2, met), met)
        self._observed_s = vehicle.time_s
        self._history.commands.clear()

    def observe(
        self,
        vehicle: VehicleState,
        elapsed_s: float,
        *,
        learns: bool = True,
        feet_near: bool = False,
        may_stand: bool = False,
        sinks: bool = True,
    ) -> None:
        """Compare what the vehicle does with what was commanded; the last call was `elapsed_s` ago.

        Without `learns` what was commanded may explain nothing: only the wind, which no command explains, is
        learnt. What holds up a vehicle that `may_stand` may be what it stands on, and is not learnt. What was
        learnt with `feet_near` anything goes with the first command that does not sink: it is gone as soon as
        the vehicle rises, which would first take back the thrust that was given up for it.
        """
        for duration_s, command in self._history.segments(self._observed_s, vehicle.time_s):
            self.lasting.predict(self._wanted(command, vehicle), duration_s)
        self._observed_s = max(self._observed_s, vehicle.time_s)
        near, self._feet_near = self._feet_near, feet_near
        if near and not (feet_near and sinks):
            self.lasting.leave_surface()
            self._weigh(self.hover.leave_surface())
        acceleration = vehicle.acceleration_ned_m_s2
        self._wind.step(vehicle, elapsed_s)
        if not learns:
            self.lasting.keep(vehicle.velocity_ned_m_s)
            return
        self.lasting.correct(
            vehicle.velocity_ned_m_s,
            acceleration,
            self._wind.late_thrust_ned_m_s2,
            elapsed_s,
            feet_near=feet_near,
            may_stand=may_stand,
        )
        if self.by_attitude:
            made_m_s2 = self.lasting.delayed_response_down_m_s2
            self._weigh(
                self.hover.correct(
                    acceleration[2],
                    made_m_s2,
                    elapsed_s,
                    follows_gusts=True,
                    feet_near=feet_near,
                    may_stand=may_stand,
                )
            )
            self._weighed_s = vehicle.time_s

    def hold(self, vehicle: VehicleState, thrust: float | None, elapsed_s: float) -> None:
        """Learn from the thrust that somebody else holds the vehicle in the air with; None: not known."""
        ours = vehicle.time_s - self._weighed_s < LONGEST_STEP_S
        acting = self._held.step(None if ours else thrust, elapsed_s)
        if acting is not None:
            down = 1.0 if self.raises_thrust else math.cos(tilt_from_quat(vehicle.attitude))
            made_m_s2 = GRAVITY_M_S2 * (1.0 - acting * down / self.hover.value)
            self._weigh(self.hover.correct(vehicle.acceleration_ned_m_s2[2], made_m_s2, elapsed_s))

    def _weigh(self, changed: float) -> None:
        """Thrust is worth so much more than it was believed to be, and what it made with it."""
        self.lasting.scale_thrust(changed)
        self._history.full_thrust_m_s2 = GRAVITY_M_S2 / self.hover.value

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
            gains = self._gains[setpoint.holds_horizontal_velocity]
            acceleration, velocity = setpoint.acceleration_ned_m_s2, setpoint.velocity_ned_m_s
            command = SentCommand(setpoint.time_s, acceleration, velocity, gains)
        else:
            thrust = quat_rotate(setpoint.attitude, (0.0, 0.0, -setpoint.thrust))
            command = SentCommand(setpoint.time_s, ZERO3, thrust=thrust)
        self._history.commands.append(command)

    def _wanted(self, command: SentCommand | None, vehicle: VehicleState) -> Vector3:
        """What the autopilot wants in a piece of time; before the first command, what it makes already."""
        if command is None:
            return self.lasting.made_ned_m_s2
        return self._history.effect(command, vehicle.velocity_ned_m_s)
