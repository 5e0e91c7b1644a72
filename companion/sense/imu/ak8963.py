"""The AK8963 magnetometer inside the MPU9250, by whichever way it is reached (`ak8963_path`).

Registers, the sensitivity adjustment and the axes are those of the MPU-9250 product specification
PS-MPU-9250A-01 rev. 1.1 (section 9.1 for the axes), the register map RM-MPU-9250A-00 rev. 1.6 and the AK8963
data sheet MS1356-E-02.

The bring-up is a generator that yields the seconds to wait before it goes on, so that it needs no clock.
A magnetometer that fails costs nothing but its own samples: it is brought up anew beside the running IMU.
"""

import math
import struct
from typing import Final

from companion.base.geometry import Vector3
from companion.sense.imu.ak8963_path import MagPath, Waits
from companion.sense.imu.i2c import SensorError

MICROTESLA_PER_LSB: Final = 0.15  # at 16 bits

# registers
_WIA, _CNTL1, _CNTL2, _ASAX = 0x00, 0x0A, 0x0B, 0x10
_IDENTITY: Final = 0x48
_POWER_DOWN: Final = 0x00
_FUSE_ROM: Final = 0x0F
_SIXTEEN_BITS: Final = 0x10
_CONTINUOUS: Final = {8: 0x02, 100: 0x06}
_DATA_READY: Final = 0x01
_SAME_MOST: Final = 10  # noise spans several steps: more of the same in a row is an old block, read again
_OVERFLOW: Final = 0x08

_RETRY_S: Final = 0.5
_SILENT_S: Final = 1.0

_BLOCK: Final = struct.Struct("<BhhhB")  # unlike the MPU9250, the AK8963 is little-endian


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

    `problem` says in one line why there are no samples; None when there are.
    """

    def __init__(self, path: MagPath, rate_hz: int) -> None:
        self._path = path
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
            copied: whether the MPU9250 has sampled, and so its master copied the block, since the last poll.
        """
        try:
            if self._bring_up is not None:
                self._continue(self._bring_up, now_s)
                return None
            block = self._path.block(copied)
            if block is None:
                return None
            decoded = self.decode(block)
        except SensorError as error:
            self._fail(str(error), now_s)
            return None
        except OSError as error:
            # one transaction that fails while samples flow costs one sample
            if self._bring_up is None:
                self._watch(False, now_s)
            else:
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
        yield from self._path.open()
        yield from self._path.write(_CNTL2, 0x01)
        yield 0.01
        identity = yield from self._path.read(_WIA)
        if identity != _IDENTITY:
            raise SensorError(f"AK8963: identity 0x{identity:02x}, expected 0x{_IDENTITY:02x}")
        yield from self._read_adjustment()
        yield from self._path.write(_CNTL1, _SIXTEEN_BITS | _CONTINUOUS[self._rate_hz])
        yield 0.01
        self._path.start()
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
        # The master copies the block more often than we read it, and the copy after the one marked "ready"
        # holds the same data unmarked: what differs from the last is new as well. A dead sensor leaves its
        # last block standing, mark and all.
        self._same_blocks = self._same_blocks + 1 if (x, y, z) == self._last_axes else 0
        if self._same_blocks > (_SAME_MOST if ready else 0):
            return None
        self._last_axes = (x, y, z)
        kx, ky, kz = self._scale
        # magnetometer x is the accelerometer's y, y its x, z points the other way
        return (ky * y, kx * x, -kz * z), ready

    def _read_adjustment(self) -> Waits:
        yield from self._path.write(_CNTL1, _FUSE_ROM)
        yield 0.01
        values = []
        for axis in range(3):
            value = yield from self._path.read(_ASAX + axis)
            values.append(value)
        if set(values) <= {0x00, 0xFF}:
            raise SensorError(f"AK8963: sensitivity adjustment 0x{bytes(values).hex()} is none")
        x, y, z = (MICROTESLA_PER_LSB * ((value - 128) * 0.5 / 128.0 + 1.0) for value in values)
        self._scale = (x, y, z)
        yield from self._path.write(_CNTL1, _POWER_DOWN)
        yield 0.01
