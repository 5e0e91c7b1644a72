"""The downward ultrasonic, whichever it is: distances along its axis, spikes among them.

`SerialRange` joins a serial line and the driver of what talks on it (`ultrasonic`); `EchoRange`
times pulses on GPIO pins (`echo_pins`).
"""

import asyncio
import math
from typing import Final, Protocol

from companion.base.clock import Clock
from companion.base.messages import RangeSample
from companion.config import RangeConfig
from companion.sense.imu.i2c import SensorError
from companion.sense.range.echo_pins import EchoPins, EchoPulse
from companion.sense.range.ultrasonic import SILENCE_S, Ultrasonic, Us100

_SOUND_AT_0_C_M_S: Final = 331.3
_SOUND_PER_C_M_S: Final = 0.606


class BytePort(Protocol):
    """A serial line. OSError when it is gone."""

    async def read(self) -> bytes:
        """Wait for at least one byte."""
        ...

    def write(self, data: bytes) -> None:
        """Send without waiting."""
        ...


class RangeFinder(Protocol):
    """Where distances come from."""

    @property
    def problem(self) -> str | None:
        """What is wrong in one line, as of the last `watch`, or None."""
        ...

    async def read(self) -> list[RangeSample]:
        """Wait for news; it may be that there is none to believe. OSError when the sensor is gone."""
        ...

    def watch(self, now_s: float) -> None:
        """Bring `problem` up to date; call it about once a second."""
        ...


def make_range_finder(config: RangeConfig, port: BytePort | EchoPins, clock: Clock) -> RangeFinder:
    """The range finder that the settings name, on what has been opened for it."""
    if isinstance(port, EchoPins):
        return EchoRange(port, config, clock)
    return SerialRange(port, config, clock)


class SerialRange:
    """An ultrasonic on a serial line."""

    def __init__(self, port: BytePort, config: RangeConfig, clock: Clock) -> None:
        self._port = port
        self._driver: Ultrasonic | Us100 = Us100(config) if config.kind == "polled" else Ultrasonic(config)
        self._patience_s = 0.25 / config.rate_hz if config.kind == "polled" else None
        self._clock = clock

    @property
    def problem(self) -> str | None:
        return self._driver.problem

    def watch(self, now_s: float) -> None:
        self._driver.watch(now_s)

    async def read(self) -> list[RangeSample]:
        """Ask if it is time to, and wait a while for bytes."""
        if question := self._driver.pending(self._clock.now_s()):
            self._port.write(question)
        try:
            async with asyncio.timeout(self._patience_s):
                data = await self._port.read()
        except TimeoutError:
            return []
        return self._driver.feed(data, self._clock.now_s())


class EchoRange:
    """An ultrasonic on two pins."""

    def __init__(self, pins: EchoPins, config: RangeConfig, clock: Clock) -> None:
        self._pins = pins
        self._config = config
        self._clock = clock
        self._speed_m_s = _SOUND_AT_0_C_M_S + _SOUND_PER_C_M_S * config.air_temperature_c
        self._next_s = -math.inf
        self._heard_s: float | None = None
        self._fault: str | None = None
        self.problem: str | None = None

    def watch(self, now_s: float) -> None:
        if self._heard_s is None:
            self._heard_s = now_s
        self.problem = self._fault if now_s - self._heard_s > SILENCE_S else None

    async def read(self) -> list[RangeSample]:
        """Ping when it is time to, and wait for the echo."""
        await self._clock.sleep_until(self._next_s)
        self._next_s = self._clock.now_s() + 1.0 / self._config.rate_hz
        try:
            pulse = await self._pins.ping()
        except SensorError as error:
            self._fault = str(error)
            return []
        self._heard_s = self._clock.now_s()
        sample = self._sample(pulse)
        return [] if sample is None else [sample]

    def _sample(self, pulse: EchoPulse) -> RangeSample | None:
        """The sound is under way for as long as the pulse lasts; half way it meets the surface."""
        distance_m = 0.5 * self._speed_m_s * (pulse.fall_s - pulse.rise_s)
        if not self._config.measures(distance_m):
            return None
        return RangeSample(0.5 * (pulse.rise_s + pulse.fall_s), distance_m)
