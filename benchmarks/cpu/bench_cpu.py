"""What the app costs in a landing: one flight, and where its CPU goes.

    python -m benchmarks cpu --scenario figure_8 --sense autopilot

In real time, the default, the simulator is a process of its own, and what this one's CPU clock says is the
app's: 640x480 at 30 fps, sensors by telemetry or by boards. A core's share counts from the take-off to the
touchdown. `--fast` flies in virtual time, where the simulator shares the process: then the watched parts
alone count, and neither the event loop nor latencies are told. Latencies are those of the machine as busy as
it is; the longest callback is in CPU time.

Prints a table and the bars, and ends in one line that says which hold; the exit status matches.
"""

import argparse
import resource
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from rich.table import Table

from benchmarks.cpu.cpu_watch import LOOP_METHODS, METHODS, CpuWatch
from benchmarks.report import BenchReport
from companion.app.app import Status
from companion.base.clock import start_unix_s
from companion.base.messages import Outcome, Phase
from companion.config import CONFIG_FOLDER, CompanionConfig, merge, validate
from companion.flightlog.record import FlightLog
from companion.flightlog.result import latency
from companion.sense.vision.opencv import prepare_opencv
from companion.sim.runner import fly
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.campaign.tables import Bar, at_most

SMOKE: Final = ("--fast", "--scenario", "static")
CORE_PERCENT: Final = 40.0
LATENCY_MS: Final = 60.0
LOOP_MS: Final = 5.0
GROUND: Final = frozenset({Phase.CONNECT, Phase.ARM})
ENDED: Final = frozenset({Phase.LANDED, Phase.ABORT})
REST: Final = "rest (threads' own, MAVSDK)"


@dataclass
class FlightSpan:
    """The app's CPU time and the flight's time at its take-off, and how much of both it took to land."""

    watch: CpuWatch
    began: tuple[float, float] | None = None
    cpu_s: float = 0.0
    flown_s: float = 0.0
    spent_s: dict[str, float] = field(default_factory=dict)
    calls: dict[str, int] = field(default_factory=dict)

    def __call__(self, status: Status) -> None:
        """Take the app's status."""
        now = (_cpu_s(), status.time_s)
        if self.began is None and status.phase not in GROUND:
            self.began = now
            self.watch.forget()
        if self.began is not None and status.phase not in ENDED:
            self.cpu_s, self.flown_s = (b - a for a, b in zip(self.began, now, strict=True))
            self.spent_s, self.calls = dict(self.watch.spent_s), dict(self.watch.calls)


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="figure_8")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sense", choices=("boards", "autopilot"), default="autopilot")
    parser.add_argument("--fast", action="store_true", help="in virtual time")
    parser.add_argument("--record", action="store_true", help="with the flight log on disk")
    chosen = parser.parse_args(arguments)
    report = BenchReport()
    prepare_opencv()
    trial = Trial.load(chosen.scenario, chosen.seed)
    settings = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=chosen.fast)
    sense: dict[str, Any] = {"sense": {"source": chosen.sense}}
    settings = validate(CompanionConfig, merge(settings.model_dump(), sense), "bench")
    span = FlightSpan(CpuWatch(METHODS if chosen.fast else {**METHODS, **LOOP_METHODS}))
    with tempfile.TemporaryDirectory() as folder, span.watch.watching():
        log = FlightLog(Path(folder) if chosen.record else None, start_unix_s(virtual=chosen.fast))
        flight = fly(settings, trial, log, span, fast=chosen.fast)
        log.close()
    report.show(_parts(span, fast=chosen.fast))
    found = _bars(span, log, trial, report, fast=chosen.fast)
    landed = flight.report.outcome is Outcome.LANDED
    return report.judge([*found, at_most("landings missed", float(not landed), 0.0)])


def _parts(span: FlightSpan, *, fast: bool) -> Table:
    rows = dict(span.spent_s)
    if not fast:
        rows[REST] = span.cpu_s - sum(rows.values())
    table = Table(title=f"the app's CPU, {span.flown_s:.0f} s from the take-off to the touchdown")
    for name in ("part", "ms a second", "calls a second", "ms a call", "longest, ms"):
        table.add_column(name, justify="left" if name == "part" else "right")
    for part, spent_s in sorted(rows.items(), key=lambda item: -item[1]):
        calls, longest_s = span.calls.get(part, 0), span.watch.longest_s.get(part, 0.0)
        figures = (f"{calls / span.flown_s:.0f}", f"{1e3 * spent_s / calls:.3f}") if calls else ("", "")
        table.add_row(part, f"{1e3 * spent_s / span.flown_s:.1f}", *figures, f"{1e3 * longest_s:.1f}")
    table.add_section()
    table.add_row("all", f"{1e3 * _share(span, fast=fast):.1f}", "", "", "")
    return table


def _share(span: FlightSpan, *, fast: bool) -> float:
    """CPU seconds a second of flight; in virtual time those of the watched parts."""
    return (sum(span.spent_s.values()) if fast else span.cpu_s) / span.flown_s


def _bars(span: FlightSpan, log: FlightLog, trial: Trial, report: BenchReport, *, fast: bool) -> list[Bar]:
    bars = [at_most("CPU", 100.0 * _share(span, fast=fast), CORE_PERCENT, "% of a core")]
    if fast:
        return bars
    delays = latency(log.kept["setpoint"], log.kept["control_report"])
    exposure_p50, exposure_p99 = delays.exposure_to_setpoint_p50, delays.exposure_to_setpoint_p99
    assert exposure_p50 is not None
    assert exposure_p99 is not None
    assert delays.cycle_late_p99 is not None
    camera_ms = 1e3 * trial.scenario.camera.latency_s
    longest = sorted(span.watch.callbacks, reverse=True)
    held = sum(callback.cpu_s > 1e-3 * LOOP_MS for callback in longest)
    report.show(f"exposure to setpoint, beyond the camera's delay: p50 {exposure_p50 - camera_ms:.1f} ms")
    report.show(f"event loop's delay, by the control cycles: p50 {delays.cycle_late_p50:.1f} ms")
    shown = ", ".join(f"{1e3 * callback.cpu_s:.1f} ({callback.part})" for callback in longest[:5])
    report.show(f"longest callbacks, ms: {shown}; {held} of {len(longest)} above {LOOP_MS:g} ms")
    return [
        *bars,
        at_most("exposure to setpoint p99", exposure_p99 - camera_ms, LATENCY_MS, "ms"),
        at_most("event loop's delay p99", delays.cycle_late_p99, LOOP_MS, "ms"),
    ]


def _cpu_s() -> float:
    """All threads of this process, the kernel's work for them included."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime
