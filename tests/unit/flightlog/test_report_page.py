"""`companion report`: one page that needs nothing else, from a flight with truth, without, and cut short."""

import asyncio
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from companion.base.messages import ControlReport, Frame, Notice, Outcome, Phase, PlanStep
from companion.config import CONFIG_FOLDER, ConfigError
from companion.flightlog.record import FlightLog
from companion.flightlog.report import write_report
from companion.flightlog.report.figures import PHASE_COLOURS, figures, phase_spans
from companion.flightlog.report.logged_flight import SensorRecord, read_flight
from companion.flightlog.report.page import differences, sensor_rows
from companion.flightlog.report.tables import flight_texts
from companion.flightlog.result import PhaseTimes, build_result
from companion.pad.colours import GROUP_COLOURS, bgr
from tests.browser import DESK, PHONE, browser
from tests.programs import ProgramHere
from tests.unit.flightlog.replay.log_files import own_rig
from tests.unit.flightlog.test_result import made_up_flight

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def write_flight(folder: Path, *, truth: bool = True, close: bool = True) -> FlightLog:
    """The made-up flight as the app would log it, with a picture five times a second."""
    kept, records = made_up_flight()
    log, rig = FlightLog(folder, 1.7e9), own_rig()
    log.write_settings(config=rig.config, vehicle=rig.vehicle, pad=rig.pad)
    messages = [(m.time_s, topic, m) for topic, ms in kept.items() if topic != "sighting" for m in ms]
    messages += [(0.5, "notice", Notice(0.5, "phase", "search: <b>looking</b>", "warning"))]
    messages += [(0.02 * k, "control_report", ControlReport(0.02 * k, True, 9, 0.001)) for k in range(500)]
    for time_s, topic, message in sorted(messages, key=lambda item: item[0]):
        log.write(topic, message, time_s)
        if topic == "plan":
            picture = np.full((24, 32), int(20 * time_s), dtype=np.uint8)
            log.write_frame(Frame(time_s, time_s, 0, picture), time_s)
    for record in records if truth else ():
        log.write("truth", record, record.time_s)
    if close:
        log.close()
    return log


class Links(HTMLParser):
    """What a page loads, and its rows."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.pictures = 0
        self.plots: set[str] = set()
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        source = found.get("src") or (found.get("href") if tag == "link" else None)
        self.pictures += tag == "img"
        if source is not None and not source.startswith("data:"):
            self.loaded.append(source)
        if (found.get("id") or "").startswith("plot-"):
            self.plots.add(str(found["id"]))


def test_the_page_of_a_simulated_flight_holds_everything_and_loads_nothing(tmp_path: Path) -> None:
    write_flight(tmp_path)
    kept, truth = made_up_flight()
    result = build_result(
        scenario="made_up",
        seed=3,
        outcome=Outcome.LANDED,
        touchdown={
            "lateral_error_m": 0.031,
            "vertical_speed_m_s": 0.21,
            "horizontal_speed_m_s": 0.05,
            "tilt_deg": 1.2,
            "yaw_error_deg": -2.0,
        },
        pad_speed_m_s=1.0,
        kept=kept,
        truth=truth,
        real_time_factor=1.0,
    )
    (tmp_path / "result.json").write_text(result.model_dump_json())
    path = write_report(tmp_path, bounds={"lateral_error_m": 0.15})
    html = path.read_text(encoding="utf-8")
    links = Links(html)
    assert links.loaded == []
    assert links.plots == {f"plot-{name}" for name in PLOTS}
    assert links.pictures >= 4
    text = html[html.index("</header>") :]
    assert "made_up, seed 3" in html
    for told in ("0.031 m", "&lt;= 0.15 m", "search: &lt;b&gt;looking&lt;/b&gt;", "antenna_position_body_m"):
        assert told in text


PLOTS = ("path", "height", "lateral", "velocity", "stated", "errors", "markers", "latency")


def test_a_real_flight_without_truth_and_result_is_judged_by_its_last_phase(tmp_path: Path) -> None:
    write_flight(tmp_path, truth=False)
    flight = read_flight(tmp_path)
    assert flight.outcome == "ended in touchdown"
    assert flight.start_unix_s == pytest.approx(1.7e9, abs=1e-3)
    assert {"height", "lateral", "latency"} <= {
        plot.removeprefix("plot-") for plot in Links(write_report(tmp_path).read_text()).plots
    }


def test_its_last_word_says_why_it_held_before_it_gave_up(tmp_path: Path) -> None:
    log = write_flight(tmp_path, truth=False, close=False)
    for text in ("hold: stop requested", "abort: clear: at rest"):
        log.write("notice", Notice(11.0, "phase", text), 11.0)
    log.close()
    assert "hold: stop requested; abort: clear: at rest. 2023-" in write_report(tmp_path).read_text()


def test_a_log_cut_short_gives_a_page_as_far_as_it_goes(tmp_path: Path) -> None:
    write_flight(tmp_path)
    log = tmp_path / "flight.mcap"
    log.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    assert "the log is cut short" in write_report(tmp_path).read_text()


def test_a_recording_by_any_name_has_its_page_beside_it(tmp_path: Path, program: ProgramHere) -> None:
    write_flight(tmp_path)
    (tmp_path / "flight.mcap").rename(tmp_path / "over the lake.mcap")
    assert program("companion", "report", tmp_path / "over the lake.mcap").code == 0
    assert "over the lake" in (tmp_path / "over the lake.html").read_text()


def test_pictures_are_of_key_moments(tmp_path: Path) -> None:
    write_flight(tmp_path)
    pictures = read_flight(tmp_path).pictures
    moments = [picture.moment for picture in pictures]
    # phases begin at 0, 2, 5 and 9 s; the descent goes from 3 m at 5 s to 1.02 m at 10 s
    assert moments == ["search", "approach", "descend, below 5 m", "below 2 m", "touchdown", "the last one"]
    assert [p.time_s for p in pictures[:2]] == pytest.approx([0.0, 2.0], abs=0.21)
    assert pictures[3].time_s == pytest.approx(7.5, abs=0.25)


def test_a_sensor_is_reported_by_rate_longest_gap_and_age() -> None:
    record = SensorRecord([0.0, 0.1, 0.2, 0.7, 0.8], [0.02, 0.02, 0.02, 0.02, 0.5])
    (row,) = sensor_rows({"gps": record})
    assert row[:5] == ("GPS", "5", "5.0", "0.50 s", "20 ms")


def test_settings_that_differ_are_named_by_their_dotted_keys() -> None:
    flown = {"a": {"b": 1, "c": [1, 2]}, "d": None}
    assert differences(flown, {"a": {"b": 1, "c": [1, 3]}, "d": None}) == [("a.c", "[1, 2]", "[1, 3]")]
    assert differences(flown, flown) == []


def test_what_is_no_flight_is_reported_in_one_line(tmp_path: Path, program: ProgramHere) -> None:
    def refused(*words: object) -> str:
        return program("companion", "report", *words).refusal

    assert "flight.mcap: cannot be read" in refused(tmp_path)
    (tmp_path / "notes.txt").touch()
    expected = "notes.txt: no recording of flights; expected a flight's folder"
    assert expected in refused(tmp_path / "notes.txt")
    FlightLog(tmp_path / "empty", 0.0).close()
    assert "holds no flight" in refused(tmp_path / "empty")
    write_flight(tmp_path / "flown")
    assert "cannot be written" in refused(tmp_path / "flown", "-o", tmp_path / "nowhere" / "page.html")
    recording = tmp_path / "flown" / "flight.mcap"
    before = recording.read_bytes()
    expected = "flight.mcap: expected the page's name, as flight.html"
    assert expected in refused(recording, "-o", recording)
    assert recording.read_bytes() == before


def test_without_plotly_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_flight(tmp_path)
    for name in [name for name in sys.modules if name.startswith("companion.flightlog.report.")]:
        if name.endswith((".page", ".figures")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setitem(sys.modules, "plotly.io", None)
    with pytest.raises(ConfigError, match="pip install plotly"):
        write_report(tmp_path)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here; Debian: apt install chromium")
def test_a_browser_draws_every_plot(tmp_path: Path) -> None:
    write_flight(tmp_path)
    page = write_report(tmp_path)
    shown = subprocess.run(
        [
            *(str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--use-gl=swiftshader"),
            *("--enable-unsafe-swiftshader", f"--user-data-dir={tmp_path / 'browser'}"),
            *("--virtual-time-budget=5000", "--dump-dom", page.as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=180,
        check=True,
    ).stdout
    body = shown[shown.index("<main>") :]
    assert body.count('class="main-svg"') >= len(PLOTS)
    for name in PLOTS:
        start = body.index(f'id="plot-{name}"')
        assert "plot-container" in body[start : start + 1000], name


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here; Debian: apt install chromium")
async def test_on_a_phone_the_path_is_seen_from_further_away(tmp_path: Path) -> None:
    write_flight(tmp_path)
    page, eye = write_report(tmp_path), "document.getElementById('plot-path')._fullLayout.scene.camera.eye.x"
    seen = {}
    async with browser(tmp_path) as tab:
        for size in (PHONE, DESK):
            await tab.resize(size)
            await tab.open(page.as_uri())
            await tab.wait_for(f"document.readyState === 'complete' && {eye}", 90.0)
            await asyncio.sleep(1.0)
            seen[size] = await tab.evaluate(eye)
    assert seen[DESK] == pytest.approx(-0.95)
    assert seen[PHONE] < 1.15 * seen[DESK]


def test_the_path_has_one_scale_on_all_axes_and_fits_the_view(tmp_path: Path) -> None:
    write_flight(tmp_path)
    scene = figures(read_flight(tmp_path))["path"][1].layout.scene
    sides = [np.ptp(axis.range) for axis in (scene.xaxis, scene.yaxis, scene.zaxis)]
    ratio = [scene.aspectratio[axis] for axis in "xyz"]
    assert max(ratio) == 1.0
    assert np.divide(ratio, sides) == pytest.approx(1.0 / max(sides))
    # 10 m to the north, 0.5 m aside, which is shown as a metre at least
    assert sides[1] == pytest.approx(10.0, abs=0.1)
    assert sides[0] == 1.0


def test_a_group_of_which_no_marker_was_seen_is_no_dot(tmp_path: Path) -> None:
    write_flight(tmp_path)
    dots = [trace.y for trace in figures(read_flight(tmp_path))["markers"][1].data]
    assert dots
    assert all(min(counts) > 0 for counts in dots)


def test_latencies_start_at_nothing_and_span_a_millisecond_at_least(tmp_path: Path) -> None:
    write_flight(tmp_path)
    figure = figures(read_flight(tmp_path))["latency"][1]
    longest = [max(trace.x, default=0.0) for trace in figure.data]
    ranges = [axis.range for axis in (figure.layout.xaxis, figure.layout.xaxis2, figure.layout.xaxis3)]
    assert [first for first, _ in ranges] == [0.0] * 3
    assert all(last >= max(1.0, most) for (_, last), most in zip(ranges, longest, strict=True))
    # the cycles of the virtual loop are off by rounding alone
    assert ranges[2][1] == 1.0


def test_what_passes_and_the_touchdown_are_marked(tmp_path: Path) -> None:
    write_flight(tmp_path)
    flight = read_flight(tmp_path)
    flight.truth[:] = [replace(t, in_contact=k >= len(flight.truth) - 3) for k, t in enumerate(flight.truth)]
    touched_s = flight.truth[-3].time_s
    drawn = figures(flight, {"lateral_error_m": 0.15, "vertical_speed_m_s": 0.4})
    for name, bound in (("lateral", 0.15), ("height", 0.4)):
        layout = drawn[name][1].layout
        assert bound in [shape.y0 for shape in layout.shapes if shape.y0 == shape.y1]
        assert touched_s in [shape.x0 for shape in layout.shapes if shape.x0 == shape.x1]
        assert {"contact", "passes below, at the touchdown"} <= {note.text for note in layout.annotations}


def test_the_errors_are_those_against_the_truth(tmp_path: Path) -> None:
    write_flight(tmp_path)
    flight = read_flight(tmp_path)
    traces = figures(flight)["errors"][1].data
    assert [trace.name for trace in traces].count("north") == 3
    flight.truth.clear()
    assert "errors" not in figures(flight)


def test_a_stage_that_was_never_reached_has_no_time() -> None:
    times = PhaseTimes(search_s=0.0, approach_s=4.96, descent_s=0.0, total_s=12.0)
    assert flight_texts(times, 3, 4) == {
        "search / approach / descent": "- / 5.0 / - s",
        "whole flight": "12.0 s",
        "frames with the pad": "3 of 4",
    }


def test_the_marker_groups_have_one_colour_set() -> None:
    assert bgr(GROUP_COLOURS["M"]) == (0, 159, 230)
    root = CONFIG_FOLDER.parent
    for folder in ("companion", "docs", "sitl", "calibration"):
        for path in (root / folder).rglob("*.py"):
            own = re.search(r'"F": ["(][#\d]', path.read_text())
            assert own is None or path.name == "colours.py", path


def test_a_phase_lasts_until_the_next_begins() -> None:
    plans = [PlanStep(t, phase) for t, phase in ((0.0, Phase.ARM), (1.0, Phase.ARM), (2.5, Phase.SEARCH))]
    spans = phase_spans([*plans, PlanStep(4.0, Phase.SEARCH)])
    assert [(s.name, s.start_s, s.end_s) for s in spans] == [("arm", 0.0, 2.5), ("search", 2.5, 4.0)]
    assert phase_spans([]) == []


def test_every_phase_has_a_colour_of_its_own() -> None:
    assert len({PHASE_COLOURS[phase] for phase in Phase}) == len(Phase)
