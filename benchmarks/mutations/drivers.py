"""The sensors' drivers under spoilt inputs: registers and FIFO of the IMU, the lines of GPS and ultrasonic.

Each target is an endless iterator: a step gives one spoilt input to the driver, and raises what the driver
should not have raised. What comes out has to be finite.
"""

from __future__ import annotations

import errno
import math
import random
from collections.abc import Iterator
from functools import partial
from typing import Any, Final

import numpy as np

from benchmarks.mutations.mutating import spoiled
from companion.base.geometry import GRAVITY_M_S2
from companion.config import GpsConfig, ImuConfig, RangeConfig
from companion.sense.gps.neo6m import Neo6m
from companion.sense.imu.i2c import SensorError
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.range.spike_filter import SpikeFilter
from companion.sense.range.ultrasonic import Ultrasonic
from companion.sense.range.us100 import Us100
from sitl.devices.ak8963 import Ak8963Device
from sitl.devices.mpu9250 import Mpu9250Device
from sitl.devices.neo6m import nmea, ubx
from sitl.sensors.inertial import NO_IMU_ERRORS, ImuSensor
from sitl.sensors.sensors import MagErrors, MagSensor

STEP_S: Final = 0.01
NEW_AFTER: Final = 2000  # inputs; then the next kind of wiring or receiver, from its start
_WIRINGS: Final = (
    {"read": "fifo", "mag_path": "master"},
    {"read": "fifo", "mag_path": "bypass"},
    {"read": "registers", "poll_hz": 200, "mag_path": "master"},
    {"read": "registers", "poll_hz": 200, "mag_path": "bypass"},
)


class NotFiniteError(ArithmeticError):
    """What came out is no number, or infinite."""


def check_finite(*values: float) -> None:
    """Raise NotFiniteError unless all are finite."""
    if not all(map(math.isfinite, values)):
        raise NotFiniteError(f"{values}")


class SpoiltBus:
    """A chip behind a bus that garbles every `one_in`-th read, and fails now and then."""

    def __init__(self, device: Mpu9250Device, rng: random.Random) -> None:
        self._device, self._rng = device, rng
        self.one_in = 3
        self.spoilt = 0

    def read(self, address: int, register: int, length: int) -> bytes:
        """As many bytes as were asked for, of whatever kind."""
        data, rng = self._device.read(address, register, length), self._rng
        if rng.randrange(self.one_in):
            return data
        self.spoilt += 1
        kind = rng.randrange(6)
        if kind == 0:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        if kind == 1:
            return bytes((rng.choice((0x00, 0xFF)),)) * length
        if kind == 2:
            return rng.randbytes(length)
        return spoiled(rng, data)[:length].ljust(length, b"\xff")

    def write(self, address: int, register: int, value: int) -> None:
        """Write, or not."""
        if not self._rng.randrange(50):
            raise OSError(errno.ETIMEDOUT, "Connection timed out")
        self._device.write(address, register, value)


def imu(rng: random.Random) -> Iterator[None]:
    """The MPU9250 and its magnetometer over each wiring."""
    while True:
        for wiring in _WIRINGS:
            config = ImuConfig.model_validate(wiring)
            noise = np.random.default_rng(rng.randrange(2**32))
            sensor = ImuSensor(NO_IMU_ERRORS, noise, STEP_S, np.eye(3))
            device = Mpu9250Device(sensor, Ak8963Device(MagSensor(MagErrors(), noise, np.eye(3))))
            bus = SpoiltBus(device, rng)
            yield from _imu(device, Mpu9250(bus, config), bus, rng)


def _imu(device: Mpu9250Device, driver: Mpu9250, bus: SpoiltBus, rng: random.Random) -> Iterator[None]:
    now_s, spoilt = 0.0, 0
    rest = (0.0, 0.0, -GRAVITY_M_S2)
    for _ in range(20 * NEW_AFTER):
        now_s += STEP_S
        bus.one_in = 3 if driver.ready else 30  # else it would never come up
        device.step(now_s, rest, (0.0, 0.0, 0.0), (20.9, 0.6, 42.9), 0.0)
        try:
            samples, fields = driver.poll(partial(float, now_s))
        except SensorError:
            samples, fields = [], []
        for sample in samples:
            check_finite(sample.time_s, *sample.rate_body_rad_s, *sample.specific_force_body_m_s2)
        for field in fields:
            check_finite(field.time_s, *field.field_body_ut)
        for _ in range(bus.spoilt - spoilt):
            yield
        spoilt = bus.spoilt
        if spoilt >= NEW_AFTER:
            return


# ---------------------------------------------------------------- GPS


def _gps_messages(rng: random.Random, k: int) -> list[bytes]:
    """One epoch as UBX and as NMEA, and an acknowledgement."""
    week_ms = (1000 * k + rng.randrange(3)) % 604_800_000
    head = week_ms.to_bytes(4, "little")
    time = f"{k // 3600 % 24:02d}{k // 60 % 60:02d}{k % 60:02d}.00"
    return [
        ubx(0x01, 0x02, head + rng.randbytes(24)),
        ubx(0x01, 0x03, head + bytes((3, 0xDD)) + bytes(10)),
        ubx(0x01, 0x04, head + rng.randbytes(14)),
        ubx(0x01, 0x06, head + bytes(4) + b"\x00\x00\x03\xdd" + rng.randbytes(40)),
        ubx(0x01, 0x12, head + rng.randbytes(32)),
        ubx(0x05, rng.randrange(2), bytes((6, rng.randrange(64)))),
        nmea(f"GPRMC,{time},A,4724.00000,N,00832.00000,E,0.5,120.0,011123,,,A"),
        nmea(f"GPGGA,{time},4724.00000,N,00832.00000,E,1,08,1.0,400.0,M,48.0,M,,"),
        nmea("GPGSA,A,3,01,02,03,04,05,06,07,08,,,,,1.8,1.0,1.5"),
    ]


def _again_whole(rng: random.Random, message: bytes) -> bytes:
    """A message with its content spoilt, and a check sum that fits."""
    if message[:1] == b"$":
        fields = message[1 : message.index(b"*")].split(b",")
        at = rng.randrange(len(fields))
        match rng.randrange(4):
            case 0:
                del fields[at:]
            case 1:
                odd = (b"", b"inf", b"nan", b"-1", b"9" * 40, b"1e400", b"A", b"\x00", b"240000.00", b"99")
                fields[at] = rng.choice(odd)
            case 2:
                fields[at] = spoiled(rng, fields[at])
            case _:
                fields.insert(at, fields[at])
        body = b",".join(fields)
        total = 0
        for value in body:
            total ^= value
        return b"$" + body + b"*%02X\r\n" % total
    payload = message[6:-2]
    return ubx(message[2], message[3], spoiled(rng, payload)[: rng.choice((len(payload), 255))])


def gps(rng: random.Random) -> Iterator[None]:
    """UBX and NMEA, spoilt on the line or by the receiver itself, in pieces of any length."""
    while True:
        kinds = rng.choice((range(6), range(6, 9), range(9)))
        receiver, now_s, k = Neo6m(GpsConfig()), 0.0, 0
        while k < NEW_AFTER:
            messages = _gps_messages(rng, k)
            stream = b""
            for kind in kinds:
                spoil = rng.random() < 0.3
                k += spoil
                message = messages[kind]
                if spoil:
                    message = (_again_whole if rng.random() < 0.7 else spoiled)(rng, message)
                stream += message
                if spoil:
                    yield
            while stream:
                size = rng.randint(1, 80)
                now_s += size / 960.0
                _take_fixes(receiver, stream[:size], now_s)
                stream = stream[size:]
            receiver.pending(now_s)


def _take_fixes(receiver: Neo6m, data: bytes, now_s: float) -> None:
    for fix in receiver.feed(data, now_s):
        check_finite(fix.time_s, fix.latitude_deg, fix.longitude_deg, fix.altitude_m, *fix.velocity_ned_m_s)


# ---------------------------------------------------------------- ultrasonic


def ultrasonic(rng: random.Random) -> Iterator[None]:
    """Both protocols, and the gate behind them."""
    while True:
        config = RangeConfig()
        drivers: tuple[Any, ...] = (Ultrasonic(config), Us100(config))
        gate, now_s = SpikeFilter(config), 0.0
        for _ in range(NEW_AFTER):
            now_s += rng.choice((0.0, 0.001, 0.05, 1.0))
            high, low = rng.randrange(20), rng.randrange(256)
            frame = bytes((0xFF, high, low, (0xFF + high + low) & 0xFF))
            for driver, data in zip(drivers, (frame, frame[1:3]), strict=True):
                driver.pending(now_s)
                for sample in driver.feed(spoiled(rng, data), now_s):
                    check_finite(sample.time_s, sample.distance_m)
                    gate.step(sample)
                driver.watch(now_s)
            yield
