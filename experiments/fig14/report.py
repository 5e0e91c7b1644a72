"""What Fig. 14 looks like: the table of its flights, and the picture of one seed's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import track as progress
from rich.table import Table

from companion.base.geometry import FloatArray
from companion.config import ConfigError
from companion.plan.obstacles.obstacles import Obstacle
from experiments.fig14.flight import FlownTrack, fly
from experiments.fig14.pilots import PILOTS, VEHICLE_RADIUS_M, PilotKnowledge
from experiments.fig14.world import CASES, FLOWN_S, LandingScene, PlannedReference, draw_scene
from experiments.model.full_mpc import FullMpcConfig, load_full
from experiments.model.pid import load_gains
from experiments.model.quadrotor import QuadrotorModel, load_quadrotor
from sitl.scenario.scenario import load_airframe
from sitl.vehicle.quadrotor import QuadrotorParameters

COLOURS: Final = {"mpc": "tab:red", "riccati": "tab:orange", "riccati + push": "black", "pid": "magenta"}
ENLARGED_M: Final = 0.5  # half the side of the view from above's enlarged part
NOTES: Final = (
    "All pilots: the same Kalman filter of the state, reference, mixer and plant; the filter's time is not",
    "in the steps'. MPC and riccati: the same weights and model, and plan over the horizon. riccati is the",
    "paper's: no bounds, no estimate of what pushes; riccati + push has the filter's, as the MPC has (for",
    "information). pid: position, velocity and acceleration fed forward; gains by",
    "experiments.tune_pid on other seeds.",
)


def table(results: Sequence[FlightScore]) -> Table:
    """A row for each case and pilot, over all seeds."""
    seeds = len({r.seed for r in results})
    grid = Table(title=f"Tracking to a moving pad, {seeds} seed{'s' if seeds > 1 else ''}")
    for heading in (
        *("case", "pilot", "RMSE cm", "worst cm"),
        f"MPC over it (pid <= {OVER['pid']:g}, riccati <= {OVER['riccati']:g})",
        f"violation % (<= {100 * VIOLATION:g})",
        f"closest m (> {VEHICLE_RADIUS_M:g})",
        *("touched, lost", "step ms", "p99"),
    ):
        grid.add_column(heading, justify="right")
    for case in BY_NAME:
        ours_m = rmse_m(of(results, case, "mpc"))
        for pilot in PILOTS:
            flown = of(results, case, pilot)
            grid.add_row(
                *(case, pilot, f"{100 * rmse_m(flown):.1f}", f"{100 * max(r.rmse_m for r in flown):.1f}"),
                f"{ours_m / rmse_m(flown):.2f}" if pilot in OVER and case in JUDGED else "-",
                f"{100 * max(r.violation for r in flown):.1f}",
                f"{min(r.closest_m for r in flown):.2f}",
                f"{sum(r.touched for r in flown)}, {sum(r.lost for r in flown)}",
                f"{1e3 * float(np.median([r.step_median_s for r in flown])):.2f}",
                f"{1e3 * max(r.step_p99_s for r in flown):.1f}",
                end_section=pilot == "pid",
            )
    return grid


def step_line(times: Mapping[str, FloatArray]) -> str:
    """The paper's horizon: MPC beside the recursion."""
    parts = [
        f"{pilot} {1e3 * np.median(spent):.1f} ms (p99 {1e3 * np.percentile(spent, 99):.1f})"
        for pilot, spent in times.items()
    ]
    return f"a step at N = {PAPER_STEPS}: " + ", ".join(parts)


def picture(
    path: Path, world: LandingScene, reference: PlannedReference, tracks: Mapping[str, FlownTrack], case: str
) -> None:
    """The 3-D view, the view from above, and errors over time, as the paper's Fig. 14.

    Raises:
        ConfigError: the picture cannot be written.
    """
    figure = Figure(figsize=(15, 8.5), layout="constrained")
    grid = figure.add_gridspec(2, 3, width_ratios=(1.5, 0.75, 0.75))
    pad = np.array([world.pad.at(t).position_ned_m for t in np.arange(0.0, FLOWN_S, 0.05)])
    flown = {pilot: track.states[:, [0, 2, 4]] * [1.0, -1.0, -1.0] for pilot, track in tracks.items()}
    # the MPC on top; with the estimate the recursion hides under it
    ways = {pilot: flown[pilot] for pilot in ("riccati", "pid", "mpc") if pilot in flown}
    lines = {"pad": pad, "min-jerk": reference.path()} | ways
    _in_space(figure.add_subplot(grid[:, 0], projection="3d"), lines, world.obstacles)
    above = figure.add_subplot(grid[0, 1])
    _from_above(above, lines, world.obstacles)
    _enlarged(above, figure.add_subplot(grid[0, 2]), lines, tracks)
    _errors(figure.add_subplot(grid[1, 1:]), tracks)
    figure.suptitle(f"Tracking a minimum-jerk reference to a moving pad: case {case}, seed {world.seed}")
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: the picture cannot be written: {error}") from error


def _style(name: str) -> dict[str, Any]:
    if name == "pad":
        return {"color": "tab:green", "linewidth": 2.5, "label": "pad"}
    if name == "min-jerk":
        return {"color": "tab:blue", "linewidth": 5.0, "alpha": 0.45, "label": "minimum jerk"}
    dashed = {"linestyle": ":"} if name == "riccati + push" else {}
    return {"color": COLOURS[name], "linewidth": 1.2, "label": name} | dashed


def _in_space(axes: Any, lines: Mapping[str, FloatArray], obstacles: Sequence[Obstacle]) -> None:
    for name, line in lines.items():
        axes.plot(line[:, 1], line[:, 0], -line[:, 2], **_style(name))
    for one in obstacles:
        outline = _outline(one)
        top = min(-one.top_down_m, 7.0)
        heights = np.array([[0.0], [top]]) * np.ones(len(outline))
        axes.plot_surface(
            np.tile(outline[:, 1], (2, 1)), np.tile(outline[:, 0], (2, 1)), heights, color="grey", alpha=0.35
        )
    axes.set(xlabel="east (m)", ylabel="north (m)", zlabel="height (m)")
    axes.set_aspect("equal")
    axes.view_init(elev=35.0, azim=-60.0)
    axes.legend(loc="upper left")


def _from_above(axes: Any, lines: Mapping[str, FloatArray], obstacles: Sequence[Obstacle]) -> None:
    for one in obstacles:
        outline = _outline(one)
        axes.fill(outline[:, 1], outline[:, 0], color="grey", alpha=0.5)
        grown = _outline(one, VEHICLE_RADIUS_M)
        axes.plot(grown[:, 1], grown[:, 0], color="grey", linestyle=":", linewidth=1.0)
    for name, line in lines.items():
        axes.plot(line[:, 1], line[:, 0], **_style(name))
    axes.set(xlabel="east (m)", ylabel="north (m)", title="from above (dotted: would touch)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)


def _enlarged(
    axes: Any, zoom: Any, lines: Mapping[str, FloatArray], tracks: Mapping[str, FlownTrack]
) -> None:
    """Where the pilots are farthest off sideways: on the whole way the lines lie on one another."""
    pilot = max(tracks, key=lambda name: np.abs(tracks[name].errors_m[:, :2]).max() if name in lines else 0.0)
    worst = int(np.hypot(*tracks[pilot].errors_m[:, :2].T).argmax())
    north_m, east_m = lines[pilot][worst, :2]
    for name, line in lines.items():
        zoom.plot(line[:, 1], line[:, 0], **_style(name))
    half_m = ENLARGED_M
    zoom.set(xlim=(east_m - half_m, east_m + half_m), ylim=(north_m - half_m, north_m + half_m))
    zoom.set_aspect("equal")
    zoom.set(xlabel="east (m)", title=f"{2 * half_m:g} m of it, where errors are largest")
    zoom.grid(alpha=0.3)
    axes.indicate_inset(
        (east_m - half_m, north_m - half_m, 2 * half_m, 2 * half_m), edgecolor="black", alpha=1.0
    )


def _errors(axes: Any, tracks: Mapping[str, FlownTrack]) -> None:
    for pilot, track in tracks.items():
        distance_cm = 100.0 * np.linalg.norm(track.errors_m, axis=1)
        style = _style(pilot) | {"label": f"{pilot}: RMSE {100.0 * track.rmse_m:.1f} cm"}
        axes.plot(track.times_s, distance_cm, **style)
    axes.set(xlabel="time (s)", ylabel="distance from the reference (cm)", ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend()


def _outline(one: Obstacle, grown_m: float = 0.0) -> FloatArray:
    """North and east (n, 2) round an obstacle grown by a margin, closed."""
    angles = np.linspace(-np.pi, np.pi, 73)
    reach = one.round_m + grown_m
    along = np.where(np.cos(angles) >= 0.0, 1.0, -1.0) * one.half_length_m + reach * np.cos(angles)
    across = np.where(np.sin(angles) >= 0.0, 1.0, -1.0) * one.half_width_m + reach * np.sin(angles)
    c, s = np.cos(one.heading_rad), np.sin(one.heading_rad)
    return np.column_stack([one.north_m + c * along - s * across, one.east_m + s * along + c * across])


# ---------------------------------------------------------------- figure
# Fig. 14: MPC, the paper's recursion and PID on the same minimum-jerk reference to a moving pad.
#
# Flies every case under every seed, on as many processes as asked for, and judges the bars. What a seed draws
# and who gets what is in `world`, `reference` and `pilots`; `report` makes tables and pictures.

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


# ---------------------------------------------------------------- run
# Figure 14: the flights, the table, the picture and the bars.


def run(seeds: Sequence[int], output: Path, case: str, jobs: int) -> bool:
    """Fly, print and draw; whether all bars hold."""
    console = Console(width=170)
    results: list[FlightScore] = []
    for flown in progress(fly_all(seeds, jobs), "flying", total=len(seeds), console=Console(stderr=True)):
        results += flown
    console.print(table(results))
    for line in NOTES:
        console.print(line, highlight=False)
    _draw(seeds[0], case, output)
    print(step_line(paper_step_s(seeds[0])))
    print(f"picture: {output}")
    found = judge(results)
    print("bars: " + ", ".join(f"{name} {'holds' if holds else 'FAILS'}" for name, holds in found.items()))
    return all(found.values())


def _draw(seed: int, case: str, path: Path) -> None:
    settings = load_settings()
    world, reference = draw_scene(seed)
    flight = flight_of(settings, world, reference)
    tracks = {pilot: fly(pilot, flight, settings.body, BY_NAME[case]) for pilot in PILOTS}
    picture(path, world, reference, tracks, case)
