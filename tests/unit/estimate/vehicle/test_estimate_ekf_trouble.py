"""The 31-state EKF in trouble: blows, wandering and late fixes, iron, a lost attitude, a bias that steps."""

import math

import numpy as np
import pytest

from companion.base.geometry import (
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    add,
    euler_from_quat,
    norm,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_integrate,
    quat_multiply,
    quat_rotate_inverse,
    rotation_vector_from_quat,
    scale,
    vector3,
    yaw_from_quat,
)
from companion.config import EkfConfig
from companion.estimate.gating import Timeline
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.ekf import VehicleEkf
from companion.estimate.vehicle.ekf_inputs import GpsStep, ImuStep
from companion.estimate.vehicle.ekf_start import InitialState
from companion.estimate.vehicle.gyro_bias_check import BiasStep
from companion.estimate.vehicle.imu_noise import STEADY, StepNoise
from tests.attitudes import DEGREE, between_deg
from tests.unit.estimate.at_rest import DOWN_FORCE, FIELD

STD_M, STD_M_S = (3.0, 3.0, 4.5), (0.15, 0.15, 0.2)


def new_ekf(config: EkfConfig | None = None, attitude: Quaternion = IDENTITY) -> VehicleEkf:
    start = InitialState(0.0, attitude, ZERO3, FIELD, 2 * DEGREE, 4 * DEGREE, 5e-4)
    return VehicleEkf(config or EkfConfig(), ZERO3, start)


def hover(ekf: VehicleEkf, seconds: float, force: Vector3 = DOWN_FORCE, fixes: bool = True) -> None:
    """Level, heading north, at rest: IMU at 100 Hz, field at 25 Hz, fixes at 5 Hz."""
    start_s = ekf.time_s
    for k in range(1, round(seconds * 100) + 1):
        t = start_s + 0.01 * k
        ekf.apply(t, ImuStep(ZERO3, force, 2, FIELD if k % 4 == 0 else None))
        if fixes and k % 20 == 0:
            ekf.apply(t, GpsStep(ZERO3, ZERO3, STD_M, STD_M_S))


def tilt_deg(ekf: VehicleEkf) -> float:
    roll, pitch, _ = euler_from_quat(ekf.attitude)
    return math.degrees(math.hypot(roll, pitch))


def std_deg(ekf: VehicleEkf) -> Vector3:
    """Of the attitude about north, east and down."""
    return vector3(np.degrees(np.sqrt(ekf.rotation_covariance().diagonal())))


# ------------------------------------------------------------ blows


@pytest.mark.parametrize("force", [(60.0, 0.0, -9.8), (0.0, -40.0, -90.0), (20.0, 20.0, 0.0)])
def test_a_touchdowns_blow_does_not_turn_the_attitude(force: Vector3) -> None:
    ekf = new_ekf()
    hover(ekf, 10.0)
    for _ in range(3):
        ekf.apply(ekf.time_s + 0.01, ImuStep(ZERO3, force, 2))
        assert tilt_deg(ekf) < 0.5
    assert norm(vector3(ekf.x[model.ACCEL_BIAS])) < 0.1


def test_a_fix_in_a_blow_hardly_counts() -> None:
    struck, calm = new_ekf(), new_ekf()
    shifts = []
    for ekf, force in ((struck, (150.0, 0.0, -9.8)), (calm, DOWN_FORCE)):
        hover(ekf, 5.0)
        ekf.apply(ekf.time_s + 0.01, ImuStep(ZERO3, force, 2))
        before = ekf.x[model.VELOCITY][0]
        ekf.apply(ekf.time_s, GpsStep(ZERO3, (before + 0.2, 0.0, 0.0), STD_M, STD_M_S))
        shifts.append(ekf.x[model.VELOCITY][0] - before)
    assert shifts[1] > 0.02
    assert abs(shifts[0]) < 0.1 * shifts[1]


# ------------------------------------------------------------ vibration


@pytest.mark.parametrize("seed", range(3))
def test_shaking_neither_turns_the_attitude_nor_tells_anything_of_it(seed: int) -> None:
    """Forces of 10 m/s² while it turns: taken for measurements, they would show a heading."""
    rng = np.random.default_rng(seed)
    ekf, truth = new_ekf(), IDENTITY
    doubt = std_deg(ekf)
    for k in range(1, 2001):
        rate = (0.8 * math.sin(0.02 * k), 0.5 * math.cos(0.013 * k), 0.7)
        truth = quat_integrate(truth, rate, 0.01)
        force = add(quat_rotate_inverse(truth, DOWN_FORCE), vector3(10.0 * rng.normal(size=3)))
        ekf.apply(0.01 * k, ImuStep(rate, force, 2))
    assert between_deg(truth, ekf.attitude) < 0.001
    for after, before in zip(std_deg(ekf), doubt, strict=True):
        assert after >= before - 1e-6


def test_a_gap_in_the_imus_stream_widens_velocity_and_attitude() -> None:
    gap, none = new_ekf(), new_ekf()
    for ekf in (gap, none):
        hover(ekf, 5.0)
    gap.apply(5.4, ImuStep(ZERO3, DOWN_FORCE, 2))
    hover(none, 0.4, fixes=False)
    for part in (slice(3), slice(3, 6)):
        variances = [ekf.motion_covariance().diagonal()[part].sum() for ekf in (gap, none)]
        assert variances[0] > 4.0 * variances[1]


# ------------------------------------------------------------ field


def turned_by_a_field(error_body_ut: Vector3) -> Vector3:
    """Rotation vector (degrees) that 5 s of a field with an error make."""
    ekf, every = new_ekf(), round(100.0 / EkfConfig().mag_rate_hz)
    for k in range(1, 501):
        field = add(FIELD, error_body_ut) if k % every == 0 else None
        ekf.apply(0.01 * k, ImuStep(ZERO3, DOWN_FORCE, 2, field))
    return scale(rotation_vector_from_quat(ekf.attitude), 1.0 / DEGREE)


def test_a_field_along_its_vertical_plane_turns_nothing_and_across_it_the_heading() -> None:
    north, down = turned_by_a_field((6.0, 0.0, 0.0)), turned_by_a_field((0.0, 0.0, 6.0))
    east = turned_by_a_field((0.0, 6.0, 0.0))
    assert norm(north) < 0.5
    assert norm(down) < 0.5
    assert abs(east[2]) > 3.0
    assert math.hypot(east[0], east[1]) < abs(east[2])


@pytest.mark.parametrize("attitude", [IDENTITY, quat_from_euler(0.3, -0.2, 2.0)])
def test_a_field_mends_the_heading_and_leaves_the_tilts_doubt(attitude: Quaternion) -> None:
    start = InitialState(0.0, attitude, ZERO3, FIELD, 2 * DEGREE, 40 * DEGREE, 5e-4)
    ekf = VehicleEkf(EkfConfig(), ZERO3, start)
    before = std_deg(ekf)
    for k in range(1, 26):
        ekf.apply(1e-6 * k, ImuStep(ZERO3, ZERO3, 1, quat_rotate_inverse(attitude, FIELD)))
    after = std_deg(ekf)
    assert after[2] < 0.5 * before[2]
    assert after[1] > 0.8 * before[1], "about east: the dip"


def test_many_fields_that_are_off_alike_tell_hardly_more_than_one() -> None:
    stds = {}
    for wander_s in (0.0, 4.0):
        start = InitialState(0.0, IDENTITY, ZERO3, FIELD, 2 * DEGREE, 10 * DEGREE, 5e-4)
        ekf = VehicleEkf(EkfConfig(mag_wander_s=wander_s, mag_rate_hz=25.0), ZERO3, start)
        for k in range(1, 51):
            ekf.apply(1e-6 * k, ImuStep(ZERO3, DOWN_FORCE, 1, add(FIELD, (10.0, 0.0, 0.0))))
        stds[wander_s] = std_deg(ekf)[2]
    assert stds[4.0] > 1.5 * stds[0.0]


@pytest.mark.parametrize("deck_ned_ut", [(0.0, 26.0, 0.0), (0.0, -26.0, 0.0), (-5.6, -18.2, -9.6)])
@pytest.mark.parametrize("noise", [STEADY, StepNoise(rate_density_rad2_s=2e-5)])
def test_a_steel_deck_turns_the_field_and_hardly_the_heading(deck_ned_ut: Vector3, noise: StepNoise) -> None:
    """Down to 30 cm over it in 5 s and 10 s there, as a dipole's field grows: the gyroscope sees no turn."""
    ekf = new_ekf()
    hover(ekf, 10.0)
    errors, stds = [], []
    for k in range(1, 1501):
        distance_m = max(5.0 - 0.0094 * k, 0.3)
        field = add(FIELD, scale(deck_ned_ut, 1.0 / (1.0 + distance_m**3)))
        t = 10.0 + 0.01 * k
        ekf.apply(t, ImuStep(ZERO3, DOWN_FORCE, 2, field if k % 10 == 0 else None, noise=noise))
        errors.append(abs(yaw_from_quat(ekf.attitude)) / DEGREE)
        stds.append(std_deg(ekf)[2])
    assert max(errors) < 5.0
    assert max(np.array(errors) / stds) < 3.0


# ------------------------------------------------------------ fixes


def test_minutes_of_wandering_fixes_leave_a_metres_doubt_of_the_position_and_not_of_the_velocity() -> None:
    config = EkfConfig(gps_wander_s=60.0)
    wandering, white = new_ekf(config), new_ekf(EkfConfig(gps_wander_s=0.0))
    stds = []
    for ekf in (wandering, white):
        # it stands off by 2 m for five minutes; few, long steps of the IMU keep the test short
        for k in range(1, 1501):
            t = 0.2 * k
            for part in range(1, 5):
                ekf.apply(t - 0.2 + 0.05 * part, ImuStep(ZERO3, DOWN_FORCE, 10))
            ekf.apply(t, GpsStep((2.0, 0.0, 0.0), ZERO3, STD_M, STD_M_S))
        stds.append(np.sqrt(ekf.P.diagonal()))
    position, velocity = stds[0][model.POSITION], stds[0][model.VELOCITY]
    assert position[:2].min() > 0.5
    assert position[:2].min() > 3.0 * stds[1][model.POSITION][0]
    assert velocity.max() < 0.15


def moving(t: float) -> GpsStep:
    return GpsStep((2.0 * t, -t, 0.0), (2.0, -1.0, 0.0), STD_M, STD_M_S)


def feed_moving(timeline: Timeline[object, object], delay_s: float) -> None:
    """Steps of the IMU every 20 ms, and fixes between two of them that arrive later."""
    fixes = [0.2 * k + 0.007 for k in range(1, 20)]
    arriving = [(0.02 * k, None) for k in range(1, 240)] + [(t + delay_s, t) for t in fixes]
    for arrival_s, measured_s in sorted(arriving, key=lambda item: item[0]):
        if measured_s is None:
            timeline.add(arrival_s, ImuStep((0.1, -0.1, 0.2), DOWN_FORCE, 4))
        else:
            timeline.add(measured_s, moving(measured_s))


@pytest.mark.parametrize(("delay_s", "stds"), [(0.03, 0.03), (0.25, 0.25), (0.5, 0.5)])
def test_a_late_fix_gives_nearly_what_it_would_have_given_on_time(delay_s: float, stds: float) -> None:
    """Forces and fixes that contradict one another: what a fix changes is more than in any flight."""
    on_time, late = new_ekf(), new_ekf()
    feed_moving(Timeline(on_time, 0.6, on_time.carried), 0.0)  # type: ignore[arg-type]
    feed_moving(Timeline(late, 0.6, late.carried), delay_s)  # type: ignore[arg-type]
    std = np.sqrt(on_time.P.diagonal())
    assert np.abs((late.x - on_time.x) / std).max() < stds
    assert np.sqrt(late.P.diagonal()) / std == pytest.approx(1.0, abs=0.02)
    assert np.linalg.eigvalsh(late.P).min() > 0.0


def test_a_fix_between_two_steps_is_compared_with_the_state_at_its_own_time() -> None:
    ekf = new_ekf()
    ekf.apply(0.0, moving(0.0))
    ekf.apply(0.02, ImuStep(ZERO3, DOWN_FORCE, 2))
    before = ekf.x.copy()
    # 80 ms at 2 m/s: a fix taken for one at the state's time would pull
    ekf.apply(0.1, GpsStep((0.2, -0.1, 0.0), (2.0, -1.0, 0.0), (0.01, 0.01, 0.01), STD_M_S))
    assert ekf.x[model.POSITION] == pytest.approx(before[model.POSITION], abs=0.005)
    assert ekf.time_s == 0.02


# ------------------------------------------------------------ a lost attitude, a bias that steps


def test_a_lost_attitude_starts_again_from_the_pre_filter_after_its_timeout() -> None:
    config, truth = EkfConfig(orientation_timeout_s=3.0), quat_from_euler(0.05, 0.0, 2.5)
    ekf = new_ekf(config)
    force = quat_rotate_inverse(truth, DOWN_FORCE)
    for k in range(1, 321):
        attitude = truth if k % 10 == 0 else None
        ekf.apply(0.01 * k, ImuStep(ZERO3, force, 2, None, attitude, 0.05, 0.1))
        if k == 300:
            assert abs(yaw_from_quat(ekf.attitude)) < 0.3, "still patient"
    assert between_deg(truth, ekf.attitude) < 2.0
    assert 1.0 < std_deg(ekf)[2] < 8.0, "as sure as the pre-filter"
    assert ekf.gates["orientation"].refused_in_a_row == 0


def test_a_pre_filter_that_disagrees_at_times_does_not_move_the_attitude() -> None:
    ekf = new_ekf()
    wrong, right = quat_from_euler(0.0, 0.0, 2.5), IDENTITY
    for k in range(1, 1001):
        attitude = (right if k % 200 == 0 else wrong) if k % 10 == 0 else None
        ekf.apply(0.01 * k, ImuStep(ZERO3, DOWN_FORCE, 2, None, attitude, 0.05, 0.1))
    assert abs(yaw_from_quat(ekf.attitude)) < 4 * DEGREE


def test_a_bias_step_sets_the_bias_and_turns_the_attitude_back() -> None:
    """The bias is that of the autopilot's turns, and what both knew of it before counts for a twentieth."""
    ekf = new_ekf(attitude=quat_from_euler(0.1, -0.05, 1.0))
    hover(ekf, 0.1, fixes=False)
    bias, before = (0.0, 2 * DEGREE, -DEGREE), ekf.attitude
    turned = scale(bias, 1.2)
    doubt = std_deg(ekf)
    ekf.apply(ekf.time_s, BiasStep(bias, 1.2))
    assert ekf.x[model.GYRO_BIAS] == pytest.approx(bias, abs=0.1 * DEGREE)
    back = quat_multiply(ekf.attitude, quat_from_rotation_vector(turned))
    assert between_deg(before, back) < 0.15
    assert ekf.x[model.EULER] == pytest.approx(euler_from_quat(ekf.attitude))
    for after, earlier in zip(std_deg(ekf), doubt, strict=True):
        assert 0.5 < math.sqrt(after**2 - earlier**2) < 1.5
    assert np.sqrt(ekf.P.diagonal()[model.GYRO_BIAS]) == pytest.approx(0.3 * DEGREE, rel=0.05)
    assert np.linalg.eigvalsh(ekf.P).min() > 0.0


def test_after_a_bias_step_the_stepped_gyroscope_keeps_the_attitude() -> None:
    ekf = new_ekf()
    hover(ekf, 5.0)
    bias = (2 * DEGREE, 0.0, 0.0)
    ekf.apply(ekf.time_s, BiasStep(bias, 0.0))
    for k in range(1, 301):
        ekf.apply(5.0 + 0.01 * k, ImuStep(bias, DOWN_FORCE, 2, FIELD if k % 4 == 0 else None))
    assert tilt_deg(ekf) < 0.7


def test_fixes_that_stray_open_the_filter_for_another_bias() -> None:
    ekf = new_ekf()
    hover(ekf, 5.0)
    before = ekf.P.diagonal()[model.GYRO_BIAS].max()
    bias, widest = (3 * DEGREE, 0.0, 0.0), 0.0
    for k in range(1, 601):
        ekf.apply(5.0 + 0.01 * k, ImuStep(bias, DOWN_FORCE, 2))
        if k % 20 == 0:
            ekf.apply(ekf.time_s, GpsStep(ZERO3, ZERO3, STD_M, STD_M_S))
        widest = max(widest, ekf.P.diagonal()[model.GYRO_BIAS].max())
    assert widest > 100.0 * before
    assert ekf.x[model.GYRO_BIAS][0] > DEGREE
