"""Flights with the sensors wired in other ways: the same drivers, and a landing all the same."""

from __future__ import annotations

import asyncio
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from companion.app.hardware import Hardware, open_hardware
from companion.base.clock import Clock
from companion.base.messages import Outcome
from companion.config import CONFIG_FOLDER, CompanionConfig, ConfigError, merge, validate
from companion.flightlog.record import FlightLog
from companion.sense.gps.neo6m import Neo6m
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.range.range_finder import make_range_finder
from companion.sim.process import SimulatorProcess
from companion.sim.runner import SitlFlight, fly
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from tests.scenario.flying import scenario_file

PATIENCE_S = 40.0


class CountingLog(FlightLog):
    """A log that keeps how many messages there were of each topic."""

    def __init__(self) -> None:
        super().__init__(None, start_unix_s=0.0)
        self.counts: Counter[str] = Counter()

    def write(self, topic: str, message: Any, time_s: float) -> None:
        self.counts[topic] += 1
        super().write(topic, message, time_s)


def fly_static(
    folder: Path, sensors: dict[str, Any], sense: dict[str, Any]
) -> tuple[SitlFlight, CountingLog]:
    path = scenario_file(folder, "static", {"sensors": sensors, "companion": {"sense": sense}})
    trial = Trial.load(str(path), 0)
    log = CountingLog()
    settings = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    return fly(settings, trial, log, lambda _status: None, fast=True), log


WIRINGS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "SPI, a US-100, a receiver that comes up at 115200 baud": (
        {"imu_interface": "spi", "ultrasonic": "polled", "gps_wake_baud": 115200},
        {"gps": {"baud": 57600}},
    ),
    "the magnetometer past the chip, its registers read one by one": (
        {"gps_wake_baud": 38400},
        {"imu": {"mag_path": "bypass", "read": "registers", "poll_hz": 200}, "gps": {"baud": 9600}},
    ),
}


@pytest.mark.parametrize("wiring", list(WIRINGS))
def test_it_lands_and_every_sensor_was_heard(tmp_path: Path, wiring: str) -> None:
    flight, log = fly_static(tmp_path, *WIRINGS[wiring])
    assert flight.report.outcome is Outcome.LANDED, flight.report.failures
    said = "\n".join(notice.text for notice in log.kept["notice"])
    assert "MPU9250" not in said
    assert "AK8963" not in said
    assert "ultrasonic" not in said
    duration_s = flight.report.duration_s
    for kind, rate_hz in (("imu", 190.0), ("mag", 80.0), ("gps", 3.5), ("range", 5.0)):
        assert log.counts[kind] > 0.7 * rate_hz * duration_s, kind


def test_a_wiring_that_the_settings_contradict_is_told_before_the_flight(tmp_path: Path) -> None:
    sensors = {"imu_interface": "spi"}
    with pytest.raises(ConfigError, match="expected master on SPI"):
        fly_static(tmp_path, sensors, {"imu": {"mag_path": "bypass"}})


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

    tasks = [asyncio.create_task(run()) for run in (inertial, positions, questions, distances)]
    end_s = clock.now_s() + seconds
    while len(heard) < 4 and clock.now_s() < end_s:
        await asyncio.wait(tasks, timeout=0.1)
        assert not any(task.done() for task in tasks), [task for task in tasks if task.done()]
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    return heard
