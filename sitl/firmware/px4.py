"""PX4 in lockstep, by its simulator interface (simulator_mavlink): HIL_SENSOR and HIL_GPS against
HIL_ACTUATOR_CONTROLS over TCP.

PX4 calls us at 4560 + instance. Its clock is the time of the HIL_SENSOR messages, and its threads sleep by
that clock, so that nothing moves between two of them. It answers each once its rate loop has run; the first
answers come only when it has booted. MAVLink for companions comes by UDP to 14540 + instance.
"""

import math
import os
import select
import socket
from contextlib import ExitStack, closing
from typing import Final

import numpy as np

from companion.base.clock import wall_clock_s
from companion.base.geometry import scale
from companion.config import ConfigError
from companion.link.codec import mavlink
from sitl.devices.neo6m import UNIX_AT_START_S
from sitl.firmware import FirmwareError
from sitl.firmware.process import (
    ANSWER_S,
    INSTANCES,
    LAST_S,
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
from sitl.mavlink.framing import FrameReader, packed
from sitl.mavlink.sensor_telemetry import pressure_hpa
from sitl.vehicle.quadrotor import RotorValues

SIMULATOR_PORT: Final = 4560
COMPANION_PORT: Final = 14540
# of its links to companions and ground stations; each instance has the next one
OWN_PORTS: Final = (14580, 18570)
AIRFRAME: Final = "none_iris"
CALL_S: Final = 20.0  # from its start until it calls
# it does not answer before it has booted: so long (of the wall's time) it is given for each step till then
BOOTING_STEP_S: Final = 0.0015
# what is set to PX4's own default counts as not set, and the airframe's would win
NOT_DEFAULT: Final = 1e-5
_GAUSS_PER_UT: Final = 0.01
_IMU: Final = 0b111_111
_MAG: Final = 0b111_000_000
_BARO: Final = 0b1_1010_0000_0000
_FIX_3D: Final = 3
_OFF: RotorValues = (0.0, 0.0, 0.0, 0.0)


# a MS5611 or BMP388 behind foam: 10 cm of noise, and slow turns of the weather and the airframe's own wash
NOISE_M: Final = 0.1
WANDER_M: Final = 0.3
WANDER_S: Final = 60.0
PERIOD_S: Final = 0.02


class Barometer:
    """The autopilot's, with noise and wander. Step it at any rate; it has a new reading every `PERIOD_S`."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._wander_m = WANDER_M * float(rng.standard_normal())
        self._due_s = -math.inf

    def read(self, now_s: float, altitude_m: float) -> float | None:
        """Pressure altitude (m) when a reading is due, else None; `altitude_m` is the true one."""
        if now_s < self._due_s - 1e-6:
            return None
        in_time = now_s - self._due_s < PERIOD_S
        self._due_s = (self._due_s if in_time else now_s) + PERIOD_S
        kept = math.exp(-PERIOD_S / WANDER_S)
        step, noise = self._rng.standard_normal(2).tolist()
        self._wander_m = kept * self._wander_m + WANDER_M * math.sqrt(1.0 - kept * kept) * step
        return altitude_m + self._wander_m + NOISE_M * float(noise)


class Px4(Firmware):
    """One PX4. Made, it has been started and has called."""

    def __init__(self, spec: FirmwareSpec, setup: Setup, barometer: Barometer) -> None:
        """Start it.

        Raises:
            ConfigError: it cannot be started, or no instance's ports are free.
        """
        self._home = setup.home
        self._barometer = barometer
        self._reader = FrameReader()
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=200)
        self._decoder = mavlink.MAVLink(None)
        self._motors = _OFF
        self._answered_us = -1
        self._mag_s = self._fix_s = math.nan
        with ExitStack() as opened:
            self._process = opened.enter_context(closing(Process("px4")))
            server, self._link, instance = _free_instance()
            opened.enter_context(closing(self._link))
            with server:
                self._process.start(_command(spec, instance, self._process), _environment(setup))
                self._socket = opened.enter_context(self._accept(server))
            self._opened = opened.pop_all()

    def step(self, moment: Moment) -> RotorValues:
        time_us = round(moment.clock_s * 1e6)
        try:
            self._socket.sendall(self._sensors(moment, time_us) + self._gps(moment))
            self._await(time_us)
        except TimeoutError:
            why = f"has not answered for {ANSWER_S:g} s"
        except ConnectionError:
            why = "has closed its connection to the simulator"
        else:
            return self._motors
        self._process.check(LAST_S)
        raise FirmwareError(f"px4 {why}: {self._process.last_words()}")

    # ------------------------------------------------------------ in

    def _accept(self, server: socket.socket) -> socket.socket:
        server.settimeout(LOOK_S)
        deadline_s = wall_clock_s() + CALL_S
        while wall_clock_s() < deadline_s:
            try:
                connection, _ = server.accept()
            except TimeoutError:
                self._check_start()
                continue
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.settimeout(ANSWER_S)  # for one that reads no more
            return connection
        raise ConfigError(f"px4 did not call the simulator within {CALL_S:g} s: {self._process.last_words()}")

    def _check_start(self) -> None:
        try:
            self._process.check()
        except FirmwareError as error:
            raise ConfigError(str(error)) from error

    def _await(self, time_us: int) -> None:
        """Wait for the answer to the sensors of that time; while it boots, not for long."""
        booting = self._answered_us < 0
        deadline_s = wall_clock_s() + (BOOTING_STEP_S if booting else ANSWER_S)
        while self._answered_us < time_us:
            left_s = deadline_s - wall_clock_s()
            if left_s <= 0.0:
                if booting:
                    return
                raise TimeoutError
            if select.select([self._socket], [], [], left_s)[0]:
                self._take(self._socket.recv(65536))

    def _take(self, data: bytes) -> None:
        if not data:
            raise ConnectionResetError
        for frame in self._reader.read(data, 0.0):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS:
                message = self._decoder.decode(bytearray(frame.data))
                self._answered_us = message.time_usec
                first, second, third, fourth = (min(1.0, max(0.0, c)) for c in message.controls[:4])
                self._motors = (first, second, third, fourth)

    # ------------------------------------------------------------ out

    def _sensors(self, moment: Moment, time_us: int) -> bytes:
        imu, mag = moment.sensors.imu, moment.sensors.mag
        if imu is None or mag is None:
            raise FirmwareError("px4 needs sensor samples before its first step")
        bits = _IMU
        if mag.time_s != self._mag_s:
            self._mag_s, bits = mag.time_s, bits | _MAG
        altitude_m = self._home[2] - moment.state.position_ned_m[2]
        height_m = self._barometer.read(moment.clock_s, altitude_m)
        if height_m is not None:
            bits |= _BARO
            altitude_m = height_m
        return packed(
            self._mav,
            mavlink.MAVLink_hil_sensor_message(
                time_us, *imu.specific_force_m_s2, *imu.rate_rad_s, *scale(mag.field_ut, _GAUSS_PER_UT),
                pressure_hpa(altitude_m), 0.0, altitude_m, 25.0, bits, 0,
            )
        )  # fmt: skip

    def _gps(self, moment: Moment) -> bytes:
        fix = moment.sensors.gps
        if fix is None or fix.time_s == self._fix_s:
            return b""
        self._fix_s = fix.time_s
        r = fix.reading
        north, east, down = (round(100.0 * v) for v in r.velocity_ned_m_s)
        speed = round(math.hypot(north, east))
        course = round(100.0 * math.degrees(math.atan2(east, north))) % 36000
        return packed(
            self._mav,
            mavlink.MAVLink_hil_gps_message(
                round((UNIX_AT_START_S + moment.clock_s) * 1e6), _FIX_3D,
                round(r.latitude_deg * 1e7), round(r.longitude_deg * 1e7), round(r.altitude_m * 1e3),
                round(r.horizontal_accuracy_m * 1e2), round(r.vertical_accuracy_m * 1e2),
                speed, north, east, down, course, r.satellites, 0, 0,
            )
        )  # fmt: skip


def _free_instance() -> tuple[socket.socket, Datagrams, int]:
    """Its simulator's port and its companion's, and the instance whose own ports are free as well."""
    for instance in range(INSTANCES):
        server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind((LOOPBACK, SIMULATOR_PORT + instance))
            server.listen(1)
            link = Datagrams(COMPANION_PORT + instance)
        except OSError:
            server.close()
            continue
        if all(is_free(socket.SOCK_DGRAM, port + instance) for port in OWN_PORTS):
            return server, link, instance
        server.close()
        link.close()
    raise ConfigError(f"no PX4 instance from 0 to {INSTANCES - 1} has its ports free")


def _command(spec: FirmwareSpec, instance: int, process: Process) -> list[str]:
    build = spec.path.parent.parent
    script = "etc/init.d-posix/rcS"
    if not (build / script).exists():
        raise ConfigError(
            f"--firmware-path {spec.path}: expected {build / script} beside the program's folder"
        )
    words = ("-i", str(instance), "-d", str(build / "etc"), "-w", str(process.folder), "-s", script)
    return [str(spec.path), *words]


def _environment(setup: Setup) -> dict[str, str]:
    """PX4's own way of setting parameters from outside: PX4_PARAM_NAME."""
    named = {**_parameters(setup), **setup.parameters}
    parameters = {f"PX4_PARAM_{name}": number_text(value) for name, value in named.items()}
    return {**os.environ, "PX4_SIM_MODEL": AIRFRAME, "HEADLESS": "1", **parameters}


def _parameters(setup: Setup) -> dict[str, float]:
    body, k = setup.airframe.body, setup.rate_scale
    turn_m = body.torque_to_thrust_m + NOT_DEFAULT
    places = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))  # front, right, rear, left
    rotors = {
        f"CA_ROTOR{i}_{name}": value
        for i, (x, y) in enumerate(places)
        for name, value in (
            ("PX", body.arm_length_m * x + NOT_DEFAULT),
            ("PY", body.arm_length_m * y + NOT_DEFAULT),
            ("KM", turn_m if i % 2 == 0 else -turn_m),
        )
    }
    return {
        **rotors,
        "MPC_THR_HOVER": body.hover_share(),
        **({} if k == 1.0 else {f"MC_{axis}RATE_K": k for axis in ("ROLL", "PITCH", "YAW")}),
        "EKF2_GPS_DELAY": round(1e3 * setup.gps_delay_s),
        # one IMU, one compass
        "EKF2_MULTI_IMU": 0,
        "SENS_IMU_MODE": 1,
        # no remote control, no ground station; setpoints lost: hold
        "COM_RC_IN_MODE": 4,
        "NAV_RCL_ACT": 0,
        "NAV_DLL_ACT": 0,
        "COM_OBL_RC_ACT": 5,
        "COM_OF_LOSS_T": 1.0,
        # No log and no battery that runs down: nothing that takes time. The log is off by the first up to PX4
        # 1.16, by the second from 1.17 on, whose logger waits in lockstep for an attitude that comes later.
        "SDLOG_MODE": -1,
        "SDLOG_BACKEND": 0,
        "SIM_BAT_DRAIN": 3600,
    }
