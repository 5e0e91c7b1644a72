"""The receiver's baud rate: found, moved to the wanted one, found again. On lines that garble bytes."""

import asyncio
import contextlib
from collections.abc import Callable

import numpy as np
import pytest

from companion.base.clock import Clock, run_in_virtual_time
from companion.base.geometry import Vector3
from companion.base.messages import GpsFix
from companion.config import GpsConfig
from companion.sense.gps.baud_rate import CHANGES, LISTEN_S, BaudRate
from companion.sense.gps.commands import configuration, port_command
from companion.sense.gps.neo6m import Neo6m
from companion.sense.serial_port import SerialPort
from sitl.devices.neo6m import Neo6mDevice
from sitl.devices.ports import AppEnd, MemoryPort, PtyPort
from sitl.devices.uart import as_received
from sitl.sensors.sensors import NO_GPS_ERRORS, GpsSensor

HOME: Vector3 = (47.0, 8.0, 400.0)
STILL: Vector3 = (0.0, 0.0, 0.0)
RATES = [4800, 9600, 19200, 38400, 57600, 115200]


class BaudRateRig:
    """Receiver, line and driver; the app's loops as in `companion.app.sensing`."""

    def __init__(
        self, wake_baud: int, config: GpsConfig, line: MemoryPort | PtyPort, port: AppEnd | SerialPort
    ):
        self.device = Neo6mDevice(GpsSensor(NO_GPS_ERRORS, np.random.default_rng(1), HOME), 0.12, wake_baud)
        self.driver = Neo6m(config)
        self.fixes: list[GpsFix] = []
        self.problems: list[str] = []
        self._line, self._port = line, port
        self._clock = Clock()

    async def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        tasks = [asyncio.create_task(loop()) for loop in (self._world, self._listen, self._configure)]
        end_s = self._clock.now_s() + seconds
        while self._clock.now_s() < end_s and not until():  # noqa: ASYNC110 - any condition will do
            await asyncio.sleep(0.01)
        for task in tasks:
            task.cancel()
        for task in tasks:
            with contextlib.suppress(asyncio.CancelledError):
                await task

    async def _world(self) -> None:
        while True:
            self.device.receive(self._line.receive())
            self._line.set_baud(self.device.baud)
            self._line.send(self.device.step(self._clock.now_s(), STILL, STILL))
            await asyncio.sleep(0.01)

    async def _listen(self) -> None:
        while True:
            data = await self._port.read()
            self.fixes += self.driver.feed(data, self._clock.now_s())

    async def _configure(self) -> None:
        while True:
            question = self.driver.pending(self._clock.now_s())
            if (problem := self.driver.problem) is not None and problem not in self.problems:
                self.problems.append(problem)
            self._port.set_baud(self.driver.baud)
            self._port.write(question)
            await asyncio.sleep(0.2)


def virtual(wake_baud: int, baud: int, script: Callable[[BaudRateRig], object]) -> BaudRateRig:
    """Run `script(rig)`, a coroutine, in virtual time."""

    async def main() -> BaudRateRig:
        line = MemoryPort(baud)
        line.set_baud(wake_baud)
        rig = BaudRateRig(wake_baud, GpsConfig.model_validate({"baud": baud}), line, line.app)
        await script(rig)  # type: ignore[misc]
        return rig

    return run_in_virtual_time(main())


# ---------------------------------------------------------------- the rate itself


@pytest.mark.parametrize("baud", [9600, 38400, 115200])
@pytest.mark.parametrize("wake_baud", RATES)
def test_whatever_the_receiver_talks_at_it_ends_at_the_wanted_rate_with_five_fixes_a_second(
    wake_baud: int, baud: int
) -> None:
    rig = virtual(wake_baud, baud, lambda rig: rig.run(26.0, lambda: rig.driver.configured))
    assert rig.driver.configured
    assert rig.device.baud == rig.driver.baud == baud

    rig = virtual(wake_baud, baud, lambda rig: rig.run(30.0))
    newest = [fix for fix in rig.fixes if fix.time_s > rig.fixes[-1].time_s - 2.0]
    assert len(newest) == 10


def test_a_receiver_without_settings_is_at_the_wanted_rate_within_seconds() -> None:
    async def script(rig: BaudRateRig) -> None:
        await rig.run(8.0, lambda: rig.device.baud == 38400)
        assert rig._clock.now_s() < 4.0

    virtual(9600, 38400, script)


def test_a_power_cut_takes_the_receiver_back_to_9600_and_it_is_found_again() -> None:
    async def script(rig: BaudRateRig) -> None:
        await rig.run(10.0)
        rig.device.power_cycle()
        assert rig.device.baud == 9600
        rig.fixes.clear()
        await rig.run(15.0)

    rig = virtual(9600, 38400, script)
    assert rig.device.baud == 38400
    assert rig.driver.configured
    assert rig.fixes[-1].time_s > 24.0


def test_a_receiver_that_says_nothing_unasked_is_found_by_asking() -> None:
    """All its output switched off, as in another's saved settings."""

    async def script(rig: BaudRateRig) -> None:
        rig.device._rates = dict.fromkeys(rig.device._rates, 0)
        await rig.run(40.0)

    rig = virtual(57600, 38400, script)
    assert rig.device.baud == 38400
    assert rig.driver.configured
    assert rig.fixes


def test_a_receiver_that_does_not_change_its_rate_serves_at_the_one_it_has() -> None:
    """One that speaks NMEA alone, say."""

    async def script(rig: BaudRateRig) -> None:
        rig.device.receive = lambda data: None  # type: ignore[method-assign]
        await rig.run(60.0)

    rig = virtual(9600, 38400, script)
    assert rig.driver.baud == 9600
    assert rig.fixes[-1].time_s > 58.0
    assert "NEO-6M: stays at 9600 baud, asked for 38400" in rig.problems


def test_a_silent_line_is_reported_and_tried_at_all_rates() -> None:
    tried: set[int] = set()

    async def script(rig: BaudRateRig) -> None:
        rig.device.silent = True

        def note() -> bool:
            tried.add(rig.driver.baud)
            return False

        await rig.run(30.0, note)

    rig = virtual(9600, 38400, script)
    assert tried == {*RATES, 230400, 460800}
    assert rig.problems == ["NEO-6M: nothing received: check its power and wiring"]


@pytest.mark.slow
async def test_it_works_on_a_pseudo_terminal_in_real_time() -> None:
    line = PtyPort(9600)
    port = SerialPort(line.path, 57600)
    rig = BaudRateRig(9600, GpsConfig(baud=57600), line, port)
    await rig.run(15.0, lambda: rig.device.baud == 57600 and rig.driver.configured)
    assert rig.device.baud == rig.driver.baud == 57600
    assert rig.driver.configured
    port.close()
    line.close()


def test_a_rate_with_messages_is_not_left() -> None:
    rate = BaudRate(38400)
    for k in range(500):
        assert not rate.step(0.1 * k, 0.1 * k - 0.05)
        assert rate.baud == 38400


def test_after_so_many_changes_in_vain_the_receiver_is_left_where_it_is() -> None:
    rate, asked, message_s, now_s = BaudRate(38400), 0, -1.0, 0.0
    while rate.wanted == 38400 and now_s < 200.0:
        asked += rate.step(now_s, message_s)
        if rate.baud == 9600:
            message_s = now_s + 0.05
        now_s += 0.2
    assert rate.baud == rate.wanted == 9600
    assert asked >= CHANGES


def test_one_rate_is_listened_to_for_longer_than_a_receivers_second() -> None:
    rate, at = BaudRate(38400), []
    for k in range(40):
        rate.step(0.1 * k, -1.0)
        at.append(rate.baud)
    assert at.count(38400) > 10
    assert LISTEN_S > 1.0
    assert at.index(9600) == pytest.approx(10 * LISTEN_S, abs=1)


# ---------------------------------------------------------------- what is sent


def test_the_port_command_is_the_protocols() -> None:
    """CFG-PRT for UART 1: 8N1 (0x8D0), the rate, UBX and NMEA in and out."""
    assert port_command(38400)[:24] == bytes.fromhex(
        "b562 0600 1400 01 00 0000 d0080000 00960000 0300 0300 0000"
    )


@pytest.mark.parametrize(("baud", "rate"), [(9600, 5), (19200, 1), (38400, 1), (115200, 1)])
def test_what_is_asked_for_fits_the_line(baud: int, rate: int) -> None:
    """At 9600 baud status and dilution come once a second: 190 bytes five times would leave nothing over."""
    commands = configuration(GpsConfig(), baud)
    rates = {
        command[7]: command[9] for command in commands if command[2:4] == b"\x06\x01" and command[6] == 1
    }
    assert rates == {0x02: 1, 0x12: 1, 0x06: 1, 0x03: rate, 0x04: rate}
    sizes = {0x02: 36, 0x12: 44, 0x06: 60, 0x03: 24, 0x04: 26}
    bytes_a_second = sum(5 / every * sizes[message] for message, every in rates.items())
    assert bytes_a_second < 0.8 * baud / 10


# ---------------------------------------------------------------- the line


@pytest.mark.parametrize("baud", RATES)
def test_at_one_rate_everything_is_heard_as_it_was_sent(baud: int) -> None:
    assert as_received(bytes(range(256)), baud, baud) == bytes(range(256))


@pytest.mark.parametrize("sent", RATES)
@pytest.mark.parametrize("heard", RATES)
def test_at_different_rates_nothing_is(sent: int, heard: int) -> None:
    text = b"$GPRMC,191418.00,V,,,,,,,040712,,,N*79\r\n"
    if sent != heard:
        assert b"$GPRMC" not in as_received(text, sent, heard)


@pytest.mark.parametrize(
    ("sent", "heard", "expected"),
    [
        # 0x55 is 0 10101010 1 on the line; seen twice as fast: 0 01100110 0, a framing error, then the rest
        (9600, 19200, "00e6"),
        # and so slowly that the byte is over within the start bit
        (115200, 9600, "ff"),
    ],
)
def test_garbage_is_the_waveform_seen_at_the_wrong_rate(sent: int, heard: int, expected: str) -> None:
    assert as_received(b"\x55", sent, heard) == bytes.fromhex(expected)
