"""Ways round obstacles: how near they come, whether what cannot be had is held before, and what they cost.

    python -m benchmarks obstacles --scenes 40

Scenes of six to ten poles and walls drawn at random; the reference is flown towards a goal behind them in
every cycle, as the planner does. Prints a table and ends in one line that says which bars hold; the exit
status matches. Nothing was tuned on these scenes (the unit tests' have other seeds).
"""

import argparse
import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from rich.table import Table

from benchmarks.report import BenchReport, figures_table, watched
from companion.base.clock import wall_clock_s
from companion.base.geometry import Vector3
from companion.base.motion import Motion
from companion.config import Box, Cylinder, PlanConfig, Shape
from companion.plan.obstacles.obstacles import Obstacle, clearance_m, route
from companion.plan.trajectory.avoidance import Avoidance
from companion.plan.trajectory.reference_generator import ReferenceGenerator

SMOKE: Final = ("--scenes", "2")
CYCLE_S: Final = 1.0 / 30.0
RADIUS_M: Final = 0.4
MARGIN_M: Final = 1.0
FLIGHT_S: Final = 45.0
ROUTE_MS: Final = 2.0
KEPT_SHARE: Final = 0.95


class SceneFlight(NamedTuple):
    """One scene's flight by the reference alone."""

    clearance_m: float
    reached: bool
    blocked: bool
    slowest_cycle_ms: float


def scene(rng: np.random.Generator) -> tuple[Shape, ...]:
    """Six to ten obstacles between (-10, ...) and (10, ...), none near either end."""
    shapes: list[Shape] = []
    for _ in range(int(rng.integers(6, 11))):
        place = (float(rng.uniform(-6.5, 6.5)), float(rng.uniform(-7.0, 7.0)))
        height = float(rng.uniform(2.0, 12.0))
        if rng.random() < 0.6:
            radius = float(rng.uniform(0.1, 0.8))
            shapes.append(Cylinder(kind="cylinder", centre_ned_m=place, radius_m=radius, height_m=height))
        else:
            length, heading = float(rng.uniform(1.0, 5.0)), float(rng.uniform(-180.0, 180.0))
            shapes.append(
                Box(
                    kind="box",
                    centre_ned_m=place,
                    length_m=length,
                    width_m=0.4,
                    heading_deg=heading,
                    height_m=height,
                )
            )
    return tuple(shapes)


def fly(shapes: tuple[Shape, ...], goal: Vector3) -> SceneFlight:
    """From the south to the goal."""
    config = PlanConfig(obstacles=shapes, obstacle_margin_m=MARGIN_M, obstacle_ceiling_m=9.0)
    generator = ReferenceGenerator(
        config.guidance, lambda _d, _v, _a: 2.0, 20, 0.1, Avoidance(config, RADIUS_M)
    )
    generator.see((0.0, 0.0, 0.0), None)
    generator.start("local", Motion((-11.0, 0.0, -5.0)), 0.0)
    places, slowest_s = [], 0.0
    for k in range(round(FLIGHT_S / CYCLE_S)):
        begun_s = wall_clock_s()
        generator.fly_to(Motion(goal), k * CYCLE_S)
        slowest_s = max(slowest_s, wall_clock_s() - begun_s)
        places.append(generator.at((k + 1) * CYCLE_S).position_m)
    nearest = float(np.min(clearance_m(np.array(places), [Obstacle.of(shape) for shape in shapes])))
    reached = math.dist(places[-1], goal) < 0.3
    return SceneFlight(nearest - RADIUS_M, reached, generator.avoidance.blocked, 1e3 * slowest_s)


def route_ms(rng: np.random.Generator, questions: int) -> float:
    """Median time (ms) of a question among ten obstacles, the graph being made."""
    obstacles = [Obstacle.of(shape) for shape in (scene(rng) + scene(rng))[:10]]
    times = []
    for _ in range(questions):
        start, goal = ((n, float(rng.uniform(-7.0, 7.0)), -5.0) for n in (-11.0, 11.0))
        begun_s = wall_clock_s()
        route(start, goal, obstacles, MARGIN_M + RADIUS_M, ceiling_down_m=-9.0)
        times.append(wall_clock_s() - begun_s)
    return 1e3 * float(np.median(times))


def add_row(name: str, flights: list[SceneFlight], table: Table) -> None:
    """A row of the table."""
    clearances = [flown.clearance_m for flown in flights]
    table.add_row(
        name,
        str(len(flights)),
        str(sum(flown.reached for flown in flights)),
        str(sum(flown.blocked for flown in flights)),
        f"{min(clearances):.2f}",
        f"{np.median([flown.slowest_cycle_ms for flown in flights]):.1f}",
    )


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Run; 0 when every bar holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--seed", type=int, default=100)
    options = parser.parse_args(arguments)
    report = BenchReport(width=120)
    rng = np.random.default_rng(options.seed)
    scenes = [scene(rng) for _ in range(options.scenes)]
    within: Callable[[tuple[Shape, ...]], Vector3] = lambda shapes: (*shapes[0].centre_ned_m, -1.0)  # noqa: E731
    free = [fly(shapes, (11.0, 0.0, -5.0)) for shapes in watched(scenes, "goals behind")]
    hopeless = [
        fly(shapes, within(shapes)) for shapes in watched(scenes[: options.scenes // 2], "goals inside")
    ]
    headings = ("goal", "scenes", "reached", "holding", "nearest, m", "slowest cycle, ms (median)")
    table = figures_table("the reference among obstacles", *headings)
    add_row("behind", free, table)
    add_row("inside one", hopeless, table)
    report.show(table)
    asked_ms = route_ms(rng, 200)
    report.show(f"a way among ten obstacles: {asked_ms:.2f} ms (<= {ROUTE_MS:g}); margin {MARGIN_M:g} m")
    bars = {
        "margin kept": min(f.clearance_m for f in free + hopeless) >= KEPT_SHARE * MARGIN_M,
        "a goal behind is reached or held before": all(f.reached or f.blocked for f in free),
        "a goal inside is held before": all(f.blocked and not f.reached for f in hopeless),
        "time of a way": asked_ms <= ROUTE_MS,
    }
    return report.judge(bars)
