"""The pad's scale by a second source: how a pad of another size seems to move, and the echoes over it."""

import math
import pickle

import numpy as np
import pytest

from companion.base.geometry import IDENTITY, Vector3, add, cross, vector3
from companion.base.geometry import scale as scaled
from companion.base.messages import Quantity, SourceComparison
from companion.base.second_sources import TABLE
from companion.config.estimate import PadFilterConfig
from companion.estimate.motion import LEVER_STD_M, MotionHistory
from companion.estimate.pad.camera_check import CameraCheck
from companion.estimate.pad.pad_types import HeightMeasurement
from tests.unit.estimate.pad.pad_sway import Sway, sightings

ROW = TABLE[Quantity.PAD_SCALE]
SWAYS = Sway(0.0, roll_rad=0.15)  # as a vehicle that chases a pad
HOVERS = Sway(0.0, height_m=1.5, roll_rad=0.02, pad_speed_m_s=0.0)


def compared(
    sway: Sway,
    printed: float,
    *,
    echoes: bool = False,
    spikes: float = 0.0,
    duration_s: float = 12.0,
    arm_std_m: float = LEVER_STD_M,
    wanders_m: float = 0.0,
    turned_rad: Vector3 = (0.0, 0.0, 0.0),
    deeper: float = 0.0,
    echo_noise_m: float = 0.03,
    seed: int = 3,
) -> SourceComparison:
    """What is found in a flight over a pad that is printed so large, as a share of its file's size.

    `arm_std_m`: so well the IMU's place is known. `wanders_m`: by so much, from one second to the next, what
    is seen is wrong. `turned_rad` and `deeper`: the camera is turned by so much (body), and shows the pad
    deeper by this share.
    """
    motion, rng = MotionHistory(3.0), np.random.default_rng(seed)
    wrong_m = wanders_m * rng.standard_normal(3)
    motion.imu_covariance_m2 = arm_std_m**2 * np.eye(3)
    check = CameraCheck(motion, PadFilterConfig(range_noise_m=echo_noise_m), 0.65)
    for k, (exposed_s, (x, y, z)) in enumerate(sightings(sway, motion, duration_s)):
        if echoes and k % 2:
            attitude = sway.attitude(exposed_s)
            away_m = 2.0 * (attitude[1] * y - attitude[2] * x) + z  # down, to the first order
            spike = rng.uniform() if rng.uniform() < spikes else 1.0
            echo_m = spike * away_m + 0.02 * rng.standard_normal()
            check.take_echo(exposed_s, HeightMeasurement(float(echo_m), (0.0, 0.0, 0.0), echo_noise_m))
        wrong_m += (wanders_m * math.sqrt(2.0 / 30.0)) * rng.standard_normal(3) - wrong_m / 30.0
        shown = add((x, y, z * (1.0 + deeper)), cross(turned_rad, (x, y, z)))
        seen = scaled(add(shown, vector3(wrong_m.tolist())), 1.0 / printed)
        check.take(exposed_s + check.delay_s, seen, (sway.noise_m / printed) ** 2)
    return next(found for found in check.comparisons if found.quantity is Quantity.PAD_SCALE)


@pytest.mark.parametrize("pad_speed_m_s", [0.0, 1.0])
def test_a_pad_printed_at_71_percent_is_refused_by_its_motion_alone(pad_speed_m_s: float) -> None:
    # flown: a slow chase at up to 29 deg; in small fast swings an IMU that is 5 cm off would explain as much
    sway = Sway(0.0, roll_rad=0.4, pad_speed_m_s=pad_speed_m_s, swing_rad_s=3.0)
    found = compared(sway, 0.71)
    assert ROW.refuses(found)
    assert found.first == "100 %"
    assert float(found.second.removesuffix(" %")) == pytest.approx(71.0, abs=8.0)


def test_it_is_refused_in_small_fast_swings_too_where_the_accelerometers_place_is_known() -> None:
    found = compared(SWAYS, 0.71, duration_s=45.0, arm_std_m=0.003)
    assert ROW.refuses(found)
    assert float(found.second.removesuffix(" %")) == pytest.approx(71.0, abs=8.0)


@pytest.mark.parametrize(
    "sway",
    [
        *(SWAYS, HOVERS, Sway(0.0), Sway(0.0, height_m=7.0, noise_m=0.03), Sway(0.03)),
        *(Sway(-0.04, height_m=6.0), Sway(0.0, pad_speed_m_s=4.0), Sway(0.0, pad_acceleration_m_s2=1.5)),
        Sway(0.0, roll_rad=0.0),
    ],
    ids=str,
)
def test_a_pad_of_its_size_is_not_announced(sway: Sway) -> None:
    assert not ROW.announces(compared(sway, 1.0))


def test_errors_that_wander_for_a_second_are_known_to_make_the_scale_unsure() -> None:
    sway = Sway(0.0, height_m=7.0, noise_m=0.02)
    found = [compared(sway, 1.0, wanders_m=0.1, seed=seed) for seed in range(12)]
    assert [each for each in found if ROW.refuses(each)] == []
    # 95 % of chi-squared with twelve degrees of freedom
    assert sum((each.difference / each.std) ** 2 for each in found) <= 21.0


def test_what_is_kept_does_not_grow_with_the_time_over_a_pad() -> None:
    """A vehicle that waits on its pad sees it all day, and the table is asked in every cycle."""
    motion, rng, sizes = MotionHistory(1.0), np.random.default_rng(5), []
    check = CameraCheck(motion, PadFilterConfig(), 0.65)
    for k in range(2400):
        motion.add(0.1 * k, IDENTITY, vector3((0.03 * rng.normal(size=3)).tolist()))
        check.take(0.1 * k, vector3((np.array([0.1, 0.0, 0.3]) + 0.002 * rng.normal(size=3)).tolist()), 4e-6)
        if k in (1199, 2399):
            kept = {name: value for name, value in vars(check).items() if value is not motion}
            sizes.append(len(pickle.dumps(kept)))
    assert sizes[1] == pytest.approx(sizes[0], abs=64)


@pytest.mark.parametrize("swing_rad_s", [1.5, 3.0, 6.0])
def test_a_camera_that_is_turned_and_has_another_focal_length_is_no_scale(swing_rad_s: float) -> None:
    sway = Sway(0.0, height_m=7.0, roll_rad=0.4, swing_rad_s=swing_rad_s, noise_m=0.01)
    for sign in (-1.0, 1.0):
        found = compared(sway, 1.0, turned_rad=(sign * 0.026, 0.01, sign * 0.03), deeper=sign * 0.013)
        assert not ROW.refuses(found)
        assert found.difference <= min(10.0, 2.5 * found.std)


@pytest.mark.parametrize("imu_m", [(0.0, 0.0, 0.1), (0.0, 0.0, -0.1), (0.06, -0.08, 0.0)], ids=str)
def test_an_imu_that_swings_about_the_centre_of_mass_is_no_scale(imu_m: Vector3) -> None:
    found = compared(Sway(0.0, roll_rad=0.15, imu_m=imu_m), 1.0)
    assert found.difference <= 2.0 * found.std
    assert not ROW.announces(found)


@pytest.mark.parametrize(("printed", "refuses"), [(0.93, True), (1.07, True), (0.96, False), (1.04, False)])
def test_over_the_board_echoes_tell_a_few_percent(printed: float, refuses: bool) -> None:
    found = compared(HOVERS, printed, echoes=True, duration_s=20.0)
    assert found.difference == pytest.approx(100.0 * abs(printed - 1.0), abs=0.7)
    assert ROW.announces(found)
    assert ROW.refuses(found) is refuses


def test_echoes_of_a_rough_pad_tell_the_scale_too() -> None:
    found = compared(HOVERS, 0.93, echoes=True, duration_s=20.0, echo_noise_m=0.06)
    assert found.difference == pytest.approx(7.0, abs=1.0)
    assert ROW.refuses(found)


@pytest.mark.parametrize("spikes", [0.0, 0.3])
def test_a_pad_of_its_size_agrees_with_its_echoes(spikes: float) -> None:
    assert not ROW.announces(compared(HOVERS, 1.0, echoes=True, spikes=spikes))
    assert not ROW.announces(compared(HOVERS, 0.99, echoes=True, spikes=spikes))
