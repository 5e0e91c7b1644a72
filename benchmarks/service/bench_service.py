"""The service's budget: start to standby, CPU, memory, latency, and ten orders in one run.

    python -m benchmarks service --part landing

`landing`: real time, app and simulator as two processes, for two minutes; the app's CPU is that of its
process as the kernel counts it. Latency is from a frame's exposure to the first setpoint that used it, by the
flight's own log, without what the camera took to hand the frame over. In real time nothing of what `compute`
models is spent, so nothing of it is taken off.
`orders`: virtual time, for a few minutes: landings in one run, among refusals and pilots who take over. What
the app holds is counted after each.

Prints the figures beside the bars, and ends in one line that says which hold; the exit status matches.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import sys
import tempfile
import threading
import time
from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from mcap.reader import make_reader

from benchmarks.report import BenchReport, resident_mb
from benchmarks.service.running import NEAR, Stage, stage
from companion.base.messages import Phase
from sitl.campaign.tables import Bar, at_most
from tests.scenario.standing_by import StoryField, stand_by

SMOKE: Final = ("--part", "orders", "--orders", "1")
START_S: Final = 4.0
STANDBY_PERCENT: Final = 25.0
LANDING_PERCENT: Final = 40.0
MEMORY_MB: Final = 300.0
LATENCY_MS: Final = 20.0
GROWTH_MB: Final = 10.0
# half of it is more than the rows of any of our cameras lie about the frame's middle, and less than a period
READOUT_S: Final = 1.0 / 60.0
STANDBY_WATCHED_S: Final = 20.0
ORDERS: Final = 10
GROUND: Final = frozenset({"standby", "connect", "arm"})
PARTS: Final = ("landing", "orders")


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--part", choices=PARTS, help="else both, one after the other")
    parser.add_argument("--scenario", default="static", help="of the landing")
    parser.add_argument("--orders", type=int, default=ORDERS)
    chosen = parser.parse_args(arguments)
    report = BenchReport()
    bars: list[Bar] = []
    if chosen.part in (None, "landing"):
        bars += _landing(chosen.scenario, report)
    if chosen.part in (None, "orders"):
        bars += _many_orders(chosen.orders)
    return report.judge(bars)


# ---------------------------------------------------------------- one landing, real time


def _landing(scenario: str, report: BenchReport) -> list[Bar]:
    with (
        tempfile.TemporaryDirectory(prefix="service-") as folder,
        stage(Path(folder), scenario, 0) as on,
    ):
        bars = [at_most("start to standby", on.start_service(), START_S, "s")]
        on.wait_until(None, healthy=True)
        bars.append(at_most("CPU in standby", _standby_percent(on), STANDBY_PERCENT, "% of a core"))
        bars.append(at_most("CPU in a landing", _landing_percent(on), LANDING_PERCENT, "% of a core"))
        bars.append(at_most("memory, largest", _memory_mb(on), MEMORY_MB, "MB"))
        on.end_service()  # which finishes the log
        delays = read_delays(Path(folder) / "flights" / "flight-0001" / "flight.mcap")
    for line in delays.lines():
        report.show(line)
    return [
        *bars,
        at_most("exposure to setpoint p99, beyond the camera", delays.beyond_ms, LATENCY_MS, "ms"),
    ]


@dataclass(frozen=True)
class Delays:
    """Of each frame that a setpoint used (ms), an entry a frame."""

    camera_ms: np.ndarray
    vision_ms: np.ndarray
    waited_ms: np.ndarray  # from the frame's result to the setpoint

    @property
    def beyond_ms(self) -> float:
        """The 99th percentile of what the camera does not account for."""
        return float(np.percentile(self.vision_ms + self.waited_ms, 99))

    def lines(self) -> list[str]:
        """Where the time goes, a line a part."""
        whole = {
            "exposure to frame": self.camera_ms,
            "frame to result": self.vision_ms,
            "result to setpoint": self.waited_ms,
            "frame to setpoint": self.vision_ms + self.waited_ms,
            "exposure to setpoint": self.camera_ms + self.vision_ms + self.waited_ms,
        }
        ranks = {name: np.percentile(values, (50, 99)) for name, values in whole.items()}
        return [f"{name}: p50 {p50:.1f} ms, p99 {p99:.1f} ms" for name, (p50, p99) in ranks.items()]


def read_delays(path: Path) -> Delays:
    """The delays of a flight, from its log."""
    frames: list[Stamps] = []
    sent: dict[float, float] = {}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(topics=["/frame_report", "/setpoint"]):
            told = json.loads(message.data)
            if channel.topic == "/frame_report":
                frames.append((told["time_s"], told["received_s"], told["done_s"]))
            elif told.get("exposure_time_s") is not None:
                sent.setdefault(told["exposure_time_s"], told["time_s"])
    used = ((_frame_of(seen_s, frames), sent_s) for seen_s, sent_s in sent.items())
    rows = [(*frame, sent_s) for frame, sent_s in used if frame is not None]
    if not rows:
        raise RuntimeError(f"{path}: no setpoint used a frame")
    return Delays(*(1e3 * np.diff(np.array(rows), axis=1).T))


Stamps = tuple[float, float, float]  # of a frame (s): exposed, received, done


def _frame_of(seen_s: float, frames: list[Stamps]) -> Stamps | None:
    """The frame in which the pad was seen then: rows are exposed before and after the frame's own time."""
    after = bisect([exposed_s for exposed_s, *_ in frames], seen_s)
    near = [frame for frame in frames[max(0, after - 1) : after + 1] if abs(frame[0] - seen_s) < READOUT_S]
    return min(near, key=lambda frame: abs(frame[0] - seen_s), default=None)


def _standby_percent(on: Stage) -> float:
    before_s = _cpu_s(on)
    time.sleep(STANDBY_WATCHED_S)
    return 100.0 * (_cpu_s(on) - before_s) / STANDBY_WATCHED_S


def _landing_percent(on: Stage) -> float:
    """From the take-off to the touchdown of a flight that is ordered."""
    on.ask({"request": "order", "kind": "fly"})
    began: tuple[float, float] | None = None
    while True:
        phase = on.ask({"request": "status"})["phase"]
        now = (_cpu_s(on), time.monotonic())
        if began is None and phase not in GROUND:
            began = now
        if began is not None and phase in {"landed", "abort", "standby"}:
            if phase == "abort":
                raise RuntimeError("the landing was aborted")
            on.wait_until("standby")
            return 100.0 * (now[0] - began[0]) / (now[1] - began[1])
        time.sleep(0.5)


def _cpu_s(on: Stage) -> float:
    """All threads and children of the service."""
    assert on.service is not None
    cells = Path(f"/proc/{on.service.pid}/stat").read_text().rpartition(")")[2].split()
    return sum(int(cell) for cell in cells[11:15]) / float(os.sysconf("SC_CLK_TCK"))


def _memory_mb(on: Stage) -> float:
    assert on.service is not None
    lines = Path(f"/proc/{on.service.pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / 1e3


# ---------------------------------------------------------------- many orders, virtual time


@dataclass(frozen=True)
class HeldMemory:
    """What the process holds between two orders."""

    tasks: int
    threads: int
    files: int
    memory_mb: float

    @classmethod
    def now(cls) -> HeldMemory:
        """Count; what is garbage is none."""
        memory_mb = resident_mb()
        return cls(
            tasks=len(asyncio.all_tasks()),
            threads=threading.active_count(),
            files=sum(1 for _ in Path("/proc/self/fd").iterdir()),
            memory_mb=memory_mb,
        )

    def more_than(self, first: HeldMemory) -> int:
        """How many tasks, threads and files more."""
        pairs = ((self.tasks, first.tasks), (self.threads, first.threads), (self.files, first.files))
        return sum(max(0, now - before) for now, before in pairs)


def _many_orders(count: int) -> list[Bar]:
    """Landings in one run: refused on the ground, every other one taken by the pilot first, landed."""
    held: list[HeldMemory] = []

    async def story(field: StoryField) -> None:
        await field.ready()
        for number in range(count):
            field.order()
            await field.take_off(4.0)
            if number % 2:
                field.order()
                await field.phase(Phase.APPROACH)
                field.pilot_mode("POSCTL")
                await field.phase(Phase.STANDBY, 30.0)
            field.order()
            await field.landed()
            await asyncio.sleep(3.0)  # the log's last messages, and its thread
            field.forget()
            held.append(HeldMemory.now())
            print(f"landing {number + 1}: {held[-1]}", file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory(prefix="service-") as folder:
        stand_by(story, record=Path(folder), base=str(NEAR))
        recorded = len(list(Path(folder).glob("flight-*/flight.mcap")))
    first, last = held[0], held[-1]
    return [
        at_most(f"of {count} ordered landings not flown", count - len(held), 0.0),
        at_most("flights without a log", count + count // 2 - recorded, 0.0),
        at_most("tasks, threads and files gained since the first", last.more_than(first), 0.0),
        at_most("memory gained since the first", last.memory_mb - first.memory_mb, GROWTH_MB, "MB"),
    ]
