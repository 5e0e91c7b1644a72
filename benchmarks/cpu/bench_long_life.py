"""An hour of virtual flight in one run, with hundreds of tries: do memory and a control step stay flat?

    python -m benchmarks long-life --minutes 60

App and simulator fly `circle` in one process, rendered, with a flight log on disk. The camera is blind for
some seconds again and again, so that the pad is lost, searched and approached anew. Each minute's memory,
steps and tasks are noted; the first quarter is for warming up. One line says at the end which bars hold.
"""

import argparse
import asyncio
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final
from unittest import mock

import numpy as np
from rich.table import Table

from benchmarks.faults.cases import changed
from benchmarks.report import BenchReport, resident_mb
from companion.app.app import App
from companion.app.hardware import make_own_actions
from companion.base.clock import run_in_virtual_time
from companion.base.messages import Frame
from companion.config import CONFIG_FOLDER
from companion.control.controller import Controller
from companion.flightlog.record import FlightLog
from companion.link.transport import memory_pair
from companion.plan.planner import Planner
from companion.sense.vision.opencv import prepare_opencv
from companion.sim.runner import hardware_of
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.campaign.tables import Bar, at_most
from sitl.run.in_process import InProcess
from sitl.scenario.scenario import load_scenario
from tests.beside import beside

SMOKE: Final = ("--minutes", "2")
SEES_S: Final = 9.0
BLIND_S: Final = 6.5
FIRST_BLIND_S: Final = 25.0
MINUTE_S: Final = 60.0
WARM_SHARE: Final = 0.25
GROWN_MB: Final = 10.0
SLOWER: Final = 1.3
_SETTINGS: Final[dict[str, Any]] = {
    "plan": {"mission": {"total_timeout_s": 3600.0}, "landing": {"retries": 20}},
}
# a battery lasts for 18 minutes, and the app lands by what is left of it
_FULL_BATTERY: Final[list[dict[str, Any]]] = [{"kind": "battery", "start_s": 0.0, "remaining_percent": 100}]


@dataclass(frozen=True, slots=True)
class Minute:
    """What one minute of the flight was like; the step is planning and control together."""

    memory_mb: float
    step_p50_ms: float
    step_p99_ms: float
    tasks: int
    tries: int


class Interrupted:
    """The camera's frames, but for `BLIND_S` in each period; nothing is rendered meanwhile."""

    def __init__(self, vehicle: InProcess) -> None:
        self._vehicle = vehicle

    async def next(self) -> Frame:
        """The next frame that is not hidden."""
        while True:
            frame = await self._vehicle.frames.next()
            if self.sees(frame.time_s):
                return frame

    def sees(self, now_s: float) -> bool:
        """Whether the camera sees."""
        return now_s < FIRST_BLIND_S or (now_s - FIRST_BLIND_S) % (BLIND_S + SEES_S) >= BLIND_S

    def close(self) -> None:
        """Nothing to release."""


@contextmanager
def timed(steps_s: list[float]) -> Iterator[None]:
    """Note the processor's seconds of each step of planner and controller."""
    plan, control = Planner.step, Controller.step
    planned = [0.0]

    def timed_plan(planner: Planner, *arguments: Any, **named: Any) -> Any:
        began_s = time.thread_time()
        found = plan(planner, *arguments, **named)
        planned[0] = time.thread_time() - began_s
        return found

    def timed_control(controller: Controller, *arguments: Any, **named: Any) -> Any:
        began_s = time.thread_time()
        found = control(controller, *arguments, **named)
        steps_s.append(planned[0] + time.thread_time() - began_s)
        return found

    with mock.patch.object(Planner, "step", timed_plan), mock.patch.object(Controller, "step", timed_control):
        yield


async def fly(minutes: int, steps_s: list[float], *, logs: bool = True) -> tuple[list[Minute], str]:
    """Fly for so long; returns the minutes, and how the flight ended if it ended before."""
    scenario = changed(load_scenario("circle"), {"companion": _SETTINGS, "faults": _FULL_BATTERY})
    trial = Trial(Path("circle.yaml"), scenario, 0)
    config = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    app_end, vehicle_end = memory_pair()
    vehicle = InProcess(
        trial.scenario,
        trial.seed,
        link=vehicle_end,
        gps_baud=config.sense.gps.baud,
        keep_truth=False,
    )
    frames = Interrupted(vehicle)
    hardware = replace(hardware_of(vehicle, app_end, config), frames=frames)
    with tempfile.TemporaryDirectory(prefix="bench-long-life-") as folder:
        log = FlightLog(Path(folder) if logs else None, start_unix_s=0.0, keeps=False)  # as on board
        app = App(config, hardware, log, make_own_actions)
        made = []
        with closing(log):
            async with beside(app.run(), vehicle.simulation.run()) as (flight, _):
                async for minute in _minutes(minutes, vehicle, frames, flight, steps_s):
                    made.append(minute)
                    print(f"{len(made)}/{minutes} min: {minute.memory_mb:.1f} MB", flush=True)
    words = [said.text for said in vehicle.simulation.status_text_monitor.texts]
    return made, words[-1] if len(made) < minutes else ""


async def _minutes(
    count: int, vehicle: InProcess, frames: Interrupted, flight: asyncio.Task[Any], steps_s: list[float]
) -> Any:
    """Look at each minute as it ends, until the flight does."""
    words = vehicle.simulation.status_text_monitor.texts
    for number in range(1, count + 1):
        while vehicle.simulation.world.time_s < number * MINUTE_S:
            if flight.done():
                return
            vehicle.wants_frames = frames.sees(vehicle.simulation.world.time_s + 0.2)
            await asyncio.wait([flight], timeout=0.1)
        p50, p99 = np.percentile(steps_s, (50, 99)) * 1e3 if steps_s else (0.0, 0.0)
        tries = sum(said.text.startswith("approach: ") for said in words)
        steps_s.clear()
        yield Minute(resident_mb(), float(p50), float(p99), len(asyncio.all_tasks()), tries)


def bars(minutes: Sequence[Minute], wanted: int, ended: str) -> list[Bar]:
    """Memory, cost and tasks at the end beside those after warming up."""
    warm = minutes[round(WARM_SHARE * wanted) :]
    third = max(1, len(warm) // 3)
    early, late = warm[:third], warm[-third:]
    grown = max(m.memory_mb for m in late) - max(m.memory_mb for m in early) if warm else 0.0
    slower = _median(late) / _median(early) if warm else 0.0
    # a request that waits for its answer is a task too
    tasks = max(m.tasks for m in late) - max(m.tasks for m in early) if warm else 0
    return [
        Bar("flown", f"{len(minutes)} of {wanted} min {ended}".strip(), len(minutes) == wanted),
        at_most("memory grown", grown, GROWN_MB, "MB"),
        at_most("cost of a step, last third over first", slower, SLOWER, digits=2),
        at_most("tasks more", tasks, 0, digits=0),
    ]


def _median(minutes: Sequence[Minute]) -> float:
    return float(np.median([minute.step_p50_ms for minute in minutes])) or 1e-9


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly; 0 when the bars hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--without-log", action="store_true", help="no flight log on disk, whose index grows")
    options = parser.parse_args(arguments)
    report = BenchReport()
    prepare_opencv()
    steps_s: list[float] = []
    with timed(steps_s):
        minutes, ended = run_in_virtual_time(fly(options.minutes, steps_s, logs=not options.without_log))
    table = Table("minute", "memory", "step p50", "step p99", "tasks", "approaches so far")
    for number, m in enumerate(minutes, 1):
        step = (f"{m.step_p50_ms:.2f} ms", f"{m.step_p99_ms:.2f} ms")
        table.add_row(f"{number}", f"{m.memory_mb:.1f} MB", *step, f"{m.tasks}", f"{m.tries}")
    report.show(table)
    found = bars(minutes, options.minutes, ended)
    return report.judge(found)
