"""The autopilot's own pose at an exposure: between samples, never beyond them."""

import math

import pytest

from companion.base.geometry import quat_from_euler, yaw_from_quat
from companion.link.telemetry.poses import KEPT_S, PoseHistory


def history() -> PoseHistory:
    """North at 2 m/s, turning at 1 rad/s; positions at even, attitudes at odd multiples of 20 ms."""
    poses = PoseHistory()
    for k in range(0, 51, 2):
        poses.take_position(0.02 * k, (0.04 * k, 0.0, -5.0))
        poses.take_attitude(0.02 * (k + 1), quat_from_euler(0.0, 0.0, 0.02 * (k + 1)))
    return poses


@pytest.mark.parametrize("time_s", [0.1, 0.4, 0.555, 1.0])
def test_a_pose_is_between_its_samples(time_s: float) -> None:
    pose = history().at(time_s)
    assert pose is not None
    assert pose.position_ned_m == pytest.approx((2.0 * time_s, 0.0, -5.0))
    assert yaw_from_quat(pose.attitude) == pytest.approx(time_s)


@pytest.mark.parametrize("time_s", [1.001, 1.01, 2.0, 0.0, -1.0, math.inf])
def test_none_beyond_what_both_have_come_up_to(time_s: float) -> None:
    assert history().at(time_s) is None


def test_what_is_old_is_forgotten_and_out_of_order_dropped() -> None:
    poses = history()
    poses.take_position(0.5, (99.0, 0.0, 0.0))
    at = poses.at(0.5)
    assert at is not None
    assert at.position_ned_m[0] == pytest.approx(1.0)
    assert poses.fresh(1.5)
    assert not poses.fresh(1.1 + KEPT_S)
    poses.take_position(5.0, (0.0, 0.0, 0.0))
    poses.take_attitude(5.0, quat_from_euler(0.0, 0.0, 0.0))
    assert poses.at(0.9) is None


def test_nothing_has_come() -> None:
    assert PoseHistory().at(0.0) is None
    assert not PoseHistory().fresh(0.0)
