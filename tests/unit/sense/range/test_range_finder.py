"""Serial ultrasonics as the app meets them: the simulated devices on their lines, in virtual time."""

import asyncio
from typing import Literal

import numpy as np
import pytest

from companion.base.clock import Clock, run_in_virtual_time
from companion.base.messages import RangeSample
from companion.config import RangeConfig
from companion.sense.range.range_finder import SerialRange, make_range_finder
from sitl.devices.ports import MemoryPort
from sitl.devices.ultrasonic import PolledUltrasonicDevice, UltrasonicDevice
from sitl.sensors.sensors import NO_RANGE_ERRORS, RangeSensor

Kind = Literal["frames", "polled"]
KINDS: list[Kind] = ["frames", "polled"]


def measure(
    kind: Kind, seconds: float, silent_from_s: float = 1e9, silent_until_s: float = 1e9
) -> tuple[list[RangeSample], list[str | None]]:
    """A sensor that goes down from 3 m at 0.5 m/s; its samples, and its problem once a second."""

    async def main() -> tuple[list[RangeSample], list[str | None]]:
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

    return run_in_virtual_time(main())


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
