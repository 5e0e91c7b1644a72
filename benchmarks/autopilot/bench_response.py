"""How an autopilot answers setpoints, beside what the vehicle's file says of it.

    python -m benchmarks response --px4 BIN --arducopter BIN

Flies jumps at random (`response_flight`) on the real firmware in lockstep, or without BIN on the bundled
autopilots. A dead time, a second order and the gains of acceleration and velocity are fitted to the tilt that
truly followed, along down to the acceleration. What the file has of integrals is by the parameters.
"""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from rich.table import Table
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.geometry import (
    GRAVITY_M_S2,
    FloatArray,
    horizontal_acceleration,
    quat_rotate,
    vector3,
    yaw_from_quat,
)
from companion.base.messages import Action, ActionKind, Setpoint
from companion.config import ControlConfig, Kind, LinkConfig, VehicleConfig, find_file, load_model
from companion.control.setpoints import Heading, attitude_setpoint
from companion.link.actions.actions import PymavlinkActions
from companion.link.session import Session
from companion.link.transport import memory_pair
from sitl.firmware.spec import FirmwareSpec
from sitl.pad.paths import Meeting, StaticMotion
from sitl.run.in_process import InProcess
from sitl.scenario.scenario import PadSettings, Scenario
from sitl.world.world import World
from tests.beside import beside

SMOKE: Final = ()
FINER: Final = 4  # dead times fall between rows
SETTLING_ROWS: Final = 240
KINDS: Final[dict[AutopilotKind, tuple[Kind, ...]]] = {
    "px4": ("acceleration", "attitude"),
    "ardupilot": ("attitude", "velocity"),
}
DOWN: Final = 2
HEADING: Final = 3


def answer(command: FloatArray, period_s: float, dead_time_s: float, w: float, zeta: float) -> FloatArray:
    """A held command after a dead time and at second order; it begins settled."""
    step_s = period_s / FINER
    fine = np.repeat(command, FINER)
    rows = np.arange(len(fine)) - dead_time_s / step_s
    late = np.interp(rows, np.arange(len(fine)), fine)
    b, a, _ = cont2discrete(([w * w], [1.0, 2.0 * zeta * w, w * w]), step_s, "zoh")
    flown: FloatArray = lfilter(b[0], a, late, zi=lfilter_zi(b[0], a) * late[0])[0][::FINER]
    return flown


def smoothed(column: FloatArray) -> FloatArray:
    """Without most of the rotors' vibration; what is compared is smoothed alike."""
    mean: FloatArray = np.convolve(column, np.ones(9) / 9.0, "same")
    return mean


def fit(columns: list[FloatArray], flown: FloatArray, free: list[FloatArray], period_s: float) -> list[float]:
    """Dead time (s), frequency (rad/s), damping, share explained, and the gains of all columns.

    `columns` pass the response, `free` (what counts at once: drag, a bias) do not; gains enter linearly.
    """

    def parts(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        dead_time_s, w, zeta = np.abs(x)
        basis = [smoothed(answer(column, period_s, dead_time_s, w, zeta)) for column in columns]
        stacked = np.column_stack([*basis, *free, np.ones(len(flown))])[SETTLING_ROWS:]
        gains = np.asarray(np.linalg.lstsq(stacked, flown[SETTLING_ROWS:], rcond=None)[0], dtype=np.float64)
        left: FloatArray = flown[SETTLING_ROWS:] - stacked @ gains
        return gains, left

    starts = [(0.03, 12.0, 0.7), (0.015, 45.0, 1.0), (0.12, 25.0, 1.0)]
    found = [
        least_squares(lambda x: parts(x)[1], start, x_scale=(0.03, 5.0, 0.3), ftol=1e-6) for start in starts
    ]
    best = min(found, key=lambda each: float(each.cost))
    gains, left = parts(best.x)
    explained = 1.0 - float(np.std(left) / np.std(flown[SETTLING_ROWS:]))
    return [*np.abs(best.x).tolist(), explained, *gains[: len(columns)].tolist()]


def along(record: AnswerRecord, axis: int, kind: Kind) -> list[float]:
    """The fit along one axis while it was excited."""
    rows = record.axis == axis
    period_s = float(np.median(np.diff(record.time_s)))
    if axis == HEADING:
        return fit([record.command_heading_rad[rows]], np.unwrap(record.heading_rad[rows]), [], period_s)
    a, v = record.command_acceleration_m_s2[rows, axis], record.command_velocity_m_s[rows, axis]
    speed = record.velocity_m_s[rows, axis]
    heard = kind == "velocity" or (axis == DOWN and kind != "attitude")
    flown = (record.acceleration_m_s2 if axis == DOWN else record.tilt_m_s2)[rows, axis]
    free = [smoothed(speed)] if axis == DOWN else []
    return fit([a, v - speed] if heard else [a], smoothed(flown), free, period_s)


def rows_of(
    vehicle: VehicleConfig, autopilot_kind: AutopilotKind, kind: Kind, record: AnswerRecord
) -> list[list[str]]:
    """Found beside what is believed."""
    believed, rows = vehicle.responses.of(autopilot_kind, kind), []
    for name, axis in (("north", 0), ("east", 1), ("down", DOWN)):
        response = believed.down if axis == DOWN else believed.sideways
        dead_s, w, zeta, explained, *gains = along(record, axis, kind)
        rows.append(
            [
                f"{autopilot_kind} {kind} {name}",
                f"{dead_s:.3f} ({response.dead_time_s:.3f})",
                f"{w:.1f} ({response.frequency_rad_s:.1f})",
                f"{zeta:.2f} ({response.damping:.2f})",
                f"{dead_s + 2.0 * zeta / w:.3f} ({response.delay_s:.3f})",
                f"{gains[0]:.2f} ({response.gain:.2f})",
                f"{gains[1]:.2f} ({response.velocity_gain_1_s:.2f})" if len(gains) > 1 else "",
                f"{100.0 * explained:.0f} %",
            ]
        )
    dead_s, w, zeta, explained, gain = along(record, HEADING, kind)
    found = (f"{dead_s:.3f}", f"{w:.1f}", f"{zeta:.2f}", f"{dead_s + 2.0 * zeta / w:.3f}", f"{gain:.2f}")
    rows.append([f"{autopilot_kind} {kind} heading", *found, "", f"{100.0 * explained:.0f} %"])
    return rows


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, fit and show."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--px4", type=Path, help="the program px4")
    parser.add_argument("--arducopter", type=Path, help="the program arducopter")
    parser.add_argument("--vehicle", default="x500", help="the airframe, and whose file to hold it against")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    vehicle = load_model(VehicleConfig, find_file("vehicles", options.vehicle))
    programs: dict[AutopilotKind, Path | None] = {"px4": options.px4, "ardupilot": options.arducopter}
    alone = any(programs.values())
    shown = Table(title=f"{options.vehicle}: found (believed)")
    for heading in ("", "dead time s", "frequency rad/s", "damping", "delay s", "gain", "K 1/s", "explained"):
        shown.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for autopilot_kind, path in programs.items():
        spec = FirmwareSpec.of(autopilot_kind, path) if path else None
        for kind in KINDS[autopilot_kind] if spec or not alone else ():
            record = fly(autopilot_kind, options.vehicle, kind, options.seed, spec)
            for cells in rows_of(vehicle, autopilot_kind, kind, record):
                shown.add_row(*cells)
    report = BenchReport()
    report.show(shown)
    return report


# ---------------------------------------------------------------- response flight
# Identification flights: setpoints that jump at random, into the real firmware or a bundled autopilot.
#
# The vehicle is flown up, then sent setpoints of one kind: along each axis in turn the acceleration, and the
# velocity where the kind has one, jumps at random about what keeps the vehicle near its place. What it truly
# does is recorded beside. In virtual time, calm air, no camera. NED, SI units.

PERIOD_S: Final = 1.0 / ControlConfig().rate_hz
SAMPLES_PER_SETPOINT: Final = 4
EACH_AXIS_S: Final = 60.0
HEIGHT_M: Final = 12.0
READY_S: Final = 90.0
# jumps: how large, and how long each lasts, at random
ACCELERATION_M_S2: Final = 1.2
VELOCITY_M_S: Final = 0.5
YAW_RAD: Final = 0.3
HOLDS_S: Final = (0.15, 1.2)
# kept near its place by truth, so slowly that it does not matter to what is found
DAMPING_1_S: Final = 0.6
PULL_1_S2: Final = 0.15
AXES: Final = ("north", "east", "down", "heading")


@dataclass(frozen=True)
class AnswerRecord:
    """Rows at even times: what was sent last by then, and how the vehicle moved; `axis` (n,) is excited."""

    time_s: FloatArray
    axis: FloatArray
    command_velocity_m_s: FloatArray
    command_acceleration_m_s2: FloatArray
    command_heading_rad: FloatArray
    velocity_m_s: FloatArray
    acceleration_m_s2: FloatArray
    tilt_m_s2: FloatArray
    heading_rad: FloatArray


def fly(
    autopilot_kind: AutopilotKind, airframe: str, kind: Kind, seed: int, firmware: FirmwareSpec | None = None
) -> AnswerRecord:
    """One flight.

    Raises:
        RuntimeError: it does not get into the air.
    """
    scenario = Scenario(
        name="response",
        description="calm air, the pad far away",
        autopilot=autopilot_kind,
        airframe=airframe,
        start_heading_deg=0.0,
        pad=PadSettings(motion=StaticMotion(kind="static", meet=Meeting(point_ned_m=(200.0, 200.0)))),
    )
    return run_in_virtual_time(_flown(scenario, kind, seed, firmware))


async def _flown(scenario: Scenario, kind: Kind, seed: int, firmware: FirmwareSpec | None) -> AnswerRecord:
    app_end, vehicle_end = memory_pair()
    vehicle = InProcess(scenario, seed, link=vehicle_end, firmware=firmware)
    vehicle.wants_frames = False
    session = Session(LinkConfig(system_id=0))
    clock = Clock()
    actions = PymavlinkActions(
        session, app_end.write, clock, LinkConfig(set_parameters=True), attitude_setpoints=kind == "attitude"
    )

    async def listen() -> None:
        while True:
            session.receive(await app_end.read(), clock.now_s())

    async def beat() -> None:
        while True:
            app_end.write(session.tick(clock.now_s()))
            await asyncio.sleep(0.05)

    with closing(vehicle.simulation) as simulation:
        async with beside(simulation.run(), listen(), beat()):
            world = simulation.world
            sender = _Sender(world, session, app_end.write, clock, kind, seed)
            await _take_off(actions, sender, world, clock)
            return await sender.excite()


async def _take_off(actions: PymavlinkActions, sender: _Sender, world: World, clock: Clock) -> None:
    for _ in range(round(READY_S)):
        await asyncio.sleep(1.0)
        if (await actions.perform(Action(ActionKind.ARM))).accepted:
            break
    result = await actions.perform(Action(ActionKind.TAKE_OFF, height_m=HEIGHT_M))
    if not result.accepted:
        raise RuntimeError(f"no take-off: {result.text}")
    for _ in range(60):
        await asyncio.sleep(1.0)
        if world.state.position_ned_m[2] < -0.8 * HEIGHT_M:
            break
    # PX4 wants to hear setpoints before it obeys
    wait = asyncio.create_task(actions.perform(Action(ActionKind.TAKE_CONTROL)))
    while not wait.done():
        await sender.send_still()
    if not wait.result().accepted:
        raise RuntimeError(f"no control: {wait.result().text}")


class _Jumps:
    """A level that jumps to another at random times."""

    def __init__(self, rng: np.random.Generator, size: float) -> None:
        self._rng, self._size, self._until_s, self._level = rng, size, 0.0, 0.0

    def at(self, time_s: float) -> float:
        if time_s >= self._until_s:
            self._until_s = time_s + float(self._rng.uniform(*HOLDS_S))
            self._level = self._size * float(self._rng.uniform(-1.0, 1.0))
        return self._level


class _Sender:
    def __init__(
        self,
        world: World,
        session: Session,
        write: Callable[[bytes], None],
        clock: Clock,
        kind: Kind,
        seed: int,
    ) -> None:
        self._world, self._session, self._write, self._clock = world, session, write, clock
        self._kind = kind
        rng = np.random.default_rng((seed, 40))
        self._acceleration, self._velocity = _Jumps(rng, ACCELERATION_M_S2), _Jumps(rng, VELOCITY_M_S)
        self._heading = _Jumps(rng, YAW_RAD)
        self._hover_thrust = world.airframe.body.hover_share()
        self._place = np.array([0.0, 0.0, -HEIGHT_M])
        self._due_s = clock.now_s()
        self._rows: list[list[float]] = []

    async def send_still(self) -> None:
        """A setpoint without jumps."""
        await self._send(None)

    async def excite(self) -> AnswerRecord:
        """Jump along each axis in turn."""
        self._place = np.array(self._world.state.position_ned_m)
        for axis in range(len(AXES)):
            end_s = self._clock.now_s() + EACH_AXIS_S
            while self._clock.now_s() < end_s:
                await self._send(axis)
        rows = np.array(self._rows)
        cut = np.split(rows, [1, 2, 5, 8, 9, 12, 15, 18], axis=1)
        return AnswerRecord(*(part[:, 0] if part.shape[1] == 1 else part for part in cut))

    async def _send(self, axis: int | None) -> None:
        now_s, state = self._clock.now_s(), self._world.state
        away = np.array(state.position_ned_m) - self._place
        v = np.array(state.velocity_ned_m_s)
        a = -DAMPING_1_S * v - PULL_1_S2 * away
        v_sp = -PULL_1_S2 * away
        if self._kind == "velocity":
            a[:2] = 0.0
        if self._kind != "attitude":
            a[2] = 0.0
        heading_rad = 0.0
        if axis is not None and axis < 3:
            a[axis] += self._acceleration.at(now_s)
            if self._kind == "velocity" or (axis == 2 and self._kind == "acceleration"):
                v_sp[axis] += self._velocity.at(now_s)
        elif axis == 3:
            heading_rad = self._heading.at(now_s)
        self._write(self._session.send_setpoint(self._setpoint(now_s, v_sp, a, heading_rad), now_s))
        for part in range(SAMPLES_PER_SETPOINT):
            await self._clock.sleep_until(self._due_s + part * PERIOD_S / SAMPLES_PER_SETPOINT)
            if axis is not None:
                self._note(axis, v_sp, a, heading_rad)
        self._due_s += PERIOD_S
        await self._clock.sleep_until(self._due_s)

    def _setpoint(self, now_s: float, v: FloatArray, a: FloatArray, heading_rad: float) -> Setpoint:
        velocity, acceleration = vector3(v.tolist()), vector3(a.tolist())
        if self._kind == "attitude":
            return attitude_setpoint(now_s, velocity, acceleration, self._hover_thrust, Heading(heading_rad))
        return Setpoint(
            time_s=now_s,
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=acceleration,
            heading_rad=heading_rad,
            holds_horizontal_velocity=self._kind == "velocity",
        )

    def _note(self, axis: int, v_sp: FloatArray, a_sp: FloatArray, heading_rad: float) -> None:
        state = self._world.state
        x, y, z = quat_rotate(state.attitude, state.specific_force_body_m_s2)
        yaw = yaw_from_quat(state.attitude)
        tilt = horizontal_acceleration(state.attitude)
        flown = (*state.velocity_ned_m_s, x, y, z + GRAVITY_M_S2, *tilt, 0.0, yaw)
        self._rows.append([self._clock.now_s(), axis, *v_sp, *a_sp, heading_rad, *flown])
