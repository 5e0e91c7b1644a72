"""Several models in one filterpy filter: against filterpy's own IMM, and by the rules of probability."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.linalg import expm

from companion.base.geometry import FloatArray
from companion.config import PadFilterConfig
from companion.estimate.pad.model_bank import (
    BankState,
    ModelBank,
    ModelTransition,
    advance,
    blend,
    change_chances,
    mix,
)
from companion.estimate.pad.pad_models import (
    TURN,
    TURN_JERK_TIME_CONSTANT_S,
    TURN_TIME_CONSTANT_S,
    VEHICLE_ACCELERATION_NOISE_M_S2_RTHZ,
    WAVE_DAMPING,
    HorizontalModels,
    Turn,
    VerticalModels,
    course_turn,
)

DT_S = 1.0 / 30.0
DWELL_S = 3.0
NO_TURN = Turn(0.0, 0.0, 0.0)
START = np.array([1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def bank_and_step() -> tuple[ModelBank, ModelTransition, FloatArray]:
    models = HorizontalModels(PadFilterConfig())
    covariances = np.tile(np.diag([0.1, 0.1, 4.0, 4.0, 0.5, 0.5, 1.0, 1.0]), (4, 1, 1))
    bank = ModelBank(np.full(4, 0.25), DWELL_S, 8, seen=2)
    bank.start(START, covariances)
    return bank, models.step(DT_S, Turn(0.4, 0.01, 1.0)), covariances


def seen(k: int, rng: np.random.Generator) -> FloatArray:
    """A circle of 5 m at 1.5 m/s."""
    angle = 0.3 * k * DT_S
    return np.array([5.0 * math.sin(angle), 5.0 * math.cos(angle)]) + 0.01 * rng.normal(size=2)


def test_bank_agrees_with_filterpys_interacting_multiple_models() -> None:
    bank, step, covariances = bank_and_step()
    R = np.array([[2e-4, 5e-5], [5e-5, 1e-4]])
    filters = []
    for i in range(4):
        one = KalmanFilter(dim_x=8, dim_z=2)
        one.x, one.P = START.copy(), covariances[i].copy()
        one.F, one.Q, one.H, one.R = step.F[i], step.Q[i], np.eye(2, 8), R
        filters.append(one)
    theirs = IMMEstimator(filters, [0.25] * 4, change_chances(np.full(4, 0.25), DWELL_S, DT_S))
    rng = np.random.default_rng(3)
    for k in range(1, 40):
        z = seen(k, rng)
        bank.predict(DT_S, step)
        bank.update(z, R)
        theirs.predict()
        theirs.update(z)
    ours = blend(bank.state)
    assert bank.state.probabilities == pytest.approx(theirs.mu, abs=1e-9)
    assert ours.mean == pytest.approx(theirs.x, abs=1e-9)
    assert ours.covariance == pytest.approx(theirs.P, abs=1e-9)


def test_two_short_steps_change_models_as_one_long_step() -> None:
    prior = np.array([0.5, 0.3, 0.2])
    twice = change_chances(prior, DWELL_S, 0.1) @ change_chances(prior, DWELL_S, 0.2)
    assert twice == pytest.approx(change_chances(prior, DWELL_S, 0.3), abs=1e-12)
    assert twice.sum(axis=1) == pytest.approx(np.ones(3))


def test_mixing_leaves_the_blend_where_it_was() -> None:
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(3, 4, 4))
    state = BankState(rng.normal(size=(3, 4)), roots @ roots.transpose(0, 2, 1), np.array([0.6, 0.3, 0.1]))
    mixed = mix(state, change_chances(np.array([0.2, 0.5, 0.3]), DWELL_S, 0.5))
    assert blend(mixed).mean == pytest.approx(blend(state).mean)
    assert blend(mixed).covariance == pytest.approx(blend(state).covariance)


def test_a_state_is_never_written_to_again() -> None:
    bank, step, _ = bank_and_step()
    rng = np.random.default_rng(2)
    bank.predict(DT_S, step)
    bank.update(seen(1, rng), 1e-4 * np.eye(2))
    held = bank.state
    before = json.dumps([part.tolist() for part in held])
    for k in range(2, 6):
        bank.predict(DT_S, step)
        bank.update(seen(k, rng), 1e-4 * np.eye(2))
    bank.restore(held)
    bank.predict(DT_S, step)
    assert json.dumps([part.tolist() for part in held]) == before


def test_a_wild_measurement_leaves_probabilities_that_are_numbers() -> None:
    bank, step, _ = bank_and_step()
    bank.predict(DT_S, step)
    bank.update(np.array([1e6, -1e6]), 1e-6 * np.eye(2))
    assert bank.state.probabilities.sum() == pytest.approx(1.0)
    assert np.isfinite(bank.state.means).all()


# ---------------------------------------------------------------- the models


def by_matrix_exponential(A: FloatArray, W: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
    """F and Q by Van Loan's method."""
    n = len(A)
    block = np.block([[-A, W], [np.zeros((n, n)), A.T]])
    grown = expm(block * t)
    F = grown[n:, n:].T
    return F, F @ grown[:n, n:]


@pytest.mark.parametrize("t", [0.001, 1 / 30, 0.1, 0.5, 2.0, 10.0])
def test_waves_move_exactly_over_any_time(t: float) -> None:
    config = PadFilterConfig(wave_periods_s=(4.0,))
    w0, zeta = math.tau / 4.0, WAVE_DAMPING
    A = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0, -w0 * w0, -2 * zeta * w0]], dtype=float)
    white = VEHICLE_ACCELERATION_NOISE_M_S2_RTHZ**2
    W = np.diag([0.0, white, 0.0, 4 * zeta * w0**3 * config.wave_acceleration_std_m_s2**2])
    F, Q = by_matrix_exponential(A, W, t)
    step = VerticalModels(config).step(t)
    assert step.F[1] == pytest.approx(F, rel=1e-8, abs=1e-10)
    assert step.Q[1] == pytest.approx(Q, rel=1e-6, abs=1e-10)


@pytest.mark.parametrize("t", [1 / 30, 0.4, 2.0])
def test_a_turning_acceleration_moves_exactly(t: float) -> None:
    config, omega = PadFilterConfig(), 0.5
    turn = np.array([[0.0, -omega], [omega, 0.0]])
    A = np.eye(8, k=2)
    A[4:6, 4:6] = turn - np.eye(2) / TURN_TIME_CONSTANT_S
    A[6:8, 6:8] = turn - np.eye(2) / TURN_JERK_TIME_CONSTANT_S
    F, _ = by_matrix_exponential(A, np.zeros((8, 8)), t)
    step = HorizontalModels(config).step(t, Turn(omega, 0.0, 0.0))
    assert step.F[TURN] == pytest.approx(F, rel=1e-9, abs=1e-11)


def test_accelerations_keep_the_spread_that_they_start_with() -> None:
    plane, climb = HorizontalModels(PadFilterConfig()), VerticalModels(PadFilterConfig())
    across, up = plane.step(300.0, NO_TURN), climb.step(300.0)
    lasting = [model for model in range(plane.count) if model != TURN]
    assert across.Q[lasting, 4, 4] == pytest.approx(plane.acceleration_variance[lasting], rel=1e-3)
    # of a turn the jerk lasts, and an acceleration that is seen no more may become any
    assert across.Q[TURN, 6, 6] == pytest.approx(plane.jerk_variance[TURN], rel=1e-3)
    assert across.Q[TURN, 4, 4] > plane.acceleration_variance[TURN]
    assert up.Q[:, 2, 2] == pytest.approx(climb.acceleration_variance, rel=1e-3)
    assert up.Q[:, 3, 3] == pytest.approx(climb.jerk_variance, rel=1e-3)


def test_prediction_takes_the_vehicles_motion_off_every_model() -> None:
    bank, step, _ = bank_and_step()
    moved = np.array([0.1, -0.2, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    still, driven = advance(bank.state, step), advance(bank.state, step._replace(moved=moved))
    assert driven.means - still.means == pytest.approx(np.tile(moved, (4, 1)))


def test_course_turns_as_velocity_and_acceleration_say() -> None:
    turn = course_turn((0.0, 2.0), (-1.0, 0.0), 1e-3, 0.5, 1e-3)
    assert turn.rate_rad_s == pytest.approx(0.49, abs=0.02)
    assert turn.acceleration_m_s2 == pytest.approx(1.0)


def test_slow_pads_turn_as_their_heading_does() -> None:
    turn = course_turn((0.0, 0.0), (0.1, -0.1), 0.3, 0.3, 1e-3)
    assert turn.rate_rad_s == pytest.approx(0.28, abs=0.03)
    assert turn.variance > course_turn((2.0, 0.0), (0.0, 0.6), 1e-3, 0.3, 1e-3).variance
