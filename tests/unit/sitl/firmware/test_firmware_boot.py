"""A firmware in the autopilot's place: it boots before the world begins, and leaves nothing behind."""

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.config import ConfigError
from sitl.firmware import FirmwareError, ardupilot, process, px4
from sitl.firmware import vehicle as firmware_vehicle
from sitl.firmware.process import Datagrams, Moment, Process
from sitl.firmware.vehicle import FirmwareVehicle
from sitl.mavlink.ground_station import GroundStation
from sitl.scenario.scenario import BeaconSettings, load_scenario
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.quadrotor import RotorValues
from sitl.world.world import World
from tests.scenario.flying import alive
from tests.unit.sitl.firmware.fake_firmware import HOME, STEP_S, Fake, fake, sensors_at_rest
from tests.waiting import soon


@pytest.fixture(autouse=True)
def in_a_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is ready settles at once; what is not is not waited for."""
    monkeypatch.setattr(firmware_vehicle, "SETTLE_S", 0.1)
    monkeypatch.setattr(firmware_vehicle, "MOST_BOOT_S", 3.0)


def vehicle(program: Fake, sensors: SimulatedAutopilotSensors | None = None) -> FirmwareVehicle:
    return FirmwareVehicle(
        program.spec,
        World(load_scenario("static"), 0),
        sensors or sensors_at_rest(),
        GroundStation(BeaconSettings(position_std_m=1.0), np.random.default_rng(0), HOME),
        np.random.default_rng(0),
        home=HOME,
        gps_delay_s=0.12,
        step_s=STEP_S,
    )


@contextmanager
def booted(program: Fake, sensors: SimulatedAutopilotSensors | None = None) -> Iterator[FirmwareVehicle]:
    with closing(vehicle(program, sensors)) as flies:
        yield flies


def fly(
    flies: FirmwareVehicle, steps: int, sensors: SimulatedAutopilotSensors | None = None
) -> list[RotorValues]:
    """The motors of so many steps from the world's time 0 on; the world stands still."""
    motors, state = [], flies._world.state
    for count in range(steps):
        motors.append(flies.step(flies._world.state, STEP_S, count * STEP_S))
        (sensors or flies._sensors).step((count + 1) * STEP_S, state, 0.0, lambda: 0.2)
    return motors


def stamps(program: Fake) -> list[float]:
    if program.spec.kind == "px4":
        return [1e-6 * m.time_usec for m in program.sensors if m.get_type() == "HIL_SENSOR"]
    return [line["timestamp"] for line in program.sensors]


# ---------------------------------------------------------------- the boot


def test_it_boots_until_it_is_ready_and_a_while_longer(kind: AutopilotKind, tmp_path: Path) -> None:
    program = fake(kind, tmp_path, boot_steps=100)
    with booted(program):
        pass
    # ready at the first look after a hundred answers, at twenty steps a look; then it settles
    assert 0.15 <= stamps(program)[-1] <= 0.8


def test_its_clock_goes_on_from_the_boot_and_never_stands_still(kind: AutopilotKind, program: Fake) -> None:
    with booted(program) as flies:
        fly(flies, 20)
    told, step_s = stamps(program), STEP_S if kind == "px4" else STEP_S / 2
    assert np.diff(told) == pytest.approx(np.full(len(told) - 1, step_s), abs=2e-6)


def test_a_boot_leaves_the_flights_sensors_as_they_were(kind: AutopilotKind, tmp_path: Path) -> None:
    plain, flown = sensors_at_rest(7), sensors_at_rest(7)
    plain.enable()
    world = World(load_scenario("static"), 0)
    with booted(fake(kind, tmp_path), flown) as flies:
        plain.step(0.0, world.state, 0.0, lambda: 0.0)
        assert (flown.imu, flown.mag, flown.gps) == (plain.imu, plain.mag, plain.gps)
        fly(flies, 60)
    for count in range(60):
        plain.step((count + 1) * STEP_S, world.state, 0.0, lambda: 0.2)
    assert (flown.imu, flown.mag, flown.gps) == (plain.imu, plain.mag, plain.gps)
    assert plain.gps is not None


def test_it_flies_on_its_own_motors_by_the_worlds_state(kind: AutopilotKind, tmp_path: Path) -> None:
    with booted(fake(kind, tmp_path, motors=[0.5] * 4)) as flies:
        assert fly(flies, 3) == [(0.5,) * 4] * 3
        assert flies.attitude_setpoint == flies._world.state.attitude


def test_it_is_armed_as_its_heartbeat_tells(kind: AutopilotKind, tmp_path: Path) -> None:
    with booted(fake(kind, tmp_path, armed=True)) as flies:
        assert not flies.armed  # not heard since
        fly(flies, 40)
        flies.network.transmit(0.1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        assert flies.armed


def test_while_it_boots_a_ground_station_asks_it_for_what_tells_that_it_is_ready(
    program: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(firmware_vehicle, "SETTLE_S", 1.2)  # it is asked once a second
    with booted(program):
        pass
    (system,) = {message.get_srcSystem() for message in program.mavlink}
    assert system == 255
    asked = {message.get_type() for message in program.mavlink}
    assert asked == {"HEARTBEAT", "COMMAND_LONG"}


# ---------------------------------------------------------------- what goes wrong


@pytest.mark.parametrize(
    ("behaviour", "reason"),
    [
        ({"ready": False, "text": "PreArm: no\tcompass\r\n"}, "PreArm: no compass"),
        ({"ready": False}, "no output"),
        ({"boot_steps": 10**6}, "no output"),
    ],
)
def test_one_that_is_never_ready_is_refused_with_its_reason(
    kind: AutopilotKind,
    behaviour: dict[str, Any],
    reason: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(firmware_vehicle, "MOST_BOOT_S", 0.6)
    program = fake(kind, tmp_path, **behaviour)
    with pytest.raises(ConfigError) as caught:
        vehicle(program)
    assert str(caught.value) == f"the firmware is not ready to arm after 0.6 s: {reason}"
    assert program.is_gone


def test_one_that_ends_while_it_boots_is_refused_with_its_last_words(
    kind: AutopilotKind, tmp_path: Path
) -> None:
    program = fake(kind, tmp_path, ends_after=30, ready=False)
    with pytest.raises(ConfigError, match=r"has ended \(exit status 3\): last words of"):
        vehicle(program)
    assert program.is_gone


@pytest.mark.parametrize("kind_of_end", [KeyboardInterrupt, ZeroDivisionError])
def test_nothing_is_left_when_the_boot_is_broken_off(
    kind: AutopilotKind, kind_of_end: type[BaseException], program: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks_off(_firmware: object, _moment: Moment) -> RotorValues:
        raise kind_of_end

    monkeypatch.setattr({"px4": px4.Px4, "ardupilot": ardupilot.ArduPilot}[kind], "step", breaks_off)
    with pytest.raises(kind_of_end):
        vehicle(program)
    assert program.is_gone


def test_nothing_is_left_when_its_start_is_interrupted(tmp_path: Path) -> None:
    program = fake("px4", tmp_path, calls=False)
    # a shell that runs the tests in the background has it ignored
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        interrupt = threading.Timer(0.4, os.kill, (os.getpid(), signal.SIGINT))
        interrupt.start()
        with pytest.raises(KeyboardInterrupt):
            vehicle(program)
    finally:
        signal.signal(signal.SIGINT, before)
    assert program.is_gone


# ---------------------------------------------------------------- its process


def test_what_it_has_started_ends_with_it(tmp_path: Path) -> None:
    with closing(Process("a")) as child:
        child.start(["/bin/sh", "-c", "sleep 60 & echo $!; wait"], os.environ)
        assert soon(lambda: child.last_words().isdecimal())
        pid = int(child.last_words())
        assert alive(pid)
    assert soon(lambda: not alive(pid))
    assert not child.folder.exists()


def test_it_ends_and_its_folder_goes_when_its_parent_is_killed() -> None:
    parent = """
import sys, time, os
from sitl.firmware.process import Process
child = Process("a")
child.start(["/bin/sh", "-c", "sleep 60 & wait"], os.environ)
print(child._child.pid, child.folder, flush=True)
time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True) as killed:
        assert killed.stdout is not None
        pid, folder = killed.stdout.readline().split()
        assert alive(int(pid))
        killed.kill()
    assert soon(lambda: not alive(int(pid)) and not Path(folder).exists())


def test_one_that_was_killed_is_reported_of_by_the_signal() -> None:
    with closing(Process("a")) as child:
        child.start(["/bin/sh", "-c", "echo here; kill -9 $$"], os.environ)
        with pytest.raises(FirmwareError) as caught:
            child.check(5.0)
    assert str(caught.value) == "a has ended (signal 9): here"


def test_of_very_many_datagrams_some_are_left_for_the_next_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "MOST_DATAGRAMS", 10)
    with closing(Datagrams(0)) as ours, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs:
        ours.write(b"to nobody yet")
        for number in range(15):
            theirs.sendto(b"%d" % number, ("127.0.0.1", ours.port))
        assert ours.read() == [b"%d" % number for number in range(10)]
        assert ours.read() == [b"%d" % number for number in range(10, 15)]
        assert ours.read() == []
        ours.write(b"to whoever spoke")
        assert theirs.recv(100) == b"to whoever spoke"
