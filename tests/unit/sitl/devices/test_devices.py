"""The receiver, the ultrasonics and their lines as hardware, and all devices with the app's drivers."""

import asyncio
import math
import struct
from typing import Literal

import numpy as np
import pytest

from companion.base.clock import Clock
from companion.base.geometry import GRAVITY_M_S2, Vector3
from sitl.devices.mpu9250 import Ak8963Device, Mpu9250Device
from sitl.devices.neo6m import Neo6mDevice, nmea, ubx
from sitl.devices.ports import MemoryPort
from sitl.devices.ultrasonic import PolledUltrasonicDevice, UltrasonicDevice, frame
from sitl.sensors.inertial import NO_IMU_ERRORS, ImuSensor
from sitl.sensors.sensors import GpsSensor, MagSensor, RangeSensor
from tests.unit.sitl.devices.sensor_desk import FORCE, STEP_S, fly
from tests.unit.sitl.sensors.flawless import NO_GPS_ERRORS, NO_MAG_ERRORS, NO_RANGE_ERRORS
from tests.virtual_time import in_virtual_time

# ---------------------------------------------------------------- NEO-6M


STILL: Vector3 = (0.0, 0.0, 0.0)
RATE_5_HZ = ubx(6, 8, struct.pack("<HHH", 200, 1, 1))


@pytest.fixture
def receiver() -> Neo6mDevice:
    return Neo6mDevice(GpsSensor(NO_GPS_ERRORS, np.random.default_rng(1), (47.0, 8.0, 400.0)))


def listen(receiver: Neo6mDevice, seconds: float) -> bytes:
    return b"".join(receiver.step(0.01 * k, STILL, STILL) for k in range(round(seconds * 100)))


def test_the_receiver_wakes_with_nmea_once_a_second_and_fixes_come_after_their_latency(
    receiver: Neo6mDevice,
) -> None:
    said = [receiver.step(0.01 * k, STILL, STILL) for k in range(350)]
    heard = b"".join(said)
    assert heard.count(b"$GPRMC") == heard.count(b"$GPGGA") == 3
    assert b"\xb5\x62" not in heard
    assert [k for k, data in enumerate(said) if data] == [112, 212, 312]


def test_commands_are_acknowledged_or_refused_and_obeyed_and_a_damaged_one_is_not_answered(
    receiver: Neo6mDevice,
) -> None:
    receiver.receive(RATE_5_HZ[:-1] + bytes([RATE_5_HZ[-1] ^ 1]))
    assert listen(receiver, 0.1) == b""
    receiver.receive(b"noise" + ubx(6, 1, bytes((1, 2, 0, 1, 0, 0, 0, 0))))
    receiver.receive(RATE_5_HZ[:7])
    receiver.receive(RATE_5_HZ[7:])
    receiver.receive(ubx(6, 0x99, b"?"))
    heard = listen(receiver, 1.15)
    assert ubx(5, 1, b"\x06\x01") + ubx(5, 1, b"\x06\x08") + ubx(5, 0, b"\x06\x99") in heard
    assert heard.count(b"\xb5\x62\x01\x02") == 5


def test_checksums_are_the_protocols() -> None:
    assert bytes.fromhex("b56206080600c80001000100de6a") == RATE_5_HZ
    assert nmea("GPGLL,4002.10513,N,07531.20562,W,143252.00,A,A") == (
        b"$GPGLL,4002.10513,N,07531.20562,W,143252.00,A,A*7B\r\n"
    )


@pytest.mark.parametrize(("port", "baud", "obeyed"), [(1, 38400, True), (3, 38400, False), (1, 12345, False)])
def test_the_receiver_changes_its_rate_and_forgets_it_without_power(
    receiver: Neo6mDevice, port: int, baud: int, obeyed: bool
) -> None:
    receiver.receive(ubx(6, 0, struct.pack("<BBHIIHHHH", port, 0, 0, 0x8D0, baud, 3, 3, 0, 0)))
    assert receiver.baud == (baud if obeyed else 9600)
    assert ubx(5, int(obeyed), b"\x06\x00") in listen(receiver, 0.1)
    receiver.power_cycle()
    assert receiver.baud == 9600


# ---------------------------------------------------------------- ultrasonic


def echo_sensor() -> RangeSensor:
    return RangeSensor(NO_RANGE_ERRORS, np.random.default_rng(1))


def test_a_frame_leaves_when_the_echo_is_back_and_no_echo_is_a_nought() -> None:
    device = UltrasonicDevice(echo_sensor(), period_s=0.08)
    heard = [(k, data) for k in range(160) if (data := device.step(0.001 * k, 1.7))]
    # 3.4 m at 340 m/s
    assert [k for k, _ in heard] == [10, 90]
    assert heard[0][1] == frame(1.7) == bytes.fromhex("ff06a4a9")
    device = UltrasonicDevice(echo_sensor())
    assert b"".join(device.step(0.001 * k, 8.0) for k in range(60)) == bytes.fromhex("ff0000ff")


def test_a_polled_one_answers_when_it_is_asked_and_its_echo_is_back() -> None:
    device = PolledUltrasonicDevice(echo_sensor())
    assert [device.step(0.001 * k, 1.7) for k in range(50)] == [b""] * 50
    device.receive(b"\x55")
    heard = [(k, data) for k in range(50, 100) if (data := device.step(0.001 * k, 1.7))]
    assert [data for _, data in heard] == [b"\x06\xa4"]
    assert heard[0][0] == pytest.approx(60, abs=1)
    device.receive(b"\x50")
    assert device.step(0.1, 1.7) == bytes((20 + 45,))


# ---------------------------------------------------------------- the line


@in_virtual_time
async def test_bytes_take_their_time_at_the_baud_rate() -> None:
    clock = Clock()
    port = MemoryPort(9600)
    port.send(bytes(96))
    count = 0
    while count < 96:
        count += len(await port.app.read())
    assert clock.now_s() == pytest.approx(0.1)
    port.app.write(b"to the device")
    assert port.receive() == b""
    await asyncio.sleep(0.1)
    assert port.receive() == b"to the device"


@in_virtual_time
async def test_what_the_line_cannot_carry_is_lost_and_does_not_pile_up() -> None:
    # one second is let wait, and the second that began before that was full
    port = MemoryPort(9600)
    for _ in range(50):
        port.send(bytes(960))
    await asyncio.sleep(30.0)
    assert len(await port.app.read()) <= 2 * 960


@in_virtual_time
async def test_unplugging_wakes_the_reader_with_an_error() -> None:
    port = MemoryPort(9600)
    reading = asyncio.create_task(port.app.read())
    await asyncio.sleep(1.0)
    port.close()
    with pytest.raises(OSError, match="unplugged"):
        await reading
    with pytest.raises(OSError, match="unplugged"):
        port.app.write(b"x")


# ---------------------------------------------------------------- all of them, with the drivers


def test_what_the_app_gets_is_the_world_with_the_sensors_errors() -> None:
    imu, mag, fixes, echoes, _ = fly(seed=1, seconds=12.0)
    late = [s for s in imu if s.time_s > 2.0]
    assert len(late) == pytest.approx(2000, rel=0.02)
    force = np.mean([s.specific_force_body_m_s2 for s in late], axis=0)
    rate = np.mean([s.rate_body_rad_s for s in late], axis=0)
    assert force == pytest.approx(FORCE, abs=0.3)
    assert rate == pytest.approx((0.0, 0.0, 0.3), abs=0.02)
    # after 12 s at 0.3 rad/s north is 3.6 rad to the left of the nose
    newest = mag[-1].field_body_ut
    heading = math.atan2(-newest[1], newest[0]) + math.atan2(0.6, 20.9)
    assert math.remainder(heading - 0.3 * mag[-1].time_s, math.tau) == pytest.approx(0.0, abs=0.15)
    assert len([f for f in fixes if f.time_s > 8.0]) == pytest.approx(19, abs=1)
    assert np.mean([f.velocity_ned_m_s for f in fixes[-20:]], axis=0) == pytest.approx((0, 1, 0), abs=0.15)
    assert len(echoes) == pytest.approx(145, abs=10)
    assert np.median([e.distance_m for e in echoes]) == pytest.approx(1.9, abs=0.02)


def test_the_same_seed_gives_the_app_the_same_samples_to_the_bit() -> None:
    assert fly(seed=4, seconds=2.0) == fly(seed=4, seconds=2.0)
    assert fly(seed=4, seconds=2.0) != fly(seed=5, seconds=2.0)


# ----------------
# The simulated MPU9250 and its magnetometer: registers, FIFO, buses and the chip's own clock.

CHIP = 0x68


FIELD: Vector3 = (20.0, 0.0, 40.0)


def make_chip(clock_error: float = 0.0, interface: Literal["i2c", "spi"] = "i2c") -> Mpu9250Device:
    imu = ImuSensor(NO_IMU_ERRORS, np.random.default_rng(1), STEP_S, np.eye(3))
    return Mpu9250Device(imu, make_magnetometer(), clock_error=clock_error, interface=interface)


@pytest.fixture
def chip() -> Mpu9250Device:
    return make_chip()


def start_fifo(chip: Mpu9250Device, mode: int = 0x40, enable: int = 0xF8) -> None:
    for register, value in ((0x19, 4), (0x1A, mode | 2), (0x23, enable), (0x6A, 0x04), (0x6A, 0x40)):
        chip.write(CHIP, register, value)


def fifo_count(chip: Mpu9250Device) -> int:
    return int.from_bytes(chip.read(CHIP, 0x72, 2), "big")


def run(chip: Mpu9250Device, seconds: float, start_s: float = 0.0) -> None:
    for k in range(round(seconds / STEP_S)):
        chip.step(start_s + k * STEP_S, FORCE, (0.1, 0.2, 0.3), FIELD, 0.0)


def test_power_on_values_are_the_register_maps_and_nobody_answers_at_another_address(
    chip: Mpu9250Device,
) -> None:
    assert chip.read(CHIP, 0x75, 1) == b"\x71"
    assert chip.read(CHIP, 0x6B, 1) == b"\x01"
    assert chip.read(CHIP, 0x19, 5) == bytes(5)
    with pytest.raises(OSError, match="Remote I/O error"):
        chip.read(0x69, 0x75, 1)
    with pytest.raises(OSError, match="Remote I/O error"):
        chip.write(0x69, 0x6B, 0)


def test_the_output_registers_hold_the_scaled_sample_and_values_beyond_the_range_clip(
    chip: Mpu9250Device,
) -> None:
    chip.push_sample((30.0, -30.0, 0.0), (5.0, -5.0, 0.0))
    ax, ay, _, _, gx, gy, _ = struct.unpack(">7h", chip.read(CHIP, 0x3B, 14))
    assert (ax, ay, gx, gy) == (32767, -32768, 32767, -32768)
    chip.write(CHIP, 0x1B, 1 << 3)  # 500 deg/s
    chip.write(CHIP, 0x1C, 2 << 3)  # 8 g
    chip.push_sample((GRAVITY_M_S2, 0.0, -GRAVITY_M_S2), (1.0, 0.0, -1.0))
    ax, ay, az, temperature, gx, gy, gz = struct.unpack(">7h", chip.read(CHIP, 0x3B, 14))
    assert (ax, ay, az) == (4096, 0, -4096)
    # 65.5 counts a degree a second
    counts = pytest.approx(57.2958 * 65.536, abs=1)
    assert (gx, gy, -gz) == (counts, 0, counts)
    assert temperature / 333.87 + 21.0 == pytest.approx(38.0, abs=0.01)


def test_the_fifo_fills_at_the_configured_rate_and_empties_by_reading(chip: Mpu9250Device) -> None:
    start_fifo(chip)
    run(chip, 0.1)
    assert fifo_count(chip) == 20 * 14
    assert chip.read(CHIP, 0x74, 14) == chip.read(CHIP, 0x3B, 14)
    assert fifo_count(chip) == 19 * 14
    chip.write(CHIP, 0x6A, 0x44)
    assert fifo_count(chip) == 0


@pytest.mark.parametrize(("clock_error", "samples"), [(0.01, 198), (0.0, 200), (-0.01, 203)])
def test_the_chips_own_clock_sets_the_rate(clock_error: float, samples: int) -> None:
    chip = make_chip(clock_error)
    start_fifo(chip)
    count = 0
    for k in range(400):
        chip.step(k * STEP_S, FORCE, (0.0, 0.0, 0.0), FIELD, 0.0)
        count += len(chip.read(CHIP, 0x74, fifo_count(chip))) // 14
    assert count == pytest.approx(samples, abs=1)


@pytest.mark.parametrize(("mode", "first"), [(0x40, 0), (0x00, 1)])
def test_a_full_fifo_stops_or_forgets_the_oldest_and_says_so(
    chip: Mpu9250Device, mode: int, first: int
) -> None:
    start_fifo(chip, mode)
    for k in range(37):
        chip.push_sample((0.01 * k, 0.0, 0.0), STILL)
    assert fifo_count(chip) == 512
    assert chip.read(CHIP, 0x3A, 1)[0] & 0x10
    assert not chip.read(CHIP, 0x3A, 1)[0] & 0x10
    start = chip.read(CHIP, 0x74, 2)
    # 37 frames are 518 bytes: the last six are missing, or the first six (one accelerometer)
    assert (start == bytes(2)) == (first == 0)


def test_only_what_is_enabled_goes_into_the_fifo(chip: Mpu9250Device) -> None:
    start_fifo(chip, enable=0x08)
    chip.push_sample((1.0, 2.0, 3.0), STILL)
    assert chip.read(CHIP, 0x74, 6) == chip.read(CHIP, 0x3B, 6)
    assert fifo_count(chip) == 0


def test_reset_forgets_every_setting_and_a_sleeping_chip_does_not_sample(chip: Mpu9250Device) -> None:
    start_fifo(chip)
    run(chip, 0.05)
    chip.write(CHIP, 0x6B, 0x80)
    assert chip.read(CHIP, 0x19, 2) == bytes(2)
    assert fifo_count(chip) == 0
    assert chip.read(CHIP, 0x6B, 1) == b"\x01"
    start_fifo(chip)
    chip.write(CHIP, 0x6B, 0x40)
    run(chip, 0.05, 0.05)
    assert fifo_count(chip) == 0


@pytest.mark.parametrize(
    ("interface", "pin_cfg", "user_ctrl", "at", "answer"),
    [
        ("i2c", 0x00, 0x00, (0x0C, 0x00), None),
        ("i2c", 0x02, 0x00, (0x0C, 0x00), b"\x48"),
        ("i2c", 0x02, 0x20, (0x0C, 0x00), None),  # the inner master owns the lines
        ("spi", 0x02, 0x00, (0x0C, 0x00), None),  # there is no I2C to be on
        ("i2c", 0x00, 0x10, (CHIP, 0x75), None),  # I2C is switched off
        ("spi", 0x00, 0x10, (CHIP, 0x75), b"\x71"),
    ],
)
def test_the_magnetometer_is_on_our_bus_with_the_bypass_alone_and_without_i2c_nobody_is(
    interface: Literal["i2c", "spi"], pin_cfg: int, user_ctrl: int, at: tuple[int, int], answer: bytes | None
) -> None:
    chip = make_chip(interface=interface)
    chip.write(CHIP, 0x37, pin_cfg)
    chip.write(CHIP, 0x6A, user_ctrl)
    if answer is not None:
        assert chip.read(*at, 1) == answer
        return
    with pytest.raises(OSError, match="Remote I/O error"):
        chip.read(*at, 1)


def readings(mag: Ak8963Device, seconds: float) -> int:
    """How many come in that time."""
    ready = 0
    for k in range(round(seconds / STEP_S)):
        mag.step(k * STEP_S, FIELD, 0.0)
        ready += mag.read(0x02, 1)[0] & 1
        mag.read(0x03, 7)
    return ready


def make_magnetometer() -> Ak8963Device:
    return Ak8963Device(MagSensor(NO_MAG_ERRORS, np.random.default_rng(1), np.eye(3)), clock_error=0.0)


@pytest.fixture
def mag() -> Ak8963Device:
    return make_magnetometer()


@pytest.mark.parametrize(("mode", "expected"), [(0x16, 100), (0x12, 8)])
def test_it_sleeps_until_it_is_told_to_measure_and_continuous_modes_have_their_rates(
    mag: Ak8963Device, mode: int, expected: int
) -> None:
    assert mag.read(0x00, 1) == b"\x48"
    assert readings(mag, 0.1) == 0
    mag.write(0x0A, mode)
    assert readings(mag, 1.0) == pytest.approx(expected, abs=1)


def test_fuses_are_readable_in_their_mode_alone(mag: Ak8963Device) -> None:
    assert mag.read(0x10, 3) == bytes(3)
    mag.write(0x0A, 0x0F)
    assert mag.read(0x10, 3) == bytes((176, 178, 165))


def test_the_field_is_in_the_magnetometers_own_axes_and_adjusted_and_overflows(mag: Ak8963Device) -> None:
    mag.write(0x0A, 0x16)
    for k in range(8):
        mag.step(k * STEP_S, (20.0, -10.0, 40.0), 0.0)
    status, x, y, z, status_2 = struct.unpack("<BhhhB", mag.read(0x02, 8))
    per_count = [0.15 * ((a - 128) * 0.5 / 128 + 1) for a in (176, 178, 165)]
    assert (status, status_2) == (0x01, 0x10)
    assert (x * per_count[0], y * per_count[1], z * per_count[2]) == pytest.approx(
        (-10.0, 20.0, -40.0), abs=0.1
    )
    for k in range(8, 16):
        mag.step(k * STEP_S, (4000.0, 2000.0, 0.0), 0.0)
    assert mag.read(0x09, 1)[0] & 0x08
