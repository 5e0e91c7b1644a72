"""Level attitudes, by where the nose points."""

import math
import struct
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import GRAVITY_M_S2, FloatArray, Quaternion, Vector3
from companion.base.messages import ImuSample, MagSample
from companion.config import CameraConfig, ImuConfig, VehicleConfig, find_file, load_model
from companion.pad import Marker, Pad, load_pad
from companion.sense.imu.mpu9250 import Mpu9250
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from sitl.devices.ports import DevicePort
from sitl.devices.rack import SensorRack
from sitl.sensors.inertial import ImuErrors, SensorErrors
from sitl.sensors.sensors import MagErrors
from sitl.vehicle.quadrotor import QuadrotorState
from tests.unit.sitl.sensors.flawless import NO_GPS_ERRORS, NO_RANGE_ERRORS

HALF = math.sqrt(0.5)
NORTH: Quaternion = (1.0, 0.0, 0.0, 0.0)
EAST: Quaternion = (HALF, 0.0, 0.0, HALF)  # level, the nose to the east
SOUTH: Quaternion = (0.0, 0.0, 0.0, 1.0)
WEST: Quaternion = (HALF, 0.0, 0.0, -HALF)


# ----------------
# Axes and signs of the simulated camera, each against what a person with a model in hand would say.
#
# The expectations are spelled out, and neither the app's code nor its settings take part where it can be
# helped: a mount or a marker that is mirrored on both sides alike would land perfectly, in simulation.

CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
VEHICLE = load_model(VehicleConfig, find_file("vehicles", "x500"))
PAD = load_pad("moving_1300")
SHARP = ImagingSettings(
    exposure_s=0.0, readout_s=0.0, noise_grey=0.0, lens_blur_px=0.5, aperture_m=0.0, vignette=0.0
)
ABOVE: Vector3 = (-0.03, 0.0, -3.08)  # the camera, 3 cm ahead and 8 cm under, is 3 m over the origin
Image = NDArray[np.uint8]
WHITE_GREY = 225  # between the ground's and the board's white, encoded as the camera encodes them


def picture(
    position: Vector3 = ABOVE,
    attitude: Quaternion = NORTH,
    *,
    pad_at: Vector3 = (0.0, 0.0, 0.0),
    pad_heading_rad: float = 0.0,
    vehicle: VehicleConfig = VEHICLE,
    pad: Pad = PAD,
) -> Image:
    cv2.setNumThreads(1)
    camera = CameraModel(CAMERA, vehicle, pad, SHARP, np.random.default_rng(0))
    return camera.render(0.0, lambda _: ScenePose(position, attitude, pad_at, pad_heading_rad))


def board_off_middle(image: Image) -> tuple[float, float]:
    """How far (right, down) of the image's middle the board's white is, px."""
    rows, columns = np.nonzero(image > WHITE_GREY)
    assert rows.size > 500, "no board in the picture"
    return float(columns.mean()) - 319.5, float(rows.mean()) - 239.5


def off_towards(half: str, image: Image) -> tuple[float, float]:
    """The same along the way to a half of the image, and across it."""
    right, down = board_off_middle(image)
    halves = {"upper": (-down, right), "lower": (down, right), "right": (right, down), "left": (-right, down)}
    return halves[half]


def codes(image: Image, dictionary: int) -> dict[int, FloatArray]:
    """The codes that OpenCV reads: id to corners (4, 2), top left of the print first."""
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionary))
    corners, ids, _ = detector.detectMarkers(image)
    assert ids is not None, "no code in the picture"
    return {
        int(i): np.asarray(c, dtype=np.float64).reshape(4, 2)
        for i, c in zip(ids.ravel(), corners, strict=True)
    }


# ---------------------------------------------------------------- where the pad is in the image


@pytest.mark.parametrize(
    ("attitude", "pad_at", "half"),
    [
        (NORTH, (1.2, 0.0, 0.0), "upper"),
        (NORTH, (0.0, 1.2, 0.0), "right"),
        (NORTH, (-1.2, 0.0, 0.0), "lower"),
        (NORTH, (0.0, -1.2, 0.0), "left"),
        (EAST, (0.0, 1.2, 0.0), "upper"),
        (EAST, (1.2, 0.0, 0.0), "left"),
        (SOUTH, (-1.2, 0.0, 0.0), "upper"),
        (SOUTH, (0.0, 1.2, 0.0), "left"),
        (WEST, (0.0, -1.2, 0.0), "upper"),
        (WEST, (1.2, 0.0, 0.0), "right"),
    ],
)
def test_a_level_vehicle_sees_the_pad_on_the_side_on_which_it_lies(
    attitude: Quaternion, pad_at: Vector3, half: str
) -> None:
    along, across = off_towards(half, picture((0.0, 0.0, -5.0), attitude, pad_at=pad_at))
    # 1.2 m from 4.92 m up at 532 px: 130 px, less or more by the 3 cm that the camera sits ahead
    assert along == pytest.approx(130.0, abs=10.0)
    assert abs(across) < 10.0


@pytest.mark.parametrize(
    ("attitude", "side"),
    [
        # right side down: the belly looks to the left, what lies below is on the image's right
        ((math.cos(0.1), math.sin(0.1), 0.0, 0.0), (1.0, 0.0)),
        # nose up: the belly looks ahead, what lies below is at the image's bottom
        ((math.cos(0.1), 0.0, math.sin(0.1), 0.0), (0.0, 1.0)),
    ],
)
def test_a_tilting_vehicle_sees_the_pad_below_it_off_to_the_lower_side(
    attitude: Quaternion, side: tuple[float, float]
) -> None:
    off = np.array(board_off_middle(picture((0.0, 0.0, -5.0), attitude)))
    assert off @ side == pytest.approx(532.0 * math.tan(0.2), abs=15.0)
    assert abs(off @ (side[1], side[0])) < 10.0


@pytest.mark.parametrize(
    ("mount", "pad_at", "half"),
    [
        # the image's top edge to the vehicle's right
        ({"camera_yaw_deg": 90.0}, (0.0, 1.2, 0.0), "upper"),
        ({"camera_yaw_deg": 90.0}, (1.2, 0.0, 0.0), "left"),
        ({"camera_yaw_deg": -90.0}, (0.0, -1.2, 0.0), "upper"),
        ({"camera_yaw_deg": 180.0}, (-1.2, 0.0, 0.0), "upper"),
        # looking ahead: what is straight below is towards the bottom
        ({"camera_tilt_deg": 14.0}, (0.0, 0.0, 0.0), "lower"),
        ({"camera_tilt_deg": -14.0}, (0.0, 0.0, 0.0), "upper"),
        # turned to the right and looking there
        ({"camera_tilt_deg": 20.0, "camera_yaw_deg": 90.0}, (0.0, 0.6, 0.0), "lower"),
    ],
)
def test_a_turned_or_tilted_camera_sees_the_pad_where_its_mount_says(
    mount: dict[str, float], pad_at: Vector3, half: str
) -> None:
    image = picture((0.0, 0.0, -5.0), pad_at=pad_at, vehicle=VEHICLE.model_copy(update=mount))
    along, across = off_towards(half, image)
    assert along > 50.0
    assert abs(across) < 15.0


# ---------------------------------------------------------------- where the codes are on the pad


def test_the_shipped_pads_far_markers_are_where_its_file_says() -> None:
    """x, the pad's heading, is up in the image, y to the right: id 0 at (0.42, -0.42) is upper left."""
    seen = codes(picture(), cv2.aruco.DICT_4X4_50)
    off = 0.42 * 532.0 / 3.0
    for marker_id, middle in {0: (-off, -off), 1: (off, -off), 2: (-off, off), 3: (off, off)}.items():
        assert seen[marker_id].mean(axis=0) - (319.5, 239.5) == pytest.approx(middle, abs=6.0)


@pytest.mark.parametrize(
    ("pad_heading_rad", "top", "id_0"),
    [
        (0.0, (0, -1), (-1, -1)),  # the pad points north, up in the image
        (0.5 * math.pi, (1, 0), (1, -1)),  # east: right
        (math.pi, (0, 1), (1, 1)),
        (-0.5 * math.pi, (-1, 0), (-1, 1)),
    ],
)
def test_the_codes_top_edges_are_towards_the_pads_heading(
    pad_heading_rad: float, top: tuple[int, int], id_0: tuple[int, int]
) -> None:
    seen = codes(picture(pad_heading_rad=pad_heading_rad), cv2.aruco.DICT_4X4_50)
    assert len(seen) == 4
    for corners in seen.values():
        up = corners[:2].mean(axis=0) - corners.mean(axis=0)  # from the middle to the top edge
        assert up / np.linalg.norm(up) == pytest.approx(top, abs=0.06)
        # unmirrored: from top left to top right is a quarter turn clockwise from up
        along = corners[1] - corners[0]
        assert along / np.linalg.norm(along) == pytest.approx((-top[1], top[0]), abs=0.06)
    assert tuple(np.sign(seen[0].mean(axis=0) - (319.5, 239.5))) == id_0


@pytest.mark.parametrize(
    ("yaw_deg", "top"), [(0.0, (0, -1)), (90.0, (1, 0)), (180.0, (0, 1)), (-90.0, (-1, 0))]
)
def test_a_marker_printed_turned_is_turned_clockwise(yaw_deg: float, top: tuple[int, int]) -> None:
    marker = Marker(
        dictionary="5x5_50", id=7, side_m=0.3, position_pad_m=(0.2, 0.1), yaw_deg=yaw_deg, group="F"
    )
    board = Pad(name="one", width_m=1.0, length_m=1.0, markers=(marker,))
    corners = codes(picture(pad=board), cv2.aruco.DICT_5X5_50)[7]
    scale = 532.0 / 3.0
    assert corners.mean(axis=0) - (319.5, 239.5) == pytest.approx((0.1 * scale, -0.2 * scale), abs=3.0)
    up = corners[:2].mean(axis=0) - corners.mean(axis=0)
    assert up / np.linalg.norm(up) == pytest.approx(top, abs=0.05)


# ----------------
# Axes and signs of the simulated IMU, each against what a person with a model in hand would say.


class NoLine(DevicePort):
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
        ((0.0, -0.5 * G, -COS_30 * G), (0.0, 0.0, 0.0), (0.0, 0.5, COS_30), (0.0, 0.0, 0.0)),
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
