"""What a step of the flight MPC costs, beside setting the same problem up anew each step.

    python -m benchmarks mpc --steps 600

Flies the MPC's own model, pushed about by gusts, along three references; every step is solved by the MPC as
it flies (matrices set up once, vectors updated, warm start), by `osqp.setup` and a solve of the same problem
with the same settings. Times are of the thread, so that a busy machine does not count. Prints a table and
ends in one line that says which bars hold; the exit status matches.
"""

import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import osqp
from rich.table import Table

from benchmarks.report import BenchReport, figures_table
from companion.base.geometry import ZERO3, FloatArray, Vector3, add, vector3
from companion.base.motion import Motion
from companion.config import ControlConfig
from companion.control.mpc.mpc import SETTINGS, Mpc
from companion.control.mpc.qp import QuadraticProgram
from companion.control.mpc.target import within_reach
from companion.control.response.flight_model import advance
from companion.control.tracking import Cone, Target

SMOKE: Final = ("--steps", "20")
LAGS_S: Final = (0.11, 0.11, 0.04)
STEP_P99_MS: Final = 5.0
FASTER_THAN_SETUP: Final = 5.0
# setting up anew is slow: of every so many steps one
ANEW_EVERY: Final = 5

Course = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]


@dataclass
class MpcFigures:
    """What was measured on one reference (ms, iterations); `anew_ms` are a sample of the steps."""

    step_ms: list[float] = field(default_factory=list)
    anew_ms: list[float] = field(default_factory=list)
    iterations: list[int] = field(default_factory=list)
    unsolved: int = 0
    difference_m_s2: float = 0.0


def circle(times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """1.5 m/s on a circle of 5 m."""
    radius, rate = 5.0, 0.3
    phase = rate * times_s
    still = np.zeros_like(phase)
    across, along = np.sin(phase), np.cos(phase)
    return (
        np.stack([radius * across, radius * (1.0 - along), still - 2.0], axis=1),
        radius * rate * np.stack([along, across, still], axis=1),
        radius * rate**2 * np.stack([-across, along, still], axis=1),
    )


def descent(times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Down at 0.7 m/s again and again, from 4 m to where the cone is narrow."""
    height = 0.3 + np.abs((0.7 * times_s) % 7.4 - 3.7)
    rate = np.where((0.7 * times_s) % 7.4 < 3.7, 0.7, -0.7)
    still = np.zeros_like(height)
    return np.stack([still, still, -height], 1), np.stack([still, still, rate], 1), np.zeros((len(height), 3))


def far_steps(times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """To and fro between points 60 m apart, so that many bounds bind."""
    north = np.full_like(times_s, 30.0 if times_s[0] % 20.0 < 10.0 else -30.0)
    still = np.zeros((len(times_s), 3))
    return np.stack([north, 0.5 * north, -10.0 + 0.1 * north], axis=1), still, still


COURSES: Final[dict[str, Course]] = {"circle": circle, "descent": descent, "far steps": far_steps}


def fly(course: Course, steps: int, config: ControlConfig) -> MpcFigures:
    """One reference, in gusts."""
    rng, found = np.random.default_rng(1), MpcFigures()
    mpc, period_s = Mpc(config, LAGS_S), 1.0 / config.rate_hz
    nodes_s: FloatArray = config.step_s * np.arange(config.horizon_steps + 1, dtype=np.float64)
    first = course(nodes_s)
    motion, last = Motion(vector3(first[0][0].tolist()), vector3(first[1][0].tolist()), ZERO3), ZERO3
    push: Vector3 = ZERO3
    for k in range(steps):
        push = vector3((0.97 * np.array(push) + 0.15 * rng.normal(size=3)).tolist())
        target = _target(course(nodes_s + k * period_s), motion, config, cone=course is descent)
        began_s = time.thread_time()
        solution = mpc.solve(motion, target, push, last)
        found.step_ms.append(1e3 * (time.thread_time() - began_s))
        found.iterations.append(solution.iterations)
        found.unsolved += not solution.solved
        if k % ANEW_EVERY == 0:
            _anew(mpc.problem(), solution.inputs_m_s2, found, config)
        last = vector3(solution.inputs_m_s2[0].tolist())
        motion = advance(motion, add(last, push), period_s, LAGS_S)
    return found


def _target(
    rows: tuple[FloatArray, FloatArray, FloatArray], motion: Motion, config: ControlConfig, *, cone: bool
) -> Target:
    apex = np.zeros_like(rows[0])
    target = Target(*rows, cone=Cone(0.2, 0.1, apex) if cone else None)
    return within_reach(target, motion.position_m, config.horizontal_reach_m, config.vertical_reach_m)


def _anew(problem: QuadraticProgram, inputs: FloatArray, found: MpcFigures, config: ControlConfig) -> None:
    """The same problem from nothing."""
    began_s = time.thread_time()
    solver = osqp.OSQP()
    bounds = (problem.lower, problem.upper)
    solver.setup(problem.P, problem.q, problem.A, *bounds, max_iter=config.maximum_iterations, **SETTINGS)
    result = solver.solve(raise_error=False)
    found.anew_ms.append(1e3 * (time.thread_time() - began_s))
    first = 9 * config.horizon_steps
    off = float(np.abs(result.x[first : first + 3] - inputs[0]).max())
    found.difference_m_s2 = max(found.difference_m_s2, off) if math.isfinite(off) else math.inf


def table(all_found: dict[str, MpcFigures]) -> Table:
    """All of it."""
    grid = figures_table(
        "A step of the flight MPC, 20 steps of 0.1 s",
        *("reference", "p50 ms", f"p99 ms (<= {STEP_P99_MS:g})", "worst ms"),
        *("iterations p50, p99", "unsolved", "set up anew p50 ms", f"times (>= {FASTER_THAN_SETUP:g})"),
    )
    for name, found in all_found.items():
        step, counts = np.percentile(found.step_ms, (50, 99, 100)), np.percentile(found.iterations, (50, 99))
        anew = float(np.median(found.anew_ms))
        grid.add_row(
            name,
            *(f"{value:.2f}" for value in step),
            f"{counts[0]:.0f}, {counts[1]:.0f}",
            f"{found.unsolved} of {len(found.step_ms)}",
            f"{anew:.2f}",
            f"{anew / step[0]:.1f}",
        )
    return grid


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=600)
    chosen = parser.parse_args(arguments)
    report = BenchReport(width=150)
    found = {name: fly(course, chosen.steps, ControlConfig()) for name, course in COURSES.items()}
    report.show(table(found))
    step_ms = np.concatenate([each.step_ms for each in found.values()])
    anew_ms = np.concatenate([each.anew_ms for each in found.values()])
    ratio = float(np.median(anew_ms) / np.median(step_ms))
    p50, p99 = np.percentile(step_ms, (50, 99))
    report.show(f"all: p50 {p50:.2f} ms, p99 {p99:.2f} ms; set up anew {ratio:.1f} times as long")
    bars = {
        "step p99": float(p99) <= STEP_P99_MS,
        "faster than setting up anew": ratio >= FASTER_THAN_SETUP,
    }
    return report.judge(bars)
