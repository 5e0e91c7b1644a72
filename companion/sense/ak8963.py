"""The AK8963 magnetometer inside the MPU9250, reached through the MPU9250's own I2C master.

Set-up goes through the master's slave 4 (one byte a transaction); then slave 0 copies ST1, HXL..HZH and
ST2 into EXT_SENS_DATA at every sample of the MPU9250. Registers, the sensitivity adjustment and the axes
are those of the MPU-9250 product specification PS-MPU-9250A-01 rev. 1.1 (section 9.1 for the axes) and
the register map RM-MPU-9250A-00.

The bring-up is a generator that yields the seconds to wait before it goes on, so that it needs no clock.
A magnetometer that fails costs nothing but its own samples: it is brought up anew beside the running FIFO.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Generator
from typing import Final

from companion.geometry import Vector3
from companion.sense.i2c import RegisterBus, SensorError

BLOCK_BYTES: Final = 8  # ST1, three axes of 16 bits, ST2
MICROTESLA_PER_LSB: Final = 0.15  # at 16 bits

_ADDRESS: Final = 0x0C
_READ: Final = 0x80

# AK8963
_WIA, _ST1, _CNTL1, _CNTL2, _ASAX = 0x00, 0x02, 0x0A, 0x0B, 0x10
_IDENTITY: Final = 0x48
_POWER_DOWN: Final = 0x00
_FUSE_ROM: Final = 0x0F
_SIXTEEN_BITS: Final = 0x10
_CONTINUOUS: Final = {8: 0x02, 100: 0x06}
_DATA_READY: Final = 0x01
_SAME_MOST: Final = 10  # noise spans several steps: more of the same in a row is an old block, read again
_OVERFLOW: Final = 0x08

# the MPU9250's master
_USER_CTRL: Final = 0x6A
_MASTER_RESET: Final = 0x62  # FIFO and master stay enabled, the master starts anew
_EXT_SENS_DATA: Final = 0x49
_SLV0_ADDR, _SLV0_REG, _SLV0_CTRL = 0x25, 0x26, 0x27
_SLV4_ADDR, _SLV4_REG, _SLV4_DO, _SLV4_CTRL, _SLV4_DI = 0x31, 0x32, 0x33, 0x34, 0x35
_MST_STATUS: Final = 0x36
_SLV4_DONE: Final = 0x40
_SLV4_NACK: Final = 0x10
_ENABLE: Final = 0x80
_TRANSACTION_WAIT_S: Final = 0.005
_TRANSACTION_TRIES: Final = 20
_RETRY_S: Final = 0.5
_SILENT_S: Final = 1.0

_BLOCK: Final = struct.Struct("<BhhhB")  # unlike the MPU9250, the AK8963 is little-endian

Waits = Generator[float, None, None]


class BringUp:
    """A bring-up under way: its steps, and when the next one is due."""

    def __init__(self, steps: Waits, start_s: float = -math.inf) -> None:
        self._steps = steps
        self._resume_s = start_s

    def advance(self, now_s: float) -> bool:
        """Do what is due; True once all is done. Raises what the steps raise."""
        if now_s < self._resume_s:
            return False
        wait_s = next(self._steps, None)
        if wait_s is None:
            return True
        self._resume_s = now_s + wait_s
        return False


class Ak8963:
    """The magnetometer: bring-up, decoding, and new bring-ups for as long as it fails.

    `address` is the MPU9250's. `problem` says in one line why there are no samples; None when there are.
    """

    def __init__(self, bus: RegisterBus, address: int, rate_hz: int) -> None:
        self._bus = bus
        self._address = address
        self._rate_hz = rate_hz
        self.problem: str | None = None
        self._last_new_s = -math.inf
        self._same_blocks = 0
        self._scale: Vector3 = (MICROTESLA_PER_LSB,) * 3
        self._last_axes: tuple[int, int, int] | None = None
        self.restart()

    def restart(self) -> None:
        """Bring it up with the polls that follow: the MPU9250's settings are fresh."""
        self._bring_up: BringUp | None = BringUp(self.bring_up())

    def poll(self, now_s: float, copied: bool) -> tuple[Vector3, bool] | None:
        """One step of a bring-up, or what is new; see `decode`. Never raises: see `problem`.

        Args:
            now_s: the time.
            copied: whether the MPU9250 has sampled, and so copied the block, since the last poll.
        """
        try:
            if self._bring_up is not None:
                self._continue(self._bring_up, now_s)
                return None
            if not copied:
                return None
            decoded = self.decode(self._bus.read(self._address, _EXT_SENS_DATA, BLOCK_BYTES))
        except SensorError as error:
            self._fail(str(error), now_s)
            return None
        except OSError as error:
            # one transaction that fails while samples flow costs one sample
            if self._bring_up is not None:
                self._fail(f"AK8963: {error.strerror or error}", now_s)
            return None
        self._watch(decoded is not None, now_s)
        return decoded

    def _continue(self, bring_up: BringUp, now_s: float) -> None:
        if bring_up.advance(now_s):
            self._bring_up = None
            self._last_new_s = now_s

    def _fail(self, problem: str, now_s: float) -> None:
        self.problem = problem
        self._bring_up = BringUp(self.bring_up(), now_s + _RETRY_S)

    def _watch(self, new: bool, now_s: float) -> None:
        if new:
            self._last_new_s = now_s
            self.problem = None
        elif now_s - self._last_new_s > _SILENT_S:
            self._fail(f"AK8963: nothing new for {_SILENT_S:g} s", now_s)

    def bring_up(self) -> Waits:
        """Reset, check identity, read the fuse ROM, start continuous measurement.

        Yields:
            Seconds to wait before the next step.

        Raises:
            SensorError: no answer on the inner bus, or not an AK8963.
            OSError: bus fault.
        """
        # nothing may be under way when the master starts anew, or the slave is left hanging
        self._bus.write(self._address, _SLV0_CTRL, 0x00)
        yield 0.01
        self._bus.write(self._address, _USER_CTRL, _MASTER_RESET)
        yield 0.01
        yield from self._write(_CNTL2, 0x01)
        yield 0.01
        identity = yield from self._read(_WIA)
        if identity != _IDENTITY:
            raise SensorError(f"AK8963: identity 0x{identity:02x}, expected 0x{_IDENTITY:02x}")
        yield from self._read_adjustment()
        yield from self._write(_CNTL1, _SIXTEEN_BITS | _CONTINUOUS[self._rate_hz])
        yield 0.01
        for register, value in (
            (_SLV0_ADDR, _READ | _ADDRESS),
            (_SLV0_REG, _ST1),
            (_SLV0_CTRL, _ENABLE | BLOCK_BYTES),
        ):
            self._bus.write(self._address, register, value)
        self._last_axes = None

    def decode(self, block: bytes) -> tuple[Vector3, bool] | None:
        """Field (µT) in the axes of the MPU9250's accelerometer, and whether it is of the newest copy.

        Call it once a copy at most. None when there is nothing new, the sensor overflowed (HOFL), or the
        block is not one.
        """
        status, x, y, z, status_2 = _BLOCK.unpack(block)
        if status_2 & _OVERFLOW or not status_2 & _SIXTEEN_BITS:
            return None
        ready = bool(status & _DATA_READY)
        # The block is copied more often than we read it, and the copy after the one marked "ready" holds
        # the same data unmarked: what differs from the last is new as well. A dead sensor leaves its last
        # block standing, mark and all.
        self._same_blocks = self._same_blocks + 1 if (x, y, z) == self._last_axes else 0
        if self._same_blocks > (_SAME_MOST if ready else 0):
            return None
        self._last_axes = (x, y, z)
        kx, ky, kz = self._scale
        # magnetometer x is the accelerometer's y, y its x, z points the other way
        return (ky * y, kx * x, -kz * z), ready

    def _read_adjustment(self) -> Waits:
        yield from self._write(_CNTL1, _FUSE_ROM)
        yield 0.01
        scale = []
        for axis in range(3):
            value = yield from self._read(_ASAX + axis)
            scale.append(MICROTESLA_PER_LSB * ((value - 128) * 0.5 / 128.0 + 1.0))
        self._scale = (scale[0], scale[1], scale[2])
        yield from self._write(_CNTL1, _POWER_DOWN)
        yield 0.01

    def _read(self, register: int) -> Generator[float, None, int]:
        self._bus.write(self._address, _SLV4_ADDR, _READ | _ADDRESS)
        yield from self._transact(register)
        return self._bus.read(self._address, _SLV4_DI, 1)[0]

    def _write(self, register: int, value: int) -> Waits:
        self._bus.write(self._address, _SLV4_ADDR, _ADDRESS)
        self._bus.write(self._address, _SLV4_DO, value)
        yield from self._transact(register)

    def _transact(self, register: int) -> Waits:
        self._bus.write(self._address, _SLV4_REG, register)
        self._bus.write(self._address, _SLV4_CTRL, _ENABLE)
        for _ in range(_TRANSACTION_TRIES):
            yield _TRANSACTION_WAIT_S
            status = self._bus.read(self._address, _MST_STATUS, 1)[0]
            if status & _SLV4_NACK:
                raise SensorError("AK8963: no acknowledge on the MPU9250's inner bus")
            if status & _SLV4_DONE:
                return
        raise SensorError("AK8963: the MPU9250's inner bus does not finish a transaction")
