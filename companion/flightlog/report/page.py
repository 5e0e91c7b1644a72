"""`report.html`: a flight on one page that needs nothing but itself, neither a network nor other files."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from string import Template
from typing import Any, Final

import numpy as np
from plotly.io import to_html
from plotly.offline import get_plotlyjs

from companion.base.files import write_atomically
from companion.base.messages import Outcome
from companion.config import CompanionConfig
from companion.flightlog.report.figures import figures
from companion.flightlog.report.logged_flight import LoggedFlight, SensorRecord
from companion.flightlog.report.tables import flight_texts, result_rows
from companion.flightlog.result import latency, phase_times

TEMPLATE: Final = Path(__file__).with_name("page.html")
PLOT_OPTIONS: Final = {"responsive": True, "displaylogo": False, "scrollZoom": False}
VERDICT_COLOURS: Final = {Outcome.LANDED.value: "#1e8449", Outcome.CRASHED.value: "#922b21"}
OTHER_COLOUR: Final = "#b9770e"
# plotly's camera sees as much in height on every screen: on a narrow one it steps back, else sides are cut
FIT_PATH: Final = """
const gd = document.getElementById("{plot_id}"), eye = gd.layout.scene.camera.eye;
let fitted = 1;
function fit() {
  const { w, h } = gd._fullLayout._size, back = Math.max(1, h / w);
  if (Math.abs(back - fitted) < 0.02) return;
  fitted = back;
  Plotly.relayout(gd, { "scene.camera.eye": { x: back * eye.x, y: back * eye.y, z: back * eye.z } });
}
fit();
gd.on("plotly_afterplot", fit);
"""
SENSOR_NAMES: Final = {
    "imu": "IMU",
    "mag": "magnetometer",
    "gps": "GPS",
    "range": "ultrasonic",
    "autopilot_attitude": "autopilot's attitude",
    "frame_report": "camera frames",
    "sighting": "frames with the pad",
}


def write_page(flight: LoggedFlight, path: Path, bounds: Mapping[str, float] | None = None) -> None:
    """Write the page; `bounds`: what passes, by the touchdown's keys."""
    write_atomically(path, page(flight, bounds or {}))


def page(flight: LoggedFlight, bounds: Mapping[str, float]) -> str:
    drawn = figures(flight, bounds)
    sections = {
        "result": (
            "Result",
            table_html(("", "measured", "passes at" if bounds else ""), _verdict_rows(flight, bounds)),
        ),
        "events": ("Events", _events(flight)),
        **{name: (title, plot_html(figure, name)) for name, (title, figure) in drawn.items()},
        "pictures": ("What the camera saw", _pictures(flight)),
        "sensors": ("Sensors", table_html(SENSOR_COLUMNS, sensor_rows(flight.sensors))),
        "settings": ("Settings that differ from the defaults", _settings(flight)),
    }
    colour = VERDICT_COLOURS.get(flight.outcome, OTHER_COLOUR)
    title = flight.title.rpartition(":")[0]
    return html_page(title, (flight.outcome, colour), _said(flight), sections, flight.versions)


def html_page(
    title: str,
    verdict: tuple[str, str],
    said: str,
    sections: Mapping[str, tuple[str, str]],
    versions: Mapping[str, str],
) -> str:
    """A page that needs nothing but itself; `sections`: title and HTML of each by its name, in order.

    `verdict`: a word and its colour; `versions` stand in the foot.
    """
    outcome, colour = verdict
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=escape(title),
        outcome=escape(outcome),
        verdict_colour=colour,
        said=escape(said),
        plotly_js=get_plotlyjs(),
        links=" ".join(f'<a href="#{name}">{title}</a>' for name, (title, _) in sections.items()),
        sections="\n".join(
            f'<section id="{name}"><h2>{title}</h2>{body}</section>'
            for name, (title, body) in sections.items()
        ),
        footer=escape(", ".join(f"{name} {version}" for name, version in versions.items())),
    )


def _said(flight: LoggedFlight) -> str:
    """The mission's own last word, with why it held before it gave up, and when it flew."""
    phases = [notice.text for notice in flight.kept.get("notice", ()) if notice.kind == "phase"]
    held = len(phases) > 1 and phases[-1].startswith("abort:") and phases[-2].startswith("hold:")
    words = "; ".join(phases[-2 if held else -1 :]) or "no phase began"
    cut = "; the log is cut short" if flight.cut else ""
    started = datetime.fromtimestamp(flight.start_unix_s, UTC)
    return f"{words}{cut}. {started:%Y-%m-%d %H:%M:%S} UTC"


# ---------------------------------------------------------------- tables


def _verdict_rows(flight: LoggedFlight, bounds: Mapping[str, float]) -> Sequence[Sequence[str]]:
    if flight.result is not None:
        return result_rows(flight.result, bounds)
    reports = flight.kept.get("frame_report", ())
    delays = latency(flight.kept.get("setpoint", ()), flight.kept.get("control_report", ()))
    seen, times = sum(report.seen for report in reports), phase_times(flight.kept["plan"])
    texts = {"outcome": flight.outcome, **flight_texts(times, seen, len(reports))}
    if pads := flight.kept.get("pad", ()):
        texts["from the pad's centre at the end, as estimated"] = f"{pads[-1].lateral_m:.3f} m"
    if (median_ms := delays.exposure_to_setpoint_p50) is not None:
        text = f"{median_ms:.0f} ms (median), {delays.exposure_to_setpoint_p99:.0f} (p99)"
        texts["exposure to setpoint"] = text
    return [(name, text, "") for name, text in texts.items()]


SENSOR_COLUMNS: Final = ("", "samples", "a second", "longest gap", "age when used, median", "p99")


def sensor_rows(sensors: Mapping[str, SensorRecord]) -> Iterator[Sequence[str]]:
    """A row a sensor that was logged: how many samples, how regular, how old."""
    for name, label in SENSOR_NAMES.items():
        if (sensor := sensors.get(name)) is None:
            continue
        arrivals = np.array(sensor.arrival_s)
        seconds = float(arrivals[-1] - arrivals[0])
        rate = f"{(len(arrivals) - 1) / seconds:.1f}" if seconds > 0.0 else "-"
        gap = f"{float(np.max(np.diff(arrivals))):.2f} s" if len(arrivals) > 1 else "-"
        p50, p99 = np.percentile(1e3 * np.array(sensor.age_s), [50, 99])
        yield label, str(len(arrivals)), rate, gap, f"{p50:.0f} ms", f"{p99:.0f} ms"


def _events(flight: LoggedFlight) -> str:
    notices = flight.kept.get("notice", ())
    rows = [(f"{max(n.time_s, 0.0):.1f} s", n.kind, n.text) for n in notices]  # the first by a hair before 0
    return table_html(("time", "kind", "text"), rows, [n.severity for n in notices])


def _settings(flight: LoggedFlight) -> str:
    config = flight.settings.get("config")
    if config is None:
        return "<p>The log holds no settings.</p>"
    changed = differences(config, CompanionConfig().model_dump(mode="json"))
    if not changed:
        return "<p>None.</p>"
    return table_html(("setting", "flown with", "default"), changed)


def differences(flown: Any, default: Any, name: str = "") -> list[Sequence[str]]:
    """Key, value and default of each setting that differs, in the settings' order; keys are dotted."""
    if isinstance(flown, dict) and isinstance(default, dict):
        found: list[Sequence[str]] = []
        for key in flown:
            found += differences(flown[key], default.get(key), f"{name}.{key}" if name else key)
        return found
    return [] if flown == default else [(name, json.dumps(flown), json.dumps(default))]


def table_html(heads: Sequence[str], rows: Iterable[Sequence[str]], classes: Sequence[str] = ()) -> str:
    """A table of texts; `classes` are those of its rows."""
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    lines = []
    for k, row in enumerate(rows):
        kind = f' class="{escape(classes[k])}"' if classes else ""
        lines.append(f"<tr{kind}>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


# ---------------------------------------------------------------- pictures and plots


def plot_html(figure: Any, name: str) -> str:
    """A plot of the page; `name` is its place."""
    html: str = to_html(
        figure,
        config=PLOT_OPTIONS,
        include_plotlyjs=False,
        full_html=False,
        div_id=f"plot-{name}",
        post_script=FIT_PATH if name == "path" else None,
    )
    return html


def _pictures(flight: LoggedFlight) -> str:
    if not flight.pictures:
        return "<p>The log holds no pictures.</p>"
    shown = [
        f'<figure><img alt="{escape(p.moment)}" src="data:image/jpeg;base64,{p.jpeg_base64}">'
        f"<figcaption>{p.time_s:.1f} s: {escape(p.moment)}</figcaption></figure>"
        for p in flight.pictures
    ]
    return f'<div class="pictures">{"".join(shown)}</div>'
