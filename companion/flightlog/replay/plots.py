"""What a person looks at after a replay: the table of errors, and the page with the plots, `replay.html`.

Times count from the first sample.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import plotly.graph_objects as go
from rich.table import Table

from companion.base.files import write_atomically
from companion.base.geometry import FloatArray, euler_from_quat
from companion.base.units import without_unit
from companion.flightlog.errors import RecordedTrack
from companion.flightlog.replay.compare import Comparison, Repetition, ReplayResult, tracks_of
from companion.flightlog.replay.flight_record import FlightRecord, Source, TrackName
from companion.flightlog.replay.run import Replayed
from companion.flightlog.report.figures import (
    AXES,
    AXIS_COLOURS,
    ESTIMATE_COLOUR,
    VEHICLE_COLOUR,
    add_dots,
    add_line,
    plain,
    stacked,
)
from companion.flightlog.report.page import OTHER_COLOUR, html_page, plot_html, table_html

COLOURS: Final[dict[Source, str]] = {"recorded": "black", "truth": VEHICLE_COLOUR}


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
    cells = [", ".join(without_unit(name))]
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


# ---------------------------------------------------------------- the page


@dataclass(frozen=True, slots=True)
class _Drawing:
    """What the plots draw from."""

    replayed: Replayed
    comparisons: dict[Source, Comparison]
    ours: dict[TrackName, RecordedTrack]
    start_s: float

    def seconds(self, times_s: FloatArray) -> FloatArray:
        return times_s - self.start_s

    def tracks(self, name: TrackName) -> list[tuple[str, str, RecordedTrack]]:
        """Label, colour and track of what the replay is held against, and of the replay."""
        pairs = [(source, self.comparisons[source].tracks.get(name)) for source in self.comparisons]
        found = [(source, COLOURS[source], pair[1]) for source, pair in pairs if pair is not None]
        ours = self.ours.get(name)
        return [*found, *([] if ours is None else [("replay", ESTIMATE_COLOUR, ours)])]


def write_page(path: Path, result: ReplayResult, record: FlightRecord, replayed: Replayed) -> None:
    """Write the table, what else there is to say, and the plots as one page."""
    comparisons = {source: Comparison(replayed, ref) for source, ref in record.references.items()}
    drawing = _Drawing(replayed, comparisons, tracks_of(replayed), record.events[0].item.time_s)
    lines = [line.partition(": ")[::2] for line in replay_lines(result)]
    table = replay_table(result)
    cells = zip(*([str(cell) for cell in column.cells] for column in table.columns), strict=True)
    heads = [str(column.header) for column in table.columns]
    plots = {name: (title, plot_html(figure, name)) for name, (title, figure) in figures(drawing).items()}
    sections = {
        "errors": ("Errors", table_html(heads, list(cells))),
        "notes": ("Notes", table_html(("", ""), lines)),
    }
    title, verdict = str(table.title), ("replay", OTHER_COLOUR)
    write_atomically(path, html_page(title, verdict, result.log, {**sections, **plots}, record.versions))


def figures(drawing: _Drawing) -> dict[str, tuple[str, go.Figure]]:
    shape = any(comparison.position_is_shape for comparison in drawing.comparisons.values())
    aside = "; the error is without its mean" if shape else ""
    found = {
        "attitude": ("Attitude", _attitude(drawing)),
        "velocity": ("Velocity NED", _vector(drawing, "velocity", "m/s")),
        "biases": ("Biases, body axes", _biases(drawing)),
        "refused": ("Measurements refused: not usable, or by the innovation test (_gate)", _refused(drawing)),
    }
    if "position" in drawing.ours:
        found["position"] = (f"Position NED{aside}", _vector(drawing, "position", "m"))
    if "pad_position" in drawing.ours:
        found["pad_position"] = ("Pad minus vehicle, NED", _vector(drawing, "pad_position", "m"))
        found["pad_velocity"] = ("Pad's velocity, NED", _vector(drawing, "pad_velocity", "m/s"))
    return found


def _attitude(drawing: _Drawing) -> go.Figure:
    """Roll, pitch and heading of all, and the errors' inclination and heading."""
    figure = plain(stacked("roll (°)", "pitch (°)", "heading (°)", "error (°)"))
    for label, colour, track in drawing.tracks("attitude"):
        angles = np.degrees([euler_from_quat(tuple(q)) for q in track.values.tolist()])
        for row, column in enumerate(angles.T, start=1):
            # dots: a line would run across the page where an angle turns over
            add_dots(figure, drawing.seconds(track.time_s), column, colour, label, row, legend=row == 1)
    for source, comparison in drawing.comparisons.items():
        times, errors = comparison.attitude_deg()
        for column, name, colour in ((1, "inclination", COLOURS[source]), (2, "heading", AXIS_COLOURS[1])):
            add_line(figure, drawing.seconds(times), errors[:, column], colour, f"{name}, {source}", 4)
    return figure


def _vector(drawing: _Drawing, name: TrackName, unit: str) -> go.Figure:
    """North, east and down of all, and the size of the differences."""
    figure = plain(stacked(*(f"{axis} ({unit})" for axis in AXES), f"error ({unit})"))
    for label, colour, track in drawing.tracks(name):
        for row, column in enumerate(track.values.T, start=1):
            add_line(figure, drawing.seconds(track.time_s), column, colour, label, row, legend=row == 1)
    for source, comparison in drawing.comparisons.items():
        times, difference = comparison.vector(name)
        lengths = np.linalg.norm(difference, axis=1)
        add_line(figure, drawing.seconds(times), lengths, COLOURS[source], f"to {source}", 4)
    return figure


def _biases(drawing: _Drawing) -> go.Figure:
    """What the EKF makes of gyroscope and accelerometer."""
    figure = plain(stacked("gyroscope (°/s)", "accelerometer (m/s²)"))
    vehicles = drawing.replayed.vehicles
    times = drawing.seconds(np.array([v.time_s for v in vehicles]))
    gyro = np.degrees([v.gyro_bias_rad_s for v in vehicles])
    accel = np.array([v.accel_bias_m_s2 for v in vehicles])
    for k, (axis, colour) in enumerate(zip(("forward", "right", "down"), AXIS_COLOURS, strict=True)):
        add_line(figure, times, gyro[:, k], colour, axis, 1)
        add_line(figure, times, accel[:, k], colour, axis, 2, legend=False)
    return figure


def _refused(drawing: _Drawing) -> go.Figure:
    figure = plain(stacked("refused so far"))
    times = drawing.seconds(np.array([time_s for time_s, _ in drawing.replayed.refused]))
    counts = [refused for _, refused in drawing.replayed.refused]
    for kind in sorted(kind for kind, count in counts[-1].items() if count):
        figure.add_scatter(
            x=times, y=[refused.get(kind, 0) for refused in counts], line_shape="hv", name=kind
        )
    return figure
