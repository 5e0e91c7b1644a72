"""The MPU9250's samples: whole frames of accelerometer, temperature and gyroscope, whatever the bus does.

`Fifo` loses none between two polls, nor by a transaction that fails, as long as the FIFO keeps them: the next
read gets them. One that broke off half way may have taken bytes with it, which the count betrays: then the
FIFO is emptied.

A FIFO that fills up stops within a frame, 512 bytes being 36 frames and 8 bytes. Whatever is read after
those 8 bytes is shifted by them, and a count shows nothing of it once the FIFO has been read down. So the
chip's own overflow flag is read before each count: what was counted before lies in front of the broken frame.
A remainder of the count that stays from one poll to the next counts too: the chip was not just writing.

`OutputRegisters` is the plain alternative. It needs a poll for every sample, and a poll that is late costs
one. INT_STATUS and the outputs are neighbours, so one transaction reads both and they belong together (the
chip holds the outputs while a burst goes on). A chip that has lost its settings goes on sampling, with other
ranges: so each sample counts only if the settings still stand after it (a FIFO would be off, and silent).
Registers: RM-MPU-9250A-00 rev. 1.6.
"""

import errno
from typing import Final

from companion.sense.imu.i2c import RegisterBus, SensorError

FIFO_BYTES: Final = 512
FRAME_BYTES: Final = 14  # seven big-endian 16-bit words

SMPLRT_DIV, USER_CTRL = 0x19, 0x6A
_INT_STATUS, _FIFO_COUNT, _FIFO_R_W = 0x3A, 0x72, 0x74
# of INT_STATUS; of INT_ENABLE, too
FIFO_OVERFLOW: Final = 0x10
_RAW_DATA_READY: Final = 0x01
# of USER_CTRL
FIFO_ENABLE: Final = 0x40
_RESET: Final = 0x04
_FIFO_BURST_BYTES: Final = 2 * FRAME_BYTES  # what an SMBus adapter reads at once
_OUTPUT_BURST_BYTES: Final = 1 + FRAME_BYTES  # INT_STATUS, then the sample


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
        self._remainder = 0

    def reset(self) -> None:
        """Empty it and have it filled from now on."""
        self._reset_due = True  # until it is through: a bus fault may come between
        self._bus.write(self._address, USER_CTRL, self._user_control | _RESET)
        self._bus.write(self._address, USER_CTRL, self._user_control | FIFO_ENABLE)
        self._bus.read(self._address, _INT_STATUS, 1)  # an old overflow is over
        self._reset_due = self._in_doubt = False
        self._remainder = 0

    def waiting(self) -> int:
        """Whole frames that can be read.

        Raises:
            SamplesLostError: it was full or out of step, and has been reset.
        """
        if self._reset_due:
            self.reset()
            raise SamplesLostError("FIFO emptied after a bus fault, samples lost")
        overflowed = self._overflowed()
        high, low = self._bus.read(self._address, _FIFO_COUNT, 2)
        count = (high & 0x1F) << 8 | low
        if count > FIFO_BYTES:
            raise OSError(errno.EIO, f"FIFO count {count} of {FIFO_BYTES}: the bus reads all ones")
        if overflowed or count > FIFO_BYTES - FRAME_BYTES:
            self.reset()
            raise SamplesLostError("FIFO overflow, samples lost")
        remainder, before = count % FRAME_BYTES, self._remainder
        if remainder and (self._in_doubt or remainder == before):
            after = " after a bus fault" if self._in_doubt else f" by {remainder} bytes"
            self.reset()
            raise SamplesLostError(f"FIFO out of step{after}, samples lost")
        self._in_doubt, self._remainder = False, remainder
        return count // FRAME_BYTES

    def read(self, frames: int) -> bytes:
        """The oldest `frames` >= 1 frames; fewer, but at least one, when the bus fails in between."""
        data, length = b"", frames * FRAME_BYTES
        try:
            while len(data) < length:
                data += self._burst(min(_FIFO_BURST_BYTES, length - len(data)))
        except OSError:
            self._in_doubt = True
            if not data:
                raise
        return data

    def _overflowed(self) -> bool:
        """Whether it was full since the last look; reading clears the chip's flag."""
        try:
            status = self._bus.read(self._address, _INT_STATUS, 1)[0]
        except OSError:
            self._in_doubt = True  # the flag may be gone
            raise
        if status == 0xFF:
            raise OSError(errno.EIO, "the interrupt status reads all ones")
        return bool(status & FIFO_OVERFLOW)

    def _burst(self, length: int) -> bytes:
        data = self._bus.read(self._address, _FIFO_R_W, length)
        if data[-FRAME_BYTES:] == b"\xff" * FRAME_BYTES:
            raise OSError(errno.EIO, "the FIFO reads all ones")
        return data


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
        self._bus.write(self._address, USER_CTRL, self._user_control)
        self._sample = b""

    def waiting(self) -> int:
        """1 when there is a sample that has not been read, else 0. Reading clears the chip's flag.

        Raises:
            SensorError: the chip has lost its settings.
        """
        data = self._bus.read(self._address, _INT_STATUS, _OUTPUT_BURST_BYTES)
        if data == b"\xff" * _OUTPUT_BURST_BYTES:
            raise OSError(errno.EIO, "the output registers read all ones")
        if not data[0] & _RAW_DATA_READY:
            return 0
        settings = self._bus.read(self._address, SMPLRT_DIV, len(self._settings))
        if settings != self._settings:
            raise SensorError(f"settings lost: {settings.hex()} instead of {self._settings.hex()}")
        self._sample = data[1:]
        return 1

    def read(self, frames: int) -> bytes:
        """The sample that `waiting` has found; `frames` is 1."""
        return self._sample * frames
