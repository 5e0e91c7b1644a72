"""Tunes the cascaded PID of Fig. 14 and writes configs/control/pid.yaml.

    python -m experiments.tune_pid

Minimised is the mean logarithm of the tracking error over training flights: nominal, gusts, wrong mass
and inertia, all of it with noise, and with twice the noise, on seeds that the comparison does not fly (its
are 100 to 119). The logarithm lets every case count alike; the last case is the margin: without it the search
ends in gains that hold the training flights by a hair and lose others. Powell's method over the logarithms of
the gains, from a hand-made start; the heading has gains of its own, which these flights do not ask for.
"""

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import scipy.optimize
import yaml

from companion.base.files import must_be_writable
from companion.base.geometry import FloatArray
from companion.config import CONFIG_FOLDER, ConfigError
from experiments.fig14.flight import LOST_M, fly
from experiments.fig14.pilots import PilotKnowledge
from experiments.fig14.report import BY_NAME
from experiments.fig14.world import DisturbanceCase, Noise, draw_scene
from experiments.model.full_mpc import load_full
from experiments.model.pid import AngleGains, AxisGains, CascadeGains
from experiments.model.quadrotor import load_quadrotor
from sitl.scenario.scenario import load_airframe

HARSH: Final = DisturbanceCase("all, twice the noise", True, True, Noise(0.04, 0.08, math.radians(1.0), 0.06))
# which case is flown on which seeds
TRAINING: Final = (
    (BY_NAME["nominal"], (1000,)),
    (BY_NAME["gust"], (1000, 1001)),
    (BY_NAME["mass, inertia"], (1001, 1002)),
    (BY_NAME["all"], (1000, 1001, 1002)),
    (HARSH, (1001, 1002, 1003)),
)
TRAINING_S: Final = 7.0  # of each flight: the way round the obstacles
HEADING: Final = AngleGains(attitude_1_s=2.0, rate_1_s=6.0, integral_1_s2=1.0, derivative=0.0)
# position, velocity, integral sideways; the same upwards; attitude, rate, integral, derivative of roll and
# pitch
START: Final = (2.5, 4.0, 1.5, 3.5, 4.0, 3.0, 8.0, 18.0, 10.0, 0.05)
HEADER: Final = """\
# The cascaded PID's gains, written by `python -m experiments.tune_pid`: least mean logarithm of the
# tracking error over {flights}.
# Powell's method, about {evaluations} evaluations; mean error {start:.4f} m at its start, {best:.4f} m here.
"""


def gains_of(numbers: Sequence[float]) -> CascadeGains:
    """A cascade by its ten numbers, in START's order; out of range they are brought within."""

    def axis(position: float, velocity: float, integral: float) -> AxisGains:
        return AxisGains(
            position_1_s=min(position, 20.0),
            velocity_1_s=min(velocity, 30.0),
            integral_1_s2=min(integral, 60.0),
        )

    attitude, rate, integral, derivative = numbers[6:]
    tilt = AngleGains(
        attitude_1_s=min(attitude, 40.0),
        rate_1_s=min(rate, 120.0),
        integral_1_s2=min(integral, 400.0),
        derivative=min(derivative, 2.0),
    )
    return CascadeGains(
        horizontal=axis(*numbers[:3]), vertical=axis(*numbers[3:6]), tilt=tilt, heading=HEADING
    )


def objective() -> Callable[[FloatArray], float]:
    """Mean logarithm of the error (m) over the training flights, of the gains' logarithms."""
    model, full, body = load_quadrotor("x500"), load_full("full"), load_airframe("x500").body
    scenes = {seed: draw_scene(seed) for seed in sorted({seed for _, seeds in TRAINING for seed in seeds})}
    flights = [
        (PilotKnowledge(model, full, gains_of(START), *scenes[seed]), case)
        for case, seeds in TRAINING
        for seed in seeds
    ]

    def mean_log(logarithms: FloatArray) -> float:
        gains = gains_of(np.exp(logarithms).tolist())
        errors = []
        for flight, case in flights:
            track = fly("pid", replace(flight, gains=gains), body, case, TRAINING_S)
            errors.append(LOST_M if track.lost else track.rmse_m)
        return float(np.mean(np.log(errors)))

    return mean_log


def tune(evaluations: int) -> tuple[CascadeGains, float, float]:
    """Gains, and the mean errors (m) at the start and with them."""
    judge, start = objective(), np.log(START)
    found = scipy.optimize.minimize(
        judge,
        start,
        method="Powell",
        bounds=[(x - 2.0, x + 2.0) for x in start],
        options={"maxfev": evaluations, "xtol": 0.02, "ftol": 1e-3},
    )
    return gains_of(np.exp(found.x).tolist()), math.exp(judge(start)), math.exp(float(found.fun))


def write(gains: CascadeGains, header: str, path: Path) -> None:
    """The gains as YAML."""
    numbers = gains.model_dump(include={"horizontal", "vertical", "tilt", "heading"})
    rounded = {part: {k: float(f"{v:.4g}") for k, v in values.items()} for part, values in numbers.items()}
    path.write_text(header + yaml.safe_dump(rounded, sort_keys=False), encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(description="Tune the PID of Fig. 14.")
    parser.add_argument("--evaluations", type=int, default=250)
    parser.add_argument("--to", type=Path, default=CONFIG_FOLDER / "control" / "pid.yaml")
    chosen = parser.parse_args(arguments)
    try:
        must_be_writable("--to", chosen.to, ".yaml")
    except ConfigError as error:
        print(f"tune_pid: {error}", file=sys.stderr)
        return 2
    gains, before_m, after_m = tune(chosen.evaluations)
    header = HEADER.format(
        flights="; ".join(f"{case.name} ({', '.join(map(str, seeds))})" for case, seeds in TRAINING),
        evaluations=chosen.evaluations,
        start=before_m,
        best=after_m,
    )
    write(gains, header, chosen.to)
    print(f"{chosen.to}: mean error {before_m:.4f} m before, {after_m:.4f} m after")
    return 0


if __name__ == "__main__":
    sys.exit(main())
