"""Serial ultrasonics as the app meets them: the simulated devices on their lines, in virtual time."""

import asyncio
import math
import os
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from gpiozero.pins.mock import MockFactory, MockPin
from gpiozero.pins.pi import PiPin
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.clock import Clock
from companion.base.messages import RangeSample
from companion.config import ConfigError, RangeConfig, validate
from companion.sense.imu.i2c import SensorError
from companion.sense.range.echo_pins import EchoPins
from companion.sense.range.range_finder import EchoRange, SerialRange, make_range_finder
from companion.sense.range.spike_filter import MARGIN_M, MARGIN_SHARE, SpikeFilter
from companion.sense.range.ultrasonic import Ultrasonic, Us100
from sitl.devices.ports import MemoryPort
from sitl.devices.ultrasonic import PolledUltrasonicDevice, UltrasonicDevice, frame, millimetres
from sitl.sensors.sensors import RangeErrors, RangeSensor
from tests.unit.sitl.sensors.flawless import NO_RANGE_ERRORS
from tests.virtual_time import in_virtual_time

Kind = Literal["frames", "polled"]
KINDS: list[Kind] = ["frames", "polled"]


@in_virtual_time
async def measure(
    kind: Kind, seconds: float, silent_from_s: float = 1e9, silent_until_s: float = 1e9
) -> tuple[list[RangeSample], list[str | None]]:
    """A sensor that goes down from 3 m at 0.5 m/s; its samples, and its problem once a second."""
    line, clock = MemoryPort(9600), Clock()
    finder = make_range_finder(RangeConfig(kind=kind), line.app, clock)
    assert isinstance(finder, SerialRange)
    sensor = RangeSensor(NO_RANGE_ERRORS, np.random.default_rng(1))
    device = UltrasonicDevice(sensor) if kind == "frames" else PolledUltrasonicDevice(sensor)
    samples: list[RangeSample] = []
    problems: list[str | None] = []

    async def world() -> None:
        while True:
            now_s = clock.now_s()
            device.silent = silent_from_s <= now_s < silent_until_s
            device.receive(line.receive())
            line.send(device.step(now_s, 3.0 - 0.5 * now_s))
            await asyncio.sleep(0.0025)

    async def listen() -> None:
        while True:
            samples.extend(await finder.read())

    async def watch() -> None:
        while True:
            await asyncio.sleep(1.0)
            finder.watch(clock.now_s())
            problems.append(finder.problem)

    tasks = [asyncio.create_task(run()) for run in (world, listen, watch)]
    await asyncio.sleep(seconds)
    for task in tasks:
        task.cancel()
    return samples, problems


@pytest.mark.parametrize("kind", KINDS)
def test_distances_and_times_agree_with_the_descent(kind: Kind) -> None:
    samples, problems = measure(kind, 5.0)
    assert len(samples) == pytest.approx(60, abs=4)
    for sample in samples:
        assert sample.distance_m == pytest.approx(3.0 - 0.5 * sample.time_s, abs=0.01)
    assert set(problems) == {None}


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensor_that_falls_silent_is_reported_and_taken_up_again(kind: Kind) -> None:
    samples, problems = measure(kind, 5.9, silent_from_s=1.5, silent_until_s=4.2)
    assert problems == [None, None, "ultrasonic: nothing received", "ultrasonic: nothing received", None]
    assert not [s for s in samples if 1.7 < s.time_s < 4.1]
    assert samples[-1].time_s > 5.7


# ---------------- The ultrasonic's gate: spikes stay out, what is good passes at once

PERIOD_S = 0.08


def passed(distances_m: list[float | None], config: RangeConfig | None = None) -> list[float | None]:
    """What the gate makes of pings in a row; None is no echo."""
    gate = SpikeFilter(config or RangeConfig())
    out: list[float | None] = []
    for k, distance_m in enumerate(distances_m):
        sample = None if distance_m is None else gate.step(RangeSample(PERIOD_S * k, distance_m))
        out.append(None if sample is None else sample.distance_m)
    return out


SILENCE = [None] * 20


@pytest.mark.parametrize(
    ("pings_m", "passed_m"),
    [
        pytest.param([2.0, 0.7, 2.0, 2.01], [2.0, None, 2.0, 2.01], id="a spike alone is dropped"),
        pytest.param([2.0, 0.4, 1.2, 2.0], [2.0, None, None, 2.0], id="two different spikes are dropped"),
        pytest.param([2.0, 1.4, 1.41, 1.4], [2.0, None, 1.41, 1.4], id="a step that stays costs one"),
        pytest.param(
            [2.0, None, 2.05, None, 2.1], [2.0, None, 2.05, None, 2.1], id="lost echoes cost no more"
        ),
        pytest.param([2.0, *SILENCE, 1.0, 1.0], [2.0, *SILENCE, None, 1.0], id="silence: two have to agree"),
    ],
)
def test_what_passes_the_gate(pings_m: list[float | None], passed_m: list[float | None]) -> None:
    assert passed([2.0, *pings_m]) == [None, *passed_m]


@pytest.mark.parametrize("speed_m_s", [0.3, 1.0, 2.0, 2.9])
@pytest.mark.parametrize("direction", [-1, 1])
def test_good_data_at_any_speed_of_flight_passes_without_lag(speed_m_s: float, direction: int) -> None:
    start_m = 4.0 if direction < 0 else 0.1
    steps = int(3.5 / (speed_m_s * PERIOD_S))
    path: list[float | None] = [start_m + direction * speed_m_s * PERIOD_S * k for k in range(steps)]
    assert passed(path)[1:] == path[1:]


def test_with_a_sensors_own_noise_hardly_a_good_sample_is_held_back() -> None:
    sensor = RangeSensor(RangeErrors(lost=0.0, spikes=0.0), np.random.default_rng(2))
    path = [sensor.sample(3.0 - 1.0 * PERIOD_S * k) for k in range(35)] * 20
    held = sum(value is None for value in passed(path))
    assert held <= 0.05 * len(path) + 20  # each of the twenty runs begins with a step


@pytest.mark.parametrize("spikes", [0.01, 0.05, 0.15])
def test_of_many_spikes_few_pass_and_those_are_small(spikes: float) -> None:
    """GIVEN a descent from 4 m THEN nothing that passes is farther off than the gate is wide.

    Two spikes in a row that agree are believed; at a share p of spikes, evenly spread, that is about p² times
    the gate's width over the distance. The estimator's innovation gate has the rest.
    """
    rng = np.random.default_rng(3)
    sensor = RangeSensor(RangeErrors(spikes=spikes), rng)
    worse = total = 0
    for _ in range(40):
        truth = [4.0 - 0.6 * PERIOD_S * k for k in range(75)]
        for value, true in zip(passed([sensor.sample(d) for d in truth]), truth, strict=True):
            if value is None:
                continue
            total += 1
            allowed = 3.0 * 2 * PERIOD_S + MARGIN_M + MARGIN_SHARE * true + 0.05
            worse += abs(value - true) > allowed
    assert total > 40 * 75 * (1.0 - 2.0 * spikes - 0.1)
    assert worse / total < spikes * spikes + 1e-9


def test_without_the_gate_spikes_reach_the_estimator() -> None:
    """What the gate is there for: the simulated sensor does have them."""
    sensor = RangeSensor(RangeErrors(spikes=0.05), np.random.default_rng(3))
    wild = [d for d in (sensor.sample(3.0) for _ in range(1000)) if d is not None and abs(d - 3.0) > 0.5]
    assert len(wild) == pytest.approx(40, abs=20)


@pytest.mark.parametrize("speed_m_s", [1.0, 5.0])
def test_the_setting_is_the_fastest_change_that_is_believed(speed_m_s: float) -> None:
    config = RangeConfig(maximum_speed_m_s=speed_m_s)
    margin = MARGIN_M + MARGIN_SHARE * 2.0
    for factor, believed in ((0.99, True), (1.01, False)):
        jump = factor * (speed_m_s * PERIOD_S + margin)
        result = passed([2.0, 2.0, 2.0 - jump], config)[-1]
        assert (result is not None) == believed
        assert result is None or math.isclose(result, 2.0 - jump)


# ---------------- The ultrasonic's parser, on hand-made frames and on the simulated sensor's

BYTE_S = 10.0 / 9600.0


def distances(data: bytes) -> list[float]:
    return [sample.distance_m for sample in Ultrasonic(RangeConfig()).feed(data, 1.0)]


@pytest.mark.parametrize("minimum_m", [None, 0.3])
@pytest.mark.parametrize(("sensor", "floor_m"), [("JSN-SR04T", 0.25), ("A02YYUW", 0.03), ("US-100", 0.03)])
def test_what_a_sensor_reports_of_its_blind_zone_is_no_distance(
    sensor: str, floor_m: float, minimum_m: float | None
) -> None:
    """GIVEN a descent to 5 mm THEN the floor, which is reported for all that is nearer, is never taken."""
    floor_m = minimum_m or floor_m
    config = RangeConfig.model_validate({"sensor": sensor, "minimum_m": minimum_m})
    blind = RangeSensor(replace(NO_RANGE_ERRORS, minimum_m=floor_m), np.random.default_rng(1))
    driver, taken = Ultrasonic(config), list[float]()
    for k in range(80):
        reported_m = blind.sample(0.4 - 0.005 * k)
        assert reported_m is not None
        assert reported_m >= floor_m
        taken += [sample.distance_m for sample in driver.feed(frame(reported_m), 0.1 * k)]
    assert taken == pytest.approx([0.4 - 0.005 * k for k in range(len(taken))], abs=1e-3)
    assert floor_m < taken[-1] <= floor_m + 0.006
    assert driver.problem is None


def test_the_data_sheets_example_is_1953_mm() -> None:
    assert distances(bytes.fromhex("ff07a1a7")) == [1.953]


def test_time_is_when_the_sound_met_the_ground() -> None:
    """Sound is back 2d/c after the ping; it met the ground half way; then four bytes take 4.17 ms."""
    (sample,) = Ultrasonic(RangeConfig()).feed(bytes.fromhex("ff07a1a7"), 10.0)
    assert sample.time_s == pytest.approx(10.0 - 4 * BYTE_S - 1.953 / 340.0)


def test_time_of_a_frame_with_bytes_behind_it_counts_those_too() -> None:
    (sample,) = Ultrasonic(RangeConfig()).feed(frame(1.0) + frame(2.0)[:3], 10.0)
    assert sample.time_s == pytest.approx(10.0 - 7 * BYTE_S - 1.0 / 340.0)


def test_of_a_heap_only_the_last_frame_is_dated() -> None:
    """GIVEN a second of frames that were read at once: a sensor sends none back to back."""
    heap = b"".join(frame(3.0 - 0.05 * k) for k in range(10))
    (sample,) = Ultrasonic(RangeConfig()).feed(heap, 10.0)
    assert sample.distance_m == 2.55
    assert sample.time_s == pytest.approx(10.0 - 4 * BYTE_S - 2.55 / 340.0)
    assert Ultrasonic(RangeConfig()).feed(heap + frame(None), 10.0) == []


def test_a_frame_in_single_bytes_is_found() -> None:
    parser = Ultrasonic(RangeConfig())
    found = [sample for byte in frame(0.5) for sample in parser.feed(bytes((byte,)), 1.0)]
    assert [sample.distance_m for sample in found] == [0.5]


@pytest.mark.parametrize(
    ("millimetres", "taken"),
    [(0, False), (30, False), (31, True), (4500, True), (4501, False), (65279, False)],
)
def test_only_distances_within_the_range_are_taken(millimetres: int, taken: bool) -> None:
    assert distances(frame(millimetres / 1000.0)) == ([millimetres / 1000.0] if taken else [])


@pytest.mark.parametrize(
    ("data", "taken"),
    [
        (frame(1.0).replace(frame(1.0)[2:3], b"\x00", 1) + frame(2.0), [2.0]),  # damaged
        (frame(1.0)[:3] + frame(2.0), [2.0]),  # half of one
        (frame(1.0) + frame(0.255), [0.255]),  # 255 mm: 0xFF 0x00 0xFF 0xFE, a header byte within
    ],
)
def test_what_is_no_whole_frame_costs_no_other(data: bytes, taken: list[float]) -> None:
    assert distances(data) == taken


@settings(max_examples=60)
@given(st.binary(max_size=40).filter(lambda noise: b"\xff" not in noise), st.integers(31, 4500))
def test_garbage_before_a_frame_does_no_harm(noise: bytes, millimetres: int) -> None:
    assert distances(noise + frame(millimetres / 1000.0)) == [millimetres / 1000.0]


@settings(max_examples=60)
@given(st.lists(st.binary(max_size=9), max_size=20))
def test_anything_at_all_survives(pieces: list[bytes]) -> None:
    parser = Ultrasonic(RangeConfig())
    for piece in pieces:
        for sample in parser.feed(piece, 1.0):
            assert 0.03 < sample.distance_m <= 4.5
    # whatever came: three frames later at the latest it is in step again
    tail = [sample.distance_m for _ in range(3) for sample in parser.feed(frame(1.234), 2.0)]
    assert tail[-1] == 1.234


# ---------------------------------------------------------------- faults


def problem_at(parser: Ultrasonic, now_s: float) -> str | None:
    parser.watch(now_s)
    return parser.problem


def test_a_sensor_that_says_nothing_is_reported_and_forgotten_when_it_speaks() -> None:
    parser = Ultrasonic(RangeConfig())
    assert problem_at(parser, 10.0) is None
    assert problem_at(parser, 10.9) is None
    assert problem_at(parser, 11.1) == "ultrasonic: nothing received"
    parser.feed(frame(1.0), 11.5)
    assert problem_at(parser, 12.0) is None
    assert problem_at(parser, 13.0) == "ultrasonic: nothing received"


def test_no_echo_is_no_fault() -> None:
    parser = Ultrasonic(RangeConfig())
    for k in range(30):
        assert parser.feed(frame(None), 0.1 * k) == []
        assert problem_at(parser, 0.1 * k) is None


def test_bytes_that_make_no_frame_are_reported() -> None:
    parser = Ultrasonic(RangeConfig())
    for k in range(30):
        parser.feed(b"\x12\x34", 0.1 * k)
        parser.watch(0.1 * k)
    assert parser.problem == "ultrasonic: no frame in what is received"


# ---------------- The polled ultrasonic's driver: what counts is when bytes come

POLLED = RangeConfig(kind="polled", rate_hz=10.0)


def asked(now_s: float = 0.0) -> Us100:
    driver = Us100(POLLED)
    assert driver.pending(now_s) == b"\x55"
    return driver


def test_it_asks_at_its_rate() -> None:
    driver = Us100(POLLED)
    asked_at = [k for k in range(100) if driver.pending(0.01 * k)]
    assert asked_at == list(range(0, 100, 10))


def test_two_bytes_are_millimetres_the_high_one_first() -> None:
    (sample,) = asked().feed(b"\x07\xa1", 0.02)
    assert sample.distance_m == 1.953
    assert sample.time_s == pytest.approx(0.02 - 2 * BYTE_S - 1.953 / 340.0)


def test_an_answer_in_two_pieces_is_one() -> None:
    driver = asked()
    assert driver.feed(b"\x07", 0.015) == []
    assert [s.distance_m for s in driver.feed(b"\xa1", 0.016)] == [1.953]


@pytest.mark.parametrize("later_s", [0.0, 0.001, 0.01])
def test_an_answer_that_comes_before_its_sound_can_is_the_last_questions(later_s: float) -> None:
    """GIVEN a loop that was held up with an answer to read: it asks again, and then reads the old answer."""
    driver = asked(0.0)
    assert driver.pending(0.5) == b"\x55"
    assert driver.feed(b"\x07\xa1", 0.5 + later_s) == []
    (sample,) = driver.feed(b"\x06\xa1", 0.52)
    assert sample.distance_m == 1.697
    assert sample.time_s == pytest.approx(0.52 - 2 * BYTE_S - 1.697 / 340.0)


@pytest.mark.parametrize(
    ("data", "taken"),
    [
        *((millimetres(n / 1000.0), n in (31, 4500)) for n in (0, 30, 31, 4500, 4501)),
        (b"\xff\xff", False),
        (b"\x00\x07\xa1", False),  # more than an answer is noise
    ],
)
def test_polled_only_distances_within_the_range_are_taken(data: bytes, taken: bool) -> None:
    assert len(asked().feed(data, 0.03)) == taken


def test_what_comes_without_a_question_is_no_answer() -> None:
    driver = Us100(POLLED)
    assert driver.feed(b"\x07\xa1", 0.0) == []
    driver.pending(0.1)
    assert len(driver.feed(b"\x07\xa1", 0.12)) == 1
    assert driver.feed(b"\x07\xa1", 0.14) == []


def test_half_an_answer_does_not_shift_the_next_one() -> None:
    driver = asked()
    assert driver.feed(b"\x07", 0.02) == []
    driver.pending(0.1)
    assert [s.distance_m for s in driver.feed(b"\x03\xe8", 0.12)] == [1.0]


@settings(max_examples=60)
@given(st.lists(st.binary(max_size=6), max_size=20))
def test_polled_anything_at_all_survives(pieces: list[bytes]) -> None:
    driver = Us100(POLLED)
    for k, piece in enumerate(pieces):
        driver.pending(0.05 * k)
        for sample in driver.feed(piece, 0.05 * k + 0.01):
            assert 0.03 < sample.distance_m <= 4.5
    driver.pending(10.0)
    assert [s.distance_m for s in driver.feed(b"\x03\xe8", 10.02)] == [1.0]


def polled_problem_at(driver: Us100, now_s: float) -> str | None:
    driver.watch(now_s)
    return driver.problem


def test_polled_a_sensor_that_says_nothing_is_reported_and_forgotten_when_it_speaks() -> None:
    driver = Us100(POLLED)
    assert polled_problem_at(driver, 0.0) is None
    assert polled_problem_at(driver, 0.9) is None
    assert polled_problem_at(driver, 1.1) == "ultrasonic: nothing received"
    driver.pending(1.2)
    driver.feed(b"\x07", 1.2)
    assert polled_problem_at(driver, 1.3) == "ultrasonic: no answer in what is received"
    driver.pending(1.4)
    driver.feed(b"\x00\x00", 1.43)  # no echo is no fault
    assert polled_problem_at(driver, 1.5) is None


@pytest.mark.parametrize("piece", [1, 2, 4])
def test_a_sensor_that_answers_with_frames_is_named_and_not_believed(piece: int) -> None:
    driver, taken = Us100(POLLED), 0
    for k in range(30):
        now_s = 0.1 * k
        driver.pending(now_s)
        driver.watch(now_s)
        high, low = divmod(1500 + k, 256)
        frame = bytes((0xFF, high, low, (0xFF + high + low) & 0xFF))
        for at in range(0, 4, piece):
            taken += len(driver.feed(frame[at : at + piece], now_s + 0.01 + 0.001 * at))
    assert taken == 0
    assert driver.problem is not None
    assert "4-byte frames, as a JSN-SR04T" in driver.problem


# ---------------- The ultrasonic on GPIO pins: gpiozero's mock pins, driven as an HC-SR04 drives them

TRIGGER, ECHO = 23, 24
PINS = RangeConfig(kind="gpio", trigger_pin=TRIGGER, echo_pin=ECHO, rate_hz=16.0)
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
    finder = EchoRange(pins(sensor), PINS, Clock())
    sensor.echo_s = 2.0 * 1.5 / SOUND_M_S
    found = [sample for _ in range(3) for sample in await finder.read()]
    assert [sample.distance_m for sample in found] == pytest.approx([1.5, 1.5, 1.5])
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
    config = PINS.model_copy(update={"air_temperature_c": celsius})
    finder = EchoRange(pins(sensor), config, Clock())
    found = [sample for _ in range(2) for sample in await finder.read()]
    assert found[0].distance_m == pytest.approx(0.005 * (331.3 + 0.606 * celsius))


@pytest.mark.parametrize("echo_s", [0.0001, 0.038])
async def test_pulses_out_of_range_are_no_distance_and_no_fault(sensor: Sensor, echo_s: float) -> None:
    sensor.echo_s = echo_s
    finder = EchoRange(pins(sensor), PINS, Clock())
    finder.watch(0.0)
    assert [await finder.read() for _ in range(3)] == [[], [], []]
    finder.watch(Clock().now_s() + 0.5)
    assert finder.problem is None


@pytest.mark.parametrize(("stuck", "words"), [(False, "does not rise"), (True, "stays high")])
async def test_a_dead_echo_pin_is_reported_and_recovered_from(
    sensor: Sensor, stuck: bool, words: str
) -> None:
    opened = pins(sensor)
    finder = EchoRange(opened, PINS, Clock())
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
    finder, clock = EchoRange(pins(sensor), PINS, Clock()), Clock()
    began_s = clock.now_s()
    for _ in range(4):
        await finder.read()
    assert clock.now_s() - began_s >= 3 / PINS.rate_hz - 0.001


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
    assert isinstance(make_range_finder(PINS, pins(sensor), Clock()), EchoRange)


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
