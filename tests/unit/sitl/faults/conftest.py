"""A flight without a fault, which the flights with one are compared with."""

import pytest

from tests.unit.sitl.devices.sensor_desk import DriverSamples, fly
from tests.unit.sitl.faults.fault_readings import SECONDS


@pytest.fixture(scope="session")
def healthy() -> DriverSamples:
    return fly(3, SECONDS)
