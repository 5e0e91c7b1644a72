"""Axes and signs of the simulated IMU, each against what a person with a model in hand would say."""

import math
import struct
from collections.abc import Callable

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, Quaternion, Vector3
from companion.base.messages import ImuSample, MagSample
from companion.config import ImuConfig
from companion.sense.imu.mpu9250 import Mpu9250
from sitl.devices.rack import SensorErrors, SensorRack
from sitl.sensors.inertial import ImuErrors
from sitl.sensors.sensors import NO_GPS_ERRORS, NO_RANGE_ERRORS, MagErrors
from sitl.vehicle.quadrotor import QuadrotorState
from tests.unit.sitl.sensors.headings import EAST, NORTH, SOUTH, WEST


class NoLine:
    """A serial line to nowhere."""

    def send(self, data: bytes) -> None:
        """Lose it."""

    def receive(self) -> bytes:
        """Nothing."""
        return b""

    def set_baud(self, baud: int) -> None:
        """Nothing has a rate."""

    def close(self) -> None:
        """Nothing to close."""


QUIET = SensorErrors(
    imu=ImuErrors(
        gyro_noise_rad_s_rthz=0.0,
        gyro_bias_rad_s=0.0,
        gyro_wander_rad_s=0.0,
        gyro_scale=0.0,
        accel_noise_m_s2_rthz=60e-6 * GRAVITY_M_S2,  # enough that the sensor is not taken for stuck
        accel_bias_m_s2=0.0,
        accel_wander_m_s2=0.0,
        accel_scale=0.0,
        misalignment_rad=0.0,
        vibration_m_s2=0.0,
        vibration_rad_s=0.0,
    ),
    magnetometer=MagErrors(noise_ut=0.3, hard_iron_ut=0.0, soft_iron=0.0, current_ut=0.0),
    gps=NO_GPS_ERRORS,
    range=NO_RANGE_ERRORS,
)
FIELD_NED: Vector3 = (20.9, 0.6, 42.9)
G = GRAVITY_M_S2
COS_30 = math.sqrt(0.75)
NOSE_UP: Quaternion = (math.cos(math.radians(15.0)), 0.0, math.sin(math.radians(15.0)), 0.0)  # by 30 degrees
RIGHT_DOWN: Quaternion = (math.cos(math.radians(15.0)), math.sin(math.radians(15.0)), 0.0, 0.0)


def through_the_rack(
    force: Vector3, rate: Vector3, attitude: Quaternion, each_step: Callable[[SensorRack, float], None]
) -> SensorRack:
    rack = SensorRack(
        3,
        1.0 / 400.0,
        home=(47.0, 8.0, 400.0),
        field_ned_ut=FIELD_NED,
        gps_port=NoLine(),
        range_port=NoLine(),
        # what the app believes of the mount is nothing to the hardware
        imu_config=ImuConfig(body_from_sensor_deg=(0.0, 0.0, 45.0)),
        errors=QUIET,
    )
    state = QuadrotorState(
        (0.0, 0.0, -5.0), attitude=attitude, rate_body_rad_s=rate, specific_force_body_m_s2=force
    )
    for k in range(400):
        rack.step(k / 400.0, state, 0.0, lambda: 5.0)
        each_step(rack, k / 400.0)
    return rack


@pytest.mark.parametrize(
    ("force", "rate", "chip_g", "chip_deg_s"),
    [
        # at rest and level: the accelerometer feels the ground push up, out of its face
        ((0.0, 0.0, -G), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
        # nose up by 30 degrees: the push is half ahead
        ((0.5 * G, 0.0, -COS_30 * G), (0.0, 0.0, 0.0), (0.5, 0.0, COS_30), (0.0, 0.0, 0.0)),
        # right side down by 30 degrees: the push is half to the left, along the chip's y
        (
            (0.0, -0.5 * G, -COS_30 * G),
            (0.0, 0.0, 0.0),
            (0.0, 0.5, COS_30),
            (0.0, 0.0, 0.0),
        ),
        # rolling right, pitching up, turning clockwise: about ahead, right and down
        ((0.0, 0.0, -G), (1.0, 2.0, 3.0), (0.0, 0.0, 1.0), (57.3, -114.6, -171.9)),
    ],
)
def test_the_chips_registers_read_as_of_one_face_up_with_x_ahead(
    force: Vector3, rate: Vector3, chip_g: Vector3, chip_deg_s: Vector3
) -> None:
    rack = through_the_rack(force, rate, NORTH, lambda _rack, _now_s: None)
    words = struct.unpack(">7h", rack.imu.read(0x68, 0x3B, 14))
    # as after power-on: 2 g and 250 deg/s full scale
    assert [word / 16384.0 for word in words[:3]] == pytest.approx(chip_g, abs=0.01)
    assert [word / 131.07 for word in words[4:]] == pytest.approx(chip_deg_s, abs=0.2)


@pytest.mark.parametrize(
    ("attitude", "hx_hy_hz"),
    [
        # the AK8963's x is to the vehicle's left, its y ahead, its z down; the field is north and down
        (NORTH, (-0.6, 20.9, 42.9)),
        (EAST, (20.9, 0.6, 42.9)),
        (SOUTH, (0.6, -20.9, 42.9)),
        (WEST, (-20.9, -0.6, 42.9)),
    ],
)
def test_the_magnetometers_registers_read_in_its_own_axes(
    attitude: Quaternion, hx_hy_hz: tuple[float, float, float]
) -> None:
    blocks: list[tuple[int, int, int]] = []

    def measure(rack: SensorRack, now_s: float) -> None:
        mag = rack.imu.magnetometer
        if now_s == 0.0:
            mag.write(0x0A, 0x16)  # 16 bits, 100 Hz
        elif mag.read(0x02, 1)[0] & 0x01:
            blocks.append(struct.unpack("<hhh", mag.read(0x03, 7)[:6]))

    through_the_rack((0.0, 0.0, -G), (0.0, 0.0, 0.0), attitude, measure)
    assert len(blocks) > 80
    gain = [0.15 * ((fuse - 128) / 256.0 + 1.0) for fuse in (176, 178, 165)]
    assert np.mean(blocks, axis=0) * gain == pytest.approx(hx_hy_hz, abs=0.15)


@pytest.mark.parametrize(
    ("attitude", "force", "field"),
    [
        (NORTH, (0.0, 0.0, -G), (20.9, 0.6, 42.9)),
        (EAST, (0.0, 0.0, -G), (0.6, -20.9, 42.9)),
        # nose up by 30 degrees: ahead is 0.866 of north less half of down
        (NOSE_UP, (0.5 * G, 0.0, -0.8660254 * G), (-3.3499, 0.6, 47.6025)),
        # right side down by 30 degrees: right is 0.866 of east and half of down
        (RIGHT_DOWN, (0.0, -0.5 * G, -0.8660254 * G), (20.9, 21.9696, 36.8525)),
    ],
)
def test_the_driver_makes_body_axes_of_the_chips(
    attitude: Quaternion, force: Vector3, field: Vector3
) -> None:
    imu: list[ImuSample] = []
    mag: list[MagSample] = []
    driver: list[Mpu9250] = []
    rate = (0.3, -0.2, 0.1)

    def poll(rack: SensorRack, now_s: float) -> None:
        if not driver:
            driver.append(Mpu9250(rack.imu, ImuConfig()))
        new_imu, new_mag = driver[0].poll(lambda: now_s)
        imu.extend(new_imu)
        mag.extend(new_mag)

    through_the_rack(force, rate, attitude, poll)
    assert imu[-1].specific_force_body_m_s2 == pytest.approx(force, abs=0.04)
    assert imu[-1].rate_body_rad_s == pytest.approx(rate, abs=0.002)
    assert np.mean([m.field_body_ut for m in mag], axis=0) == pytest.approx(field, abs=0.25)
