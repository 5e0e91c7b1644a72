"""A vehicle that stands in the air with all its sensors, heard through the app's own drivers."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.base.clock import Clock, run_in_virtual_time
from companion.base.geometry import GRAVITY_M_S2, Vector3, quat_from_euler
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import GpsConfig, ImuConfig, RangeConfig
from companion.sense.gps.neo6m import Neo6m
from companion.sense.imu.i2c import SensorError
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.range.ultrasonic import Ultrasonic
from sitl.camera.frame_line import FrameLine
from sitl.devices.ports import MemoryPort
from sitl.devices.rack import SensorRack
from sitl.faults.faults import Fault
from sitl.faults.faulty_link import LinkSettings, LinkWay
from sitl.faults.injection import FaultSchedule, FaultTargets
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.actuators import Motors
from sitl.vehicle.quadrotor import QuadrotorState

STEP_S = 1.0 / 400.0
FORCE: Vector3 = (0.0, 0.0, -GRAVITY_M_S2)
HOME = (47.0, 8.0, 400.0)
FIELD_NED_UT = (20.9, 0.6, 42.9)


class Heard(NamedTuple):
    """What the drivers made of it."""

    imu: list[ImuSample]
    mag: list[MagSample]
    fixes: list[GpsFix]
    echoes: list[RangeSample]
    problems: list[str]


def fly(seed: int, seconds: float, faults: Sequence[Fault] = ()) -> Heard:
    """The vehicle turns and drifts eastward 2 m over the floor; what do the app's drivers make of it?"""
    imu: list[ImuSample] = []
    mag: list[MagSample] = []
    fixes: list[GpsFix] = []
    echoes: list[RangeSample] = []
    problems: list[str] = []

    async def world(rack: SensorRack, clock: Clock) -> None:
        rng = np.random.default_rng(0)
        ways = (LinkWay(LinkSettings(), rng), LinkWay(LinkSettings(), rng))
        onboard = SimulatedAutopilotSensors(rng, STEP_S, home=HOME, field_ned_ut=FIELD_NED_UT, imu_filter=2)
        schedule = FaultSchedule(faults, FaultTargets(rack, onboard, FrameLine(rng), Motors(), *ways))
        for k in range(round(seconds / STEP_S)):
            schedule.step(k * STEP_S)
            attitude = quat_from_euler(0.0, 0.0, 0.3 * k * STEP_S)
            state = QuadrotorState(
                position_ned_m=(0.0, k * STEP_S, -2.0),
                velocity_ned_m_s=(0.0, 1.0, 0.0),
                attitude=attitude,
                rate_body_rad_s=(0.0, 0.0, 0.3),
                specific_force_body_m_s2=FORCE,
            )
            rack.step(k * STEP_S, state, 0.5, lambda: 1.9)
            await clock.sleep_until((k + 1) * STEP_S)

    async def inertial(driver: Mpu9250, clock: Clock) -> None:
        for k in range(1_000_000):
            await clock.sleep_until(0.01 * k)
            try:
                new_imu, new_mag = driver.poll(clock.now_s)
            except SensorError as error:
                problems.append(str(error))
                continue
            imu.extend(new_imu)
            mag.extend(new_mag)

    async def position(driver: Neo6m, port: MemoryPort, clock: Clock) -> None:
        while True:
            data = await port.app.read()
            fixes.extend(driver.feed(data, clock.now_s()))

    async def configure(driver: Neo6m, port: MemoryPort, clock: Clock) -> None:
        while True:
            command = driver.pending(clock.now_s())
            port.app.set_baud(driver.baud)
            port.app.write(command)
            await asyncio.sleep(0.2)

    async def distance(driver: Ultrasonic, port: MemoryPort, clock: Clock) -> None:
        while True:
            data = await port.app.read()
            echoes.extend(driver.feed(data, clock.now_s()))

    async def main() -> None:
        clock = Clock()
        gps_line, range_line = MemoryPort(9600), MemoryPort(9600)
        rack = SensorRack(
            seed,
            STEP_S,
            home=HOME,
            field_ned_ut=FIELD_NED_UT,
            gps_port=gps_line,
            range_port=range_line,
        )
        receiver = Neo6m(GpsConfig())
        tasks = [
            asyncio.create_task(inertial(Mpu9250(rack.imu, ImuConfig()), clock)),
            asyncio.create_task(position(receiver, gps_line, clock)),
            asyncio.create_task(configure(receiver, gps_line, clock)),
            asyncio.create_task(distance(Ultrasonic(RangeConfig()), range_line, clock)),
        ]
        await world(rack, clock)
        for task in tasks:
            task.cancel()

    run_in_virtual_time(main())
    return Heard(imu, mag, fixes, echoes, problems)
