"""The command line's small decisions."""

import asyncio
import io
import json
import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import typer
from rich.console import Console

from companion.app.app import Status
from companion.app.command import EXIT_CODES, Output
from companion.app.terminal import StatusView
from companion.base.geometry import ZERO3
from companion.base.messages import FrameReport, Notice, Outcome, PadState, Phase, VehicleState
from companion.cli import SERVE_ADDRESS, cli
from companion.config import CONFIG_FOLDER, CompanionConfig, ConfigError, ServeConfig, validate
from companion.sim import process
from companion.sim.process import SimulatorError, SimulatorProcess
from companion.sim.settings import sitl_settings
from companion.sim.trial import External, Trial
from tests.programs import MODULES, ProgramHere


def test_every_outcome_has_an_exit_code_of_its_own() -> None:
    assert EXIT_CODES.keys() == set(Outcome)
    assert len(set(EXIT_CODES.values())) == len(Outcome)
    assert EXIT_CODES[Outcome.LANDED] == 0


HEAVY = {
    "aiohttp",
    "cv2",
    "numpy",
    "scipy",
    "osqp",
    "pymavlink",
    "mavsdk",
    "matplotlib",
    "skfuzzy",
    "filterpy",
}
MOST_MODULES = 400  # Typer, pydantic beneath it and the standard library need some 270


NOT_FOUND = {
    "companion": [
        ["nope"],
        ["--config", "nope.yaml"],
        ["--sitl", "--scenario", "nope"],
        ["--sitl", "--config", "nope.yaml"],
        ["check", "--config", "nope.yaml"],
        ["check", "--pad", "--config", "nope.yaml"],
        ["detect", "nope.jpg"],
        ["detect", "photo.png", "--pad", "nope"],
        ["detect", "photo.png", "--camera", "nope.yaml"],
        ["fuzzy", "nope"],
        ["identify", "nope"],
        ["identify", "photo.png", "--check", "nope"],
        ["logs", "convert", "nope"],
        ["logs", "export", "nope"],
        ["logs", "repair", "nope"],
        ["pad", "nope"],
        ["pad", "--coverage", "--camera", "nope"],
        ["replay", "nope"],
        ["replay", "photo.png", "--config", "nope.yaml"],
        ["report", "nope"],
    ],
    "companion-sitl": [
        ["nope"],
        ["--scenario", "nope"],
        ["scenarios", "nope"],
        ["campaign", "--scenarios", "line", "nope"],
        ["campaign", "--config", "nope.yaml"],
        ["hand-held", "--motion", "still", "--scenario", "nope"],
        ["view", "nope"],
    ],
    "python -m experiments": [
        ["nope"],
        ["fig13", "--scenario", "nope"],
        ["profiles", "--scenario", "nope"],
        ["pad-recall", "--camera", "nope"],
        ["table1", "--pad", "nope"],
        ["fig14", "--case", "nope"],
        ["fig14", "--nope"],
    ],
    "calibrate-camera": [["nope"]],
    "calibrate-magnetometer": [["nope"], ["photo.png", "--config", "nope.yaml"]],
    "calibrate-mount": [
        ["nope"],
        ["accelerometer", "nope.csv"],
        ["camera", "nope"],
        ["camera", "photo.png", "--camera", "nope"],
        ["gyro", "--config", "nope.yaml"],
        ["record", "swayed", "--config", "nope.yaml"],
    ],
}
SCRIPT = """
import importlib, json, sys
program, module, runs = json.loads(sys.argv[1])
main = importlib.import_module(module).main
for words in runs:
    sys.argv = [program, *words]
    try:
        main()
    except SystemExit as end:
        print(json.dumps([words, end.code, sorted(sys.modules)]))
"""


def ended(program: str, runs: list[list[str]], folder: Path) -> list[tuple[list[str], int, set[str]]]:
    """The runs of a program one after another in one process: words, exit code, modules imported by then."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, json.dumps([program, MODULES[program], runs])],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(CONFIG_FOLDER.parent)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[[")]
    assert len(lines) == len(runs), done.stderr
    return [(words, code, set(modules)) for words, code, modules in lines]


@pytest.mark.parametrize("program", MODULES)
def test_help_and_version_import_no_library_of_the_flight(program: str, tmp_path: Path) -> None:
    for words, code, modules in ended(program, [["--help"], ["--version"]], tmp_path):
        assert (words, code, modules & HEAVY) == (words, 0, set())
        assert len(modules) < MOST_MODULES


@pytest.mark.parametrize("program", NOT_FOUND)
def test_what_is_not_found_is_reported_before_anything_heavy_is_imported(
    program: str, tmp_path: Path
) -> None:
    (tmp_path / "photo.png").touch()
    # modules add up from run to run, so what one imports is still seen after the last
    for words, code, modules in ended(program, NOT_FOUND[program], tmp_path):
        assert (words, code, modules & HEAVY) == (words, 2, set())
        assert len(modules) < MOST_MODULES


# ----------------
# The options of a flight on the user's own autopilot: what goes together, and what it makes of them.

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
        (options(autopilot="px4"), False, "--autopilot px4: expected external; the bundled one's profile is"),
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


# ---------------- `--serve`, alone or with an address, over the address of the settings


def parsed(*words: str) -> object:
    return typer.main.get_command(cli).make_context("companion", list(words)).params["serve"]


@pytest.mark.parametrize(
    ("words", "address"),
    [
        ((), None),
        (("--sitl",), None),
        (("--serve",), SERVE_ADDRESS),
        (("--serve", "--sitl"), SERVE_ADDRESS),
        (("--sitl", "--serve", "0.0.0.0:80"), "0.0.0.0:80"),
        (("--serve=[::1]:80", "--no-ui"), "[::1]:80"),
        (("--serve", "status"), SERVE_ADDRESS),  # a command, which then says that the option is a flight's
    ],
)
def test_alone_it_means_this_machine_s_own_browser(words: tuple[str, ...], address: str | None) -> None:
    assert parsed(*words) == address


def test_it_needs_real_time() -> None:
    with pytest.raises(ConfigError, match="--serve: shows a flight in real time; expected it without --fast"):
        typer.main.get_command(cli).main(["--sitl", "--fast", "--serve"], standalone_mode=False)


def test_it_goes_over_the_settings_and_leaves_the_rest_of_them() -> None:
    serve = {"address": "[::1]:90", "rate_hz": 5.0}
    config = CompanionConfig(serve=validate(ServeConfig, serve, "test"))
    output = Output(None, None, live=False, serve="127.0.0.1:81")
    assert output.shown(config).serve == ServeConfig(address="127.0.0.1:81", rate_hz=5.0)
    assert Output(None, None, live=False).shown(config) is config
    wrong = Output(Path("x"), None, live=False, serve="8080")
    with pytest.raises(ConfigError, match=r"^--serve: address: expected ADDRESS:PORT"):
        wrong.shown(config)


# ---------------- The status in the terminal: what a person sees, with and without a pad in sight

VEHICLE = VehicleState(
    1.0, (1, 0, 0, 0), ZERO3, (0.0, 0.0, -6.5), ZERO3, ZERO3, ZERO3, ZERO3, 0, 0, 0, True, True
)
PAD = PadState(1.0, (0.3, -0.4, 2.0), ZERO3, (1.2, 0.9, 0.0), ZERO3, 0.0, 1.25, 0.01, 0.1, 0.95)
FRAME = FrameReport(1.0, 1.04, 1.06, 30, {"F": 2, "M": 11, "C": 0}, seen=True, searched_whole_frame=False)


def status(pad: PadState | None, *notices: Notice) -> Status:
    return Status(
        time_s=12.5,
        phase=Phase.DESCEND,
        mode="OFFBOARD",
        vehicle=VEHICLE,
        pad=pad,
        last_frame=None if pad is None else FRAME,
        frame_rate_hz=29.7,
        latency_ms=None if pad is None else 61.4,
        notices=notices,
    )


def shown(*states: Status, terminal: bool, live: bool = True) -> str:
    """What has been printed after these states."""
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=terminal, width=140, color_system=None)
    with StatusView(console, "circle, seed 1", live=live) as view:
        for state in states:
            view(state)
    return screen.getvalue()


def test_the_panel_shows_phase_height_pad_markers_rate_and_latency() -> None:
    text = shown(status(PAD), terminal=True)
    for words in ("circle, seed 1", "12.5 s", "descend (OFFBOARD)", "2.00 m", "0.50 m", "1.50 m/s", "2/11/0"):
        assert words in text
    assert "30/s" in text
    assert "61 ms" in text


def test_without_a_pad_the_height_is_the_vehicles_and_the_rest_is_a_dash() -> None:
    text = shown(status(None), terminal=True)
    assert "6.5 m" in text
    assert " - " in text


def test_a_camera_that_is_lost_shows_in_place_of_its_rate() -> None:
    text = shown(replace(status(None), camera_problem="no frame for 0.25 s"), terminal=True)
    assert "no camera" in text
    assert "30/s" not in text


def test_where_there_is_no_terminal_each_notice_is_one_line() -> None:
    first = Notice(3.0, "phase", "arm: ready: " + "a long word " * 20, "info")
    second = Notice(4.0, "phase", "take off", "info")
    text = shown(status(None, first), status(None, second), status(None), terminal=False)
    lines = text.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("    3.0 s  arm: ready: a long word")
    assert lines[1] == "    4.0 s  take off"


def test_no_ui_prints_notices_on_a_terminal_too() -> None:
    text = shown(status(PAD, Notice(3.0, "phase", "arm", "info")), terminal=True, live=False)
    assert text.strip() == "3.0 s  arm"


@pytest.mark.parametrize("live", [False, True])
def test_a_terminal_that_is_stopped_holds_up_nobody(live: bool) -> None:
    passed, goes_on = threading.Semaphore(0), threading.Event()

    class Stopped(io.StringIO):
        def write(self, text: str) -> int:
            assert goes_on.wait(60.0)
            return super().write(text)

    screen = Stopped()
    console = Console(file=screen, force_terminal=True, width=140, color_system=None)

    def fly() -> None:
        with StatusView(console, "circle, seed 1", live=live) as view:
            for number in range(20):
                view(status(PAD, Notice(float(number), "phase", f"notice {number}.", "info")))
            passed.release()
            goes_on.wait(60.0)

    flight = threading.Thread(target=fly, daemon=True)
    flight.start()
    in_time = passed.acquire(timeout=30.0)
    goes_on.set()
    flight.join(30.0)
    assert in_time
    assert "notice 19." in screen.getvalue()
    assert live or all(f"notice {number}." in screen.getvalue() for number in range(20))


class Gone(io.StringIO):
    """A reader that has gone away."""

    def __init__(self, error: OSError) -> None:
        super().__init__()
        self.error, self.writes = error, 0

    def write(self, text: str) -> int:
        self.writes += 1
        raise self.error

    def flush(self) -> None:
        raise self.error


@pytest.mark.parametrize("terminal", [False, True])
@pytest.mark.parametrize("error", [BrokenPipeError(), OSError(5, "Input/output error")])
def test_a_reader_that_goes_away_ends_no_flight(
    error: OSError, terminal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = Gone(error)
    console = Console(file=screen, force_terminal=terminal, width=140, color_system=None)
    monkeypatch.setattr(os, "dup2", lambda *_: None)  # Rich would take the tests' own output away
    notice = Notice(1.0, "phase", "landed", "info")
    with StatusView(console, "circle, seed 1", live=False) as view:
        view(status(PAD, notice))
        assert screen.writes <= 1
        view(status(PAD, notice))
        assert screen.writes <= 1
