"""`companion check` as a program: on a vehicle in another process, and on wrong and missing devices."""

import json
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.config import merge
from tests.programs import ProgramHere
from tests.scenario.real_time.hand_held import PATIENCE_S, ROOT, held

Findings = dict[tuple[str, str], dict[str, str]]


def checked(settings: Path, *words: str) -> tuple[int, Findings]:
    """The exit code, and the findings by group and name."""
    done = subprocess.run(
        (sys.executable, "-m", "companion.cli", "check", "--config", str(settings), "--json", "-", *words),
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=6.0 * PATIENCE_S,
        check=False,
    )
    assert done.stderr == ""
    detail = json.loads(done.stdout)["findings"]
    return done.returncode, {(finding["group"], finding["name"]): finding for finding in detail}


def changed(settings: Path, name: str, overrides: dict[str, Any]) -> Path:
    """The settings with something else, in a file beside them."""
    path = settings.with_name(name)
    path.write_text(yaml.safe_dump(merge(yaml.safe_load(settings.read_text()), overrides)))
    return path


def not_well(findings: Findings, state: str) -> set[tuple[str, str]]:
    return {key for key, finding in findings.items() if finding["state"] == state}


def test_a_px4_vehicle_that_stands_there(tmp_path: Path) -> None:
    with held(tmp_path) as settings:
        code, findings = checked(settings)
        # an address where nobody is, a bus that is none, a system that is another, a camera of another size
        wrong = changed(
            settings,
            "wrong.yaml",
            {
                "camera": "hd_1280x720",
                "link": {"system_id": 7},
                "sense": {
                    "imu": {"address": 0x69},
                    "gps": {"port": "/dev/nowhere"},
                    "range": {"port": str(tmp_path / "file")},
                },
            },
        )
        wrong_code, mistaken = checked(wrong)
    # how fast things come is this machine's affair
    groups = {group for group, _ in not_well(findings, "fail")}
    assert groups <= {"camera", "telemetry"}, findings
    assert code == bool(groups)
    assert findings["link", "heartbeat"]["detail"].startswith("PX4 1.16.1, mode ")
    assert findings["autopilot's parameters", "COM_RC_OVERRIDE"]["detail"] == "1"
    assert findings["autopilot's parameters", "COM_RC_OVERRIDE"]["state"] == "warning"
    assert findings["autopilot's parameters", "COM_OF_LOSS_T"]["state"] == "ok"
    well = {("IMU", "identity"), ("IMU", "magnetometer"), ("GPS", "fix"), ("range", "echo")}
    assert well <= not_well(findings, "ok"), findings
    assert findings["camera", "exposure"]["state"] == "not checked"

    assert wrong_code == 1
    fails = not_well(mistaken, "fail")
    assert fails == {
        ("camera", "opens"),
        ("IMU", "identity"),
        ("GPS", "opens"),
        ("range", "opens"),
        ("link", "heartbeat"),
    }
    assert "expected the calibration's 1280x720" in mistaken["camera", "opens"]["detail"]
    assert "but system 1's" in mistaken["link", "heartbeat"]["detail"]
    assert not_well(mistaken, "not checked") >= {
        ("telemetry", "rates"),
        ("autopilot's parameters", "parameters"),
    }
    assert all(finding["hint"] for finding in mistaken.values() if finding["state"] in ("fail", "warning"))


def test_an_ardupilot_vehicle_by_its_telemetry_alone(tmp_path: Path) -> None:
    scenario = tmp_path / "copter.yaml"
    scenario.write_text(
        yaml.safe_dump(
            {
                **yaml.safe_load((ROOT / "configs" / "scenarios" / "static.yaml").read_text()),
                "autopilot": "ardupilot",
                "companion": {"sense": {"source": "autopilot"}},
            }
        )
    )
    with held(tmp_path, str(scenario)) as settings:
        code, findings = checked(settings)
    assert code == 1
    assert not_well(findings, "fail") == {("autopilot's parameters", "GUID_OPTIONS")}
    assert findings["autopilot's parameters", "GUID_OPTIONS"]["detail"] == "0"
    assert findings["autopilot's parameters", "GUID_OPTIONS"]["hint"].startswith("expected 8 (bit 3)")
    assert findings["link", "heartbeat"]["detail"].startswith("ArduPilot 4.6.0, mode ")
    assert not_well(findings, "ok") >= {
        ("autopilot's sensors", "IMU and compass"),
        ("autopilot's sensors", "range"),
    }
    assert not {"IMU", "GPS", "range"} & {group for group, _ in findings}


def test_a_line_of_noise_is_reported_from_a_silent_one(tmp_path: Path) -> None:
    settings = tmp_path / "noise.yaml"
    devices = {"sense": {"source": "autopilot", "vision": {"source": f"images:{tmp_path}"}}}
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = "{}:{}".format(*server.getsockname())
        settings.write_text(yaml.safe_dump({**devices, "link": {"connection": f"tcp:{address}"}}))

        def answer() -> None:
            line, _ = server.accept()
            with line:
                line.sendall(b"\x00\x55\xaa" * 1000)
                line.recv(1 << 20)
                threading.Event().wait(8.0)

        threading.Thread(target=answer, daemon=True).start()
        code, findings = checked(settings)
    assert code == 1
    assert "3000 bytes that are no MAVLink 2" in findings["link", "heartbeat"]["detail"]
    assert "MAV_PROTO_VER" in findings["link", "heartbeat"]["hint"]
    assert "baud" not in findings["link", "heartbeat"]["hint"]  # TCP has none


def test_the_result_goes_to_a_file_beside_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: ProgramHere
) -> None:
    settings, result = tmp_path / "mine.yaml", tmp_path / "check.json"
    settings.write_text("sense: {source: autopilot}\n")
    monkeypatch.setenv("COLUMNS", "200")
    words = ("--config", settings, "--no-link", "--json", result, "--record", tmp_path)
    ended = program("companion", "check", *words)
    assert ended.code == 1
    detail = json.loads(result.read_text())
    assert detail["state"] == "fail"
    lines = ended.out.splitlines()
    assert "not ready to fly: camera: opens; not looked at: " in lines[-1]
    assert any("not checked" in line and "--no-link" in line for line in lines)
