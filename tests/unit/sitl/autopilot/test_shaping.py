"""Jerk-limited paths: they arrive, keep their limits, and stop where they should."""

import math

import pytest

from sitl.autopilot.control.shaping import (
    FirstOrderLowPass,
    Path1,
    Path2,
    ShapingLimits,
    root_law,
    signed_root_law,
)

LIMITS = ShapingLimits(acceleration=2.5, jerk=5.0)
DT_S = 0.01


def test_the_root_law_joins_smoothly_and_never_asks_for_more_than_can_be_braked() -> None:
    knee = LIMITS.braking / LIMITS.position_gain**2
    below, above = (root_law(knee + d, LIMITS.position_gain, LIMITS.braking, DT_S) for d in (-1e-6, 1e-6))
    assert above == pytest.approx(below, abs=1e-5)
    for distance in (0.1, 1.0, 5.0, 50.0):
        speed = root_law(distance, LIMITS.position_gain, LIMITS.braking, DT_S)
        assert speed * speed <= 2.0 * LIMITS.braking * distance
        assert signed_root_law(-distance, LIMITS.position_gain, LIMITS.braking, DT_S) == -speed


@pytest.mark.parametrize("distance_m", [0.3, 5.0, 40.0])
def test_a_path_to_a_place_keeps_its_limits_and_overshoots_little(distance_m: float) -> None:
    path, last = Path2(), (0.0, 0.0)
    furthest = fastest = hardest = jerkiest = 0.0
    place = (0.6 * distance_m, 0.8 * distance_m)
    for _ in range(4000):
        path.to_place(place, (0.0, 0.0), (0.0, 0.0), 4.0, LIMITS, DT_S)
        furthest = max(furthest, 0.6 * path.position[0] + 0.8 * path.position[1])
        fastest = max(fastest, math.hypot(*path.velocity))
        hardest = max(hardest, math.hypot(*path.acceleration))
        jerkiest = max(jerkiest, math.dist(path.acceleration, last) / DT_S)
        last = path.acceleration
    assert path.position == pytest.approx(place, abs=1e-3)
    assert furthest < 1.05 * distance_m
    assert fastest < 4.1
    assert hardest <= LIMITS.acceleration * 1.001
    assert jerkiest <= LIMITS.jerk * 1.001


def test_one_axis_moves_as_a_plane_does_along_one_of_its_axes() -> None:
    line, plane = Path1(), Path2()
    for step in range(600):
        wish = 1.0 if step < 300 else -0.5
        line.to_velocity(wish, 0.0, LIMITS, DT_S)
        plane.to_velocity((wish, 0.0), (0.0, 0.0), LIMITS, DT_S)
    assert (line.position, line.velocity) == pytest.approx((plane.position[0], plane.velocity[0]))
    assert line.velocity == pytest.approx(-0.5, abs=1e-2)


def test_an_acceleration_is_reached_at_the_jerk_and_flown_on() -> None:
    path = Path1()
    for _ in range(200):
        path.to_acceleration(1.0, LIMITS, DT_S)
    # 0.2 s of jerk cost 0.1 m/s
    assert path.velocity == pytest.approx(1.9, abs=0.01)


def test_a_path_waits_where_the_vehicle_cannot_follow_and_goes_on_every_other_way() -> None:
    line, plane = Path1(velocity=1.0), Path2(velocity=(1.0, 1.0))
    line.limit, line.behind_m, line.slower_m_s = 1.0, 0.5, 0.5
    plane.limit, plane.behind_m, plane.slower_m_s = (3.0, 0.0), (0.5, 0.0), (0.5, 0.0)
    for _ in range(100):
        line.to_acceleration(1.0, LIMITS, DT_S)
        plane.to_acceleration((1.0, 1.0), LIMITS, DT_S)
    assert (line.position, line.velocity) == (0.0, 1.0)
    assert (plane.position, plane.velocity) == ((0.0, 0.0), (1.0, 1.0))
    for _ in range(400):  # braking and turning back are free
        line.to_velocity(-1.0, 0.0, LIMITS, DT_S)
        plane.to_velocity((-1.0, 0.0), (0.0, 0.0), LIMITS, DT_S)
    assert line.velocity == pytest.approx(-1.0, abs=1e-2)
    assert plane.velocity == pytest.approx((-1.0, 0.0), abs=1e-2)
    assert line.position < -1.0
    for _ in range(400):  # and it may brake into the limit
        line.to_velocity(1.0, 0.0, LIMITS, DT_S)
    assert line.velocity == pytest.approx(0.0, abs=0.03)


def test_a_vehicle_that_has_caught_up_moves_the_path_on_at_the_limit_too() -> None:
    line, plane = Path1(velocity=1.0), Path2(velocity=(1.0, 0.0))
    line.limit, line.behind_m, line.slower_m_s = 1.0, -0.5, -0.5
    plane.limit, plane.behind_m, plane.slower_m_s = (3.0, 0.0), (-0.5, 0.0), (-0.5, 0.0)
    line.to_acceleration(1.0, LIMITS, DT_S)
    plane.to_acceleration((1.0, 0.0), LIMITS, DT_S)
    assert line.position == pytest.approx(plane.position[0])
    assert line.position > 0.0
    assert line.velocity == pytest.approx(plane.velocity[0])
    assert line.velocity > 1.0


def test_a_low_pass_starts_from_its_first_value_and_lags_by_its_cutoff() -> None:
    low = FirstOrderLowPass(1.0 / (2.0 * math.pi))  # a time constant of 1 s
    assert low.step(3.0, DT_S) == 3.0
    for _ in range(100):
        low.step(4.0, DT_S)
    assert low.value == pytest.approx(4.0 - math.exp(-1.0), abs=0.01)
    low.reset()
    assert low.step(-1.0, DT_S) == -1.0
