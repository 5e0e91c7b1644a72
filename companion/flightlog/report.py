"""What a person looks at after a flight: the table of results and the plots.

Plots (PNG): `path.png` (3-D path with the pad's, the paper's Fig. 14), `height.png`, `lateral.png`,
`detections.png` (by marker group), `estimators.png` (errors against truth).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from companion.base.geometry import FloatArray
from companion.base.messages import FrameReport, PlanStep, Truth
from companion.config import Cylinder, Shape
from companion.flightlog.errors import TruthTrack, estimate_errors, sighting_errors_body_m
from companion.flightlog.result import Result

mpl.use("Agg")

VEHICLE_COLOUR: Final = "#c0392b"
PAD_COLOUR: Final = "#27ae60"
OBSTACLE_COLOUR: Final = "#7f8c8d"
ESTIMATE_COLOUR: Final = "#2471a3"
GROUP_COLOURS: Final = {"F": "#7d3c98", "M": "#d68910", "C": "#148f77"}
GROUP_NAMES: Final = {"F": "far", "M": "medium", "C": "close"}


def result_table(result: Result, bounds: Mapping[str, float]) -> Table:
    """The table at the end of a flight; `bounds` maps the touchdown's keys to what passes."""
    table = Table(title=f"{result.scenario}, seed {result.seed}: {result.outcome}", title_justify="left")
    table.add_column("")
    table.add_column("measured", justify="right")
    table.add_column("passes at", justify="right")
    units = {"m_s": "m/s", "m": "m", "deg": "°"}
    if result.touchdown is not None:
        for key, value in result.touchdown.model_dump().items():
            name, unit = _name_and_unit(key, units)
            limit = f"<= {bounds[key]:g} {unit}" if key in bounds else ""
            table.add_row(f"touchdown {name}", f"{value:.3f} {unit}", limit)
    spent = (result.time.search_s, result.time.approach_s, result.time.descent_s)
    rows = {
        "pad speed": f"{result.pad.speed_m_s:.2f} m/s",
        "search / approach / descent": " / ".join(f"{seconds:.1f}" for seconds in spent) + " s",
        "whole flight": f"{result.time.total_s:.1f} s",
        "frames with the pad": f"{result.vision.frames_with_pad} of {result.vision.frames}",
        "sighting error (rms)": _optional(result.vision.relative_position_rmse_m, "m"),
        "attitude error (rms)": _optional(result.estimate.attitude_rmse_deg, "°"),
        "velocity error (rms)": _optional(result.estimate.velocity_rmse_m_s, "m/s"),
        "pad velocity error (rms)": _optional(result.estimate.pad_velocity_rmse_m_s, "m/s"),
        "exposure to setpoint": _optional(result.latency_ms.exposure_to_setpoint_p50, "ms (median)"),
        "control cycles late": _optional(result.latency_ms.cycle_late_p99, "ms (p99)"),
        "control cycles unsolved": f"{result.control.unsolved} of {result.control.cycles}",
        "simulated / real time": f"{result.sim.real_time_factor:.1f}",
    }
    for name, text in rows.items():
        table.add_row(name, text, "")
    return table


def _name_and_unit(key: str, units: Mapping[str, str]) -> tuple[str, str]:
    for suffix, unit in units.items():
        if key.endswith(f"_{suffix}"):
            return key.removesuffix(f"_{suffix}").replace("_", " "), unit
    return key, ""


def _optional(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.3f} {unit}"


def write_plots(
    folder: Path,
    kept: Mapping[str, Sequence[Any]],
    truth: Sequence[Truth],
    obstacles: Sequence[Shape] = (),
) -> list[Path]:
    """Draw all plots into a folder and return their paths; the obstacles (from home) go into `path.png`.

    Raises:
        ValueError: fewer than two records of truth.
    """
    track = TruthTrack(truth)
    drawings: dict[str, Callable[[Figure], None]] = {
        "path.png": lambda figure: draw_path(figure, track, obstacles),
        "height.png": lambda figure: draw_height(figure, track, kept),
        "lateral.png": lambda figure: draw_lateral(figure, track, kept),
        "detections.png": lambda figure: draw_detections(figure, track, kept.get("frame_report", ())),
        "estimators.png": lambda figure: draw_estimators(figure, track, kept),
    }
    paths = []
    for name, draw in drawings.items():
        figure = Figure(figsize=(9.0, 6.5), dpi=110, layout="constrained")
        draw(figure)
        paths.append(folder / name)
        figure.savefig(paths[-1])
    return paths


def draw_path(figure: Figure, track: TruthTrack, obstacles: Sequence[Shape] = ()) -> None:
    """The vehicle's and the pad's paths among the obstacles, z up (the paper's Fig. 14)."""
    axes: Any = figure.add_subplot(projection="3d")
    vehicle, pad = track.at("position", track.time_s), track.at("pad_position", track.time_s)
    axes.plot(vehicle[:, 1], vehicle[:, 0], -vehicle[:, 2], color=VEHICLE_COLOUR, label="vehicle")
    axes.plot(pad[:, 1], pad[:, 0], -pad[:, 2], color=PAD_COLOUR, label="pad")
    for shape in obstacles:
        north, east = outline_m(shape)
        sides = np.array([[0.0], [shape.height_m]]) * np.ones_like(north)
        walls = np.vstack((north, north)), np.vstack((east, east))
        axes.plot_surface(walls[1], walls[0], sides, color=OBSTACLE_COLOUR, alpha=0.35, linewidth=0.0)
        axes.plot(east, north, shape.height_m, color=OBSTACLE_COLOUR, linewidth=0.8)
    axes.scatter(vehicle[-1, 1], vehicle[-1, 0], -vehicle[-1, 2], color="black", s=30, label="end")
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.set_zlabel("up (m)")
    if obstacles:
        axes.set_aspect("equal")  # or a clearance would look other than it is
    axes.set_title("Path of vehicle and pad (truth)")
    axes.legend()


def outline_m(shape: Shape) -> tuple[FloatArray, FloatArray]:
    """North and east (m, from home) of an obstacle's outline, closed, (n,) each."""
    north, east = shape.centre_ned_m
    if isinstance(shape, Cylinder):
        turn = np.linspace(0.0, 2.0 * np.pi, 25)
        return north + shape.radius_m * np.cos(turn), east + shape.radius_m * np.sin(turn)
    along = 0.5 * shape.length_m * np.array([1.0, 1.0, -1.0, -1.0, 1.0])
    across = 0.5 * shape.width_m * np.array([1.0, -1.0, -1.0, 1.0, 1.0])
    c, s = np.cos(np.radians(shape.heading_deg)), np.sin(np.radians(shape.heading_deg))
    return north + c * along - s * across, east + s * along + c * across


def draw_height(figure: Figure, track: TruthTrack, kept: Mapping[str, Sequence[Any]]) -> None:
    """Height over the pad and vertical speed relative to it."""
    top, bottom = figure.subplots(2, 1, sharex=True)
    times = track.time_s
    height = track.at("pad_position", times)[:, 2] - track.at("position", times)[:, 2]
    top.plot(times, height, color=VEHICLE_COLOUR, label="truth")
    pads = kept.get("pad", ())
    top.plot(
        [pad.time_s for pad in pads],
        [pad.height_m for pad in pads],
        ".",
        markersize=2,
        color=ESTIMATE_COLOUR,
        label="pad filter",
    )
    top.set_ylabel("height over the pad (m)")
    top.legend()
    relative = track.at("velocity", times)[:, 2] - track.at("pad_velocity", times)[:, 2]
    bottom.plot(times, relative, color=VEHICLE_COLOUR)
    bottom.set_ylabel("sink rate relative\nto the pad (m/s)")
    bottom.set_xlabel("time (s)")
    _mark_phases((top, bottom), kept.get("plan", ()))


def draw_lateral(figure: Figure, track: TruthTrack, kept: Mapping[str, Sequence[Any]]) -> None:
    """Horizontal distance to the pad's centre, true and estimated, on a logarithmic scale."""
    axes = figure.subplots()
    times = track.time_s
    offset = (track.at("position", times) - track.at("pad_position", times))[:, :2]
    axes.semilogy(
        times, np.maximum(np.linalg.norm(offset, axis=1), 1e-3), color=VEHICLE_COLOUR, label="truth"
    )
    pads = kept.get("pad", ())
    estimated = np.array([pad.relative_position_ned_m[:2] for pad in pads]).reshape(-1, 2)
    axes.semilogy(
        [pad.time_s for pad in pads],
        np.maximum(np.linalg.norm(estimated, axis=1), 1e-3),
        ".",
        markersize=2,
        color=ESTIMATE_COLOUR,
        label="pad filter",
    )
    axes.set_ylabel("lateral distance to the pad's centre (m)")
    axes.set_xlabel("time (s)")
    axes.legend()
    axes.grid(visible=True, which="both", alpha=0.2)
    _mark_phases((axes,), kept.get("plan", ()))


def draw_detections(figure: Figure, track: TruthTrack, reports: Sequence[FrameReport]) -> None:
    """How many markers of each group were accepted, over time and over height."""
    top, bottom = figure.subplots(2, 1)
    times = np.array([report.time_s for report in reports])
    heights = (track.at("pad_position", times) - track.at("position", times))[:, 2]
    for group, colour in GROUP_COLOURS.items():
        counts = np.array([report.marker_count.get(group, 0) for report in reports])  # type: ignore[call-overload]
        top.plot(times, counts, ".", markersize=3, color=colour, label=f"{group} ({GROUP_NAMES[group]})")
        seen = counts > 0
        bottom.plot(heights[seen], counts[seen], ".", markersize=3, color=colour)
    top.set_xlabel("time (s)")
    top.set_ylabel("markers accepted")
    top.legend()
    bottom.set_xlabel("height over the pad (m)")
    bottom.set_ylabel("markers accepted")
    bottom.set_xscale("log")


def draw_estimators(figure: Figure, track: TruthTrack, kept: Mapping[str, Sequence[Any]]) -> None:
    """Errors of attitude, velocity, pad position and pad velocity against the truth."""
    errors = estimate_errors(kept, track)
    grid = figure.subplots(4, 1, sharex=True)
    grid[0].plot(errors["time_s"], errors["attitude_deg"], color=ESTIMATE_COLOUR)
    grid[0].set_ylabel("attitude (°)")
    _plot_axes(grid[1], errors["time_s"], errors["velocity_m_s"], "velocity (m/s)")
    seen_at, seen_error = sighting_errors_body_m(kept.get("sighting", ()), track)
    grid[2].plot(
        seen_at, np.linalg.norm(seen_error, axis=1), ".", markersize=2, color="grey", label="sightings"
    )
    _plot_axes(grid[2], errors["pad_time_s"], errors["pad_position_m"], "relative\nposition (m)")
    _plot_axes(grid[3], errors["pad_time_s"], errors["pad_velocity_m_s"], "pad velocity\n(m/s)")
    grid[0].set_title("Estimate minus truth, airborne")
    grid[3].set_xlabel("time (s)")


def _plot_axes(axes: Any, times: FloatArray, rows: FloatArray, label: str) -> None:
    for k, name in enumerate(("north", "east", "down")):
        axes.plot(times, rows[:, k], linewidth=0.8, label=name)
    axes.set_ylabel(label)
    axes.legend(loc="upper left", ncols=4, fontsize=7)


def _mark_phases(all_axes: Sequence[Any], plans: Sequence[PlanStep]) -> None:
    """A thin line and a name where a phase begins."""
    previous = None
    for plan in plans:
        if plan.phase == previous:
            continue
        previous = plan.phase
        for axes in all_axes:
            axes.axvline(plan.time_s, color="grey", linewidth=0.5)
        all_axes[0].text(
            plan.time_s,
            1.0,
            f" {plan.phase}",
            rotation=90,
            fontsize=6,
            verticalalignment="top",
            transform=all_axes[0].get_xaxis_transform(),
        )
