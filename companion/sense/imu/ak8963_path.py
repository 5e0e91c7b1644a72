"""Two ways to the AK8963 inside the MPU9250: by the MPU9250's own I2C master, or past it on our bus.

`MasterPath`: single registers through the master's slave 4, one byte a transaction; then slave 0 copies the
block of a measurement into EXT_SENS_DATA at every sample of the MPU9250. It works over I2C and SPI.
`BypassPath`: the magnetometer's pins are switched through to our I2C bus and it answers there at 0x0C; the
MPU9250's driver sets BYPASS_EN. Registers: RM-MPU-9250A-00 rev. 1.6.

What waits is a generator that yields the seconds to wait before it goes on, so that it needs no clock.
"""

from collections.abc import Generator
from typing import Final, Protocol

from companion.sense.imu.fifo import USER_CTRL
from companion.sense.imu.i2c import RegisterBus, SensorError

ADDRESS: Final = 0x0C
BLOCK_REGISTER: Final = 0x02  # ST1
BLOCK_BYTES: Final = 8  # ST1, three axes of 16 bits, ST2; reading ST2 lets the next measurement in

_READ: Final = 0x80
_MASTER_RESET: Final = 0x02
_EXT_SENS_DATA: Final = 0x49
_SLV0_ADDR, _SLV0_REG, _SLV0_CTRL = 0x25, 0x26, 0x27
_SLV4_ADDR, _SLV4_REG, _SLV4_DO, _SLV4_CTRL, _SLV4_DI = 0x31, 0x32, 0x33, 0x34, 0x35
_MST_STATUS: Final = 0x36
_SLV4_DONE: Final = 0x40
_SLV4_NACK: Final = 0x10
_ENABLE: Final = 0x80
_TRANSACTION_WAIT_S: Final = 0.005
_TRANSACTION_TRIES: Final = 20

Waits = Generator[float, None, None]


class MagPath(Protocol):
    """A way to the magnetometer's registers. OSError is a fault of our bus, SensorError one beyond it."""

    def open(self) -> Waits:
        """Bring the way itself into a known state."""
        ...

    def read(self, register: int) -> Generator[float, None, int]:
        """One byte."""
        ...

    def write(self, register: int, value: int) -> Waits:
        """One byte."""
        ...

    def start(self) -> None:
        """Measurements flow from now on: prepare for reading their blocks."""
        ...

    def block(self, copied: bool) -> bytes | None:
        """The newest block, or None when there cannot be a new one; `copied`: the MPU9250 has sampled."""
        ...


class MasterPath:
    """By the MPU9250's I2C master. `user_control` is USER_CTRL as it is while samples flow."""

    def __init__(self, bus: RegisterBus, address: int, user_control: int) -> None:
        self._bus = bus
        self._address = address
        self._user_control = user_control

    def open(self) -> Waits:
        """Start the master anew."""
        # nothing may be under way when the master starts anew, or the slave is left hanging
        self._set(_SLV0_CTRL, 0x00)
        yield 0.01
        self._set(USER_CTRL, self._user_control | _MASTER_RESET)
        yield 0.01

    def read(self, register: int) -> Generator[float, None, int]:
        self._set(_SLV4_ADDR, _READ | ADDRESS)
        yield from self._transact(register)
        return self._bus.read(self._address, _SLV4_DI, 1)[0]

    def write(self, register: int, value: int) -> Waits:
        self._set(_SLV4_ADDR, ADDRESS)
        self._set(_SLV4_DO, value)
        yield from self._transact(register)

    def start(self) -> None:
        """Have slave 0 copy a block at every sample of the MPU9250."""
        self._set(_SLV0_ADDR, _READ | ADDRESS)
        self._set(_SLV0_REG, BLOCK_REGISTER)
        self._set(_SLV0_CTRL, _ENABLE | BLOCK_BYTES)

    def block(self, copied: bool) -> bytes | None:
        """The newest copy, if it has not been read yet."""
        return self._bus.read(self._address, _EXT_SENS_DATA, BLOCK_BYTES) if copied else None

    def _set(self, register: int, value: int) -> None:
        self._bus.write(self._address, register, value)

    def _transact(self, register: int) -> Waits:
        self._set(_SLV4_REG, register)
        self._set(_SLV4_CTRL, _ENABLE)
        for _ in range(_TRANSACTION_TRIES):
            yield _TRANSACTION_WAIT_S
            status = self._bus.read(self._address, _MST_STATUS, 1)[0]
            if status & _SLV4_NACK:
                raise SensorError("AK8963: no acknowledge on the MPU9250's inner bus")
            if status & _SLV4_DONE:
                return
        raise SensorError("AK8963: the MPU9250's inner bus does not finish a transaction")


class BypassPath:
    """Past the MPU9250, on our own bus."""

    def __init__(self, bus: RegisterBus) -> None:
        self._bus = bus

    def open(self) -> Waits:
        """Nothing: BYPASS_EN is among the MPU9250's settings."""
        yield from ()

    def read(self, register: int) -> Generator[float, None, int]:
        yield from ()
        return self._bus.read(ADDRESS, register, 1)[0]

    def write(self, register: int, value: int) -> Waits:
        self._bus.write(ADDRESS, register, value)
        yield from ()

    def start(self) -> None:
        """Nothing: blocks are read where they arise."""

    def block(self, copied: bool) -> bytes | None:
        """The magnetometer's own registers: it measures whether or not the MPU9250 has sampled."""
        return self._bus.read(ADDRESS, BLOCK_REGISTER, BLOCK_BYTES)
