"""The MPU9250's FIFO: whole frames of accelerometer, temperature and gyroscope, whatever the bus does.

A transaction that fails loses nothing as long as the FIFO keeps the samples: the next read gets them. One
that broke off half way may have taken bytes with it, which the count betrays: then the FIFO is emptied.
Registers: RM-MPU-9250A-00 rev. 1.6.
"""

from __future__ import annotations

import errno
from typing import Final

from companion.sense.imu.i2c import RegisterBus, SensorError

FIFO_BYTES: Final = 512
FRAME_BYTES: Final = 14  # seven big-endian 16-bit words

_USER_CTRL, _FIFO_COUNT, _FIFO_R_W = 0x6A, 0x72, 0x74
_ENABLE: Final = 0x40
_RESET: Final = 0x04
_BURST_BYTES: Final = 28  # two frames: what an SMBus adapter reads at once


class SamplesLostError(SensorError):
    """The FIFO was read too late or got out of step and has been emptied: the sensor is well."""


class Fifo:
    """The FIFO of the MPU9250 at `address`. Every method: OSError when the bus fails.

    `user_control` are the bits of USER_CTRL beside the FIFO's own: the inner bus's master, I2C switched off.
    """

    def __init__(self, bus: RegisterBus, address: int, user_control: int) -> None:
        self._bus = bus
        self._address = address
        self._user_control = user_control
        self._reset_due = False
        self._in_doubt = False

    def reset(self) -> None:
        """Empty it and have it filled from now on."""
        self._reset_due = True  # until it is through: a bus fault may come between
        self._bus.write(self._address, _USER_CTRL, self._user_control | _RESET)
        self._bus.write(self._address, _USER_CTRL, self._user_control | _ENABLE)
        self._reset_due = self._in_doubt = False

    def waiting(self) -> int:
        """Whole frames that can be read.

        Raises:
            SamplesLostError: it was full or out of step, and has been reset.
        """
        if self._reset_due:
            self.reset()
            raise SamplesLostError("FIFO emptied after a bus fault, samples lost")
        high, low = self._bus.read(self._address, _FIFO_COUNT, 2)
        count = (high & 0x1F) << 8 | low
        if count > FIFO_BYTES:
            raise OSError(errno.EIO, f"FIFO count {count} of {FIFO_BYTES}: the bus reads all ones")
        if count > FIFO_BYTES - FRAME_BYTES:
            self.reset()
            raise SamplesLostError("FIFO overflow, samples lost")
        if self._in_doubt and count % FRAME_BYTES:
            self.reset()
            raise SamplesLostError("FIFO out of step after a bus fault, samples lost")
        self._in_doubt = False
        return count // FRAME_BYTES

    def read(self, frames: int) -> bytes:
        """The oldest `frames` >= 1 frames; fewer, but at least one, when the bus fails in between."""
        data, length = b"", frames * FRAME_BYTES
        try:
            while len(data) < length:
                data += self._burst(min(_BURST_BYTES, length - len(data)))
        except OSError:
            self._in_doubt = True
            if not data:
                raise
        return data

    def _burst(self, length: int) -> bytes:
        data = self._bus.read(self._address, _FIFO_R_W, length)
        if data[-FRAME_BYTES:] == b"\xff" * FRAME_BYTES:
            raise OSError(errno.EIO, "the FIFO reads all ones")
        return data
