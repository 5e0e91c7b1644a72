"""A service and a simulated vehicle as two processes in real time, with a witness on the line between."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from benchmarks.service.judging import UdpWitness
from companion.base.messages import Phase
from companion.config import CONFIG_FOLDER, merge
from sitl.scenario.scenario import load_scenario

ROOT: Final = CONFIG_FOLDER.parent
PATIENCE_S: Final = 60.0
NEAR: Final = Path(__file__).with_name("near.yaml")
STANDS_BY: Final = b"standby: waiting for an order"


def ask(path: Path, request: dict[str, Any]) -> dict[str, Any]:
    """One answer of the service's at its local socket.

    Raises:
        OSError: nobody answers.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(5.0)
        connection.connect(str(path))
        connection.sendall(json.dumps(request).encode() + b"\n")
        answer: dict[str, Any] = json.loads(connection.makefile("rb").readline() or b"{}")
        return answer


@dataclass
class Stage:
    """A simulator, a witness, and whatever services are started."""

    folder: Path
    settings: Path
    witness: UdpWitness
    simulator: subprocess.Popen[str]
    service: subprocess.Popen[str] | None = None

    def start_service(self, *, nice: int = 0) -> float:
        """Start the service; returns how long (s) it took to say that it stands by."""
        begun_s = time.monotonic()
        self.service = subprocess.Popen(
            (
                *("nice", "-n", str(nice), sys.executable, "-m", "companion.cli"),
                *("--no-ui", "--config", str(self.settings)),
                *("--record", str(self.folder / "flights")),
            ),
            cwd=ROOT,
            env=os.environ | {"RUNTIME_DIRECTORY": str(self.folder / "run"), "PYTHONUNBUFFERED": "1"},
            stdout=(self.folder / "said.txt").open("a"),
            stderr=subprocess.STDOUT,
            text=True,
        )
        said = (self.folder / "said.txt").stat().st_size
        while STANDS_BY not in (self.folder / "said.txt").read_bytes()[said:]:
            if time.monotonic() - begun_s > PATIENCE_S or self.service.poll() is not None:
                raise RuntimeError("the service did not stand by")
            time.sleep(0.02)
        return time.monotonic() - begun_s

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """One answer of the service's."""
        return ask(self.folder / "run" / "companion.sock", request)

    def wait_until(self, phase: str | None, *, healthy: bool = False) -> None:
        """Wait for a phase, or for a service without problems."""
        by_s = time.monotonic() + PATIENCE_S
        while True:
            report = self.ask({"request": "status"})
            if (phase is None or report["phase"] == phase) and not (healthy and report["problems"]):
                return
            if time.monotonic() > by_s:
                raise RuntimeError(f"not {phase or 'healthy'} within {PATIENCE_S:g} s: {report['problems']}")
            time.sleep(0.2)

    def end_service(self) -> int:
        """Ask the service to end; its exit code."""
        assert self.service is not None
        self.service.send_signal(signal.SIGINT)
        return self.service.wait(timeout=PATIENCE_S)

    def finish(self) -> Path:
        """End the simulation; where its report is."""
        said, _ = self.simulator.communicate(f"finish {Phase.ABORT}\n", timeout=30.0)
        return Path(json.loads(said.splitlines()[-1])["report"])


@contextmanager
def stage(folder: Path, scenario: str | Path, seed: int) -> Iterator[Stage]:
    """A vehicle that is served, and the settings with which a service finds it; all ended at the end."""
    simulator = subprocess.Popen(
        (
            *(sys.executable, "-m", "sitl.cli", "--child", "--scenario", str(scenario)),
            *("--seed", str(seed), "--folder", str(folder)),
        ),
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=(folder / "simulator.txt").open("w"),
        text=True,
    )
    assert simulator.stdout is not None
    wired = json.loads(simulator.stdout.readline())
    witness = UdpWitness(int(wired["link"]["connection"].rpartition(":")[2]))
    operator = load_scenario(scenario).companion
    changes: dict[str, Any] = {
        "link": {"connection": f"udp:127.0.0.1:{witness.port}"},
        "plan": {"mission": {"may_arm": True}},
    }
    settings = folder / "companion.yaml"
    settings.write_text(yaml.safe_dump(merge(merge(wired, operator), changes)))
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
