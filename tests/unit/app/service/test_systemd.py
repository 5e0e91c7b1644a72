"""What systemd is told, over the socket that it names."""

import socket
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest

from companion.app.service.systemd import ServiceNotifier


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


def test_without_a_manager_nothing_is_opened_or_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[object] = []
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    monkeypatch.setattr("companion.app.service.systemd.socket.socket", lambda *kind: opened.append(kind))
    ServiceNotifier().ready()
    assert opened == []
