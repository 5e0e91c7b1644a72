"""The options of a flight on the user's own autopilot: what goes together, and what it makes of them."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from companion.config import CONFIG_FOLDER, ConfigError
from companion.sim import process
from companion.sim.external import External
from companion.sim.process import SimulatorError, SimulatorProcess
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from tests.programs import ProgramHere

UDP, TCP = "udpin:127.0.0.1:14540", "tcp:127.0.0.1:5763"


def options(
    autopilot: str | None = "external", connect: str | None = UDP, world: str | None = None
) -> dict[str, str | None]:
    return {"--autopilot": autopilot, "--connect": connect, "--connect-world": world}


def test_they_name_the_connections() -> None:
    assert External.of(options(autopilot=None, connect=None), fast=True) is None
    assert External.of(options(), fast=False) == External(UDP)
    assert External.of(options(world=TCP), fast=False) == External(UDP, TCP)


@pytest.mark.parametrize(
    ("given", "fast", "text"),
    [
        (options(autopilot=None), False, "--connect: needs --autopilot external"),
        (
            options(autopilot=None, connect=None, world=TCP),
            False,
            "--connect-world: needs --autopilot external",
        ),
        (
            options(autopilot="px4"),
            False,
            "--autopilot px4: expected external; the bundled one's profile is",
        ),
        (options(connect=None), False, "--autopilot external: expected --connect with where it is"),
        (options(), True, "--fast: expected to be left out"),
        (
            options(connect="serial:/dev/ttyS0:57600"),
            False,
            "--connect serial:/dev/ttyS0:57600: expected udp:",
        ),
        (options(world="nowhere"), False, "--connect-world nowhere: expected udp:HOST:PORT, udpin"),
    ],
)
def test_what_does_not_go_together_is_said(given: dict[str, Any], fast: bool, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        External.of(given, fast=fast)
    assert str(caught.value).startswith(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("words", [("--connect", UDP), ("--autopilot", "external")])
def test_without_the_desk_they_are_refused(words: tuple[str, str], program: ProgramHere) -> None:
    assert program("companion", *words).refusal.startswith(f"companion: {words[0]}: needs --sitl")


def test_the_app_takes_the_autopilots_own_sensors_and_our_echoes() -> None:
    trial = Trial.load("static", 0, External(UDP))
    sense = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=False).sense
    assert (sense.source, sense.autopilot.range_source) == ("autopilot", "boards")
    assert trial.time_limit_s == Trial.load("static", 0).time_limit_s + 60.0


async def test_an_autopilot_that_is_not_there_is_said_in_the_worlds_own_words(tmp_path: Path) -> None:
    words = tmp_path / "stderr"
    words.write_text("companion-sitl: waiting\ncompanion-sitl: tcp:127.0.0.1:1: Connection refused\n")
    silent = await asyncio.create_subprocess_exec("sleep", "60", stdout=asyncio.subprocess.PIPE)
    simulator = SimulatorProcess(silent, {}, words)
    with pytest.raises(SimulatorError) as caught:
        await simulator._listen(0.05)
    await simulator.kill()
    assert str(caught.value) == "nothing for 0.05 s: companion-sitl: tcp:127.0.0.1:1: Connection refused"


async def test_what_the_world_waits_for_is_said_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(process, "EXTERNAL_START_TIMEOUT_S", 1.0)
    monkeypatch.setattr(process, "WORDS_PERIOD_S", 0.05)
    words = tmp_path / "stderr"
    words.write_text("companion-sitl: waiting for a vehicle\n")
    silent = await asyncio.create_subprocess_exec("sleep", "60", stdout=asyncio.subprocess.PIPE)
    simulator = SimulatorProcess(silent, {}, words)
    with pytest.raises(SimulatorError):
        await simulator._find(External(UDP))
    await simulator.kill()
    assert capfd.readouterr().err == "companion-sitl: waiting for a vehicle\n"
