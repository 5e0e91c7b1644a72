"""The 31-state EKF: updates, gates, consistency of its covariance."""

import math

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    Quaternion,
    Vector3,
    quat_conjugate,
    quat_from_euler,
    quat_integrate,
    quat_multiply,
    quat_normalise,
    quat_rotate_inverse,
    rotation_vector_from_quat,
    scale,
    vector3,
    yaw_from_quat,
)
from companion.config import EkfConfig
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.ekf import VehicleEkf
from companion.estimate.vehicle.ekf_inputs import GpsStep, ImuStep
from companion.estimate.vehicle.ekf_start import InitialState
from tests.attitudes import between_deg
from tests.unit.estimate.at_rest import DOWN_FORCE, FIELD

ANTENNA = (0.1, 0.05, -0.05)


def new_ekf(attitude: Quaternion = IDENTITY, tilt_deg: float = 2.0, gyro_std: float = 5e-4) -> VehicleEkf:
    start = InitialState(
        0.0, attitude, (0.0, 0.0, 0.0), FIELD, math.radians(tilt_deg), math.radians(4.0), gyro_std
    )
    return VehicleEkf(EkfConfig(), ANTENNA, start)


def at_rest(attitude: Quaternion) -> ImuStep:
    field = quat_rotate_inverse(attitude, FIELD)
    return ImuStep((0.0, 0.0, 0.0), quat_rotate_inverse(attitude, DOWN_FORCE), 2, field)


def fix(position: Vector3 = (0.0, 0.0, 0.0), velocity: Vector3 = (0.0, 0.0, 0.0)) -> GpsStep:
    return GpsStep(position, velocity, (3.0, 3.0, 4.5), (0.15, 0.15, 0.2))


def busy(ekf: VehicleEkf, start: int, end: int, seed: int = 5) -> None:
    """Steps of 10 ms with everything noisy."""
    for k in range(start, end):
        rng = np.random.default_rng((seed, k))
        step = ImuStep(
            vector3(0.5 * rng.normal(size=3)),
            vector3(2.0 * rng.normal(size=3) + DOWN_FORCE),
            2,
            vector3(rng.normal(size=3) + FIELD) if k % 4 == 0 else None,
            quat_from_euler(*(0.05 * rng.normal(size=3))) if k % 10 == 0 else None,
        )
        ekf.apply(0.01 * k, step)
        if k % 20 == 0:
            noise = rng.normal(size=6)
            ekf.apply(0.01 * k + 0.003, fix(vector3(noise[:3]), vector3(0.1 * noise[3:])))


def test_covariance_stays_symmetric_and_positive_definite() -> None:
    ekf = new_ekf()
    for k in range(1, 6000, 500):
        busy(ekf, k, k + 500)
        assert np.array_equal(ekf.P, ekf.P.T) or np.abs(ekf.P - ekf.P.T).max() < 1e-12
        assert np.linalg.eigvalsh(ekf.P).min() > 0.0
        assert np.linalg.norm(ekf.x[model.QUATERNION]) == pytest.approx(1.0, abs=1e-12)


def test_euler_angles_and_their_covariance_follow_from_the_quaternion() -> None:
    ekf = new_ekf(quat_from_euler(0.1, -0.2, 2.0))
    busy(ekf, 1, 300)
    ekf.predict(ekf.time_s + 0.01, ((0.3, 0.2, -0.5), (0.0, 1.0, -9.0)))
    assert abs(np.dot(quat_from_euler(*ekf.x[model.EULER]), ekf.attitude)) == pytest.approx(1.0)
    J = model.euler_jacobian(ekf.attitude)
    quaternion = ekf.P[model.QUATERNION, model.QUATERNION]
    assert ekf.P[model.EULER, model.EULER] == pytest.approx(J @ quaternion @ J.T, abs=5e-9)
    assert ekf.P[model.EULER, model.QUATERNION] == pytest.approx(J @ quaternion, abs=5e-9)


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, 270])
def test_tilt_and_heading_converge_at_rest(yaw_deg: int) -> None:
    truth = quat_from_euler(0.05, -0.08, math.radians(yaw_deg))
    ekf = new_ekf(quat_multiply(quat_from_euler(0.03, -0.03, 0.06), truth))
    for k in range(1, 1500):
        step = at_rest(truth)
        ekf.apply(0.01 * k, step)
        if k % 20 == 0:
            ekf.apply(0.01 * k, fix())
    # from 4.2 degrees; a hidden accelerometer or magnetometer bias remains possible, and the filter knows
    error_deg, std_deg = between_deg(ekf.attitude, truth), math.degrees(2 * ekf.P.diagonal()[:4].sum() ** 0.5)
    assert error_deg < 1.8
    assert error_deg < 2.0 * std_deg < 8.0


def test_gyroscope_is_integrated_by_the_trapezoid_rule() -> None:
    ekf = new_ekf(tilt_deg=0.01)
    truth, yaw_s = IDENTITY, 1.0
    for k in range(1, 300):
        t = 0.01 * k
        # heading rate 3 sin(t * pi / 1.5): up to 6 rad/s²
        rate = 3.0 * math.sin(math.pi * t / 1.5)
        yaw_s = 3.0 * 1.5 / math.pi * (1.0 - math.cos(math.pi * t / 1.5))
        truth = quat_from_euler(0.0, 0.0, yaw_s)
        ekf.apply(t, ImuStep((0.0, 0.0, rate), DOWN_FORCE, 2))
    assert math.remainder(yaw_from_quat(ekf.attitude) - yaw_s, math.tau) == pytest.approx(0.0, abs=0.01)
    assert between_deg(ekf.attitude, truth) < 0.6


def test_steady_turn_loses_no_angle() -> None:
    ekf, truth = new_ekf(tilt_deg=0.01), IDENTITY
    for k in range(1, 1001):
        truth = quat_integrate(truth, (0.0, 0.0, 1.0), 0.01)
        ekf.apply(0.01 * k, ImuStep((0.0, 0.0, 1.0), DOWN_FORCE, 2))
    # 10 rad: a scale error of one part in a thousand would be 0.6 degrees
    assert between_deg(ekf.attitude, truth) < 0.5


def test_gyro_bias_is_found_while_standing_still() -> None:
    ekf = new_ekf(gyro_std=0.02)
    bias = (0.01, -0.008, 0.005)
    for k in range(1, 1000):
        still = ImuStep(bias, DOWN_FORCE, 2, still=k % 10 == 0, at_rest=k % 10 == 0)
        ekf.apply(0.01 * k, still)
    assert ekf.x[model.GYRO_BIAS] == pytest.approx(bias, abs=5e-4)
    assert ekf.x[model.VELOCITY] == pytest.approx([0.0, 0.0, 0.0], abs=0.02)


def test_first_fix_places_the_antenna_and_not_the_centre_of_mass() -> None:
    ekf = new_ekf(quat_from_euler(0.0, 0.0, math.pi / 2))
    ekf.apply(0.01, at_rest(ekf.attitude))
    ekf.apply(0.02, fix((5.0, 6.0, -7.0), (1.0, 2.0, 3.0)))
    # heading east: 0.1 m forward is east, 0.05 m to the right is south
    assert ekf.x[model.POSITION] == pytest.approx([5.05, 5.9, -6.95], abs=0.02)
    assert ekf.x[model.VELOCITY] == pytest.approx([1.0, 2.0, 3.0])


def test_a_wild_fix_is_refused() -> None:
    ekf = new_ekf()
    busy(ekf, 1, 400)
    before = ekf.x[model.POSITION].copy()
    ekf.apply(ekf.time_s, fix((300.0, 0.0, 0.0)))
    assert ekf.x[model.POSITION] == pytest.approx(before, abs=0.5)
    assert ekf.gates["gps_position"].refused == 1


def test_fixes_that_insist_are_believed_in_the_end() -> None:
    ekf = new_ekf()
    busy(ekf, 1, 400)
    for k in range(20):
        ekf.apply(4.0 + 0.2 * k, fix((300.0, 0.0, 0.0)))
    assert ekf.x[model.POSITION][0] == pytest.approx(300.0, abs=5.0)


def test_wrong_orientation_and_field_are_refused() -> None:
    ekf = new_ekf()
    busy(ekf, 1, 400)
    before, other = ekf.attitude, new_ekf()
    other.restore(ekf.snapshot())
    spun = quat_multiply(quat_from_euler(0.0, 0.0, 2.5), before)
    step = ImuStep((0.0, 0.0, 0.0), DOWN_FORCE, 2, scale(FIELD, -1.0), spun)
    ekf.apply(ekf.time_s, step)
    other.apply(other.time_s, ImuStep((0.0, 0.0, 0.0), DOWN_FORCE, 2))
    assert np.array_equal(ekf.x, other.x), "as if only the IMU had spoken"
    for kind in ("mag", "orientation"):
        assert ekf.gates[kind].refused == other.gates[kind].refused + 1


def test_sign_of_the_measured_quaternion_does_not_matter() -> None:
    one, two = new_ekf(), new_ekf()
    q = quat_from_euler(0.02, 0.01, 0.03)
    one.apply(0.01, ImuStep((0, 0, 0), DOWN_FORCE, 2, None, q))
    two.apply(0.01, ImuStep((0, 0, 0), DOWN_FORCE, 2, None, (-q[0], -q[1], -q[2], -q[3])))
    assert np.array_equal(one.x, two.x)


def test_snapshot_does_not_change_while_the_filter_goes_on() -> None:
    ekf = new_ekf()
    busy(ekf, 1, 100)
    snapshot = ekf.snapshot()
    x, P = snapshot.x.copy(), snapshot.P.copy()
    busy(ekf, 100, 200)
    assert np.array_equal(snapshot.x, x)
    assert np.array_equal(snapshot.P, P)


def test_the_motions_covariance_is_that_of_errors_drawn_from_the_states() -> None:
    ekf = new_ekf(quat_from_euler(0.1, -0.2, 2.0))
    busy(ekf, 1, 200)
    rng = np.random.default_rng(3)
    drawn = []
    for state in rng.multivariate_normal(ekf.x, ekf.P, 20000, method="cholesky"):
        q = quat_normalise(model.quaternion_of(state))
        rotation = rotation_vector_from_quat(quat_multiply(q, quat_conjugate(ekf.attitude)))
        moved = [state[part] - ekf.x[part] for part in (model.VELOCITY, model.POSITION)]
        drawn.append(np.concatenate([rotation, *moved]))
    found, claimed = np.cov(np.array(drawn).T), ekf.motion_covariance()
    scale_of = np.sqrt(np.outer(claimed.diagonal(), claimed.diagonal()))
    assert (found / scale_of) == pytest.approx(claimed / scale_of, abs=0.03)
    assert claimed[:3, :3] == pytest.approx(ekf.rotation_covariance())


def test_a_fix_without_vertical_speed_leaves_the_climb_rate_to_the_accelerometer() -> None:
    ekf = new_ekf()
    ekf.apply(0.01, fix())
    start_std = math.sqrt(ekf.P[15, 15])
    for k in range(1, 500):
        # it climbs with 0.5 m/s² for a second, then steadily
        lift = (0.0, 0.0, -GRAVITY_M_S2 - (0.5 if k <= 100 else 0.0))
        ekf.apply(0.01 * (k + 1), ImuStep((0.0, 0.0, 0.0), lift, 2, FIELD))
        if k % 20 == 0:
            elapsed_s = 0.01 * k
            height_m = 0.25 * elapsed_s**2 if elapsed_s <= 1.0 else 0.25 + 0.5 * (elapsed_s - 1.0)
            place = (ANTENNA[0], ANTENNA[1], ANTENNA[2] - height_m)
            ekf.apply(
                0.01 * (k + 1) + 1e-4, GpsStep(place, (0.0, 0.0, 0.0), (3.0, 3.0, 4.5), (0.15, 0.15, 50.0))
            )
    assert ekf.x[15] == pytest.approx(-0.5, abs=0.1)
    assert start_std < 0.5


def test_the_first_fix_keeps_the_climb_rate_that_it_does_not_know() -> None:
    ekf = new_ekf()
    before = ekf.P[15, 15]
    ekf.apply(0.01, GpsStep(ANTENNA, (1.0, 2.0, 0.0), (3.0, 3.0, 4.5), (0.15, 0.15, 50.0)))
    assert vector3(ekf.x[model.VELOCITY]) == pytest.approx((1.0, 2.0, 0.0))
    assert ekf.P[13, 13] == pytest.approx(0.15**2)
    assert ekf.P[15, 15] == pytest.approx(before, rel=0.2)
    known = new_ekf()
    known.apply(0.01, fix(velocity=(1.0, 2.0, -1.0)))
    assert known.x[15] == -1.0
