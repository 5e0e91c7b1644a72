"""What Fig. 14 looks like: the table of its flights, and the picture of one seed's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from companion.base.geometry import FloatArray
from companion.config import ConfigError
from companion.plan.obstacles.obstacles import Obstacle
from experiments.fig14.figure import (
    BY_NAME,
    JUDGED,
    OVER,
    PAPER_STEPS,
    VIOLATION,
    FlightScore,
    of,
    rmse_m,
)
from experiments.fig14.flight import FlownTrack
from experiments.fig14.pilots import PILOTS, VEHICLE_RADIUS_M
from experiments.fig14.reference import PlannedReference
from experiments.fig14.world import FLOWN_S, LandingScene

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
