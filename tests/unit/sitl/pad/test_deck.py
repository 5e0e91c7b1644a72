"""A deck at sea: its motion, and how vehicle, ultrasonic, camera and score take its tilt."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import Vector3, matrix_from_quat, quat_from_euler, subtract, tilt_from_quat
from companion.config import ConfigError, validate
from sitl.pad.motion import PadTruth, build_pad_motion
from sitl.pad.paths import DeckMotion, DeckSettings, LineMotion, StaticMotion
from sitl.scenario.scenario import Scenario
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.ground import PadBoard, tilt_from_normal
from sitl.world.world import World

DT = 0.0025
STAND = 0.18
SEA = DeckSettings(
    significant_height_m=0.5, significant_roll_deg=8.0, significant_pitch_deg=5.0, roll_period_s=7.0
)


def tilting(roll_deg: float, pitch_deg: float, heading_deg: float = 30.0, **values: Any) -> PadTruth:
    roll, pitch, heading = (math.radians(a) for a in (roll_deg, pitch_deg, heading_deg))
    zero = (0.0, 0.0, 0.0)
    return PadTruth(0.0, (4.0, 5.0, -1.0), zero, zero, heading, 0.0, roll, pitch, **values)


def vector(values: NDArray[np.float64]) -> Vector3:
    x, y, z = values.tolist()
    return (x, y, z)


# ---------------------------------------------------------------- the motion


def test_each_rate_is_its_angles_derivative() -> None:
    deck, h = DeckMotion(SEA, np.random.default_rng(2)), 1e-5
    for t in np.arange(0.1, 30.0, 1.37).tolist():
        before, now, after = deck.at(t - h), deck.at(t), deck.at(t + h)
        for name, order in (("heave", 1), ("heave", 2), ("roll", 1), ("pitch", 1)):
            was, is_, becomes = (getattr(each, name) for each in (before, now, after))
            slope = (becomes[order - 1] - was[order - 1]) / (2 * h)
            assert is_[order] == pytest.approx(slope, abs=1e-6)


def test_a_sea_is_as_high_as_it_is_said_to_be_and_its_parts_move_apart() -> None:
    deck = DeckMotion(SEA, np.random.default_rng(2))
    states = [deck.at(0.5 * i) for i in range(6000)]
    heave, roll, pitch = (np.array([part[0] for part in parts]) for parts in zip(*states, strict=True))
    assert 4.0 * heave.std() == pytest.approx(0.5, rel=0.05)
    assert 4.0 * np.degrees(roll.std()) == pytest.approx(8.0, rel=0.05)
    assert 4.0 * np.degrees(pitch.std()) == pytest.approx(5.0, rel=0.05)
    # heave and pitch are of the same waves, but not of the same phase
    together = np.abs(np.corrcoef([heave, roll, pitch]))
    assert together[0, 2] < 0.9
    assert together[1, [0, 2]].max() < 0.1


def test_a_sea_adds_to_a_way_and_leaves_the_way_as_it_is() -> None:
    line = LineMotion(kind="line", speed_m_s=0.7)
    calm = build_pad_motion(line, 2.0, "along", np.random.default_rng(5))
    rough = build_pad_motion(line, 2.0, "along", np.random.default_rng(5), SEA)
    a, b = calm.at(11.0), rough.at(11.0)
    assert b.position_ned_m[:2] == a.position_ned_m[:2]
    assert b.heading_rad == a.heading_rad
    assert b.position_ned_m[2] != a.position_ned_m[2]
    assert b.roll_rad != 0.0 != b.pitch_rad
    h = 1e-4
    fall = (rough.at(11.0 + h).position_ned_m[2] - rough.at(11.0 - h).position_ned_m[2]) / (2 * h)
    assert b.velocity_ned_m_s[2] == pytest.approx(fall, abs=1e-6)


def test_a_deck_that_would_dip_under_is_refused() -> None:
    deck = {"significant_height_m": 1.0, "significant_roll_deg": 10.0}
    settings = {"name": "x", "description": "x", "pad": {"surface_height_m": 0.5, "deck": deck}}
    with pytest.raises(ConfigError, match=r"surface_height_m is 0\.5; expected at least 1"):
        validate(Scenario, settings, "x.yaml")


# ---------------------------------------------------------------- geometry


@pytest.mark.parametrize(
    "angles", [(0.0, 0.0, 70.0), (8.0, 0.0, 30.0), (0.0, -6.0, 200.0), (9.0, 5.0, -80.0)]
)
def test_the_axes_are_those_of_the_same_angles_as_a_quaternion(angles: tuple[float, float, float]) -> None:
    pad = tilting(*angles)
    matrix = matrix_from_quat(quat_from_euler(pad.roll_rad, pad.pitch_rad, pad.heading_rad))
    axes = pad.axes()
    np.testing.assert_allclose(np.column_stack(axes), matrix, atol=1e-12)
    v = (0.3, -0.8, 2.0)
    assert axes.to_ned(axes.from_ned(v)) == pytest.approx(v)
    assert axes.to_ned(v) == pytest.approx(vector(matrix @ v))


def test_a_place_on_the_deck_goes_where_its_turning_takes_it() -> None:
    rates = {"roll_rate_rad_s": 0.2, "pitch_rate_rad_s": -0.15}
    pad = tilting(6.0, 4.0, **rates)._replace(heading_rate_rad_s=0.1)
    h, local = 1e-6, (0.5, -0.3, 0.0)
    before, after = (
        np.add(pad.extrapolated(t).position_ned_m, pad.extrapolated(t).axes().to_ned(local)) for t in (-h, h)
    )
    place = vector(np.add(pad.position_ned_m, pad.axes().to_ned(local)))
    assert pad.velocity_at_ned_m_s(place) == pytest.approx(vector((after - before) / (2 * h)), abs=1e-6)


def test_what_lies_under_a_point_is_the_sloping_surface() -> None:
    board, pad = PadBoard(0.65, 0.65), tilting(0.0, 10.0, heading_deg=0.0)
    # bow up: forward is higher, by the slope
    assert board.surface_down_m(pad, 4.4, 5.0) == pytest.approx(-1.0 - 0.4 * math.tan(math.radians(10.0)))
    assert board.surface_down_m(pad, 3.6, 5.0) == pytest.approx(-1.0 + 0.4 * math.tan(math.radians(10.0)))
    assert board.surface_down_m(pad, 4.645, 5.0) == 0.0  # seen from above the board is shorter
    highest = -1.0 - 0.65 * math.sin(math.radians(10.0))
    assert highest - 0.1 < board.ceiling_down_m(pad) <= highest
    assert board.ceiling_down_m(tilting(0.0, 0.0)) == -1.0


def test_tilt_is_counted_from_the_decks_normal_which_without_a_sea_is_upright() -> None:
    pad = tilting(7.0, -4.0)
    along = quat_from_euler(pad.roll_rad, pad.pitch_rad, pad.heading_rad)
    assert tilt_from_normal(pad, along) == pytest.approx(0.0, abs=1e-6)
    level = quat_from_euler(0.0, 0.0, 1.0)
    assert tilt_from_normal(pad, level) == pytest.approx(tilt_from_quat(along))
    calm = build_pad_motion(StaticMotion(kind="static"), 0.3, "along", np.random.default_rng(0)).at(3.0)
    assert calm.axes().down == (0.0, 0.0, 1.0)
    assert tilt_from_normal(calm, level) == pytest.approx(0.0, abs=1e-6)


# ---------------------------------------------------------------- the world


def at_sea(**deck: float) -> World:
    meet = {"point_ned_m": [8.0, 3.0], "spread_m": 0.0}
    settings = {
        "name": "sea",
        "description": "sea",
        "pad": {"surface_height_m": 2.0, "motion": {"kind": "static", "meet": meet}, "deck": deck},
    }
    return World(validate(Scenario, settings, "sea"), 1)


def on_deck(world: World, gap_m: float) -> World:
    """Over the deck's middle, tilting with it."""
    pad = world.pad_state
    up = pad.axes().to_ned((0.0, 0.0, -STAND - gap_m))
    place = vector(np.add(pad.position_ned_m, up))
    attitude = quat_from_euler(pad.roll_rad, pad.pitch_rad, pad.heading_rad)
    world.place(QuadrotorState(place, pad.velocity_ned_m_s, attitude))
    return world


def test_a_vehicle_on_a_rocking_deck_tilts_and_goes_with_it() -> None:
    world = on_deck(
        at_sea(significant_roll_deg=10.0, significant_pitch_deg=5.0, significant_height_m=0.4), 0.0
    )
    tilts = []
    for k in range(round(12.0 / DT)):
        world.step((0.0, 0.0, 0.0, 0.0), DT)
        if k % 40 == 0 and k > 400:
            tilts.append(tilt_from_quat(world.state.attitude))
            assert tilt_from_normal(world.pad_state, world.state.attitude) < math.radians(0.5)
            away = subtract(world.state.position_ned_m, world.pad_state.position_ned_m)
            local = world.pad_state.axes().from_ned(away)
            assert local == pytest.approx((0.0, 0.0, -STAND), abs=0.02)
            assert world.at_rest_on_pad
    assert math.degrees(max(tilts)) > 3.0
    truth = world.truth()
    assert (truth.pad_roll_rad, truth.pad_pitch_rad) == (world.pad_state.roll_rad, world.pad_state.pitch_rad)


def test_truth_in_between_has_the_tilt_in_between() -> None:
    world = at_sea(significant_roll_deg=10.0, significant_pitch_deg=8.0)
    for _ in range(40):
        world.step((0.0, 0.0, 0.0, 0.0), DT)
    then, now = world.truth_at(0.08), world.truth()
    middle = world.truth_at(0.09)
    for name in ("pad_roll_rad", "pad_pitch_rad"):
        assert getattr(then, name) != getattr(now, name)
        assert getattr(middle, name) == pytest.approx(
            0.5 * (getattr(then, name) + getattr(now, name)), abs=1e-5
        )


def test_touchdown_is_scored_along_the_decks_normal() -> None:
    world = on_deck(at_sea(significant_roll_deg=25.0), 0.0)
    for _ in range(round(60.0 / DT)):
        # wait for a good tilt: the deck moves on without the vehicle
        if abs(math.degrees(world.pad_motion.at(world.time_s).roll_rad)) > 5.0:
            break
        world.time_s += DT
    world.pad_state = world.pad_motion.at(world.time_s)
    on_deck(world, 1.2)
    tilt_deg = math.degrees(tilt_from_quat(world.state.attitude))
    assert tilt_deg > 5.0
    while world.watch.touchdown is None:
        world.step((0.0, 0.0, 0.0, 0.0), DT)
    assert world.watch.touchdown.on_pad
    # it fell along with the deck's tilt of then; the deck has turned on a little since
    now_deg = math.degrees(tilt_from_normal(world.pad_state, world.state.attitude))
    assert world.watch.touchdown.tilt_deg == pytest.approx(now_deg, abs=0.3)
    assert world.watch.touchdown.tilt_deg < 0.8 * tilt_deg


def test_the_ultrasonic_hears_the_deck_along_its_normal() -> None:
    world = at_sea(significant_roll_deg=20.0)
    world.pad_state = world.pad_state._replace(roll_rad=math.radians(8.0), pitch_rad=0.0)
    n, e, d = world.pad_state.position_ned_m
    world.place(QuadrotorState((n, e, d - 1.5), attitude=quat_from_euler(0.0, 0.0, 0.0)))
    heard = world.ranging((0.0, 0.0, 0.0), math.radians(15.0))()
    assert heard == pytest.approx(1.5 * math.cos(math.radians(8.0)))
    # tilting against the deck by more than the beam it hears nothing of it, only the ground
    against = quat_from_euler(math.radians(-9.0), 0.0, world.pad_state.heading_rad)
    world.place(QuadrotorState((n, e, d - 1.5), attitude=against))
    assert world.ranging((0.0, 0.0, 0.0), math.radians(15.0))() == pytest.approx(1.5 - d)
