"""Two apps on one machine are never at one autopilot, however the first ended or the line is named."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from companion.app.hardware import ASKED, app_at, only_app_at
from companion.config import CONFIG_FOLDER, ConfigError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the lock is Linux's")
HOLDS = """
import sys, time
from companion.app.hardware import only_app_at
with only_app_at(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60.0)
"""


def holder(connection: str) -> subprocess.Popen[str]:
    """Another process that is at the autopilot."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDS, connection], cwd=CONFIG_FOLDER.parent, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_a_second_app_is_reported_who_is_there_and_a_kill_leaves_nothing_held() -> None:
    connection = f"udp:127.0.0.1:{os.getpid()}"
    with holder(connection) as other:
        told = re.escape(f"link.connection {connection}: another companion (process {other.pid}) is at")
        with pytest.raises(ConfigError, match=told), only_app_at(connection):
            pass
        assert app_at(connection) == f"another companion (process {other.pid})"
        with only_app_at(f"tcp:127.0.0.1:{os.getpid()}"):  # another line
            pass
        other.send_signal(signal.SIGKILL)
        other.wait()
        assert app_at(connection) is None
        with only_app_at(connection):
            pass


def test_however_many_ask_each_is_told_that_somebody_is_there() -> None:
    connection = f"udpin:127.0.0.1:{os.getpid()}"
    with only_app_at(connection):
        told = {app_at(connection) for _ in range(2 * ASKED)}
    assert told == {"another companion", f"another companion (process {os.getpid()})"}


def test_a_device_is_the_same_by_whatever_path_it_is_named(tmp_path: Path) -> None:
    device, link = tmp_path / "ttyAMA0", tmp_path / "serial0"
    device.touch()
    link.symlink_to(device)
    there = pytest.raises(ConfigError, match="is at this autopilot")
    with only_app_at(f"serial:{device}:921600"), there, only_app_at(f"serial:{link}:57600"):
        pass
    with only_app_at(f"serial:{link}:921600"):
        pass
