"""A service and a simulated vehicle as two processes in real time, with a witness on the line between."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import yaml

from companion.config import CONFIG_FOLDER, merge
from companion.link.codec import Codec, mavlink

ROOT: Final = CONFIG_FOLDER.parent
PATIENCE_S: Final = 60.0
ASKING: Final = frozenset({mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE})
OFFBOARD: Final = 6 << 16  # PX4's main mode


@dataclass
class Seen:
    """What passed, with the time (s, monotonic): the app's setpoints and commands, the autopilot's modes."""

    setpoints: list[float] = field(default_factory=list)
    commands: list[tuple[float, int]] = field(default_factory=list)
    beats: list[tuple[float, int, bool]] = field(default_factory=list)  # custom mode, armed

    def take(self, message: Any, now_s: float, *, from_app: bool) -> None:
        """Note a message."""
        kind = message.get_type()
        if from_app and kind.startswith("SET_") and "TARGET" in kind:
            self.setpoints.append(now_s)
        elif from_app and kind in {"COMMAND_LONG", "COMMAND_INT"} and message.command not in ASKING:
            self.commands.append((now_s, message.command))
        elif not from_app and kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            self.beats.append((now_s, message.custom_mode, armed))


class Witness:
    """A UDP relay between the app, which calls `port`, and the simulated vehicle at `vehicle_port`."""

    def __init__(self, vehicle_port: int) -> None:
        self.seen = Seen()
        self._app_side = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._app_side.bind(("127.0.0.1", 0))
        self._vehicle_side = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._vehicle_side.connect(("127.0.0.1", vehicle_port))
        self.port: int = self._app_side.getsockname()[1]
        self._ends = False
        self._thread = threading.Thread(target=self._relay, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the relay."""
        self._ends = True
        self._thread.join()
        self._app_side.close()
        self._vehicle_side.close()

    def _relay(self) -> None:
        app: tuple[str, int] | None = None
        codecs = {True: Codec(1), False: Codec(1)}
        while not self._ends:
            for ready in select.select([self._app_side, self._vehicle_side], [], [], 0.2)[0]:
                from_app = ready is self._app_side
                with suppress(OSError):
                    if from_app:
                        data, app = self._app_side.recvfrom(65536)
                        self._vehicle_side.send(data)
                    else:
                        data = self._vehicle_side.recv(65536)
                        if app is not None:
                            self._app_side.sendto(data, app)
                    now_s = time.monotonic()
                    for message in codecs[from_app].decode(data):
                        self.seen.take(message, now_s, from_app=from_app)


@dataclass
class Stage:
    """A simulator, a witness, and whatever services are started."""

    folder: Path
    settings: Path
    witness: Witness
    simulator: subprocess.Popen[str]
    service: subprocess.Popen[str] | None = None

    def start_service(self) -> float:
        """Start the service; returns how long (s) it took to say that it stands by."""
        begun_s = time.monotonic()
        self.service = subprocess.Popen(
            (
                *(sys.executable, "-m", "companion.cli", "--no-ui", "--config", str(self.settings)),
                *("--record", str(self.folder / "flights")),
            ),
            cwd=ROOT,
            env=os.environ | {"RUNTIME_DIRECTORY": str(self.folder / "run"), "PYTHONUNBUFFERED": "1"},
            stdout=(self.folder / "said.txt").open("a"),
            stderr=subprocess.STDOUT,
            text=True,
        )
        said = (self.folder / "said.txt").stat().st_size
        while b"standby: waits for an order" not in (self.folder / "said.txt").read_bytes()[said:]:
            if time.monotonic() - begun_s > PATIENCE_S or self.service.poll() is not None:
                raise RuntimeError("the service did not stand by")
            time.sleep(0.02)
        return time.monotonic() - begun_s

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """One answer of the service's."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(5.0)
            connection.connect(str(self.folder / "run" / "companion.sock"))
            connection.sendall(json.dumps(request).encode() + b"\n")
            answer: dict[str, Any] = json.loads(connection.makefile("rb").readline())
            return answer

    def wait_until(self, phase: str | None, *, healthy: bool = False, most_s: float = PATIENCE_S) -> None:
        """Wait for a phase, or for a service without problems."""
        by_s = time.monotonic() + most_s
        while True:
            report = self.ask({"request": "status"})
            if (phase is None or report["phase"] == phase) and not (healthy and report["problems"]):
                return
            if time.monotonic() > by_s:
                raise RuntimeError(f"not {phase or 'healthy'} within {most_s:g} s: {report['problems']}")
            time.sleep(0.2)

    def report(self) -> dict[str, Any]:
        """End the simulation; what it says of the flight."""
        said, _ = self.simulator.communicate("finish aborted\n", timeout=30.0)
        told: dict[str, Any] = json.loads(Path(json.loads(said.splitlines()[-1])["report"]).read_text())
        return told


@contextmanager
def stage(folder: Path, scenario: str, seed: int) -> Iterator[Stage]:
    """A vehicle that is served, and the settings with which a service finds it; all ended at the end."""
    simulator = subprocess.Popen(
        (
            *(sys.executable, "-m", "sitl.cli", "--child", "--scenario", scenario),
            *("--seed", str(seed), "--folder", str(folder)),
        ),
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert simulator.stdout is not None
    wired = json.loads(simulator.stdout.readline())
    witness = Witness(int(wired["link"]["connection"].rpartition(":")[2]))
    changes = {
        "link": {"connection": f"udp:127.0.0.1:{witness.port}"},
        "plan": {"mission": {"may_arm": True}},
    }
    settings = folder / "companion.yaml"
    settings.write_text(yaml.safe_dump(merge(wired, changes)))
    made = Stage(folder, settings, witness, simulator)
    try:
        yield made
    finally:
        for process in (made.service, simulator):
            if process is not None and process.poll() is None:
                with suppress(OSError):
                    process.send_signal(signal.SIGCONT)
                    process.kill()
                process.wait()
        witness.close()
