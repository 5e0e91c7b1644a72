"""Which ports and buses are opened, by where the sensors are."""

import asyncio
from typing import Any

import pytest

from companion.app import hardware
from companion.config import CompanionConfig, SenseConfig
from companion.config.reading import validate


class Opened:
    """Anything that can be opened; remembers that it was."""

    def __init__(self, name: str, names: list[str]) -> None:
        names.append(name)

    def close(self) -> None:
        """Nothing to give back."""


def opened(sense: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> tuple[list[str], hardware.Hardware]:
    names: list[str] = []

    async def transport(*_: object) -> Opened:
        return Opened("autopilot", names)

    async def camera(*_: object, waits: bool) -> Opened:
        return Opened("camera", names)

    monkeypatch.setattr(hardware, "open_transport", transport)
    monkeypatch.setattr(hardware, "keep_camera", camera)
    monkeypatch.setattr(hardware, "open_bus", lambda bus: Opened(bus, names))
    monkeypatch.setattr(hardware, "SerialPort", lambda port, baud: Opened(port, names))
    # an address where no companion of this machine is: two do not share one
    link = {"connection": "udpin:127.0.0.1:1"}
    config = validate(CompanionConfig, {"sense": sense, "link": link}, "test")

    async def main() -> hardware.Hardware:
        async with hardware.open_hardware(config) as found:
            return found

    return names, asyncio.run(main())


def test_our_boards_are_opened_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    names, found = opened({}, monkeypatch)
    defaults = SenseConfig()
    assert names == ["autopilot", defaults.imu.bus, defaults.gps.port, defaults.range.port, "camera"]
    assert None not in (found.imu_bus, found.gps_port, found.range_port)


def test_no_board_is_opened_when_the_autopilots_sensors_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    names, found = opened({"source": "autopilot"}, monkeypatch)
    assert names == ["autopilot", "camera"]
    assert (found.imu_bus, found.gps_port, found.range_port) == (None, None, None)


def test_the_ultrasonic_alone_may_be_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    sense = {"source": "autopilot", "autopilot": {"range_source": "boards"}}
    names, found = opened(sense, monkeypatch)
    assert names == ["autopilot", SenseConfig().range.port, "camera"]
    assert found.range_port is not None
