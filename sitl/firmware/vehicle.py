"""A firmware in the place of the bundled autopilot: the simulation steps it and connects its clients."""

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from companion.base.clock import sleep_s, wall_clock_s
from companion.base.geometry import Quaternion, Vector3
from companion.config import ConfigError
from companion.link.codec import mavlink
from sitl.firmware import FirmwareError
from sitl.firmware.ardupilot import ArduPilot
from sitl.firmware.process import Firmware, Moment, Setup
from sitl.firmware.px4 import Barometer, Px4
from sitl.firmware.spec import FirmwareSpec
from sitl.mavlink.framing import FrameReader, MavFrame
from sitl.mavlink.ground_station import GroundStation
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.sensors.sensors import OUT_OF_RANGE_M
from sitl.vehicle.quadrotor import QuadrotorState, RotorValues
from sitl.world.world import World

# what the chip passes on; the firmware filters by itself
IMU_FILTER: Final = 1


class FirmwareVehicle:
    """One firmware with its sensors about the world's vehicle; made, it has booted."""

    def __init__(
        self,
        spec: FirmwareSpec,
        world: World,
        sensors: SimulatedAutopilotSensors,
        ground_station: GroundStation,
        rng: np.random.Generator,
        *,
        home: Vector3,
        gps_delay_s: float,
        step_s: float,
    ) -> None:
        """Start it and let it boot.

        Raises:
            ConfigError: it cannot be started, or is not ready to arm in time.
        """
        self._world, self._sensors = world, sensors
        airframe = world.believed_airframe
        tuning = world.built.rate_scale(airframe.body)
        setup = Setup(airframe, home, gps_delay_s, dict(spec.parameters), tuning)
        self._firmware = start_firmware(spec, setup, Barometer(rng))
        try:
            # the world's time 0 is its next step: its clock never stands still
            self._clock_at_start_s = boot(self._firmware, sensors, world.state, step_s) + step_s
            sensors.enable()
            sensors.step(0.0, world.state, 0.0, lambda: 0.0)
        except BaseException:
            self._firmware.close()
            raise
        self.network = FirmwareNetwork(self._firmware, ground_station)

    def step(self, _state: QuadrotorState, _dt_s: float, now_s: float) -> RotorValues:
        """The motors' commands until the next step, by what its sensors have now.

        Raises:
            FirmwareError: it has ended or does not answer.
        """
        return self._firmware.step(Moment(self._clock_at_start_s + now_s, self._sensors, self._world.state))

    @property
    def armed(self) -> bool:
        """From its last heartbeat."""
        return self.network.armed

    @property
    def attitude_setpoint(self) -> Quaternion:
        """Its setpoint is not known: the true attitude is used instead."""
        return self._world.state.attitude

    def close(self) -> None:
        self._firmware.close()


Write = Callable[[Sequence[bytes]], None]
AUTOPILOT: Final = 1


class FirmwarePort:
    """One client."""

    def __init__(self, write: Write, *, datagrams: bool) -> None:
        self.write = write
        self.reader = FrameReader(datagrams=datagrams)


class FirmwareNetwork:
    """All clients of one firmware, and the state in its heartbeat: `sitl.mavlink.network` for a firmware.

    MAVLink is forwarded unchanged, to the ground station too. Once a tick what the firmware has sent goes to
    every client, so that load on the machine changes nothing.
    """

    def __init__(self, firmware: Firmware, ground_station: GroundStation) -> None:
        self.armed = False
        self._firmware = firmware
        self._ground_station = ground_station
        self._decoder = mavlink.MAVLink(None)
        self._reader = FrameReader(datagrams=True)
        self._ports: list[FirmwarePort] = []

    def connect(self, write: Write, *, datagrams: bool) -> FirmwarePort:
        port = FirmwarePort(write, datagrams=datagrams)
        self._ports.append(port)
        return port

    def disconnect(self, port: Any) -> None:
        self._ports.remove(port)

    def receive(self, port: Any, data: bytes, now_s: float) -> None:
        """Take what a client sent: to the firmware frame by frame, and to the ground station."""
        for frame in port.reader.read(data, now_s):
            self._firmware.write(frame.data)
            self._ground_station.handle(frame, now_s)

    def transmit(self, now_s: float, pad_position_ned_m: Vector3, pad_velocity_ned_m_s: Vector3) -> None:
        """Forward what the firmware and the ground station have sent; the beacon is at the pad."""
        sent = self._firmware.read()
        for data in sent:
            for frame in self._reader.read(data, now_s):
                self._watch(frame)
        beacon = self._ground_station.transmit(now_s, pad_position_ned_m, pad_velocity_ned_m_s)
        if beacon:
            self._firmware.write(beacon)
            sent.append(beacon)
        for port in tuple(self._ports) if sent else ():
            port.write(sent)

    def _watch(self, frame: MavFrame) -> None:
        is_its = frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT and frame.component == AUTOPILOT
        if is_its:
            mode = self._decoder.decode(bytearray(frame.data)).base_mode
            self.armed = bool(mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)


# ---------------------------------------------------------------- start

MOST_BOOT_S: Final = 90.0
SETTLE_S: Final = 5.0  # ready, it stands so much longer: its biases go on settling
STEPS_PER_LOOK: Final = 20
GROUND_STATION: Final = (255, 190)
# what ArduCopter wants for flying by setpoints: velocity, and a position on the globe
_EKF_NEEDS: Final = (
    mavlink.EKF_ATTITUDE | mavlink.EKF_VELOCITY_HORIZ | mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_POS_VERT_ABS
)


def start_firmware(spec: FirmwareSpec, setup: Setup, barometer: Barometer) -> Firmware:
    return Px4(spec, setup, barometer) if spec.kind == "px4" else ArduPilot(spec, setup)


def boot(
    firmware: Firmware, sensors: SimulatedAutopilotSensors, state: QuadrotorState, step_s: float
) -> float:
    """Boot it with the vehicle at rest until it is ready to arm; returns its clock (s) then.

    Before its first heartbeat it is given real time: its start-up script runs by the wall's clock.

    Raises:
        ConfigError: it ends, or is not ready to arm within `MOST_BOOT_S`.
    """
    readiness = _Readiness(firmware)
    # the flight's own sensors begin at the world's time 0; these have the same flaws
    sensors = copy.deepcopy(sensors)
    sensors.enable()
    began_s, ready_s = wall_clock_s(), math.inf
    try:
        for count in range(1, math.ceil(MOST_BOOT_S / step_s)):
            clock_s = count * step_s
            sensors.step(clock_s, state, 0.0, lambda: OUT_OF_RANGE_M)
            firmware.step(Moment(clock_s, sensors, state))
            if count % STEPS_PER_LOOK == 0:
                readiness.look()
                ready_s = min(ready_s, clock_s) if readiness.ready else math.inf
                if clock_s >= ready_s + SETTLE_S:
                    return clock_s
                if not readiness.heard:
                    sleep_s(began_s + clock_s - wall_clock_s())
    except FirmwareError as error:
        raise ConfigError(str(error)) from error
    raise ConfigError(f"the firmware is not ready to arm after {MOST_BOOT_S:g} s: {readiness.reason}")


class _Readiness:
    """Listens as a ground station does, until the autopilot may be armed."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._mav = mavlink.MAVLink(None, *GROUND_STATION)
        self._reader = FrameReader()
        self._looks = 0
        self.ready = self.heard = False
        self.reason = "no output"
        self._healthy = self._located = False

    def look(self) -> None:
        for frame in self._frames():
            self._take(frame)
        if self._looks % 20 == 0:
            self._ask()
        self._looks += 1
        self.ready = self._healthy and self._located

    def _frames(self) -> Iterator[MavFrame]:
        for data in self._firmware.read():
            yield from self._reader.read(data, 0.0)

    def _take(self, frame: MavFrame) -> None:
        match frame.message_id:
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self.heard = True
            case mavlink.MAVLINK_MSG_ID_SYS_STATUS:
                health = self._mav.decode(bytearray(frame.data)).onboard_control_sensors_health
                self._healthy = bool(health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
            case mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT:
                self._located = self._mav.decode(bytearray(frame.data)).flags & _EKF_NEEDS == _EKF_NEEDS
            case mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS:  # PX4's: sufficient for readiness
                self._located = True
            case mavlink.MAVLINK_MSG_ID_STATUSTEXT:
                self.reason = " ".join(str(self._mav.decode(bytearray(frame.data)).text).split())

    def _ask(self) -> None:
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3
        )
        interval_us = 500_000
        wants = mavlink.MAVLink_command_long_message(
            0, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, interval_us, 0, 0, 0, 0, 0,
        )  # fmt: skip
        for message in (beat, wants):
            self._firmware.write(bytes(message.pack(self._mav)))
