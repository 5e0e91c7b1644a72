"""A well-tuned PID, a baseline for the MPC and the recursion.

Per axis, u = a_ref + K_p e + K_d e' + integral of K_i e, with e the target's position minus the vehicle's
when the command takes effect. Prediction over the delay, reference with velocity and acceleration fed
forward, and the approach of far targets are those of the other trackers. Only the integral counteracts a
disturbance. It is held while the command is at its bound and the error would drive it further (clamping),
and is bounded itself. Gains: `control.pid`, from `python -m experiments tune-flight-pid`.

Frame: as the MPC's, NED axes that do not accelerate; SI units.
"""

import math

import numpy as np

from companion.base.geometry import ZERO3, Vector3, add, vector3
from companion.base.motion import Motion
from companion.config import ControlConfig, PidGains
from companion.control.limits import aside_m_s2
from companion.control.response.flight_model import advance
from companion.control.tracking import SolveOutcome, Target, TrackingSolution


class PidTracker:
    """Three PIDs. Keeps the integrals."""

    def __init__(self, config: ControlConfig, lags_s: Vector3) -> None:
        """`lags_s` are `flight_model.lags`, for the predicted states that are reported."""
        sideways, upright = config.pid.horizontal, config.pid.vertical
        self._gains = (sideways, sideways, upright)
        self._steps, self._step_s = config.horizon_steps, config.step_s
        self._period_s = 1.0 / config.rate_hz
        self._lags_s = lags_s
        self._horizontal = aside_m_s2(config.limits)
        self._vertical = config.limits.vertical_acceleration_m_s2
        self._integral: Vector3 = ZERO3

    def reset(self) -> None:
        """Forget what has been integrated."""
        self._integral = ZERO3

    def solve(
        self, start: Motion, target: Target, disturbance_m_s2: Vector3, last_input_m_s2: Vector3
    ) -> TrackingSolution:
        """The command for now, and what it would lead to over the horizon.

        The disturbance and the last input are the model-based trackers' and are not used. Without finite
        numbers to go by: no acceleration, not solved.
        """
        reference = np.hstack([target.position_m, target.velocity_m_s, target.acceleration_m_s2])
        rows = reference.tolist()
        first = self._bounded(self._command(start, rows[0]))
        if not (np.isfinite(reference).all() and all(map(math.isfinite, first))):
            return TrackingSolution(np.zeros((self._steps, 3)), np.zeros((self._steps, 9)), SolveOutcome.KEPT)
        self._integrate(start, rows[0], first)
        return self._rollout(start, rows)

    def _command(self, motion: Motion, row: list[float]) -> Vector3:
        p, v = motion.position_m, motion.velocity_m_s
        return vector3(
            [
                row[6 + i]
                + g.position_gain_1_s2 * (row[i] - p[i])
                + g.velocity_gain_1_s * (row[3 + i] - v[i])
                + self._integral[i]
                for i, g in enumerate(self._gains)
            ]
        )

    def _bounded(self, command: Vector3) -> Vector3:
        """The nearest command along the same horizontal direction that the gate will let through."""
        x, y, z = command
        size = math.hypot(x, y)
        share = min(1.0, self._horizontal / size) if size > 0.0 else 1.0
        return (x * share, y * share, min(max(z, -self._vertical), self._vertical))

    def _integrate(self, start: Motion, row: list[float], flown: Vector3) -> None:
        wanted = self._command(start, row)
        self._integral = vector3(
            [
                _integrated(
                    self._integral[i], row[i] - start.position_m[i], wanted[i] - flown[i], g, self._period_s
                )
                for i, g in enumerate(self._gains)
            ]
        )

    def _rollout(self, start: Motion, rows: list[list[float]]) -> TrackingSolution:
        """Inputs and states of the law on the model; the integral is constant, against the disturbance."""
        push = (-self._integral[0], -self._integral[1], -self._integral[2])
        motion, inputs, states = start, [], []
        for row in rows[: self._steps]:
            command = self._bounded(self._command(motion, row))
            motion = advance(motion, add(command, push), self._step_s, self._lags_s)
            inputs.append(command)
            states.append((*motion.position_m, *motion.velocity_m_s, *motion.acceleration_m_s2))
        return TrackingSolution(np.array(inputs), np.array(states))


def _integrated(integral: float, error_m: float, cut_m_s2: float, gains: PidGains, period_s: float) -> float:
    """The integral after one period; it waits where the command was cut and the error asks for more."""
    if cut_m_s2 * error_m > 0.0:
        return integral
    most = gains.integral_limit_m_s2
    return min(max(integral + gains.integral_gain_1_s3 * error_m * period_s, -most), most)
