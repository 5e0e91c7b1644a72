"""Fig. 14: its worlds and reference, short flights of each pilot, the bars and the picture."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from companion.plan.obstacles.obstacles import Obstacle, clearance_m
from experiments.fig14 import CASE_NAMES
from experiments.fig14 import report as fig14
from experiments.fig14.flight import FlownTrack, fly
from experiments.fig14.pilots import (
    FLIP,
    KEPT_CLEAR_M,
    PILOTS,
    PLANES,
    VEHICLE_RADIUS_M,
    PilotKnowledge,
    outward,
    rows_of,
    surroundings,
)
from experiments.fig14.report import (
    BY_NAME,
    FlightScore,
    flight_of,
    judge,
    load_settings,
    picture,
    step_line,
    table,
)
from experiments.fig14.world import (
    CASES,
    FLOWN_S,
    ITERATION_S,
    LEAST_CLEAR_M,
    closest_m,
    disturbed,
    draw_scene,
    draw_world,
    plan_reference,
)
from experiments.tune_pid import TRAINING
from tests.programs import ProgramHere

SEED = 4


@pytest.fixture(scope="module")
def flight() -> PilotKnowledge:
    return flight_of(load_settings(), *draw_scene(SEED))


def flown(flight: PilotKnowledge, pilot: str, seconds: float, case: str = "nominal") -> FlownTrack:
    return fly(pilot, flight, load_settings().body, BY_NAME[case], seconds)


def test_a_seed_is_a_world() -> None:
    one, same, other = draw_world(4), draw_world(4), draw_world(7)
    assert one.obstacles == same.obstacles != other.obstacles
    assert one.pad.at(7.0) == same.pad.at(7.0) != other.pad.at(7.0)


def test_the_reference_goes_round_with_margin_and_arrives(flight: PilotKnowledge) -> None:
    world, reference = flight.world, flight.reference
    assert closest_m(reference, world) >= LEAST_CLEAR_M - 0.05
    pad = world.pad.at(FLOWN_S - 0.2).position_ned_m
    gap = np.subtract(reference.at(FLOWN_S - 0.2).position_m, pad)
    assert np.linalg.norm(gap[:2]) < 0.15
    assert -0.45 < gap[2] < -0.2


def test_replanning_makes_no_step(flight: PilotKnowledge) -> None:
    """Position, velocity and acceleration go on from one iteration's course to the next's."""
    for before, after in zip(flight.reference.courses, flight.reference.courses[1:], strict=False):
        now_s = after.start_s
        here, there = before.at(now_s), after.at(now_s)
        assert np.allclose(here.position_m, there.position_m)
        assert np.allclose(here.velocity_m_s, there.velocity_m_s)
        assert np.allclose(here.acceleration_m_s2, there.acceleration_m_s2, atol=1e-6)
    assert flight.reference.courses[1].start_s == pytest.approx(ITERATION_S)


def test_a_world_without_a_way_has_no_reference(flight: PilotKnowledge) -> None:
    pad = flight.world.pad.at(FLOWN_S / 2.0).position_ned_m
    wall = Obstacle(pad[0], pad[1], 15.0, 15.0, 0.0, 0.0, -50.0)
    assert plan_reference(replace(flight.world, obstacles=(wall,))) is None


def test_a_case_disturbs_mass_and_inertia_by_up_to_a_fifth() -> None:
    body = load_settings().body
    shares = [disturbed(body, BY_NAME["all"], seed).mass_kg / body.mass_kg for seed in range(40)]
    assert 0.8 <= min(shares) < 0.85
    assert 1.15 < max(shares) <= 1.2
    assert disturbed(body, BY_NAME["gust"], 1) == body


def test_half_spaces_stand_between_the_row_and_its_obstacle(flight: PilotKnowledge) -> None:
    rows = rows_of(flight, 2.0)
    around = surroundings(rows, flight.world.obstacles)
    points = rows.position_m[1:]
    room = np.einsum("kpi,ki->kp", around.normals, points) - around.offsets_m
    nearest = clearance_m(points * FLIP, flight.world.obstacles)
    near = around.offsets_m.max(axis=1) > -1e3
    assert near.any()
    assert np.allclose(room.min(axis=1)[near], nearest[near] - KEPT_CLEAR_M, atol=1e-6)
    assert around.normals.shape == (len(points), PLANES, 3)


def test_outward_is_away_from_the_surface() -> None:
    pole = Obstacle(0.0, 0.0, 0.0, 0.0, 0.0, 0.5, -9.0)
    away = outward(np.array([[3.0, 4.0, -2.0], [0.0, 0.0, -20.0]]), pole)
    assert np.allclose(away, [[0.6, 0.8, 0.0], [0.0, 0.0, -1.0]], atol=1e-5)


@pytest.mark.parametrize(("pilot", "within_m"), [("pid", 0.15), ("riccati", 0.05), ("mpc", 0.02)])
def test_each_pilot_follows(flight: PilotKnowledge, pilot: str, within_m: float) -> None:
    track = flown(flight, pilot, 1.5)
    assert not track.lost
    assert not track.touched
    assert track.rmse_m < within_m
    assert track.violation(flight.full.limits) == 0.0


def test_the_same_seed_is_the_same_flight(flight: PilotKnowledge) -> None:
    first, second = (flown(flight, "pid", 1.0, "all") for _ in range(2))
    assert np.array_equal(first.states, second.states)
    assert not np.array_equal(first.states, flown(flight, "pid", 1.0).states)


def test_what_flies_into_an_obstacle_has_touched_it(flight: PilotKnowledge) -> None:
    start = flight.reference.at(0.0).position_m
    pole = Obstacle(start[0], start[1] + 0.5, 0.0, 0.0, 0.0, 0.2, -20.0)
    track = flown(replace(flight, world=replace(flight.world, obstacles=(pole,))), "pid", 0.2)
    assert track.closest_m < VEHICLE_RADIUS_M
    assert track.touched


def results(change: Callable[[FlightScore], FlightScore] = lambda r: r) -> list[FlightScore]:
    errors = {"mpc": 0.01, "riccati": 0.03, "riccati + push": 0.01, "pid": 0.05}
    return [
        change(
            FlightScore(
                s,
                c.name,
                p,
                errors[p],
                0.0,
                1.0,
                touched=False,
                lost=False,
                step_median_s=1e-3,
                step_p99_s=2e-3,
            )
        )
        for s in range(2)
        for c in CASES
        for p in PILOTS
    ]


def test_the_bars_hold_and_fail_one_by_one() -> None:
    assert list(judge(results()).values()) == [True] * 4
    slow = judge(results(lambda r: replace(r, rmse_m=0.026) if r.pilot == "mpc" and r.case == "gust" else r))
    assert list(slow.values()) == [False, False, True, True]
    over = judge(results(lambda r: replace(r, violation=0.011) if r.pilot == "mpc" else r))
    assert list(over.values()) == [True, True, False, True]
    hit = judge(results(lambda r: replace(r, touched=True) if r.pilot == "mpc" else r))
    assert list(hit.values()) == [True, True, True, False]
    other = judge(results(lambda r: replace(r, touched=True, violation=1.0) if r.pilot == "pid" else r))
    assert all(other.values())


def test_table_line_and_picture(flight: PilotKnowledge, tmp_path: Path) -> None:
    assert table(results()).row_count == len(CASES) * len(PILOTS)
    assert "N = 100: mpc 2.0 ms (p99 2.0)" in step_line({"mpc": np.array([0.002])})
    path = tmp_path / "fig14.png"
    picture(path, flight.world, flight.reference, {"pid": flown(flight, "pid", 1.0)}, "nominal")
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("option", "said"), [("--case=storm", "no 'storm'"), ("--output=x.gif", "expected a .png")]
)
def test_what_a_user_gets_wrong_is_reported_in_a_line(option: str, said: str, program: ProgramHere) -> None:
    assert said in program("python -m experiments", "fig14", option).refusal


def test_the_seeds_that_tuned_are_not_those_that_judge() -> None:
    assert min(seed for _, seeds in TRAINING for seed in seeds) >= 1000
    assert fig14.PAPER_STEPS == 100


def test_the_command_names_the_cases_that_are_flown() -> None:
    assert tuple(case.name for case in CASES) == CASE_NAMES
