"""`companion check --pad` as a program: on a vehicle in another process, and what it refuses."""

import subprocess
import sys
import threading
from pathlib import Path

import pytest
import yaml
from pymavlink import mavutil

from tests.programs import ProgramHere
from tests.scenario.real_time.hand_held import PATIENCE_S, ROOT, held

FORCE = 21196
NO_FOLDER = "/nowhere/check.json: expected a file in an existing folder"


def arm(connection: str) -> None:
    """Arm a vehicle against its will."""
    line = mavutil.mavlink_connection(f"udpout:{connection.partition(':')[2]}", source_system=254)
    for _ in range(20):
        line.mav.command_long_send(
            1, 1, mavutil.mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, FORCE, 0, 0, 0, 0, 0
        )
        answer = line.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.5)
        if answer is not None and answer.result == mavutil.mavlink.MAV_RESULT_ACCEPTED:
            break
    line.close()


def test_it_checks_by_the_devices_and_ends_when_the_vehicle_is_armed(tmp_path: Path) -> None:
    with held(tmp_path) as path:
        command = (
            sys.executable,
            "-m",
            "companion.cli",
            "check",
            "--pad",
            "--config",
            str(path),
            "--serve",
            "0",
        )
        with subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            guard = threading.Timer(PATIENCE_S, process.kill)
            guard.start()
            assert process.stdout is not None
            said = []
            for line in process.stdout:
                said.append(line.strip())
                if "Raise it" in line:
                    break
            arm(yaml.safe_load(path.read_text())["link"]["connection"])
            _, errors = process.communicate()
            guard.cancel()
    assert said[0].startswith("picture at http://127.0.0.1:")
    assert "Hold it level" in said[1]
    answers = {line.partition(":")[0] for line in said if line.startswith("ok")}
    assert answers >= {"ok  level is level", "ok  compass", "ok  height, low"}, said
    assert process.returncode == 2
    assert errors.startswith("companion: the autopilot says armed; expected a disarmed vehicle")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--serve", "8080"), "--serve: belongs to --pad"),
        (("--json", "/nowhere/check.json"), f"--json {NO_FOLDER}"),
        (("--config", "missing.yaml"), "missing.yaml: cannot be read"),
        (("--pad", "--json", "/nowhere/check.json"), f"--json {NO_FOLDER}"),
        (("--pad", "--config", "missing.yaml"), "missing.yaml: cannot be read"),
        (("--pad", "--no-link", "--config", "telemetry.yaml"), "--no-link: sense.source is autopilot"),
        (("--pad", "--no-link", "--config", "absent.yaml"), "serial port /nowhere/gps: cannot be opened"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    words: tuple[str, ...],
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    program: ProgramHere,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "telemetry.yaml").write_text("sense: {source: autopilot}\n")
    (tmp_path / "absent.yaml").write_text(
        "sense: {imu: {bus: 'socket:/nowhere/bus'}, gps: {port: /nowhere/gps}}\n"
    )
    assert program("companion", "check", *words).refusal.startswith(f"companion: {expected}")
