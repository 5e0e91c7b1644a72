"""The pad's motions: each against its own finite differences, and against what its settings promise."""

import itertools
import math

import numpy as np
import pytest

from companion.base.geometry import ZERO3, wrap_angle
from sitl.pad.motion import IncidentMotion, PadMotion, PadMotionSettings, PadTruth, build_pad_motion
from sitl.pad.paths import (
    CircleMotion,
    FigureEightMotion,
    Heading,
    HeaveMotion,
    LineMotion,
    Meeting,
    RandomTurnsMotion,
    StaticMotion,
    WaypointsMotion,
)
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.ground import PadBoard, echo_distance_m

BLOCK = ((8.0, -9.0), (8.0, 7.0), (20.0, 7.0), (20.0, -9.0))
MOTIONS: dict[str, PadMotionSettings] = {
    "static": StaticMotion(kind="static"),
    "line": LineMotion(kind="line", speed_m_s=1.0),
    "circle": CircleMotion(kind="circle", speed_m_s=1.5, radius_m=5.0),
    "anticlockwise": CircleMotion(kind="circle", speed_m_s=1.5, radius_m=5.0, direction="anticlockwise"),
    "figure_8": FigureEightMotion(kind="figure_8", speed_m_s=2.0, half_length_m=12.0),
    "heave": HeaveMotion(kind="heave", significant_height_m=0.5, peak_period_s=5.0, drift_speed_m_s=0.2),
    "random_turns": RandomTurnsMotion(kind="random_turns", speed_m_s=1.2),
    "moody_turns": RandomTurnsMotion(kind="random_turns", speed_m_s=1.5, slowest_m_s=0.5),
    "waypoints": WaypointsMotion(kind="waypoints", points_ned_m=BLOCK, speed_m_s=1.3, loop=True),
}
CONSTANT_SPEED = {
    "line": 1.0,
    "circle": 1.5,
    "anticlockwise": 1.5,
    "figure_8": 2.0,
    "random_turns": 1.2,
    "waypoints": 1.3,
}
# the others are where their points are
MET = [name for name in MOTIONS if name != "waypoints"]


def built(
    motion: PadMotionSettings, seed: int = 0, heading: Heading = "along", height: float = 1.0
) -> PadMotion:
    return build_pad_motion(motion, height, heading, np.random.default_rng(seed))


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("seed", [0, 1])
def test_velocity_is_the_places_derivative_and_acceleration_the_velocitys(name: str, seed: int) -> None:
    pad, h = built(MOTIONS[name], seed), 1e-4
    # odd times, which no joint of random_turns falls on
    for t in np.arange(0.137, 60.0, 2.713).tolist():
        before, now, after = pad.at(t - h), pad.at(t), pad.at(t + h)
        for axis in range(3):
            slope = (after.position_ned_m[axis] - before.position_ned_m[axis]) / (2 * h)
            bend = (after.velocity_ned_m_s[axis] - before.velocity_ned_m_s[axis]) / (2 * h)
            assert now.velocity_ned_m_s[axis] == pytest.approx(slope, abs=1e-6)
            assert now.acceleration_ned_m_s2[axis] == pytest.approx(bend, abs=1e-6)
        turn = wrap_angle(after.heading_rad - before.heading_rad) / (2 * h)
        assert now.heading_rate_rad_s == pytest.approx(turn, abs=1e-6)


@pytest.mark.parametrize("name", CONSTANT_SPEED)
def test_the_speed_is_the_one_given_all_the_way_and_along_means_pointing_where_it_goes(name: str) -> None:
    pad = built(MOTIONS[name], seed=3)
    for i in range(900):
        now = pad.at(0.1 * i)
        north, east, _ = now.velocity_ned_m_s
        assert math.hypot(north, east) == pytest.approx(CONSTANT_SPEED[name], abs=1e-9)
        assert wrap_angle(now.heading_rad - math.atan2(east, north)) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", MOTIONS)
def test_a_fixed_heading_stays_and_a_seed_gives_one_motion_and_another_seed_another(name: str) -> None:
    pad = built(MOTIONS[name], heading=30.0)
    assert pad.at(7.0).heading_rad == pytest.approx(math.radians(30.0))
    assert pad.at(7.0).heading_rate_rad_s == 0.0
    one, same, other = (built(MOTIONS[name], seed).at(33.3) for seed in (4, 4, 5))
    assert one == same
    assert (one != other) == (name in MET)


@pytest.mark.parametrize("name", MET)
def test_it_is_met_where_and_when_the_settings_say(name: str) -> None:
    meet = Meeting(point_ned_m=(12.0, -3.0), time_s=17.0, spread_m=2.0)
    motion = MOTIONS[name].model_copy(update={"meet": meet})
    places = np.array([built(motion, seed, height=0.6).at(17.0).position_ned_m for seed in range(20)])
    away = np.hypot(places[:, 0] - 12.0, places[:, 1] + 3.0)
    assert away.max() <= 2.0 + 1e-9
    assert away.max() > 0.5
    if name != "heave":
        np.testing.assert_allclose(places[:, 2], -0.6)


@pytest.mark.parametrize("name", MOTIONS)
def test_it_keeps_clear_of_home_until_it_is_met(name: str) -> None:
    for seed in range(10):
        pad = built(MOTIONS[name], seed)
        assert min(math.hypot(*pad.at(0.25 * i).position_ned_m[:2]) for i in range(88)) > 3.0


def test_the_circle_is_round_and_its_direction_is_seen_from_above() -> None:
    for direction, sign in (("clockwise", 1.0), ("anticlockwise", -1.0)):
        motion = CircleMotion(kind="circle", speed_m_s=1.0, radius_m=4.0, direction=direction)  # type: ignore[arg-type]
        pad = built(motion)
        assert pad.at(0.0).heading_rate_rad_s == pytest.approx(sign * 0.25)
        lap = math.tau * 4.0
        assert pad.at(lap).position_ned_m == pytest.approx(pad.at(0.0).position_ned_m, abs=1e-9)
        half = np.subtract(pad.at(0.5 * lap).position_ned_m, pad.at(0.0).position_ned_m)
        assert float(np.linalg.norm(half)) == pytest.approx(8.0)


def test_the_figure_of_eight_closes_crosses_itself_and_turns_both_ways() -> None:
    motion = FigureEightMotion(kind="figure_8", speed_m_s=2.0, half_length_m=10.0, axis_deg=0.0, phase=0.0)
    pad = built(motion)
    lap_s = 5.244115108584239 * 10.0 / 2.0
    start = pad.at(0.0)
    assert pad.at(lap_s).position_ned_m == pytest.approx(start.position_ned_m, abs=1e-6)
    assert pad.at(lap_s / 2).position_ned_m == pytest.approx(start.position_ned_m, abs=1e-6)
    ends = np.subtract(pad.at(lap_s / 4).position_ned_m, pad.at(3 * lap_s / 4).position_ned_m)
    assert ends == pytest.approx((20.0, 0.0, 0.0), abs=1e-6)
    rates = [pad.at(0.05 * lap_s * i).heading_rate_rad_s for i in range(20)]
    assert max(rates) == pytest.approx(3.0 * 2.0 / 10.0)
    assert min(rates) == pytest.approx(-3.0 * 2.0 / 10.0)


def test_the_sea_has_its_significant_height_and_period() -> None:
    motion = HeaveMotion(kind="heave", significant_height_m=0.8, peak_period_s=6.0)
    pad = built(motion, height=2.0)
    z = np.array([pad.at(0.25 * i).position_ned_m[2] for i in range(20000)])
    assert 4.0 * z.std() == pytest.approx(0.8, rel=0.03)
    assert np.abs(z + 2.0).max() <= motion.largest_excursion_m() + 1e-9
    upward = np.sum((z[1:] > -2.0) & (z[:-1] <= -2.0))
    mean_period_s = 5000.0 / upward
    assert 3.5 < mean_period_s < 6.0  # a spectrum's mean crossing period is some 0.7 of its peak's


def test_random_turns_stay_about_their_middle_and_turn_within_the_limit() -> None:
    motion = RandomTurnsMotion(
        kind="random_turns",
        speed_m_s=1.5,
        max_turn_rate_deg_s=25.0,
        radius_m=10.0,
        meet=Meeting(spread_m=0.0),
    )
    for seed in range(5):
        pad = built(motion, seed)
        track = [pad.at(0.5 * i) for i in range(600)]
        extent = np.ptp([p.position_ned_m[:2] for p in track], axis=0)
        assert max(extent) < 50.0
        assert max(abs(p.heading_rate_rad_s) for p in track) <= math.radians(25.0) + 1e-9
        steps = np.diff([p.position_ned_m for p in track], axis=0)
        assert np.linalg.norm(steps, axis=1).max() <= 1.5 * 0.5 + 1e-9


# ---------------------------------------------------------------- driven ways


@pytest.mark.parametrize("slowest", [None, 0.4])
def test_random_turns_keep_their_bounds_and_nothing_jumps(slowest: float | None) -> None:
    motion = RandomTurnsMotion(
        kind="random_turns", speed_m_s=3.0, slowest_m_s=slowest, max_acceleration_m_s2=0.9
    )
    for seed in range(4):
        pad = built(motion, seed)
        track = [pad.at(0.02 * i) for i in range(3000)]
        speeds = [math.hypot(*p.velocity_ned_m_s[:2]) for p in track]
        accelerations = np.array([p.acceleration_ned_m_s2[:2] for p in track])
        assert max(speeds) <= 3.0 + 1e-9
        assert min(speeds) >= (3.0 if slowest is None else slowest) - 1e-9
        assert np.hypot(*accelerations.T).max() <= 0.9 + 1e-9
        assert max(abs(p.heading_rate_rad_s) for p in track) <= math.radians(20.0) + 1e-9
        # a jump from arc to arc would be of the size of the acceleration itself
        assert np.abs(np.diff(accelerations, axis=0)).max() < 0.06
    assert np.ptp(speeds) > (0.5 if slowest else -1.0)


def waypoints(**values: object) -> WaypointsMotion:
    return WaypointsMotion.model_validate(
        {"kind": "waypoints", "points_ned_m": BLOCK, "speed_m_s": 1.0, **values}
    )


def test_waypoints_are_driven_in_their_order_with_rounded_corners() -> None:
    motion = waypoints(start_s=5.0, max_acceleration_m_s2=0.5)
    pad = built(motion)
    assert pad.at(5.0).position_ned_m == pytest.approx((8.0, -9.0, -1.0))
    assert pad.at(3.0).position_ned_m == pytest.approx((8.0, -11.0, -1.0))
    track = np.array([pad.at(5.0 + 0.05 * i).position_ned_m[:2] for i in range(1200)])
    nearest = [np.hypot(*(track - corner).T) for corner in BLOCK]
    passed = [int(np.argmin(distance)) for distance in nearest]
    assert passed == sorted(passed)
    # it cuts the corners, by less than a circle of v^2 / a with its straight legs would twice over
    assert [0.05 < distance.min() < 2.0 for distance in nearest[1:3]] == [True, True]
    for a, b in ((BLOCK[0], BLOCK[1]), (BLOCK[1], BLOCK[2])):
        middle = (np.array(a) + b) / 2.0
        assert np.hypot(*(track - middle).T).min() < 0.05


def test_the_corners_keep_the_bounds_on_acceleration_and_rate_of_turn() -> None:
    for bounds in ({"max_acceleration_m_s2": 0.4}, {"max_turn_rate_deg_s": 20.0}):
        pad = built(waypoints(**bounds))
        track = [pad.at(0.05 * i) for i in range(1200)]
        sideways = max(math.hypot(*p.acceleration_ned_m_s2[:2]) for p in track)
        turning = math.degrees(max(abs(p.heading_rate_rad_s) for p in track))
        assert sideways <= bounds.get("max_acceleration_m_s2", 1.0) + 1e-6
        assert turning <= bounds.get("max_turn_rate_deg_s", 45.0) + 1e-6
        assert sideways > 0.38 or turning > 19.5


def test_a_loop_comes_round_again_and_again() -> None:
    pad = built(waypoints(loop=True))
    at_first = [pad.at(0.1 * i).position_ned_m for i in range(3000)]
    near = [math.hypot(p[0] - 8.0, p[1] - 7.0) < 2.0 for p in at_first]
    rounds = sum(1 for before, now in itertools.pairwise(near) if now and not before)
    assert rounds >= 4


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"speed_m_s": 4.0}, "to round the corners"),
        ({"points_ned_m": ((0.0, 5.0), (9.0, 5.0), (0.0, 5.5))}, "at most 150"),
        ({"points_ned_m": ((0.0, 5.0), (0.0, 5.0))}, "twice in a row"),
        ({"points_ned_m": ((0.0, 5.0), (9.0, 5.0)), "loop": True}, "3 or more"),
    ],
)
def test_a_route_that_cannot_be_driven_is_refused(values: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        waypoints(**values)


# ----------------
# What happens to a pad on its way: each motion by its own derivative, and to its stated end.

SPEED, COURSE = 1.5, math.radians(30.0)


class Straight:
    """1.5 m/s, or another speed, on a course of 30 degrees, at 0.3 m."""

    def __init__(self, speed_m_s: float = SPEED) -> None:
        self.speed_m_s = speed_m_s

    def at(self, time_s: float) -> PadTruth:
        north, east = self.speed_m_s * math.cos(COURSE), self.speed_m_s * math.sin(COURSE)
        return PadTruth(time_s, (north * time_s, east * time_s, -0.3), (north, east, 0.0), ZERO3, COURSE, 0.0)


@pytest.fixture
def motion() -> IncidentMotion:
    return IncidentMotion(Straight().at)


def along(pad: PadTruth) -> tuple[float, float]:
    """Way and speed along the course."""
    c, s = math.cos(COURSE), math.sin(COURSE)
    return (
        c * pad.position_ned_m[0] + s * pad.position_ned_m[1],
        c * pad.velocity_ned_m_s[0] + s * pad.velocity_ned_m_s[1],
    )


def check_derivatives(motion: IncidentMotion, from_s: float, to_s: float) -> None:
    h = 1e-4
    for k in range(1, 50):
        t = from_s + (to_s - from_s) * k / 50
        before, now, after = motion.at(t - h), motion.at(t), motion.at(t + h)
        for axis in range(3):
            speed = (after.position_ned_m[axis] - before.position_ned_m[axis]) / (2 * h)
            assert now.velocity_ned_m_s[axis] == pytest.approx(speed, abs=1e-3)


def test_without_an_incident_the_motion_is_the_scenarios(motion: IncidentMotion) -> None:
    assert motion.at(7.3) == Straight().at(7.3)


def test_it_brakes_at_its_deceleration_and_stands(motion: IncidentMotion) -> None:
    motion.drive(10.0, 0.0, 3.0)
    assert along(motion.at(10.0)) == pytest.approx((15.0, 1.5))
    assert along(motion.at(10.25))[1] == pytest.approx(0.75)
    assert along(motion.at(14.0)) == pytest.approx((15.0 + 1.5**2 / 6.0, 0.0))
    check_derivatives(motion, 10.0, 12.0)


def test_at_once_means_within_a_millimetre(motion: IncidentMotion) -> None:
    motion.drive(10.0, 0.0)
    assert along(motion.at(11.0)) == pytest.approx((15.0, 0.0), abs=1e-3)


def test_it_turns_back_and_drives_as_fast_as_it_came(motion: IncidentMotion) -> None:
    motion.turn_back(10.0, 2.0)
    assert along(motion.at(20.0))[1] == pytest.approx(-1.5)
    assert motion.at(20.0).heading_rad == pytest.approx(COURSE)  # it does not turn round
    check_derivatives(motion, 10.0, 13.0)


def test_it_leaves_and_after_the_fault_it_goes_on_as_before(motion: IncidentMotion) -> None:
    motion.drive(10.0, 6.0, 2.0)
    assert along(motion.at(13.0))[1] == pytest.approx(6.0)
    before = motion.at(13.0)
    motion.drive(13.0, motion.usual_m_s, 3.0)
    assert motion.at(13.0).position_ned_m == pytest.approx(before.position_ned_m)
    assert along(motion.at(20.0))[1] == pytest.approx(1.5)


def test_one_that_stands_leaves_along_its_heading() -> None:
    motion = IncidentMotion(Straight(0.0).at)
    motion.drive(5.0, 6.0, 2.0)
    assert along(motion.at(10.0))[1] == pytest.approx(6.0)
    vn, ve, _ = motion.at(10.0).velocity_ned_m_s
    assert math.atan2(ve, vn) == pytest.approx(COURSE)


def test_it_tilts_to_its_angle_and_back(motion: IncidentMotion) -> None:
    motion.tilt(10.0, math.radians(15.0), math.radians(30.0))
    assert math.degrees(motion.at(10.25).roll_rad) == pytest.approx(7.5)
    assert math.degrees(motion.at(10.25).roll_rate_rad_s) == pytest.approx(30.0)
    assert math.degrees(motion.at(12.0).roll_rad) == pytest.approx(15.0)
    motion.tilt(12.0, 0.0, math.radians(30.0))
    assert math.degrees(motion.at(12.25).roll_rad) == pytest.approx(7.5)
    assert motion.at(13.0).roll_rad == 0.0


def test_one_that_is_gone_stays_for_its_beacon_alone(motion: IncidentMotion) -> None:
    motion.vanish(10.0)
    gone, was = motion.at(11.0), Straight().at(10.0)
    assert (gone.position_ned_m, gone.is_there) == (was.position_ned_m, False)
    assert gone.velocity_ned_m_s == ZERO3
    board, above = PadBoard(0.5, 0.5), (*was.position_ned_m[:2], -2.0)
    for pad, under in ((was, True), (gone, False)):
        assert board.is_under(pad, above) is under
        assert board.surface_down_m(pad, *above[:2]) == (was.position_ned_m[2] if under else 0.0)
        echo = echo_distance_m(board, pad, QuadrotorState(position_ned_m=above), ZERO3, 0.2)
        assert echo == pytest.approx(1.7 if under else 2.0)
    motion.appear()
    assert motion.at(12.0) == Straight().at(12.0)
