"""The ultrasonic on GPIO pins: gpiozero's mock pins, driven as an HC-SR04 drives them."""

import asyncio
import os
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from gpiozero.pins.mock import MockFactory, MockPin
from gpiozero.pins.pi import PiPin

from companion.base.clock import Clock
from companion.config import ConfigError, RangeConfig, validate
from companion.sense.imu.i2c import SensorError
from companion.sense.range.echo_pins import EchoPins
from companion.sense.range.range_finder import EchoRange, make_range_finder

TRIGGER, ECHO = 23, 24
CONFIG = RangeConfig(kind="gpio", trigger_pin=TRIGGER, echo_pin=ECHO, rate_hz=16.0)
SOUND_M_S = 331.3 + 0.606 * 20.0


class TimedPin(MockPin):  # type: ignore[misc]
    """A mock pin whose edges are stamped by the factory, as a Raspberry Pi's are by the kernel."""

    def _call_when_changed(self) -> None:
        PiPin._call_when_changed(self, self.factory.now, self._state)


class TriggerPin(TimedPin):
    """Tells when its pulse ends: that is when an HC-SR04 pings."""

    def _set_state(self, value: int) -> None:
        was = self._state
        super()._set_state(value)
        if was and not value and self.factory.on_ping is not None:
            self.factory.on_ping()


class Sensor(MockFactory):  # type: ignore[misc]
    """Pins with an HC-SR04 on them. `echo_s` is how long the echo pin stays high."""

    def __init__(self) -> None:
        super().__init__(pin_class=TimedPin)
        self.now = 5000.0  # its ticks have nothing to do with the app's clock
        self.echo_s: float | None = 0.01
        self.pings = 0
        self.on_ping: Callable[[], None] | None = self._answer
        self.trigger = self.pin(TRIGGER, pin_class=TriggerPin)
        self.echo = self.pin(ECHO)

    def ticks(self) -> float:
        return self.now

    @staticmethod
    def ticks_diff(later: float, earlier: float) -> float:
        return later - earlier

    def _answer(self) -> None:
        self.pings += 1
        if self.echo_s is None:
            return
        # another thread, as gpiozero's callbacks come from
        thread = threading.Thread(target=self._pulse, args=(self.echo_s,))
        thread.start()
        thread.join()

    def _pulse(self, echo_s: float) -> None:
        self.now += 0.0005
        self.echo.drive_high()
        self.now += echo_s
        self.echo.drive_low()


@pytest.fixture
def sensor() -> Iterator[Sensor]:
    factory = Sensor()
    yield factory
    factory.close()


def pins(sensor: Sensor) -> EchoPins:
    return EchoPins(TRIGGER, ECHO, Clock(), pin_factory=sensor)


async def test_the_pulses_length_is_the_way_there_and_back(sensor: Sensor) -> None:
    finder = EchoRange(pins(sensor), CONFIG, Clock())
    sensor.echo_s = 2.0 * 1.5 / SOUND_M_S
    found = [sample for _ in range(3) for sample in await finder.read()]
    assert [sample.distance_m for sample in found] == pytest.approx([1.5, 1.5])
    assert sensor.pings == 3


async def test_the_sample_is_of_the_middle_of_the_pulse_on_the_apps_clock(sensor: Sensor) -> None:
    clock = Clock()
    before_s = clock.now_s()
    pulse = await pins(sensor).ping()
    assert pulse.fall_s - pulse.rise_s == pytest.approx(0.01, abs=1e-9)
    # the simulated edge is "now" by the pins' own ticks: it has to lie within the ping
    assert before_s <= pulse.fall_s <= clock.now_s()


async def test_a_late_wake_up_is_in_no_time_stamp(sensor: Sensor) -> None:
    """GIVEN an edge that the loop hears of 30 ms later THEN the pulse is dated by its ticks."""
    clock = Clock()

    def answer_late() -> None:
        sensor._pulse(0.01)
        sensor.now += 0.03

    sensor.on_ping = answer_late
    pulse = await pins(sensor).ping()
    assert clock.now_s() - pulse.fall_s >= 0.03


@pytest.mark.parametrize("celsius", [-10.0, 20.0, 40.0])
async def test_the_speed_of_sound_follows_the_airs_temperature(sensor: Sensor, celsius: float) -> None:
    config = CONFIG.model_copy(update={"air_temperature_c": celsius})
    finder = EchoRange(pins(sensor), config, Clock())
    found = [sample for _ in range(2) for sample in await finder.read()]
    assert found[0].distance_m == pytest.approx(0.005 * (331.3 + 0.606 * celsius))


@pytest.mark.parametrize("echo_s", [0.0001, 0.038])
async def test_pulses_out_of_range_are_no_distance_and_no_fault(sensor: Sensor, echo_s: float) -> None:
    sensor.echo_s = echo_s
    finder = EchoRange(pins(sensor), CONFIG, Clock())
    finder.watch(0.0)
    assert [await finder.read() for _ in range(3)] == [[], [], []]
    finder.watch(Clock().now_s() + 0.5)
    assert finder.problem is None


async def test_a_spike_is_kept_out(sensor: Sensor) -> None:
    finder = EchoRange(pins(sensor), CONFIG, Clock())
    distances: list[list[float]] = []
    for echo_s in (0.01, 0.01, 0.003, 0.01):
        sensor.echo_s = echo_s
        distances.append([sample.distance_m for sample in await finder.read()])
    assert [len(found) for found in distances] == [0, 1, 0, 1]


@pytest.mark.parametrize(("stuck", "words"), [(False, "does not rise"), (True, "stays high")])
async def test_a_dead_echo_pin_is_reported_and_recovered_from(
    sensor: Sensor, stuck: bool, words: str
) -> None:
    opened = pins(sensor)
    finder = EchoRange(opened, CONFIG, Clock())
    now_s = Clock().now_s()
    finder.watch(now_s)
    sensor.echo_s = None
    if stuck:
        sensor.echo.drive_high()
    with pytest.raises(SensorError, match=words):
        await opened.ping()
    assert await finder.read() == []
    finder.watch(now_s + 2.0)
    assert finder.problem == f"ultrasonic: the echo pin {words}"
    sensor.echo.drive_low()
    sensor.echo_s = 0.01
    await finder.read()
    assert len(await finder.read()) == 1
    finder.watch(Clock().now_s() + 0.5)
    assert finder.problem is None


async def test_a_pin_that_stays_high_until_the_next_trigger_costs_one_echo(sensor: Sensor) -> None:
    opened = pins(sensor)
    answer = sensor._answer

    def make_without_time_out() -> None:
        if sensor.echo.state:
            sensor.echo.drive_low()  # the new trigger ends the old cycle
        if sensor.pings == 1:
            sensor.pings += 1
            sensor.echo.drive_high()  # no echo comes
        else:
            answer()

    sensor.on_ping = make_without_time_out
    await opened.ping()
    with pytest.raises(SensorError, match="stays high"):
        await opened.ping()
    for _ in range(3):
        pulse = await opened.ping()
        assert pulse.fall_s - pulse.rise_s == pytest.approx(0.01)
    assert sensor.pings == 5


async def test_lgpio_s_pipe_is_made_where_a_service_may_write(
    sensor: Sensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("LG_WD", raising=False)
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/companion")
    pins(sensor).close()
    assert os.environ["LG_WD"] == "/run/companion"
    monkeypatch.setenv("LG_WD", "/var/tmp")  # a person's own choice stays
    pins(sensor).close()
    assert os.environ["LG_WD"] == "/var/tmp"


async def test_it_pings_at_its_rate_and_not_faster(sensor: Sensor) -> None:
    finder, clock = EchoRange(pins(sensor), CONFIG, Clock()), Clock()
    began_s = clock.now_s()
    for _ in range(4):
        await finder.read()
    assert clock.now_s() - began_s >= 3 / CONFIG.rate_hz - 0.001


async def test_closing_ends_a_waiting_ping(sensor: Sensor) -> None:
    sensor.echo_s = None
    opened = pins(sensor)
    waiting = asyncio.create_task(opened.ping())
    await asyncio.sleep(0.02)
    opened.close()
    with pytest.raises(OSError, match="closed"):
        await waiting
    with pytest.raises(OSError, match="closed"):
        await opened.ping()


async def test_the_settings_choose_it(sensor: Sensor) -> None:
    assert isinstance(make_range_finder(CONFIG, pins(sensor), Clock()), EchoRange)


async def test_a_missing_module_is_reported_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gpiozero", None)
    with pytest.raises(
        ConfigError, match=r"gpiozero is missing; expected: apt install python3-gpiozero python3-lgpio$"
    ):
        EchoPins(TRIGGER, ECHO, Clock())


async def test_pins_that_cannot_be_had_are_reported_in_one_line(sensor: Sensor) -> None:
    first: Any = pins(sensor)
    with pytest.raises(ConfigError, match=r"^GPIO pins 23 and 24: cannot be opened: .*in use") as error:
        pins(sensor)
    assert "\n" not in str(error.value)
    first.close()


def test_one_pin_cannot_be_both() -> None:
    with pytest.raises(ConfigError, match="echo_pin 23: expected another than trigger_pin"):
        validate(RangeConfig, {"kind": "gpio", "trigger_pin": 23, "echo_pin": 23}, "test.yaml")


async def test_closing_in_the_middle_of_a_pulse_is_told_as_closing(sensor: Sensor) -> None:
    opened = pins(sensor)
    loop, send_ping = asyncio.get_running_loop(), opened._send_ping

    def closed_meanwhile() -> None:
        asyncio.run_coroutine_threadsafe(close(), loop).result(1.0)
        send_ping()

    async def close() -> None:
        opened.close()

    opened._send_ping = closed_meanwhile  # type: ignore[method-assign]
    with pytest.raises(OSError, match="closed"):
        await opened.ping()


async def test_a_trigger_that_fails_is_the_sensors_fault(sensor: Sensor) -> None:
    opened = pins(sensor)
    opened._trigger.close()
    with pytest.raises(SensorError, match="ultrasonic: "):
        await opened.ping()


async def test_where_no_library_of_pins_serves_each_is_named_with_its_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("GPIOZERO_PIN_FACTORY", raising=False)
    for module in ("lgpio", "RPi", "RPi.GPIO", "pigpio"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError, match=r"cannot be opened: .*; lgpio: .*; rpigpio: ") as error:
        EchoPins(TRIGGER, ECHO, Clock())
    assert "\n" not in str(error.value)
