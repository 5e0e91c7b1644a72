"""The SPI bus on a stand-in for the kernel's spidev that checks clock rates, a simulated chip behind it."""

import sys
import tempfile
import types

import numpy as np
import pytest

from companion.config import ConfigError, ImuConfig
from companion.sense.imu.i2c import open_bus
from companion.sense.imu.spi import SpiBus
from sitl.devices.mpu9250 import Mpu9250Device
from tests.unit.sense.imu.imu_rig import FIELD, REST, ImuRig

SENSORS = range(0x3A, 0x61)  # PS-MPU-9250A-01: sensor and interrupt registers may be read at 20 MHz


class FakeSpiDev:
    """spidev.SpiDev with one MPU9250: the first byte's top bit reads, the rest is the register."""

    device: Mpu9250Device | None = None
    missing: OSError | None = None

    def __init__(self) -> None:
        self.mode = 0
        self.max_speed_hz = 500_000
        self.closed = False
        self.file = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the bus

    def open(self, bus: int, select: int) -> None:
        self.at = (bus, select)
        if self.missing is not None:
            raise self.missing

    def fileno(self) -> int:
        return self.file.fileno()

    def close(self) -> None:
        self.closed = True
        self.file.close()

    def xfer2(self, data: list[int], speed_hz: int) -> list[int]:
        assert self.device is not None
        assert self.mode in (0, 3)
        register, reads = data[0] & 0x7F, data[0] & 0x80
        sensors = reads and register in SENSORS and register + len(data) - 2 in SENSORS
        assert speed_hz <= (20_000_000 if sensors else 1_000_000), f"register 0x{register:02x} too fast"
        if reads:
            return [0, *self.device.read(0x68, register, len(data) - 1)]
        for offset, value in enumerate(data[1:]):
            self.device.write(0x68, register + offset, value)
        return [0] * len(data)


@pytest.fixture
def spidev(monkeypatch: pytest.MonkeyPatch) -> type[FakeSpiDev]:
    class Fresh(FakeSpiDev):
        pass

    module = types.ModuleType("spidev")
    module.SpiDev = Fresh  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "spidev", module)
    return Fresh


@pytest.mark.parametrize("read", ["fifo", "registers"])
def test_the_driver_gets_its_samples_through_spi_within_the_chips_clock_rates(
    spidev: type[FakeSpiDev], read: str
) -> None:
    def wire(device: Mpu9250Device) -> SpiBus:
        spidev.device = device
        bus = open_bus("spi:0.0")
        assert isinstance(bus, SpiBus)
        return bus

    poll_hz = 200 if read == "registers" else 100
    config = ImuConfig.model_validate({"bus": "spi:0.0", "read": read, "poll_hz": poll_hz})
    rig = ImuRig(config, wrap=wire)
    rig.run(1.0)
    assert not rig.faults
    assert rig.problem() is None
    assert len(rig.imu) > 150
    assert rig.imu[-1].specific_force_body_m_s2 == pytest.approx(REST, abs=0.05)
    assert np.mean([m.field_body_ut for m in rig.mag], axis=0) == pytest.approx(FIELD, abs=0.3)


def test_registers_are_read_with_the_top_bit_set_and_written_without(
    spidev: type[FakeSpiDev], monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[tuple[list[int], int]] = []

    def record(_self: FakeSpiDev, data: list[int], speed_hz: int) -> list[int]:
        sent.append((data, speed_hz))
        return [0xAA, *range(len(data) - 1)]

    monkeypatch.setattr(spidev, "xfer2", record)
    bus = SpiBus(0, 1)
    assert bus.read(0x68, 0x3B, 3) == bytes((0, 1, 2))
    bus.write(0x68, 0x6B, 0x80)
    bus.read(0x68, 0x74, 28)
    assert [data for data, _ in sent[:2]] == [[0xBB, 0, 0, 0], [0x6B, 0x80]]
    assert [speed for _, speed in sent] == [8_000_000, 1_000_000, 1_000_000]


def test_a_chip_that_is_not_behind_the_chip_select_is_a_bus_fault(spidev: type[FakeSpiDev]) -> None:
    with pytest.raises(OSError, match="no device 0x0c"):
        SpiBus(0, 0).read(0x0C, 0x00, 1)


def test_a_missing_module_is_reported_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "spidev", None)
    with pytest.raises(ConfigError, match=r"spidev is missing; expected: apt install python3-spidev"):
        open_bus("spi:0.0")


def test_a_missing_device_is_reported_in_one_line(spidev: type[FakeSpiDev]) -> None:
    spidev.missing = FileNotFoundError(2, "No such file or directory")
    with pytest.raises(ConfigError, match=r"/dev/spidev1.2 cannot be opened: No such file"):
        open_bus("spi:1.2")
