"""ArduCopter in lockstep, by its JSON backend: servo pulses in, the vehicle's state out, over UDP.

ArduCopter sends a packet of pulses and waits for the answer, whose `timestamp` is its clock: it does not
run meanwhile. It simulates barometer, compass and GPS itself from the position and attitude that it
receives; the IMU is the simulator's, with vibration. MAVLink is on UDP too, on its first serial port.
"""

import os
import socket
import struct
from contextlib import ExitStack, closing
from typing import Final

from companion.base.clock import wall_clock_s
from companion.base.geometry import Vector3
from companion.config import ConfigError
from sitl.firmware import FirmwareError
from sitl.firmware.process import (
    ANSWER_S,
    INSTANCES,
    LOOK_S,
    LOOPBACK,
    Datagrams,
    Firmware,
    Moment,
    Process,
    Setup,
    is_free,
)
from sitl.firmware.spec import FirmwareSpec, number_text
from sitl.vehicle.quadrotor import RotorValues

# magic, frame rate (Hz), frame count, 16 pulses (us); ArduPilot's SIM_JSON documentation
PULSES: Final = struct.Struct("<HHI16H")
MAGIC: Final = 18458
BASE_PORT: Final = 5760
PORTS_PER_INSTANCE: Final = 10
STEP_HZ: Final = 400
# it samples its IMU between our steps: with 400 samples a second alone, its loop of 400 Hz misses every third
FRAMES_PER_STEP: Final = 2
START_S: Final = 20.0
_PULSE_US: Final = (1000.0, 1000.0)  # off, and from there to full
# its motors: right, left, front, rear
_FRONT, _RIGHT, _REAR, _LEFT = 2, 0, 3, 1


class ArduPilot(Firmware):
    """One ArduCopter. Made, it has been started and waits for its first answer."""

    def __init__(self, spec: FirmwareSpec, setup: Setup) -> None:
        """Start it.

        Raises:
            ConfigError: it cannot be started, or no instance's ports are free.
        """
        self._peer: tuple[str, int] | None = None
        self._frame = -1
        self._motors: RotorValues = (0.0, 0.0, 0.0, 0.0)
        with ExitStack() as opened:
            self._process = opened.enter_context(closing(Process("arducopter")))
            self._link, instance = _free_instance()
            opened.enter_context(closing(self._link))
            self._socket = opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            self._socket.bind((LOOPBACK, 0))
            self._socket.settimeout(LOOK_S)
            parameters = self._process.folder / "vehicle.parm"
            named = {**_parameters(setup), **setup.parameters}
            parameters.write_text("".join(f"{name} {number_text(v)}\n" for name, v in named.items()))
            self._process.start(self._command(spec, instance, setup.home, str(parameters)), os.environ)
            try:
                self._await(START_S)
            except FirmwareError as error:
                raise ConfigError(str(error)) from error
            self._opened = opened.pop_all()

    def step(self, moment: Moment) -> RotorValues:
        assert self._peer is not None
        for frame in range(FRAMES_PER_STEP):
            earlier_s = (FRAMES_PER_STEP - 1 - frame) / (FRAMES_PER_STEP * STEP_HZ)
            self._socket.sendto(_state(moment, earlier_s), self._peer)
            self._await(ANSWER_S)
        return self._motors

    def _await(self, patience_s: float) -> None:
        """Wait for the next pulses; those of a frame that has been answered are a repetition."""
        deadline_s = wall_clock_s() + patience_s
        while wall_clock_s() < deadline_s:
            try:
                if self._take(*self._socket.recvfrom(4096)):
                    return
            except TimeoutError:
                self._process.check()
        raise FirmwareError(f"arducopter has not answered for {patience_s:g} s: {self._process.last_words()}")

    def _take(self, data: bytes, peer: tuple[str, int]) -> bool:
        if len(data) != PULSES.size:
            return False
        magic, _, frame, *pulses = PULSES.unpack(data)
        if magic != MAGIC or frame <= self._frame:
            return False
        self._peer, self._frame = peer, frame
        self._motors = tuple(_share(pulses[motor]) for motor in (_FRONT, _RIGHT, _REAR, _LEFT))
        return True

    def _command(self, spec: FirmwareSpec, instance: int, home: Vector3, parameters: str) -> list[str]:
        latitude, longitude, altitude = home
        control_port = self._socket.getsockname()[1]
        return [
            str(spec.path), "--model", f"JSON:{LOOPBACK}", "--speedup", "1", "--slave", "0", "-w",
            "--defaults", parameters, "--sim-address", LOOPBACK, "--sim-port-out", str(control_port),
            "-I", str(instance), "--home", f"{latitude:.7f},{longitude:.7f},{altitude:.2f},0",
            "--serial0", f"udpclient:{LOOPBACK}:{self._link.port}",
        ]  # fmt: skip


def _share(pulse_us: int) -> float:
    off, span = _PULSE_US
    return min(1.0, max(0.0, (pulse_us - off) / span))


def _state(moment: Moment, earlier_s: float) -> bytes:
    """One line of JSON between line feeds: SI units, NED, FRD, quaternion w x y z.

    The state stands for the whole step that ends with it: its stamp may be `earlier_s` before that end.
    """
    imu, state = moment.sensors.imu, moment.state
    if imu is None:
        raise FirmwareError("arducopter needs sensor samples before its first step")
    return (
        f'\n{{"timestamp":{moment.clock_s - earlier_s:.6f},'
        f'"imu":{{"gyro":{_numbers(imu.rate_rad_s)},"accel_body":{_numbers(imu.specific_force_m_s2)}}},'
        f'"position":{_numbers(state.position_ned_m)},"quaternion":{_numbers(state.attitude)},'
        f'"velocity":{_numbers(state.velocity_ned_m_s)},"no_time_sync":1}}\n'
    ).encode()


def _numbers(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"


def _free_instance() -> tuple[Datagrams, int]:
    """Our end of the MAVLink of the first instance whose ports are free, and the instance.

    It listens on its second and third serial ports, but only after a while: so that two instances do not
    start with one instance, our end has the number of its first port.
    """
    for instance in range(INSTANCES):
        first = BASE_PORT + PORTS_PER_INSTANCE * instance
        try:
            link = Datagrams(first)
        except OSError:
            continue
        if all(is_free(socket.SOCK_STREAM, first + n) for n in (0, 2, 3)):
            return link, instance
        link.close()
    raise ConfigError(f"no ArduPilot instance from 0 to {INSTANCES - 1} has its ports free")


def _tuned(factor: float) -> dict[str, float]:
    """ArduCopter's own gains of the rate loops, multiplied."""
    gains = {"RLL": (0.135, 0.135, 0.0036), "PIT": (0.135, 0.135, 0.0036), "YAW": (0.18, 0.018, 0.0)}
    return {
        f"ATC_RAT_{axis}_{name}": factor * gain
        for axis, pid in gains.items()
        for name, gain in zip("PID", pid, strict=True)
    }


def _parameters(setup: Setup) -> dict[str, float]:
    sticks = {
        f"RC{channel}_{name}": value
        for channel in range(1, 9)
        for name, value in (("MIN", 1000), ("MAX", 2000), ("TRIM", 1500))
    }
    # "calibrated" is what is not as it comes; the offsets are those of its own simulated compasses
    compasses = {
        f"COMPASS_OFS{n}_{axis}": value
        for n in ("", "2", "3")
        for axis, value in (("X", 5), ("Y", 13), ("Z", -18))
    }
    return {
        **sticks,
        **compasses,
        "FRAME_CLASS": 1,
        "FRAME_TYPE": 6,  # plus, the front rotor anticlockwise
        # Thrust goes with the pulse and begins at the least one, as our plant has it: a share of the throttle
        # is that share of the plant's full thrust, so that MOT_THST_HOVER is in the plant's scale.
        "MOT_THST_EXPO": 0.0,
        "MOT_SPIN_ARM": 0.0,
        "MOT_SPIN_MIN": 0.0,
        "MOT_SPIN_MAX": 1.0,
        "MOT_THST_HOVER": setup.airframe.body.hover_share(),
        **({} if setup.rate_scale == 1.0 else _tuned(setup.rate_scale)),
        "MOT_PWM_MIN": 1000,
        "MOT_PWM_MAX": 2000,
        "FS_GCS_ENABLE": 0,
        "GUID_OPTIONS": 8,  # thrust in attitude setpoints is thrust
        "GUID_TIMEOUT": 1.0,  # with its default, 3, the app refuses control
        "SIM_TERRAIN": 0,
        "SIM_RATE_HZ": FRAMES_PER_STEP * STEP_HZ,
        "SCHED_LOOP_RATE": STEP_HZ,
        "SR0_EXT_STAT": 2,
        "LOG_BACKEND_TYPE": 0,
    }
