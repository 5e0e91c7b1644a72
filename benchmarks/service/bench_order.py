"""What an order costs the app: the kept minute is written to the card while the landing begins.

    python -m benchmarks order

Real time, app and simulator as two processes, for two minutes: the app stands by until its minute is full,
then is ordered to fly. By the flight's own log, `WATCHED_S` after the order beside all windows of that length
in the minute before it: how late control cycles begin, how long a frame takes from its arrival to its result,
and the steps between the IMU's stamps, where a FIFO that overflows leaves a gap. What the flight itself
computes, once it sees the pad, lies behind the window.

`--busy`: so many programs compute without end beside it, at the usual priority; the service has the unit's
(`--nice`, which takes root). The kernel hands out time slices in standby too: the windows before the order
are its floor. What counts is the difference to their middle one; beside it stands how many of them have a
cycle as late without an order.

Prints the figures beside the bars, and ends in one line that says which hold; the exit status matches.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.reader import make_reader

from benchmarks.report import BenchReport
from benchmarks.service.running import NEAR, ROOT, stage
from companion.base.geometry import FloatArray
from companion.flightlog.flights_recorder import KEPT_S
from sitl.campaign.tables import Bar, at_most

SMOKE: Final = ("--kept-s", "3")
NEEDS: Final = "the machine to itself"
WATCHED_S: Final = 4.0  # until the minute is written, which takes 3 s
FLOWN_S: Final = 20.0
LATE_MS: Final = 20.0
# a cycle that follows the camera lasts so many periods at most: see `companion.app.pacing`
LONGEST_CYCLE: Final = 1.4
CONTROL_HZ: Final = 30.0
IMU_GAP: Final = 1.5  # of the usual step: a sample is missing
UNIT: Final = ROOT / "systemd" / "companion.service"
TOPICS: Final = ("/plan", "/imu", "/frame_report", "/order")


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--kept-s", type=float, default=KEPT_S, help="how long it stands by before the order")
    parser.add_argument("--busy", type=int, default=0, help="programs that compute without end beside it")
    parser.add_argument("--nice", type=int, default=unit_nice(), help="the service's priority; the unit's")
    options = parser.parse_args(arguments)
    with (
        tempfile.TemporaryDirectory(prefix="order-") as folder,
        stage(Path(folder), NEAR, 0) as on,
        ExitStack() as beside,
    ):
        for _ in range(options.busy):
            busy = beside.enter_context(subprocess.Popen((sys.executable, "-c", "while True: pass")))
            beside.callback(busy.kill)
        on.start_service(nice=options.nice)
        assert on.service is not None
        nice = os.getpriority(os.PRIO_PROCESS, on.service.pid)
        on.wait_until(None, healthy=True)
        time.sleep(options.kept_s)
        on.ask({"request": "order", "kind": "fly"})
        time.sleep(FLOWN_S)
        on.end_service()  # which finishes the log
        timing = read_timing(Path(folder) / "flights" / "flight-0001" / "flight.mcap")
    report = BenchReport()
    report.show(f"beside {options.busy} programs that compute without end; the service at nice {nice}")
    for line in timing.lines():
        report.show(line)
    return report.judge(timing.bars())


def unit_nice() -> int:
    """The priority that the unit gives the service."""
    found = re.search(r"^Nice=(-?\d+)$", UNIT.read_text(encoding="utf-8"), re.MULTILINE)
    return int(found[1]) if found else 0


@dataclass(frozen=True)
class Window:
    """A while: cycles' lateness and frames' time to a result (ms), gaps of the IMU."""

    late_ms: FloatArray
    vision_ms: FloatArray
    imu_gaps: int


@dataclass(frozen=True)
class OrderTiming:
    """Before the order, in windows as long as the one after it."""

    before: tuple[Window, ...]
    after: Window
    kept_s: float

    @property
    def floor_ms(self) -> FloatArray:
        """The latest cycle (ms) of each window before the order."""
        return np.array([window.late_ms.max() for window in self.before])

    def lines(self) -> list[str]:
        """A line a figure."""
        rows = {"cycle late": "late_ms", "frame to result": "vision_ms"}
        lines = [f"kept before the order: {self.kept_s:.0f} s, {len(self.before)} windows of {WATCHED_S:g} s"]
        for name, of in rows.items():
            before = np.concatenate([getattr(window, of) for window in self.before])
            shown = (
                f"{side} p50 {np.median(values):.1f}, p99 {np.percentile(values, 99):.1f}, "
                f"most {values.max():.1f} ms"
                for side, values in (("before", before), ("after", getattr(self.after, of)))
            )
            lines.append(f"{name}: {'; '.join(shown)}")
        floor_ms, latest_ms = self.floor_ms, self.after.late_ms.max()
        gaps = [window.imu_gaps for window in self.before]
        return [
            *lines,
            f"latest cycle, window by window before: median {np.median(floor_ms):.1f} ms, "
            f"most {floor_ms.max():.1f} ms",
            f"windows before with a cycle as late as the latest after: {sum(floor_ms >= latest_ms)}",
            f"IMU gaps: before {sum(gaps)}, most of a window {max(gaps)}; after {self.after.imu_gaps}",
        ]

    def bars(self) -> list[Bar]:
        """What the order adds."""
        later_ms = float(self.after.late_ms.max() - np.median(self.floor_ms))
        gaps = self.after.imu_gaps - float(np.median([window.imu_gaps for window in self.before]))
        return [
            at_most("latest cycle after the order, beyond that of a window before", later_ms, LATE_MS, "ms"),
            at_most("gaps of the IMU after the order, beyond those of a window before", gaps, 0.0),
        ]


def read_timing(path: Path) -> OrderTiming:
    """Both sides of the order of a flight's log."""
    rows: dict[str, list[tuple[float, dict[str, Any]]]] = {topic: [] for topic in TOPICS}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(topics=TOPICS):
            rows[channel.topic].append((1e-9 * message.log_time, json.loads(message.data)))
    ordered_s = rows["/order"][0][0]

    def window(from_s: float, to_s: float) -> Window:
        within = {t: [(at, m) for at, m in rows[t] if from_s <= at < to_s] for t in TOPICS}
        cycles_s = np.diff([at for at, _ in within["/plan"]])
        steps_s = np.diff([m["time_s"] for _, m in within["/imu"]])
        reports = [m for _, m in within["/frame_report"]]
        return Window(
            late_ms=1e3 * np.maximum(0.0, cycles_s - LONGEST_CYCLE / CONTROL_HZ),
            vision_ms=1e3 * np.array([m["done_s"] - m["received_s"] for m in reports]),
            imu_gaps=int((steps_s > IMU_GAP * np.median(steps_s)).sum()),
        )

    kept_s = ordered_s - rows["/plan"][0][0]
    windows = max(1, int(kept_s / WATCHED_S))
    starts_s = [ordered_s - (n + 1) * WATCHED_S for n in range(windows)]
    before = tuple(window(start_s, start_s + WATCHED_S) for start_s in starts_s)
    return OrderTiming(before, window(ordered_s, ordered_s + WATCHED_S), kept_s)
