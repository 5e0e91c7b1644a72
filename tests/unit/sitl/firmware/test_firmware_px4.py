"""PX4 in lockstep: who waits for whom, what it is told in which units, and how it starts and ends."""

import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import quat_from_euler
from companion.config import ConfigError
from sitl.devices.neo6m import UNIX_AT_START_S
from sitl.firmware import px4
from sitl.vehicle.quadrotor import QuadrotorState, resting_state
from tests.unit.sitl.firmware.fake_firmware import (
    STEP_S,
    Fake,
    fake,
    fix,
    given,
    moment,
    moments,
    running,
    setup_of,
)

IMU, MAG, BARO = 0b111_111, 0b111_000_000, 0b1_1010_0000_0000


pytestmark = pytest.mark.usefixtures("answered_from_the_first")


@pytest.fixture
def kind() -> AutopilotKind:
    return "px4"


def told(program: Fake, kind: str) -> list[Any]:
    return [message for message in program.sensors if message.get_type() == kind]


def test_each_step_waits_for_the_answer_to_its_own_time(program: Fake) -> None:
    with running(program) as firmware:
        for count in range(1, 30):
            clock_s = 1.0 + count * STEP_S
            assert firmware.step(moment(clock_s))[0] == pytest.approx(clock_s / 10.0, abs=1e-6)
    times = [message.time_usec for message in told(program, "HIL_SENSOR")]
    assert times == [round(1e6 * (1.0 + n * STEP_S)) for n in range(1, 30)]


def test_while_it_boots_the_motors_are_off_and_nobody_waits_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(px4, "BOOTING_STEP_S", 0.002)
    with running(fake("px4", tmp_path, boot_steps=1000, motors=[0.5] * 4)) as firmware:
        assert {firmware.step(at) for at in moments(20)} == {(0.0, 0.0, 0.0, 0.0)}


def test_inertial_sensors_are_in_si_units_the_field_in_gauss_and_the_pose_for_it_to_find_out(
    program: Fake,
) -> None:
    state = QuadrotorState((10.0, -20.0, -5.0), attitude=quat_from_euler(0.3, -0.2, 1.0))
    sensed = {"force": (0.1, -0.2, -9.7), "rate": (0.3, -0.4, 0.5), "field": (20.0, -1.0, 43.0)}
    with running(program) as firmware:
        firmware.step(moment(STEP_S, state, **sensed))
    (heard,) = program.sensors
    assert heard.get_type() == "HIL_SENSOR"
    assert (heard.xacc, heard.yacc, heard.zacc) == pytest.approx((0.1, -0.2, -9.7))
    assert (heard.xgyro, heard.ygyro, heard.zgyro) == pytest.approx((0.3, -0.4, 0.5))
    assert (heard.xmag, heard.ymag, heard.zmag) == pytest.approx((0.20, -0.01, 0.43))
    assert heard.id == 0


def test_what_has_no_new_reading_is_not_marked_as_new(program: Fake) -> None:
    with running(program) as firmware:
        for count in range(1, 10):
            firmware.step(moment(count * STEP_S, mag_s=0.0 if count < 5 else 1.0))
    fields = [message.fields_updated for message in told(program, "HIL_SENSOR")]
    # the barometer every eighth step
    assert fields == [IMU | MAG | BARO, IMU, IMU, IMU, IMU | MAG, IMU, IMU, IMU, IMU | BARO]


def test_the_pressure_is_that_of_its_height_in_hectopascals(program: Fake) -> None:
    with running(program) as firmware:
        for count in range(1, 40):
            state = resting_state((0.0, 0.0, -500.0 if count > 20 else 0.0), 0.0)
            firmware.step(moment(count * STEP_S, state))
    heard = told(program, "HIL_SENSOR")
    low, high = heard[0], heard[-1]
    assert low.abs_pressure == pytest.approx(966.1, abs=0.2)  # standard atmosphere, 400 m and 900 m
    assert high.abs_pressure == pytest.approx(909.7, abs=0.2)
    assert (low.pressure_alt, high.pressure_alt) == pytest.approx((400.0, 900.0), abs=2.0)


@pytest.mark.parametrize(
    ("velocity", "speed", "course"),
    [
        ((3.0, 0.0, -1.0), 300, 0),
        ((0.0, 2.0, 0.5), 200, 9000),
        ((-1.0, 0.0, 0.0), 100, 18000),
        ((0.0, -4.0, 0.0), 400, 27000),
        ((1.0, -1e-5, 0.0), 100, 0),
    ],
)
def test_a_fix_is_in_integers_and_its_course_is_where_it_goes(
    velocity: tuple[float, float, float], speed: int, course: int, program: Fake
) -> None:
    with running(program) as firmware:
        firmware.step(moment(0.5, fix=fix(0.45, velocity)))
        firmware.step(moment(0.5 + STEP_S, fix=fix(0.45, velocity)))  # the same one, told once
    (heard,) = told(program, "HIL_GPS")
    assert heard.time_usec == round(1e6 * (UNIX_AT_START_S + 0.5))
    assert (heard.fix_type, heard.satellites_visible) == (3, 11)
    assert (heard.lat, heard.lon, heard.alt) == (471234567, -87654321, 432100)
    assert (heard.eph, heard.epv) == (250, 380)
    assert (heard.vn, heard.ve, heard.vd) == tuple(round(100 * v) for v in velocity)
    assert (heard.vel, heard.cog) == (speed, course)


def test_it_is_reported_of_the_vehicle_and_the_receivers_delay_by_values_that_are_never_its_own_defaults(
    program: Fake,
) -> None:
    setup = setup_of(program.spec, gps_delay_s=0.2)
    # PX4's default for this one: told as it is, it would count as not set
    body = setup.airframe.body.model_copy(update={"torque_to_thrust_m": 0.05})
    setup = setup._replace(airframe=setup.airframe.model_copy(update={"body": body}))
    told = {name: float(value) for name, value in given(program, setup).items()}
    arm_m = body.arm_length_m
    for rotor, place in enumerate(((arm_m, 0.0), (0.0, arm_m), (-arm_m, 0.0), (0.0, -arm_m))):
        found = told[f"CA_ROTOR{rotor}_PX"], told[f"CA_ROTOR{rotor}_PY"]
        assert found == pytest.approx(place, abs=1e-4)
        assert 0.0 not in found
    turns = [told[f"CA_ROTOR{rotor}_KM"] for rotor in range(4)]
    assert turns == pytest.approx([0.05, -0.05, 0.05, -0.05], abs=1e-4)  # front and rear anticlockwise
    assert not {0.05, -0.05, 0.0} & set(turns)
    assert told["MPC_THR_HOVER"] == pytest.approx(body.hover_share(), abs=1e-5)
    assert told["EKF2_GPS_DELAY"] == 200


@contextlib.contextmanager
def taken(port: int, kind: socket.SocketKind) -> Iterator[None]:
    with contextlib.closing(socket.socket(socket.AF_INET, kind)) as other:
        with contextlib.suppress(OSError):  # somebody else has it, who is as good
            other.bind(("127.0.0.1", port))
            if kind is socket.SOCK_STREAM:
                other.listen(1)
        yield


@pytest.mark.parametrize("port", [14540, 14580, 18570])
def test_an_instance_with_a_port_in_use_is_passed_over(port: int, program: Fake) -> None:
    with taken(port, socket.SOCK_DGRAM), running(program):
        pass
    assert 0 not in program.instances


def test_a_folder_that_is_no_build_is_said(program: Fake) -> None:
    script = program.spec.path.parent.parent / "etc" / "init.d-posix" / "rcS"
    script.unlink()
    with pytest.raises(ConfigError) as caught:
        given(program)
    assert str(caught.value) == (
        f"--firmware-path {program.spec.path}: expected {script} beside the program's folder"
    )


def test_what_is_no_program_for_this_machine_is_said(program: Fake) -> None:
    program.spec.path.write_bytes(b"\x7fELF of another kind")
    with pytest.raises(ConfigError, match=r"px4: cannot be run \(Exec format error\)"):
        given(program)
