"""The response of a multirotor under an autopilot to an acceleration command (eq. 38 with w = d).

Per axis p' = v, v' = a, a' = (u + d - a) / tau. u is the commanded acceleration, d a disturbance (wind, a
wrong thrust scale) as the acceleration that it adds, tau the lag of attitude and motors (sideways) or of
the motors only (down). Frames: any that does not turn or accelerate, NED axes; SI units. Discretised
exactly under a zero-order hold.
"""

import math
from typing import Final

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import FloatArray, Vector3
from companion.base.motion import Motion
from companion.config import AxisResponse, ControlConfig, Kind, VehicleConfig

AxisState = tuple[float, float, float]
SHORTEST_LAG_S: Final = 0.01  # a third of a cycle at 30 Hz: shorter is none


def advance_axis(state: AxisState, input_m_s2: float, duration_s: float, tau_s: float) -> AxisState:
    """(p, v, a) of one axis after `duration_s` under a constant u + d."""
    p, v, a = state
    t = duration_s
    transient = a - input_m_s2
    lag = tau_s * -math.expm1(-t / tau_s)
    return (
        p + v * t + 0.5 * input_m_s2 * t * t + transient * tau_s * (t - lag),
        v + input_m_s2 * t + transient * lag,
        input_m_s2 + transient * math.exp(-t / tau_s),
    )


def advance(motion: Motion, input_m_s2: Vector3, duration_s: float, lags_s: Vector3) -> Motion:
    """All three axes after `duration_s` under a constant u + d; each has its own lag."""
    p, v, a = motion.position_m, motion.velocity_m_s, motion.acceleration_m_s2
    x = advance_axis((p[0], v[0], a[0]), input_m_s2[0], duration_s, lags_s[0])
    y = advance_axis((p[1], v[1], a[1]), input_m_s2[1], duration_s, lags_s[1])
    z = advance_axis((p[2], v[2], a[2]), input_m_s2[2], duration_s, lags_s[2])
    return Motion((x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2]))


def lags(vehicle: VehicleConfig, control: ControlConfig, autopilot_kind: AutopilotKind = "px4") -> Vector3:
    """Lag (s) along north, east and down, besides `command_delay_s`: together as late as the response.

    Sideways the vehicle has to tilt first, upwards only thrust lags; velocity setpoints the autopilot shapes.
    """
    by_velocity = control.setpoint == "velocity"
    response = vehicle.responses.of(autopilot_kind, flown_kind(control))
    sideways = control.autopilot_lag_s if by_velocity else vehicle.acceleration_time_constant_s
    down = control.autopilot_climb_lag_s if by_velocity else vehicle.thrust_time_constant_s
    x = _lag(sideways, response.sideways, control)
    return (x, x, _lag(down, response.down, control))


def _lag(measured_s: float | None, response: AxisResponse, control: ControlConfig) -> float:
    if measured_s is not None:
        return measured_s
    return max(SHORTEST_LAG_S, response.delay_s - control.command_delay_s)


def velocity_gains(
    vehicle: VehicleConfig,
    control: ControlConfig,
    autopilot_kind: AutopilotKind = "px4",
    *,
    sideways: bool = True,
) -> Vector3:
    """Gains (1/s) of the autopilot's own velocity loops, north, east and down.

    `sideways`: it is sent a horizontal velocity. By attitude setpoints it has no such loops.
    """
    if control.setpoint == "attitude":
        return (0.0, 0.0, 0.0)
    responses = vehicle.responses
    x, z = control.autopilot_velocity_gain_1_s, control.autopilot_climb_gain_1_s
    x = responses.of(autopilot_kind, "velocity").sideways.velocity_gain_1_s if x is None else x
    z = responses.of(autopilot_kind, flown_kind(control)).down.velocity_gain_1_s if z is None else z
    return (x, x, z) if sideways else (0.0, 0.0, z)


def flown_kind(control: ControlConfig) -> Kind:
    """The kind of setpoint whose response counts; before it is known whose autopilot obeys, by velocity."""
    return "velocity" if control.setpoint == "auto" else control.setpoint


def discretise(step_s: float, tau_s: float) -> tuple[FloatArray, FloatArray]:
    """A (3, 3) and B (3,) of one axis over one step: its columns are the answers to unit states and input."""
    units = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    columns = [advance_axis(unit, 0.0, step_s, tau_s) for unit in units]
    return np.array(columns).T, np.array(advance_axis((0.0, 0.0, 0.0), 1.0, step_s, tau_s))
