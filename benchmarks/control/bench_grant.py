"""The fall at the grant of control by attitude and thrust, beside its bar: whatever hover thrust was told.

    python -m benchmarks grant --arducopter BIN --seeds 5

The vehicle's true hover thrust is 0.5 to 1.6 times the one that its builder, the app's file and the
autopilot's parameter tell (`sitl.scenario.as_built`). It takes off by the autopilot's own control, in 5 m/s
of wind; from the app's first setpoint on, the bench looks how far it falls below the highest that it has
been since, beyond what its plan descends; once the plan was moved after the vehicle, all of it counts. In
virtual time, with the bundled behaviour of ArduPilot and, given its SITL build, with the real ArduCopter in
lockstep. Where the app refuses control, nothing falls: its reason is told.
"""

import argparse
import asyncio
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final

from benchmarks.faults.cases import changed
from benchmarks.in_process import app_and_vehicle
from benchmarks.report import BenchReport
from companion.base.clock import run_in_virtual_time
from companion.config import CONFIG_FOLDER
from companion.flightlog.record import FlightLog
from companion.link.codec import mavlink
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.campaign.tables import Bar, at_most
from sitl.firmware.spec import FirmwareSpec
from sitl.mavlink.framing import FrameReader
from sitl.run.simulation import Simulation
from sitl.scenario.as_built import NOTHING_ELSE
from sitl.scenario.scenario import Scenario, load_scenario
from tests.beside import beside

SMOKE: Final = ("--seeds", "1", "--shares", "1", "--jobs", "1")
SHARES: Final = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6)
MOST_FALL_M: Final = 0.3
LOOKS_FOR_S: Final = 6.0  # the vehicle is on its way to the waypoint, at one height
REFUSED_AFTER_S: Final = 45.0
LOOK_S: Final = 0.1
REPLANNED: Final = "replanned"
WIND: Final = {"mean_m_s": 5.0}


@dataclass
class Grant:
    """The app's first setpoint, and how far the vehicle came down from there on; None: it never came.

    `sunk_m`: below its highest; `lag_m`: of that, more than its plan descended.
    """

    share: float
    seed: int
    began_s: float | None = None
    sunk_m: float = 0.0
    lag_m: float = 0.0
    texts: list[str] = field(default_factory=list)

    @property
    def fall_m(self) -> float:
        """How far it fell: a plan that was moved after it says nothing."""
        return self.sunk_m if any(REPLANNED in text for text in self.texts) else self.lag_m


class GrantWitness:
    """Follows the height from the first setpoint by attitude on."""

    def __init__(self, simulation: Simulation, found: Grant, log: FlightLog) -> None:
        self._simulation, self._found, self._log = simulation, found, log
        self._reader = FrameReader(datagrams=True)
        self._stepped_s, self._planned_m = 0.0, 0.0  # how far the plan has climbed since
        self._highest_m = self._most_over_m = 0.0

    def hear(self, data: bytes, now_s: float) -> None:
        """Take what the app has just sent."""
        wanted: Any = mavlink
        kinds = {frame.message_id for frame in self._reader.read(data, now_s)}
        if self._found.began_s is None and wanted.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET in kinds:
            self._found.began_s, self._stepped_s = now_s, now_s
            self._highest_m = self._most_over_m = self._height_m()

    def step(self) -> None:
        """Look at the world."""
        found, now_s = self._found, self._simulation.world.time_s
        if found.began_s is None:
            return
        reference = self._log.kept["plan"][-1].reference
        if reference is not None:
            self._planned_m -= float(reference.velocity_m_s[0, 2]) * (now_s - self._stepped_s)
        self._stepped_s, height_m = now_s, self._height_m()
        over_m = height_m - self._planned_m
        self._highest_m = max(self._highest_m, height_m)
        self._most_over_m = max(self._most_over_m, over_m)
        found.sunk_m = max(found.sunk_m, self._highest_m - height_m)
        found.lag_m = max(found.lag_m, self._most_over_m - over_m)

    def _height_m(self) -> float:
        return -self._simulation.world.state.position_ned_m[2]


def scenario_of(share: float) -> Scenario:
    """A vehicle that needs so many times the hover thrust that was told."""
    built = {**NOTHING_ELSE, "exactly": {"hover_thrust": 1.0 / share}}
    return changed(load_scenario("line"), {"autopilot": "ardupilot", "as_built": built, "wind": WIND})


def fly(firmware: FirmwareSpec | None, flight: tuple[float, int]) -> Grant:
    """One take-off and grant."""
    share, seed = flight
    trial = Trial(Path("line.yaml"), scenario_of(share), seed, firmware=firmware)
    return run_in_virtual_time(_fly(trial, Grant(share, seed)))


async def _fly(trial: Trial, found: Grant) -> Grant:
    config = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    log = FlightLog(None, start_unix_s=0.0)
    app, vehicle = app_and_vehicle(trial, config, log)
    with closing(vehicle.simulation) as simulation, closing(log):
        witness = GrantWitness(simulation, found, log)
        simulation.on_step = witness.step
        simulation.line.listeners.append(witness.hear)
        async with beside(simulation.run(), app.run()) as (_, flight):
            while not flight.done() and simulation.world.time_s < _until_s(found):
                vehicle.wants_frames = found.began_s is None  # or it would approach the pad, and descend
                await asyncio.wait([flight], timeout=LOOK_S)
        found.texts = [said.text for said in simulation.status_text_monitor.texts]
    return found


def _until_s(found: Grant) -> float:
    return REFUSED_AFTER_S if found.began_s is None else found.began_s + LOOKS_FOR_S


def rows(name: str, grants: Sequence[Grant]) -> list[str]:
    """A line a share: the worst fall, and what was refused."""
    lines = []
    for share in sorted({grant.share for grant in grants}):
        mine = [grant for grant in grants if grant.share == share]
        taken = [grant for grant in mine if grant.began_s is not None]
        worst = max(taken, key=lambda grant: grant.fall_m, default=None)
        fall = "       -" if worst is None else f"{worst.fall_m:5.2f} m (seed {worst.seed})"
        reason = next((grant.texts[-1] for grant in mine if grant.began_s is None and grant.texts), "")
        lines.append(f"{name:10} x{share:<4g} {len(taken)}/{len(mine)} taken, worst fall {fall}  {reason}")
    return lines


def bar(name: str, grants: Sequence[Grant]) -> Bar:
    """The bar on the worst fall; control has to have been taken somewhere."""
    worst_m = max((g.fall_m for g in grants if g.began_s is not None), default=float("inf"))
    return at_most(f"{name} fall at the grant", worst_m, MOST_FALL_M, "m", 2)


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, print the table, and say which bars hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--arducopter", type=Path, help="the program arducopter")
    parser.add_argument("--only-firmware", action="store_true", help="without the bundled behaviour")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--shares", type=float, nargs="+", default=SHARES, help="true over told")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(arguments)
    report = BenchReport()
    flown: list[tuple[str, FirmwareSpec | None]] = [] if options.only_firmware else [("bundled", None)]
    if options.arducopter is not None:
        flown.append(("ArduCopter", FirmwareSpec.of("ardupilot", options.arducopter)))
    flights = list(product(options.shares, range(options.first, options.first + options.seeds)))
    bars = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for name, firmware in flown:
            grants = []
            for grant in pool.map(partial(fly, firmware), flights):
                grants.append(grant)
                (text,) = rows(name, [grant])
                report.show(f"{len(grants)}/{len(flights)} {text}")
            for text in rows(name, grants):
                report.show(text)
            bars.append(bar(name, grants))
    return report.judge(bars)
