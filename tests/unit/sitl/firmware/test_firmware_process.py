"""What both firmwares do alike as a process: parameters, instances, how one starts, fails and ends."""

import socket
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.config import ConfigError
from sitl.firmware import FirmwareError, ardupilot, px4
from sitl.vehicle.quadrotor import RotorValues
from tests.unit.sitl.firmware.fake_firmware import (
    STEP_S,
    Fake,
    fake,
    given,
    heard,
    moment,
    moments,
    open_files,
    running,
    step_on,
)

MODULES: dict[AutopilotKind, Any] = {"px4": px4, "ardupilot": ardupilot}
PROGRAMS: dict[AutopilotKind, str] = {"px4": "px4", "ardupilot": "arducopter"}


pytestmark = pytest.mark.usefixtures("answered_from_the_first")


@pytest.mark.parametrize(
    ("kind", "told", "motors"),
    [
        ("px4", [0.125, 0.25, 0.375, 0.5], (0.125, 0.25, 0.375, 0.5)),
        ("px4", [-0.5, 1.5, float("nan"), 1.0], (0.0, 1.0, 0.0, 1.0)),
        # right, left, front, rear
        ("ardupilot", [0.2, 0.4, 0.1, 0.3], (0.1, 0.2, 0.3, 0.4)),
        ("ardupilot", [-1.0, 1.2, 0.0, 1.0], (0.0, 0.0, 1.0, 1.0)),
    ],
)
def test_motors_come_front_right_rear_left_within_off_and_full(
    kind: AutopilotKind, told: list[float], motors: RotorValues, tmp_path: Path
) -> None:
    with running(fake(kind, tmp_path, motors=told)) as firmware:
        assert firmware.step(moment(STEP_S)) == motors


def test_a_users_parameter_is_over_all_others_and_keeps_its_digits(
    kind: AutopilotKind, tmp_path: Path
) -> None:
    own = "MPC_THR_HOVER" if kind == "px4" else "MOT_THST_HOVER"
    told = given(fake(kind, tmp_path, {own: 0.4, "SOME_NUMBER": 12345678.0, "SMALL": 0.123456789}))
    assert (told[own], told["SOME_NUMBER"], told["SMALL"]) == ("0.4", "12345678", "0.123456789")


def test_two_at_once_have_ports_of_their_own(kind: AutopilotKind, tmp_path: Path) -> None:
    programs = [fake(kind, tmp_path / name, motors=[share] * 4) for name, share in (("a", 0.25), ("b", 0.75))]
    with running(programs[0]) as first, running(programs[1]) as second:
        for at in moments(30):
            found = first.step(at), second.step(at)
        assert found == ((0.25,) * 4, (0.75,) * 4)
        systems = [{m.get_srcSystem() for m in heard(f)} for f in (first, second)]
    (one,), (other,) = (program.instances for program in programs)
    assert one != other
    if kind == "px4":
        assert systems == [{one + 1}, {other + 1}]  # PX4 numbers itself so


def test_without_a_free_instance_it_is_said_and_nothing_is_left(
    kind: AutopilotKind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    files, module = open_files(), MODULES[kind]
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        port = "SIMULATOR_PORT" if kind == "px4" else "BASE_PORT"
        monkeypatch.setattr(module, port, other.getsockname()[1])
        monkeypatch.setattr(module, "INSTANCES", 1)
        with (
            pytest.raises(ConfigError, match="instance from 0 to 0 has its ports free"),
            running(fake(kind, tmp_path)),
        ):
            pass
    assert open_files() == files
    assert not list(tmp_path.glob(f"{PROGRAMS[kind]}-*"))


def test_one_that_ends_before_it_answers_is_reported_by_its_last_words(
    kind: AutopilotKind, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError) as caught, running(fake(kind, tmp_path, ends_after=-1)):
        pass
    name = PROGRAMS[kind]
    assert str(caught.value) == f"{name} has ended (exit status 3): last words of {name}"


@pytest.mark.parametrize(
    ("kind", "patience", "behaviour", "words"),
    [
        ("px4", "CALL_S", {"calls": False}, "px4 did not call the simulator within 0.5 s: booting"),
        ("ardupilot", "START_S", {"silent_after": -1}, "arducopter has not answered for 0.5 s: booting"),
    ],
)
def test_one_that_never_says_anything_is_reported(
    kind: AutopilotKind,
    patience: str,
    behaviour: dict[str, Any],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(MODULES[kind], patience, 0.5)
    program = fake(kind, tmp_path, **behaviour)
    with pytest.raises(ConfigError) as caught, running(program):
        pass
    assert str(caught.value) == words
    assert program.is_gone


@pytest.mark.parametrize(
    ("behaviour", "words"),
    [
        ({"ends_after": 10}, "{0} has ended (exit status 3): last words of {0}"),
        (
            {"silent_after": 10, "says": "I am\n\nstuck  here\n \n"},
            "{0} has not answered for 0.2 s: stuck here",
        ),
    ],
)
def test_one_that_ends_or_is_silent_in_flight_is_reported(
    kind: AutopilotKind,
    behaviour: dict[str, Any],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if "says" in behaviour:
        monkeypatch.setattr(MODULES[kind], "ANSWER_S", 0.2)
    with running(fake(kind, tmp_path, **behaviour)) as firmware, pytest.raises(FirmwareError) as caught:
        step_on(firmware, 20)
    assert str(caught.value) == words.format(PROGRAMS[kind])


def test_nothing_is_left_of_it_in_the_end(kind: AutopilotKind, program: Fake) -> None:
    files = open_files()
    with running(program) as firmware:
        firmware.step(moment(STEP_S))
        assert Path(program.started["folder"]).name.startswith(f"{PROGRAMS[kind]}-")
    assert program.is_gone
    assert open_files() == files
    firmware.close()  # twice does no harm
