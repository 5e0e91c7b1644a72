"""Identifies the numbers of the flight model from a flight of a vehicle under its autopilot.

The model is `flight_model`'s, with the autopilot's velocity loop closed around it: per axis

    v' = a,  a' = (u + K (v_sp - v) + d - a) / tau

with u and v_sp the setpoint's acceleration and velocity that were sent `delay_s` before, d the disturbance.
For attitude setpoints K = 0, and u is the acceleration of attitude and thrust.

The flight is divided into windows of 1 s. (In longer ones d does not stay constant, and since setpoints
respond to the disturbance, the lag would be overestimated.) The initial v and a of each window and its d
are free and enter linearly, so they are projected out. K and tau minimise the squares of the remaining
velocity. North and east share theirs. Standard deviations allow for correlated residuals within a window.
NED, SI units.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.linalg
import scipy.optimize

from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.control.response.flight_model import SHORTEST_LAG_S

WINDOW_S: Final = 1.0  # see above
FEWEST_WINDOWS: Final = 10  # their scatter, which is the deviation, is known to a quarter by then
# numbers less certain than these shares of themselves are none
MOST_UNCERTAIN: Final = 0.25
HOVER_UNCERTAIN: Final = 0.02  # see above
GAIN_BOUNDS: Final = (0.2, 12.0)  # 1/s: of autopilots by default 1.7 to 4 (`config.vehicle`)
LAG_BOUNDS_S: Final = (SHORTEST_LAG_S, 1.5)  # s; judged
# what is nearer to the assumed number than so many standard deviations is no reason to change that
SIGNIFICANT: Final = 2.0
FREE: Final = 3  # v, a and d of each window


class TooLittleError(ValueError):
    """The flight does not show: it is too short, or nothing in it moves enough."""


@dataclass(frozen=True)
class ResponseRecord:
    """What was commanded and flown: rows at evenly spaced times, in pieces without a gap.

    `time_s` (n,), `velocity_ned_m_s` (n, 3), `force_m_s2` (n,) the specific force's size, commands
    `command_velocity_ned_m_s` and `command_acceleration_ned_m_s2` (n, 3), `thrust` (n,) or None; `pieces` are
    the rows [first, last) in which the autopilot obeyed, in the air.
    """

    time_s: FloatArray
    velocity_ned_m_s: FloatArray
    force_m_s2: FloatArray
    command_velocity_ned_m_s: FloatArray
    command_acceleration_ned_m_s2: FloatArray
    thrust: FloatArray | None
    pieces: tuple[tuple[int, int], ...]

    @property
    def period_s(self) -> float:
        """Time between rows."""
        return float(self.time_s[1] - self.time_s[0])


@dataclass(frozen=True, slots=True)
class IdentifiedResponse:
    """Gain K (1/s; 0 by attitude) and lag tau (s) along one direction."""

    gain_1_s: float
    lag_s: float


def adopted(found: float, std: float, assumed: float) -> float:
    """The number found, or the assumed one when the two do not contradict each other."""
    return found if abs(found - assumed) > SIGNIFICANT * std else assumed


@dataclass(frozen=True, slots=True)
class ResponseEstimate:
    """A response as found, its standard deviations, and how many windows speak for it.

    A gain with an infinite deviation is the one that was assumed.
    """

    response: IdentifiedResponse
    gain_std_1_s: float
    lag_std_s: float
    windows: int

    def adopted(self, assumed: IdentifiedResponse) -> IdentifiedResponse:
        """What of it there is reason to fly with; the rest as assumed."""
        best = self.response
        return IdentifiedResponse(
            adopted(best.gain_1_s, self.gain_std_1_s, assumed.gain_1_s),
            adopted(best.lag_s, self.lag_std_s, assumed.lag_s),
        )


@dataclass(frozen=True)
class Windows:
    """One direction's velocity (steps, n) and commands (steps, n) of n windows."""

    velocity_m_s: FloatArray
    command_velocity_m_s: FloatArray
    command_acceleration_m_s2: FloatArray
    period_s: float


def windows(flown: ResponseRecord, axes: tuple[int, ...], delay_s: float) -> Windows:
    """Windows of all these axes (0 north, 1 east, 2 down), with commands as they take effect.

    Raises:
        TooLittleError: there are too few.
    """
    steps = round(WINDOW_S / flown.period_s)
    starts = [k for first, last in flown.pieces for k in range(first, last - steps, steps // 2)]
    if len(starts) < FEWEST_WINDOWS:
        raise TooLittleError(
            f"{len(starts)} windows of {WINDOW_S:g} s of flight by setpoints, expected {FEWEST_WINDOWS}"
        )
    rows = np.array(starts)[None, :] + np.arange(steps)[:, None]

    def cut(column: FloatArray, delay_s: float) -> FloatArray:
        return np.interp(flown.time_s - delay_s, flown.time_s, column)[rows]

    commands = (flown.command_velocity_ned_m_s, flown.command_acceleration_ned_m_s2)
    parts = [
        [cut(source[:, axis], late_s) for axis in axes]
        for source, late_s in ((flown.velocity_ned_m_s, 0.0), *((command, delay_s) for command in commands))
    ]
    velocity, command_velocity, command_acceleration = (np.hstack(part) for part in parts)
    return Windows(velocity, command_velocity, command_acceleration, flown.period_s)


def _answers(cut: Windows, response: IdentifiedResponse) -> tuple[FloatArray, FloatArray]:
    """Velocity under the commands from rest (steps, n), and under unit v, a and d (steps, 3)."""
    K, tau = response.gain_1_s, response.lag_s
    F = np.array([[0.0, 1.0], [-K / tau, -1.0 / tau]])
    augmented = np.zeros((3, 3))
    augmented[:2, :2], augmented[1, 2] = F, 1.0 / tau
    moved = scipy.linalg.expm(augmented * cut.period_s)
    A, B = moved[:2, :2], moved[:2, 2]
    wanted = cut.command_acceleration_m_s2 + K * cut.command_velocity_m_s
    steps, count = wanted.shape
    # the free answers go along as three more windows: v, a and a constant disturbance
    push = np.hstack([wanted, np.tile([0.0, 0.0, 1.0], (steps, 1))])
    state = np.zeros((2, count + FREE))
    state[0, count], state[1, count + 1] = 1.0, 1.0
    velocity = np.empty((steps, count + FREE))
    for k in range(steps):
        velocity[k] = state[0]
        state = A @ state + B[:, None] * push[k]
    return velocity[:, :count], velocity[:, count:]


def residuals(cut: Windows, response: IdentifiedResponse) -> FloatArray:
    """What of the velocity (steps, n) neither the commands nor any v, a and d explain."""
    forced, free = _answers(cut, response)
    left = cut.velocity_m_s - forced
    basis = np.linalg.qr(free)[0]
    unexplained: FloatArray = left - basis @ (basis.T @ left)
    return unexplained


def prediction_error_m_s(cut: Windows, response: IdentifiedResponse) -> float:
    """Root mean square error (m/s) of a window's second half, predicted by what its first half gave."""
    forced, free = _answers(cut, response)
    half = len(forced) // 2
    left = cut.velocity_m_s - forced
    begun = np.linalg.lstsq(free[:half], left[:half], rcond=None)[0]
    return float(np.sqrt(np.mean((left[half:] - free[half:] @ begun) ** 2)))


def fit(cut: Windows, start: IdentifiedResponse) -> ResponseEstimate:
    """Gain and lag by least squares from a start; a gain of 0 stays.

    A setpoint that carries the predicted velocity asks little of the autopilot's gain: where the flight
    leaves that open, it stays as guessed (its deviation is then infinite), and the lag is what fits to it.

    Raises:
        TooLittleError: the windows leave the lag open.
    """
    if start.gain_1_s > 0.0:
        found, shares = _search(cut, start, gain_is_free=True)
        if (shares <= MOST_UNCERTAIN).all():
            stds = (found.gain_1_s * float(shares[0]), found.lag_s * float(shares[1]))
            return ResponseEstimate(found, *stds, cut.velocity_m_s.shape[1])
    found, shares = _search(cut, start, gain_is_free=False)
    if not shares[0] <= MOST_UNCERTAIN:
        how_well = f"within {100.0 * shares[0]:.0f} %" if shares[0] < 1.0 else "not at all"
        most = f"{100.0 * MOST_UNCERTAIN:.0f} % or better"
        raise TooLittleError(f"too little excitation: lag known {how_well}, expected {most}")
    return ResponseEstimate(found, math.inf, found.lag_s * float(shares[0]), cut.velocity_m_s.shape[1])


def _search(
    cut: Windows, start: IdentifiedResponse, *, gain_is_free: bool
) -> tuple[IdentifiedResponse, FloatArray]:
    """The best response, and the relative standard deviations of what was free; infinite at a bound."""

    def response(logs: FloatArray) -> IdentifiedResponse:
        gain = float(np.exp(logs[0])) if gain_is_free else start.gain_1_s
        return IdentifiedResponse(gain, float(np.exp(logs[-1])))

    first = np.log([start.gain_1_s, start.lag_s] if gain_is_free else [start.lag_s])
    bounds = np.log([GAIN_BOUNDS, LAG_BOUNDS_S] if gain_is_free else [LAG_BOUNDS_S]).T
    found = scipy.optimize.least_squares(
        lambda logs: residuals(cut, response(logs)).ravel(), np.clip(first, *bounds), bounds=bounds
    )
    shares = _uncertainty(found.jac, found.fun, cut.velocity_m_s.shape)
    if np.any(np.abs(found.x - bounds) < 1e-3):
        shares = np.full_like(shares, np.inf)
    return response(found.x), shares


def _uncertainty(jacobian: FloatArray, left: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Relative standard deviations of the numbers, by how their windows disagree."""
    steps, count = shape
    per_window = (jacobian * left[:, None]).reshape(steps, count, -1).sum(axis=0)
    # windows overlap by half: each counts by half
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    covariance = 2.0 * bread @ (per_window.T @ per_window) @ bread
    shares: FloatArray = np.sqrt(np.diag(covariance))
    return np.where(np.isfinite(shares) & (shares > 0.0), shares, np.inf)


def hover_thrust(flown: ResponseRecord) -> tuple[float, float]:
    """Share of full thrust that carries the weight, and its standard deviation, from thrust as commanded.

    Thrust T makes the force g T / hover along the vehicle's axis, so hover = g * mean(T) / mean(force).

    Raises:
        TooLittleError: no thrust was commanded, too shortly, or it does not fit the force.
    """
    if flown.thrust is None:
        raise TooLittleError("no thrust in the log: hover thrust shows in flights by attitude setpoints")
    size = round(WINDOW_S / flown.period_s)
    starts = [k for first, last in flown.pieces for k in range(first, last - size + 1, size)]
    fewest = FEWEST_WINDOWS // 2  # of windows that do not overlap, as long
    if len(starts) < fewest:
        raise TooLittleError(f"{WINDOW_S * len(starts):.0f} s of flight, expected {WINDOW_S * fewest:.0f} s")
    rows = np.array(starts)[:, None] + np.arange(size)
    shares = GRAVITY_M_S2 * flown.thrust[rows].mean(axis=1) / flown.force_m_s2[rows].mean(axis=1)
    mean, std = float(np.mean(shares)), float(np.std(shares, ddof=1)) / math.sqrt(len(shares))
    if not std <= HOVER_UNCERTAIN * mean:
        raise TooLittleError(f"hover thrust within {100.0 * std / mean:.0f} %, expected 2 % or better")
    return mean, std
