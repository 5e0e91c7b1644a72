"""What a user gets wrong ends in one line on standard error and exit code 2, and leaves nothing behind."""

import os
import socket
import tty
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.config import CONFIG_FOLDER
from tests.programs import EndedProgram, program_here
from tests.scenario.flying import run, scenario_file, started
from tests.unit.link.transport.transport_ends import free_port

DESK = ("--sitl", "--fast", "--no-ui")
Companion = Callable[..., EndedProgram]


@pytest.fixture
def companion(capfd: pytest.CaptureFixture[str]) -> Companion:
    """The command in this process, with what the processes say that it starts."""
    return partial(program_here(capfd), "companion")


def refused(ended: EndedProgram) -> str:
    """The one line of a command that was refused."""
    assert ended.refusal.startswith("companion: "), ended
    return ended.refusal.removeprefix("companion: ").removesuffix("\n")


def settings(folder: Path, content: dict[str, Any] | str) -> Path:
    """A settings file."""
    path = folder / "settings.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return path


# ---------------------------------------------------------------- options


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([*DESK, "--scenario", "nowhere"], "no 'nowhere'; expected the path of a .yaml file or one of:"),
        ([*DESK, "--seed", "seven"], "'--seed'"),
        ([*DESK, "--seed", "-1"], "'--seed'"),
        ([*DESK, "--wings"], "No such option: --wings"),
        ([*DESK, "here"], "No such command 'here'; see companion --help"),
        (["--fast"], "--fast: needs --sitl"),
        (["--scenario", "line"], "--scenario: needs --sitl"),
        (["--seed", "0"], "--seed: needs --sitl"),
        (["--json", "result.json"], "--json: needs --sitl"),
        ([*DESK, "--json", "/nowhere/result.json"], "--json /nowhere/result.json: expected a file"),
        ([*DESK, "--json", "/"], "--json /: expected a file"),
        ([*DESK, "--record", "/proc/flight"], "--record /proc/flight: cannot be written"),
        ([*DESK, "--config", "/nowhere.yaml"], "/nowhere.yaml: cannot be read: No such file"),
    ],
    ids=lambda value: " ".join(value[-2:]) if isinstance(value, list) else "",
)
def test_a_wrong_option_is_named(arguments: list[str], expected: str, companion: Companion) -> None:
    assert expected in refused(companion(*arguments))


def test_a_folder_that_holds_a_flight_is_not_overwritten(tmp_path: Path, companion: Companion) -> None:
    log = tmp_path / "flight.mcap"
    log.write_bytes(b"the last flight")
    assert "holds a flight already" in refused(companion(*DESK, "--record", tmp_path))
    assert log.read_bytes() == b"the last flight"


def own_process(*words: str | Path) -> EndedProgram:
    done = run(*words)
    return EndedProgram(done.code, done.stdout, done.stderr)


def test_the_command_itself_ends_so(tmp_path: Path) -> None:
    assert "No such option" in refused(own_process("--wings"))
    impossible = vehicle(tmp_path, "/dev/ptmx", vision={"source": "film"})
    assert "sense.vision.source: 'film'" in refused(own_process("--no-ui", "--config", impossible))


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("control: {rate_hz: [", "settings.yaml:1:21: broken YAML"),
        ("wings: 2", "settings.yaml: unknown key 'wings'"),
        ("control: {rate_hz: 1000}", "settings.yaml: control.rate_hz: expected less than or equal to 100"),
        ("control: {rate_hz: quick}", "settings.yaml: control.rate_hz: expected a valid number"),
        ("camera: nikon", "cameras: no 'nikon'; expected the path of a .yaml file or one of: "),
        ("pad: lily", "pads: no 'lily'; expected the path of a .yaml file or one of: "),
        ("vehicle: balloon", "vehicles: no 'balloon'; expected the path of a .yaml file or one of: "),
        ("link: {connection: 'ftp:host:1'}", "settings.yaml: link.connection: expected serial:PATH:BAUD"),
    ],
)
def test_a_wrong_setting_is_named_with_its_file_and_key(
    content: str, expected: str, tmp_path: Path, companion: Companion
) -> None:
    path, record = settings(tmp_path, content), tmp_path / "record"
    assert expected in refused(companion(*DESK, "--config", path, "--record", record))
    assert not record.exists()


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"companion": {"plan": {"wings": 2}}}, "line_changed.yaml: companion: unknown key 'plan.wings'"),
        ({"pad": {"motion": {"speed_m_s": 99}}}, "line_changed.yaml: pad.motion.speed_m_s: "),
        ({"airframe": "balloon"}, "airframes: no 'balloon'; expected the path of a .yaml file or one of: "),
    ],
)
def test_a_wrong_scenario_is_named_with_its_file_and_key(
    changes: dict[str, Any], expected: str, tmp_path: Path, companion: Companion
) -> None:
    assert expected in refused(companion(*DESK, "--scenario", scenario_file(tmp_path, "line", changes)))


def test_a_pad_that_the_app_does_not_look_for_is_refused(tmp_path: Path, companion: Companion) -> None:
    pad = {
        "name": "small",
        "width_m": 0.5,
        "length_m": 0.5,
        "markers": [
            {"dictionary": "4x4_50", "id": 0, "side_m": 0.3, "position_pad_m": [0.0, 0.0], "group": "F"}
        ],
    }
    path = settings(tmp_path, pad)
    scenario = scenario_file(tmp_path, "line", {"pad": {"name": str(path)}})
    line = refused(companion(*DESK, "--scenario", scenario))
    assert f"pad.name is '{path}' but the app looks for 'moving_1300'" in line


def test_a_camera_of_another_size_is_refused(tmp_path: Path, companion: Companion) -> None:
    camera = yaml.safe_load((CONFIG_FOLDER / "cameras" / "sitl_640x480.yaml").read_text())
    path = settings(tmp_path, {**camera, "name": "wide", "width_px": 700, "height_px": 500})
    scenario = scenario_file(tmp_path, "line", {"camera": {"config": str(path)}})
    line = refused(companion(*DESK, "--scenario", scenario))
    assert "camera.config 'wide' is 700x500 px but the app's camera 'sitl_640x480' 640x480 px" in line


def test_a_simulator_that_cannot_start_says_why(tmp_path: Path, companion: Companion) -> None:
    scenario = scenario_file(tmp_path, "line", {"airframe": "balloon"})
    record = tmp_path / "record"
    line = refused(companion("--sitl", "--no-ui", "--scenario", scenario, "--record", record))
    assert "the simulator did not start: companion-sitl: airframes: no 'balloon'" in line
    assert not record.exists()


# ---------------------------------------------------------------- hardware


@pytest.fixture
def pty() -> Iterator[str]:
    """A serial port that is there."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def vehicle(folder: Path, pty: str, **changes: dict[str, Any]) -> Path:
    """The settings of a vehicle all of whose ports are there, with changes."""
    sense: dict[str, Any] = {
        # connected to when it is read, which is later than anything here
        "imu": {"bus": f"socket:{folder / 'registers'}"},
        "gps": {"port": pty},
        "range": {"port": pty},
        "vision": {"source": "v4l2:99"},
    }
    link = {"connection": f"udpin:127.0.0.1:{free_port()}", "actions": "pymavlink"}
    for part, change in changes.items():
        (link if part == "link" else sense[part]).update(change)
    return settings(folder, {"link": link, "sense": sense})


def test_a_udp_port_in_use_is_said(tmp_path: Path, pty: str, companion: Companion) -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other:
        other.bind(("127.0.0.1", 0))
        connection = f"udpin:127.0.0.1:{other.getsockname()[1]}"
        path = vehicle(tmp_path, pty, link={"connection": connection})
        line = refused(companion("--no-ui", "--config", path))
    assert line == f"link.connection: {connection}: Address already in use"


@pytest.mark.parametrize(
    ("part", "change", "expected"),
    [
        ("range", {"port": "/dev/null"}, "serial port /dev/null: cannot be opened at 9600 baud"),
        ("link", {"connection": "serial:/dev/null:57600"}, "link.connection: serial:/dev/null:57600: "),
        ("imu", {"bus": "spi:0"}, "bus 'spi:0': expected i2c:NUMBER, spi:BUS.SELECT or socket:PATH"),
        (
            "vision",
            {"source": "video:/nowhere.mp4"},
            "sense.vision.source: video:/nowhere.mp4: cannot be read",
        ),
        ("vision", {"source": "film"}, "sense.vision.source: 'film'; expected v4l2:NUMBER, picamera2:NUMBER"),
    ],
)
def test_hardware_that_cannot_be_is_named(
    part: str, change: dict[str, Any], expected: str, tmp_path: Path, pty: str, companion: Companion
) -> None:
    record = tmp_path / "flights"
    line = refused(
        companion("--no-ui", "--config", vehicle(tmp_path, pty, **{part: change}), "--record", record)
    )
    assert expected in line
    assert not list(record.glob("flight-*"))


def test_hardware_that_is_missing_is_waited_for_and_said(tmp_path: Path) -> None:
    missing = {
        "link": {"connection": "serial:/dev/ttyNOWHERE:57600"},
        "gps": {"port": "/dev/ttyNOWHERE"},
        "range": {"port": "/dev/ttyNOWHERE"},
        "imu": {"bus": "i2c:99"},
        "vision": {"source": "v4l2:99"},
    }
    said = {
        "autopilot link lost: link.connection: serial:/dev/ttyNOWHERE:57600: No such file or directory",
        "gps lost: serial port /dev/ttyNOWHERE: cannot be opened at 38400 baud: No such file or directory",
        "ultrasonic lost: serial port /dev/ttyNOWHERE: cannot be opened at 9600 baud",
        "bus 'i2c:99': /dev/i2c-99 cannot be opened: No such file",
        "camera: sense.vision.source: v4l2:99: no camera at /dev/video99",
    }
    with started("--no-ui", "--config", vehicle(tmp_path, "/dev/ptmx", **missing)) as process:
        for_each = set(said)
        assert process.stdout is not None
        for line in process.stdout:
            for_each -= {words for words in for_each if words in line}
            if not for_each:
                break
        assert process.poll() is None
        process.terminate()
        assert process.wait(timeout=20.0) == 0
    assert not for_each
