"""ArduCopter in lockstep: who waits for whom, what it is told in which frames, and how it starts and ends."""

from __future__ import annotations

import socket
import tempfile
from contextlib import closing
from pathlib import Path

import pytest

from companion.base.geometry import quat_from_euler
from companion.config import ConfigError
from sitl.firmware import ardupilot
from sitl.firmware.errors import FirmwareError
from sitl.vehicle.quadrotor import QuadrotorState
from tests.unit.sitl.firmware.fake_firmware import (
    HOME,
    STEP_S,
    Fake,
    fake,
    moment,
    moments,
    open_files,
    running,
    setup_of,
    step_on,
)


def parameters(program: Fake) -> dict[str, str]:
    return dict(line.split() for line in program.started["parameters"].splitlines())


def word_after(program: Fake, option: str) -> str:
    words: list[str] = program.started["words"]
    return words[words.index(option) + 1]


# ---------------------------------------------------------------- lockstep


def test_each_step_is_two_frames_that_end_with_it_and_waits_for_their_answers(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path)
    with running(program) as firmware:
        for count in range(1, 30):
            clock_s = 1.0 + count * STEP_S
            assert firmware.step(moment(clock_s))[1] == pytest.approx(clock_s / 10.0, abs=6e-4)
    stamps = [line["timestamp"] for line in program.sensors]
    assert stamps == pytest.approx([1.0 + n * STEP_S / 2 for n in range(1, 59)], abs=1e-6)


def test_pulses_that_come_twice_are_answered_once(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path, repeats=2)
    with running(program) as firmware:
        for at in moments(10):
            firmware.step(at)
    stamps = [line["timestamp"] for line in program.sensors]
    assert stamps == sorted(set(stamps))
    assert len(stamps) == 20


def test_the_pulses_of_right_left_front_rear_become_front_right_rear_left(tmp_path: Path) -> None:
    with running(fake("ardupilot", tmp_path, motors=[0.2, 0.4, 0.1, 0.3])) as firmware:
        assert firmware.step(moment(STEP_S)) == (0.1, 0.2, 0.3, 0.4)


def test_pulses_beyond_off_and_full_are_off_and_full(tmp_path: Path) -> None:
    with running(fake("ardupilot", tmp_path, motors=[-1.0, 1.2, 0.0, 1.0])) as firmware:
        assert firmware.step(moment(STEP_S)) == (0.0, 0.0, 1.0, 1.0)


# ---------------------------------------------------------------- what it is told


def test_it_is_reported_of_sensors_and_state_in_si_units_ned_and_frd(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path)
    attitude = quat_from_euler(0.3, -0.2, 1.0)
    state = QuadrotorState((10.0, -20.0, -5.0), velocity_ned_m_s=(1.0, -2.0, 0.5), attitude=attitude)
    with running(program) as firmware:
        firmware.step(moment(STEP_S, state, force=(0.1, -0.2, -9.7), rate=(0.3, -0.4, 0.5)))
    told = program.sensors[-1]
    assert told["imu"] == {"gyro": [0.3, -0.4, 0.5], "accel_body": [0.1, -0.2, -9.7]}
    assert told["position"] == [10.0, -20.0, -5.0]
    assert told["velocity"] == [1.0, -2.0, 0.5]
    assert told["quaternion"] == pytest.approx(attitude, abs=1e-8)  # w first, body to NED
    assert told["no_time_sync"] == 1


def test_it_is_reported_where_it_stands_and_whom_to_talk_to(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path)
    with running(program):
        pass
    assert word_after(program, "--model") == "JSON:127.0.0.1"
    latitude, longitude, altitude, heading = map(float, word_after(program, "--home").split(","))
    assert (latitude, longitude, altitude, heading) == (*HOME, 0.0)
    assert word_after(program, "--serial0").startswith("udpclient:127.0.0.1:")


# ---------------------------------------------------------------- parameters


def test_its_parameters_are_those_of_the_vehicle(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path)
    setup = setup_of(program.spec)
    with running(program, setup):
        pass
    given = parameters(program)
    assert (given["FRAME_CLASS"], given["FRAME_TYPE"]) == ("1", "6")
    assert float(given["MOT_THST_HOVER"]) == pytest.approx(setup.airframe.body.hover_share())
    assert (given["MOT_PWM_MIN"], given["MOT_PWM_MAX"], given["MOT_THST_EXPO"]) == ("1000", "2000", "0")
    assert (given["SIM_RATE_HZ"], given["SCHED_LOOP_RATE"]) == ("800", "400")


@pytest.mark.parametrize("throttle", [0.0, 0.21, 0.5, 1.0])
def test_a_share_of_its_throttle_is_that_share_of_the_plants_thrust(throttle: float, tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path)
    with running(program):
        pass
    given = {name: float(value) for name, value in parameters(program).items() if name.startswith("MOT_")}
    # Thrust_Linearization::thrust_to_actuator without its curve, then output_to_pwm
    actuator = given["MOT_SPIN_MIN"] + (given["MOT_SPIN_MAX"] - given["MOT_SPIN_MIN"]) * throttle
    pulse_us = given["MOT_PWM_MIN"] + (given["MOT_PWM_MAX"] - given["MOT_PWM_MIN"]) * actuator
    assert given["MOT_THST_EXPO"] == 0.0
    assert ardupilot._share(round(pulse_us)) == pytest.approx(throttle, abs=1e-3)


def test_a_users_parameter_is_over_all_others_and_keeps_its_digits(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path, {"GUID_OPTIONS": 0.0, "MASK": 12345678.0, "SMALL": 0.123456789})
    with running(program):
        pass
    given = parameters(program)
    assert (given["GUID_OPTIONS"], given["MASK"], given["SMALL"]) == ("0", "12345678", "0.123456789")


# ---------------------------------------------------------------- instances


def test_two_at_once_have_ports_of_their_own(tmp_path: Path) -> None:
    programs = [
        fake("ardupilot", tmp_path / name, motors=[share] * 4) for name, share in (("a", 0.25), ("b", 0.75))
    ]
    with running(programs[0]) as first, running(programs[1]) as second:
        for at in moments(5):
            found = first.step(at), second.step(at)
    assert found == ((0.25,) * 4, (0.75,) * 4)
    assert programs[0].instances != programs[1].instances


def test_an_instance_is_taken_before_its_program_takes_its_ports() -> None:
    first, one = ardupilot._free_instance()
    with closing(first):
        second, other = ardupilot._free_instance()
        second.close()
    assert one != other
    assert first.port == 5760 + 10 * one


def test_without_a_free_instance_it_is_said_and_nothing_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    files = open_files()
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        monkeypatch.setattr(ardupilot, "BASE_PORT", other.getsockname()[1])
        monkeypatch.setattr(ardupilot, "INSTANCES", 1)
        with (
            pytest.raises(ConfigError, match="no ArduPilot instance from 0 to 0 has its ports free"),
            running(fake("ardupilot", tmp_path)),
        ):
            pass
    assert open_files() == files
    assert not list(tmp_path.glob("arducopter-*"))


# ---------------------------------------------------------------- what goes wrong


def test_one_that_ends_at_once_is_reported_of_by_its_last_words(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught, running(fake("ardupilot", tmp_path, ends_after=-1)):
        pass
    assert str(caught.value) == "arducopter has ended (exit status 3): last words of arducopter"


def test_one_that_never_says_anything_is_reported_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ardupilot, "START_S", 0.5)
    program = fake("ardupilot", tmp_path, silent_after=-1)
    with pytest.raises(ConfigError) as caught, running(program):
        pass
    assert str(caught.value) == "arducopter has not answered for 0.5 s: booting"
    assert program.is_gone


def test_one_that_ends_in_flight_is_reported_of_by_its_last_words(tmp_path: Path) -> None:
    with (
        running(fake("ardupilot", tmp_path, ends_after=10)) as firmware,
        pytest.raises(FirmwareError) as caught,
    ):
        step_on(firmware, 20)
    assert str(caught.value) == "arducopter has ended (exit status 3): last words of arducopter"


def test_one_that_answers_no_more_is_reported_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ardupilot, "ANSWER_S", 0.2)
    with (
        running(fake("ardupilot", tmp_path, silent_after=10)) as firmware,
        pytest.raises(FirmwareError) as caught,
    ):
        step_on(firmware, 20)
    assert str(caught.value) == "arducopter has not answered for 0.2 s: booting"


def test_what_is_no_answer_of_its_own_is_not_taken_for_one(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path, motors=[0.5] * 4)
    with running(program) as firmware, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        address = ("127.0.0.1", int(word_after(program, "--sim-port-out")))
        for junk in (b"", b"\0" * 40, b"junk" * 100):
            stranger.sendto(junk, address)
        for at in moments(3):
            assert firmware.step(at) == (0.5,) * 4


def test_nothing_is_left_of_it_in_the_end(tmp_path: Path) -> None:
    program, files = fake("ardupilot", tmp_path), open_files()
    with running(program) as firmware:
        firmware.step(moment(STEP_S))
        assert Path(program.started["folder"]).name.startswith("arducopter-")
    assert program.is_gone
    assert open_files() == files
    firmware.close()  # twice does no harm
