"""Reading markers: every group, parts of the image, shrunk images, and what must not be believed."""

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import Quaternion, Vector3, quat_from_euler
from companion.base.messages import Frame, MarkerGroup
from companion.config import CameraConfig, VisionConfig
from companion.pad import DICTIONARIES, Marker, Pad
from companion.sense.vision import aruco
from companion.sense.vision.aruco import (
    GROUPS,
    CodeReader,
    Detection,
    PadDetector,
    SearchPass,
    farthest_apart,
)
from companion.sense.vision.lens import Lens

TakePicture = Callable[..., tuple[Frame, Vector3, Quaternion]]
LEVEL = quat_from_euler(0.0, 0.0, 0.3)
WHOLE = SearchPass(0, 0, 640, 480, 1, GROUPS)


def drawn(codes: list[tuple[str, int, int, int]], side: int = 96) -> NDArray[np.uint8]:
    """A white image with codes (dictionary, id, left, top)."""
    image = np.full((480, 640), 230, np.uint8)
    for name, identity, left, top in codes:
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[name])
        image[top : top + side, left : left + side] = cv2.aruco.generateImageMarker(
            dictionary, identity, side
        )
    return image


@pytest.fixture
def detector(pad: Pad, camera: CameraConfig) -> PadDetector:
    return PadDetector(pad, VisionConfig(), Lens(camera))


@pytest.mark.parametrize(
    ("height_m", "shrink", "group", "at_least"),
    [
        (9.0, 1, "F", 4),
        (5.0, 1, "F", 4),
        (2.5, 2, "F", 4),
        (1.2, 2, "M", 8),
        (0.5, 1, "C", 8),
        (0.2, 4, "C", 4),
    ],
)
def test_each_group_is_read_at_its_height(
    detector: PadDetector,
    take_picture: TakePicture,
    *,
    height_m: float,
    shrink: int,
    group: MarkerGroup,
    at_least: int,
) -> None:
    frame, _, _ = take_picture((-0.03, 0.0, -height_m - 0.08), LEVEL)
    found = detector.detect(frame.image, SearchPass(0, 0, 640, 480, shrink, (group,)))
    assert len(found) >= at_least
    assert {d.marker.group for d in found} == {group}


@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, 45.0, 60.0])
@pytest.mark.parametrize(("height_m", "shrink", "group"), [(9.0, 1, "F"), (0.25, 3, "C")])
def test_small_markers_are_read_at_any_angle(
    detector: PadDetector,
    take_picture: TakePicture,
    *,
    height_m: float,
    shrink: int,
    group: MarkerGroup,
    yaw_deg: float,
) -> None:
    attitude = quat_from_euler(0.0, 0.0, math.radians(yaw_deg))
    frame, _, _ = take_picture((0.0, 0.0, -height_m - 0.08), attitude)
    found = detector.detect(frame.image, SearchPass(0, 0, 640, 480, shrink, (group,)))
    assert len(found) >= 4


@pytest.mark.parametrize("yaw_deg", [0.0, 15.0, 30.0, 45.0, 60.0, 75.0])
def test_hardly_legible_markers_are_read_enlarged(
    detector: PadDetector, take_picture: TakePicture, yaw_deg: float
) -> None:
    # cells of 2.3 px: as they are, fewer are read
    attitude = quat_from_euler(0.0, 0.0, math.radians(yaw_deg))
    look = SearchPass(220, 140, 420, 340, 1, ("F",))
    enlarged = replace(look, enlarge=2)
    pictures = [take_picture((0.0, 0.0, -14.5), attitude, seed=seed)[0].image for seed in range(6)]
    found = [detector.detect(picture, enlarged) for picture in pictures]
    assert all(found)
    assert sum(map(len, found)) > sum(len(detector.detect(picture, look)) for picture in pictures)
    for detection in (each for read in found for each in read):
        assert detection.corner_std_px < 0.35


@pytest.mark.parametrize("cell_px", [2.9, 3.2, 3.5])
def test_cells_of_a_few_pixels_are_read_wherever_between_pixels_they_lie(cell_px: float) -> None:
    """Half of a cell's pixels may be its neighbours': it is told by its middle, and one way or the other."""
    reader = CodeReader([cv2.aruco.getPredefinedDictionary(DICTIONARIES["4x4_50"])], [(0, 0)])
    fine = 20
    code = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(DICTIONARIES["4x4_50"]), 0, 6)
    light = cv2.resize(code, None, fx=fine, fy=fine, interpolation=cv2.INTER_NEAREST).astype(np.float32)
    rng = np.random.default_rng(2)
    read = 0
    for x, y in rng.uniform(10.0, 11.0, (60, 2)):
        share = cell_px * 8 / fine  # each pixel is the mean of 8 by 8 places
        place = np.array([(share, 0.0, 8.0 * x), (0.0, share, 8.0 * y)])
        wide = cv2.warpAffine(light, place, (360, 360), flags=cv2.INTER_NEAREST, borderValue=255.0)
        seen = cv2.resize(wide, (45, 45), interpolation=cv2.INTER_AREA) * 0.8 + 20.0
        seen = cv2.GaussianBlur(seen, (0, 0), 0.4) + rng.normal(0.0, 2.0, seen.shape)
        read += len(reader.read(np.rint(seen).clip(0, 255).astype(np.uint8), 12.0))
    assert read == 60


def test_corners_are_those_of_the_whole_image_whatever_part_or_size_was_searched(
    detector: PadDetector, take_picture: TakePicture
) -> None:
    looks = (
        SearchPass(131, 57, 601, 470, 1, ("F",)),
        SearchPass(3, 5, 640, 480, 2, ("F",)),
        SearchPass(131, 57, 601, 470, 1, ("F",), enlarge=2),
    )
    for seed in range(6):
        frame, _, _ = take_picture((0.0, 0.0, -3.0), LEVEL, seed=seed)
        whole = detector.detect(frame.image, WHOLE)
        for look in looks:
            part = detector.detect(frame.image, look)
            assert [d.marker.id for d in part] == [0, 1, 2, 3]
            for a in part:
                b = next(d for d in whole if d.marker == a.marker)
                assert np.abs(a.corners_px - b.corners_px).max() < 0.1


def test_an_outline_is_half_a_pixel_within_the_marker(
    detector: PadDetector, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OpenCV's runs through the middles of the outermost black pixels: a marker of 96 px seems one of 95."""
    monkeypatch.setattr(aruco, "refine_corners", lambda _image, found, *_: found)
    for shrink in (1, 2, 4):
        place = SearchPass(0, 0, 640, 480, shrink, GROUPS)
        (found,) = detector.detect(drawn([("4x4_50", 1, 200, 100)]), place)
        square = np.array([(199.5, 99.5), (295.5, 99.5), (295.5, 195.5), (199.5, 195.5)])
        assert found.corners_px == pytest.approx(square, abs=0.1 * shrink)


@pytest.mark.parametrize("height_m", [0.24, 0.28, 0.32])
def test_what_is_legible_in_a_shrunk_image_is_refined_in_the_full_one(
    pad: Pad, camera: CameraConfig, take_picture: TakePicture, height_m: float
) -> None:
    every = PadDetector(pad, VisionConfig(maximum_markers=25), Lens(camera))
    for seed in range(6):
        frame, _, _ = take_picture((-0.03, 0.0, -height_m - 0.08), LEVEL, seed=seed)
        shrunk = every.detect(frame.image, SearchPass(0, 0, 640, 480, 4, ("C",)))
        whole = every.detect(frame.image, SearchPass(0, 0, 640, 480, 1, ("C",)))
        both = {d.marker.id: d.corners_px for d in whole}
        alike = [d for d in shrunk if d.marker.id in both]
        assert len(alike) >= 8
        for detection in alike:
            assert detection.refined
            assert detection.corners_px == pytest.approx(both[detection.marker.id], abs=0.1)


def test_corners_go_round_from_the_top_left_of_the_code(detector: PadDetector) -> None:
    (found,) = detector.detect(drawn([("4x4_50", 2, 200, 150)]), WHOLE)
    assert found.corners_px == pytest.approx(
        np.array([(199.5, 149.5), (295.5, 149.5), (295.5, 245.5), (199.5, 245.5)]), abs=0.6
    )
    assert found.side_px == pytest.approx(96.0, abs=2.0)


@pytest.mark.parametrize("shrink", [2, 4])
def test_what_is_whole_is_read_up_to_the_frames_edge_and_what_is_cut_off_is_not(
    detector: PadDetector, shrink: int
) -> None:
    # OpenCV's usual distance to the border, 3 px of the shrunk image, loses the first
    image = drawn([("4x4_50", 2, 2 * shrink, 150)], side=240)
    look = SearchPass(0, 0, 640, 480, shrink, GROUPS)
    assert [d.marker.id for d in detector.detect(image, look)] == [2]
    for cut in (2 * shrink + 2, 3 * shrink, 5 * shrink):
        assert detector.detect(np.ascontiguousarray(np.roll(image, -cut, axis=1)), look) == []


def test_markers_that_are_not_on_the_pad_are_not_reported(detector: PadDetector) -> None:
    image = drawn(
        [("4x4_50", 1, 60, 60), ("4x4_50", 9, 260, 60), ("6x6_50", 3, 460, 60), ("5x5_50", 49, 60, 260)]
    )
    found = detector.detect(image, WHOLE)
    assert [(d.marker.dictionary, d.marker.id) for d in found] == [("4x4_50", 1)]


def test_a_code_that_is_seen_twice_is_believed_nowhere(detector: PadDetector) -> None:
    image = drawn([("4x4_50", 1, 60, 60), ("4x4_50", 1, 300, 260), ("4x4_50", 0, 460, 60)])
    assert [d.marker.id for d in detector.detect(image, WHOLE)] == [0]


def test_a_reader_tells_every_sighting_of_a_code() -> None:
    """Ten prints of one tag lie about in some pictures: to believe none of them is the pad's own rule."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    image = np.full((200, 480), 230, np.uint8)
    for left, number in ((20, 0), (170, 3), (320, 0)):
        image[40:136, left : left + 96] = cv2.aruco.generateImageMarker(dictionary, number, 96)
    codes = CodeReader([dictionary], [(0, k) for k in range(len(dictionary.bytesList))]).read(image, 12.0)
    assert [code.number for code in codes] == [0, 0, 3]


@pytest.mark.parametrize(("least_px", "read"), [(95.5, [0]), (96.5, [])])
def test_the_least_side_is_the_markers_and_not_its_outlines(least_px: float, read: list[int]) -> None:
    """The outline runs through the middles of the outermost pixels: 95 px about a marker of 96."""
    reader = CodeReader([cv2.aruco.getPredefinedDictionary(DICTIONARIES["4x4_50"])], [(0, 0)])
    codes = reader.read(drawn([("4x4_50", 0, 60, 60)]), least_px)
    assert [code.number for code in codes] == read


def test_small_markers_are_measured_as_far_as_others_are_not_enough(pad: Pad, camera: CameraConfig) -> None:
    """A print costs ten times a side's; of small ones those that lie farthest from the others are fitted."""
    large = [m for m in pad.markers if m.group == "F"]
    small = [m for m in pad.markers if m.group == "M"]
    image = np.full((480, 640), 230, np.uint8)

    def found(markers: list[Marker], side: int, top: int) -> list[Detection]:
        made = []
        for k, marker in enumerate(markers):
            left = 30 + (side + 40) * k
            dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[marker.dictionary])
            code = cv2.aruco.generateImageMarker(dictionary, marker.id, side)
            image[top : top + side, left : left + side] = code
            right, bottom = left + side, top + side
            square = np.array([(left, top), (right, top), (right, bottom), (left, bottom)]) - 0.5
            made.append(Detection(marker, marker.corners_pad_m(), square, float(side)))
        return made

    large_found, small_found = found(large[:4], 72, 40), found(small[:4], 21, 300)
    for beside, fitted in ((4, 0), (3, 1), (0, 4)):
        made = aruco.refine_corners(image, large_found[:beside] + small_found, Lens(camera), 0.0)
        assert [d.marker.group for d in made] == ["F"] * beside + ["M"] * fitted
        assert all(d.refined for d in made)


def test_plain_noise_and_empty_parts_hold_no_markers(detector: PadDetector) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (480, 640)).astype(np.uint8)
    assert detector.detect(noise, WHOLE) == []
    assert detector.detect(noise, SearchPass(100, 100, 104, 300, 1, GROUPS)) == []


def test_of_many_markers_those_farthest_apart_are_kept_in_order(pad: Pad) -> None:
    markers = [m for m in pad.markers if m.group == "C"]
    found = [Detection(m, m.corners_pad_m(), m.corners_pad_m()[:, :2] * 2000.0, 66.0) for m in markers]
    kept = farthest_apart(found, 4)
    assert [d.marker.id for d in kept] == sorted(d.marker.id for d in kept)
    spread = np.array([d.marker.position_pad_m for d in kept])
    assert np.abs(spread) == pytest.approx(np.full((4, 2), 0.1))  # the four corners of the grid
    assert farthest_apart(found[:3], 4) == found[:3]


def test_markers_beside_others_are_those_farthest_from_them(pad: Pad) -> None:
    markers = [m for m in pad.markers if m.group == "C"]
    found = [Detection(m, m.corners_pad_m(), m.corners_pad_m()[:, :2] * 2000.0, 66.0) for m in markers]
    corner = next(d for d in found if np.array(d.marker.position_pad_m) == pytest.approx((0.1, 0.1)))
    others = [d for d in found if d is not corner]
    (first,) = farthest_apart(others, 1, [corner])
    assert first.marker.position_pad_m == pytest.approx((-0.1, -0.1))
    kept = farthest_apart(others, 3, [corner])
    spread = np.array([d.marker.position_pad_m for d in kept])
    assert np.abs(spread) == pytest.approx(np.full((3, 2), 0.1))
