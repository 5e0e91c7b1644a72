"""Landings on the firmwares' own simulators in real time, as docs/how-to/real-autopilots.md flies them.

    python -m benchmarks external --px4 BIN --arducopter BIN --flights 5

PX4 flies in its SIH, ArduCopter in its own simulator; the pad, the camera and the score are the external
world's. The machine has to be quiet: firmware, world and app need two cores. One flight after another, each
with an empty parameter set but for the documented ones. `--out DIR` (default: flights/bench-external) keeps
them; give the same command again after an interruption, and it goes on.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from pymavlink import mavutil
from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from companion.config import CONFIG_FOLDER, ConfigError
from sitl.campaign.tables import Bar, at_most
from sitl.firmware.process import Process

SMOKE: Final = ("--flights", "1", "--scenarios", "static")
NEEDS: Final = "PX4, ARDUCOPTER and the machine to itself"
SCENARIOS: Final = ("static", "line", "circle")
MEDIAN_CM: Final = 6.0
BROKEN_COMMITS: Final = 1
BREAKS_OFF: Final = ": waiting again over the pad"
# as it arms, the list of PX4's timers (drv_hrt.cpp of its posix build) has lost its middle in 1 of 12 starts:
# the simulated magnetometer, barometer and GPS stop, and its failsafe lands it
TIMERS_LOST: Final = ("no magnetic field in the IMU's messages", "autopilot failsafe: AUTO.LAND")
STARTS: Final = 3
LOG: Final = "app.log"
BOOT_S: Final = 120.0
FLIGHT_S: Final = 400.0
HOME: Final = "47.397742,8.545594,489,0"
PX4_PARAMETERS: Final = {
    "COM_RC_IN_MODE": 4,
    "NAV_RCL_ACT": 0,
    "NAV_DLL_ACT": 0,
    "COM_OBL_RC_ACT": 5,
    "COM_OF_LOSS_T": 1.0,
}
ARDUPILOT_PARAMETERS: Final = {
    "GUID_OPTIONS": 8,
    "GUID_TIMEOUT": 0.5,
    "FS_GCS_ENABLE": 0,
    "FENCE_ENABLE": 1,
    "SIM_TERRAIN": 0,
    "SIM_SPEEDUP": 1,
}


@dataclass(frozen=True)
class Flight:
    """One flight, and the folder that keeps it."""

    kind: AutopilotKind
    binary: Path
    scenario: str
    seed: int
    folder: Path

    @property
    def row(self) -> Path:
        """Its row, once it is flown."""
        return self.folder / "row.json"


def connections(kind: AutopilotKind) -> tuple[str, ...]:
    """Where app and world find it, a connection each."""
    if kind == "px4":
        return ("--connect", "udpin:127.0.0.1:14540", "--connect-world", "udpin:127.0.0.1:14550")
    return ("--connect", "tcp:127.0.0.1:5762", "--connect-world", "tcp:127.0.0.1:5763")


@contextmanager
def firmware(flight: Flight) -> Iterator[None]:
    """It runs, and is about ready to arm.

    Raises:
        ConfigError: the program cannot be run.
        FirmwareError: it has ended.
    """
    with ExitStack() as stack:
        process = Process(flight.kind)
        stack.callback(process.close)
        if flight.kind == "px4":
            start_px4(process, flight.binary)
        else:
            stack.callback(start_ardupilot(process, flight.binary))
        yield


def start_px4(process: Process, binary: Path) -> None:
    """SIH's quadrotor as a daemon, and the documented parameters."""
    build = binary.parent.parent
    variables = {"PX4_SIM_MODEL": "sihsim_quadx", "PX4_SIMULATOR": "sihsim", "HEADLESS": "1"}
    work = process.folder
    start = ("-i", "0", "-d", build / "etc", "-w", work, "-s", "etc/init.d-posix/rcS")
    process.start((binary, *start), os.environ | variables)
    process.check(6.0)
    for name, value in PX4_PARAMETERS.items():
        subprocess.run(
            (binary.with_name("px4-param"), "--instance", "0", "set", name, str(value)),
            cwd=work, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=10.0, check=False,
        )  # fmt: skip
    process.check(8.0)


def start_ardupilot(process: Process, binary: Path) -> Callable[[], None]:
    """Its own quadrotor; what is returned lets go of the first port, which comes before the end."""
    file = process.folder / "landing.parm"
    file.write_text("".join(f"{name} {value}\n" for name, value in ARDUPILOT_PARAMETERS.items()))
    shipped = binary.parents[3] / "Tools" / "autotest" / "default_params" / "copter.parm"
    process.start(
        (binary, "--model", "+", "--speedup", "1", "--slave", "0", "--defaults", f"{shipped},{file}",
         "--sim-address=127.0.0.1", "-I0", "--home", HOME, "-w"),
        os.environ,
    )  # fmt: skip
    process.check(2.0)
    ready, ended = threading.Event(), threading.Event()
    holder = threading.Thread(target=hold_first_port, args=(ready, ended), daemon=True)
    holder.start()
    deadline_s = time.monotonic() + BOOT_S
    while not ready.wait(1.0) and time.monotonic() < deadline_s:
        process.check()
    process.check(4.0)

    def let_go() -> None:
        ended.set()
        holder.join(2.0)

    return let_go


def hold_first_port(ready: threading.Event, ended: threading.Event) -> None:
    """ArduPilot begins when somebody connects there, and tells its messages only to who sends heartbeats."""
    link = mavutil.mavlink_connection("tcp:127.0.0.1:5760", source_system=254, retries=20)
    while not ended.is_set():
        link.mav.heartbeat_send(6, 8, 0, 0, 4)
        message = link.recv_match(type="STATUSTEXT", blocking=True, timeout=0.5)
        if message is not None and "is using GPS" in message.text:
            ready.set()
    link.close()


def fly(flight: Flight) -> dict[str, Any]:
    """Fly one; the row of the table, written beside the flight.

    A start at which PX4 lost its timers is no flight: it is kept beside, counted, and made again.
    """
    for lost in range(STARTS):
        row = attempt(flight) | {"lost_starts": lost}
        said = (flight.folder / LOG).read_text(errors="replace")
        if lost + 1 == STARTS or not all(words in said for words in TIMERS_LOST):
            break
        beside = flight.folder.with_name(f"{flight.folder.name}-lost-{lost}")
        shutil.rmtree(beside, ignore_errors=True)
        flight.folder.rename(beside)
    flight.row.write_text(json.dumps(row))
    return row


def attempt(flight: Flight) -> dict[str, Any]:
    """Start the firmware and fly."""
    shutil.rmtree(flight.folder, ignore_errors=True)  # of a flight that was interrupted
    flight.folder.mkdir(parents=True)
    result, log = flight.folder / "result.json", flight.folder / LOG
    with firmware(flight), log.open("wb") as said:
        code = subprocess.run(
            (sys.executable, "-m", "companion.cli", "--sitl", "--autopilot", "external",
             *connections(flight.kind), "--scenario", flight.scenario, "--seed", str(flight.seed), "--no-ui",
             "--json", result, "--record", flight.folder / "log"),
            cwd=CONFIG_FOLDER.parent, stdout=said, stderr=subprocess.STDOUT, timeout=FLIGHT_S, check=False,
        ).returncode  # fmt: skip
    found = json.loads(result.read_text()) if result.exists() else {}
    return {
        "outcome": found.get("outcome", f"exit code {code}"),
        "touchdown": found.get("touchdown"),
        "broken_commits": log.read_text(errors="replace").count(BREAKS_OFF),
    }


def shown(flights: Sequence[Flight]) -> tuple[Table, list[Bar]]:
    """The table of what is flown, and its bars."""
    table, bars = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0)), []
    for heading in (
        "firmware, scenario",
        "landed",
        "lateral cm p50 worst",
        "down, sideways m/s worst",
        "broken",
        "lost starts",
    ):
        table.add_column(heading, no_wrap=True)
    for kind, scenario in dict.fromkeys((f.kind, f.scenario) for f in flights):
        rows = [json.loads(f.row.read_text()) for f in flights if (f.kind, f.scenario) == (kind, scenario)]
        landed = [row for row in rows if row["outcome"] == "landed"]
        touched = [row["touchdown"] for row in rows if row["touchdown"]]
        lateral = [100.0 * t["lateral_error_m"] for t in touched]
        median = float(np.median(lateral)) if lateral else float("inf")
        broken = max(row["broken_commits"] for row in rows)
        speeds = [
            max((t[k] for t in touched), default=0.0) for k in ("vertical_speed_m_s", "horizontal_speed_m_s")
        ]
        name = f"{kind} {scenario}"
        table.add_row(
            name, f"{len(landed)}/{len(rows)}", f"{median:.1f} {max(lateral, default=0.0):.1f}",
            f"{speeds[0]:.2f} {speeds[1]:.2f}", str(broken), str(sum(row["lost_starts"] for row in rows)),
        )  # fmt: skip
        bars.append(Bar(f"{name} landed", f"{len(landed)} of {len(rows)} (all)", len(landed) == len(rows)))
        bars.append(at_most(f"{name} p50", median, MEDIAN_CM, "cm"))
        bars.append(at_most(f"{name} broken commits", broken, BROKEN_COMMITS, digits=0))
    return table, bars


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly what has no row yet, print the table, and say which bars hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--px4", type=Path, help="the program px4")
    parser.add_argument("--arducopter", type=Path, help="the program arducopter")
    parser.add_argument("--flights", type=int, default=5, help="of each scenario on each firmware")
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    parser.add_argument("--out", type=Path, default=Path("flights/bench-external"))
    options = parser.parse_args(arguments)
    binaries: dict[AutopilotKind, Path | None] = {"px4": options.px4, "ardupilot": options.arducopter}
    flights = [
        Flight(kind, path.resolve(), scenario, seed, options.out.resolve() / f"{kind}-{scenario}-{seed}")
        for seed in range(options.flights)
        for kind, path in binaries.items()
        if path is not None
        for scenario in options.scenarios
    ]
    if not flights:
        raise ConfigError("bench-external: expected --px4 BIN, --arducopter BIN or both")
    report = BenchReport()
    for flight in flights:
        if not flight.row.exists():
            report.progress(f"{flight.kind} {flight.scenario} {flight.seed}: {json.dumps(fly(flight))}")
    table, bars = shown(flights)
    report.show(table)
    return report.judge(bars)
