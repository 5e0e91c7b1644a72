"""How fast one simulated vehicle runs in virtual time on one core, without and with its camera.

    python -m benchmarks sitl-speed --autopilot px4 --seed 0

The vehicle is served alone and flown by MAVLink bytes over a moving pad, in wind (`speed_flight`). Figures
are simulated seconds in one of this process's CPU seconds, the best of a few flights, because what else the
machine does slows a CPU second too. The table of parts comes from flights of its own, since watching costs:
its parts are scaled to what the flight costs unwatched. Prints the bars and ends in one line that says
whether they hold; the exit status matches.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, NamedTuple

import cv2
from rich.table import Table

from benchmarks.cpu.speed_flight import HIGH_M, SpeedClient, SpeedFlight, fly
from benchmarks.report import BenchReport
from sitl.autopilot import SimulatedAutopilot
from sitl.camera.camera import CameraModel
from sitl.devices.rack import SensorRack
from sitl.mavlink.network import Network
from sitl.run.simulation import PHYSICS_STEP_S, Simulation
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.world.contact import Contact
from sitl.world.world import World

SMOKE: Final = ("--runs", "1")
BARE_FACTOR: Final = 40.0
CAMERA_FACTOR: Final = 8.0
LEAST_PHYSICS_HZ: Final = 400.0
FLOWN_M: Final = 2.0
RUNS: Final = 3
REST: Final = "event loop, ticks, log"
PARTS: Final[dict[str, tuple[tuple[type[Any], str], ...]]] = {
    "physics": ((World, "step"), (World, "motion"), (World, "truth")),
    "contact": ((Contact, "step"),),
    "autopilot": ((SimulatedAutopilot, "step"),),
    "sensor chips": ((SensorRack, "step"),),
    "autopilot's own sensors": ((SimulatedAutopilotSensors, "step"),),
    "MAVLink": (*((Network, "receive"), (Network, "transmit")),),
    "rendering": ((CameraModel, "render"),),
    "client": ((SpeedClient, "write"), (SpeedClient, "stream")),
    REST: ((Simulation, "_tick"),),
}


class SpeedBar(NamedTuple):
    """A figure and the least that it may be."""

    name: str
    measured: float
    least: float

    @property
    def holds(self) -> bool:
        """Whether it is that much."""
        return self.measured >= self.least

    def __str__(self) -> str:
        return (
            f"{self.name} {self.measured:.1f} (at least {self.least:g}) {'holds' if self.holds else 'FAILS'}"
        )


class Watch:
    """Adds up the time spent in methods by part, without that of watched methods within them."""

    def __init__(self) -> None:
        self.spent_s: defaultdict[str, float] = defaultdict(float)
        self._inner_s: list[float] = []

    @contextmanager
    def watching(self) -> Iterator[None]:
        """While inside, the methods of `PARTS` are timed."""
        found = [(owner, name, getattr(owner, name)) for methods in PARTS.values() for owner, name in methods]
        for part, methods in PARTS.items():
            for owner, name in methods:
                setattr(owner, name, self._timed(part, getattr(owner, name)))
        try:
            yield
        finally:
            for owner, name, method in found:
                setattr(owner, name, method)

    def _timed(self, part: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **named: Any) -> Any:
            self._inner_s.append(0.0)
            started_s = time.perf_counter()
            try:
                return method(*arguments, **named)
            finally:
                spent_s = time.perf_counter() - started_s
                self.spent_s[part] += spent_s - self._inner_s.pop()
                if self._inner_s:
                    self._inner_s[-1] += spent_s

        return timed


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--autopilot", choices=("px4", "ardupilot"), default="px4")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--runs", type=int, default=RUNS, help="the best of so many flights counts")
    chosen = parser.parse_args(arguments)
    report = BenchReport()
    cv2.setNumThreads(1)
    flights: dict[bool, SpeedFlight] = {}
    parts: dict[bool, dict[str, float]] = {}
    for camera in (False, True):
        flown = [fly(chosen.autopilot, chosen.seed, camera=camera) for _ in range(chosen.runs)]
        flights[camera] = max(flown, key=lambda flight: flight.whole.real_time_factor)
        watch = Watch()
        with watch.watching():
            fly(chosen.autopilot, chosen.seed, camera=camera)
        parts[camera] = _scaled(watch.spent_s, 1e3 / flights[camera].whole.real_time_factor)
    report.show(_parts_table(parts))
    return report.judge(_bars(flights))


def _scaled(spent_s: dict[str, float], total_ms: float) -> dict[str, float]:
    """ms of a simulated second by part, the client's left out."""
    own = {part: spent_s.get(part, 0.0) for part in PARTS if part != "client"}
    whole_s = sum(own.values())
    return {part: total_ms * value / whole_s for part, value in own.items()}


def _parts_table(parts: dict[bool, dict[str, float]]) -> Table:
    table = Table(title="ms of CPU a simulated second")
    table.add_column("part")
    for name in ("without camera", "with camera"):
        table.add_column(name, justify="right")
    for part in parts[False]:
        table.add_row(part, *(f"{parts[camera][part]:.2f}" for camera in (False, True)))
    table.add_section()
    table.add_row("all", *(f"{sum(parts[camera].values()):.2f}" for camera in (False, True)))
    return table


def _bars(flights: dict[bool, SpeedFlight]) -> list[SpeedBar]:
    bare, rendered = flights[False], flights[True]
    return [
        SpeedBar("without camera, x real time", bare.whole.real_time_factor, BARE_FACTOR),
        *(
            SpeedBar(f"640x480 at 30 fps from {name}, x real time", stage.real_time_factor, CAMERA_FACTOR)
            for name, stage in rendered.stages.items()
        ),
        SpeedBar("physics, Hz", 1.0 / PHYSICS_STEP_S, LEAST_PHYSICS_HZ),
        # that it was flown at all, and to the places where it is measured
        SpeedBar("highest, m", bare.highest_m, HIGH_M - 1.0),
        SpeedBar("over the pad, m to spare", FLOWN_M - max(bare.away_m.values()), 0.0),
        SpeedBar("frames a second", rendered.frames / rendered.seconds, 29.0),
    ]
