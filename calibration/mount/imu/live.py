"""Static intervals taken live while a person turns the IMU. A thin shell around `FaceGuide`."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Final

from calibration.mount.imu.guide import FaceGuide, ImuBuffer
from calibration.mount.imu.six_faces import mounting_matrix
from calibration.mount.imu.static_intervals import find_static_intervals
from calibration.mount.record.devices import MountSensors
from calibration.mount.record.live import read_imu, until_done
from calibration.mount.record.samples import ImuSamples
from companion.base.clock import Clock
from companion.base.messages import ImuSample
from companion.config import ConfigError, ImuConfig
from companion.sense.imu.mpu9250 import Mpu9250

LOOK_S: Final = 0.5
REMIND_S: Final = 10.0

Tell = Callable[[str], None]
Keep = Callable[[ImuSample, float], None]


async def six_faces_live(
    imu: ImuConfig, sensors: MountSensors, tell: Tell, longest_s: float, keep: Keep | None = None
) -> tuple[ImuSamples, FaceGuide]:
    """Ask for the six faces in turn; returns all samples (sensor axes), and what was asked and measured.

    Raises:
        ConfigError: the sensor does not answer, or not all faces came in time.
    """
    turn = mounting_matrix(imu.body_from_sensor_deg)
    samples, guide, clock = ImuBuffer(turn), FaceGuide(turn), Clock()

    async def watch() -> None:
        start_s = clock.now_s()
        advised_s, advised = -REMIND_S, ""
        while not guide.done:
            if clock.now_s() - start_s > longest_s:
                raise ConfigError(f"no end after {longest_s:g} s; expected: {guide.advice}")
            if guide.advice != advised or clock.now_s() - advised_s >= REMIND_S:
                advised_s, advised = clock.now_s(), guide.advice
                tell(advised)
            await asyncio.sleep(LOOK_S)
            if (line := guide.take(samples.since(guide.after_s))) is not None:
                tell(line)

    await _with_imu(imu, sensors, tell, samples, watch, keep)
    return samples.since(-1e9), guide


async def still_live(
    imu: ImuConfig,
    sensors: MountSensors,
    tell: Tell,
    seconds: float,
    longest_s: float,
    keep: Keep | None = None,
) -> ImuSamples:
    """Wait for a static interval of `seconds`; returns all samples (sensor axes).

    Raises:
        ConfigError: the sensor does not answer, or is not left alone.
    """
    samples, clock = ImuBuffer(mounting_matrix(imu.body_from_sensor_deg)), Clock()

    async def watch() -> None:
        start_s = clock.now_s()
        tell(f"leave it alone for {seconds:g} s")
        while not any(
            rest.to_s - rest.from_s >= seconds for rest in find_static_intervals(samples.since(start_s))
        ):
            if clock.now_s() - start_s > longest_s:
                raise ConfigError(
                    f"not still for {seconds:g} s within {longest_s:g} s; expected it left alone"
                )
            await asyncio.sleep(LOOK_S)

    await _with_imu(imu, sensors, tell, samples, watch, keep)
    return samples.since(-1e9)


async def _with_imu(
    imu: ImuConfig,
    sensors: MountSensors,
    tell: Tell,
    samples: ImuBuffer,
    watch: Callable[[], Awaitable[None]],
    keep: Keep | None,
) -> None:
    """Run `watch` to its end while samples come."""
    # uncalibrated: an earlier calibration must not enter this one
    driver = Mpu9250(sensors.imu_bus, imu)
    clock = Clock()

    def take(sample: ImuSample) -> None:
        if keep is not None:
            keep(sample, clock.now_s())
        samples.add(sample)

    await until_done(watch, read_imu(driver, imu, take, tell))
