"""The simulator as a command: what is wrong is said in one line, and it ends with its standard input."""

import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from companion.config import CONFIG_FOLDER, load_config
from sitl.run.process_control import read_report
from tests.programs import ProgramHere
from tests.waiting import soon

COMMAND = (sys.executable, "-m", "sitl.cli")
FREE_PORTS = ("--port", "0", "--gcs-port", "0", "--tcp-port", "0")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--scenario", "nowhere"), "scenarios: no 'nowhere'; expected the path of a .yaml file or one of: "),
        (("--seed", "-1"), "Invalid value for '--seed': Input should be greater than or equal to 0"),
        (("--port", "99999"), "Invalid value for '--port': Input should be less than or equal to 65535"),
        (("--wings", "2"), "No such option: --wings"),
        (("--seed", "3", "campaign"), "--seed: applies to a served vehicle; expected it without 'campaign'"),
        (("--bind", "a..b"), "UDP port a..b:14580: "),
        (("--external", "tcp:a..b:1"), "--external tcp:a..b:1: expected udp:HOST:PORT"),
        (("--external", "udp:a..b:1"), "--external udp:a..b:1: expected udp:HOST:PORT"),
        *(
            (
                ("--external", "udp:127.0.0.1:9", *more),
                f"{more[0]}: has no effect with an external vehicle; expected it",
            )
            for more in (("--bind", "0.0.0.0"), ("--port", "1"), ("--signing-key", "k"), ("--serve-truth",))
        ),
        (("--child", "--tcp-port", "1"), "--tcp-port: expected it without --child"),
        (("--folder", "/nowhere"), "--folder /nowhere: expected a folder that can be written to"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    arguments: tuple[str, ...], expected: str, program: ProgramHere
) -> None:
    assert program("companion-sitl", *arguments).refusal.startswith(f"companion-sitl: {expected}")


def test_a_port_in_use_is_said(program: ProgramHere) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        port = other.getsockname()[1]
        refusal = program("companion-sitl", "--port", 0, "--gcs-port", 0, "--tcp-port", port).refusal
    assert f"TCP port 127.0.0.1:{port}: already in use; expected a free port at an address" in refusal


@contextmanager
def child_in(folder: Path, *words: str) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """A simulator as a child process that listens, and the endpoints that it told."""
    with subprocess.Popen(
        (*COMMAND, *words, "--child", "--folder", str(folder)),
        cwd=CONFIG_FOLDER.parent,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        endpoints = json.loads(process.stdout.readline())
        assert endpoints["link"]["connection"].startswith("udp:127.0.0.1:")
        assert (folder / "camera").is_socket()
        assert (folder / "registers").is_socket()
        yield process, endpoints


def test_it_says_where_it_listens_and_judges_when_asked(tmp_path: Path) -> None:
    with child_in(tmp_path) as (process, endpoints):
        assert Path(endpoints["sense"]["gps"]["port"]).is_char_device()
        said, _ = process.communicate("finish search\n", timeout=20.0)
    assert process.returncode == 0
    report = read_report(Path(json.loads(said)["report"]))
    assert report.outcome == "timeout"
    assert report.touchdown is None


@pytest.mark.parametrize("name", ["camera", "registers"])
def test_a_file_in_a_sockets_place_is_said(name: str, tmp_path: Path, program: ProgramHere) -> None:
    (tmp_path / name).write_text("a file")
    assert "is in the way of a socket" in program("companion-sitl", "--folder", tmp_path, *FREE_PORTS).refusal
    assert (tmp_path / name).read_text() == "a file"


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A folder whose sockets have names that are short enough, whatever pytest calls its own."""
    with tempfile.TemporaryDirectory(prefix="sitl-") as folder:
        yield Path(folder)


def test_terminated_while_it_starts_it_leaves_nothing(short_path: Path) -> None:
    with subprocess.Popen(
        (*COMMAND, *FREE_PORTS),
        cwd=CONFIG_FOLDER.parent,
        env={**os.environ, "TMPDIR": str(short_path)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        soon(lambda: list(short_path.glob("companion-sitl-*")))
        process.terminate()
        _, errors = process.communicate(timeout=20.0)
    assert not list(short_path.iterdir())
    assert (process.returncode, errors) == (130, b"")


def test_a_child_ends_with_its_standard_input() -> None:
    words, nothing = (*COMMAND, "--child"), subprocess.DEVNULL
    done = subprocess.run(
        words, cwd=CONFIG_FOLDER.parent, stdin=nothing, capture_output=True, timeout=20, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")


def test_the_settings_that_lead_to_a_served_vehicle_are_the_apps(tmp_path: Path) -> None:
    (tmp_path / "desk.yaml").write_text(
        "name: desk\ndescription: x\npad: {motion: {kind: static}}\n"
        "companion: {plan: {mission: {may_arm: true}}}\n"
    )
    (tmp_path / "key").write_text("a passphrase")
    (tmp_path / "key").chmod(0o600)
    words = ("--scenario", "desk.yaml", "--settings", "settings.yaml", "--signing-key", "key")
    with subprocess.Popen(
        (*COMMAND, *words, *FREE_PORTS),
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(CONFIG_FOLDER.parent), "PYTHONUNBUFFERED": "1"},
    ) as simulator:
        assert simulator.stdout is not None
        while "settings" not in (line := simulator.stdout.readline()):
            assert line, "it has ended"
        found = load_config(tmp_path / "settings.yaml")
        simulator.terminate()
    assert found.plan.mission.may_arm
    assert found.link.connection.startswith("udp:127.0.0.1:")
    assert (found.link.signing_key, found.link.actions) == (tmp_path / "key", "pymavlink")
    assert found.sense.vision.source.startswith("socket:")
    assert found.sense.imu.bus.startswith("socket:")
