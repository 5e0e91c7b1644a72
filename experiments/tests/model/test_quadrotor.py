"""The paper's model: eq. 5 both ways, eq. 6 against the vector form, eqs. 9-11 against differences."""

import math
from pathlib import Path

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    FloatArray,
    Quaternion,
    Vector3,
    quat_from_euler,
    quat_integrate,
    quat_rotate,
)
from companion.config import ConfigError, find_file
from experiments.model.quadrotor import (
    ANGLES,
    POSITION,
    RATES,
    VELOCITY,
    QuadrotorModel,
    flipped,
    load_quadrotor,
    state_from_ned,
    structure,
)
from sitl.scenario.scenario import load_airframe
from sitl.vehicle.quadrotor import Quadrotor, QuadrotorState

SHIPPED = ("x500", "sih", "arducopter_sitl")


def ned_from_state(state: FloatArray) -> tuple[Vector3, Vector3, Quaternion, Vector3]:
    """Position, velocity (NED), attitude and body rate (FRD) of a state (12,)."""
    x, vx, y, vy, z, vz, phi, phi_rate, theta, theta_rate, psi, psi_rate = state.tolist()
    rate = (
        phi_rate - math.sin(theta) * psi_rate,
        theta_rate * math.cos(phi) + psi_rate * math.sin(phi) * math.cos(theta),
        -theta_rate * math.sin(phi) + psi_rate * math.cos(phi) * math.cos(theta),
    )
    attitude = quat_from_euler(*flipped((phi, theta, psi)))
    return flipped((x, y, z)), flipped((vx, vy, vz)), attitude, flipped(rate)


def x500(layout: str = "plus") -> QuadrotorModel:
    return QuadrotorModel(load_quadrotor("x500").config.model_copy(update={"layout": layout}))


def random_points(model: QuadrotorModel, count: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """States (count, 12) of lively flight and inputs (count, 4) by rotor speeds well within their range."""
    rng = np.random.default_rng(seed)
    states = rng.uniform(-1.0, 1.0, (count, 12))
    states[:, RATES] *= 3.0
    speeds = model.config.max_rotor_speed_rad_s * rng.uniform(0.4, 0.9, (count, 4))
    return states, model.inputs(speeds)


@pytest.mark.parametrize("layout", ["plus", "x"])
def test_rotor_speeds_give_the_inputs_that_they_came_from(layout: str) -> None:
    model = x500(layout)
    speeds = np.array([[600.0, 650.0, 700.0, 550.0], [927.5, 0.0, 300.0, 10.0]])
    assert np.allclose(model.rotor_speeds(model.inputs(speeds)), speeds, atol=1e-4)


def test_the_plus_is_the_papers() -> None:
    """Eq. 5, written out."""
    model, w = x500(), np.array([600.0, 650.0, 700.0, 550.0])
    c = model.config
    b, d, s = c.thrust_coefficient_n_s2, c.torque_coefficient_n_m_s2, w**2
    lever = b * c.arm_length_m
    expected = [b * s.sum(), lever * (s[3] - s[1]), lever * (s[2] - s[0]), d * (s[1] + s[3] - s[0] - s[2])]
    assert np.allclose(model.inputs(w), expected)


def test_the_x_rolls_right_with_its_left_pair_and_pitches_with_front_and_rear() -> None:
    model = x500("x")
    c = model.config
    arm = c.arm_length_m / 2.0**0.5
    thrust = c.thrust_coefficient_n_s2 * 500.0**2
    front_right, _, _, front_left = np.eye(4) * 500.0
    assert np.allclose(model.inputs(front_right)[1:3], [-arm * thrust, -arm * thrust])
    assert np.allclose(model.inputs(front_left)[1:3], [arm * thrust, -arm * thrust])


@pytest.mark.parametrize("name", SHIPPED)
def test_hover_is_at_rest_and_within_reach(name: str) -> None:
    model = load_quadrotor(name)
    assert np.allclose(model.derivative(np.zeros(12), model.hover), 0.0, atol=1e-9)
    assert (model.rotor_speeds(model.hover) < 0.8 * model.config.max_rotor_speed_rad_s).all()


def test_the_angular_accelerations_are_newton_eulers() -> None:
    """I w' = U - w x (I w + h), the rotors' momentum along up: the gyroscopic terms have opposite signs."""
    model = x500()
    states, inputs = random_points(model, 50)
    inertia = np.diag(model.inertia_kg_m2)
    spins = model.rotor_speeds(inputs) * model.config.rotor_inertia_kg_m2
    momentum = spins[:, 0] - spins[:, 1] + spins[:, 2] - spins[:, 3]  # anticlockwise is positive about up
    for state, u, h in zip(states, inputs, momentum, strict=True):
        w = state[RATES]
        expected = np.linalg.solve(inertia, u[1:] - np.cross(w, inertia @ w + [0.0, 0.0, h]))
        assert np.allclose(model.derivative(state, u)[RATES], expected, rtol=1e-9)


def test_the_accelerations_are_thrust_along_the_bodys_axis() -> None:
    model = x500()
    states, inputs = random_points(model, 50)
    for state, u in zip(states, inputs, strict=True):
        attitude = ned_from_state(state)[2]
        force = quat_rotate(attitude, (0.0, 0.0, -u[0] / model.mass_kg))
        expected = (force[0], -force[1], -force[2] - GRAVITY_M_S2)
        slope = model.derivative(state, u)
        assert np.allclose(slope[VELOCITY], expected)
        assert np.allclose(slope[POSITION], state[VELOCITY])


@pytest.mark.parametrize("layout", ["plus", "x"])
def test_jacobians_are_the_finite_differences(layout: str) -> None:
    model = x500(layout)
    states, inputs = random_points(model, 40, seed=1)
    A, B = model.jacobians(states, inputs)
    step = 1e-5
    for column in range(12):
        aside = step * np.eye(12)[column]
        slope = (model.derivative(states + aside, inputs) - model.derivative(states - aside, inputs)) / (
            2 * step
        )
        assert np.allclose(A[:, :, column], slope, atol=1e-6)
    for column in range(4):
        aside = step * np.eye(4)[column]
        slope = (model.derivative(states, inputs + aside) - model.derivative(states, inputs - aside)) / (
            2 * step
        )
        assert np.allclose(B[:, :, column], slope, atol=1e-5)


def test_a_linearised_step_is_the_slope_of_a_whole_one() -> None:
    model = x500()
    states, inputs = random_points(model, 20, seed=2)
    inputs[:, 1:] *= 0.05  # torques of flight: full ones turn it by a radian within the step
    h, step = 0.02, 1e-5
    A, B = model.linearise(states, inputs, h)
    for column in range(12):
        aside = step * np.eye(12)[column]
        after, before = (model.advance(states + k * aside, inputs, h) for k in (1.0, -1.0))
        # the point moves on within the step, which the frozen matrices leave out
        assert np.allclose(A[:, :, column], (after - before) / (2 * step), atol=0.02)
    for column in range(4):
        aside = step * np.eye(4)[column]
        after, before = (model.advance(states, inputs + k * aside, h) for k in (1.0, -1.0))
        assert np.allclose(B[:, :, column], (after - before) / (2 * step), atol=0.05)


def test_no_entry_stands_outside_the_structure() -> None:
    model = x500("x")
    A, B = model.linearise(*random_points(model, 30, seed=3), 0.05)
    where_a, where_b = structure()
    assert (A[:, where_a == 0.0] == 0.0).all()
    assert (B[:, where_b == 0.0] == 0.0).all()
    assert (where_a == 0.0).sum() > 50


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0])
def test_ned_and_back(yaw_deg: float) -> None:
    attitude = quat_from_euler(0.3, -0.2, np.radians(yaw_deg))
    given = ((1.0, 2.0, -3.0), (0.5, -0.4, 0.2), attitude, (0.1, -0.6, 0.9))
    back = ned_from_state(state_from_ned(*given))
    for found, expected in zip(back, given, strict=True):
        same = np.allclose(found, expected) or np.allclose(found, -np.array(expected))
        assert same


def test_the_angles_rates_are_their_derivatives() -> None:
    attitude, rate = quat_from_euler(0.4, 0.5, -1.0), (0.7, -0.9, 0.4)
    step_s = 1e-5
    now = state_from_ned((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), attitude, rate)
    soon = state_from_ned((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), quat_integrate(attitude, rate, step_s), rate)
    assert np.allclose((soon[ANGLES] - now[ANGLES]) / step_s, now[RATES], atol=1e-4)


def test_the_simulators_plant_goes_the_same_way() -> None:
    """Signs and rotors against the simulator's own airframe: a hundredth of a second of uneven rotors."""
    model = x500()
    plant = Quadrotor(load_airframe("x500").body)
    shares = (0.45, 0.52, 0.5, 0.55)
    state = QuadrotorState((0.0, 0.0, -5.0), thrust_share=shares)
    for _ in range(10):
        state = plant.step(state, shares, 0.001)
    speeds = model.config.max_rotor_speed_rad_s * np.sqrt(shares)
    ours = model.advance(np.array([0.0] * 4 + [5.0] + [0.0] * 7), model.inputs(speeds), 0.01)
    theirs = state_from_ned(
        state.position_ned_m, state.velocity_ned_m_s, state.attitude, state.rate_body_rad_s
    )
    assert np.allclose(ours, theirs, rtol=0.02, atol=2e-5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("layout: plus", "layout: hexa"), "model.layout: expected"),
        (
            ("max_rotor_speed_rad_s: 927.5", "max_rotor_speed_rad_s: 9"),
            "model.max_rotor_speed_rad_s: expected",
        ),
    ],
)
def test_a_wrong_model_is_refused_in_one_line(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    path = tmp_path / "vehicle.yaml"
    path.write_text(find_file("vehicles", "x500").read_text().replace(*change))
    with pytest.raises(ConfigError, match=said):
        load_quadrotor(path)


def test_a_vehicle_without_a_model_says_so(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.yaml"
    path.write_text(find_file("vehicles", "x500").read_text().split("model:")[0])
    with pytest.raises(ConfigError, match=r"vehicle.yaml: model: expected .* found none"):
        load_quadrotor(path)
