"""Flies a vehicle through `response_plan`, by a MAVLink client on the simulation's own virtual loop.

Real firmware in lockstep or a bundled autopilot: the same client, the same bytes, the same world. What was
asked for and what the world says was flown are sampled together. NED, SI units.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from companion.clock import run_in_virtual_time
from companion.geometry import FloatArray, Quaternion, euler_from_quat, quat_from_euler
from companion.messages import Manner
from sitl.firmware.spec import FirmwareSpec
from sitl.framing import dialect
from sitl.in_process import InProcess
from sitl.pad_paths import Meeting, StaticMotion
from sitl.scenario import PadSettings, Scenario
from tests.bench.response_plan import SETTLE_S, Group, Kind, Run, groups

mavlink: Any = dialect

SETPOINT_S: Final = 1.0 / 30.0
SAMPLE_S: Final = 0.01
HEIGHT_M: Final = 12.0
READY_S: Final = 60.0
CLIMB_S: Final = 30.0
HOVER_THRUST: Final = 0.5
GUIDED, OFFBOARD = 4, 6
_POSITION, _HORIZONTAL_VELOCITY, _ACCELERATION = 0b111, 0b11000, 0b111000000
_RATES: Final = 0b111
# height kept while leans are asked for: thrust shares for a metre, and for a metre per second
_HEIGHT_GAIN, _CLIMB_GAIN = 0.05, 0.1


@dataclass(frozen=True)
class Flown:
    """One run: `asked` and `flown` at `SAMPLE_S`; a sine's frequency (Hz), None otherwise."""

    asked: FloatArray
    flown: FloatArray
    frequency_hz: float | None


class _Client:
    """One end of the MAVLink line."""

    def __init__(self, vehicle: InProcess, manner: Manner) -> None:
        self._simulation = vehicle.simulation
        self._mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=191)
        self._decoder = mavlink.MAVLink(None)
        self._port = vehicle.simulation.connect(self._hear, datagrams=True)
        self.manner = manner
        self.armed, self.mode = False, -1
        self.texts: list[str] = []

    def _hear(self, frames: Sequence[bytes]) -> None:
        for frame in frames:
            for message in self._decoder.parse_buffer(bytearray(frame)) or ():
                self._take(message)

    def _take(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            self.mode = message.custom_mode
        elif kind == "STATUSTEXT":
            self.texts.append(message.text)

    def send(self, message: Any) -> None:
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        self._simulation.hear(self._port, data)

    def command(self, command: int, *values: float) -> None:
        padded = (*values, *(0.0,) * (7 - len(values)))
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, *padded))

    def beat(self) -> None:
        self.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3))

    def motion(
        self, mask: int, velocity: Sequence[float], acceleration: Sequence[float], yaw: float, yaw_rate: float
    ) -> None:
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, mavlink.MAV_FRAME_LOCAL_NED, _POSITION | mask, 0, 0, 0,
                *velocity, *acceleration, yaw, yaw_rate,
            )
        )  # fmt: skip

    def attitude(self, attitude: Quaternion, thrust: float) -> None:
        self.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, _RATES, attitude, 0, 0, 0, thrust))


class ResponseFlight:
    """One autopilot through all its groups."""

    def __init__(self, manner: Manner, firmware: FirmwareSpec | None, seed: int) -> None:
        """Inside a running loop; a firmware is started and boots here."""
        pad = PadSettings(motion=StaticMotion(kind="static", meet=Meeting(point_ned_m=(500.0, 500.0))))
        scenario = Scenario(
            name="response",
            description="calm air, the pad far away",
            autopilot=manner,
            start_heading_deg=0.0,
            pad=pad,
        )
        self.vehicle = InProcess(scenario, seed, firmware=firmware)
        self.vehicle.wants_frames = False
        self._world = self.vehicle.simulation.world
        self._client = _Client(self.vehicle, manner)
        self._level_m = -HEIGHT_M
        self._asked = 0.0
        self._kind: Kind = "velocity"

    async def fly(self, chosen: Sequence[Group]) -> dict[str, list[Flown]]:
        """Take off, and fly all runs."""
        loop = asyncio.get_running_loop()
        tasks = [loop.create_task(self.vehicle.simulation.run()), loop.create_task(self._beat())]
        try:
            await self._take_off()
            return {group.name: [await self._run(group.kind, run) for run in group.runs] for group in chosen}
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
            self.vehicle.simulation.close()

    async def _beat(self) -> None:
        while True:
            self._client.beat()
            await asyncio.sleep(1.0)

    # ------------------------------------------------------------ take-off

    async def _take_off(self) -> None:
        client, by_setpoint = self._client, self._client.manner == "px4"
        await self._until(lambda: client.armed, READY_S, self._ask_to_arm)
        if by_setpoint:
            await self._until(self._is_high, CLIMB_S, lambda: self._move((0.0, 0.0, -1.0)))
        else:
            client.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, HEIGHT_M)
            await self._until(self._is_high, CLIMB_S, lambda: None)
        await self._settle()

    def _ask_to_arm(self) -> None:
        client, now_s = self._client, asyncio.get_running_loop().time()
        self._move((0.0, 0.0, 0.0))
        if now_s % 1.0 >= SETPOINT_S:
            return
        if client.manner == "px4":
            client.command(mavlink.MAV_CMD_DO_SET_MODE, 1, OFFBOARD)
        else:
            client.send(mavlink.MAVLink_param_set_message(1, 1, b"GUID_OPTIONS", 8.0, 4))
            client.command(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED)
        client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def _is_high(self) -> bool:
        return -self._world.state.position_ned_m[2] > HEIGHT_M - 0.5

    async def _until(self, holds: Any, limit_s: float, act: Any) -> None:
        loop = asyncio.get_running_loop()
        end_s = loop.time() + limit_s
        while not holds():
            if loop.time() > end_s:
                raise RuntimeError(f"{self._client.manner} does not take off: {self._client.texts[-5:]}")
            act()
            await asyncio.sleep(SETPOINT_S)

    def _move(self, velocity: Sequence[float]) -> None:
        self._client.motion(_ACCELERATION, velocity, (0.0, 0.0, 0.0), 0.0, 0.0)

    # ------------------------------------------------------------ runs

    async def _settle(self) -> None:
        loop = asyncio.get_running_loop()
        end_s = loop.time() + SETTLE_S
        while loop.time() < end_s:
            self._move((0.0, 0.0, 0.0))
            await asyncio.sleep(SETPOINT_S)

    async def _run(self, kind: Kind, run: Run) -> Flown:
        """One run: setpoints at their own rate, samples of both sides at theirs."""
        await self._settle()
        loop = asyncio.get_running_loop()
        self._level_m, begun_s = self._world.state.position_ned_m[2], loop.time()
        sampler = loop.create_task(self._sample(kind, begun_s + run.duration_s))
        while (t := loop.time() - begun_s) < run.duration_s:
            self._asked = run.signal(t)
            self._send(kind, run, t)
            await asyncio.sleep(SETPOINT_S)
        asked, flown = await sampler
        if kind in ("acceleration", "both"):
            flown = np.gradient(flown, SAMPLE_S)
        return Flown(asked, np.unwrap(flown) if kind == "yaw" else flown, run.frequency_hz)

    async def _sample(self, kind: Kind, end_s: float) -> tuple[FloatArray, FloatArray]:
        loop, rows = asyncio.get_running_loop(), []
        await asyncio.sleep(0.5 * SAMPLE_S)
        while loop.time() < end_s:
            rows.append((self._asked, self._flown(kind)))
            await asyncio.sleep(SAMPLE_S)
        table = np.array(rows)
        return table[:, 0], table[:, 1]

    def _flown(self, kind: Kind) -> float:
        state = self._world.state
        roll, pitch, yaw = euler_from_quat(state.attitude)
        north, _, down = state.velocity_ned_m_s
        return {"roll": roll, "pitch": pitch, "yaw": yaw, "climb": down}.get(kind, north)

    def _send(self, kind: Kind, run: Run, t: float) -> None:
        client, value, still = self._client, run.signal(t), (0.0, 0.0, 0.0)
        match kind:
            case "roll" | "pitch":
                roll, pitch = (value, 0.0) if kind == "roll" else (0.0, value)
                client.attitude(quat_from_euler(roll, pitch, 0.0), self._thrust(value))
            case "acceleration":
                client.motion(_HORIZONTAL_VELOCITY, still, (value, 0.0, 0.0), 0.0, 0.0)
            case "both":
                client.motion(0, (run.integral(t), 0.0, 0.0), (value, 0.0, 0.0), 0.0, 0.0)
            case "velocity":
                self._move((value, 0.0, 0.0))
            case "climb":
                self._move((0.0, 0.0, value))
            case "yaw":
                client.motion(_ACCELERATION, still, still, value, run.rate(t))

    def _thrust(self, lean_rad: float) -> float:
        """That keeps the height, by what the world says; ArduPilot divides by the lean's cosine itself."""
        state = self._world.state
        sunk, down = state.position_ned_m[2] - self._level_m, state.velocity_ned_m_s[2]
        thrust = HOVER_THRUST + _HEIGHT_GAIN * sunk + _CLIMB_GAIN * down
        return thrust / math.cos(lean_rad) if self._client.manner == "px4" else thrust


def fly(
    manner: Manner, firmware: FirmwareSpec | None, seed: int, chosen: Sequence[Group] | None = None
) -> dict[str, list[Flown]]:
    """All runs by group; None: the bundled autopilot."""

    async def flight() -> dict[str, list[Flown]]:
        return await ResponseFlight(manner, firmware, seed).fly(chosen or groups(manner))

    return run_in_virtual_time(flight())
