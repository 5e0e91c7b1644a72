"""Where the time goes in virtual time: one flight, one core, milliseconds of computing a simulated second.

    python -m tests.bench.cpu.bench_time --scenario circle --seed 0

Prints a table and ends in one line that says whether the bar holds (3x real time with rendering on); the
exit status matches.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, Final

import cv2
from rich.console import Console
from rich.table import Table

from companion.base.clock import wall_clock_s
from companion.config import CONFIG_FOLDER
from companion.control.controller import Controller
from companion.estimate.estimator import StateEstimator
from companion.flightlog.record import FlightLog
from companion.link.session import Session
from companion.plan.planner import Planner
from companion.sense.gps.neo6m import Neo6m
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.range.ultrasonic import Ultrasonic
from companion.sense.vision.pipeline import Vision
from companion.sim.runner import fly
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.autopilot import SimulatedAutopilot
from sitl.camera.camera import CameraModel
from sitl.devices.rack import SensorRack
from sitl.mavlink.network import Network
from sitl.world.world import World

REAL_TIME_FACTOR: Final = 3.0
PARTS: Final[dict[str, dict[type[Any], tuple[str, ...]]]] = {
    "SITL: world": {World: ("step", "truth", "range_to_surface_m")},
    "SITL: autopilot": {SimulatedAutopilot: ("step",)},
    "SITL: sensors and devices": {SensorRack: ("step",)},
    "SITL: rendering": {CameraModel: ("render",)},
    "SITL: MAVLink": {Network: ("receive", "transmit")},
    "app: drivers": {Mpu9250: ("poll",), Neo6m: ("feed", "pending"), Ultrasonic: ("feed",)},
    "app: detection and pose": {Vision: ("step",)},
    "app: estimators": {
        StateEstimator: (
            *("add_imu", "add_mag", "add_gps", "add_range", "add_sighting"),
            *("vehicle", "pad", "pad_prior"),
        )
    },
    "app: planner": {Planner: ("step",)},
    "app: MPC and limits": {Controller: ("step",)},
    "app: MAVLink": {Session: ("receive", "tick", "send_setpoint", "send_notice", "align")},
}


class Stopwatch:
    """Adds up the time spent in methods, by part; a call within another part's call counts there alone."""

    def __init__(self) -> None:
        self.spent_s: defaultdict[str, float] = defaultdict(float)
        self._running = False

    def watch(self, part: str, owner: type[Any], name: str) -> None:
        """Replace a method by one that is timed."""
        method: Callable[..., Any] = getattr(owner, name)

        def timed(*arguments: Any, **named: Any) -> Any:
            if self._running:
                return method(*arguments, **named)
            self._running = True
            started_s = wall_clock_s()
            try:
                return method(*arguments, **named)
            finally:
                self.spent_s[part] += wall_clock_s() - started_s
                self._running = False

        setattr(owner, name, timed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="circle")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    stopwatch = Stopwatch()
    for part, owners in PARTS.items():
        for owner, names in owners.items():
            for name in names:
                stopwatch.watch(part, owner, name)
    trial = Trial.load(chosen.scenario, chosen.seed)
    settings = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    log = FlightLog(None, start_unix_s=0.0)
    started_s = wall_clock_s()
    flight = fly(settings, trial, log, lambda _status: None, fast=True)
    elapsed_s = wall_clock_s() - started_s
    return report(stopwatch, elapsed_s, flight.report.duration_s, flight.real_time_factor)


def report(stopwatch: Stopwatch, elapsed_s: float, simulated_s: float, factor: float) -> int:
    """Print the table and the verdict; returns the exit status."""
    rest_s = elapsed_s - sum(stopwatch.spent_s.values())
    rows = {**stopwatch.spent_s, "event loop, log, start": rest_s}
    table = Table(title=f"{simulated_s:.0f} s simulated in {elapsed_s:.1f} s")
    table.add_column("part")
    table.add_column("ms a simulated second", justify="right")
    table.add_column("share", justify="right")
    for part, spent_s in sorted(rows.items(), key=lambda item: -item[1]):
        table.add_row(part, f"{1e3 * spent_s / simulated_s:.1f}", f"{100 * spent_s / elapsed_s:.0f} %")
    Console().print(table)
    holds = factor >= REAL_TIME_FACTOR
    print(f"bar: {factor:.1f}x real time, at least {REAL_TIME_FACTOR:g}x: {'holds' if holds else 'FAILS'}")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
