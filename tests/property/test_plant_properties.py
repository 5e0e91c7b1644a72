"""What holds for the plant whatever the state: norms, momenta, energies."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3, matrix_from_quat, norm, quat_from_euler
from sitl.pad.motion import PadTruth, build_pad_motion
from sitl.pad.paths import FigureEightMotion
from sitl.scenario.scenario import load_airframe
from sitl.vehicle.quadrotor import Quadrotor, QuadrotorState, RotorValues
from sitl.world.contact import Contact
from sitl.world.ground import PadBoard, thrust_ratio

DT = 0.0025
X500 = load_airframe("x500")
SMOOTH = X500.body.model_copy(
    update={
        "inertia_kg_m2": (0.012, 0.02, 0.03),
        "rotor_drag_plane_n_s2_m_rad": 0.0,
        "rotor_inflow_loss_n_s2_m_rad": 0.0,
        "body_drag_area_m2": 0.0,
    }
)
OFF: RotorValues = (0.0, 0.0, 0.0, 0.0)

angles = st.floats(-3.0, 3.0)
speeds = st.tuples(*[st.floats(-8.0, 8.0)] * 3)
rates = st.tuples(*[st.floats(-6.0, 6.0)] * 3)
shares = st.tuples(*[st.floats(0.0, 1.0)] * 4)
attitudes = st.builds(quat_from_euler, angles, st.floats(-1.5, 1.5), angles)


def energy(vehicle: Quadrotor, state: QuadrotorState, inertia: Vector3) -> float:
    v, w = state.velocity_ned_m_s, state.rate_body_rad_s
    turning = 0.5 * sum(i * x * x for i, x in zip(inertia, w, strict=True))
    height = -state.position_ned_m[2]
    return 0.5 * vehicle.mass_kg * norm(v) ** 2 + turning + vehicle.mass_kg * GRAVITY_M_S2 * height


@given(attitude=attitudes, rate=rates, velocity=speeds, share=shares, command=shares)
@settings(max_examples=30, deadline=None)
def test_the_quaternion_stays_a_unit_and_everything_finite(
    attitude: tuple[float, float, float, float],
    rate: Vector3,
    velocity: Vector3,
    share: RotorValues,
    command: RotorValues,
) -> None:
    vehicle = Quadrotor(X500.body)
    state = QuadrotorState((0.0, 0.0, -50.0), velocity, attitude, rate, share)
    for _ in range(40):
        state = vehicle.step(state, command, DT, wind_ned_m_s=(5.0, -3.0, 1.0))
        assert math.isclose(sum(x * x for x in state.attitude), 1.0, abs_tol=1e-12)
        assert all(0.0 <= s <= 1.0 for s in state.thrust_share)
    assert all(map(math.isfinite, state.position_ned_m + state.velocity_ned_m_s + state.rate_body_rad_s))


@given(attitude=attitudes, rate=rates, velocity=speeds)
@settings(max_examples=20, deadline=None)
def test_a_free_body_keeps_its_energy_and_its_angular_momentum(
    attitude: tuple[float, float, float, float], rate: Vector3, velocity: Vector3
) -> None:
    vehicle, inertia = Quadrotor(SMOOTH), SMOOTH.inertia_kg_m2
    state = QuadrotorState((0.0, 0.0, -50.0), velocity, attitude, rate)

    def momentum(s: QuadrotorState) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return np.asarray(matrix_from_quat(s.attitude) @ (np.array(inertia) * np.array(s.rate_body_rad_s)))

    before, turning = energy(vehicle, state, inertia), momentum(state)
    for _ in range(200):
        state = vehicle.step(state, OFF, DT)
    assert energy(vehicle, state, inertia) == pytest.approx(before, rel=1e-7)
    np.testing.assert_allclose(momentum(state), turning, atol=1e-6)


@given(attitude=attitudes, rate=rates, velocity=speeds)
@settings(max_examples=20, deadline=None)
def test_still_air_only_ever_takes_energy(
    attitude: tuple[float, float, float, float], rate: Vector3, velocity: Vector3
) -> None:
    vehicle, inertia = Quadrotor(X500.body), X500.body.inertia_kg_m2
    state = QuadrotorState((0.0, 0.0, -50.0), velocity, attitude, rate)
    last = energy(vehicle, state, inertia)
    for _ in range(100):
        state = vehicle.step(state, OFF, DT)
        now = energy(vehicle, state, inertia)
        assert now <= last + 1e-6
        last = now


@given(
    roll=st.floats(-0.4, 0.4),
    pitch=st.floats(-0.4, 0.4),
    yaw=angles,
    down=st.floats(0.0, 2.0),
    north=st.floats(-1.5, 1.5),
)
@settings(max_examples=25, deadline=None)
def test_legs_never_give_back_more_than_they_took_and_come_to_rest(
    roll: float, pitch: float, yaw: float, down: float, north: float
) -> None:
    vehicle, inertia = Quadrotor(X500.body), X500.body.inertia_kg_m2
    contact = Contact(X500.legs, X500.body.mass_kg, PadBoard(0.5, 0.5), ())
    pad = PadTruth(0.0, (100.0, 0.0, -0.1), ZERO3, ZERO3, 0.0, 0.0)
    state = QuadrotorState((0.0, 0.0, -0.32), (north, 0.0, down), quat_from_euler(roll, pitch, yaw))
    started = energy(vehicle, state, inertia)
    for _ in range(1000):
        load = contact.step(state, pad, DT)
        state = vehicle.step(
            state, OFF, DT, force_ned_n=load.force_ned_n, torque_body_n_m=load.torque_body_n_m
        )
        assert energy(vehicle, state, inertia) <= started + 0.02
    assert norm(state.velocity_ned_m_s) < 0.01
    assert norm(state.rate_body_rad_s) < 0.02


@given(height=st.floats(-1.0, 20.0), radius=st.floats(0.03, 0.5))
@settings(max_examples=100)
def test_ground_effect_helps_and_by_no_more_than_a_third(height: float, radius: float) -> None:
    assert 1.0 <= thrust_ratio(height, radius) <= 4.0 / 3.0 + 1e-12


@given(seed=st.integers(0, 10_000), speed=st.floats(0.2, 4.0), size=st.floats(2.0, 30.0), t=st.floats(0, 600))
@settings(max_examples=50, deadline=None)
def test_a_figure_of_eight_of_any_size_has_its_speed(seed: int, speed: float, size: float, t: float) -> None:
    motion = FigureEightMotion(kind="figure_8", speed_m_s=speed, half_length_m=size)
    pad = build_pad_motion(motion, 0.3, "along", np.random.default_rng(seed)).at(t)
    assert norm(pad.velocity_ned_m_s) == pytest.approx(speed, rel=1e-7)
    assert norm(pad.acceleration_ned_m_s2) <= 3.0 * speed**2 / size * (1.0 + 1e-9)
