"""What a person looks at after a replay: the table of errors and the plots.

Plots (PNG): `attitude.png`, `velocity.png`, `position.png`, `pad_motion.png` (of a log with sightings),
`biases.png`, `refused.png`. Times count from the first sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from companion.base.files import save_figure
from companion.base.geometry import FloatArray, euler_from_quat
from companion.flightlog.replay.compare import Comparison, Repetition, ReplayResult, tracks_of
from companion.flightlog.replay.flight_record import FlightRecord, RecordedTrack, Source, TrackName
from companion.flightlog.replay.run import Replayed
from companion.flightlog.report.plots import ESTIMATE_COLOUR, VEHICLE_COLOUR

RECORDED_COLOUR: Final = "black"
COLOURS: Final[dict[Source, str]] = {"recorded": RECORDED_COLOUR, "truth": VEHICLE_COLOUR}
AXES: Final = ("north", "east", "down")
BROAD_PT: Final = 3.0
BROAD_ALPHA: Final = 0.4
UNITS: Final = {"deg": "°", "m_s": "m/s", "m": "m"}


def replay_table(result: ReplayResult) -> Table:
    """The errors against each reference; a quantity that neither has is left out."""
    table = Table(title=f"{Path(result.log).name}: {result.duration_s:.0f} s replayed", title_justify="left")
    table.add_column("replay minus")
    for source in result.errors:
        table.add_column(f"{source}, rms", justify="right")
        table.add_column("95 %", justify="right")
        table.add_column("worst", justify="right")
    figures = {source: dict(errors) for source, errors in result.errors.items()}
    for name in next(iter(figures.values()), {}):
        if any(errors[name] is not None for errors in figures.values()):
            table.add_row(*_row(name, [errors[name] for errors in figures.values()]))
    return table


def _row(name: str, all_figures: Sequence[Any]) -> list[str]:
    suffix = next(key for key in UNITS if name.endswith(f"_{key}"))
    cells = [f"{name.removesuffix(f'_{suffix}').replace('_', ' ')}, {UNITS[suffix]}"]
    for figures in all_figures:
        if figures is None:
            cells += ["-", "-", "-"]
        else:
            cells += [f"{value:.3f}" for value in (figures.rms, figures.p95, figures.worst)]
    return cells


def replay_lines(result: ReplayResult) -> list[str]:
    """What else there is to say, a line each."""
    counts = ", ".join(f"{count} {kind}" for kind, count in result.samples.items())
    refused = ", ".join(f"{count} {kind}" for kind, count in result.refused.items()) or "none"
    north, east, down = result.field.ned_ut
    lines = [
        f"samples: {counts}",
        f"refused: {refused}",
        f"settings: {result.settings}",
        f"Earth's field: ({north:.1f}, {east:.1f}, {down:.1f}) µT, by {result.field.source}",
    ]
    if result.biases is not None:
        gyro = ", ".join(f"{math.degrees(value):.3f}" for value in result.biases.gyro_rad_s)
        accel = ", ".join(f"{value:.3f}" for value in result.biases.accel_m_s2)
        lines.append(f"biases at the end: gyroscope ({gyro}) °/s, accelerometer ({accel}) m/s²")
    if result.repetition is not None:
        lines.append(repetition_line(result.repetition))
    return [*lines, *(f"note: {note}" for note in result.notes)]


def repetition_line(repetition: Repetition) -> str:
    """Whether the flight's estimates came out again."""
    if repetition.identical:
        return f"repeats the flight: all {repetition.states} recorded states to the bit"
    return f"does not repeat the flight: the states differ from time_s {repetition.differs_from_s:.3f} on"


# ---------------------------------------------------------------- plots


@dataclass(frozen=True, slots=True)
class _Drawing:
    """What the plots draw from."""

    record: FlightRecord
    replayed: Replayed
    comparisons: dict[Source, Comparison]
    ours: dict[TrackName, RecordedTrack]
    start_s: float

    def seconds(self, times_s: FloatArray) -> FloatArray:
        return times_s - self.start_s

    def reference(self, source: Source, name: TrackName) -> RecordedTrack | None:
        pair = self.comparisons[source].tracks.get(name)
        return None if pair is None else pair[1]


def write_plots(folder: Path, record: FlightRecord, replayed: Replayed) -> list[Path]:
    """Draw all plots into a folder and return their paths."""
    comparisons = {source: Comparison(replayed, ref) for source, ref in record.references.items()}
    start_s = record.events[0].item.time_s
    drawing = _Drawing(record, replayed, comparisons, tracks_of(replayed), start_s)
    drawings: dict[str, Callable[[Figure, _Drawing], None]] = {
        "attitude.png": draw_attitude,
        "velocity.png": lambda figure, d: draw_vector(figure, d, "velocity", "velocity", "m/s"),
        "biases.png": draw_biases,
        "refused.png": draw_refused,
    }
    if "position" in drawing.ours:
        drawings["position.png"] = lambda figure, d: draw_vector(figure, d, "position", "position", "m")
    if "pad_position" in drawing.ours:
        drawings["pad_motion.png"] = draw_pad
    paths = []
    for name, draw in drawings.items():
        figure = Figure(figsize=(9.0, 6.5), dpi=110, layout="constrained")
        draw(figure, drawing)
        paths.append(folder / name)
        save_figure(figure, paths[-1])
    return paths


def draw_attitude(figure: Figure, drawing: _Drawing) -> None:
    """Roll, pitch and heading of all, and the errors' heading and inclination."""
    grid = figure.subplots(4, 1, sharex=True)
    curves: list[tuple[str, str, RecordedTrack | None]] = [
        (source, COLOURS[source], drawing.reference(source, "attitude")) for source in drawing.comparisons
    ]
    curves.append(("replay", ESTIMATE_COLOUR, drawing.ours["attitude"]))
    for label, colour, track in curves:
        if track is None:
            continue
        angles = np.degrees([euler_from_quat(tuple(q)) for q in track.values.tolist()])
        for axes, column in zip(grid, angles.T, strict=False):
            # dots: a line would run across the page where an angle turns over
            size, alpha = (1.5, 1.0) if label == "replay" else (5.0, BROAD_ALPHA)
            look = {"markersize": size, "alpha": alpha, "markeredgewidth": 0.0, "color": colour}
            axes.plot(drawing.seconds(track.time_s), column, ".", label=label, **look)
    for axes, name in zip(grid, ("roll (°)", "pitch (°)", "heading (°)"), strict=False):
        axes.set_ylabel(name)
    for source, comparison in drawing.comparisons.items():
        times, errors = comparison.attitude_deg()
        for column, name, style in ((1, "inclination", "-"), (2, "heading", ":")):
            _line(
                grid[3],
                drawing.seconds(times),
                errors[:, column],
                COLOURS[source],
                f"{name}, {source}",
                style,
            )
    grid[3].set_ylabel("error (°)")
    _finish(grid, "Attitude")


def draw_vector(figure: Figure, drawing: _Drawing, name: TrackName, title: str, unit: str) -> None:
    """North, east and down of all, and the size of the differences."""
    grid = figure.subplots(4, 1, sharex=True)
    _draw_components(grid[:3], drawing, name, unit)
    for source, comparison in drawing.comparisons.items():
        times, difference = comparison.vector(name)
        lengths = np.linalg.norm(difference, axis=1)
        _line(grid[3], drawing.seconds(times), lengths, COLOURS[source], f"to {source}")
    grid[3].set_ylabel(f"error ({unit})")
    shapes = [c for c in drawing.comparisons.values() if name == "position" and c.position_is_shape]
    aside = "; the error is without its mean" if shapes else ""
    _finish(grid, f"{title.capitalize()} NED{aside}")


def draw_pad(figure: Figure, drawing: _Drawing) -> None:
    """The pad's position relative to the vehicle, and its velocity over ground."""
    grid = figure.subplots(3, 2, sharex=True)
    _draw_components(grid[:, 0], drawing, "pad_position", "m")
    _draw_components(grid[:, 1], drawing, "pad_velocity", "m/s")
    grid[0][0].set_title("Pad minus vehicle, NED")
    grid[0][1].set_title("Pad's velocity, NED")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7)
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")


def draw_biases(figure: Figure, drawing: _Drawing) -> None:
    """What the EKF makes of gyroscope and accelerometer."""
    top, bottom = figure.subplots(2, 1, sharex=True)
    vehicles = drawing.replayed.vehicles
    times = drawing.seconds(np.array([v.time_s for v in vehicles]))
    gyro = np.degrees([v.gyro_bias_rad_s for v in vehicles])
    accel = np.array([v.accel_bias_m_s2 for v in vehicles])
    for k, axis in enumerate(("forward", "right", "down")):
        top.plot(times, gyro[:, k], linewidth=0.8, label=axis)
        bottom.plot(times, accel[:, k], linewidth=0.8, label=axis)
    top.set_ylabel("gyroscope (°/s)")
    bottom.set_ylabel("accelerometer (m/s²)")
    _finish((top, bottom), "Biases, body axes")


def draw_refused(figure: Figure, drawing: _Drawing) -> None:
    """How many measurements have been refused so far, by kind."""
    axes = figure.subplots()
    times = drawing.seconds(np.array([time_s for time_s, _ in drawing.replayed.refused]))
    counts = [refused for _, refused in drawing.replayed.refused]
    for kind in sorted(kind for kind, count in counts[-1].items() if count):
        axes.step(times, [refused.get(kind, 0) for refused in counts], where="post", label=kind)
    axes.set_ylabel("refused so far")
    axes.set_xlabel("time (s)")
    axes.set_title("Measurements refused: not usable, or by the innovation test (_gate)")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=7)


def _draw_components(grid: Sequence[Any], drawing: _Drawing, name: TrackName, unit: str) -> None:
    for source in drawing.comparisons:
        track = drawing.reference(source, name)
        if track is not None:
            for axes, column in zip(grid, track.values.T, strict=True):
                _broad(axes, drawing.seconds(track.time_s), column, COLOURS[source], source)
    if (replayed := drawing.ours.get(name)) is not None:
        for axes, column in zip(grid, replayed.values.T, strict=True):
            _line(axes, drawing.seconds(replayed.time_s), column, ESTIMATE_COLOUR, "replay")
    for axes, axis in zip(grid, AXES, strict=True):
        axes.set_ylabel(f"{axis} ({unit})")


def _line(
    axes: Any, times: FloatArray, values: FloatArray, colour: str, label: str, style: str = "-"
) -> None:
    axes.plot(times, values, style, linewidth=0.8, color=colour, label=label)


def _broad(axes: Any, times: FloatArray, values: FloatArray, colour: str, label: str) -> None:
    """What the replay is held against: broad and pale, to be seen also where the replay lies on it."""
    axes.plot(times, values, linewidth=BROAD_PT, alpha=BROAD_ALPHA, color=colour, label=label)


def _finish(grid: Sequence[Any], title: str) -> None:
    grid[0].set_title(title, loc="right")
    grid[-1].set_xlabel("time (s)")
    for axes in dict.fromkeys((grid[0], grid[-1])):
        if axes.get_legend_handles_labels()[1]:
            _legend_above(axes)


def _legend_above(axes: Any) -> None:
    """Over the axes, at the left of the title: in them it would hide what is drawn."""
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2, "frameon": False}
    axes.legend(ncols=4, fontsize=7, handletextpad=0.4, columnspacing=1.0, **place)
