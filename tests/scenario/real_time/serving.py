"""`companion-sitl` as its users start it, on free ports, for clients that nobody here wrote."""

import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from companion.base.autopilot_kind import AutopilotKind
from companion.config import CONFIG_FOLDER
from tests.scenario.real_time.quiet_machine import beside_lateness

START_TIMEOUT_S = 30.0


@dataclass(frozen=True)
class ServedVehicle:
    """A vehicle that is being served, and where: the ports that clients call."""

    autopilot_kind: AutopilotKind
    companion_port: int
    ground_port: int
    tcp_port: int


@contextmanager
def serving(autopilot_kind: AutopilotKind, *arguments: str | int | Path) -> Iterator[ServedVehicle]:
    """Start it with `arguments`, and end it as Ctrl-C does; nothing else may be on its standard error."""
    command = (
        *(sys.executable, "-m", "sitl.cli", "--autopilot", autopilot_kind, "--scenario", "static"),
        *("--port", "0", "--gcs-port", "0", "--tcp-port", "0", *map(str, arguments)),
    )
    with subprocess.Popen(
        command,
        cwd=CONFIG_FOLDER.parent,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield ServedVehicle(autopilot_kind, *_ports(process))
        finally:
            process.send_signal(signal.SIGINT)
            try:
                _, errors = process.communicate(timeout=10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
            ended = process.returncode, beside_lateness(errors)
            assert ended == (0, ""), ended


def _ports(process: subprocess.Popen[str]) -> tuple[int, int, int]:
    """The three ports that the start-up text names, in its order."""
    assert process.stdout is not None
    ports: list[int] = []
    guard = threading.Timer(START_TIMEOUT_S, process.kill)  # which ends the reading
    guard.start()
    for line in process.stdout:
        if found := re.match(r"  (?:UDP|TCP) (\d+)", line):
            ports.append(int(found[1]))
        if line.startswith("Ctrl-C"):
            break
    guard.cancel()
    companion, ground, tcp = ports
    return companion, ground, tcp
