"""The sensors over sockets and pseudo-terminals in real time: the drivers hear each of them."""

import asyncio
from pathlib import Path

from companion.app.hardware import Hardware, open_hardware
from companion.base.clock import Clock
from companion.config import CONFIG_FOLDER, CompanionConfig, merge, validate
from companion.sense.gps.neo6m import Neo6m
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.range.range_finder import make_range_finder
from companion.sim.process import SimulatorProcess
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from tests.beside import beside
from tests.scenario.flying import scenario_file

PATIENCE_S = 40.0


async def test_over_sockets_and_pseudo_terminals_in_real_time_the_same_drivers_hear_every_sensor(
    tmp_path: Path,
) -> None:
    """The simulator is a process of its own; here are no more than the drivers, for some seconds."""
    sensors = {"imu_interface": "spi", "ultrasonic": "polled", "gps_wake_baud": 57600}
    trial = Trial.load(str(scenario_file(tmp_path, "static", {"sensors": sensors})), 0)
    simulator = await SimulatorProcess.start(trial, tmp_path)
    try:
        settings = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=False)
        wired = validate(CompanionConfig, merge(settings.model_dump(), simulator.endpoints), "endpoints")
        assert wired.sense.imu.over_spi
        async with open_hardware(wired) as hardware:
            heard = await listen(wired, hardware, PATIENCE_S)
    finally:
        await simulator.kill()
    assert heard == {"imu", "mag", "gps", "range"}


async def listen(config: CompanionConfig, hardware: Hardware, seconds: float) -> set[str]:
    """Which of the sensors have been heard within `seconds`, all of them at best."""
    clock, heard = Clock(), set[str]()
    bus, gps_port, range_port = hardware.imu_bus, hardware.gps_port, hardware.range_port
    assert bus is not None
    assert gps_port is not None
    assert range_port is not None
    imu, gps = Mpu9250(bus, config.sense.imu), Neo6m(config.sense.gps)
    finder = make_range_finder(config.sense.range, range_port, clock)

    async def inertial() -> None:
        while True:
            for kind, samples in zip(("imu", "mag"), imu.poll(clock.now_s), strict=True):
                heard.update([kind] if samples else [])
            await asyncio.sleep(0.01)

    async def positions() -> None:
        while True:
            data = await gps_port.read()
            # NMEA does at any rate: a fix counts once the receiver is configured
            heard.update(["gps"] if gps.feed(data, clock.now_s()) and gps.configured else [])

    async def questions() -> None:
        while True:
            question = gps.pending(clock.now_s())
            gps_port.set_baud(gps.baud)
            gps_port.write(question)
            await asyncio.sleep(0.2)

    async def distances() -> None:
        while True:
            heard.update(["range"] if await finder.read() else [])

    end_s = clock.now_s() + seconds
    async with beside(inertial(), positions(), questions(), distances()) as tasks:
        while len(heard) < 4 and clock.now_s() < end_s:
            await asyncio.wait(tasks, timeout=0.1)
            assert not any(task.done() for task in tasks), [task for task in tasks if task.done()]
    return heard
