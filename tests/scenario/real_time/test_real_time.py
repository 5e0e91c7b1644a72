"""Flights in real time: the simulator a process of its own, MAVLink over UDP, actions by MAVSDK."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
import yaml
from pymavlink import mavutil

from sitl.run.process_control import read_report
from sitl.run.tick_timer import LATE_S
from tests.scenario.flying import (
    FEW_PICTURES,
    ROOT,
    FlownCommand,
    alive,
    children,
    run,
    scenario_file,
    started,
    wait_for_line,
)
from tests.scenario.real_time.quiet_machine import LATE, beside_lateness, wait_for_quiet
from tests.waiting import soon

DESK = ("--sitl", "--no-ui", "--scenario", "line", "--seed", "0")
END_TIMEOUT_S = 30.0


@pytest.fixture(autouse=True)
def machine_with_time_to_spare() -> None:
    wait_for_quiet()


def fly_in_real_time(folder: Path) -> FlownCommand:
    """A flight on a machine that keeps up; one that does not is given a second chance."""
    for attempt in ("first", "second"):
        path = folder / f"{attempt}.json"
        flown = run(*DESK, "--json", path, "--record", folder / attempt, result=path)
        if LATE not in flown.stderr:
            return flown
    pytest.skip(f"this machine does not keep up with real time: {flown.stderr.strip()}")


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit code and standard error of a process that is about to end.

    That the machine was late is left out: it says something of the machine.
    """
    _, words = process.communicate(timeout=END_TIMEOUT_S)
    return process.returncode, beside_lateness(words)


def gone(pid: int) -> bool:
    """Whether a process ends within a few seconds."""
    deadline = time.monotonic() + 10.0
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    return not alive(pid)


def test_lands_in_real_time_with_mavsdk(tmp_path: Path) -> None:
    flown = fly_in_real_time(tmp_path)
    assert flown.landing["touchdown"]["lateral_error_m"] <= 0.15
    assert flown.landing["sim"]["real_time_factor"] == pytest.approx(1.0, abs=0.05)
    # times count from the start of the flight, not from the start of the machine
    assert flown.landing["events"][0]["time_s"] < 5.0
    assert flown.stderr == ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_in_flight_hands_the_vehicle_back(number: signal.Signals, tmp_path: Path) -> None:
    with started(*DESK, "--record", tmp_path) as process:
        wait_for_line(process, "airborne")
        (simulator,) = children(process.pid)
        process.send_signal(number)
        wait_for_line(process, "abort: stop")
        assert ended(process) == (4, "companion: aborted: stop requested: by the operator\n")
        assert not alive(simulator)
    assert (tmp_path / "result.json").exists()
    assert handed_back(tmp_path / "flight.tlog")


def handed_back(path: Path) -> bool:
    """Whether the autopilot's last mode was its own hold (PX4: AUTO.LOITER)."""
    log = mavutil.mavlink_connection(str(path))
    mode = None
    while (message := log.recv_match(type="HEARTBEAT")) is not None:
        if message.get_srcComponent() == 1:
            mode = message.custom_mode
    return mode == (4 << 16 | 3 << 24)


def test_a_simulator_does_not_outlive_an_app_that_was_killed() -> None:
    with started(*DESK) as process:
        wait_for_line(process, "take off")
        (simulator,) = children(process.pid)
        process.kill()
        process.wait()
        assert gone(simulator)


def test_a_simulator_that_crashes_ends_the_flight_in_one_line(tmp_path: Path) -> None:
    with started(*DESK, "--record", tmp_path) as process:
        wait_for_line(process, "take off")
        (simulator,) = children(process.pid)
        os.kill(simulator, signal.SIGKILL)
        code, words = ended(process)
    assert code == 1
    assert words == "companion: the simulator ended in flight: no reason given\n"
    # what was logged up to then is there to be looked at
    assert (tmp_path / "flight.mcap").stat().st_size > 0


def simulated(folder: Path) -> tuple[subprocess.Popen[str], Path]:
    """A simulator in real time that is no child of the app, and the app's settings for it."""
    scenario = scenario_file(folder, "static", FEW_PICTURES)
    simulator = subprocess.Popen(
        (sys.executable, "-m", "sitl.cli", "--child", "--scenario", str(scenario), "--folder", str(folder)),
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert simulator.stdout is not None
    settings = folder / "companion.yaml"
    wired = json.loads(simulator.stdout.readline())
    settings.write_text(yaml.safe_dump(wired | {"plan": {"mission": {"may_arm": True}}}))
    return simulator, settings


def test_killed_before_it_armed_the_next_start_arms_nothing_until_it_is_permitted(tmp_path: Path) -> None:
    simulator, settings = simulated(tmp_path)
    flights = tmp_path / "flights"
    fly = ("--fly", "--no-ui", "--config", settings, "--record", flights)
    with simulator:
        assert run("permit", "--record", flights).code == 0  # nobody sits at a terminal here
        with started(*fly) as killed:
            wait_for_line(killed, "waiting: ")
        with started(*fly) as again:
            wait_for_line(again, "standby: the last flight was begun and never ended")
            time.sleep(12.0)  # the vehicle was ready to arm within 9 s
            again.send_signal(signal.SIGTERM)
            words, _ = again.communicate(timeout=END_TIMEOUT_S)
        assert "arm:" not in words
        assert run("permit", "--record", flights).code == 0
        with started(*fly) as permitted:
            wait_for_line(permitted, "arm:")
            permitted.send_signal(signal.SIGTERM)
            permitted.communicate(timeout=END_TIMEOUT_S)
        simulator.communicate("finish abort\n", timeout=20.0)


def test_the_service_stands_by_lands_when_it_is_ordered_to_and_stands_by_again(tmp_path: Path) -> None:
    simulator, settings = simulated(tmp_path)
    flights, asked = tmp_path / "flights", tmp_path / "run" / "companion.sock"
    with simulator, closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as manager:
        # nobody reads it meanwhile: a service manager that hangs must not hold up a flight
        manager.bind(str(tmp_path / "notify"))
        managed = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "RUNTIME_DIRECTORY": str(asked.parent)}
        service = ("--no-ui", "--config", settings, "--record", flights)
        with started(*service, variables=managed) as process:
            wait_for_line(process, "standby: waiting for an order")
            assert soon(lambda: healthy(asked), 40.0, 0.3)
            assert run("order", "land", "--socket", asked).code == 1  # it stands on the ground
            ordered = run("order", "fly", "--wait", "--socket", asked)
            after = run("status", "--socket", asked)
            process.send_signal(signal.SIGTERM)
            words, errors = process.communicate(timeout=END_TIMEOUT_S)
        said, _ = simulator.communicate("finish landed\n", timeout=20.0)
        report = read_report(Path(json.loads(said)["report"]))
        if report.latest_tick_s > LATE_S:
            pytest.skip(f"the simulator was {report.latest_tick_s:.1f} s late on this machine")
        assert (ordered.code, report.outcome) == (0, "landed"), (ordered, words)
        assert after.code == 0, after
        assert (process.returncode, errors) == (0, "")
        assert {manager.recv(1000) for _ in range(3)} >= {b"READY=1", b"WATCHDOG=1"}
    assert (flights / "flight-0001" / "flight.mcap").stat().st_size > 0


def healthy(asked: Path) -> bool:
    """Whether the running service says that it is well."""
    return run("status", "--socket", asked).code == 0
