"""One simulated MPU9250 with the driver on it, and the time that passes for both."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, Vector3, matrix_from_quat, quat_from_euler
from companion.base.messages import ImuSample, MagSample
from companion.config import ImuConfig, SenseConfig, load_inertial
from companion.sense.imu.i2c import RegisterBus, SensorError
from companion.sense.imu.mpu9250 import Mpu9250
from sitl.devices.mpu9250 import Ak8963Device, Mpu9250Device
from sitl.sensors.inertial import NO_IMU_ERRORS, ImuErrors, ImuSensor
from sitl.sensors.sensors import MagErrors, MagSensor

STEP_S = 1.0 / 400.0
REST: Vector3 = (0.0, 0.0, -GRAVITY_M_S2)
STILL: Vector3 = (0.0, 0.0, 0.0)
FIELD: Vector3 = (20.9, 0.6, 42.9)
# enough noise that no two samples are alike, and small against every tolerance here
QUIET_IMU = replace(NO_IMU_ERRORS, accel_noise_m_s2_rthz=60e-6 * GRAVITY_M_S2)
QUIET_MAG = MagErrors(noise_ut=0.3, hard_iron_ut=0.0, soft_iron=0.0, current_ut=0.0)

Truth = Callable[[float], tuple[Vector3, Vector3, Vector3]]


def at_rest(_now_s: float) -> tuple[Vector3, Vector3, Vector3]:
    return REST, STILL, FIELD


class ImuRig:
    """One chip, its driver, and the time that passes for both."""

    def __init__(
        self,
        config: ImuConfig | None = None,
        imu: ImuErrors = QUIET_IMU,
        *,
        clock_error: float = 0.003,
        identity: int = 0x71,
        wrap: Callable[[Mpu9250Device], RegisterBus] = lambda device: device,
    ) -> None:
        self.config = config or ImuConfig(poll_hz=100)
        rng = np.random.default_rng(7)
        roll, pitch, yaw = (math.radians(angle) for angle in self.config.body_from_sensor_deg)
        mount = matrix_from_quat(quat_from_euler(roll, pitch, yaw)).T  # sensor from body
        self.device = Mpu9250Device(
            ImuSensor(imu, rng, STEP_S, mount),
            Ak8963Device(MagSensor(QUIET_MAG, rng, mount)),
            clock_error=clock_error,
            identity=identity,
            interface="spi" if self.config.over_spi else "i2c",
        )
        self.driver = Mpu9250(
            wrap(self.device), self.config, inertial=load_inertial(SenseConfig(imu=self.config))
        )
        self.now_s = 0.0
        self.imu: list[ImuSample] = []
        self.mag: list[MagSample] = []
        self.faults: list[SensorError] = []
        self._step = 0

    def run(self, seconds: float, truth: Truth = at_rest, polling: bool = True) -> None:
        every = round(1.0 / (self.config.poll_hz * STEP_S))
        for _ in range(round(seconds / STEP_S)):
            self.now_s = self._step * STEP_S
            self.device.step(self.now_s, *truth(self.now_s), 0.0)
            if polling and self._step % every == 0:
                self.poll(self.now_s)
            self._step += 1

    def problem(self) -> str | None:
        return self.driver.problem

    def poll(self, now_s: float) -> None:
        try:
            imu, mag = self.driver.poll(lambda: now_s)
        except SensorError as error:
            self.faults.append(error)
        else:
            self.imu += imu
            self.mag += mag
