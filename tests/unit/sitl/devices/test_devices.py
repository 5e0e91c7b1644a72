"""The receiver, the ultrasonics and their lines as hardware, and all devices with the app's drivers."""

import asyncio
import math
import struct

import numpy as np
import pytest

from companion.base.clock import Clock, run_in_virtual_time
from sitl.devices.neo6m import Neo6mDevice, nmea, ubx
from sitl.devices.ports import MemoryPort
from sitl.devices.ultrasonic import PolledUltrasonicDevice, UltrasonicDevice, frame
from sitl.sensors.sensors import (
    NO_GPS_ERRORS,
    NO_RANGE_ERRORS,
    GpsSensor,
    RangeSensor,
)
from tests.unit.sitl.devices.sensor_desk import FORCE, fly

# ---------------------------------------------------------------- NEO-6M


def make_receiver() -> Neo6mDevice:
    return Neo6mDevice(GpsSensor(NO_GPS_ERRORS, np.random.default_rng(1), (47.0, 8.0, 400.0)))


def listen(receiver: Neo6mDevice, seconds: float, start_s: float = 0.0) -> bytes:
    still = (0.0, 0.0, 0.0)
    return b"".join(receiver.step(start_s + 0.01 * k, still, still) for k in range(round(seconds * 100)))


def test_the_receiver_wakes_with_nmea_once_a_second() -> None:
    heard = listen(make_receiver(), 3.5)
    assert heard.count(b"$GPRMC") == heard.count(b"$GPGGA") == 3
    assert b"\xb5\x62" not in heard


def test_fixes_come_after_their_latency() -> None:
    receiver = make_receiver()
    heard = [k for k in range(250) if receiver.step(0.01 * k, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))]
    assert heard == [112, 212]


def test_commands_are_acknowledged_or_refused_and_obeyed() -> None:
    receiver = make_receiver()
    receiver.receive(b"noise" + ubx(6, 1, bytes((1, 2, 0, 1, 0, 0, 0, 0))))
    receiver.receive(ubx(6, 8, struct.pack("<HHH", 200, 1, 1))[:7])
    receiver.receive(ubx(6, 8, struct.pack("<HHH", 200, 1, 1))[7:])
    receiver.receive(ubx(6, 0x99, b"?"))
    heard = listen(receiver, 1.15)
    assert ubx(5, 1, b"\x06\x01") + ubx(5, 1, b"\x06\x08") + ubx(5, 0, b"\x06\x99") in heard
    assert heard.count(b"\xb5\x62\x01\x02") == 5


def test_a_damaged_command_is_not_answered() -> None:
    receiver = make_receiver()
    command = bytearray(ubx(6, 8, struct.pack("<HHH", 200, 1, 1)))
    command[-1] ^= 1
    receiver.receive(bytes(command))
    assert listen(receiver, 0.1) == b""


def test_checksums_are_the_protocols() -> None:
    assert ubx(6, 8, struct.pack("<HHH", 200, 1, 1)) == bytes.fromhex("b56206080600c80001000100de6a")
    assert nmea("GPGLL,4002.10513,N,07531.20562,W,143252.00,A,A") == (
        b"$GPGLL,4002.10513,N,07531.20562,W,143252.00,A,A*7B\r\n"
    )


@pytest.mark.parametrize(("port", "baud", "obeyed"), [(1, 38400, True), (3, 38400, False), (1, 12345, False)])
def test_the_receiver_changes_its_rate_and_forgets_it_without_power(
    port: int, baud: int, obeyed: bool
) -> None:
    receiver = make_receiver()
    receiver.receive(ubx(6, 0, struct.pack("<BBHIIHHHH", port, 0, 0, 0x8D0, baud, 3, 3, 0, 0)))
    assert receiver.baud == (baud if obeyed else 9600)
    assert ubx(5, int(obeyed), b"\x06\x00") in listen(receiver, 0.1)
    receiver.power_cycle()
    assert receiver.baud == 9600


# ---------------------------------------------------------------- ultrasonic


def test_a_frame_leaves_when_the_echo_is_back() -> None:
    device = UltrasonicDevice(RangeSensor(NO_RANGE_ERRORS, np.random.default_rng(1)), period_s=0.08)
    heard = [(k, data) for k in range(160) if (data := device.step(0.001 * k, 1.7))]
    # 3.4 m at 340 m/s
    assert [k for k, _ in heard] == [10, 90]
    assert heard[0][1] == frame(1.7) == bytes.fromhex("ff06a4a9")


def test_no_echo_is_a_nought() -> None:
    device = UltrasonicDevice(RangeSensor(NO_RANGE_ERRORS, np.random.default_rng(1)))
    heard = b"".join(device.step(0.001 * k, 8.0) for k in range(60))
    assert heard == bytes.fromhex("ff0000ff")


def test_a_polled_one_answers_when_it_is_asked_and_its_echo_is_back() -> None:
    device = PolledUltrasonicDevice(RangeSensor(NO_RANGE_ERRORS, np.random.default_rng(1)))
    assert [device.step(0.001 * k, 1.7) for k in range(50)] == [b""] * 50
    device.receive(b"\x55")
    heard = [(k, data) for k in range(50, 100) if (data := device.step(0.001 * k, 1.7))]
    assert [data for _, data in heard] == [b"\x06\xa4"]
    assert heard[0][0] == pytest.approx(60, abs=1)
    device.receive(b"\x50")
    assert device.step(0.1, 1.7) == bytes((20 + 45,))


# ---------------------------------------------------------------- the line


def test_bytes_take_their_time_at_the_baud_rate() -> None:
    async def main() -> None:
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

    run_in_virtual_time(main())


def test_what_the_line_cannot_carry_is_lost_and_does_not_pile_up() -> None:
    async def main() -> int:
        port = MemoryPort(9600)
        for _ in range(50):
            port.send(bytes(960))
        await asyncio.sleep(30.0)
        return len(await port.app.read())

    # one second is let wait, and the second that began before that was full
    assert run_in_virtual_time(main()) <= 2 * 960


def test_unplugging_wakes_the_reader_with_an_error() -> None:
    async def main() -> None:
        port = MemoryPort(9600)
        reading = asyncio.create_task(port.app.read())
        await asyncio.sleep(1.0)
        port.close()
        with pytest.raises(OSError, match="unplugged"):
            await reading
        with pytest.raises(OSError, match="unplugged"):
            port.app.write(b"x")

    run_in_virtual_time(main())


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
