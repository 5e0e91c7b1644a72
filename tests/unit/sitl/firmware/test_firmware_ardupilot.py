"""ArduCopter in lockstep: who waits for whom, what it is told in which frames, and how it starts and ends."""

import socket
from pathlib import Path

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import quat_from_euler
from sitl.firmware import ardupilot
from sitl.vehicle.quadrotor import QuadrotorState
from tests.unit.sitl.firmware.fake_firmware import (
    HOME,
    STEP_S,
    Fake,
    fake,
    given,
    moment,
    moments,
    running,
    setup_of,
)


@pytest.fixture
def kind() -> AutopilotKind:
    return "ardupilot"


def word_after(program: Fake, option: str) -> str:
    words: list[str] = program.started["words"]
    return words[words.index(option) + 1]


def test_each_step_is_two_frames_that_end_with_it_and_waits_for_their_answers(program: Fake) -> None:
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


def test_it_is_reported_of_sensors_and_state_in_si_units_ned_and_frd(program: Fake) -> None:
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


def test_it_is_told_its_parameters_where_it_stands_and_whom_to_talk_to(program: Fake) -> None:
    setup = setup_of(program.spec)
    told = given(program, setup)
    assert (told["FRAME_CLASS"], told["FRAME_TYPE"]) == ("1", "6")
    assert float(told["MOT_THST_HOVER"]) == pytest.approx(setup.airframe.body.hover_share())
    assert (told["MOT_PWM_MIN"], told["MOT_PWM_MAX"], told["MOT_THST_EXPO"]) == ("1000", "2000", "0")
    assert (told["SIM_RATE_HZ"], told["SCHED_LOOP_RATE"]) == ("800", "400")
    assert word_after(program, "--model") == "JSON:127.0.0.1"
    assert [float(word) for word in word_after(program, "--home").split(",")] == [*HOME, 0.0]
    assert word_after(program, "--serial0").startswith("udpclient:127.0.0.1:")
    motors = {name: float(value) for name, value in told.items() if name.startswith("MOT_")}
    for throttle in (0.0, 0.21, 0.5, 1.0):  # is that share of the plant's thrust:
        # Thrust_Linearization::thrust_to_actuator without its curve, then output_to_pwm
        actuator = motors["MOT_SPIN_MIN"] + (motors["MOT_SPIN_MAX"] - motors["MOT_SPIN_MIN"]) * throttle
        pulse_us = motors["MOT_PWM_MIN"] + (motors["MOT_PWM_MAX"] - motors["MOT_PWM_MIN"]) * actuator
        assert ardupilot._share(round(pulse_us)) == pytest.approx(throttle, abs=1e-3)


def test_what_is_no_answer_of_its_own_is_not_taken_for_one(tmp_path: Path) -> None:
    program = fake("ardupilot", tmp_path, motors=[0.5] * 4)
    with running(program) as firmware, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        address = ("127.0.0.1", int(word_after(program, "--sim-port-out")))
        for junk in (b"", b"\0" * 40, b"junk" * 100):
            stranger.sendto(junk, address)
        for at in moments(3):
            assert firmware.step(at) == (0.5,) * 4
