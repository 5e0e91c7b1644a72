"""What systemd is told, over the socket that it names."""

import re
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Final

import pytest

from companion.app.command import EXIT_CODES
from companion.app.missions import LAST_REQUESTS_S, LINGER_S
from companion.app.service.systemd import ServiceNotifier
from companion.base.command_line import INTERRUPTED
from companion.base.messages import Outcome
from companion.config import CompanionConfig


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """A service manager that listens."""
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(5.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield listener


def test_each_state_is_one_datagram(manager: socket.socket) -> None:
    notifier = ServiceNotifier()
    notifier.ready()
    notifier.alive()
    notifier.status("search: pad not seen")
    notifier.stopping()
    heard = [manager.recv(1000) for _ in range(4)]
    assert heard == [b"READY=1", b"WATCHDOG=1", b"STATUS=search: pad not seen", b"STOPPING=1"]


def test_a_manager_that_does_not_read_holds_nobody_up(manager: socket.socket) -> None:
    notifier = ServiceNotifier()
    for _ in range(5000):
        notifier.alive()
    manager.setblocking(False)
    waiting = 0
    with suppress(BlockingIOError):
        while manager.recv(1000) == b"WATCHDOG=1":
            waiting += 1
    assert 0 < waiting < 5000
    notifier.status("heard again")
    assert manager.recv(1000) == b"STATUS=heard again"


def test_a_manager_that_went_away_is_no_fault_of_the_flight(
    manager: socket.socket, capfd: pytest.CaptureFixture[str]
) -> None:
    notifier = ServiceNotifier()
    notifier.ready()
    assert manager.recv(1000) == b"READY=1"
    manager.close()
    notifier.alive()
    notifier.alive()
    assert capfd.readouterr() == ("", "")


def test_one_that_could_not_be_sent_does_not_end_the_watchdog_s(
    manager: socket.socket, tmp_path: Path
) -> None:
    notifier, away = ServiceNotifier(), tmp_path / "away"
    (tmp_path / "notify").rename(away)
    notifier.alive()
    away.rename(tmp_path / "notify")
    notifier.alive()
    assert manager.recv(1000) == b"WATCHDOG=1"


@pytest.mark.parametrize("text", ["refused\nSTOPPING=1", "refused\r\nSTOPPING=1"])
def test_no_text_is_more_than_one_line_of_the_protocol(text: str, manager: socket.socket) -> None:
    notifier = ServiceNotifier()
    notifier.status(text)
    notifier.status("lost: \ud800")  # as a file's name may read that is no UTF-8
    assert [manager.recv(1000) for _ in range(2)] == [b"STATUS=refused STOPPING=1", b"STATUS=lost: ?"]


def test_without_a_manager_nothing_is_opened_or_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[object] = []
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    monkeypatch.setattr("companion.app.service.systemd.socket.socket", lambda *kind: opened.append(kind))
    ServiceNotifier().ready()
    assert opened == []


# ---------------- The systemd unit: systemd itself finds nothing wrong with it

FOLDER = Path(__file__).resolve().parents[4] / "systemd"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed here")
def test_the_unit_is_verified_by_systemd(tmp_path: Path) -> None:
    # the program is not installed here: put one in its place that is
    unit = (FOLDER / "companion.service").read_text()
    path = tmp_path / "companion.service"
    path.write_text(unit.replace("/opt/companion/current/.venv/bin/companion", "/bin/true"))
    done = subprocess.run(
        ["systemd-analyze", "verify", str(path)], capture_output=True, text=True, timeout=60, check=False
    )
    about_ours = [line for line in done.stderr.splitlines() if "companion.service" in line]
    assert (done.returncode, about_ours) == (0, []), done.stderr


def test_the_unit_starts_the_command_that_is_installed() -> None:
    unit = (FOLDER / "companion.service").read_text()
    assert "ExecStart=/opt/companion/current/.venv/bin/companion " in unit
    assert "KillSignal=SIGINT" in unit


def test_a_stop_in_flight_is_no_failure_and_wrong_settings_are_not_tried_again() -> None:
    unit = (FOLDER / "companion.service").read_text().splitlines()
    assert f"SuccessExitStatus={EXIT_CODES[Outcome.ABORTED]} {INTERRUPTED}" in unit
    assert "RestartPreventExitStatus=2" in unit
    assert "Restart=always" in unit


def settings_of_the_unit() -> dict[str, str]:
    lines = (FOLDER / "companion.service").read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))


def test_it_is_started_where_it_may_write() -> None:
    # lgpio leaves a pipe in the working folder; a service's is "/", read-only
    unit = settings_of_the_unit()
    assert unit["WorkingDirectory"] == f"%S/{unit['StateDirectory']}"
    assert unit["ProtectSystem"] == "strict"


# the kernel's groups of devices (/proc/devices): the module that makes each, or none, where it is built in
MODULES: Final = {
    "ttyACM": "cdc_acm",
    "ttyUSB": "usbserial",
    "i2c": "i2c_dev",
    "video4linux": "videodev",
    "media": "mc",
    "spi": "spidev",
    **dict.fromkeys(("ttyAMA", "ttyS", "dma_heap", "gpiochip")),
}


def test_every_group_of_devices_is_there_before_the_list_of_those_allowed_is_resolved() -> None:
    # systemd.resource-control(5): a group that the kernel has not yet is left out, until the next start
    unit = (FOLDER / "companion.service").read_text()
    groups = re.findall(r"^DeviceAllow=char-(\S+) rw$", unit, re.MULTILINE)
    assert set(groups) == set(MODULES)
    wanted = {f"modprobe@{module}.service" for module in MODULES.values() if module}
    for key in ("Wants", "After"):
        named = " ".join(re.findall(rf"^{key}=(.*)$", unit, re.MULTILINE)).split()
        assert wanted <= set(named)


def test_the_service_comes_before_other_programs_and_not_before_the_kernels() -> None:
    unit = settings_of_the_unit()
    assert int(unit["Nice"]) < 0  # within a control group
    assert int(unit["CPUWeight"]) > 100  # between groups; systemd's own
    # all its threads would have a real-time policy: vision, the log
    assert unit.get("CPUSchedulingPolicy", "other") == "other"


def test_systemd_waits_until_a_vehicle_that_climbs_clear_of_the_pad_is_handed_back() -> None:
    unit = (FOLDER / "companion.service").read_text().splitlines()
    [waits_s] = [float(line.split("=")[1]) for line in unit if line.startswith("TimeoutStopSec=")]
    climbs_s = CompanionConfig().plan.mission.phases.hold_s
    assert waits_s >= climbs_s + LAST_REQUESTS_S + LINGER_S + 5.0  # and the log is closed


def test_the_install_script_is_sound_bash() -> None:
    command = ["bash", "-n", str(FOLDER / "install.sh")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    assert (done.returncode, done.stderr) == (0, "")
