"""The MPU9250's output registers as a source of samples: one burst holds the "new" flag and the sample.

The plain alternative to the FIFO. It needs a poll for every sample, and a poll that is late costs one.
INT_STATUS and the outputs are neighbours, so one transaction reads both and they belong together (the chip
holds the outputs while a burst goes on). A chip that has lost its settings goes on sampling, with other
ranges: so each sample counts only if the settings still stand after it (a FIFO would be off, and silent).
Registers: RM-MPU-9250A-00 rev. 1.6.
"""

import errno
from typing import Final

from companion.sense.imu.i2c import RegisterBus, SensorError

_SMPLRT_DIV, _INT_STATUS, _USER_CTRL = 0x19, 0x3A, 0x6A
_BURST_BYTES: Final = 15  # INT_STATUS, then accelerometer, temperature and gyroscope
_RAW_DATA_READY: Final = 0x01


class OutputRegisters:
    """The newest sample of the MPU9250 at `address`. Every method: OSError when the bus fails.

    The same interface as `Fifo`: a sample that waits, and its 14 bytes. `settings` are what SMPLRT_DIV and
    the registers after it were set to.
    """

    def __init__(self, bus: RegisterBus, address: int, user_control: int, settings: bytes) -> None:
        self._bus = bus
        self._address = address
        self._user_control = user_control
        self._settings = settings
        self._sample = b""

    def reset(self) -> None:
        """Begin, without a FIFO."""
        self._bus.write(self._address, _USER_CTRL, self._user_control)
        self._sample = b""

    def waiting(self) -> int:
        """1 when there is a sample that has not been read, else 0. Reading clears the chip's flag.

        Raises:
            SensorError: the chip has lost its settings.
        """
        data = self._bus.read(self._address, _INT_STATUS, _BURST_BYTES)
        if data == b"\xff" * _BURST_BYTES:
            raise OSError(errno.EIO, "the output registers read all ones")
        if not data[0] & _RAW_DATA_READY:
            return 0
        settings = self._bus.read(self._address, _SMPLRT_DIV, len(self._settings))
        if settings != self._settings:
            raise SensorError(f"settings lost: {settings.hex()} instead of {self._settings.hex()}")
        self._sample = data[1:]
        return 1

    def read(self, frames: int) -> bytes:
        """The sample that `waiting` has found; `frames` is 1."""
        return self._sample * frames
