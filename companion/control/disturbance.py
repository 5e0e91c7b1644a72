"""What pushes the vehicle besides the command: an observer per axis, for tracking without a lasting offset.

State per axis: velocity v, flown acceleration a, disturbance d, the measured acceleration's bias b, and s,
the late measurement of a. They move by
    v' = a,  a' = (u + d - a)/tau,  s' = (a - s)/tau_s,  d and b slow random walks;
measured are v and s + b (eq. 38 with w = d).

A stationary Kalman gain (eq. 17 at its limit). The bias is there because the measured
acceleration carries the attitude's error times g: without it that error would pass for a disturbance.

How fast the disturbance may walk is bounded by what the model leaves out: attitude and motors answer at
second and third order, which at 2 Hz looks like a push of the command's own size. An observer that follows it
makes the vehicle sway for ever.

NED axes, SI units.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg

from companion.control.flight_model import advance_axis
from companion.geometry import GRAVITY_M_S2, ZERO3, FloatArray, Quaternion, Vector3, add, level_acceleration

VELOCITY_NOISE_M_S = 0.03
ACCELERATION_NOISE_M_S2 = 0.4
# random walks per square root of a second: how fast gusts come, how fast the bias wanders, the model's own
DISTURBANCE_WALK = 0.3
# where we make the lean: sideways, where gusts are told from it, the rest changes with the mean wind; down,
# air blows through a rotor that leans into the wind, and thrust goes and comes with the lean
LEANING_DISTURBANCE_WALKS = (0.1, 0.1, 2.0)
BIAS_WALK = 0.03
MODEL_ACCELERATION_WALK = 0.3
MODEL_VELOCITY_WALK = 0.01
MAXIMUM_BIAS_M_S2 = 0.5
# a larger surprise is a jump of the estimate (a fix came in), not of the vehicle: it counts for this much
LARGEST_VELOCITY_INNOVATION_M_S = 0.3
LARGEST_ACCELERATION_INNOVATION_M_S2 = 3.0


def transition(period_s: float, tau_s: float, sensor_lag_s: float) -> FloatArray:
    """F (5, 5) of v, a, d, b and s over one period: its columns are where unit states go by themselves."""
    columns = []
    for unit in np.eye(5).tolist():
        axis = _Axis(*unit)
        axis.predict(0.0, period_s, tau_s, sensor_lag_s)
        columns.append([axis.velocity, axis.acceleration, axis.disturbance, axis.bias, axis.shown])
    return np.array(columns).T


def stationary_gain(
    period_s: float, tau_s: float, sensor_lag_s: float, disturbance_walk: float = DISTURBANCE_WALK
) -> FloatArray:
    """Kalman gain (5, 2) from the innovations of v and the measured acceleration to v, a, d, b, s."""
    F = transition(period_s, tau_s, sensor_lag_s)
    H = np.array([[1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, 1.0]])
    walks = np.array([MODEL_VELOCITY_WALK, MODEL_ACCELERATION_WALK, disturbance_walk, BIAS_WALK, 0.0])
    Q = np.diag(walks**2 * period_s)
    R = np.diag([VELOCITY_NOISE_M_S**2, ACCELERATION_NOISE_M_S2**2])
    P = scipy.linalg.solve_discrete_are(F.T, H.T, Q, R)
    gain: FloatArray = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return gain


class _Axis:
    """The observer of one axis."""

    def __init__(
        self,
        velocity: float = 0.0,
        acceleration: float = 0.0,
        disturbance: float = 0.0,
        bias: float = 0.0,
        shown: float = 0.0,
    ) -> None:
        self.velocity = velocity
        self.acceleration = acceleration
        self.disturbance = disturbance
        self.bias = bias
        self.shown = shown

    def predict(self, command_m_s2: float, duration_s: float, tau_s: float, sensor_lag_s: float) -> None:
        if duration_s <= 0.0:
            return
        before = self.velocity
        _, self.velocity, self.acceleration = advance_axis(
            (0.0, before, self.acceleration), command_m_s2 + self.disturbance, duration_s, tau_s
        )
        # the mean acceleration of so short a time stands for its course
        mean = (self.velocity - before) / duration_s
        self.shown += -math.expm1(-duration_s / sensor_lag_s) * (mean - self.shown)

    def correct(
        self, velocity: float, acceleration: float, gain: tuple[tuple[float, float], ...], bound: float
    ) -> None:
        jump = velocity - self.velocity
        dv = _clamp(jump, LARGEST_VELOCITY_INNOVATION_M_S)
        da = _clamp(acceleration - self.shown - self.bias, LARGEST_ACCELERATION_INNOVATION_M_S2)
        self.velocity += jump - dv  # what is beyond is taken over as it is
        self.velocity += gain[0][0] * dv + gain[0][1] * da
        self.acceleration += gain[1][0] * dv + gain[1][1] * da
        self.disturbance = _clamp(self.disturbance + gain[2][0] * dv + gain[2][1] * da, bound)
        self.shown += gain[4][0] * dv + gain[4][1] * da
        self.bias = _clamp(self.bias + gain[3][0] * dv + gain[3][1] * da, MAXIMUM_BIAS_M_S2)


class DisturbanceObserver:
    """Velocity, flown acceleration and disturbance of the vehicle, from what was commanded and measured."""

    def __init__(
        self,
        period_s: float,
        lags_s: Vector3,
        sensor_lag_s: float,
        maximum_m_s2: float,
        walks: Vector3 = (DISTURBANCE_WALK,) * 3,
    ) -> None:
        """`walks`: how fast the disturbance may walk along each axis, m/s2 per square root of a second."""
        self._gains = tuple(
            tuple((float(v), float(a)) for v, a in stationary_gain(period_s, lag_s, sensor_lag_s, walk))
            for lag_s, walk in zip(lags_s, walks, strict=True)
        )
        self._lags_s = lags_s
        self._sensor_lag_s = sensor_lag_s
        self._maximum_m_s2 = maximum_m_s2
        self._axes = (_Axis(), _Axis(), _Axis())

    @property
    def velocity_ned_m_s(self) -> Vector3:
        """Velocity (m/s, NED) as the observer has it."""
        x, y, z = self._axes
        return (x.velocity, y.velocity, z.velocity)

    @property
    def acceleration_ned_m_s2(self) -> Vector3:
        """Flown acceleration (m/s2, NED), freed of the measurement's bias."""
        x, y, z = self._axes
        return (x.acceleration, y.acceleration, z.acceleration)

    @property
    def disturbance_ned_m_s2(self) -> Vector3:
        """Disturbance (m/s2, NED), each axis within the bound."""
        x, y, z = self._axes
        return (x.disturbance, y.disturbance, z.disturbance)

    def start(
        self, velocity_ned_m_s: Vector3, acceleration_ned_m_s2: Vector3, disturbance_ned_m_s2: Vector3 = ZERO3
    ) -> None:
        """Begin anew from measurements and a first guess of the disturbance."""
        for axis, v, a, d in zip(
            self._axes, velocity_ned_m_s, acceleration_ned_m_s2, disturbance_ned_m_s2, strict=True
        ):
            axis.velocity, axis.acceleration, axis.bias, axis.shown = v, a, 0.0, a
            axis.disturbance = _clamp(d, self._maximum_m_s2)

    def predict(self, command_ned_m_s2: Vector3, duration_s: float) -> None:
        """Carry the state on under a constant command."""
        for axis, command, lag_s in zip(self._axes, command_ned_m_s2, self._lags_s, strict=True):
            axis.predict(command, duration_s, lag_s, self._sensor_lag_s)

    def correct(self, velocity_ned_m_s: Vector3, acceleration_ned_m_s2: Vector3) -> None:
        """Take in measured velocity and acceleration; a measurement that is not finite is passed over."""
        if not all(map(math.isfinite, (*velocity_ned_m_s, *acceleration_ned_m_s2))):
            return
        for axis, v, a, gain in zip(
            self._axes, velocity_ned_m_s, acceleration_ned_m_s2, self._gains, strict=True
        ):
            axis.correct(v, a, gain, self._maximum_m_s2)

    def relieve_vertical(self, covered_m_s2: float) -> None:
        """Take off the vertical disturbance what the thrust scale covers from now on."""
        self._axes[2].disturbance -= covered_m_s2


class GustObserver:
    """The quick part of the wind's push, from how the vehicle leans and how it accelerates.

    A multirotor's thrust lies along its up axis, so what it accelerates sideways beyond its lean is the
    wind's doing, and no lag of attitude or motors stands between. Errors of the attitude are slow and the
    mean wind too: they are left to `DisturbanceObserver`, which takes this part as known. NED, m/s2.
    """

    SMOOTHING_S = 0.06
    FORGETTING_S = 5.0

    def __init__(self, sensor_lag_s: float) -> None:
        """`sensor_lag_s` is how late the measured acceleration is: the lean is made as late."""
        self._lag_s = sensor_lag_s
        self.reset()

    def reset(self) -> None:
        """Begin anew, calm."""
        self._lean: tuple[float, float] | None = None
        self._quick = self._slow = (0.0, 0.0)

    @property
    def push_ned_m_s2(self) -> Vector3:
        """The part of the wind's push (m/s2, NED) that has not lasted; its third part is 0."""
        return (self._quick[0] - self._slow[0], self._quick[1] - self._slow[1], 0.0)

    def step(self, attitude: Quaternion, acceleration_ned_m_s2: Vector3, elapsed_s: float) -> Vector3:
        """Take in attitude and acceleration, the last were `elapsed_s` ago; returns `push_ned_m_s2`."""
        x, y, z = acceleration_ned_m_s2
        if not all(map(math.isfinite, (x, y, z, *attitude))):
            return self.push_ned_m_s2
        lean = level_acceleration(attitude)
        carried = 1.0 - z / GRAVITY_M_S2
        if self._lean is None:
            self._lean = lean
            self._quick = self._slow = (x - lean[0] * carried, y - lean[1] * carried)
        self._lean = _follow(self._lean, lean, elapsed_s / self._lag_s)
        wind = (x - self._lean[0] * carried, y - self._lean[1] * carried)
        self._quick = _follow(self._quick, wind, elapsed_s / self.SMOOTHING_S)
        self._slow = _follow(self._slow, self._quick, elapsed_s / self.FORGETTING_S)
        return self.push_ned_m_s2

    def added_to(self, disturbance_ned_m_s2: Vector3, maximum_m_s2: float) -> Vector3:
        """The whole disturbance (m/s2, NED), each axis within the bound."""
        x, y, z = add(disturbance_ned_m_s2, self.push_ned_m_s2)
        return (_clamp(x, maximum_m_s2), _clamp(y, maximum_m_s2), z)


class ThrustScale:
    """How much more thrust than configured the vehicle needs to hover; learnt from the vertical disturbance.

    A thrust that is off by a factor disturbs in proportion to the thrust itself, sideways too, which a
    constant disturbance does not describe; hence the lasting part of the vertical one moves over into the
    factor.
    """

    LEARNING_TIME_S = 2.0
    BOUNDS = (0.7, 1.4)

    def __init__(self) -> None:
        self.factor = 1.0

    def learn(self, disturbance_down_m_s2: float, elapsed_s: float) -> float:
        """Take in a part of the disturbance; the return (m/s2) is how much of it the factor now covers."""
        moved = disturbance_down_m_s2 * min(1.0, elapsed_s / self.LEARNING_TIME_S)
        low, high = self.BOUNDS
        factor = max(low, min(high, self.factor * (1.0 + moved / GRAVITY_M_S2)))
        covered = (factor / self.factor - 1.0) * GRAVITY_M_S2
        self.factor = factor
        return covered


def _follow(
    state: tuple[float, float], measured: tuple[float, float], exponent: float
) -> tuple[float, float]:
    share = -math.expm1(-exponent)
    return (state[0] + share * (measured[0] - state[0]), state[1] + share * (measured[1] - state[1]))


def _clamp(value: float, bound: float) -> float:
    return max(-bound, min(bound, value))
