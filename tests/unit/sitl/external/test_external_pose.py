"""Poses of somebody else's vehicle: read from its messages, and between them."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import ned_from_geodetic, quat_from_euler, rotation_vector_from_quat
from sitl.external import pose as external_pose
from sitl.external.pose import LONGEST_GUESS_S, Pose, PoseTrack
from tests.unit.sitl.external.external_vehicle import GROUND, LEVEL, hil_state, sim_state

PLACE, SPEED = (12.0, -7.0, -3.5), (1.0, -0.5, 0.25)
TILTED = quat_from_euler(0.1, -0.2, 2.0)


@pytest.mark.parametrize("kind", ["SIM_STATE", "HIL_STATE_QUATERNION"])
def test_a_message_tells_the_pose(kind: str) -> None:
    if kind == "SIM_STATE":
        sample = external_pose.sim_state(sim_state(PLACE, SPEED, TILTED), 5.0)
    else:
        sample = external_pose.hil_state(hil_state(PLACE, SPEED, TILTED), 5.0)
    assert sample is not None
    assert sample.time_s == 5.0
    # whole numbers of 1e-7 deg are 11 mm, and both cut them off
    assert ned_from_geodetic(*sample.place, GROUND) == pytest.approx(PLACE, abs=0.012)
    assert sample.velocity_ned_m_s == pytest.approx(SPEED, abs=0.01)
    assert sample.attitude == pytest.approx(TILTED, abs=1e-6)


@pytest.mark.parametrize("in_degrees", [False, True])
def test_an_old_sim_state_has_its_place_as_float_alone(in_degrees: bool) -> None:
    changes: dict[str, Any] = {"lat_int": 0, "lon_int": 0}
    if in_degrees:
        changes |= {"lat": 47.0001, "lon": 8.0001}
    sample = external_pose.sim_state(sim_state(PLACE, **changes), 0.0)
    assert sample is not None
    expected = (47.0001, 8.0001) if in_degrees else (47.0 + 12.0 / 111200.0, 8.0 - 7.0 / 76000.0)
    assert sample.place[:2] == pytest.approx(expected, abs=5e-6)


def test_a_sim_state_without_a_quaternion_has_its_angles() -> None:
    message = sim_state(PLACE, attitude=(0.0, 0.0, 0.0, 0.0), roll=0.1, pitch=-0.2, yaw=2.0)
    sample = external_pose.sim_state(message, 0.0)
    assert sample is not None
    assert sample.attitude == pytest.approx(TILTED, abs=1e-6)


def test_what_holds_no_pose_gives_none() -> None:
    nowhere: dict[str, Any] = {"lat": 0.0, "lon": 0.0, "lat_int": 0, "lon_int": 0}
    assert external_pose.sim_state(sim_state(PLACE, **nowhere), 0.0) is None
    assert external_pose.sim_state(sim_state(PLACE, vn=math.nan), 0.0) is None
    assert external_pose.hil_state(hil_state(PLACE, attitude=(0.0, 0.0, 0.0, 0.0)), 0.0) is None


@pytest.mark.parametrize("wild", [math.nan, math.inf, -math.inf, 3.4e38, -3.4e38])
@pytest.mark.parametrize("name", ["roll", "yaw", "xgyro", "zgyro", "vn", "vd", "alt"])
def test_wild_numbers_are_no_pose(name: str, wild: float) -> None:
    values: dict[str, Any] = {name: wild}
    message = sim_state(PLACE, attitude=(0.0, 0.0, 0.0, 0.0), **values)
    assert external_pose.sim_state(message, 0.0) is None


def pose(time_s: float, north_m: float, speed_m_s: float, yaw_rad: float = 0.0, rate: float = 0.0) -> Pose:
    yawed = quat_from_euler(0.0, 0.0, yaw_rad)
    return Pose(time_s, (north_m, 0.0, 0.0), (speed_m_s, 0.0, 0.0), yawed, (0.0, 0.0, rate))


def test_between_two_messages_a_cubic_is_exact_for_a_vehicle_that_brakes() -> None:
    # x = 2 t - t^2, so v = 2 - 2 t
    track = PoseTrack()
    for time_s in (0.0, 0.02, 0.04):
        track.put(pose(time_s, 2.0 * time_s - time_s**2, 2.0 - 2.0 * time_s))
    between = track.at(0.031)
    assert between.position_ned_m[0] == pytest.approx(2.0 * 0.031 - 0.031**2, abs=1e-9)
    assert between.velocity_ned_m_s[0] == pytest.approx(2.0 - 2.0 * 0.031)


def test_an_attitude_is_turned_on_between_and_the_short_way() -> None:
    track = PoseTrack()
    track.put(pose(0.0, 0.0, 0.0, 0.2))
    turned = pose(0.02, 0.0, 0.0, 0.24)
    track.put(turned._replace(attitude=(-turned.attitude[0], 0.0, 0.0, -turned.attitude[3])))
    assert abs(rotation_vector_from_quat(track.at(0.005).attitude)[2]) == pytest.approx(0.21, abs=1e-6)


def test_beyond_the_newest_it_is_carried_on_but_not_for_long() -> None:
    track = PoseTrack()
    track.put(pose(1.0, 3.0, 2.0, yaw_rad=0.1, rate=0.5))
    ahead = track.at(1.05)
    assert ahead.position_ned_m[0] == pytest.approx(3.1)
    assert rotation_vector_from_quat(ahead.attitude)[2] == pytest.approx(0.125)
    assert track.at(9.0).position_ned_m[0] == pytest.approx(3.0 + 2.0 * LONGEST_GUESS_S)


def test_steps_of_whole_numbers_are_smoothed_away() -> None:
    """At 0.3 m/s and 50 Hz a place in steps of 11 mm stands for two messages and jumps with the third."""
    track, worst, step_m, offset_m = PoseTrack(), 0.0, 0.0111, 0.0
    for k in range(200):
        true_m = 0.3 * 0.02 * k
        kept = track.put(pose(0.02 * k, math.floor(true_m / step_m) * step_m, 0.3))
        assert kept is not None
        if k > 50:
            offset_m = 0.5 * step_m  # what cutting off costs in the mean
            worst = max(worst, abs(kept.position_ned_m[0] + offset_m - true_m))
    assert worst < 0.002


@pytest.mark.parametrize(("axis", "step_m"), [(0, 0.0111), (2, 0.01)])
def test_a_vehicle_that_hovers_does_not_jump_from_step_to_step(axis: int, step_m: float) -> None:
    """The camera's view between two frames: what rounding adds to how the vehicle moves."""
    track, dt_s, wander_m, w = PoseTrack(), 0.02, 0.03, 2.0

    def along(value: float) -> tuple[float, float, float]:
        return (value, 0.0, 0.0) if axis == 0 else (0.0, 0.0, value)

    missed = []
    for k in range(1000):
        true_m, speed = wander_m * math.sin(w * dt_s * k), wander_m * w * math.cos(w * dt_s * k)
        told = math.floor(true_m / step_m) * step_m
        kept = track.put(Pose(dt_s * k, along(told), along(speed), LEVEL, (0.0, 0.0, 0.0)))
        assert kept is not None
        missed.append(kept.position_ned_m[axis] - true_m)
    settled = missed[100:]
    assert max(abs(b - a) for a, b in pairwise(settled)) / dt_s < 0.02  # m/s
    assert max(map(abs, settled)) < step_m


def test_a_leap_is_believed_and_an_old_message_is_not() -> None:
    track = PoseTrack()
    track.put(pose(1.0, 0.0, 0.0))
    track.put(pose(1.02, 50.0, 0.0))
    assert track.at(1.02).position_ned_m[0] == 50.0
    assert track.put(pose(1.01, 0.0, 0.0)) is None
    assert track.put(pose(1.02, 0.0, 0.0)) is None


def test_a_simulator_that_starts_anew_is_followed() -> None:
    track = PoseTrack()
    track.put(pose(1000.0, 5.0, 0.0))
    assert track.put(pose(3.0, 0.0, 0.0)) is not None
    assert track.at(3.0).position_ned_m[0] == 0.0


def test_what_is_old_is_forgotten_and_without_a_pose_there_is_none() -> None:
    track = PoseTrack()
    with pytest.raises(ValueError, match="no pose"):
        track.at(0.0)
    for k in range(400):
        track.put(pose(0.02 * k, 0.0, 0.0))
    assert track.at(0.0).time_s > 5.0
    assert track.newest is not None
    assert track.newest.attitude == LEVEL


def test_beginning_anew_what_was_is_there_until_the_next_pose_comes_whenever_that_is_of() -> None:
    track = PoseTrack()
    track.put(pose(1.0, 3.0, 0.0))
    track.begin_anew()
    assert track.at(1.0).position_ned_m[0] == 3.0
    track.put(pose(0.99, 0.5, 0.0))  # by another stamp
    assert track.at(1.0).position_ned_m[0] == 0.5


def test_without_stamps_or_by_a_clock_that_was_set_the_simulator_goes_on_as_our_clock_does() -> None:
    track = PoseTrack()
    for time_s, stamp_s in ((1.0, 50.0), (1.1, 50.02), (1.2, 3.0), (1.3, 3.1), (1.4, math.nan)):
        track.put(pose(time_s, 0.0, 0.0)._replace(simulated_s=stamp_s))
    times = [track.at(time_s).simulated_s for time_s in (1.0, 1.1, 1.2, 1.3, 1.4, 1.45)]
    steps = [b - a for a, b in pairwise(times)]
    assert steps == pytest.approx([0.02, 0.1, 0.1, 0.1, 0.05])


def test_a_stamp_that_was_read_late_neither_stops_the_clock_nor_drives_it_on() -> None:
    track, rng = PoseTrack(), np.random.default_rng(1)
    for k in range(3000):
        late_s = float(rng.uniform(-0.004, 0.004))
        track.put(pose(1.0 + 0.01 * k, 0.0, 0.0)._replace(simulated_s=0.0098 * k + late_s))
    newest = track.newest
    assert newest is not None
    assert newest.simulated_s - 1.0 == pytest.approx(0.98 * (newest.time_s - 1.0), abs=0.02)
