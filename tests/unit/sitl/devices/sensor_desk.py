"""A vehicle that stands in the air with all its sensors, heard through the app's own drivers."""

import asyncio
from collections.abc import Sequence
from typing import NamedTuple
from unittest.mock import Mock

import numpy as np

from companion.base.clock import Clock
from companion.base.geometry import GRAVITY_M_S2, Vector3, quat_from_euler
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import GpsConfig, ImuConfig, RangeConfig
from companion.sense.gps.neo6m import Neo6m
from companion.sense.imu.i2c import SensorError
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.range.ultrasonic import Ultrasonic
from sitl.devices.ports import MemoryPort
from sitl.devices.rack import SensorRack
from sitl.faults.faults import Fault
from sitl.faults.lines import FrameLine, LinkChannel, LinkSettings
from sitl.faults.schedule import FaultSchedule
from sitl.faults.targets import FaultTargets
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.quadrotor import Motors, QuadrotorState
from tests.virtual_time import in_virtual_time

STEP_S = 1.0 / 400.0
FORCE: Vector3 = (0.0, 0.0, -GRAVITY_M_S2)
HOME = (47.0, 8.0, 400.0)
FIELD_NED_UT = (20.9, 0.6, 42.9)


class DriverSamples(NamedTuple):
    """What the drivers made of it."""

    imu: list[ImuSample]
    mag: list[MagSample]
    fixes: list[GpsFix]
    echoes: list[RangeSample]
    problems: list[str]


class _Drivers:
    """The app's drivers on a rack's lines, and what they have made of it."""

    def __init__(self, rack: SensorRack, gps_line: MemoryPort, range_line: MemoryPort) -> None:
        self.heard = DriverSamples([], [], [], [], [])
        self._rack, self._gps_line, self._range_line = rack, gps_line, range_line
        self._clock = Clock()

    def start(self) -> list[asyncio.Task[None]]:
        """Let all of them read."""
        receiver = Neo6m(GpsConfig())
        return [
            asyncio.create_task(self._inertial(Mpu9250(self._rack.imu, ImuConfig()))),
            asyncio.create_task(self._position(receiver)),
            asyncio.create_task(self._configure(receiver)),
            asyncio.create_task(self._distance(Ultrasonic(RangeConfig()))),
        ]

    async def _inertial(self, driver: Mpu9250) -> None:
        for k in range(1_000_000):
            await self._clock.sleep_until(0.01 * k)
            try:
                new_imu, new_mag = driver.poll(self._clock.now_s)
            except SensorError as error:
                self.heard.problems.append(str(error))
                continue
            self.heard.imu.extend(new_imu)
            self.heard.mag.extend(new_mag)

    async def _position(self, driver: Neo6m) -> None:
        while True:
            data = await self._gps_line.app.read()
            self.heard.fixes.extend(driver.feed(data, self._clock.now_s()))

    async def _configure(self, driver: Neo6m) -> None:
        while True:
            command = driver.pending(self._clock.now_s())
            self._gps_line.app.set_baud(driver.baud)
            self._gps_line.app.write(command)
            await asyncio.sleep(0.2)

    async def _distance(self, driver: Ultrasonic) -> None:
        while True:
            data = await self._range_line.app.read()
            self.heard.echoes.extend(driver.feed(data, self._clock.now_s()))


async def _world(rack: SensorRack, seconds: float, faults: Sequence[Fault]) -> None:
    """The vehicle turns and drifts, in its time."""
    clock, rng = Clock(), np.random.default_rng(0)
    ways = (LinkChannel(LinkSettings(), rng), LinkChannel(LinkSettings(), rng))
    onboard = SimulatedAutopilotSensors(rng, STEP_S, home=HOME, field_ned_ut=FIELD_NED_UT, imu_filter=2)
    schedule = FaultSchedule(
        faults, FaultTargets(rack, onboard, FrameLine(rng), Motors(), *ways, Mock(), Mock(), Mock())
    )
    for k in range(round(seconds / STEP_S)):
        schedule.step(k * STEP_S)
        state = QuadrotorState(
            position_ned_m=(0.0, k * STEP_S, -2.0),
            velocity_ned_m_s=(0.0, 1.0, 0.0),
            attitude=quat_from_euler(0.0, 0.0, 0.3 * k * STEP_S),
            rate_body_rad_s=(0.0, 0.0, 0.3),
            specific_force_body_m_s2=FORCE,
        )
        rack.step(k * STEP_S, state, 0.5, lambda: 1.9)
        await clock.sleep_until((k + 1) * STEP_S)


@in_virtual_time
async def fly(seed: int, seconds: float, faults: Sequence[Fault] = ()) -> DriverSamples:
    """The vehicle turns and drifts eastward 2 m over the floor; what do the app's drivers make of it?"""
    gps_line, range_line = MemoryPort(9600), MemoryPort(9600)
    rack = SensorRack(
        seed, STEP_S, home=HOME, field_ned_ut=FIELD_NED_UT, gps_port=gps_line, range_port=range_line
    )
    drivers = _Drivers(rack, gps_line, range_line)
    tasks = drivers.start()
    await _world(rack, seconds, faults)
    for task in tasks:
        task.cancel()
    return drivers.heard
