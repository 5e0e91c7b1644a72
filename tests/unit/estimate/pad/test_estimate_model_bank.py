"""All models in one array operation: against filterpy's own IMM, and by the rules of probability."""

import json
import math

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.linalg import expm

from companion.base.geometry import FloatArray
from companion.config import PadFilterConfig
from companion.estimate.pad.model_bank import BankState, ModelBank, ModelTransition, advance, innovation, mix
from companion.estimate.pad.pad_models import (
    TURN,
    TURN_JERK_TIME_CONSTANT_S,
    TURN_TIME_CONSTANT_S,
    WAVE_DAMPING,
    PadModels,
    Turn,
    course_turn,
)

DT_S = 1.0 / 30.0
DWELL_S = 3.0
NO_TURN = Turn(0.0, 0.0, 0.0)
PLANE, CLIMB = 0, 1
# the vertical models' first axis, of which they have states of their own
UP = slice(0, 8, 2)


class Bank:
    """The pad's models over a circle of 5 m at 1.5 m/s, and the vehicle's own way."""

    def __init__(self) -> None:
        self.models = PadModels(PadFilterConfig())
        self.rng = np.random.default_rng(3)
        self.bank = ModelBank(self.models.groups, DWELL_S)
        self.R = np.array([[[2e-4, 5e-5], [5e-5, 1e-4]], [[3e-4, 0.0], [0.0, 1.0]]])
        across, up = (
            np.diag([0.1, 0.1, 4.0, 4.0, 0.5, 0.5, 1.0, 1.0]),
            np.diag([0.1, 0, 0.2, 0, 0.3, 0, 0.4, 0]),
        )
        self.means = np.array([[1.0, 2.0, *[0.0] * 6], [3.0, *[0.0] * 7]])
        self.covariances = np.array([across, up])[self.bank.group_of]
        self.bank.start(self.means, self.covariances)

    def step(self, dt_s: float = DT_S) -> ModelTransition:
        F, Q = self.models.step(dt_s, Turn(0.4, 0.01, 1.0), 4e-4)
        moved = np.array([[0.01, -0.02, 0.1, 0.2, *[0.0] * 4], [0.03, 0.0, -0.1, *[0.0] * 5]])
        return ModelTransition(F, Q, moved[self.bank.group_of])

    def seen(self, k: int) -> FloatArray:
        angle = 0.3 * k * DT_S
        north, east = np.array([5.0 * math.sin(angle), 5.0 * math.cos(angle)]) + 0.01 * self.rng.normal(
            size=2
        )
        return np.array([[north, east], [3.0 + 0.01 * self.rng.normal(), 0.0]])

    def update(self, z: FloatArray, group: int | None = None) -> None:
        rows = self.bank.group_of
        self.bank.update(innovation(self.bank.state, z[rows], self.R[rows]), group)


def textbook(bank: Bank, group: int, axes: slice, seen: int) -> IMMEstimator:
    """filterpy's own, one filter a model, moved by the bank's F and Q."""
    models = bank.models.groups[group]
    step = bank.step()
    filters = []
    for model in range(models.start, models.stop):
        one = KalmanFilter(dim_x=len(range(8)[axes]), dim_z=seen)
        one.x, one.P = bank.means[group, axes].copy(), bank.covariances[model, axes, axes].copy()
        one.F, one.Q = step.F[model, axes, axes], step.Q[model, axes, axes]
        one.B, one.H, one.R = np.eye(one.dim_x), np.eye(seen, one.dim_x), bank.R[group, :seen, :seen]
        filters.append(one)
    chances = bank.bank.change_chances(DT_S)[models, models]
    return IMMEstimator(filters, [1.0 / len(filters)] * len(filters), chances)


@pytest.mark.parametrize(("group", "axes", "seen"), [(PLANE, slice(8), 2), (CLIMB, UP, 1)])
def test_bank_agrees_with_filterpys_interacting_multiple_models(group: int, axes: slice, seen: int) -> None:
    bank = Bank()
    theirs = textbook(bank, group, axes, seen)
    step = bank.step()
    models = bank.models.groups[group]
    for k in range(1, 150):
        z = bank.seen(k)
        bank.bank.predict(DT_S, step)
        bank.update(z)
        theirs.predict(step.moved[models.start, axes])
        theirs.update(z[group, :seen])
    state = bank.bank.state
    ours = bank.bank.blend(state)
    assert state.probabilities[models] == pytest.approx(theirs.mu, rel=1e-9)
    assert ours.mean[group, axes] == pytest.approx(theirs.x, rel=1e-9, abs=1e-10)
    scale = np.sqrt(np.outer(theirs.P.diagonal(), theirs.P.diagonal()))
    assert ours.covariance[group, axes, axes] / scale == pytest.approx(theirs.P / scale, rel=1e-9, abs=1e-9)
    for i, one in enumerate(theirs.filters):
        assert state.covariances[models.start + i, axes, axes] == pytest.approx(one.P, rel=1e-8, abs=1e-12)


def test_of_the_vertical_models_second_axis_nothing_ever_comes() -> None:
    bank = Bank()
    for k in range(1, 30):
        bank.bank.predict(DT_S, bank.step())
        bank.update(bank.seen(k))
    means, covariances, _ = bank.bank.state
    climb = bank.models.groups[CLIMB]
    assert not means[climb, 1::2].any()
    assert not covariances[climb, 1::2].any()
    assert not covariances[climb, :, 1::2].any()


def test_a_height_alone_leaves_the_plane_as_it_was() -> None:
    bank, both = Bank(), Bank()
    for each in (bank, both):
        each.bank.predict(DT_S, each.step())
    before, z = bank.bank.state, bank.seen(1)
    bank.update(z, CLIMB)
    both.update(z)
    plane, climb = bank.models.groups
    for mine, old, taken in zip(bank.bank.state, before, both.bank.state, strict=True):
        assert (mine[plane] == old[plane]).all()
        assert mine[climb] == pytest.approx(taken[climb], rel=1e-12)


def test_covariances_stay_symmetric_and_positive() -> None:
    bank = Bank()
    for k in range(1, 300):
        bank.bank.predict(DT_S, bank.step())
        bank.update(bank.seen(k))
    P = bank.bank.state.covariances
    assert pytest.approx(P, rel=1e-12, abs=1e-18) == P.transpose(0, 2, 1)
    assert np.linalg.eigvalsh(P[bank.models.groups[PLANE]]).min() > 0.0


def test_two_short_steps_change_models_as_one_long_step() -> None:
    bank = Bank().bank
    twice = bank.change_chances(0.1) @ bank.change_chances(0.2)
    assert twice == pytest.approx(bank.change_chances(0.3), abs=1e-12)
    assert twice.sum(axis=1) == pytest.approx(np.ones(8))
    assert not twice[:4, 4:].any()


def test_mixing_leaves_the_blend_where_it_was() -> None:
    rng, bank = np.random.default_rng(1), ModelBank([slice(0, 3)], DWELL_S)
    roots = rng.normal(size=(3, 4, 4))
    state = BankState(rng.normal(size=(3, 4)), roots @ roots.transpose(0, 2, 1), np.array([0.6, 0.3, 0.1]))
    chances = 0.4 * np.array([0.2, 0.5, 0.3]) + 0.6 * np.eye(3)
    before, after = bank.blend(state), bank.blend(mix(state, chances))
    assert after.mean == pytest.approx(before.mean)
    assert after.covariance == pytest.approx(before.covariance)


def test_a_state_is_never_written_to_again() -> None:
    bank = Bank()
    bank.bank.predict(DT_S, bank.step())
    bank.update(bank.seen(1))
    held = bank.bank.state
    before = json.dumps([part.tolist() for part in held])
    for k in range(2, 6):
        bank.bank.predict(DT_S, bank.step())
        bank.update(bank.seen(k))
        bank.update(bank.seen(k), CLIMB)
    bank.bank.restore(held)
    bank.bank.predict(DT_S, bank.step())
    assert json.dumps([part.tolist() for part in held]) == before


def test_a_wild_measurement_leaves_probabilities_that_are_numbers() -> None:
    bank = Bank()
    bank.bank.predict(DT_S, bank.step())
    bank.update(np.array([[1e6, -1e6], [1e6, 0.0]]))
    for group in bank.models.groups:
        assert bank.bank.state.probabilities[group].sum() == pytest.approx(1.0)
    assert np.isfinite(bank.bank.state.means).all()


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
    white = 4e-4
    W = np.diag([0.0, white, 0.0, 4 * zeta * w0**3 * config.wave_acceleration_std_m_s2**2])
    F, Q = by_matrix_exponential(A, W, t)
    models = PadModels(config)
    ours_F, ours_Q = models.step(t, NO_TURN, white)
    wave = models.groups[CLIMB].start + 1
    assert ours_F[wave, UP, UP] == pytest.approx(F, rel=1e-8, abs=1e-10)
    assert ours_Q[wave, UP, UP] == pytest.approx(Q, rel=1e-6, abs=1e-10)


@pytest.mark.parametrize("t", [1 / 30, 0.4, 2.0])
def test_a_turning_acceleration_moves_exactly(t: float) -> None:
    config, omega = PadFilterConfig(), 0.5
    turn = np.array([[0.0, -omega], [omega, 0.0]])
    A = np.eye(8, k=2)
    A[4:6, 4:6] = turn - np.eye(2) / TURN_TIME_CONSTANT_S
    A[6:8, 6:8] = turn - np.eye(2) / TURN_JERK_TIME_CONSTANT_S
    F, _ = by_matrix_exponential(A, np.zeros((8, 8)), t)
    ours, _ = PadModels(config).step(t, Turn(omega, 0.0, 0.0), 0.0)
    assert ours[TURN] == pytest.approx(F, rel=1e-9, abs=1e-11)


def test_accelerations_keep_the_spread_that_they_start_with() -> None:
    models = PadModels(PadFilterConfig())
    _, Q = models.step(300.0, NO_TURN, 0.0)
    lasting = [model for model in range(models.count) if model != TURN]
    assert Q[lasting, 4, 4] == pytest.approx(models.acceleration_variance[lasting], rel=1e-3)
    # of a turn the jerk lasts, and an acceleration that is seen no more may become any
    assert Q[TURN, 6, 6] == pytest.approx(models.jerk_variance[TURN], rel=1e-3)
    assert Q[TURN, 4, 4] > models.acceleration_variance[TURN]
    climb = models.groups[CLIMB]
    assert Q[climb, 6, 6] == pytest.approx(models.jerk_variance[climb], rel=1e-3)


def test_prediction_takes_the_vehicles_motion_off_every_model() -> None:
    bank = Bank()
    step = bank.step()
    still, driven = (
        advance(bank.bank.state, step._replace(moved=moved)) for moved in (0.0 * step.moved, step.moved)
    )
    assert driven.means - still.means == pytest.approx(step.moved)


def test_course_turns_as_velocity_and_acceleration_say() -> None:
    turn = course_turn((0.0, 2.0), (-1.0, 0.0), 1e-3, 0.5, 1e-3)
    assert turn.rate_rad_s == pytest.approx(0.49, abs=0.02)
    assert turn.acceleration_m_s2 == pytest.approx(1.0)


def test_slow_pads_turn_as_their_heading_does() -> None:
    turn = course_turn((0.0, 0.0), (0.1, -0.1), 0.3, 0.3, 1e-3)
    assert turn.rate_rad_s == pytest.approx(0.28, abs=0.03)
    assert turn.variance > course_turn((2.0, 0.0), (0.0, 0.6), 1e-3, 0.3, 1e-3).variance
