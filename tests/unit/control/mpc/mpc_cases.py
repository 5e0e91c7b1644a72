"""Plants, references and starts for the tests of the MPC."""

import numpy as np

from companion.base.geometry import FloatArray, Vector3
from companion.config import ControlConfig
from companion.control.response.flight_model import discretise
from companion.control.tracking import Target

TAU_S = 0.11
LAGS_S = (TAU_S, TAU_S, 0.04)
CONFIG = ControlConfig()
N, DT = CONFIG.horizon_steps, CONFIG.step_s


def hover_at(position: Vector3, floor_down_m: float | None = None) -> Target:
    still = np.zeros((N + 1, 3))
    floor = None if floor_down_m is None else np.full(N + 1, floor_down_m)
    return Target(np.tile(np.array(position), (N + 1, 1)), still, still, floor)


def curve() -> Target:
    """Some smooth reference that ends in rest, small enough for no constraint to bind."""
    t = DT * np.arange(N + 1)[:, None]
    w, phase = 2.0, np.array([0.0, 1.0, 2.0])
    rest = np.clip(1.0 - t / t[-3], 0.0, 1.0)
    position = 0.2 * np.sin(w * t + phase) * rest
    velocity = 0.3 * np.cos(w * t + phase) * rest
    acceleration = -0.4 * np.sin(w * t + phase) * rest
    return Target(position, velocity, acceleration)


def batch_inputs(
    start: FloatArray,
    reference: FloatArray,
    needed: FloatArray,
    *,
    last: float,
    first_change: float,
    d: float,
    axis: int,
) -> FloatArray:
    """One axis by least squares over a horizon so long that its end does not matter; no constraints.

    start (3,); reference (N + 1, 3), needed (N,): held on after their ends.
    """
    M = N + 200
    A, B = discretise(DT, LAGS_S[axis])
    w = CONFIG.vertical if axis == 2 else CONFIG.horizontal
    answer = np.zeros((3, M))  # state's answer to each input, built up step by step
    free = start.copy()
    rows, targets = [], []
    weights = np.array([1.0 / w.position_m, 1.0 / w.velocity_m_s, 1.0 / w.acceleration_m_s2])
    for k in range(M):
        answer = A @ answer
        answer[:, k] += B
        free = A @ free + B * d
        goal = reference[min(k + 1, N)]
        rows.append(weights[:, None] * answer)
        targets.append(weights * (goal - free))
    wished = np.concatenate([needed, np.full(M - N, needed[-1])])
    rows.append(np.eye(M) / w.effort_m_s2)
    targets.append(wished / w.effort_m_s2)
    change = np.diff(wished, prepend=wished[0])
    change[0] = first_change + last
    rows.append((np.eye(M) - np.eye(M, k=-1)) / w.effort_change_m_s2)
    targets.append(change / w.effort_change_m_s2)
    solution, *_ = np.linalg.lstsq(np.vstack(rows), np.concatenate(targets), rcond=None)
    return np.array(solution[:N])
