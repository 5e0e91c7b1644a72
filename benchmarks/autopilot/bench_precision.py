"""The autopilots' own precision landing on what the app sees: `control.output: landing_target`.

    python -m benchmarks precision --runs 5
    python -m benchmarks precision --px4 BIN --arducopter BIN --case line --runs 5

An operator flies the vehicle over the pad at 8 m with the pad's speed and then says LAND (PX4: precision
landing), or RTL where the case says so. From then on the autopilot is alone with LANDING_TARGET: of the app,
which sees rendered frames and flies nothing, or, with `--targets truth`, from the truth with 1 cm + 1 % of
noise, 30 Hz, 100 ms late, as long as the pad is in the 62 x 48 deg view of a camera fixed to the body.
Without BIN the bundled autopilots fly. `--lead` is `control.target_lead_s`.
Landed: within 15 cm, 0.5 m/s down and 0.3 m/s sideways relative to the pad, 8 deg of tilt, at rest, disarmed.
Virtual time.
"""

from __future__ import annotations

import argparse
import asyncio
import math
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final, Literal

import numpy as np
from rich.table import Table

from benchmarks.in_process import app_and_vehicle
from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from companion.base.clock import run_in_virtual_time
from companion.base.geometry import (
    IDENTITY,
    Vector3,
    add,
    norm,
    quat_conjugate,
    quat_rotate,
    subtract,
)
from companion.base.messages import Outcome, Phase
from companion.config import CONFIG_FOLDER
from companion.flightlog.record import FlightLog
from companion.link.codec import Codec, mavlink
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.firmware.spec import FirmwareSpec
from sitl.run.in_process import InProcess
from sitl.run.simulation import Simulation
from sitl.scenario.scenario import PassBounds, Scenario
from sitl.world.score import judge
from tests.beside import beside

SMOKE: Final = ("--runs", "1", "--autopilot_kind", "ardupilot", "--case", "line 1")
Targets = Literal["camera", "truth"]
TARGET_PERIOD_S: Final = 1.0 / 30.0
TARGET_LATE_S: Final = 0.1
HALF_VIEW_RAD: Final = (math.radians(24.0), math.radians(31.0))  # forward, sideways
HEIGHT_M: Final = 8.0
OVER_PAD_M: Final = 0.3
OVER_PAD_S: Final = 3.0  # so long before it is told to land: the pad is seen, and ArduPilot's filter begins
LOOK_S: Final = 0.05
READY_LIMIT_S: Final = 90.0
LANDING_LIMIT_S: Final = 60.0
FOLLOW_GAIN_1_S: Final = 0.8
_NO_PLACE_NO_YAW: Final = 0b110000000111
NAV_PRECLAND: Final = 23
BOUNDS: Final = PassBounds(
    lateral_error_m=0.15, vertical_speed_m_s=0.5, horizontal_speed_m_s=0.3, tilt_deg=8.0
)
PARAMETERS: Final[dict[AutopilotKind, dict[str, float]]] = {
    # PLND_OPTIONS 1: targets move; PLND_LAG: from the exposure to the message; RTL_ALT: as it flies already
    "ardupilot": {
        "PLND_ENABLED": 1,
        "PLND_TYPE": 1,
        "PLND_OPTIONS": 1,
        "PLND_LAG": TARGET_LATE_S,
        "RTL_ALT": 100.0 * HEIGHT_M,
    },
    # MPC_LAND_SPEED: its default of 0.7 m/s is a hard contact
    "px4": {"RTL_PLD_MD": 2, "RTL_RETURN_ALT": HEIGHT_M, "MPC_LAND_SPEED": 0.4},
}
# landed, and the lateral median, of the real firmware on targets from the truth
IDEAL: Final[dict[AutopilotKind, dict[str, str]]] = {
    "ardupilot": {"line": "100 %, 1-2 cm", "turn": "0 % (0.56 m lag)", "wind": "20-60 %"},
    "px4": {"line": "0 %", "turn": "0 %", "wind": "0 %"},
}


@dataclass(frozen=True, slots=True)
class PrecisionCase:
    """A pad's motion and the wind; `by_rtl`: it is told to return, and the pad is beside home."""

    name: str
    kind: str
    motion: dict[str, Any]
    wind_m_s: float = 0.0
    by_rtl: bool = False


def line(speed_m_s: float) -> dict[str, Any]:
    """A straight pad, or one that stands."""
    return {"kind": "line", "speed_m_s": speed_m_s} if speed_m_s else {"kind": "static"}


CASES: Final = (
    *(PrecisionCase(f"line {v:g} m/s", "line" if v else "static", line(v)) for v in (0.0, 0.5, 1.0, 2.0)),
    PrecisionCase("circle 5 m, 1.5 m/s", "turn", {"kind": "circle", "speed_m_s": 1.5, "radius_m": 5.0}),
    PrecisionCase("figure 8, 2 m/s", "turn", {"kind": "figure_8", "speed_m_s": 2.0, "half_length_m": 8.0}),
    *(PrecisionCase(f"wind 8 m/s, line {v:g} m/s", "wind", line(v), 8.0) for v in (0.0, 1.0)),
    PrecisionCase("rtl, pad at home", "static", line(0.0), by_rtl=True),
)


@dataclass(frozen=True, slots=True)
class PrecisionLandingResult:
    """How one went; the numbers are NaN without a touchdown. `targets`: how many were sent.

    `failures`: why it was no landing.
    """

    landed: bool
    lateral_m: float
    vertical_m_s: float
    seconds: float
    targets: int
    failures: tuple[str, ...] = ()


class Operator:
    """The ground station: knows the truth, flies the vehicle over the pad, and says when to land."""

    def __init__(self, simulation: Simulation, kind: AutopilotKind, case: PrecisionCase) -> None:
        self._simulation, self._kind, self._case = simulation, kind, case
        self._us = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        wanted = (mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
        self._reader = Codec(255, 190, wanted)
        self._system = 0
        self.armed = False
        self.own_position_m: Vector3 | None = None
        self._port = simulation.line.connect(self._hear, datagrams=False)

    def _hear(self, frames: Sequence[bytes]) -> None:
        for message in self._reader.decode(b"".join(frames)):
            if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1:
                continue
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self._system = message.get_srcSystem()
                self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            else:
                self.own_position_m = (message.x, message.y, message.z)

    def send(self, message: Any) -> None:
        """As bytes over the link."""
        self._simulation.line.receive(self._port, bytes(message.pack(self._us)))

    def command(self, number: int, *parameters: float) -> None:
        """COMMAND_LONG; parameters that are not given have no value."""
        filled = (*parameters, *(math.nan,) * (7 - len(parameters)))
        self.send(mavlink.MAVLink_command_long_message(self._system, 1, number, 0, *filled))

    async def take_off(self) -> None:
        """Arm and climb to the height."""
        await _until(lambda: bool(self._system))
        ardupilot = self._kind == "ardupilot"
        over_sea = self._simulation.home[2]
        heights = 0.0 if ardupilot else over_sea
        interval = (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 33_333.0, 0, 0, 0, 0, 0)
        self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, *interval)
        while not self.armed:
            if ardupilot:
                self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 0, 0, 0, 0, 0)
            self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, 0, 0, 0, 0, 0, 0)
            await asyncio.sleep(1.0)
        place = (0.0,) * 6 if ardupilot else (math.nan,) * 6
        self.command(mavlink.MAV_CMD_NAV_TAKEOFF, *place, heights + HEIGHT_M)
        await _until(lambda: -self._simulation.world.state.position_ned_m[2] > 0.9 * HEIGHT_M)
        await asyncio.sleep(2.0)

    async def meet_pad(self, frames: Any) -> None:
        """Fly over the pad and along with it, until that has gone well for a while; `frames` from then on."""
        good_s, ticks = 0.0, 0
        while good_s < OVER_PAD_S:
            self._follow_pad()
            if ticks == 20 and self._kind == "px4":
                self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 6, 0, 0, 0, 0, 0)
            state, pad = self._simulation.world.state, self._simulation.world.pad_state
            away = subtract(state.position_ned_m, pad.position_ned_m)
            slip = subtract(state.velocity_ned_m_s, pad.velocity_ned_m_s)
            over = math.hypot(away[0], away[1]) < OVER_PAD_M and norm(slip) < OVER_PAD_M
            good_s = good_s + LOOK_S if over and ticks > 40 else 0.0
            frames.wants_frames = frames.wants_frames or good_s > 0.0
            ticks += 1
            await asyncio.sleep(LOOK_S)

    def land(self) -> None:
        """Say so, once."""
        if self._case.by_rtl:
            mode = (1, 6, 0) if self._kind == "ardupilot" else (1, 4, 5)
            self.command(mavlink.MAV_CMD_DO_SET_MODE, *mode, 0, 0, 0, 0)
        elif self._kind == "ardupilot":
            self.command(mavlink.MAV_CMD_NAV_LAND, *(0.0,) * 7)
        else:
            self.command(NAV_PRECLAND)

    def _follow_pad(self) -> None:
        """The pad's velocity and acceleration, and what brings it over the pad, by the truth."""
        world = self._simulation.world
        north, east, down = subtract(world.pad_state.position_ned_m, world.state.position_ned_m)
        towards = (FOLLOW_GAIN_1_S * v for v in _bounded((north, east, down - HEIGHT_M)))
        velocity = add(world.pad_state.velocity_ned_m_s, (next(towards), next(towards), next(towards)))
        acceleration = world.pad_state.acceleration_ned_m_s2
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, self._system, 1, mavlink.MAV_FRAME_LOCAL_NED, _NO_PLACE_NO_YAW,
                0.0, 0.0, 0.0, *velocity, *acceleration, 0.0, 0.0,
            )
        )  # fmt: skip


async def _until(holds: Callable[[], bool]) -> None:
    while not holds():  # noqa: ASYNC110 - the truth tells nobody of a change
        await asyncio.sleep(LOOK_S)


def _bounded(v: Vector3, most: float = 3.0) -> Vector3:
    share = min(1.0, most / max(norm(v), 1e-9))
    return (v[0] * share, v[1] * share, v[2] * share)


class TruthTargets:
    """Sees the pad at 30 Hz by the truth, and tells of it 100 ms later."""

    def __init__(self, operator: Operator, simulation: Simulation, kind: AutopilotKind, seed: int) -> None:
        self._operator, self._simulation, self._kind = operator, simulation, kind
        self._rng = np.random.default_rng((seed, 77))
        self._late: deque[Any] = deque()
        self.count = 0

    async def run(self) -> None:
        """Go on until cancelled."""
        delay = round(TARGET_LATE_S / TARGET_PERIOD_S)
        while True:
            await asyncio.sleep(TARGET_PERIOD_S)
            self._late.append(self._target())
            if len(self._late) > delay and (message := self._late.popleft()) is not None:
                self._operator.send(message)
                self.count += 1

    def _target(self) -> Any | None:
        state, pad = self._simulation.world.state, self._simulation.world.pad_state
        away = subtract(pad.position_ned_m, state.position_ned_m)
        x, y, z = quat_rotate(quat_conjugate(state.attitude), away)
        forward, sideways = HALF_VIEW_RAD
        if z <= 0.0 or abs(math.atan2(x, z)) > forward or abs(math.atan2(y, z)) > sideways:
            return None
        noise = ((0.01 + 0.01 * norm(away)) * self._rng.standard_normal(3)).tolist()
        seen: Vector3 = (x + noise[0], y + noise[1], z + noise[2])
        frame = mavlink.MAV_FRAME_BODY_FRD
        if self._kind == "px4":  # it takes places in its own NED alone
            if self._operator.own_position_m is None:
                return None
            seen = add(self._operator.own_position_m, quat_rotate(state.attitude, seen))
            frame = mavlink.MAV_FRAME_LOCAL_NED
        return mavlink.MAVLink_landing_target_message(
            0, 0, frame, 0.0, 0.0, norm(away), 0.0, 0.0, *seen, list(IDENTITY),
            mavlink.LANDING_TARGET_TYPE_VISION_FIDUCIAL, 1,
        )  # fmt: skip


def scenario_of(kind: AutopilotKind, case: PrecisionCase, lead_s: float) -> Scenario:
    """The pad meets the place where the vehicle comes to it; one to return to stands beside home."""
    place = [1.5, 1.0] if case.by_rtl else [10.0, 0.0]
    meet = {"point_ned_m": place, "time_s": 22.0, "spread_m": 0.0}
    return Scenario.model_validate(
        {
            "name": "bench",
            "description": case.name,
            "autopilot": kind,
            "pad": {"surface_height_m": 0.1, "motion": {**case.motion, "meet": meet}},
            "wind": {"mean_m_s": case.wind_m_s},
            "companion": {"control": {"output": "landing_target", "target_lead_s": lead_s}},
        }
    )


def fly(
    kind: AutopilotKind,
    case: PrecisionCase,
    seed: int,
    *,
    targets: Targets = "camera",
    lead_s: float = 0.0,
    program: Path | None = None,
    parameters: Sequence[str] = (),
) -> PrecisionLandingResult:
    """One flight: up, over the pad, and down by the autopilot's own means; the app flies nothing."""
    scenario = scenario_of(kind, case, lead_s)
    named = [f"{name}={value:g}" for name, value in PARAMETERS[kind].items()]
    spec = None if program is None else FirmwareSpec.of(kind, program, (*named, *parameters))
    return run_in_virtual_time(_fly(Trial(Path("bench.yaml"), scenario, seed, firmware=spec), case, targets))


async def _fly(trial: Trial, case: PrecisionCase, targets: Targets) -> PrecisionLandingResult:
    config = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    log = FlightLog(None, start_unix_s=0.0)
    app, vehicle = app_and_vehicle(trial, config, log, keep_truth=False)
    vehicle.wants_frames = False
    kind = trial.scenario.autopilot
    with closing(vehicle.simulation) as simulation, closing(log):
        if trial.firmware is None:
            for name, value in PARAMETERS[kind].items():
                simulation.autopilot.parameters.set(name, value)
            simulation.autopilot.reboot()
        operator = Operator(simulation, kind, case)
        truth = TruthTargets(operator, simulation, kind, trial.seed)
        telling = truth.run() if targets == "truth" else app.run()
        async with beside(simulation.run(), telling) as tasks:
            return await _operate(operator, vehicle, camera=targets == "camera", tasks=tasks)


async def _operate(
    operator: Operator, vehicle: InProcess, *, camera: bool, tasks: Sequence[asyncio.Task[Any]]
) -> PrecisionLandingResult:
    world, count = vehicle.simulation.world, _Count()
    vehicle.simulation.line.listeners.append(count.hear)
    try:
        async with asyncio.timeout(READY_LIMIT_S):
            await operator.take_off()
            sees = vehicle if camera else _Blind()
            await operator.meet_pad(sees)
    except TimeoutError:
        for task in tasks:
            if task.done():
                task.result()
        return PrecisionLandingResult(False, math.nan, math.nan, math.nan, count.targets)
    began_s = world.time_s
    operator.land()
    while operator.armed and world.time_s < began_s + LANDING_LIMIT_S:
        for task in tasks:
            if task.done():
                task.result()
        await asyncio.sleep(LOOK_S)
    await asyncio.sleep(1.0)
    verdict = judge(
        world.watch,
        BOUNDS,
        at_rest_on_pad=world.at_rest_on_pad,
        disarmed=not operator.armed,
        final_phase=Phase.LANDED,
    )
    touch = world.watch.touchdown
    if touch is None:
        return PrecisionLandingResult(False, math.nan, math.nan, math.nan, count.targets)
    return PrecisionLandingResult(
        verdict.outcome is Outcome.LANDED,
        touch.lateral_error_m,
        touch.vertical_speed_m_s,
        touch.time_s - began_s,
        count.targets,
        verdict.failures,
    )


class _Blind:
    """No camera is asked for."""

    wants_frames = False


class _Count:
    """Landing targets among what clients send."""

    def __init__(self) -> None:
        self.targets = 0
        self._codec = Codec(0, wanted=(mavlink.MAVLINK_MSG_ID_LANDING_TARGET,))

    def hear(self, data: bytes, _now_s: float) -> None:
        self.targets += len(self._codec.decode(data))


def row(
    autopilot: str, kind: AutopilotKind, case: PrecisionCase, landings: Sequence[PrecisionLandingResult]
) -> tuple[str, ...]:
    """A line of the table."""
    touched = [landing for landing in landings if not math.isnan(landing.lateral_m)]
    middles = ("-", "-", "-", "-")
    if touched:
        middles = (
            f"{100.0 * median(t.lateral_m for t in touched):.1f}",
            f"{100.0 * max(t.lateral_m for t in touched):.1f}",
            f"{median(t.vertical_m_s for t in touched):.2f}",
            f"{median(t.seconds for t in touched):.1f}",
        )
    landed = f"{sum(landing.landed for landing in landings)}/{len(landings)}"
    return (autopilot, case.name, landed, *middles, IDEAL[kind].get(case.kind, "not recorded"))


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly all cases for both autopilots and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=5, help="landings a case")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--autopilot_kind", choices=["ardupilot", "px4"], help="one alone")
    parser.add_argument("--case", default="", help="cases whose name begins so")
    parser.add_argument("--targets", choices=["camera", "truth"], default="camera")
    parser.add_argument("--lead", type=float, default=0.0, help="control.target_lead_s (s)")
    parser.add_argument("--px4", type=Path, help="the program px4; else the bundled one flies")
    parser.add_argument("--arducopter", type=Path, help="the program arducopter; else the bundled one flies")
    parser.add_argument("--param", action="append", default=[], help="NAME=VALUE, of the firmware")
    options = parser.parse_args(arguments)
    report = BenchReport(width=140)
    columns = ("autopilot", "case", "landed", "lateral cm p50", "worst", "down m/s p50", "seconds p50")
    table = Table(*columns, "ideal targets")
    programs: dict[AutopilotKind, Path | None] = {"px4": options.px4, "ardupilot": options.arducopter}
    kinds: tuple[AutopilotKind, ...] = ("ardupilot", "px4")
    if options.autopilot_kind:
        kinds = (options.autopilot_kind,)
    elif any(programs.values()):
        kinds = tuple(kind for kind in kinds if programs[kind])
    for kind in kinds:
        for case in (case for case in CASES if case.name.startswith(options.case)):
            landings = []
            for seed in range(options.first, options.first + options.runs):
                landing = fly(
                    kind,
                    case,
                    seed,
                    targets=options.targets,
                    lead_s=options.lead,
                    program=programs[kind],
                    parameters=options.param,
                )
                landings.append(landing)
                if not landing.landed:
                    print(f"seed {seed}: {'; '.join(landing.failures) or 'no touchdown'}", flush=True)
            name = kind if programs[kind] else f"{kind}, bundled"
            cells = row(name, kind, case, landings)
            table.add_row(*cells)
            print(*cells, sep="  ", flush=True)
    report.show(table)
    return report
