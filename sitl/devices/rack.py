"""The companion computer's sensors: the truth of each physics step in, registers and bytes out.

Each sensor has a random stream of its own, so that a fault in one does not change the noise of another.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from companion.base.geometry import (
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    add,
    norm,
    quat_from_rotation_vector,
    quat_rotate_inverse,
    scale,
    subtract,
    tilt_from_quat,
)
from companion.config import GpsConfig, ImuConfig
from sitl.devices.mpu9250 import Ak8963Device, Mpu9250Device
from sitl.devices.neo6m import Neo6mDevice
from sitl.devices.ports import DevicePort
from sitl.devices.ultrasonic import PolledUltrasonicDevice, UltrasonicDevice
from sitl.scenario.scenario import SensorSettings
from sitl.sensors.inertial import ImuSensor, SensorErrors, felt_at, moved_at
from sitl.sensors.sensors import BoardTruth, GpsSensor, MagSensor, RangeSensor
from sitl.vehicle.quadrotor import QuadrotorState


class BoardMount:
    """How the inertial board lies on the airframe, against what its file says; it may slip.

    The board's axes are the body's turned by a rotation vector (FRD, rad). While it slips, the gyroscope
    feels the slip as a turn. Magnetometer and inertial sensor are one chip and turn together.
    """

    def __init__(self, dt_s: float) -> None:
        self._dt_s = dt_s
        self._turn: Vector3 = ZERO3
        self._board: Quaternion = IDENTITY
        # for faults: where it is to lie, and how long it takes to get there (s); 0: it lay there before
        self.target_rad: Vector3 = ZERO3
        self.slips_for_s = 0.0

    def clear_faults(self) -> None:
        """Where the file has it."""
        self.target_rad, self.slips_for_s = ZERO3, 0.0

    def felt(self, force_body: Vector3, rate_body: Vector3) -> tuple[Vector3, Vector3]:
        """Specific force and rate (body axes) as the board feels them in this step."""
        slip_rate = ZERO3
        if self._turn != self.target_rad:
            slip_rate = self._move()
        if self._board == IDENTITY:
            return force_body, rate_body
        force = quat_rotate_inverse(self._board, force_body)
        return force, add(quat_rotate_inverse(self._board, rate_body), slip_rate)

    def seen(self, field_body: Vector3) -> Vector3:
        return field_body if self._board == IDENTITY else quat_rotate_inverse(self._board, field_body)

    def _move(self) -> Vector3:
        """One step of the slip; returns its rate (rad/s), about an axis that stays."""
        left = subtract(self.target_rad, self._turn)
        if self.slips_for_s <= 0.0:
            self._turn, rate = self.target_rad, ZERO3
        else:
            speed = norm(self.target_rad) / self.slips_for_s
            step = min(1.0, speed * self._dt_s / norm(left)) if speed > 0.0 else 1.0
            self._turn = self.target_rad if step >= 1.0 else add(self._turn, scale(left, step))
            rate = scale(left, step / self._dt_s)
        self._board = quat_from_rotation_vector(self._turn)
        return rate


OSCILLATOR_TOLERANCE: Final = 0.01  # MPU9250: ±1 %
# How the simulated chip is soldered in: face up, its x axis forward. Its axes are right-handed with z out of
# its face, so y is left and z up. Independent of the app's settings.
SENSOR_FROM_BODY: Final = np.array(
    [
        # forward, right, down
        [1.0, 0.0, 0.0],  # chip x
        [0.0, -1.0, 0.0],  # chip y
        [0.0, 0.0, -1.0],  # chip z
    ]
)


class SensorRack:
    """The vehicle's IMU (a register bus), GPS and ultrasonic (on their serial lines)."""

    def __init__(
        self,
        seed: int,
        dt_s: float,
        *,
        home: Vector3,
        field_ned_ut: Vector3,
        gps_port: DevicePort,
        range_port: DevicePort,
        imu_config: ImuConfig | None = None,
        gps_config: GpsConfig | None = None,
        errors: SensorErrors | None = None,
        wiring: SensorSettings | None = None,
        imu_position_body_m: Vector3 = ZERO3,
    ) -> None:
        """`imu_position_body_m`: the IMU from the centre of mass; `wiring`: which sensors there are."""
        wiring = wiring or SensorSettings()
        imu_config, gps_config = imu_config or ImuConfig(), gps_config or GpsConfig()
        errors = errors or SensorErrors()
        streams = [np.random.default_rng((seed, k)) for k in range(4)]
        clock_errors = streams[0].uniform(-OSCILLATOR_TOLERANCE, OSCILLATOR_TOLERANCE, 2).tolist()
        self.mount = BoardMount(dt_s)
        self.inertial = ImuSensor(errors.imu, streams[0], dt_s, SENSOR_FROM_BODY)
        self.magnetometer = MagSensor(errors.magnetometer, streams[1], SENSOR_FROM_BODY)
        self.echo = RangeSensor(errors.range, streams[3])
        self.imu = Mpu9250Device(
            self.inertial,
            Ak8963Device(self.magnetometer, clock_error=clock_errors[1]),
            address=imu_config.address,
            interface=wiring.imu_interface,
            clock_error=clock_errors[0],
        )
        self.position = GpsSensor(errors.gps, streams[2], home)
        self.gps = Neo6mDevice(self.position, gps_config.latency_s, wiring.gps_wake_baud)
        ultrasonic = UltrasonicDevice if wiring.ultrasonic == "frames" else PolledUltrasonicDevice
        self.range = ultrasonic(self.echo)
        self._field_ned_ut = field_ned_ut
        self.deck_field_ned_ut = ZERO3  # of what is beneath, in addition
        self._imu_position_body_m = imu_position_body_m
        self._antenna_body_m = gps_config.antenna_position_body_m
        self._gps_port = gps_port
        self._range_port = range_port

    @property
    def truth(self) -> BoardTruth:
        imu = self.inertial
        return BoardTruth(
            imu.accel_calibration_errors,
            imu.gyro_calibration_errors,
            self.magnetometer.calibration_errors,
            SENSOR_FROM_BODY,
        )

    def clear_faults(self) -> None:
        imu, inertial = self.imu, self.inertial
        imu.wake()
        imu.magnetometer.silent = False
        imu.nack_every, imu.fault = 0, "none"
        inertial.rate_offset_rad_s = inertial.force_offset_m_s2 = ZERO3
        inertial.accel_limit_m_s2, inertial.vibration_factor = math.inf, 1.0
        self.magnetometer.stray_field_ut = ZERO3
        self.range.silent = False
        self.gps.has_fix, self.gps.silent = True, False
        self.position.jump_ned_m, self.position.stuck = ZERO3, False
        for part in (self.mount, inertial.gyro_glitches, inertial.accel_glitches, self.magnetometer.glitches):
            part.clear_faults()
        self.position.glitches.clear_faults()
        self.echo.clear_faults()

    def step(
        self, now_s: float, state: QuadrotorState, throttle: float, range_height_m: Callable[[], float]
    ) -> None:
        """One physics step: sample, and send what is due.

        `throttle` is the mean motor command, 0 to 1; `range_height_m` gives the ultrasonic's height over the
        floor or pad beneath it, and is called at each ping.
        """
        field_body = ZERO3
        if self.imu.magnetometer.is_due(now_s):
            field_body = quat_rotate_inverse(state.attitude, add(self._field_ned_ut, self.deck_field_ned_ut))
        felt = felt_at(self._imu_position_body_m, state)
        force, rate = self.mount.felt(felt, state.rate_body_rad_s)
        self.imu.step(now_s, force, rate, self.mount.seen(field_body), throttle)
        self._step_gps(now_s, state)
        self._step_range(now_s, state, range_height_m)

    def _step_gps(self, now_s: float, state: QuadrotorState) -> None:
        gps, port = self.gps, self._gps_port
        if heard := port.receive():
            gps.receive(heard)
        if now_s < gps.next_s:
            return
        port.set_baud(gps.baud)
        port.send(gps.step(now_s, *moved_at(self._antenna_body_m, state)))

    def _step_range(self, now_s: float, state: QuadrotorState, range_height_m: Callable[[], float]) -> None:
        sonar, port = self.range, self._range_port
        if heard := port.receive():
            sonar.receive(heard)
        if now_s >= sonar.next_s:
            port.send(sonar.step(now_s, range_height_m(), tilt_from_quat(state.attitude)))
