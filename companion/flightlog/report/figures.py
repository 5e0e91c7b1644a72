"""The plots of the page: made with plotly, to be zoomed, panned and read off in a browser.

The truth is drawn where there is one (the simulator's); else the estimates stand alone.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Final

import numpy as np
import plotly.graph_objects as go
import plotly.io
from plotly.subplots import make_subplots

from companion.base.geometry import FloatArray
from companion.base.messages import Phase, PlanStep
from companion.config import Cylinder, PlanConfig, Shape
from companion.flightlog.errors import TruthTrack, estimate_errors, sighting_errors_body_m
from companion.flightlog.report.logged_flight import LoggedFlight
from companion.flightlog.result import setpoint_delays_s
from companion.pad.colours import GROUP_COLOURS

plotly.io.templates.default = "plotly_white"
VEHICLE_COLOUR: Final = "#c0392b"
PAD_COLOUR: Final = "#27ae60"
OBSTACLE_COLOUR: Final = "#7f8c8d"
ESTIMATE_COLOUR: Final = "#2471a3"
AXIS_COLOURS: Final = (ESTIMATE_COLOUR, "#b9770e", "#148f77")
PASS_COLOUR: Final = "#b80000"
GROUP_NAMES: Final = {"F": "far", "M": "medium", "C": "close"}
HEIGHT_PX: Final = 330
PATH_HEIGHT_PX: Final = 560
NAMES_PX: Final = 95  # over the plots, for the phases' names
# a band that is narrower than this share of the flight has its name in the hover text alone
NAMED_SHARE: Final = 0.045
AXES: Final = ("north", "east", "down")
# by kind: on the ground, on the way, looking, closing in, down; what goes wrong is warm
PHASE_COLOURS: Final = {
    Phase.STANDBY: "#95a5a6",
    Phase.CONNECT: "#b2babb",
    Phase.ARM: "#7f8c8d",
    Phase.TAKE_OFF: "#5d6d7e",
    Phase.WAYPOINT: "#aeb6bf",
    Phase.ROUTE: "#85929e",
    Phase.SEARCH: "#f4d03f",
    Phase.APPROACH: "#5dade2",
    Phase.DESCEND: "#58d68d",
    Phase.TOUCHDOWN: "#1e8449",
    Phase.LANDED: "#a569bd",
    Phase.HOLD: "#eb984e",
    Phase.ABORT: "#e74c3c",
}


def figures(
    flight: LoggedFlight, bounds: Mapping[str, float] | None = None
) -> dict[str, tuple[str, go.Figure]]:
    """Titles and plots by the name of their place on the page; a plot without data is left out.

    `bounds`: what passes, by the touchdown's keys; drawn as lines.
    """
    pass_m, pass_m_s = ((bounds or {}).get(key) for key in ("lateral_error_m", "vertical_speed_m_s"))
    track = TruthTrack(flight.truth) if len(flight.truth) > 1 else None
    drawn = {
        "path": ("Path", path_figure(flight, track)),
        "height": ("Height over the pad", height_figure(flight, track, pass_m_s)),
        "lateral": ("Lateral distance", lateral_figure(flight, track, pass_m)),
        "velocity": ("Velocity", velocity_figure(flight)),
        "stated": ("Stated errors", stated_figure(flight)),
        "errors": ("Errors against the truth", error_figure(flight, track)),
        "markers": ("Markers", marker_figure(flight, track)),
        "latency": ("Latency", latency_figure(flight)),
    }
    return {name: (title, figure) for name, (title, figure) in drawn.items() if figure is not None}


# ---------------------------------------------------------------- the path


def path_figure(flight: LoggedFlight, track: TruthTrack | None) -> go.Figure | None:
    """Vehicle, pad and obstacles in three dimensions, equal axes, z up."""
    paths = _estimated_paths(flight)
    if track is not None:
        columns = {"vehicle": "position", "pad": "pad_position"}
        paths = {name: track.at(column, track.time_s) for name, column in columns.items()}
    if not len(paths["vehicle"]):
        return None
    figure = go.Figure()
    for name, colour in (("vehicle", VEHICLE_COLOUR), ("pad", PAD_COLOUR)):
        north, east, down = paths[name].T
        line = {"color": colour, "width": 4}
        figure.add_scatter3d(x=east, y=north, z=-down, mode="lines", line=line, name=name)
    north, east, down = paths["vehicle"][-1]
    end = {"size": 4, "color": "black"}
    figure.add_scatter3d(x=[east], y=[north], z=[-down], mode="markers", marker=end, name="end")
    for shape in _obstacles(flight):
        around_north, around_east = outline_m(shape)
        for height_m in (0.0, shape.height_m):
            figure.add_scatter3d(
                x=around_east,
                y=around_north,
                z=np.full_like(around_east, height_m),
                mode="lines",
                line={"color": OBSTACLE_COLOUR, "width": 3},
                name="obstacle",
                showlegend=False,
            )
    axes = {axis: {"title": f"{name} (m)"} for axis, name in zip("xyz", ("east", "north", "up"), strict=True)}
    scene = {f"{axis}axis": spec for axis, spec in axes.items()}
    figure.update_layout(scene={**scene, **_equal_axes(figure)}, height=PATH_HEIGHT_PX)
    # labels in three dimensions need no margin beside them
    return plain(figure).update_layout(margin={"l": 5, "r": 5})


def _equal_axes(figure: go.Figure) -> dict[str, Any]:
    """One scale on all axes, the longest side 1, so that the whole of it is before the camera."""
    sides, ranges = dict[str, float](), dict[str, list[float]]()
    for axis in "xyz":
        values = np.concatenate([np.asarray(trace[axis], dtype=float) for trace in figure.data])
        side = sides[axis] = max(float(np.ptp(values)), 1.0)
        middle = 0.5 * float(values.min() + values.max())
        ranges[axis] = [middle - 0.5 * side, middle + 0.5 * side]
    longest = max(sides.values())
    ratio = {axis: side / longest for axis, side in sides.items()}
    # from the south-west, so that north and east rise away from whoever looks
    camera = {"eye": {"x": -0.95, "y": -1.15, "z": 0.8}}
    return {
        "aspectmode": "manual",
        "aspectratio": ratio,
        "camera": camera,
        **{f"{axis}axis_range": span for axis, span in ranges.items()},
    }


def _estimated_paths(flight: LoggedFlight) -> dict[str, FloatArray]:
    """The vehicle's by the EKF once it has a place, and the pad's where it was, relative to that."""
    placed = [vehicle for vehicle in flight.kept.get("vehicle", ()) if vehicle.origin is not None]
    vehicle = np.array([v.position_ned_m for v in placed]).reshape(-1, 3)
    if not len(vehicle):
        return {"vehicle": vehicle, "pad": vehicle}
    times = np.array([v.time_s for v in placed])
    pads = [pad for pad in flight.kept.get("pad", ()) if times[0] <= pad.time_s <= times[-1]]
    at = np.array([pad.time_s for pad in pads])
    relative = np.array([pad.relative_position_ned_m for pad in pads]).reshape(-1, 3)
    under = np.stack([np.interp(at, times, column) for column in vehicle.T], axis=1).reshape(-1, 3)
    return {"vehicle": vehicle, "pad": under + relative}


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


def _obstacles(flight: LoggedFlight) -> Sequence[Shape]:
    plan = flight.settings.get("config", {}).get("plan")
    return () if plan is None else PlanConfig.model_validate(plan).obstacles


# ---------------------------------------------------------------- over time


def height_figure(
    flight: LoggedFlight, track: TruthTrack | None, pass_m_s: float | None = None
) -> go.Figure | None:
    """Height over the pad, and the rate at which it decreases; `pass_m_s` passes at the touchdown."""
    pads = flight.kept.get("pad", ())
    if track is None and not pads:
        return None
    seen_s = [pad.time_s for pad in pads]
    figure = stacked("height (m)", "sink rate (m/s)")
    if track is not None:
        times = track.time_s
        height = (track.at("pad_position", times) - track.at("position", times))[:, 2]
        sink = (track.at("velocity", times) - track.at("pad_velocity", times))[:, 2]
        add_line(figure, times, height, VEHICLE_COLOUR, "truth", 1)
        add_line(figure, times, sink, VEHICLE_COLOUR, "truth", 2, legend=False)
    add_dots(figure, seen_s, [pad.height_m for pad in pads], ESTIMATE_COLOUR, "pad filter", 1)
    add_dots(figure, seen_s, [pad.sink_m_s for pad in pads], ESTIMATE_COLOUR, "pad filter", 2, legend=False)
    _mark_pass(figure, pass_m_s, 2)
    return _over_time(figure, flight, track)


def lateral_figure(
    flight: LoggedFlight, track: TruthTrack | None, pass_m: float | None = None
) -> go.Figure | None:
    """Horizontal distance to the pad's centre, logarithmic; `pass_m` passes at the touchdown."""
    pads = flight.kept.get("pad", ())
    if track is None and not pads:
        return None
    seen_s = [pad.time_s for pad in pads]
    figure = stacked("lateral (m)")
    if track is not None:
        offset = (track.at("position", track.time_s) - track.at("pad_position", track.time_s))[:, :2]
        distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-3)
        add_line(figure, track.time_s, distance, VEHICLE_COLOUR, "truth", 1)
    distances = [max(pad.lateral_m, 1e-3) for pad in pads]
    add_dots(figure, seen_s, distances, ESTIMATE_COLOUR, "pad filter", 1)
    figure.update_yaxes(type="log", dtick="D2")  # labels at 1, 2, 5: all nine overprint
    _mark_pass(figure, pass_m, 1)
    return _over_time(figure, flight, track)


def velocity_figure(flight: LoggedFlight) -> go.Figure | None:
    """Velocity over ground by the EKF beside what was commanded, NED."""
    vehicles, setpoints = flight.kept.get("vehicle", ()), flight.kept.get("setpoint", ())
    if not vehicles:
        return None
    figure = stacked(*(f"{axis} (m/s)" for axis in AXES))
    times, sent = [v.time_s for v in vehicles], [s.time_s for s in setpoints]
    for k in range(3):
        first = k == 0
        flown = [v.velocity_ned_m_s[k] for v in vehicles]
        add_line(figure, times, flown, VEHICLE_COLOUR, "estimate", k + 1, legend=first)
        commanded = [s.velocity_ned_m_s[k] for s in setpoints]
        add_line(figure, sent, commanded, ESTIMATE_COLOUR, "setpoint", k + 1, legend=first)
    return _over_time(figure, flight)


def stated_figure(flight: LoggedFlight) -> go.Figure | None:
    """What the filters say of their own errors: standard deviations."""
    vehicles, pads = flight.kept.get("vehicle", ()), flight.kept.get("pad", ())
    if not vehicles:
        return None
    # a plot for each unit: degrees and metres have no scale in common
    figure = stacked("attitude (°)", "velocity (m/s)", "pad position (m)", "pad velocity (m/s)")
    times, seen_s = [v.time_s for v in vehicles], [pad.time_s for pad in pads]
    attitude = [math.degrees(v.attitude_std_rad) for v in vehicles]
    add_line(figure, times, attitude, VEHICLE_COLOUR, "attitude", 1)
    add_line(figure, times, [v.velocity_std_m_s for v in vehicles], "#b9770e", "velocity", 2)
    add_dots(figure, seen_s, [pad.position_std_m for pad in pads], ESTIMATE_COLOUR, "pad position", 3)
    add_dots(figure, seen_s, [pad.velocity_std_m_s for pad in pads], "#148f77", "pad velocity", 4)
    figure.update_yaxes(type="log", dtick="D2")  # labels at 1, 2, 5: all nine overprint
    return _over_time(figure, flight)


def error_figure(flight: LoggedFlight, track: TruthTrack | None) -> go.Figure | None:
    """Errors of attitude, velocity, pad position and pad velocity in the air; north, east, down."""
    if track is None or not flight.kept.get("vehicle"):
        return None
    errors = estimate_errors(flight.kept, track)
    figure = stacked("attitude (°)", "velocity (m/s)", "pad position (m)", "pad velocity (m/s)")
    add_line(figure, errors["time_s"], errors["attitude_deg"], "black", "attitude", 1, legend=False)
    seen_s, seen_m = sighting_errors_body_m(flight.kept.get("sighting", ()), track)
    add_dots(figure, seen_s, np.linalg.norm(seen_m, axis=1), "grey", "sightings (distance)", 3)
    for row, times, name in (
        (2, "time_s", "velocity_m_s"),
        (3, "pad_time_s", "pad_position_m"),
        (4, "pad_time_s", "pad_velocity_m_s"),
    ):
        for axis, colour, values in zip(AXES, AXIS_COLOURS, errors[name].T, strict=True):
            add_line(figure, errors[times], values, colour, axis, row, legend=row == 2)
    return _over_time(figure, flight, track)


def marker_figure(flight: LoggedFlight, track: TruthTrack | None) -> go.Figure | None:
    """How many markers of each group were accepted in each frame; by the height, where that is true."""
    reports = flight.kept.get("frame_report", ())
    if not reports:
        return None
    rows = 1 if track is None else 2
    figure = make_subplots(rows=rows, cols=1, vertical_spacing=0.2)
    for group, colour in GROUP_COLOURS.items():
        seen = [report for report in reports if report.marker_count.get(group)]
        counts = [report.marker_count[group] for report in seen]
        times, name = np.array([report.time_s for report in seen]), f"{group} ({GROUP_NAMES[group]})"
        add_dots(figure, times, counts, colour, name, 1)
        if track is not None:
            heights = (track.at("pad_position", times) - track.at("position", times))[:, 2]
            add_dots(figure, heights, counts, colour, name, 2, legend=False)
    figure.update_yaxes(rangemode="tozero")
    label_rows(figure, *("markers",) * rows)
    if rows == 2:
        figure.update_xaxes(title_text="time (s)", row=1, col=1)
        figure.update_xaxes(title_text="height over the pad (m)", type="log", dtick="D2", row=2, col=1)
        figure.update_layout(height=2 * HEIGHT_PX)
    return _over_time(figure, flight, track, row=1)


def latency_figure(flight: LoggedFlight) -> go.Figure | None:
    """Histograms (ms): exposure to setpoint, vision, and how late control cycles began."""
    reports, control = flight.kept.get("frame_report", ()), flight.kept.get("control_report", ())
    delays_s = {
        "exposure to setpoint": setpoint_delays_s(flight.kept.get("setpoint", ())),
        "frame received to markers found": [r.done_s - r.received_s for r in reports],
        "control cycle late": [report.cycle_late_s for report in control],
    }
    if not any(delays_s.values()):
        return None
    # under one another: a phone has no room for more
    figure = make_subplots(rows=3, cols=1, subplot_titles=list(delays_s), vertical_spacing=0.16)
    for row, values in enumerate(delays_s.values(), start=1):
        milliseconds = np.round(1e3 * np.array(values), 3)
        figure.add_histogram(x=milliseconds, nbinsx=60, marker_color=ESTIMATE_COLOUR, row=row, col=1)
        longest = float(milliseconds.max(initial=0.0))
        figure.update_xaxes(range=[0.0, max(1.05 * longest, 1.0)], row=row, col=1)
        if len(milliseconds):
            p99 = float(np.percentile(milliseconds, 99))
            figure.add_vline(x=p99, line={"color": VEHICLE_COLOUR, "dash": "dot"}, row=row, col=1)
    figure.update_xaxes(title_text="ms; dotted: p99", row=3, col=1)
    figure.update_layout(showlegend=False, height=2 * HEIGHT_PX)
    return plain(figure)


# ---------------------------------------------------------------- parts


STACK_HEIGHTS: Final = {1: 1.0, 2: 1.6, 3: 1.8, 4: 2.4}  # of HEIGHT_PX


def stacked(*labels: str) -> go.Figure:
    """Plots over one time, one under another, each with the label of its axis."""
    rows = len(labels)
    spacing = 0.06 if rows == 2 else 0.04
    figure = make_subplots(rows=rows, cols=1, shared_xaxes=True, vertical_spacing=spacing)
    label_rows(figure, *labels)
    return figure.update_layout(height=int(STACK_HEIGHTS[rows] * HEIGHT_PX))


def add_line(
    figure: go.Figure, times: Any, values: Any, colour: str, name: str, row: int, *, legend: bool = True
) -> None:
    look = {"mode": "lines", "line": {"color": colour, "width": 1.5}}
    _add(figure, times, values, name, row, showlegend=legend, **look)


def add_dots(
    figure: go.Figure, times: Any, values: Any, colour: str, name: str, row: int, *, legend: bool = True
) -> None:
    if len(times):
        look = {"mode": "markers", "marker": {"color": colour, "size": 3}}
        _add(figure, times, values, name, row, showlegend=legend, **look)


def _add(figure: go.Figure, times: Any, values: Any, name: str, row: int, **look: Any) -> None:
    at = {"x": np.asarray(times), "y": np.asarray(values), "row": row, "col": 1}
    figure.add_scattergl(name=name, legendgroup=name, **at, **look)


def label_rows(figure: go.Figure, *labels: str) -> None:
    for row, label in enumerate(labels, start=1):
        figure.update_yaxes(title_text=label, row=row, col=1)
    figure.update_xaxes(title_text="time (s)", row=len(labels), col=1)


def _mark_pass(figure: go.Figure, bound: float | None, row: int) -> None:
    if bound is not None:
        line = {"color": PASS_COLOUR, "dash": "dash", "width": 1}
        figure.add_hline(y=bound, line=line, annotation_text="passes below, at the touchdown", row=row, col=1)


@dataclass(frozen=True, slots=True)
class PhaseSpan:
    """One stay in a phase; times (s) of the messages it was made from."""

    phase: Phase
    start_s: float
    end_s: float

    @property
    def name(self) -> str:
        return self.phase.value.replace("_", " ")

    @property
    def colour(self) -> str:
        return PHASE_COLOURS[self.phase]


def phase_spans(plans: Sequence[PlanStep]) -> list[PhaseSpan]:
    """The stays in their order; one lasts until the next begins, the last until the last plan."""
    starts = [(Phase(phase), next(steps).time_s) for phase, steps in groupby(plans, lambda p: p.phase)]
    ends = [start_s for _, start_s in starts[1:]] + [plan.time_s for plan in plans[-1:]]
    return [PhaseSpan(phase, start_s, end_s) for (phase, start_s), end_s in zip(starts, ends, strict=True)]


def _over_time(
    figure: go.Figure, flight: LoggedFlight, track: TruthTrack | None = None, row: int | None = None
) -> go.Figure:
    """The phases behind the curves, their names over the uppermost; lines at the contact and at landed.

    In all rows, or in one. All at once: plotly copies and checks what is there with each that is added.
    """
    spans = phase_spans(flight.kept.get("plan", ()))
    seconds = spans[-1].end_s - spans[0].start_s if spans else 0.0
    marks = [("contact", time_s) for time_s in _contacts_s(track)]
    marks += [("landed", span.start_s) for span in spans if span.phase is Phase.LANDED][:1]
    shapes, words = list(figure.layout.shapes), list(figure.layout.annotations)
    for axis in figure.select_yaxes(row=row):
        y = axis.plotly_name.replace("axis", "")
        on = {"xref": y.replace("y", "x"), "yref": f"{y} domain", "y0": 0, "y1": 1}
        line = {"color": "black", "dash": "dot", "width": 1}
        shapes += [{"type": "line", "x0": time_s, "x1": time_s, "line": line, **on} for _, time_s in marks]
        band = {"type": "rect", "opacity": 0.18, "line": {"width": 0}, "layer": "below", **on}
        shapes += [{"x0": s.start_s, "x1": s.end_s, "fillcolor": s.colour, **band} for s in spans]
        at = {"y": 1, "xref": on["xref"], "yref": on["yref"], "xanchor": "left", "yanchor": "top"}
        words += [
            {"x": time_s, "text": name, "textangle": -90, "showarrow": False, **at} for name, time_s in marks
        ]
    words += [_name_of(span) for span in spans if span.end_s - span.start_s > NAMED_SHARE * seconds]
    plain(figure).update_layout(shapes=shapes, annotations=words, hovermode="x unified", margin_t=NAMES_PX)
    return figure


def _contacts_s(track: TruthTrack | None) -> list[float]:
    if track is None:
        return []
    touches = track.at("in_contact", track.time_s)[:, 0] > 0.5
    times: list[float] = track.time_s[1:][touches[1:] & ~touches[:-1]].tolist()
    return times


def _name_of(span: PhaseSpan) -> dict[str, Any]:
    return {
        "x": 0.5 * (span.start_s + span.end_s),
        "xref": "x",
        "y": 1.0,
        "yref": "paper",
        "yanchor": "bottom",
        "text": span.name,
        "textangle": -90,  # on a phone a band is narrower than its name is long
        "showarrow": False,
        "font": {"size": 11, "color": "#566573"},
    }


def plain(figure: go.Figure) -> go.Figure:
    if figure.layout.height is None:
        figure.update_layout(height=HEIGHT_PX)
    figure.update_layout(
        margin={"l": 60, "r": 20, "t": 50, "b": 70},
        legend={
            "orientation": "h",
            "itemsizing": "constant",
            "yref": "container",
            "y": 0.0,
            "yanchor": "bottom",
        },
    )
    return figure
