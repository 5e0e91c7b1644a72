"""Axes and signs of the simulated camera, each against what a person with a model in hand would say.

The expectations are spelled out, and neither the app's code nor its settings take part where it can be
helped: a mount or a marker that is mirrored on both sides alike would land perfectly, in simulation.
"""

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import FloatArray, Quaternion, Vector3
from companion.config import CameraConfig, VehicleConfig, find_file, load_model
from companion.pad import Marker, Pad, load_pad
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from tests.unit.sitl.sensors.headings import EAST, NORTH, SOUTH, WEST

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


def codes(image: Image, dictionary: int) -> dict[int, FloatArray]:
    """The codes that OpenCV reads: id to corners (4, 2), top left of the print first."""
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionary))
    corners, ids, _ = detector.detectMarkers(image)
    assert ids is not None, "no code in the picture"
    return {
        int(i): np.asarray(c, dtype=np.float64).reshape(4, 2)
        for i, c in zip(ids.ravel(), corners, strict=True)
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
    right, down = board_off_middle(picture((0.0, 0.0, -5.0), attitude, pad_at=pad_at))
    along, across = {
        "upper": (-down, right),
        "lower": (down, right),
        "right": (right, down),
        "left": (-right, down),
    }[half]
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
    right, down = board_off_middle(image)
    along, across = {"upper": (-down, right), "lower": (down, right), "left": (-right, down)}[half]
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
