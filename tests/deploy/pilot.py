"""A pilot's client beside the real service under systemd: flights by MAVSDK, landings ordered by MAVLink.

    python -m tests.deploy.pilot land|kill|stop        as root, where the service runs

`tests/deploy/service.sh` runs it in its container, with the settings that `settings_text` makes. The vehicle
is `companion-sitl` as its users start it; a witness is between it and the service. Each part begins in
standby and ends in it. Exit codes: 0 all well, 1 something is not, with one line that says what.

`land`: plugs the devices in 20 s after the service has started; two landings in one run of the service; it is
stopped in a third, hands back, is started again, and lands.
`kill`, `stop`: SIGKILL or SIGSTOP in the approach, in the descent and committed to land: systemd or its
watchdog restarts the service into standby; nothing is armed or ordered by it, and the next landing is well.
"""

import asyncio
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import aclosing, asynccontextmanager, closing, contextmanager
from pathlib import Path
from typing import Any, Final

import yaml
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from pymavlink import mavutil

from benchmarks.service import judging
from benchmarks.service.judging import Beat, UdpWitness, reached
from benchmarks.service.running import NEAR, ask
from companion.app.service.local_socket import FILE_NAME, SYSTEM_FOLDER
from companion.config import merge
from sitl.scenario.scenario import load_scenario

SIGNALS: Final = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP}
PLUGGED: Final = Path("/run/vehicle")
SERVICE_PORT, VEHICLE_PORT, CLIENT_PORT, GROUND_PORT = 14600, 14580, 14550, 18570
LATE_S: Final = 20.0
PATIENCE_S: Final = 90.0
HEIGHT_M: Final = 4.0
WATCHED_S: Final = 5.0
RESTARTS_WITHIN_S: Final = 30.0
LAND: Final = mavutil.mavlink.MAV_CMD_NAV_LAND
IN_PROGRESS, ACCEPTED = mavutil.mavlink.MAV_RESULT_IN_PROGRESS, mavutil.mavlink.MAV_RESULT_ACCEPTED
COMMITTED: Final = "committed"  # as the service's event begins
LOITER: Final = 4 << 16 | 3 << 24


class DeploymentError(Exception):
    """Something is not as it should be."""


def settings_text() -> str:
    """The service's settings: devices at fixed places, which appear when the vehicle is plugged in."""
    devices = {
        "link": {"connection": f"udp:127.0.0.1:{SERVICE_PORT}"},
        "sense": {
            "imu": {"bus": f"socket:{PLUGGED}/registers"},
            "gps": {"port": f"{PLUGGED}/gps"},
            "range": {"port": f"{PLUGGED}/range"},
            "vision": {"source": f"socket:{PLUGGED}/camera"},
        },
    }
    return str(yaml.safe_dump(merge(load_scenario(NEAR).companion, devices)))


def step(words: str) -> None:
    """Say what is well."""
    print(f"  {words}", flush=True)


# ---------------------------------------------------------------- the vehicle


@contextmanager
def plugged_in() -> Iterator[UdpWitness]:
    """The vehicle with its devices at their places, and a witness on its line; all gone at the end."""
    PLUGGED.mkdir()
    shutil.chown(PLUGGED, "companion", "companion")
    command = (sys.executable, "-m", "sitl.cli", "--scenario", str(NEAR), "--folder", str(PLUGGED))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, user="companion") as process:
        try:
            for name, port in _ports(process).items():
                (PLUGGED / name).symlink_to(port)
            with closing(UdpWitness(VEHICLE_PORT, SERVICE_PORT)) as witness:
                yield witness
        finally:
            process.terminate()
            process.wait()
            shutil.rmtree(PLUGGED)


def _ports(process: subprocess.Popen[str]) -> dict[str, str]:
    """The serial ports that the vehicle names when it is ready."""
    assert process.stdout is not None
    found = {}
    for line in process.stdout:
        if named := re.match(r"  (GPS|ultrasonic) +(\S+)", line):
            found[{"GPS": "gps", "ultrasonic": "range"}[named[1]]] = named[2]
        if line.startswith("Ctrl-C"):
            return found
    raise DeploymentError("the vehicle does not start")


# ---------------------------------------------------------------- the service


def unit(name: str) -> str:
    """A property of the unit."""
    command = ("systemctl", "show", "companion", f"--property={name}", "--value")
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def phase() -> str:
    """The service's phase; nothing while it does not answer."""
    try:
        return str(ask(SYSTEM_FOLDER / FILE_NAME, {"request": "status"}).get("phase", ""))
    except OSError:
        return ""


def committed() -> bool:
    """Whether this run of the service is committed to land."""
    try:
        report = ask(SYSTEM_FOLDER / FILE_NAME, {"request": "status"})
    except OSError:
        return False
    return any(event["text"].startswith(COMMITTED) for event in report.get("events", ()))


def problems() -> list[str]:
    """What keeps the service from landing now."""
    try:
        return list(ask(SYSTEM_FOLDER / FILE_NAME, {"request": "status"})["problems"])
    except (OSError, KeyError):
        return ["no answer"]


async def until(holds: Callable[[], object], what: str, most_s: float = PATIENCE_S) -> float:
    """Wait for something; returns how long (s) it took.

    Raises:
        Wrong: it does not come.
    """
    begun_s = time.monotonic()
    while not holds():
        if time.monotonic() - begun_s > most_s:
            raise DeploymentError(f"not within {most_s:g} s: {what}; phase '{phase()}', {problems()}")
        await asyncio.sleep(0.05)
    return time.monotonic() - begun_s


async def late_devices() -> None:
    """Wait until the service has run for so long without any device."""
    since_s = 1e-6 * int(unit("ActiveEnterTimestampMonotonic"))
    await asyncio.sleep(max(0.0, since_s + LATE_S - time.monotonic()))
    if unit("ActiveState") != "active" or phase() != "standby":
        raise DeploymentError(f"without devices: {unit('ActiveState')}, phase '{phase()}'")
    step(f"in standby {LATE_S:g} s without any device: {'; '.join(problems())}")


# ---------------------------------------------------------------- the pilot


class ScriptedPilot:
    """Flies by MAVSDK, orders by MAVLink."""

    def __init__(self, system: Any, witness: UdpWitness) -> None:
        self.action, self.telemetry = ActionAsync(system), TelemetryAsync(system)
        self.witness = witness
        self._ground = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{GROUND_PORT}", source_system=255, source_component=190
        )

    @property
    def beat(self) -> Beat:
        """The vehicle's mode now."""
        return self.witness.seen.at(time.monotonic())

    async def take_off(self) -> None:
        """Arm and climb; setpoints and orders of the service's until then are wrong."""
        sent = len(self.witness.seen.setpoints), len(self.witness.seen.commands)
        await _first(self.telemetry.subscribe_health_all_ok(), bool)
        await self.action.hold()
        await self.action.set_takeoff_altitude(HEIGHT_M)
        await self.action.arm()
        await self.action.takeoff()
        await _first(self.telemetry.subscribe_position(), lambda p: p.relative_altitude_m > HEIGHT_M - 0.4)
        await until(lambda: self.beat.mode == LOITER, "hold after the take-off")
        if sent != (len(self.witness.seen.setpoints), len(self.witness.seen.commands)):
            raise DeploymentError("the service has ordered something in standby")

    async def order(self) -> None:
        """Ask the service to land; it is followed, or the order is wrong."""
        await until(lambda: not problems(), "healthy")
        while self._ground.recv_match(blocking=False) is not None:
            pass
        self._ground.mav.command_long_send(1, 191, LAND, 0, *[0.0] * 7)
        await self._answer(IN_PROGRESS, 3.0)

    async def landed(self) -> None:
        """The order's last answer; it stands disarmed, and the service stands by again."""
        begun_s = time.monotonic()
        await self._answer(ACCEPTED, PATIENCE_S)
        await until(lambda: not self.beat.armed, "disarmed", 3.0)
        await until(lambda: phase() == "standby", "standby", 20.0)
        step(f"ordered by MAV_CMD_NAV_LAND: landed and disarmed after {time.monotonic() - begun_s:.0f} s")

    async def _answer(self, result: int, most_s: float) -> None:
        answers: list[int] = []

        def came() -> bool:
            while (ack := self._ground.recv_match(type="COMMAND_ACK", blocking=False)) is not None:
                if ack.command == LAND and ack.get_srcComponent() == 191:
                    answers.append(ack.result)
            if any(answer not in (IN_PROGRESS, result) for answer in answers):
                raise DeploymentError(f"the order was answered {answers}, expected {result}")
            return result in answers

        await until(came, f"answer {result} to the order", most_s)


async def _first(stream: Any, holds: Callable[[Any], bool]) -> None:
    """Wait for a telemetry message of which something holds."""
    async with asyncio.timeout(PATIENCE_S), aclosing(stream) as messages:
        async for message in messages:
            if holds(message):
                return


@asynccontextmanager
async def connected() -> AsyncIterator[Any]:
    """MAVSDK's system of the vehicle."""
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    mavsdk = Mavsdk(configuration)
    configuration.destroy()
    try:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{CLIENT_PORT}")
        system = await mavsdk.first_autopilot(PATIENCE_S)
        if system is None:
            raise DeploymentError("MAVSDK finds no autopilot")
        yield system
    finally:
        await asyncio.to_thread(mavsdk.destroy)


# ---------------------------------------------------------------- the parts


async def land(pilot: ScriptedPilot) -> None:
    """Two landings in one run; stopped in a third flight."""
    process = unit("MainPID")
    for _ in range(2):
        await pilot.take_off()
        await pilot.order()
        await pilot.landed()
    if unit("MainPID") != process:
        raise DeploymentError("the service was restarted between the landings")
    await pilot.take_off()
    await pilot.order()
    await until(lambda: reached(phase(), "approach"), "approach")
    await _systemctl("stop", "success")
    await until(lambda: pilot.beat.mode == LOITER, "hold after systemctl stop", 3.0)
    await _systemctl("start", "success")
    await pilot.order()
    await pilot.landed()
    await _systemctl("stop", "success")
    await _systemctl("start", "success")
    await until(lambda: phase() == "standby", "standby")


async def _systemctl(word: str, result: str) -> None:
    """Start or stop the service; a stop is no failure, neither in standby nor in a flight."""
    before = phase()
    await asyncio.to_thread(subprocess.run, ("systemctl", word, "companion"), check=True)
    states = {"start": "active", "stop": "inactive"}
    found = unit("ActiveState"), unit("Result")
    if found != (states[word], result):
        raise DeploymentError(f"systemctl {word} in '{before}': {found}")
    step(f"systemctl {word} in '{before}': {found[0]}, {found[1]}, exit code {unit('ExecMainStatus')}")


async def interrupted(pilot: ScriptedPilot, number: signal.Signals, wanted: str) -> None:
    """A signal in a phase: restarted into standby, with nothing armed or ordered."""
    await pilot.take_off()
    await pilot.order()
    await until(committed if wanted == COMMITTED else lambda: reached(phase(), wanted), wanted)
    process, there = unit("MainPID"), wanted if wanted == COMMITTED else phase()
    os.kill(int(process), number)
    signalled_s = time.monotonic()

    def restarted() -> bool:
        return unit("MainPID") not in ("0", process) and phase() == "standby"

    took_s = await until(restarted, "standby after the restart", RESTARTS_WITHIN_S)
    await asyncio.sleep(WATCHED_S)
    seen = pilot.witness.seen
    found = judging.killed(seen, signalled_s)
    if found or phase() != "standby":
        raise DeploymentError(f"{number.name} in {there}: {'; '.join(found)}, phase '{phase()}'")
    await pilot.action.land()  # the failsafe holds
    await until(lambda: not pilot.beat.armed, "landed by the pilot")
    left_s = judging.left_after_s(seen, signalled_s) or 0.0
    step(f"{number.name} in {there}: failsafe after {left_s:.1f} s, standby after {took_s:.0f} s, silent")


async def fly(part: str) -> None:
    """One part."""
    if part == "land":
        await late_devices()
    with plugged_in() as witness:
        async with connected() as system:
            pilot = ScriptedPilot(system, witness)
            took_s = await until(lambda: not problems(), "healthy")
            step(f"vehicle plugged in: all devices found, healthy after {took_s:.0f} s")
            if part == "land":
                await land(pilot)
                return
            for wanted in ("approach", "descend", COMMITTED):
                await interrupted(pilot, SIGNALS[part], wanted)
            await pilot.take_off()
            await pilot.order()
            await pilot.landed()


def main(words: list[str]) -> int:
    """Entry point; returns the exit status."""
    if words == ["settings"]:
        print(settings_text(), end="")
        return 0
    try:
        asyncio.run(fly(words[0]))
    except DeploymentError as error:
        print(f"pilot: {words[0]}: {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
