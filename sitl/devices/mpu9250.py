"""The MPU9250 as registers: what the driver sees on its bus, I2C or SPI, down to a FIFO that overflows.

After RM-MPU-9250A-00 rev. 1.6: power-on values, reset, sleep, sample-rate divider, ranges (quantised and
clipped), FIFO with both full modes, the inner I2C master's slaves 0 and 4, the bypass to the magnetometer,
I2C_IF_DIS, INT_STATUS. It keeps its own time: the oscillator is off by `clock_error`, within the data sheet's
±1 %. On SPI the magnetometer is reachable through the inner I2C master only.
"""

from __future__ import annotations

import errno
import math
import struct
from typing import Final, Literal

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3
from sitl.sensors.inertial import ImuSensor
from sitl.sensors.sensors import MagSensor

FIFO_BYTES: Final = 512
Fault = Literal["none", "nack", "ones", "stuck", "saturated"]
Interface = Literal["i2c", "spi"]

_SMPLRT_DIV, _CONFIG, _GYRO_CONFIG, _ACCEL_CONFIG, _FIFO_EN = 0x19, 0x1A, 0x1B, 0x1C, 0x23
_SLV0_ADDR, _SLV0_REG, _SLV0_CTRL = 0x25, 0x26, 0x27
_SLV4_ADDR, _SLV4_REG, _SLV4_DO, _SLV4_CTRL, _SLV4_DI, _MST_STATUS = 0x31, 0x32, 0x33, 0x34, 0x35, 0x36
_INT_PIN_CFG, _INT_STATUS, _ACCEL_OUT, _EXT_SENS_DATA = 0x37, 0x3A, 0x3B, 0x49
_USER_CTRL, _PWR_MGMT_1, _FIFO_COUNT, _FIFO_R_W, _WHO_AM_I = 0x6A, 0x6B, 0x72, 0x74, 0x75

# FIFO_EN bit -> its share of the 14 bytes accelerometer, temperature, gyroscope, in register order
_FIFO_PARTS: Final = ((0x08, 0, 6), (0x80, 6, 8), (0x40, 8, 10), (0x20, 10, 12), (0x10, 12, 14))
_FIFO_ALL: Final = 0xF8
_MASTER_OR_FIFO: Final = 0x60  # USER_CTRL
_WORDS: Final = struct.Struct(">7h")
# largest number of queued steps, and how many of them stay when it is reached: one second
_MOST_QUEUED_STEPS: Final = 4000
_KEPT_STEPS: Final = 400
# time (s), specific force (m/s²), rate (rad/s), throttle
_QueuedStep = tuple[float, Vector3, Vector3, float]


class Mpu9250Device:
    """A register bus with one MPU9250 on it. Step it at the physics' rate, read and write it any time.

    The fault "nack" is a bus that fails, "ones" a line that is pulled up, "stuck" a chip that stops sampling,
    "saturated" one whose every axis is at the end of its range.

    Until its first access it does not sample: it queues the truth, which `wake` samples later. So
    sensors that are not read cost little, and a reader sees no difference.
    """

    def __init__(
        self,
        imu: ImuSensor,
        magnetometer: Ak8963Device,
        *,
        address: int = 0x68,
        interface: Interface = "i2c",
        identity: int = 0x71,
        clock_error: float = 0.003,
    ) -> None:
        self._imu = imu
        self.magnetometer = magnetometer
        self._address = address
        self._interface = interface
        self._identity = identity
        self._clock = 1.0 + clock_error
        self.temperature_c = 38.0
        self.fault: Fault = "none"
        self.nack_every = 0  # one transaction in so many is not acknowledged; 0: all are
        self._transactions = 0
        self.nacks_to_come = 0  # so many transactions are not acknowledged, as glitches on the bus make them
        self._previous: tuple[float, Vector3, Vector3] | None = None
        self._next_s = -math.inf
        self._asleep = True
        self._queued: list[_QueuedStep] = []
        self.power_cycle()

    def power_cycle(self) -> None:
        """Everything as after power-on; the driver's settings are gone."""
        self._registers = bytearray(0x80)
        self._registers[_PWR_MGMT_1] = 0x01
        self._registers[_WHO_AM_I] = self._identity
        self._fifo = bytearray()
        self.magnetometer.reset()
        self._apply_settings()

    # ------------------------------------------------------------ the world's side

    def step(
        self,
        now_s: float,
        specific_force_body_m_s2: Vector3,
        rate_body_rad_s: Vector3,
        field_body_ut: Vector3,
        throttle: float,
    ) -> None:
        """One physics step; samples by the chip's own clock.

        `field_body_ut` counts when the magnetometer's measurement is due.
        """
        self.magnetometer.step(now_s, field_body_ut, throttle)
        if self._asleep:
            self._queued.append((now_s, specific_force_body_m_s2, rate_body_rad_s, throttle))
            if len(self._queued) >= _MOST_QUEUED_STEPS:
                self._drop_old_steps()
            return
        self._sample(now_s, specific_force_body_m_s2, rate_body_rad_s, throttle)

    def wake(self) -> None:
        """Sample the queued steps, and every step from now on."""
        if not self._asleep:
            return
        self._asleep = False
        self._drop_old_steps()
        for step in self._queued:
            self._sample(*step)
        self._queued.clear()

    def _drop_old_steps(self) -> None:
        """Drop queued steps older than the filters' memory; random numbers and clock advance as if
        sampled."""
        gone = self._queued[:-_KEPT_STEPS]
        if not gone:
            return
        del self._queued[: len(gone)]
        self._imu.skip([throttle for _, _, _, throttle in gone])
        now_s = gone[-1][0]
        first_s = gone[0][0] if self._previous is None else self._next_s
        self._previous = (now_s, ZERO3, ZERO3)
        self._next_s = _next_after(now_s, first_s, self._period_s)

    def _sample(
        self, now_s: float, specific_force_body_m_s2: Vector3, rate_body_rad_s: Vector3, throttle: float
    ) -> None:
        force, rate = self._imu.sample(specific_force_body_m_s2, rate_body_rad_s, throttle)
        if self._previous is None:
            self._next_s = now_s
            self._previous = (now_s, force, rate)
        before_s, before_force, before_rate = self._previous
        self._previous = (now_s, force, rate)
        if not self._registers[_USER_CTRL] & _MASTER_OR_FIFO:
            # one sample overwrites another
            while self._next_s + self._period_s <= now_s:
                self._next_s += self._period_s
        while self._next_s <= now_s:
            # the chip samples between two steps of the physics
            share = (now_s - self._next_s) / (now_s - before_s) if now_s > before_s else 0.0
            self.push_sample(_blend(force, before_force, share), _blend(rate, before_rate, share))
            self._next_s += self._period_s

    def push_sample(self, specific_force_m_s2: Vector3, rate_rad_s: Vector3) -> None:
        """One sample, in sensor axes, into the output registers, the FIFO and the inner bus."""
        registers = self._registers
        if self.fault == "stuck" or registers[_PWR_MGMT_1] & 0x40:
            return
        ka, kg = self._accel_per_m_s2, self._gyro_per_rad_s
        ax, ay, az = specific_force_m_s2
        gx, gy, gz = rate_rad_s
        words = [round(ax * ka), round(ay * ka), round(az * ka), self._temperature_counts()]
        words += (round(gx * kg), round(gy * kg), round(gz * kg))
        if self.fault == "saturated":
            words = [32767, 32767, 32767, words[3], 32767, 32767, 32767]
        if max(words) > 32767 or min(words) < -32768:
            words = [max(-32768, min(32767, word)) for word in words]
        data = _WORDS.pack(*words)
        registers[_ACCEL_OUT : _ACCEL_OUT + 14] = data
        registers[_INT_STATUS] |= 0x01
        if registers[_USER_CTRL] & 0x20:
            self._read_slave_0()
        if registers[_USER_CTRL] & 0x40:
            self._fill_fifo(data)

    def _temperature_counts(self) -> int:
        return round((self.temperature_c - 21.0) * 333.87)

    def _fill_fifo(self, data: bytes) -> None:
        enabled = self._registers[_FIFO_EN] & _FIFO_ALL
        if enabled != _FIFO_ALL:
            data = b"".join(data[start:end] for bit, start, end in _FIFO_PARTS if enabled & bit)
        self._fifo += data
        if len(self._fifo) > FIFO_BYTES:
            self._registers[_INT_STATUS] |= 0x10
            if self._registers[_CONFIG] & 0x40:
                del self._fifo[FIFO_BYTES:]
            else:
                del self._fifo[: len(self._fifo) - FIFO_BYTES]

    def _read_slave_0(self) -> None:
        registers = self._registers
        control = registers[_SLV0_CTRL]
        if control & 0x80 and registers[_SLV0_ADDR] == 0x80 | AK8963_ADDRESS:
            if self.magnetometer.silent:
                registers[_MST_STATUS] |= 0x01
                return
            length = control & 0x0F
            data = self.magnetometer.read(registers[_SLV0_REG], length)
            registers[_EXT_SENS_DATA : _EXT_SENS_DATA + length] = data

    # ------------------------------------------------------------ the bus's side

    def read(self, address: int, register: int, length: int) -> bytes:
        """Read registers; FIFO_R_W takes from the FIFO instead of stepping on.

        Raises:
            OSError: no device at the address, or the fault "nack".
        """
        self.wake()
        self._check(address)
        if self.fault == "ones":
            return b"\xff" * length
        if address == AK8963_ADDRESS:
            return self.magnetometer.read(register, length)
        if register == _FIFO_R_W:
            data = bytes(self._fifo[:length])
            del self._fifo[:length]
            return data.ljust(length, b"\0")
        if register <= _FIFO_COUNT + 1 < register + length or register == _FIFO_COUNT:
            struct.pack_into(">H", self._registers, _FIFO_COUNT, len(self._fifo))
        data = bytes(self._registers[register : register + length]).ljust(length, b"\0")
        if register <= _INT_STATUS < register + length:
            self._registers[_INT_STATUS] = 0
        if register <= _MST_STATUS < register + length:
            self._registers[_MST_STATUS] = 0
        return data

    def write(self, address: int, register: int, value: int) -> None:
        """Write one register.

        Raises:
            OSError: no device at the address, or the fault "nack".
        """
        self.wake()
        self._check(address)
        if self.fault == "ones":
            return
        if address == AK8963_ADDRESS:
            self.magnetometer.write(register, value)
            return
        if register == _PWR_MGMT_1 and value & 0x80:
            self.power_cycle()
            return
        if register in (_WHO_AM_I, _INT_STATUS, _MST_STATUS, _FIFO_COUNT, _FIFO_COUNT + 1):
            return
        self._registers[register] = value
        if register == _USER_CTRL:
            # the reset bits clear themselves
            if value & 0x04:
                self._fifo.clear()
            self._registers[_USER_CTRL] = value & ~0x07 & 0xFF
        elif register == _SLV4_CTRL and value & 0x80:
            self._transact_slave_4()
        elif register <= _ACCEL_CONFIG:
            self._apply_settings()

    def _check(self, address: int) -> None:
        glitch = self.nacks_to_come > 0
        self.nacks_to_come -= glitch
        if self.nack_every:
            self._transactions += 1
            glitch |= self._transactions % self.nack_every == 0
        if glitch or self.fault == "nack" or not self._answers(address):
            raise OSError(errno.EREMOTEIO, "Remote I/O error")

    def _answers(self, address: int) -> bool:
        if self._interface == "spi":
            return address == self._address
        if address == AK8963_ADDRESS:
            # switched through by BYPASS_EN, while the inner master is off
            bypass, master = self._registers[_INT_PIN_CFG] & 0x02, self._registers[_USER_CTRL] & 0x20
            return bool(bypass and not master) and not self.magnetometer.silent
        return address == self._address and not self._registers[_USER_CTRL] & 0x10

    def _transact_slave_4(self) -> None:
        registers = self._registers
        if not registers[_USER_CTRL] & 0x20:
            return
        registers[_SLV4_CTRL] &= 0x7F
        slave = registers[_SLV4_ADDR]
        if slave & 0x7F != AK8963_ADDRESS or self.magnetometer.silent:
            registers[_MST_STATUS] |= 0x50
            return
        if slave & 0x80:
            registers[_SLV4_DI] = self.magnetometer.read(registers[_SLV4_REG], 1)[0]
        else:
            self.magnetometer.write(registers[_SLV4_REG], registers[_SLV4_DO])
        registers[_MST_STATUS] |= 0x40

    def _apply_settings(self) -> None:
        registers = self._registers
        dlpf = registers[_CONFIG] & 0x07
        base_hz = 1000.0 if 1 <= dlpf <= 6 else 8000.0
        self._period_s = (1 + registers[_SMPLRT_DIV]) / base_hz * self._clock
        gyro_range = math.radians(250.0) * (1 << (registers[_GYRO_CONFIG] >> 3 & 3))
        accel_range = 2.0 * GRAVITY_M_S2 * (1 << (registers[_ACCEL_CONFIG] >> 3 & 3))
        self._gyro_per_rad_s = 32768.0 / gyro_range
        self._accel_per_m_s2 = 32768.0 / accel_range
        self._imu.set_filter(dlpf)


def _next_after(now_s: float, first_s: float, period_s: float) -> float:
    """The first sample's time after now, the periods added one by one as the chip does."""
    if first_s > now_s:
        return first_s
    times_s = np.full(int((now_s - first_s) / period_s) + 3, period_s)
    times_s[0] = first_s
    times_s = np.add.accumulate(times_s)
    return float(times_s[np.searchsorted(times_s, now_s, side="right")])


def _blend(new: Vector3, old: Vector3, share_of_old: float) -> Vector3:
    keep = 1.0 - share_of_old
    return (
        keep * new[0] + share_of_old * old[0],
        keep * new[1] + share_of_old * old[1],
        keep * new[2] + share_of_old * old[2],
    )


AK8963_ADDRESS: Final = 0x0C
_WIA, _ST1, _HXL, _ST2, _CNTL1, _CNTL2, _ASAX = 0x00, 0x02, 0x03, 0x09, 0x0A, 0x0B, 0x10

# ---------------------------------------------------------------- ak8963
# After PS-MPU-9250A-01 rev. 1.1: power-down, continuous (8 and 100 Hz) and fuse-ROM modes, 16 or 14 bits,
# ST1 data-ready, ST2 overflow. Its axes are not the accelerometer's: x and y are swapped, z is opposite.

_FUSE_ROM: Final = 0x0F
_PERIOD_S: Final = {0x02: 1.0 / 8.0, 0x06: 1.0 / 100.0}
_MEASUREMENT_S: Final = 0.0072
_FULL_SCALE_UT: Final = 4912.0
_ADJUSTMENT: Final = (176, 178, 165)  # the fuse ROM's three bytes
_PER_UT: Final = [1.0 / (0.15 * ((value - 128) * 0.5 / 128.0 + 1.0)) for value in _ADJUSTMENT]


class Ak8963Device:
    """The magnetometer's registers. `silent` is a failed one: it acknowledges nothing."""

    def __init__(self, sensor: MagSensor, clock_error: float = -0.004) -> None:
        self._sensor = sensor
        self._clock = 1.0 + clock_error
        self.silent = False
        self.reset()

    def reset(self) -> None:
        """Power-on state: powered down."""
        self._registers = bytearray(0x13)
        self._registers[_WIA] = 0x48
        self._period_s: float | None = None
        self._middle_s: float | None = None
        self._measured: tuple[float, Vector3] | None = None

    def is_due(self, now_s: float) -> bool:
        """Whether it measures in a step at that time: then the field counts."""
        return self._period_s is not None and (self._middle_s is None or now_s >= self._middle_s)

    def step(self, now_s: float, field_body_ut: Vector3, throttle: float) -> None:
        """Measure when it is time to; the result shows half a measurement later."""
        if self._measured is not None and now_s >= self._measured[0]:
            self._latch(self._measured[1])
            self._measured = None
        if self._period_s is None:
            return
        if self._middle_s is None:
            self._middle_s = now_s + 0.5 * _MEASUREMENT_S
        if now_s >= self._middle_s:
            field = self._sensor.sample(field_body_ut, throttle)
            self._measured = (self._middle_s + 0.5 * _MEASUREMENT_S, field)
            self._middle_s += self._period_s

    def read(self, register: int, length: int) -> bytes:
        """Read registers; reading the data or ST2 clears data-ready."""
        data = bytes(self._registers[register : register + length]).ljust(length, b"\0")
        if register <= _ST2 and register + length > _HXL:
            self._registers[_ST1] = 0
        return data

    def write(self, register: int, value: int) -> None:
        """Write a register: CNTL1 (mode, width) and CNTL2 (reset) do something."""
        if register == _CNTL2 and value & 0x01:
            self.reset()
        elif register == _CNTL1:
            self._registers[_CNTL1] = value
            mode = value & 0x0F
            period_s = _PERIOD_S.get(mode)
            self._period_s = None if period_s is None else period_s * self._clock
            self._middle_s = self._measured = None
            fuses = bytes(_ADJUSTMENT) if mode == _FUSE_ROM else bytes(3)
            self._registers[_ASAX : _ASAX + 3] = fuses

    def _latch(self, field: Vector3) -> None:
        x, y, z = field
        sixteen_bits = self._registers[_CNTL1] & 0x10
        step = 1.0 if sixteen_bits else 0.25
        limit = 32760 if sixteen_bits else 8190
        counts = [value * k * step for value, k in zip((y, x, -z), _PER_UT, strict=True)]
        raw = [max(-limit, min(limit, round(count))) for count in counts]
        struct.pack_into("<hhh", self._registers, _HXL, *raw)
        overflow = 0x08 if abs(x) + abs(y) + abs(z) >= _FULL_SCALE_UT else 0x00
        self._registers[_ST2] = sixteen_bits | overflow
        self._registers[_ST1] = 0x01
