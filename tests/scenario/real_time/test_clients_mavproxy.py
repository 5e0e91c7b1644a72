"""MAVProxy against `companion-sitl`, as PX4 and as ArduPilot in real time: what its users type."""

import os
import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from companion.base.autopilot_kind import AutopilotKind
from tests.scenario.real_time.serving import serving

MAVPROXY = Path(sys.executable).parent / "mavproxy.py"
MODULES = "link,param,mode,arm,wp,fence,misc,cmdlong,rc"
PATIENCE_S = 60.0  # on a busy machine the vehicle slows down


class MavProxy:
    """A running MAVProxy: what is typed into it, and what it prints."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._lines: queue.Queue[str] = queue.Queue()
        self.said: list[str] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def type(self, line: str, answer: str) -> None:
        """Type a line and wait for what the answer's pattern finds."""
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        self._expect(answer)

    def has_said(self, pattern: str) -> None:
        """Wait until it has printed what the pattern finds, unless it has before."""
        if not any(re.search(pattern, line) for line in self.said):
            self._expect(pattern)

    def _expect(self, pattern: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                self.said.append(self._lines.get(timeout=max(0.0, deadline - time.monotonic())))
            except queue.Empty:
                raise AssertionError(f"no {pattern!r} in:\n{''.join(self.said)}") from None
            if re.search(pattern, self.said[-1]):
                return

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)


@contextmanager
def mavproxy(port: int, folder: Path) -> Iterator[MavProxy]:
    """MAVProxy on a TCP port, its files in a folder of its own."""
    command = (
        *(sys.executable, str(MAVPROXY), "--master", f"tcp:127.0.0.1:{port}"),
        *("--state-basedir", str(folder), "--default-modules", MODULES),
    )
    with subprocess.Popen(
        command,
        cwd=folder,
        env={**os.environ, "HOME": str(folder)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        try:
            yield MavProxy(process)
        finally:
            process.kill()


# each autopilot: the way to a mode, the mode, the way back. MAVProxy's own `mode NAME` and `rtl` put a
# tuple where PX4's modes have three numbers, and end in an error before anything is sent
WORDS: dict[AutopilotKind, tuple[str, str, str]] = {
    "px4": ("long DO_SET_MODE 1 4 3", "LOITER", "long NAV_RETURN_TO_LAUNCH"),
    "ardupilot": ("mode GUIDED", "GUIDED", "rtl"),
}


# a square of a kilometre about either autopilot's usual home, far from where it flies
CORNERS: dict[AutopilotKind, tuple[float, float]] = {
    "px4": (47.3977, 8.5456),
    "ardupilot": (-35.3633, 149.1652),
}
HALF_DEG = 0.005


def fence_file(autopilot_kind: AutopilotKind, folder: Path) -> Path:
    """A fence as MAVProxy's `fence save` and QGroundControl's plain text have it."""
    latitude, longitude = CORNERS[autopilot_kind]
    lines = [
        f"{number}\t0\t3\t5001\t4\t0\t0\t0\t{latitude + y * HALF_DEG}\t{longitude + x * HALF_DEG}\t0\t1"
        for number, (x, y) in enumerate(((-1, -1), (-1, 1), (1, 1), (1, -1)))
    ]
    path = folder / "fence.txt"
    path.write_text("\n".join(("QGC WPL 110", *lines)) + "\n")
    return path


def fly(autopilot_kind: AutopilotKind, folder: Path) -> None:
    """Parameters, modes, waypoints, a fence, arm, take off, return."""
    change, mode, come_back = WORDS[autopilot_kind]
    with serving(autopilot_kind) as served, mavproxy(served.tcp_port, folder) as client:
        client.has_said("Detected vehicle 1:1")
        client.has_said(r"Received \d+ parameters")
        client.type("param fetch", r"Received \d+ parameters")
        client.type("wp list", r"Requesting \d+ waypoints")
        client.has_said("GPS lock")
        client.type(f"fence load {fence_file(autopilot_kind, folder)}", "TYPE_FENCE: ACCEPTED")
        client.type("fence list", "Requesting 4 fence items")
        client.type("mode", f"Available modes:.*{mode}")
        client.type(change, "DO_SET_MODE: ACCEPTED")
        client.type("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED")
        client.has_said("ARMED")
        client.type("takeoff 2", "NAV_TAKEOFF: ACCEPTED")
        time.sleep(4.0)
        client.type("status VFR_HUD", r"VFR_HUD.*climb")
        client.type(come_back, "Mode RTL")
    said = "".join(client.said)
    assert f"Mode {mode}" in said
    assert "no link" not in said
    assert "breach" not in said
    assert "link 1 down" not in said


@pytest.mark.skipif(
    not MAVPROXY.exists(), reason="MAVProxy is not installed beside this interpreter; see Makefile"
)
def test_mavproxy_flies_both_autopilots(tmp_path: Path) -> None:
    folders = tmp_path / "p", tmp_path / "a"
    for folder in folders:
        folder.mkdir()
    with ThreadPoolExecutor() as pool:
        for flight in [pool.submit(fly, "px4", folders[0]), pool.submit(fly, "ardupilot", folders[1])]:
            flight.result()
