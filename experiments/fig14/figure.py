"""Fig. 14: MPC, the paper's recursion and PID on the same minimum-jerk reference to a moving pad.

Flies every case under every seed, on as many processes as asked for, and judges the bars. What a seed draws
and who gets what is in `world`, `reference` and `pilots`; `report` makes tables and pictures.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray
from experiments.fig14.flight import FlownTrack, fly
from experiments.fig14.pilots import PILOTS, PilotKnowledge
from experiments.fig14.reference import PlannedReference, draw_scene
from experiments.fig14.world import CASES, LandingScene
from experiments.model.full_mpc import FullMpcConfig, load_full
from experiments.model.pid import load_gains
from experiments.model.quadrotor import QuadrotorModel, load_quadrotor
from sitl.scenario.scenario import load_airframe
from sitl.vehicle.quadrotor import QuadrotorParameters

VEHICLE: Final = "x500"
BY_NAME: Final = {case.name: case for case in CASES}
# the bars: of the MPC's error over another's, in the cases of gusts and of a wrong model
JUDGED: Final = ("gust", "mass, inertia", "all")
OVER: Final = {"pid": 0.5, "riccati": 0.8}
VIOLATION: Final = 0.01
PAPER_STEPS: Final = 100


@dataclass(frozen=True)
class FigureSettings:
    """What does not depend on the seed."""

    model: QuadrotorModel
    full: FullMpcConfig
    body: QuadrotorParameters


@dataclass(frozen=True)
class FlightScore:
    """One flight in numbers; `bound` names what `violation` is of."""

    seed: int
    case: str
    pilot: str
    rmse_m: float
    violation: float
    closest_m: float
    touched: bool
    lost: bool
    step_median_s: float
    step_p99_s: float


@lru_cache(maxsize=1)
def load_settings(vehicle: str = VEHICLE) -> FigureSettings:
    """The shipped vehicle's model and airframe, and the tracker's settings.

    Raises:
        ConfigError: a file is missing or wrong, or the vehicle has no model.
    """
    return FigureSettings(load_quadrotor(vehicle), load_full("full"), load_airframe(vehicle).body)


def flight_of(settings: FigureSettings, world: LandingScene, reference: PlannedReference) -> PilotKnowledge:
    """What the pilots get."""
    return PilotKnowledge(settings.model, settings.full, load_gains("pid"), world, reference)


def fly_seed(seed: int) -> list[FlightScore]:
    """All cases and pilots of one seed.

    Raises:
        ConfigError: see `load_settings`.
    """
    settings = load_settings()
    flight = flight_of(settings, *draw_scene(seed))
    return [
        _result(seed, case.name, pilot, fly(pilot, flight, settings.body, case), settings.full)
        for case in CASES
        for pilot in PILOTS
    ]


def _result(seed: int, case: str, pilot: str, track: FlownTrack, full: FullMpcConfig) -> FlightScore:
    return FlightScore(
        seed,
        case,
        pilot,
        track.rmse_m,
        track.violation(full.limits),
        track.closest_m,
        track.touched,
        track.lost,
        float(np.median(track.step_s)),
        float(np.percentile(track.step_s, 99)),
    )


def fly_all(seeds: Sequence[int], jobs: int) -> Iterator[list[FlightScore]]:
    """Each seed's results as they come, in the order of the seeds.

    Raises:
        ConfigError: see `load_settings`.
    """
    if jobs == 1 or len(seeds) == 1:
        yield from map(fly_seed, seeds)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(fly_seed, seeds)


def of(results: Sequence[FlightScore], case: str, pilot: str) -> list[FlightScore]:
    """Those of a case and a pilot."""
    return [r for r in results if r.case == case and r.pilot == pilot]


def rmse_m(results: Sequence[FlightScore]) -> float:
    """Root mean square over flights of equal length."""
    return float(np.sqrt(np.mean([r.rmse_m**2 for r in results])))


def judge(results: Sequence[FlightScore]) -> dict[str, bool]:
    """Which bars hold."""
    found = {}
    for other, most in OVER.items():
        ratios = [rmse_m(of(results, c, "mpc")) / rmse_m(of(results, c, other)) for c in JUDGED]
        found[f"RMSE MPC <= {most:g} x {other} ({max(ratios):.2f})"] = max(ratios) <= most
    ours = [r for r in results if r.pilot == "mpc"]
    worst = max(r.violation for r in ours)
    found[f"violation <= {VIOLATION:.0%} ({worst:.1%})"] = worst <= VIOLATION
    closest_m = min(r.closest_m for r in ours)
    found[f"no obstacle touched ({closest_m:.2f} m off)"] = not any(r.touched or r.lost for r in ours)
    return found


def paper_step_s(seed: int, flown_s: float = 3.0) -> dict[str, FloatArray]:
    """Times of steps (n,) of MPC and recursion at the paper's horizon, over the start of a flight."""
    settings = load_settings()
    full = settings.full.model_copy(update={"steps": PAPER_STEPS})
    flight = flight_of(FigureSettings(settings.model, full, settings.body), *draw_scene(seed))
    return {
        pilot: fly(pilot, flight, settings.body, BY_NAME["all"], flown_s).step_s
        for pilot in ("mpc", "riccati")
    }
