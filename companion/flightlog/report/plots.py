"""The plots of a simulated flight, as PNG.

`path.png` (3-D path with the pad's, the paper's Fig. 14, and the map), `height.png`, `lateral.png`,
`detections.png` (by marker group), `estimators.png` (errors against truth). Phases are coloured bands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from companion.base.files import save_figure
from companion.base.geometry import FloatArray
from companion.base.messages import FrameReport, Phase, PlanStep, Truth
from companion.config import Cylinder, Shape
from companion.flightlog.errors import TruthTrack, estimate_errors, sighting_errors_body_m
from companion.flightlog.report.phases import PhaseSpan, phase_spans, spread_out
from companion.pad.colours import GROUP_COLOURS

mpl.use("Agg")

VEHICLE_COLOUR: Final = "#c0392b"
PAD_COLOUR: Final = "#27ae60"
OBSTACLE_COLOUR: Final = "#7f8c8d"
ESTIMATE_COLOUR: Final = "#2471a3"
# of each plot: what it shows, over what the flight was
TITLES: Final = {
    "path.png": "paths of vehicle and pad",
    "height.png": "height over the pad, and sink rate",
    "lateral.png": "distance from the pad's centre",
    "detections.png": "markers accepted, by group",
    "estimators.png": "errors of the estimates against the truth",
}
_PASSES: Final[dict[str, Any]] = {"color": "#b80000", "linestyle": "--"}
LEAST_DISTANCE_CM: Final = 0.01  # a logarithm has no zero
GROUP_NAMES: Final = {"F": "far", "M": "medium", "C": "close"}
SIZE_IN: Final = (9.0, 6.5)
# of the strip with the phases' names, in parts of a plot's height; and of a name written upright, in inches
STRIP_SHARE: Final = 0.28
NAME_WIDTH_IN: Final = 0.16
NAME_SIZE: Final = 9
MOST_TICKS: Final = 7  # of an axis in three dimensions


def write_plots(
    folder: Path,
    kept: Mapping[str, Sequence[Any]],
    truth: Sequence[Truth],
    obstacles: Sequence[Shape] = (),
    title: str = "",
    pass_lateral_m: float | None = None,
    pass_vertical_m_s: float | None = None,
) -> list[Path]:
    """Draw all plots into a folder and return their paths; the obstacles (from home) go into `path.png`.

    `pass_lateral_m` and `pass_vertical_m_s` are what passes at touchdown, drawn as lines.

    Raises:
        ValueError: fewer than two records of truth.
    """
    track = TruthTrack(truth)
    drawings: dict[str, Callable[[Figure], None]] = {
        "path.png": lambda figure: draw_path(figure, track, obstacles),
        "height.png": lambda figure: draw_height(figure, track, kept, pass_vertical_m_s),
        "lateral.png": lambda figure: draw_lateral(figure, track, kept, pass_lateral_m),
        "detections.png": lambda figure: draw_detections(figure, track, kept),
        "estimators.png": lambda figure: draw_estimators(figure, track, kept),
    }
    paths = []
    for name, draw in drawings.items():
        figure = Figure(figsize=SIZE_IN, dpi=110, layout="constrained")
        figure.suptitle(f"{TITLES[name]}\n{title}" if title else TITLES[name])
        draw(figure)
        paths.append(folder / name)
        save_figure(figure, paths[-1])
    return paths


# ---------------------------------------------------------------- paths


def draw_path(figure: Figure, track: TruthTrack, obstacles: Sequence[Shape] = ()) -> None:
    """The vehicle's and the pad's paths among the obstacles: in three dimensions, z up, and from above."""
    figure.set_size_inches(12.0, 6.0)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.25, 1.0))
    space: Any = figure.add_subplot(grid[0], projection="3d")
    ground = figure.add_subplot(grid[1])
    vehicle, pad = track.at("position", track.time_s), track.at("pad_position", track.time_s)
    # the pad's is broad and below: over the pad both are the same; a pad that stands has no path
    for path, colour, name, width, marker in (
        (pad, PAD_COLOUR, "pad", 4.0, "s"),
        (vehicle, VEHICLE_COLOUR, "vehicle", 1.4, ""),
    ):
        look: dict[str, Any] = {"color": colour, "linewidth": width, "marker": marker, "markevery": [-1]}
        space.plot(path[:, 1], path[:, 0], -path[:, 2], label=f"{name} (truth)", **look)
        ground.plot(path[:, 1], path[:, 0], **look)
    for shape in obstacles:
        north, east = outline_m(shape)
        sides = np.array([[0.0], [shape.height_m]]) * np.ones_like(north)
        walls = np.vstack((north, north)), np.vstack((east, east))
        space.plot_surface(walls[1], walls[0], sides, color=OBSTACLE_COLOUR, alpha=0.35, linewidth=0.0)
        space.plot(east, north, shape.height_m, color=OBSTACLE_COLOUR, linewidth=0.8)
        ground.fill(east, north, color=OBSTACLE_COLOUR, alpha=0.35)
    space.scatter(vehicle[-1, 1], vehicle[-1, 0], -vehicle[-1, 2], color="black", s=30, label="end")
    ground.plot(vehicle[-1, 1], vehicle[-1, 0], "o", color="black", markersize=5)
    for axes in (space, ground):
        axes.set_xlabel("east (m)")
        axes.set_ylabel("north (m)")
    # beyond the ticks of an axis that is drawn steeply
    space.yaxis.labelpad = 12.0
    space.set_zlabel("up (m)")
    # among obstacles a clearance must look as it is; a long low path needs its own scale upward
    space.set_aspect("equal" if obstacles else "equalxy")
    ground.set_aspect("equal")
    ground.margins(0.1)
    _ticks_by_length(space)
    ground.yaxis.tick_right()
    ground.yaxis.set_label_position("right")
    ground.grid(visible=True, alpha=0.3)
    figure.legend(*space.get_legend_handles_labels(), loc="outside lower center", ncols=3)


def _ticks_by_length(space: Any) -> None:
    """Fewer ticks on the shorter of two horizontal axes of one scale, where they would overlap."""
    spans = [float(np.ptp(limits)) for limits in (space.get_xlim3d(), space.get_ylim3d())]
    for axis, span in zip((space.xaxis, space.yaxis), spans, strict=True):
        axis.set_major_locator(MaxNLocator(max(1, round(MOST_TICKS * span / max(spans)))))


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


# ---------------------------------------------------------------- over time


def draw_height(
    figure: Figure,
    track: TruthTrack,
    kept: Mapping[str, Sequence[Any]],
    pass_vertical_m_s: float | None = None,
) -> None:
    """Height over the pad and vertical speed relative to it."""
    top, bottom = _over_time(figure, 2, kept, track)
    times = track.time_s
    height = track.at("pad_position", times)[:, 2] - track.at("position", times)[:, 2]
    top.plot(times, height, color=VEHICLE_COLOUR, linewidth=1.0, zorder=4, label="truth")
    pads = kept.get("pad", ())
    _dots(top, [pad.time_s for pad in pads], [pad.height_m for pad in pads], ESTIMATE_COLOUR, "pad filter")
    top.set_ylabel("height over the pad (m)")
    relative = track.at("velocity", times)[:, 2] - track.at("pad_velocity", times)[:, 2]
    bottom.plot(times, relative, color=VEHICLE_COLOUR)
    if pass_vertical_m_s is not None:
        bottom.axhline(pass_vertical_m_s, **_PASSES, label="passes below this, at the touchdown")
    bottom.set_ylabel("sink rate relative\nto the pad (m/s)")
    _legend_below(figure, top, bottom)


def draw_lateral(
    figure: Figure,
    track: TruthTrack,
    kept: Mapping[str, Sequence[Any]],
    pass_lateral_m: float | None = None,
) -> None:
    """Horizontal distance to the pad's centre, true and estimated, on a logarithmic scale."""
    (axes,) = _over_time(figure, 1, kept, track)
    times = track.time_s
    offset = (track.at("position", times) - track.at("pad_position", times))[:, :2]
    distance = np.maximum(100.0 * np.linalg.norm(offset, axis=1), LEAST_DISTANCE_CM)
    axes.semilogy(times, distance, color=VEHICLE_COLOUR, label="truth")
    pads = kept.get("pad", ())
    estimated = np.array([pad.relative_position_ned_m[:2] for pad in pads]).reshape(-1, 2)
    distance = np.maximum(100.0 * np.linalg.norm(estimated, axis=1), LEAST_DISTANCE_CM)
    _dots(axes, [pad.time_s for pad in pads], distance, ESTIMATE_COLOUR, "pad filter")
    if pass_lateral_m is not None:
        axes.axhline(100.0 * pass_lateral_m, **_PASSES, label="passes below this, at the touchdown")
    axes.set_ylabel("lateral distance to the pad's centre (cm)")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda distance_cm, _: f"{distance_cm:g}"))
    axes.grid(visible=True, which="both", alpha=0.2)
    _legend_below(figure, axes)


def draw_detections(figure: Figure, track: TruthTrack, kept: Mapping[str, Sequence[Any]]) -> None:
    """How many markers of each group were accepted, over time and over height."""
    halves: Any = figure.subfigures(2, 1, height_ratios=(1.0 + STRIP_SHARE, 1.0))
    over_time, over_height = halves
    (top,) = _over_time(over_time, 1, kept, track)
    bottom = over_height.subplots()
    reports: Sequence[FrameReport] = kept.get("frame_report", ())
    times = np.array([report.time_s for report in reports])
    heights = (track.at("pad_position", times) - track.at("position", times))[:, 2]
    for group, colour in GROUP_COLOURS.items():
        counts = np.array([report.marker_count.get(group, 0) for report in reports])
        seen = counts > 0
        _dots(top, times[seen], counts[seen], colour, f"{group} ({GROUP_NAMES[group]})")
        _dots(bottom, heights[seen], counts[seen], colour)
    for axes in (top, bottom):
        axes.set_ylabel("markers accepted")
        axes.set_ylim(0.0)
    bottom.set_xlabel("height over the pad (m)")
    if any(report.seen for report in reports):
        bottom.set_xscale("log")
        bottom.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        bottom.xaxis.set_major_formatter(FuncFormatter(lambda height_m, _: f"{height_m:g}"))
        bottom.xaxis.set_minor_formatter(NullFormatter())
    _legend_below(over_height, top)


def draw_estimators(figure: Figure, track: TruthTrack, kept: Mapping[str, Sequence[Any]]) -> None:
    """Errors of attitude, velocity, pad position and pad velocity against the truth, airborne."""
    errors = estimate_errors(kept, track)
    grid = _over_time(figure, 4, kept, track)
    grid[0].plot(errors["time_s"], errors["attitude_deg"], color="black", linewidth=0.8)
    grid[0].set_ylabel("attitude\nerror (°)")
    _plot_axes(grid[1], errors["time_s"], errors["velocity_m_s"], "velocity\nerror (m/s)")
    seen_at, seen_error = sighting_errors_body_m(kept.get("sighting", ()), track)
    _dots(grid[2], seen_at, np.linalg.norm(seen_error, axis=1), "grey", "sightings (distance)")
    _plot_axes(grid[2], errors["pad_time_s"], errors["pad_position_m"], "relative\nposition\nerror (m)")
    _plot_axes(grid[3], errors["pad_time_s"], errors["pad_velocity_m_s"], "pad velocity\nerror (m/s)")
    _legend_below(figure, grid[2])


def _plot_axes(axes: Any, times: FloatArray, rows: FloatArray, label: str) -> None:
    for k, name in enumerate(("north", "east", "down")):
        axes.plot(times, rows[:, k], linewidth=0.8, label=name)
    axes.set_ylabel(label)


def _dots(axes: Any, times: Any, values: Any, colour: str, label: str | None = None) -> None:
    axes.plot(times, values, ".", markersize=2.5, color=colour, label=label)


def _legend_below(figure: Any, *plots: Any) -> None:
    """The legend of some plots under all of them, where it hides nothing."""
    shown = [entry for axes in plots for entry in zip(*axes.get_legend_handles_labels(), strict=True)]
    legend = figure.legend(*zip(*shown, strict=True), loc="outside lower center", ncols=4)
    for handle in legend.legend_handles:
        handle.set_markersize(6.0)


# ---------------------------------------------------------------- phases


def _over_time(figure: Any, rows: int, kept: Mapping[str, Sequence[Any]], track: TruthTrack) -> list[Any]:
    """Plots under one another over one time axis, the phases behind them and their names over them."""
    plans: Sequence[PlanStep] = kept.get("plan", ())
    strip, *grid = figure.subplots(
        rows + 1, 1, sharex=True, squeeze=False, height_ratios=(STRIP_SHARE * max(rows, 2) / 2, *[1.0] * rows)
    )[:, 0]
    grid[-1].set_xlabel("time (s)")
    strip.axis("off")
    spans = phase_spans(plans)
    for span in spans:
        for axes in grid:
            axes.axvspan(span.start_s, span.end_s, color=span.colour, alpha=0.22, linewidth=0.0)
    _mark_touchdown(grid, spans, track)
    if spans:
        strip.set_xlim(spans[0].start_s, spans[-1].end_s)
        strip.margins(x=0.0)
        _name_phases(strip, spans)
    return list(grid)


def _mark_touchdown(grid: Sequence[Any], spans: Sequence[PhaseSpan], track: TruthTrack) -> None:
    """Lines where it touched, and where the landing was found to be over; each named once."""
    touches = track.at("in_contact", track.time_s)[:, 0] > 0.5
    contacts_s = track.time_s[1:][touches[1:] & ~touches[:-1]]
    landed_s = [span.start_s for span in spans if span.phase is Phase.LANDED][:1]
    for name, times_s, side in (("contact", contacts_s, "right"), ("landed", landed_s, "left")):
        for axes in grid:
            for time_s in times_s:
                axes.axvline(time_s, color="black", linestyle=":", linewidth=1.0)
        if len(times_s):
            grid[0].annotate(
                name, (times_s[0], 1.0), xycoords=("data", "axes fraction"),
                xytext=(-4 if side == "right" else 4, -4), textcoords="offset points", ha=side, va="top",
                fontsize=9, rotation=90,
            )  # fmt: skip


def _name_phases(strip: Any, spans: Sequence[PhaseSpan]) -> None:
    """The bands in full colour, and over each its name upright, moved aside where two would overprint."""
    low, high = spans[0].start_s, spans[-1].end_s
    apart = NAME_WIDTH_IN / SIZE_IN[0] * 1.15 * (high - low)
    most = int((high - low) / apart) if apart > 0.0 else 1
    named = sorted(sorted(spans, key=lambda span: span.start_s - span.end_s)[:most], key=lambda s: s.start_s)
    middles = [0.5 * (span.start_s + span.end_s) for span in named]
    strip.set_ylim(0.0, 1.0)
    for span in spans:
        strip.axvspan(span.start_s, span.end_s, ymax=0.12, color=span.colour, linewidth=0.0)
    for span, middle, place in zip(named, middles, spread_out(middles, apart, low, high), strict=True):
        strip.plot((middle, place), (0.12, 0.24), color="grey", linewidth=0.5)
        strip.text(place, 0.27, span.name, rotation=90, fontsize=NAME_SIZE, ha="center", va="bottom")
