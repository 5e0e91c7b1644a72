"""Flights with the sensors wired in other ways: the same drivers, and a landing all the same."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from companion.base.messages import Outcome
from companion.config import ConfigError
from companion.flightlog.record import FlightLog
from companion.sim.runner import SitlFlight
from tests.scenario.flying import FEW_PICTURES, fly_logged, notices, scenario_file


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
    changes = {**FEW_PICTURES, "sensors": sensors, "companion": {"sense": sense}}
    log = CountingLog()
    return fly_logged(scenario_file(folder, "static", changes), log)[0], log


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
    said = notices(log)
    assert "MPU9250" not in said
    assert "AK8963" not in said
    assert "ultrasonic" not in said
    duration_s = flight.report.duration_s
    for kind, rate_hz in (("imu", 190.0), ("mag", 50.0), ("gps", 3.5), ("range", 5.0)):
        assert log.counts[kind] > 0.7 * rate_hz * duration_s, kind


def test_a_wiring_that_the_settings_contradict_is_reported_before_the_flight(tmp_path: Path) -> None:
    sensors = {"imu_interface": "spi"}
    with pytest.raises(ConfigError, match="expected master on SPI"):
        fly_static(tmp_path, sensors, {"imu": {"mag_path": "bypass"}})
