"""What is told of a serial port that is not there, in virtual time."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

from companion.app.hardware import Hardware
from companion.app.sensing import Sensing
from companion.app.supervision import supervised
from companion.base.clock import Clock, run_in_virtual_time
from companion.config import CompanionConfig
from companion.flightlog.record import FlightLog
from companion.link.codec import Severity
from companion.link.inbox import memory_pair
from companion.tools.pad_check.moves import RecentSamples

MISSING = "serial port /dev/ttyAMA0: cannot be opened"
PLUGGED_IN_S = 6.5


class PortPluggedInLate:
    """One that is not there before `PLUGGED_IN_S`, and says nothing then."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    async def read(self) -> bytes:
        await self._clock.sleep_until(self._clock.now_s() + 0.01)
        if self._clock.now_s() < PLUGGED_IN_S:
            raise OSError(MISSING)
        await asyncio.Event().wait()
        return b""

    def write(self, data: bytes) -> None: ...

    def set_baud(self, baud: int) -> None: ...

    def close(self) -> None: ...


def test_a_port_that_is_not_there_is_told_once_and_its_silence_only_when_it_is() -> None:
    told: list[tuple[float, str]] = []

    async def main() -> None:
        clock = Clock()

        def notify(kind: str, text: str, severity: Severity) -> None:
            del kind, severity
            told.append((clock.now_s(), text))

        camera: Any = SimpleNamespace(next=asyncio.Event().wait)
        vision: Any = None
        hardware = Hardware(
            memory_pair()[0], camera, gps_port=PortPluggedInLate(clock), range_port=PortPluggedInLate(clock)
        )
        sensing = Sensing(
            CompanionConfig(), hardware, vision, RecentSamples(),
            clock=clock, log=FlightLog(None, start_unix_s=0.0), notify=notify,
        )  # fmt: skip
        tasks = [
            asyncio.create_task(supervised(name, work, notify, lambda: True))
            for name, work in sensing.tasks().items()
        ]
        await clock.sleep_until(20.0)
        for task in tasks:
            task.cancel()

    run_in_virtual_time(main())
    before = sorted(text for time_s, text in told if time_s < PLUGGED_IN_S)
    assert before == [f"gps lost: {MISSING}", f"ultrasonic lost: {MISSING}"]
    after = {text for time_s, text in told if time_s > PLUGGED_IN_S}
    assert after >= {"gps is back", "ultrasonic is back", "ultrasonic: nothing received"}
    assert "NEO-6M: nothing received: check its power and wiring" in after
