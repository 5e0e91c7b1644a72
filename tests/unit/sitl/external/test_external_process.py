"""The external world as a process: its words, its end, and its verdict."""

import asyncio
import json
import signal
import socket
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from companion.base.messages import Outcome
from companion.config import CONFIG_FOLDER
from sitl.cli import main
from sitl.run.report import read_report
from sitl.scenario.home import magnetic_field_ned_ut
from tests.unit.sitl.external.external_bench import Player
from tests.unit.sitl.external.external_vehicle import GROUND, PX4


def test_what_is_no_connection_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(("--external", "udpin:127.0.0.1:0"))
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("companion-sitl: --external udpin:127.0.0.1:0: expected udp:HOST:PORT")


def test_for_people_it_waits_until_it_is_stopped_and_judges_then(tmp_path: Path) -> None:
    with subprocess.Popen(
        (sys.executable, "-m", "sitl.cli", "--external", f"udpin:127.0.0.1:{free_port()}",
         "--folder", str(tmp_path)),
        cwd=CONFIG_FOLDER.parent, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True,
    ) as process:  # fmt: skip
        assert process.stderr is not None
        assert "pad lies flush" in process.stderr.readline()
        assert "waiting for a vehicle" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        said, words = process.communicate(timeout=20.0)
    assert (process.returncode, words) == (0, "")
    assert read_report(Path(json.loads(said)["report"])).failures == ("never touched down",)


def free_port() -> int:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as finder:
        finder.bind(("127.0.0.1", 0))
        number: int = finder.getsockname()[1]
        return number


async def test_as_a_process_it_serves_and_judges(tmp_path: Path) -> None:
    player = Player(PX4, lambda _: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0)
    await player.open()
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "sitl.cli", "--external", f"udp:127.0.0.1:{player.port}"),
        *("--scenario", "line", "--folder", str(tmp_path), "--child"),
        cwd=CONFIG_FOLDER.parent,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    playing = asyncio.create_task(player.run(20.0, 0.0))
    assert process.stdout is not None
    endpoints = json.loads(await asyncio.wait_for(process.stdout.readline(), 20.0))
    assert endpoints["sense"]["source"] == "autopilot"
    # by a heading of another place's declination the app would be told wrong
    assert endpoints["estimate"]["magnetic_field_ned_ut"] == list(magnetic_field_ned_ut(GROUND))
    assert endpoints["sense"]["range"]["port"].startswith("/dev/")
    assert endpoints["sense"]["vision"]["source"] == f"socket:{tmp_path / 'camera'}"
    said, words = await asyncio.wait_for(process.communicate(b"finish search\n"), 20.0)
    playing.cancel()
    await asyncio.gather(playing, return_exceptions=True)
    player.close()
    assert process.returncode == 0
    assert read_report(Path(json.loads(said)["report"])).outcome is Outcome.TIMEOUT
    lines = words.decode().splitlines()
    assert "pad.surface_height_m 0.3 is taken as 0" in lines[0]
    assert lines[1].endswith(f"waiting for a vehicle on udp:127.0.0.1:{player.port}")
