"""The local socket: who may open it, what it answers, and what becomes of one that is left behind."""

import asyncio
import errno
import json
import os
import re
import socket
import stat
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import typer

from companion.app.service import commands, local_socket
from companion.app.service.commands import order_command, status_command
from companion.app.service.local_socket import served
from companion.app.service.systemd import ServiceState
from companion.base.clock import Clock, up_s
from companion.base.errors import ConfigError
from companion.base.messages import Order, OrderKind, OrderOutcome, OrderReply

USED: dict[str, Any] = {"used": 1200, "refused": 7, "unused": False, "reason": "too late"}
REPORT: dict[str, Any] = {
    "phase": "standby",
    "order": None,
    "up_s": 7300.0,
    "autopilot": "px4",
    "mode": "AUTO.LOITER",
    "armed": False,
    "battery_percent": 80.0,
    "inputs": [
        {"name": "IMU", "rate_hz": 199.7, "age_s": 0.01, "silent": False, **USED},
        {"name": "GPS", "rate_hz": 0.0, "age_s": 0.1, "silent": False, **USED},
        {"name": "ultrasonic", "rate_hz": 3.0, "age_s": 8.0, "silent": True, **USED},
    ],
    "aligned": True,
    "attitude_std_deg": 0.42,
    "velocity_std_m_s": 0.05,
    "position_std_m": 1.2,
    "pad_seen_s": None,
    "pad_lateral_m": None,
    "pad_height_m": None,
    "sources": [
        {
            "quantity": "attitude",
            "state": "refused",
            "words": "our horizon pitch 12.6 deg, the autopilot's -0.3",
        },
        {"quantity": "heading", "state": "not measured", "words": "not measured yet"},
        {"quantity": "position", "state": "not measured", "words": "not measured yet"},
    ],
    "latency": {"frame": {"p50_ms": 41.0, "p99_ms": 63.0}},
    "late_cycles_percent": 0.1,
    "machine": {"cpu_percent": 14.0, "memory_mb": 180.0, "temperature_deg_c": 51.0, "disk_free_mb": 9000.0},
    "recording": None,
    "events": [{"time_s": 0.2, "severity": "info", "text": "standby: waiting for an order"}],
    "problems": [],
}


class SocketService:
    """What answers behind the socket."""

    def __init__(self, *outcomes: OrderOutcome) -> None:
        self.outcomes, self.orders = outcomes, list[Order]()
        self.report = dict(REPORT)

    async def state(self) -> str:
        return json.dumps(self.report)

    def give(self, order: Order, on_reply: Callable[[OrderReply], None]) -> None:
        self.orders.append(order)
        for outcome in self.outcomes:
            on_reply(OrderReply(1.0, order.kind, order.source, outcome, "words"))


@asynccontextmanager
async def running(service: SocketService, path: Path) -> AsyncIterator[None]:
    async with served(path, service.state, service.give, Clock()):
        yield


async def ask(path: Path, line: bytes) -> list[dict[str, Any]]:
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(line)
    writer.write_eof()
    answers = [json.loads(text) for text in (await reader.read()).splitlines()]
    writer.close()
    return answers


async def test_it_answers_requests_and_says_what_it_expected(tmp_path: Path) -> None:
    service, path = (
        SocketService(OrderOutcome.IN_PROGRESS, OrderOutcome.ACCEPTED),
        tmp_path / "run" / "socket",
    )
    async with running(service, path):
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
        assert await ask(path, b'{"request": "status"}\n') == [REPORT]
        assert [a["outcome"] for a in await ask(path, b'{"request": "order", "kind": "land"}\n')] == [
            "in_progress",
            "accepted",
        ]
        late = b'{"request": "order", "kind": "land", "until_s": 1%s}\n' % (b"0" * 400)
        nested = b"[" * 4000 + b"\n"
        for wrong in (
            b"\n",
            b"{}\n",
            b"[]\n",
            b'{"request": "order", "kind": "dance"}\n',
            b"\xff\n",
            late,
            nested,
        ):
            (answer,) = await ask(path, wrong)
            assert "expected a request" in answer["error"]
        assert await ask(path, b"x" * 100_000) == []
        assert await ask(path, b'{"request": "status"}\n') == [REPORT]
    assert [(o.kind, o.source) for o in service.orders] == [(OrderKind.LAND, "the local socket")]
    assert not path.exists()


async def test_no_order_waits_for_the_end_of_another(tmp_path: Path) -> None:
    service, path = SocketService(OrderOutcome.IN_PROGRESS), tmp_path / "socket"
    async with running(service, path):
        _, writer = await asyncio.open_unix_connection(path)
        writer.write(b'{"request": "order", "kind": "land"}\n{"request": "order", "kind": "stop"}\n')
        async with asyncio.timeout(20.0):
            while len(service.orders) < 2:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        writer.close()
    assert [order.kind for order in service.orders] == [OrderKind.LAND, OrderKind.STOP]


async def test_an_order_is_not_followed_once_nobody_waits_for_its_answer(tmp_path: Path) -> None:
    service, path = SocketService(OrderOutcome.ACCEPTED), tmp_path / "socket"
    async with running(service, path):
        for until_s, outcome in ((up_s() - 0.1, "temporarily_rejected"), (up_s() + 60.0, "accepted")):
            request = {"request": "order", "kind": "land", "until_s": until_s}
            (answer,) = await ask(path, json.dumps(request).encode() + b"\n")
            assert answer["outcome"] == outcome
    assert len(service.orders) == 1


async def test_a_second_service_is_refused_and_a_socket_left_behind_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "socket"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as left:
        left.bind(str(path))
    async with running(SocketService(), path):
        with pytest.raises(ConfigError, match="another companion listens there"):
            async with running(SocketService(), path):
                pass
        assert await ask(path, b'{"request": "status"}\n') == [REPORT]


# ---------------------------------------------------------------- the commands


async def command(
    service: SocketService, path: Path, call: Callable[[], None], capsys: pytest.CaptureFixture[str]
) -> tuple[int, str]:
    """Exit code and standard output of a command that asks a running service."""
    async with running(service, path):
        with pytest.raises(typer.Exit) as ended:
            await asyncio.to_thread(call)
    return ended.value.exit_code, capsys.readouterr().out


async def test_status_shows_it_and_its_exit_code_says_healthy_or_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, service = tmp_path / "socket", SocketService()
    code, words = await command(service, path, lambda: status_command(False, False, path), capsys)
    assert code == 0
    for expected in ("healthy", "standby, up 2 h", "200 Hz, now", "p50 41 ms, p99 63 ms", "battery 80 %"):
        assert expected in words
    assert "our horizon pitch 12.6 deg" in words
    assert "used 1200, refused 7: too late" in words
    for expected in ("begins, now", "silent for 8 s", "2 h ago"):  # a GPS that has just come, the first event
        assert expected in words
    service.report["inputs"][0].update(unused=True, reason="stamped ahead")
    _, words = await command(service, path, lambda: status_command(False, False, path), capsys)
    assert "NOT USED, refused 7: stamped ahead" in words
    assert re.search(r"not measured yet +heading, position", words)
    service.report["problems"] = ["camera: no frame yet"]
    _, words = await command(service, path, lambda: status_command(False, False, path), capsys)
    assert re.search(r"state +NOT READY: camera: no frame yet", words)
    code, words = await command(service, path, lambda: status_command(False, True, path), capsys)
    assert (code, json.loads(words)["problems"]) == (1, ["camera: no frame yet"])


async def test_watching_waits_for_a_service_and_goes_on_after_it_ends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, waits = tmp_path / "socket", threading.Semaphore(0)
    turns = iter(range(3))

    def wait(_: float) -> None:
        waits.release()
        if next(turns, None) is None:
            raise KeyboardInterrupt

    monkeypatch.setattr(commands, "sleep_s", wait)
    with pytest.raises(KeyboardInterrupt):
        status_command(True, True, path)
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(told) == 4
    assert all("expected a running companion" in line["error"] for line in told)


@pytest.mark.parametrize(
    ("outcomes", "wait", "code", "said"),
    [
        ((OrderOutcome.IN_PROGRESS,), False, 0, ["land: in progress: words"]),
        ((OrderOutcome.TEMPORARILY_REJECTED,), False, 1, ["land: temporarily rejected: words"]),
        (
            (OrderOutcome.IN_PROGRESS, OrderOutcome.ACCEPTED),
            True,
            0,
            ["land: in progress: words", "land: accepted: words"],
        ),
        (
            (OrderOutcome.IN_PROGRESS, OrderOutcome.FAILED),
            True,
            1,
            ["land: in progress: words", "land: failed: words"],
        ),
    ],
)
async def test_order_says_what_became_of_it(
    outcomes: tuple[OrderOutcome, ...],
    wait: bool,
    code: int,
    said: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "socket"
    found = await command(
        SocketService(*outcomes), path, lambda: order_command(OrderKind.LAND, wait, path), capsys
    )
    assert found == (code, "".join(f"{line}\n" for line in said))


def test_who_may_not_ask_is_told_which_group_may(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # root may enter any folder: the system's answer stands in for its refusal
    def refused(_self: socket.socket, _address: str) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(socket.socket, "connect", refused)
    with pytest.raises(ConfigError, match=r"Permission denied; expected sudo, or .*usermod -aG companion"):
        status_command(False, False, tmp_path / "socket")


def test_the_services_socket_is_asked_while_its_folder_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local_socket, "SYSTEM_FOLDER", tmp_path)
    assert local_socket.where_to_ask() == tmp_path / local_socket.FILE_NAME  # seen or not
    monkeypatch.setattr(local_socket, "SYSTEM_FOLDER", tmp_path / "gone")
    assert local_socket.where_to_ask() == local_socket.socket_path()


@pytest.mark.parametrize(
    ("state", "words"),
    [
        (
            ServiceState("loaded", "enabled", "activating"),
            r"^companion.service is starting; .*in some seconds",
        ),
        (ServiceState("loaded", "enabled", "failed"), r"^companion.service has failed; .*journalctl"),
        (ServiceState("loaded", "enabled", "inactive"), r"^companion.service is stopped; .*systemctl start"),
        (ServiceState("not-found", "", "inactive"), r"gone/companion.sock: No such .*a running companion"),
        (None, r"gone/companion.sock: No such file or directory; expected a running companion"),
    ],
)
def test_where_no_socket_is_yet_it_says_what_the_installed_service_does(
    state: ServiceState | None, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commands, "where_to_ask", lambda: tmp_path / "gone" / local_socket.FILE_NAME)
    monkeypatch.setattr(commands, "listening_elsewhere", lambda _: [])
    monkeypatch.setattr(commands, "service_state", lambda: state)
    with pytest.raises(ConfigError, match=words):
        status_command(False, False)
    with pytest.raises(ConfigError, match="other: No such file or directory; expected a running companion"):
        status_command(False, False, tmp_path / "other")


def test_a_service_that_listens_elsewhere_is_named_with_its_socket(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "theirs" / local_socket.FILE_NAME
    path.parent.mkdir()
    monkeypatch.setattr(commands, "where_to_ask", lambda: tmp_path / "ours" / local_socket.FILE_NAME)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as theirs:
        theirs.bind(str(path))
        assert str(path) not in local_socket.listening_elsewhere(tmp_path)  # it does not listen yet
        theirs.listen()
        assert str(path) not in local_socket.listening_elsewhere(path)
        with pytest.raises(ConfigError, match=rf"one listens at .*{path}.*: expected --socket with its path"):
            status_command(False, False)


def test_where_the_kernel_names_no_sockets_none_listens_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local_socket, "SOCKETS", tmp_path / "no_proc")
    assert local_socket.listening_elsewhere(tmp_path) == []


@pytest.mark.parametrize(
    "answer",
    [
        b"COMPANION FRAMES \x80\n",
        b"[]\n",
        b'{"error": "expected a request"}\n',
        b'{"phase": "standby"}\n',
        b"{" * 9000,
    ],
    ids=["bytes", "list", "error", "another-version", "endless"],
)
async def test_what_answers_otherwise_than_the_service_is_reported_in_one_line(
    answer: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "socket"

    async def converse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(answer)
        writer.close()

    async with await asyncio.start_unix_server(converse, path):
        with pytest.raises(ConfigError, match="that is no answer of this version's service; expected its"):
            await asyncio.to_thread(status_command, False, False, path)
