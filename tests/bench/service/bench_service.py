"""The service's budget: start to standby, CPU in standby and in a landing, memory, and ten orders in one run.

    python -m tests.bench.service.bench_service

Real time, app and simulator as two processes; the app's CPU is that of its process as the kernel counts it.
Prints the figures beside the bars, and ends in one line that says which hold; the exit status matches.
"""

from __future__ import annotations

import argparse
import gc
import os
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from companion.base.messages import Phase
from tests.bench.cpu.bench_cpu import Bar
from tests.bench.service.running import Stage, stage
from tests.scenario.standing_by import Field, stand_by

START_S: Final = 4.0
STANDBY_PERCENT: Final = 25.0
LANDING_PERCENT: Final = 40.0
MEMORY_MB: Final = 300.0
GROWTH_MB: Final = 10.0
STANDBY_WATCHED_S: Final = 20.0
ORDERS: Final = 10
GROUND: Final = frozenset({"standby", "connect", "arm"})


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="static")
    parser.add_argument("--orders", type=int, default=ORDERS)
    chosen = parser.parse_args(arguments)
    with (
        tempfile.TemporaryDirectory(prefix="service-") as folder,
        stage(Path(folder), chosen.scenario, 0) as on,
    ):
        bars = [Bar("start to standby", on.start_service(), START_S, "s")]
        on.wait_until(None, healthy=True)
        standby = _standby_percent(on)
        bars.append(Bar("CPU in standby", standby, STANDBY_PERCENT, "% of a core"))
        bars.append(Bar("CPU in a landing", _landing_percent(on), LANDING_PERCENT, "% of a core"))
        bars.append(Bar("memory, largest", _memory_mb(on), MEMORY_MB, "MB"))
    bars += _many_orders(chosen.orders)
    for bar in bars:
        print(bar)
    failed = [bar.name for bar in bars if not bar.holds]
    print(f"bars: {'all hold' if not failed else 'FAILED: ' + ', '.join(failed)}")
    return 1 if failed else 0


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


def _own_memory_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def _many_orders(count: int) -> list[Bar]:
    """Landings in one run, in virtual time: refused on the ground, taken by the pilot, landed."""
    landed, memory_mb = 0, []

    async def story(field: Field) -> None:
        nonlocal landed
        await field.ready()
        for number in range(count):
            field.order()
            await field.take_off()
            if number % 2:
                field.order()
                await field.phase(Phase.APPROACH)
                field.pilot_mode("POSCTL")
                await field.phase(Phase.STANDBY, 30.0)
            field.order()
            await field.landed()
            landed += 1
            gc.collect()
            memory_mb.append(_own_memory_mb())

    stand_by(story)
    grown_mb = memory_mb[-1] - memory_mb[1]
    return [
        Bar(f"of {count} ordered landings not flown", count - landed, 0.0, ""),
        Bar("memory gained from the second landing to the last", grown_mb, GROWTH_MB, "MB"),
    ]


if __name__ == "__main__":
    sys.exit(main())
