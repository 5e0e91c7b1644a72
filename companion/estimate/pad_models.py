"""How pads may move: the models that the pad filter's two banks hold.

Horizontal, state (p_n, p_e, v_n, v_e, a_n, a_e): position and velocity relative to the vehicle, and the pad's
own acceleration. Seen as a complex number in the plane it obeys a' = (-1/tau + i omega) a + white jerk:

    steady     small and short-lived: constant velocity
    manoeuvre  large, fading in a second or two: constant acceleration
    turn       lasting, and turning with the course: coordinated turn

That a turn is written as jerk = omega x a, rather than as a = omega x v, keeps it free of the pad's absolute
velocity, hence of GPS: only the turn rate, a scalar, has to be known.

Vertical, state (p, v, a, j):

    still      small and short-lived
    waves      a'' = -w0^2 a - 2 zeta w0 a' + white noise, for each period of a sea

Both are sums of exponentials exp(s t) with complex s, so transitions are exact for any step, and process
noise is the quadrature of exact responses. NED, SI units.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.config import PadFilterConfig
from companion.estimate.model_bank import Step
from companion.geometry import FloatArray

ComplexArray = NDArray[np.complex128]

HORIZONTAL: Final = ("steady", "manoeuvre", "turn")
# Gauss-Legendre on 0..1: exact for polynomials of degree 11, which covers a third integral of white noise
_NODES, _WEIGHTS = (0.5 * values for values in np.polynomial.legendre.leggauss(6))
_NODES = _NODES + 0.5
_EYE2: Final = np.eye(2)


def vertical_names(config: PadFilterConfig) -> tuple[str, ...]:
    """The vertical models, in their order."""
    return ("still", *(f"waves_{period_s:g}s" for period_s in config.wave_periods_s))


class HorizontalModels:
    """Steady, manoeuvre and turn, for a given turn rate."""

    def __init__(self, config: PadFilterConfig) -> None:
        fades_s = np.array(
            [config.steady_time_constant_s, config.manoeuvre_time_constant_s, config.turn_time_constant_s]
        )
        self._poles = -1.0 / fades_s + 0j
        steady = 2.0 * config.steady_acceleration_std_m_s2**2 / config.steady_time_constant_s
        self._jerk = np.array([steady, config.manoeuvre_jerk_m_s3_rthz**2, config.turn_jerk_m_s3_rthz**2])
        self._vehicle = config.vehicle_acceleration_noise_m_s2_rthz**2
        self.acceleration_variance = 0.5 * self._jerk * fades_s

    def step(self, dt_s: float, turn_rate_rad_s: float, turn_variance: float, acceleration_m_s2: float) -> Step:
        """F and Q (3, 6, 6) over dt_s; the caller fills in how the vehicle moved.

        The turn rate's variance ((rad/s)²) acts on an acceleration of the given size as jerk: an error that
        lasts is as harmful as a white one of that density after a second.
        """
        poles, jerk = self._poles.copy(), self._jerk.copy()
        poles[2] += 1j * turn_rate_rad_s
        jerk[2] += turn_variance * acceleration_m_s2**2
        F = np.zeros((3, 3, 2, 3, 2))
        F[:, 0, :, 0, :] = F[:, 1, :, 1, :] = _EYE2
        F[:, 0, :, 1, :] = dt_s * _EYE2
        F[:, :, :, 2, :] = _plane(_responses(poles, dt_s))
        times = _NODES * dt_s
        g = _responses(poles[:, None], times).transpose(0, 2, 1)  # (3 models, 3 states, nodes)
        weighted = g * (_WEIGHTS * dt_s)
        products = jerk[:, None, None] * (weighted @ g.conj().transpose(0, 2, 1))
        products = products + self._vehicle * _velocity_walk(dt_s, 3)
        Q = _plane(products).transpose(0, 1, 3, 2, 4)
        return Step(F.reshape(3, 6, 6), Q.reshape(3, 6, 6), np.zeros(6))


class VerticalModels:
    """Still, and waves of each period."""

    def __init__(self, config: PadFilterConfig) -> None:
        self.count = 1 + len(config.wave_periods_s)
        self._still_pole = -1.0 / config.steady_time_constant_s
        self._still_jerk = 2.0 * config.rest_acceleration_std_m_s2**2 / config.steady_time_constant_s
        w0 = math.tau / np.array(config.wave_periods_s)
        zeta = config.wave_damping
        self._poles = w0 * complex(-zeta, math.sqrt(1.0 - zeta * zeta))
        variance = config.wave_acceleration_std_m_s2**2
        self._noise = 4.0 * zeta * w0**3 * variance
        self._vehicle = config.vehicle_acceleration_noise_m_s2_rthz**2
        self.acceleration_variance = np.array([config.rest_acceleration_std_m_s2**2, *[variance] * len(w0)])
        self.jerk_variance = np.array([variance * w0.mean() ** 2, *(variance * w0**2)])

    def step(self, dt_s: float) -> Step:
        """F and Q (m, 4, 4) over dt_s; the caller fills in how the vehicle moved."""
        m = self.count
        F = np.zeros((m, 4, 4))
        F[:, 0, 0] = F[:, 1, 1] = 1.0
        F[:, 0, 1] = dt_s
        Q = np.zeros((m, 4, 4))
        Q[:, :2, :2] = self._vehicle * _velocity_walk(dt_s, 3)[:2, :2]
        self._still(dt_s, F[0], Q[0])
        self._waves(dt_s, F[1:], Q[1:])
        return Step(F, Q, np.zeros(4))

    def _still(self, dt_s: float, F: FloatArray, Q: FloatArray) -> None:
        """The acceleration fades; its rate plays no part, and waits as waves would have it."""
        pole = np.array(self._still_pole + 0j)
        F[:3, 2] = _responses(pole, dt_s).real
        g = _responses(pole, _NODES * dt_s).real
        Q[:3, :3] += self._still_jerk * (g.T * (_WEIGHTS * dt_s)) @ g
        Q[3, 3] = self.jerk_variance[0]

    def _waves(self, dt_s: float, F: FloatArray, Q: FloatArray) -> None:
        """a(t) = Re(C exp(s t)) with C = a + i (Re(s) a - j) / Im(s)."""
        real, imaginary = self._poles.real, self._poles.imag
        f = _responses(self._poles, dt_s)  # (waves, 3)
        f = np.concatenate((f, (self._poles * f[:, 2].T)[:, None]), axis=1)
        F[:, :, 2] = f.real - f.imag * (real / imaginary)[:, None]
        F[:, :, 3] = f.imag / imaginary[:, None]
        g = _responses(self._poles[:, None], _NODES * dt_s)  # (waves, nodes, 3)
        g = np.concatenate((g, self._poles[:, None, None] * g[:, :, 2:]), axis=2)
        kick = g.imag / imaginary[:, None, None]
        weighted = kick.transpose(0, 2, 1) * (_WEIGHTS * dt_s) * self._noise[:, None, None]
        Q += weighted @ kick


def _responses(pole: ComplexArray, t: float | FloatArray) -> ComplexArray:
    """What an acceleration exp(s t) has made of position, velocity and itself at t: stacked last."""
    grown = np.exp(pole * t)
    speed = (grown - 1.0) / pole
    responses = np.empty((*grown.shape, 3), dtype=complex)
    responses[..., 0], responses[..., 1], responses[..., 2] = (speed - t) / pole, speed, grown
    return responses


def _plane(values: ComplexArray) -> FloatArray:
    """Complex factors as rotations and stretches of the plane: two axes more."""
    plane = np.empty((*values.shape, 2, 2))
    plane[..., 0, 0] = plane[..., 1, 1] = values.real
    plane[..., 1, 0] = values.imag
    plane[..., 0, 1] = -values.imag
    return plane


def _velocity_walk(dt: float, size: int) -> FloatArray:
    """White noise of the measured acceleration: position, velocity, of (size, size)."""
    walk = np.zeros((size, size))
    walk[0, 0], walk[1, 1] = dt**3 / 3, dt
    walk[0, 1] = walk[1, 0] = dt * dt / 2
    return walk
