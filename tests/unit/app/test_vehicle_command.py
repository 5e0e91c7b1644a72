"""A flight of the real vehicle as a command: what it keeps."""

import asyncio
import errno
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from companion.app import command
from companion.app.command import Output, fly_the_vehicle, stand_by
from companion.app.service.state_report import StateReport
from companion.base.messages import Notice, Phase
from companion.config import ConfigError
from companion.flightlog.record import FlightLog
from companion.sim.command import fly_in_sitl
from companion.sim.trial import Trial


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
    assert fly_the_vehicle(settings, Output(tmp_path / "flights", None, live=False)) == 0
    assert dict(logs[0].kept) == {}
    assert (tmp_path / "flights" / "flight-0001" / "flight.mcap").stat().st_size > 0


def test_a_damaged_card_keeps_no_service_from_starting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def service(*_: object) -> int:
        return 0

    def damaged(*_: object) -> None:
        raise OSError(errno.EUCLEAN, "Structure needs cleaning")

    monkeypatch.setattr(command, "_service", service)
    monkeypatch.setattr(command, "make_room", damaged)
    settings = tmp_path / "settings.yaml"
    settings.write_text("{}\n", encoding="utf-8")
    assert stand_by(settings, Output(tmp_path, None, live=False)) == 0
    said = capsys.readouterr().err.splitlines()
    assert [line for line in said if "not enough room was made: [Errno 117] Structure needs cleaning" in line]


async def test_who_asks_by_the_link_is_told_how_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "GROUND_REPORT_S", 0.0)
    problems = [("GPS: silent for 7.0 s", "no home position"), ()]
    asked = iter([False, True, True])
    told: list[tuple[str, str, str]] = []

    async def report() -> StateReport:
        return StateReport.model_construct(phase="standby", order=None, problems=problems.pop(0))

    app: Any = SimpleNamespace(
        session=SimpleNamespace(
            state=SimpleNamespace(connected=False),
            orders=SimpleNamespace(take_question=lambda: next(asked, False)),
        ),
        announcer=SimpleNamespace(notify=lambda *said: told.append(said)),
    )
    logged = set[str]()
    log: Any = SimpleNamespace(write=lambda topic, _state, _now_s: logged.add(topic))
    telling = asyncio.create_task(command._tell_ground(app, None, log, None, 0.0, report))  # type: ignore[arg-type]
    for _ in range(100):
        await asyncio.sleep(0.01)
        if len(told) == 2:
            break
    telling.cancel()
    assert told == [
        ("status", "not ready to land: GPS: silent for 7.0 s; no home position", "warning"),
        ("status", "ready to land", "info"),
    ]
    assert logged == {"computer"}


async def test_whatever_fails_in_telling_the_ground_it_is_told_and_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """GIVEN a service whose report to the ground fails once THEN that is told, and it is made again."""
    told, again = list[str](), asyncio.Event()

    class Service:
        missions = SimpleNamespace(give=None, stopped_idle=True)
        announcer = SimpleNamespace(notify=lambda _kind, text, _severity: told.append(text))

        def request_stop(self) -> None:
            """Nobody asks."""

        async def run(self) -> Phase:
            await asyncio.wait_for(again.wait(), 5.0)
            return Phase.STANDBY

    async def tell_ground(*_: object) -> None:
        if told:
            again.set()
        raise OSError(errno.EIO, "Input/output error")

    page = SimpleNamespace(served=lambda _app: nullcontext())
    for name, stub in {
        "open_hardware": lambda *_, **__: nullcontext(),
        "App": lambda *_, **__: Service(),
        "LivePage": lambda *_: page,
        "served": lambda *_: nullcontext(),
        "_tell_ground": tell_ground,
    }.items():
        monkeypatch.setattr(command, name, stub)
    none: Any = None
    assert await command._service(none, none, none, None) == 0
    assert told == ["ground report lost: Input/output error"]


TELLS = "plan: {mission: {may_arm: true}}\ncontrol: {output: landing_target}\n"


def test_no_flight_is_flown_by_settings_that_fly_nothing(tmp_path: Path) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text(TELLS, encoding="utf-8")
    output, refused = Output(None, None, live=False), "landing_target flies nothing; expected setpoints"
    with pytest.raises(ConfigError, match=f"--fly: .*{refused}"):
        fly_the_vehicle(settings, output)
    with pytest.raises(ConfigError, match=f"--sitl: .*{refused}"):
        fly_in_sitl(settings, Trial.load("static", 0), output, fast=True)


def test_vision_only_says_what_it_does() -> None:
    def words(*problems: str) -> str:
        return StateReport.model_construct(
            phase="standby", order=None, problems=problems, vision_only=True
        ).words

    assert words() == "sends the pad when it is seen"
    assert words("camera: no frame yet") == "does not send the pad: camera: no frame yet"
