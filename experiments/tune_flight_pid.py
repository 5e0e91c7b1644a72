"""Tunes `control.pid` for flight: the gains under which the vehicle of `tracking_loop` tracks best.

Searched are, for each direction, the natural frequency w, the damping z and the integral's share k of
p³ + K_d p² + K_p p + K_i with K_p = w², K_d = 2 z w and K_i = k w³: a Latin hypercube over the whole box,
then narrower draws about the best. What is minimised is the root mean square of the tracking error over
all cases of the training seeds; horizontal and vertical gains are drawn together and judged apart, since
the axes hardly meet. Afterwards the winner flies held-out seeds, beside the other controllers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import qmc

from companion.base.geometry import FloatArray
from companion.config import ControlConfig, PidConfig, PidGains
from experiments.tracking_loop import CASES, TrackingLoop

TRAINING_SEEDS: Final = (100,)
HELD_OUT_SEEDS: Final = (200, 201, 202)
FLIGHT_S: Final = 14.0
LOWEST: Final = np.array([0.8, 0.5, 0.0])  # w (rad/s), z, k
HIGHEST: Final = np.array([4.5, 1.6, 0.4])
ROUNDS: Final = 3
NARROWING: Final = 0.4  # of the box, from round to round
DIGITS: Final = 2

Report = Callable[[str], None]


def gains_of(shape: FloatArray) -> PidGains:
    """Gains of a natural frequency (rad/s), a damping and an integral share (3,)."""
    w, z, k = shape.tolist()
    return PidGains(
        position_gain_1_s2=round(w * w, DIGITS),
        velocity_gain_1_s=round(2.0 * z * w, DIGITS),
        integral_gain_1_s3=round(k * w**3, DIGITS),
    )


def rmse_m(config: ControlConfig, seeds: Sequence[int]) -> FloatArray:
    """Horizontal and vertical root mean square error (2,) over all cases and seeds."""
    flights = [TrackingLoop(config, case, seed).fly(FLIGHT_S).rmse_m() for case in CASES for seed in seeds]
    mean: FloatArray = np.sqrt(np.mean(np.square(flights), axis=0))
    return mean


@dataclass(slots=True)
class _Best:
    """The best shape of one direction so far."""

    shape: FloatArray
    error_m: float = np.inf

    def hear(self, shape: FloatArray, error_m: float) -> None:
        if error_m < self.error_m:
            self.shape, self.error_m = shape, error_m


def tune(draws: int, seed: int, report: Report) -> PidConfig:
    """The best gains of `draws` draws a round; `report` takes a line of progress."""
    middle = 0.5 * (LOWEST + HIGHEST)
    best = (_Best(middle), _Best(middle))
    sampler = qmc.LatinHypercube(d=6, rng=np.random.default_rng(seed))
    for step in range(ROUNDS):
        half = 0.5 * (HIGHEST - LOWEST) * NARROWING**step
        centres = np.concatenate([b.shape for b in best])
        samples = centres + (2.0 * sampler.random(draws) - 1.0) * np.tile(half, 2)
        samples = np.clip(samples, np.tile(LOWEST, 2), np.tile(HIGHEST, 2))
        for sample in samples:
            shapes = (sample[:3], sample[3:])
            config = _config(*shapes)
            for found, shape, error_m in zip(best, shapes, rmse_m(config, TRAINING_SEEDS), strict=True):
                found.hear(shape, float(error_m))
        errors = ", ".join(f"{100.0 * b.error_m:.1f} cm" for b in best)
        report(f"round {step + 1} of {ROUNDS}: horizontal, vertical {errors}")
    return _config(best[0].shape, best[1].shape).pid


def _config(horizontal: FloatArray, vertical: FloatArray) -> ControlConfig:
    pid = PidConfig(horizontal=gains_of(horizontal), vertical=gains_of(vertical))
    return ControlConfig(controller="pid", pid=pid)


def held_out_table(pid: PidConfig) -> Table:
    """Tracking errors on seeds that tuned nothing."""
    table = Table(title=f"held-out seeds {', '.join(map(str, HELD_OUT_SEEDS))}", title_justify="left")
    for name in ("controller", "horizontal RMSE (cm)", "vertical RMSE (cm)"):
        table.add_column(name, justify="right")
    configs = {
        "pid": ControlConfig(controller="pid", pid=pid),
        "riccati": ControlConfig(controller="riccati"),
        "mpc": ControlConfig(),
    }
    for name, config in configs.items():
        table.add_row(name, *(f"{100.0 * value:.2f}" for value in rmse_m(config, HELD_OUT_SEEDS)))
    return table


def show(pid: PidConfig, console: Console) -> None:
    """The settings to put into a file, and how they do elsewhere."""
    console.print("control:\n  controller: pid\n  pid:", highlight=False)
    for name, gains in (("horizontal", pid.horizontal), ("vertical", pid.vertical)):
        numbers = ", ".join(f"{key}: {value:g}" for key, value in gains.model_dump().items())
        console.print(f"    {name}: {{{numbers}}}", highlight=False, soft_wrap=True)
    console.print(held_out_table(pid))
