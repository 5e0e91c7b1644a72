"""The computer: clock, disk, power, service; and what a running service does to the check."""

import asyncio
import os
import shutil
from collections import namedtuple
from datetime import UTC, datetime
from pathlib import Path

import pytest

from companion.app.service import systemd
from companion.app.service.systemd import ServiceState
from companion.config import CompanionConfig
from companion.tools.preflight import computer, run
from companion.tools.preflight.findings import Finding, FindingGroup, FindingState, summary_line

NOW = datetime(2099, 1, 1, tzinfo=UTC)
RUNNING = ServiceState("loaded", "enabled", "active")
Usage = namedtuple("Usage", "total used free")


def found(
    monkeypatch: pytest.MonkeyPatch,
    folder: Path,
    answers: dict[str, str] | None = None,
    state: ServiceState | None = RUNNING,
    now: datetime = NOW,
) -> dict[str, Finding]:
    """The findings where these programs answer so."""
    detail = {"timedatectl": "yes\n", "vcgencmd": "throttled=0x0\n", **(answers or {})}
    for module in (computer, systemd):
        monkeypatch.setattr(module, "output_of", lambda *words, **_: detail.get(words[0]) or None)
    return {finding.name: finding for finding in computer.check_computer(folder, state, now)}


def test_a_good_computer_is_well(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    states = {finding.state for finding in found(monkeypatch, tmp_path).values()}
    assert states == {FindingState.OK}


@pytest.mark.parametrize(
    ("answers", "name", "state"),
    [
        ({"timedatectl": "no\n"}, "clock", FindingState.WARNING),
        ({"timedatectl": ""}, "clock", FindingState.NOT_CHECKED),
        ({"vcgencmd": "throttled=0x50005\n"}, "power", FindingState.FAIL),
        ({"vcgencmd": "throttled=0x50000\n"}, "power", FindingState.WARNING),
        ({"vcgencmd": "throttled=0x8\n"}, "power", FindingState.WARNING),
        ({"vcgencmd": "VCHI initialization failed"}, "power", FindingState.NOT_CHECKED),
        ({"vcgencmd": ""}, "power", FindingState.NOT_CHECKED),
    ],
)
def test_what_the_programs_answer_counts(
    answers: dict[str, str], name: str, state: FindingState, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert found(monkeypatch, tmp_path, answers)[name].state is state


def test_a_clock_before_the_installation_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    clock = found(monkeypatch, tmp_path, now=datetime(1970, 1, 1, tzinfo=UTC))["clock"]
    assert (clock.state, clock.detail) == (
        FindingState.WARNING,
        "1970-01-01 00:00 UTC, before this was installed",
    )


@pytest.mark.parametrize(
    ("free_mb", "state"), [(100, FindingState.FAIL), (1000, FindingState.WARNING), (9000, FindingState.OK)]
)
def test_room_on_the_disk_counts_for_a_folder_that_is_not_there_yet(
    free_mb: int, state: FindingState, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(0, 0, free_mb * 1_000_000))
    assert found(monkeypatch, tmp_path / "not" / "yet")["disk"].state is state


@pytest.mark.parametrize(
    ("service", "state"),
    [
        (None, FindingState.NOT_CHECKED),
        (ServiceState("not-found", "", "inactive"), FindingState.WARNING),
        (ServiceState("loaded", "disabled", "inactive"), FindingState.WARNING),
        (ServiceState("loaded", "enabled", "failed"), FindingState.FAIL),
        (ServiceState("loaded", "enabled", "inactive"), FindingState.OK),
    ],
)
def test_the_service_is_to_be_installed_and_enabled(
    service: ServiceState | None, state: FindingState, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert found(monkeypatch, tmp_path, state=service)["service"].state is state


@pytest.mark.parametrize(
    ("state", "app", "who", "hint"),
    [
        (RUNNING, "another companion (process 7)", "the service", "sudo systemctl stop companion.service"),
        (None, "another companion (process 7)", "another companion (process 7)", "stop it, check"),
    ],
    ids=["service", "by-hand"],
)
def test_what_a_running_app_has_is_left_alone(
    state: ServiceState | None, app: str, who: str, hint: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    async def opened(*_: object) -> list[Finding]:
        raise AssertionError("a device was opened")

    monkeypatch.setattr(run, "service_state", lambda: state)
    monkeypatch.setattr(run, "app_at", lambda _: app)
    monkeypatch.setattr(run, "check_devices", opened)
    monkeypatch.setattr(run, "check_link", opened)
    findings = asyncio.run(run.preflight(CompanionConfig(), Path("x.yaml"), tmp_path))
    left = [finding for finding in findings if f"{who} is running" in finding.detail]
    groups = {"camera", "IMU", "GPS", "range", "link", "telemetry", "autopilot's parameters"}
    assert {finding.group for finding in left} == groups
    assert all(finding.hint.startswith(hint) for finding in left)
    line = summary_line(findings)
    named = "camera, IMU, GPS, range, link, telemetry, autopilot's parameters, second sources"
    assert line.endswith(f"; not looked at: {named}")
    assert "nothing fails" not in line
    assert "no preflight check, since a running app has the devices" in line


def test_a_check_that_looked_at_all_says_that_nothing_fails() -> None:
    group, other = FindingGroup("IMU"), FindingGroup("computer")
    looked_at = [group.ok("samples", "200 Hz"), other.ok("disk", "9 GB"), other.skip("power", "no vcgencmd")]
    assert summary_line(looked_at) == "2 ok, 1 not checked; nothing fails"
    failed = [group.skip("opens", "taken"), other.fail("disk", "0 GB", "")]
    assert summary_line(failed) == (
        "1 fail, 1 not checked; not ready to fly: computer: disk; not looked at: IMU"
    )


@pytest.mark.parametrize("state", [ServiceState("loaded", "disabled", "inactive"), None])
def test_the_disk_is_that_of_the_installed_service_before_its_first_start_too(
    state: ServiceState | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    flights = tmp_path / "var" / "lib" / "companion"
    monkeypatch.setattr(computer, "SERVICE_FLIGHTS", flights)
    (disk,) = (finding for finding in computer.check_computer(None, state, NOW) if finding.name == "disk")
    where = Path.cwd() if state is None else flights
    assert f"GB free for {where}" in disk.detail


def test_who_may_not_write_is_told_what_mends_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(0, 0, 9e9))
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    assert found(monkeypatch, tmp_path)["disk"].hint.startswith("--record DIR")
    monkeypatch.setattr(computer, "SERVICE_FLIGHTS", tmp_path)
    assert found(monkeypatch, tmp_path)["disk"].hint == "sudo -u companion companion check"
