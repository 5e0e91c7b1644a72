"""Where the pad will be: its estimated motion carried over the horizon, as a known input to the MPC.

A pad on a curve turns its velocity and acceleration at the rate omega = (v x a)_z / |v|^2; one that is too
slow, or brakes rather than turns, for that to be well determined keeps its velocity while its acceleration
dies away. The vertical acceleration always dies away. NED axes, SI units; the origin is where the pad was
estimated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray, Vector3
from companion.base.messages import PadState

ComplexArray = NDArray[np.complex128]

MINIMUM_TURNING_SPEED_M_S = 0.4
MINIMUM_TURN_RATE_RAD_S = 0.02
MAXIMUM_TURN_RATE_RAD_S = 1.5


@dataclass(frozen=True, slots=True)
class PadPrediction:
    """The pad at n times, NED: displacement since the estimate, velocity, acceleration, each (n, 3)."""

    displacement_m: FloatArray
    velocity_m_s: FloatArray
    acceleration_m_s2: FloatArray


def turn_rate(velocity_m_s: Vector3, acceleration_m_s2: Vector3) -> float | None:
    """Rate (rad/s, clockwise positive) at which the course turns; None when it is not well determined."""
    vx, vy, _ = velocity_m_s
    ax, ay, _ = acceleration_m_s2
    squared = vx * vx + vy * vy
    if squared < MINIMUM_TURNING_SPEED_M_S**2:
        return None
    omega = (vx * ay - vy * ax) / squared
    return omega if MINIMUM_TURN_RATE_RAD_S < abs(omega) < MAXIMUM_TURN_RATE_RAD_S else None


def predict_pad(pad: PadState, times_s: FloatArray, decay_s: float) -> PadPrediction:
    """The pad at `times_s` (n,) of the app's clock, counted from where it was estimated."""
    t = times_s - pad.time_s
    velocity, acceleration = pad.velocity_ned_m_s, pad.acceleration_ned_m_s2
    displacement, speed, change = _decaying(velocity, acceleration, t, decay_s)
    omega = turn_rate(velocity, acceleration)
    if omega is not None:
        v, a = complex(velocity[0], velocity[1]), complex(acceleration[0], acceleration[1])
        for columns, plane in zip(
            (displacement, speed, change), _turning(v, a, t, omega, decay_s), strict=True
        ):
            columns[:, 0], columns[:, 1] = plane.real, plane.imag
    return PadPrediction(displacement, speed, change)


def origin_at_rest(count: int) -> PadPrediction:
    """The same for an origin that does not move."""
    zero = np.zeros((count, 3))
    return PadPrediction(zero, zero, zero)


def _decaying(
    velocity: Vector3, acceleration: Vector3, t: FloatArray, decay_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    v, a = np.array(velocity), np.array(acceleration)
    fade = np.exp(-t / decay_s)[:, None]
    column = t[:, None]
    gained = decay_s * (1.0 - fade)
    return v * column + a * decay_s * (column - gained), v + a * gained, a * fade


def _turning(
    velocity: complex, acceleration: complex, t: FloatArray, omega: float, decay_s: float
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Displacement, velocity and acceleration (n,) in a turn; complex numbers are the horizontal plane.

    The course turns at the rate omega, and with it what is left of the acceleration along it: it dies away.
    """
    along = acceleration - 1j * omega * velocity
    turned, fade = np.exp(1j * omega * t), np.exp(-t / decay_s)
    pole = 1j * omega - 1.0 / decay_s
    speed = (velocity + along * decay_s * (1.0 - fade)) * turned
    displacement = (velocity + along * decay_s) * (turned - 1.0) / (1j * omega)
    displacement -= along * decay_s * (turned * fade - 1.0) / pole
    return displacement, speed, 1j * omega * speed + along * turned * fade
