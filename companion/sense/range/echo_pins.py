"""An ultrasonic with a trigger and an echo pin (HC-SR04, JSN-SR04T in mode 0) on the Raspberry Pi's GPIO.

A pulse of 10 us or more on the trigger sends a ping; the echo pin is high from then until the sound is back
(HC-SR04 data sheet; without an echo for 38 ms, with some makes 200 ms, with others until the next trigger).
gpiozero stamps the edges itself (with lgpio the kernel does, as they happen), so that a late wake-up is in no
distance. Its ticks are put on the app's clock, which is handed in. gpiozero is imported when pins are opened:
nothing else here needs it.
"""

import asyncio
import errno
import os
import threading
import warnings
from dataclasses import dataclass
from tempfile import gettempdir
from typing import Any, Final

from companion.base.clock import Clock
from companion.config import ConfigError
from companion.sense.imu.i2c import SensorError

TRIGGER_S: Final = 10e-6
TIMEOUT_S: Final = 0.25
_FALLBACK: Final = "Falling back from "  # gpiozero, of a library of pins that does not serve


@dataclass(frozen=True, slots=True)
class EchoPulse:
    """A pulse on the echo pin: its edges on the app's clock."""

    rise_s: float
    fall_s: float


class EchoPins:
    """The two pins, by their Broadcom numbers. Make it inside the running loop; one ping at a time.

    Args:
        trigger_pin: output.
        echo_pin: input, behind a divider when the sensor runs on 5 V.
        clock: tells the time of the edges.
        pin_factory: gpiozero's; its own choice when left out.

    Raises:
        ConfigError: gpiozero is missing, or these pins cannot be had.
    """

    def __init__(self, trigger_pin: int, echo_pin: int, clock: Clock, pin_factory: Any = None) -> None:
        gpiozero = _gpiozero_module()
        self._pin_error: type[Exception] = gpiozero.GPIOZeroError
        self._clock = clock
        self._loop = asyncio.get_running_loop()
        self._rise: float | None = None
        self._pulse: asyncio.Future[tuple[float, float]] | None = None
        self._closed = False
        try:
            # of a library that does not serve it only warns, and its error names none
            with warnings.catch_warnings(record=True) as fallbacks:
                warnings.simplefilter("always")
                self._trigger = gpiozero.OutputDevice(trigger_pin, pin_factory=pin_factory)
                self._echo = gpiozero.InputDevice(echo_pin, pull_up=False, pin_factory=pin_factory)
        except (gpiozero.GPIOZeroError, OSError, ImportError) as error:
            said = [str(told.message) for told in fallbacks]
            tried = [words.removeprefix(_FALLBACK) for words in said if words.startswith(_FALLBACK)]
            why = "; ".join([str(error).rstrip("!"), *tried])
            raise ConfigError(f"GPIO pins {trigger_pin} and {echo_pin}: cannot be opened: {why}") from error
        pin = self._echo.pin
        pin.edges = "both"
        pin.bounce = None
        pin.when_changed = self._on_edge

    async def ping(self) -> EchoPulse:
        """Ping, and wait for the end of the echo's pulse.

        Raises:
            SensorError: the echo pin does nothing, or stays high, or the trigger fails.
            OSError: the pins have been closed.
        """
        if self._closed:
            raise OSError(errno.EBADF, "GPIO pins closed")
        # a pin that is still high is no reason to wait: some makes let it fall with the next trigger only; a
        # fall that no rise came before belongs to the ping before
        self._rise = None
        self._pulse = self._loop.create_future()
        try:
            await self._clock.run(self._send_ping, modelled_s=0.0)
        except self._pin_error as error:
            if not self._closed:
                raise SensorError(f"ultrasonic: {error}") from error
        try:
            rise, fall = await asyncio.wait_for(self._pulse, TIMEOUT_S)
        except TimeoutError as error:
            what = "stays high" if self._echo.pin.state else "does not rise"
            raise SensorError(f"ultrasonic: the echo pin {what}") from error
        factory = self._echo.pin_factory
        fall_s = self._clock.now_s() - factory.ticks_diff(factory.ticks(), fall)
        return EchoPulse(fall_s - factory.ticks_diff(fall, rise), fall_s)

    def close(self) -> None:
        """Give the pins back; a waiting `ping` ends with OSError."""
        if self._closed:
            return
        self._closed = True
        self._echo.pin.when_changed = None
        self._echo.close()
        self._trigger.close()
        if self._pulse is not None and not self._pulse.done():
            self._pulse.set_exception(OSError(errno.EBADF, "GPIO pins closed"))

    def _send_ping(self) -> None:
        self._trigger.on()
        # longer does no harm: the ping starts with the falling edge
        threading.Event().wait(TRIGGER_S)
        self._trigger.off()

    def _on_edge(self, ticks: float, level: int) -> None:
        """gpiozero's thread: an edge."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._take_edge, ticks, level)

    def _take_edge(self, ticks: float, level: int) -> None:
        if level:
            self._rise = ticks
        elif self._rise is not None and self._pulse is not None and not self._pulse.done():
            self._pulse.set_result((self._rise, ticks))


def _gpiozero_module() -> Any:
    # lgpio makes a pipe in the working directory, which of a service is /, and read-only
    os.environ.setdefault("LG_WD", os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0] or gettempdir())
    try:
        import gpiozero  # noqa: PLC0415 - needed on a vehicle with such a sensor alone
    except ImportError as error:
        raise ConfigError(
            "sense.range.kind gpio: gpiozero is missing; expected: apt install python3-gpiozero python3-lgpio"
        ) from error
    return gpiozero
