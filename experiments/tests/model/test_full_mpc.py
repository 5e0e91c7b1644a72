"""The MPC on 12 states: the recursion where no bound is near, and each bound where one is."""

import math

import numpy as np
import pytest

from companion.base.geometry import FloatArray
from experiments.model.disturbance_filter import NO_DISTURBANCE, HorizonReference, along, disturbance_effect
from experiments.model.full_mpc import (
    FullMpc,
    FullMpcConfig,
    FullRiccatiTracker,
    FullSolution,
    ObstacleBounds,
    load_full,
    within_reach,
)
from experiments.model.quadrotor import (
    ANGLES,
    PHI,
    POSITION,
    PSI,
    STATES,
    THETA,
    VELOCITY,
    QuadrotorModel,
    load_quadrotor,
)

MODEL = load_quadrotor("x500")
CONFIG = load_full("full")


def waiting(
    place: tuple[float, float, float] = (0.0, 0.0, 5.0), config: FullMpcConfig = CONFIG
) -> HorizonReference:
    """Hold a place."""
    rows = (config.steps + 1, 3)
    return HorizonReference(np.tile(place, (rows[0], 1)), np.zeros(rows), np.zeros(rows))


def swinging(config: FullMpcConfig = CONFIG) -> HorizonReference:
    """Along a sine at 2 m/s², on a heading."""
    t = config.step_s * np.arange(config.steps + 1)[:, None]
    way = np.array([[1.0, -0.5, 0.2]])
    return HorizonReference(
        way * np.sin(2 * t) + [0.0, 0.0, 5.0], 2 * way * np.cos(2 * t), -4 * way * np.sin(2 * t), 0.7
    )


def nothing_around(planes: int = 0) -> ObstacleBounds:
    N = CONFIG.steps
    return ObstacleBounds(np.full(N, -1e3), np.zeros((N, planes, 3)), np.full((N, planes), -1e4))


def state_at(reference: HorizonReference) -> FloatArray:
    state: FloatArray = along(reference, MODEL, CONFIG.step_s).states[0]
    return state


def exact(planes: int = 0) -> FullMpc:
    return FullMpc(CONFIG.model_copy(update={"maximum_iterations": 10000}), MODEL, planes)


def fly(
    mpc: FullMpc, state: FloatArray, reference: HorizonReference, around: ObstacleBounds, steps: int
) -> FloatArray:
    """States (steps + 1, 12) in closed loop on the model itself; the reference stands."""
    flown = [state]
    for _ in range(steps):
        flown.append(MODEL.advance(flown[-1], mpc.solve(flown[-1], reference, around).first, 0.02))
    return np.array(flown)


def test_without_a_bound_in_reach_it_is_the_recursion() -> None:
    reference = swinging()
    state = state_at(reference) + 0.02
    free = FullRiccatiTracker(CONFIG, MODEL).solve(state, reference)
    found = exact().solve(state, reference, nothing_around())
    assert found.solved
    assert np.allclose(found.inputs[0], free.inputs[0], atol=5e-3)
    assert np.allclose(found.states, free.states, atol=5e-3)


def test_the_nominal_is_flown_by_its_own_inputs() -> None:
    reference = swinging()
    nominal = along(reference, MODEL, CONFIG.step_s)
    assert np.allclose(nominal.states[:, POSITION], reference.position_m)
    assert np.abs(nominal.remainder[1:-1, VELOCITY]).max() < 0.02
    assert nominal.states[0, PSI] == pytest.approx(0.7)


def test_a_push_tilts_the_nominal_against_it() -> None:
    disturbance = np.array([1.5, 0.0, -2.0, 0.0, 0.3, 0.0])
    nominal = along(waiting(), MODEL, CONFIG.step_s, disturbance)
    lift = 9.80665 + 2.0
    assert nominal.states[0, THETA] == pytest.approx(math.atan2(-1.5, lift))
    assert nominal.inputs[0, 0] == pytest.approx(MODEL.mass_kg * math.hypot(1.5, lift))
    assert np.abs(nominal.remainder).max() < 1e-3
    assert np.allclose(disturbance_effect(disturbance, 0.1)[VELOCITY], [0.15, 0.0, -0.2])


def test_bounds_that_bind_are_solved_within_the_iterations() -> None:
    """Wind that the tilt cannot stand against, as at a gust's height."""
    disturbance = np.array([-6.5, -2.3, -2.4, -0.3, 0.2, -0.2])
    mpc, state = FullMpc(CONFIG, MODEL), state_at(waiting())
    iterations = []
    for k in range(80):
        grown = min(1.0, k / 40) * disturbance
        found = mpc.solve(state, waiting(), nothing_around(), grown)
        iterations.append(found.iterations)
        assert found.solved
        state = MODEL.advance(state, found.first, 0.02) + disturbance_effect(grown, 0.02)
    assert np.abs(state[ANGLES[:2]]).max() > 0.9 * math.radians(CONFIG.limits.tilt_deg)
    assert max(iterations) < CONFIG.maximum_iterations


def test_a_known_push_leaves_no_offset() -> None:
    reference, disturbance = waiting(), np.array([1.5, -1.0, -1.0, 0.0, 0.0, 0.0])
    mpc, state = FullMpc(CONFIG, MODEL), state_at(waiting())
    for _ in range(150):
        inputs = mpc.solve(state, reference, nothing_around(), disturbance).first
        state = MODEL.advance(state, inputs, 0.02) + disturbance_effect(disturbance, 0.02)
    assert np.abs(state[POSITION] - [0.0, 0.0, 5.0]).max() < 2e-3


def test_the_rotors_range_is_kept_hard() -> None:
    limits = CONFIG.limits.model_copy(update={"most_thrust_share": 0.6})
    weak = CONFIG.model_copy(update={"limits": limits, "maximum_iterations": 4000})
    found = FullMpc(weak, MODEL).solve(state_at(waiting()), waiting((0.0, 0.0, 6.0)), nothing_around())
    shares = found.inputs @ (MODEL.thrusts_from_inputs / MODEL.full_rotor_thrust_n).T
    assert shares.max() == pytest.approx(0.6, abs=0.005)


def test_tilt_and_speed_are_kept() -> None:
    flown = fly(FullMpc(CONFIG, MODEL), state_at(waiting()), waiting((6.0, -6.0, 5.0)), nothing_around(), 100)
    tilt = np.radians(CONFIG.limits.tilt_deg)
    assert 0.6 * tilt < np.abs(flown[:, ANGLES[:2]]).max() <= 1.01 * tilt
    assert np.abs(flown[:, VELOCITY[:2]]).max() <= 1.01 * CONFIG.limits.horizontal_speed_m_s
    assert np.abs(flown[-1, POSITION[:2]]).min() > 1.0


def test_it_stops_over_the_floor() -> None:
    around = ObstacleBounds(
        np.full(CONFIG.steps, 4.5), np.zeros((CONFIG.steps, 0, 3)), np.zeros((CONFIG.steps, 0))
    )
    flown = fly(FullMpc(CONFIG, MODEL), state_at(waiting()), waiting((0.0, 0.0, 4.0)), around, 60)
    assert 4.48 < flown[:, POSITION[2]].min() < 4.52


def test_it_stops_before_a_half_space() -> None:
    N = CONFIG.steps
    around = ObstacleBounds(np.full(N, -1e3), np.tile([-1.0, 0.0, 0.0], (N, 1, 1)), np.full((N, 1), -1.0))
    flown = fly(FullMpc(CONFIG, MODEL, 1), state_at(waiting()), waiting((1.6, 0.0, 5.0)), around, 90)
    assert 0.97 < flown[:, POSITION[0]].max() < 1.02


def test_a_reference_far_off_is_drawn_near_as_a_whole() -> None:
    far = waiting((30.0, 40.0, 5.0))
    near = within_reach(far, np.array([0.0, 0.0, 5.0]), 1.0)
    assert np.allclose(near.position_m, [0.6, 0.8, 5.0])
    assert within_reach(far, np.array([30.0, 40.0, 5.5]), 1.0) is far


def test_the_same_question_has_the_same_answer() -> None:
    state = state_at(swinging()) + 0.1
    first, second = (FullMpc(CONFIG, MODEL).solve(state, swinging(), nothing_around()) for _ in range(2))
    assert np.array_equal(first.inputs, second.inputs)
    assert first.iterations == second.iterations


def test_what_is_not_a_number_gets_the_old_plan_a_step_on_and_is_forgotten() -> None:
    mpc, state = FullMpc(CONFIG, MODEL), state_at(swinging())
    before = mpc.solve(state, swinging(), nothing_around())
    broken = mpc.solve(np.full(STATES, np.nan), swinging(), nothing_around())
    assert not broken.solved
    assert np.array_equal(broken.inputs[0], before.inputs[1])
    assert mpc.solve(state, swinging(), nothing_around()).solved


def test_without_any_plan_it_hovers() -> None:
    mpc = FullMpc(CONFIG, MODEL)
    found: FullSolution = mpc.solve(np.full(STATES, np.nan), waiting(), nothing_around())
    assert np.array_equal(found.inputs[0], MODEL.hover)
    mpc.reset()
    assert mpc.solve(state_at(waiting()), waiting(), nothing_around()).solved


def test_a_hundred_steps_of_an_x_frame_are_solved() -> None:
    long = CONFIG.model_copy(update={"steps": 100})
    model = QuadrotorModel(MODEL.config.model_copy(update={"layout": "x"}))
    reference = swinging(long)
    around = ObstacleBounds(np.full(100, -1e3), np.zeros((100, 0, 3)), np.zeros((100, 0)))
    found = FullMpc(long, model).solve(state_at(reference), reference, around, NO_DISTURBANCE)
    assert found.solved
    assert np.abs(found.states[:, POSITION] - reference.position_m).max() < 0.05
    assert np.abs(found.states[:, PHI]).max() < 0.5
