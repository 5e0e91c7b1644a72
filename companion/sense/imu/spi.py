"""The register bus over SPI: the kernel's spidev, one chip behind one chip select.

Figures of PS-MPU-9250A-01 rev. 1.1, section 7.5: bit 7 of the first byte reads, the rest is the register,
which steps on by itself; 1 MHz for any register, 20 MHz for reading those of sensors and interrupts.
`spidev` is imported when a bus is opened: it is compiled on the machine that has such a bus.
"""

import errno
from typing import Any, Final

from companion.base.errors import ConfigError, DeviceMissing
from companion.base.files import take_alone

READ_BIT: Final = 0x80
REGISTER_HZ: Final = 1_000_000
SENSOR_READ_HZ: Final = 8_000_000  # of the 20 allowed: loose wires carry 8
FIRST_SENSOR_REGISTER: Final = 0x3A  # INT_STATUS, then the outputs
LAST_SENSOR_REGISTER: Final = 0x60  # the last of EXT_SENS_DATA
_MODE: Final = 3  # the clock rests high; data is taken at its rising edge
_ADDRESSES: Final = (0x68, 0x69)


class SpiBus:
    """A RegisterBus on /dev/spidevBUS.SELECT.

    The chip select does the addressing, so that both of the MPU9250's I2C addresses mean the one chip here,
    and any other means a chip that is not there. Nothing acknowledges on SPI: a chip that is missing reads as
    all ones or all noughts, which is the driver's to notice.

    Raises:
        ConfigError: no spidev module, no such device, or another program of ours has it.
    """

    def __init__(self, bus: int, select: int) -> None:
        path = f"/dev/spidev{bus}.{select}"
        self._spi = _spidev_module().SpiDev()
        try:
            self._spi.open(bus, select)
            take_alone(self._spi.fileno())
        except OSError as error:
            self._spi.close()
            reason = error.strerror or str(error)
            raise DeviceMissing(f"bus 'spi:{bus}.{select}': {path} cannot be opened: {reason}") from error
        self._spi.mode = _MODE
        self._spi.max_speed_hz = REGISTER_HZ

    def read(self, address: int, register: int, length: int) -> bytes:
        _check(address)
        # FIFO and settings are not among the sensors' registers
        sensors = register >= FIRST_SENSOR_REGISTER and register + length - 1 <= LAST_SENSOR_REGISTER
        speed_hz = SENSOR_READ_HZ if sensors else REGISTER_HZ
        return self._transfer([register | READ_BIT, *bytes(length)], speed_hz)[1:]

    def write(self, address: int, register: int, value: int) -> None:
        _check(address)
        self._transfer([register, value], REGISTER_HZ)

    def close(self) -> None:
        self._spi.close()

    def _transfer(self, data: list[int], speed_hz: int) -> bytes:
        return bytes(self._spi.xfer2(data, speed_hz))


def _check(address: int) -> None:
    if address not in _ADDRESSES:
        raise OSError(errno.ENXIO, f"no device 0x{address:02x} behind this chip select")


def _spidev_module() -> Any:
    try:
        import spidev  # noqa: PLC0415 - needed on a vehicle with SPI alone
    except ImportError as error:
        raise ConfigError(
            "bus 'spi:...': spidev is missing; expected: apt install python3-spidev (or pip install spidev)"
        ) from error
    return spidev
