"""References resampled and carried along with the pad."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import FloatArray
from companion.base.messages import DescentCone, Reference
from companion.control.mpc.target import HeadingReference, make_target, sample, stop_reference, within_reach
from companion.control.pad_prediction import PadPrediction, origin_at_rest

ROWS_S: FloatArray = 5.0 + 0.1 * np.arange(6, dtype=np.float64)


def _parabola(origin: str = "pad", minimum_height_m: float | None = None) -> Reference:
    t = 0.1 * np.arange(11)[:, None]
    a = np.array([0.4, -0.2, 0.1])
    return Reference(
        5.0,
        "pad" if origin == "pad" else "local",
        0.1,
        0.5 * a * t * t,
        a * t,
        np.tile(a, (11, 1)),
        0.0,
        minimum_height_m,
    )


def test_between_rows_the_reference_is_interpolated() -> None:
    times = np.array([5.0, 5.05, 5.333, 6.0])
    position, velocity, acceleration = sample(_parabola(), times)
    t = (times - 5.0)[:, None]
    a = np.array([0.4, -0.2, 0.1])
    np.testing.assert_allclose(position, 0.5 * a * t * t, atol=1e-3)
    np.testing.assert_allclose(velocity, a * t, atol=1e-12)
    np.testing.assert_allclose(acceleration, np.tile(a, (4, 1)))


def test_beyond_its_end_the_reference_goes_straight_on_and_before_its_start_it_waits() -> None:
    position, velocity, acceleration = sample(_parabola(), np.array([4.0, 6.5]))
    assert position[0].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(position[1], [0.2 + 0.4 * 0.5, -0.1 - 0.2 * 0.5, 0.05 + 0.1 * 0.5])
    np.testing.assert_allclose(velocity[1], [0.4, -0.2, 0.1])
    assert not acceleration[1].any()


def test_a_single_row_is_a_place_to_stay() -> None:
    target = make_target(stop_reference(0.0, (1.0, 2.0, -3.0), 0.0), np.arange(3.0), origin_at_rest(3))
    np.testing.assert_allclose(target.position_m, [(1.0, 2.0, -3.0)] * 3)
    assert not target.velocity_m_s.any()
    assert target.floor_down_m is None


def test_the_pads_motion_and_the_floor_over_it_are_added() -> None:
    times = ROWS_S
    path = PadPrediction(np.full((6, 3), 2.0), np.full((6, 3), 0.5), np.full((6, 3), 0.1))
    bare = make_target(_parabola(), times, origin_at_rest(6))
    target = make_target(_parabola(minimum_height_m=-0.5), times, path)
    np.testing.assert_allclose(target.position_m, bare.position_m + 2.0)
    np.testing.assert_allclose(target.velocity_m_s, bare.velocity_m_s + 0.5)
    np.testing.assert_allclose(target.acceleration_m_s2, bare.acceleration_m_s2 + 0.1)
    assert target.floor_down_m is not None
    np.testing.assert_allclose(target.floor_down_m, 2.0 + 0.5)


def test_a_local_reference_knows_no_floor_over_the_pad() -> None:
    reference = _parabola(origin="local", minimum_height_m=0.3)
    assert make_target(reference, ROWS_S[:3], origin_at_rest(3)).floor_down_m is None


@pytest.mark.parametrize("wanted_deg", [170.0, -170.0])
def test_heading_turns_no_faster_than_allowed_and_the_shorter_way(wanted_deg: float) -> None:
    heading = HeadingReference(0.5)
    heading.reset(math.radians(-160.0))
    heading.step(math.radians(wanted_deg), 0.1)
    assert math.remainder(heading.heading_rad - math.radians(-160.0), math.tau) == pytest.approx(-0.05)


def test_heading_rate_follows_a_steady_turn() -> None:
    heading = HeadingReference(1.0)
    for k in range(120):
        heading.step(0.3 * (k + 1) / 30.0, 1.0 / 30.0)
    assert heading.rate_rad_s == pytest.approx(0.3, abs=0.01)
    assert heading.heading_rad == pytest.approx(1.2)


def test_heading_stays_when_the_wish_is_no_number() -> None:
    heading = HeadingReference(1.0)
    heading.reset(0.4)
    heading.step(math.nan, 0.1)
    assert heading.heading_rad == 0.4
    heading.reset(math.nan)
    assert heading.heading_rad == 0.0


def test_a_far_reference_is_drawn_within_reach_as_a_whole_and_keeps_its_floor() -> None:
    times = ROWS_S
    target = make_target(_parabola(minimum_height_m=0.3), times, origin_at_rest(6))
    near = within_reach(target, (-30.0, 40.0, 5.0), 2.0, 0.7)
    np.testing.assert_allclose(near.position_m[0], [-30.0 + 1.2, 40.0 - 1.6, 5.0 - 0.7])
    np.testing.assert_allclose(np.diff(near.position_m, axis=0), np.diff(target.position_m, axis=0))
    assert near.floor_down_m is target.floor_down_m


def test_a_near_reference_is_left_alone() -> None:
    target = make_target(_parabola(), ROWS_S, origin_at_rest(6))
    assert within_reach(target, (1.9, 0.0, 0.69), 2.0, 0.7) is target
    assert within_reach(target, (0.0, 0.0, 0.0), 2.0, 0.7) is target


def test_a_reference_below_the_floor_is_lifted_to_it() -> None:
    reference = Reference(
        0.0, "pad", 1.0, np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)), 0.0, minimum_height_m=0.5
    )
    assert make_target(reference, np.arange(3.0), origin_at_rest(3)).position_m[:, 2].tolist() == [-0.5] * 3


def test_a_cone_stands_on_the_pad_as_it_moves() -> None:
    times: FloatArray = 0.1 * np.arange(6, dtype=np.float64)
    up = np.stack([times, 0.0 * times, -0.3 * times], axis=1)
    path = PadPrediction(up, np.zeros((6, 3)), np.zeros((6, 3)))
    cone = DescentCone(slope=0.2, radius_m=0.1, apex_height_m=0.18)
    target = make_target(replace(_parabola(), cone=cone), times, path)
    assert target.cone is not None
    assert (target.cone.slope, target.cone.radius_m) == (0.2, 0.1)
    np.testing.assert_allclose(target.cone.apex_m, up - [0.0, 0.0, 0.18])
    assert make_target(replace(_parabola(origin="local"), cone=cone), times, path).cone is None
    assert make_target(_parabola(), times, path).cone is None
