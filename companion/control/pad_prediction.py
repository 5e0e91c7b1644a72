"""The pad's predicted motion over the horizon, a known input to the MPC.

A pad on a curve turns its velocity and acceleration at the rate omega = (v x a)_z / |v|^2. If the pad is
too slow for a well determined omega, or brakes rather than turns, it keeps its velocity and its
acceleration decays. Any other change of its acceleration, at the beginning or end of a curve, decays as
well, and the vertical acceleration always does. A pad that brakes comes to a halt and does not drive
backwards from there. NED axes, SI units; the origin is the pad's estimated position.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray, Vector3
from companion.base.messages import PadState
from companion.base.motion import COURSE_M_S

ComplexArray = NDArray[np.complex128]

DECAY_S: Final = 1.0  # a pad's measured acceleration is believed to fade so fast
MINIMUM_TURN_RATE_RAD_S = 0.02  # 2 deg over the horizon: straight on, and the turn's formula divides by it
MAXIMUM_TURN_RATE_RAD_S = 1.5  # more is noise: of 0.45 m/s2 at the least speed of a course
# Slower than this the course is noise: a pad that turns back, or starts to move, does not halt first.
MINIMUM_BRAKING_SPEED_M_S = 0.1


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
    if squared < COURSE_M_S**2:
        return None
    omega = (vx * ay - vy * ax) / squared
    return omega if MINIMUM_TURN_RATE_RAD_S < abs(omega) < MAXIMUM_TURN_RATE_RAD_S else None


def predict_pad(pad: PadState, times_s: FloatArray) -> PadPrediction:
    """The pad at `times_s` (n,) of the app's clock, counted from where it was estimated."""
    t = times_s - pad.time_s
    velocity, acceleration = pad.velocity_ned_m_s, pad.acceleration_ned_m_s2
    displacement, speed, change = _decaying(velocity, acceleration, t)
    v, a = complex(velocity[0], velocity[1]), complex(acceleration[0], acceleration[1])
    omega = turn_rate(velocity, acceleration)
    if omega is not None:
        plane = _turning(v, a, t, omega)
    elif abs(v) >= MINIMUM_BRAKING_SPEED_M_S and (a / v).real < 0.0:
        plane = _braking(v, a, t)
    else:
        plane = _complex(displacement), _complex(speed), _complex(change)
    # one that halts is not driven on by its jerk
    jerk = complex(pad.jerk_ned_m_s3[0], pad.jerk_ned_m_s3[1]) if plane[1].all() else 0j
    for columns, row, gain in zip((displacement, speed, change), plane, _jerk_gains(t), strict=True):
        moved = row + jerk * gain
        columns[:, 0], columns[:, 1] = moved.real, moved.imag
    return PadPrediction(displacement, speed, change)


def origin_at_rest(count: int) -> PadPrediction:
    """The same for an origin that does not move."""
    zero = np.zeros((count, 3))
    return PadPrediction(zero, zero, zero)


def _decaying(
    velocity: Vector3, acceleration: Vector3, t: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    v, a = np.array(velocity), np.array(acceleration)
    fade = np.exp(-t / DECAY_S)[:, None]
    column = t[:, None]
    gained = DECAY_S * (1.0 - fade)
    return v * column + a * DECAY_S * (column - gained), v + a * gained, a * fade


def _complex(columns: FloatArray) -> ComplexArray:
    return np.asarray(columns[:, 0] + 1j * columns[:, 1])


def _jerk_gains(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement, velocity and acceleration (n,) that a jerk of 1 has made which dies away."""
    change = DECAY_S * -np.expm1(-t / DECAY_S)
    speed = DECAY_S * (t - change)
    return DECAY_S * (0.5 * t * t - speed), speed, change


def _turning(
    velocity: complex, acceleration: complex, t: FloatArray, omega: float
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Displacement, velocity and acceleration (n,) in a turn; complex numbers are the horizontal plane.

    The course turns at the rate omega, and with it what is left of the acceleration along it: it dies away.
    """
    along = acceleration - 1j * omega * velocity
    halt_s = _halt_s((along / velocity).real)
    t, moving = np.minimum(t, halt_s), t < halt_s
    turned, fade = np.exp(1j * omega * t), np.exp(-t / DECAY_S)
    pole = 1j * omega - 1.0 / DECAY_S
    speed = (velocity + along * DECAY_S * (1.0 - fade)) * turned
    displacement = (velocity + along * DECAY_S) * (turned - 1.0) / (1j * omega)
    displacement -= along * DECAY_S * (turned * fade - 1.0) / pole
    return displacement, speed * moving, (1j * omega * speed + along * turned * fade) * moving


def _braking(
    velocity: complex, acceleration: complex, t: FloatArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """The same on a straight course: what acts along it ends at the halt, what acts across it dies away."""
    course = velocity / abs(velocity)
    along, across = (acceleration / course).real, (acceleration / course).imag
    halt_s = _halt_s(along / abs(velocity))
    fade, held = np.exp(-t / DECAY_S), np.minimum(t, halt_s)
    held_fade, moving = np.exp(-held / DECAY_S), t < halt_s
    displacement = abs(velocity) * held + along * DECAY_S * (held - DECAY_S * (1.0 - held_fade))
    speed = (abs(velocity) + along * DECAY_S * (1.0 - held_fade)) * moving
    change = along * held_fade * moving
    aside = across * DECAY_S * (t - DECAY_S * (1.0 - fade))
    aside_speed, aside_change = across * DECAY_S * (1.0 - fade), across * fade
    return (
        (displacement + 1j * aside) * course,
        (speed + 1j * aside_speed) * course,
        (change + 1j * aside_change) * course,
    )


def _halt_s(braking_1_s: float) -> float:
    """When a speed halts whose relative rate of change is `braking_1_s` at first and dies away; inf: never.

    v (1 + k tau (1 - exp(-t / tau))) = 0 with k the rate and tau the decay.
    """
    spent = 1.0 + 1.0 / (braking_1_s * DECAY_S) if braking_1_s < 0.0 else -1.0
    return -DECAY_S * math.log(spent) if spent > 0.0 else math.inf
