"""A flight of the real vehicle as a command: what it keeps."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.app import command
from companion.app.command import Output, fly_the_vehicle
from companion.base.messages import Notice, Phase
from companion.flightlog.record import FlightLog


def test_a_flight_on_board_fills_no_memory_with_what_only_a_score_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs: list[FlightLog] = []

    async def flight(_config: object, log: FlightLog, *_rest: object) -> tuple[Phase, bool]:
        log.write("notice", Notice(0.0, "phase", "landed: disarmed: motors off"), 0.0)
        logs.append(log)
        return Phase.LANDED, False

    monkeypatch.setattr(command, "_vehicle_flight", flight)
    settings = tmp_path / "settings.yaml"
    settings.write_text("plan: {mission: {may_arm: true}}\n", encoding="utf-8")
    assert fly_the_vehicle(settings, Output.of(tmp_path / "flights", None, live=False)) == 0
    assert dict(logs[0].kept) == {}
    assert (tmp_path / "flights" / "flight-0001" / "flight.mcap").stat().st_size > 0
