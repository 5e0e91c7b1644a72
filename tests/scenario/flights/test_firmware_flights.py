"""Flights with a firmware from end to end, by fakes that cannot fly: who hears whom, how they end."""

import asyncio
import json
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any, NoReturn

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import Outcome, Phase
from companion.config import ConfigError
from companion.sim import runner
from companion.sim.flights import Answer, answer
from companion.sim.process import SimulatorError, SimulatorProcess
from companion.sim.trial import Trial
from sitl.firmware import px4, vehicle
from sitl.run.server import Service, _kept_free
from tests.programs import ProgramHere
from tests.scenario.flying import COMMAND, ROOT, alive, children, environment, started, wait_for_line
from tests.scenario.real_time.quiet_machine import beside_lateness
from tests.unit.sitl.campaign.campaign_parts import scenario_file
from tests.unit.sitl.external.external_vehicle import ARDUPILOT, MessageSender, heartbeat
from tests.unit.sitl.firmware.fake_firmware import Fake, fake, messages
from tests.waiting import soon

BOTH = pytest.mark.parametrize("kind", ["px4", "ardupilot"])
ENDED = r"(px4|arducopter) has ended \(exit status 3\): last words of (px4|arducopter)"
NEVER_READY: dict[str, Any] = {"boot_steps": 10**9}


@pytest.fixture(autouse=True)
def in_a_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is ready settles at once, in this process."""
    monkeypatch.setattr(vehicle, "SETTLE_S", 0.1)


def asked(program: Fake, scenario: Path) -> Answer:
    """Have a flight flown as a campaign has, in this process."""
    request = {"scenario": str(scenario), "seed": 0, "firmware": program.spec.as_json()}
    return answer(json.dumps(request).encode())


def options(program: Fake) -> list[str]:
    """What names it to a command."""
    return list(program.spec.options)


# ---------------------------------------------------------------- in virtual time


@BOTH
def test_a_flight_is_scored_and_the_app_was_heard(kind: AutopilotKind, tmp_path: Path) -> None:
    program = fake(kind, tmp_path)
    result = asked(program, scenario_file(tmp_path)).result
    assert result is not None
    assert result.outcome is Outcome.TIMEOUT  # it cannot fly
    said = {message.get_srcComponent(): message.get_srcSystem() for message in program.mavlink}
    (instance,) = program.instances
    assert said == {190: 255, 191: instance + 1 if kind == "px4" else 1}
    assert program.is_gone


@BOTH
def test_a_firmware_that_ends_in_flight_is_a_fault_of_that_flight_alone(
    kind: AutopilotKind, tmp_path: Path
) -> None:
    program = fake(kind, tmp_path, ends_after=500)
    fault = asked(program, scenario_file(tmp_path)).fault
    assert fault is not None
    assert re.fullmatch(f"SimulatorError: {ENDED}", fault)
    assert program.is_gone


def test_a_firmware_that_is_not_ready_is_refused_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vehicle, "MOST_BOOT_S", 0.5)
    program = fake("px4", tmp_path, ready=False, text="Preflight Fail: no home")
    refused = asked(program, scenario_file(tmp_path)).refused
    assert refused == "the firmware is not ready to arm after 0.5 s: Preflight Fail: no home"
    assert program.is_gone


def test_nothing_is_left_when_the_apps_settings_are_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(*_: object) -> NoReturn:
        raise ConfigError("a.yaml: wrong")

    monkeypatch.setattr(runner, "App", refuses)
    program = fake("px4", tmp_path)
    assert asked(program, scenario_file(tmp_path)).refused == "a.yaml: wrong"
    assert program.is_gone


def test_the_command_says_in_one_line_that_the_firmware_ended(tmp_path: Path, program: ProgramHere) -> None:
    firmware = fake("ardupilot", tmp_path, ends_after=500)
    words = ["companion", "--sitl", "--fast", "--no-ui", "--scenario", str(scenario_file(tmp_path))]
    said = program(*words, *options(firmware))
    assert said.code == 1
    assert re.fullmatch(f"companion: {ENDED}\n", said.err)
    assert firmware.is_gone


@pytest.mark.parametrize(
    ("number", "code", "words"), [(signal.SIGINT, 130, "companion: interrupted"), (signal.SIGKILL, -9, "")]
)
def test_whoever_does_not_wait_for_the_boot_leaves_nothing(
    number: signal.Signals, code: int, words: str, tmp_path: Path
) -> None:
    program = fake("px4", tmp_path, **NEVER_READY)
    with started("--sitl", "--fast", "--no-ui", *options(program)) as process:
        assert soon(lambda: bool(program.instances))
        process.send_signal(number)
        _, said = process.communicate(timeout=20.0)
    assert (process.returncode, said.strip()) == (code, words)
    assert program.is_gone


def test_a_campaigns_process_that_ends_in_a_flight_leaves_nothing(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path, **NEVER_READY)
    request = {"scenario": "static", "seed": 0, "firmware": program.spec.as_json()}
    with subprocess.Popen(
        (*COMMAND, "flights"), cwd=ROOT, env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        process.stdin.write(json.dumps(request).encode() + b"\n")
        process.stdin.flush()
        assert soon(lambda: bool(program.instances))
        process.communicate(timeout=20.0)
    assert program.is_gone


# ---------------------------------------------------------------- in a process of its own


async def test_a_simulator_of_its_own_flies_it_and_leaves_nothing(tmp_path: Path) -> None:
    program = fake("px4", tmp_path)
    simulator = await SimulatorProcess.start(Trial.load("static", 0, firmware=program.spec), tmp_path)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.settimeout(5.0)
            _, host, port = simulator.endpoints["link"]["connection"].split(":")
            client.sendto(MessageSender(1, 191).pack(heartbeat(ARDUPILOT)), (host, int(port)))
            heard: set[int] = set()
            while not {1, 190} <= heard:
                heard |= {message.get_srcComponent() for message in messages(client.recv(4096))}
        report = await simulator.finish(Phase.ABORT)
    finally:
        await simulator.kill()
    assert report.outcome is Outcome.ABORTED
    assert program.is_gone


async def test_one_that_ends_in_flight_ends_the_simulator_with_its_words(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path, ends_after=6000)
    simulator = await SimulatorProcess.start(Trial.load("static", 0, firmware=program.spec), tmp_path)
    try:
        with pytest.raises(SimulatorError, match=f"^the simulator ended in flight: companion-sitl: {ENDED}$"):
            await simulator.watch()
    finally:
        await simulator.kill()
    assert program.is_gone


async def test_a_simulator_that_is_given_up_while_it_boots_leaves_nothing(tmp_path: Path) -> None:
    program = fake("px4", tmp_path, **NEVER_READY)
    trial = Trial.load("static", 0, firmware=program.spec)
    starting = asyncio.create_task(SimulatorProcess.start(trial, tmp_path))
    assert await asyncio.to_thread(soon, lambda: bool(program.instances))
    starting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await starting
    assert program.is_gone


def test_a_simulator_that_serves_ends_with_ctrl_c_and_leaves_nothing(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path)
    ports = ("--port", "0", "--gcs-port", "0", "--tcp-port", "0")
    with subprocess.Popen(
        (sys.executable, "-m", "sitl.cli", "--scenario", "static", *ports, *options(program)),
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        wait_for_line(process, "Ctrl-C")
        assert len(children(process.pid)) == 2  # the firmware, and what waits for our end
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20.0)
    assert (process.returncode, beside_lateness(errors)) == (0, "")
    assert not alive(process.pid)
    assert program.is_gone


def test_what_is_to_be_served_is_not_taken_by_a_firmware() -> None:
    with _kept_free(Service()):
        server, link, instance = px4._free_instance()
    server.close()
    link.close()
    assert instance > 0  # the first would have the ports 14580 and 18570
