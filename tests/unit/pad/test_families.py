"""Markers of every family: drawn by the simulator, read by the vision that flies, printed as their own."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from companion.base.geometry import IDENTITY, euler_from_quat
from companion.base.messages import Frame
from companion.config import (
    CameraConfig,
    ConfigError,
    VehicleConfig,
    VisionConfig,
    find_file,
    load_model,
    validate,
)
from companion.pad import DICTIONARIES, Pad, load_pad
from companion.sense.vision.pipeline import Vision
from companion.tools.pads.printing import black_cells
from companion.tools.pads.run import single_pad
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from tests.programs import ProgramHere, exit_code

CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
VEHICLE = load_model(VehicleConfig, find_file("vehicles", "x500"))
# AprilRobotics' tag36_11_00000.png without its white, the top of it up
TAG36_11_00000 = (
    "########",
    "#..#.#.#",
    "##...#.#",
    "##..####",
    "#.#.####",
    "##.#..##",
    "####.###",
    "########",
)


@pytest.mark.parametrize("family", sorted(DICTIONARIES))
def test_a_lonely_marker_of_each_family_is_found_where_it_lies_and_as_it_is_turned(family: str) -> None:
    pad = single_pad({"dictionary": family, "id": 7, "side_m": 0.4})
    model = CameraModel(CAMERA, VEHICLE, pad, ImagingSettings(), np.random.default_rng(0))
    scene = ScenePose((0.2, -0.1, -2.3), IDENTITY, (0.0, 0.0, -0.3), 0.5)
    vision = Vision(pad, CAMERA, VEHICLE, VisionConfig())
    sighting = vision.step(Frame(0.0, 0.03, 0, model.render(0.0, lambda _: scene)), None).sighting
    assert sighting is not None
    assert sighting.pad_position_body_m == pytest.approx((-0.2, 0.1, 2.0), abs=0.02)
    assert euler_from_quat(sighting.body_from_pad)[2] == pytest.approx(0.5, abs=0.02)


def test_an_apriltag_is_printed_as_aprilrobotics_prints_it() -> None:
    """With the top of their picture towards the pad's heading."""
    pad = single_pad({"dictionary": "apriltag_36h11", "id": 0, "side_m": 0.8})
    printed = [["."] * 8 for _ in range(8)]
    for corners in black_cells(pad, pad.markers[0]):
        (bottom, left), (top, right) = np.array(corners).min(axis=0), np.array(corners).max(axis=0)
        row, columns = round((0.4 - top) / 0.1), (round((left + 0.4) / 0.1), round((right + 0.4) / 0.1))
        assert round((top - bottom) / 0.1) == 1
        for column in range(*columns):
            printed[row][column] = "#"
    assert tuple("".join(row) for row in printed) == TAG36_11_00000


@pytest.mark.parametrize(
    ("sides_m", "groups"),
    [((0.4,), "F"), ((0.4, 0.05), "FC"), ((0.4, 0.14, 0.05), "FMC"), ((0.4, 0.35, 0.1, 0.05, 0.05), "FFMCC")],
)
def test_markers_without_a_group_get_one_by_their_size(sides_m: tuple[float, ...], groups: str) -> None:
    markers = [
        {"dictionary": "4x4_50", "id": k, "side_m": side, "position_pad_m": (k - 2.0, 0.0)}
        for k, side in enumerate(sides_m)
    ]
    data: dict[str, Any] = {"name": "p", "width_m": 6.0, "length_m": 6.0, "markers": markers}
    assert "".join(marker.group for marker in Pad.model_validate(data).markers) == groups
    markers[0]["group"] = "M"
    assert Pad.model_validate(data).markers[0].group == "M"


@pytest.mark.parametrize(("height_m", "read"), [(4.0, {"F"}), (1.2, {"F", "C"}), (0.25, {"C"})])
def test_a_nested_marker_is_read_with_the_one_about_it_and_below_it(height_m: float, read: set[str]) -> None:
    pad = load_pad("nested_400")
    model = CameraModel(CAMERA, VEHICLE, pad, ImagingSettings(), np.random.default_rng(0))
    scene = ScenePose((0.0, 0.0, -height_m - 0.3), IDENTITY, (0.0, 0.0, -0.3), 0.5)
    vision, found = Vision(pad, CAMERA, VEHICLE, VisionConfig()), set()
    for number in range(4):
        frame = Frame(0.03 * number, 0.03 * number, number, model.render(0.0, lambda _: scene))
        result = vision.step(frame, None)
        found |= {marker.marker.group for marker in result.used}
        if result.sighting is not None:
            assert result.sighting.pad_position_body_m == pytest.approx(
                (0.0, 0.0, height_m), abs=0.02 * height_m
            )
    assert found == read


def nested(identity: int, side_m: float, place: tuple[float, float] = (0.0, 0.0)) -> Pad:
    """A small tag on one of 40 cm of that id."""
    tag = {"dictionary": "apriltag_36h11", "position_pad_m": (0.0, 0.0)}
    markers = [
        {**tag, "id": identity, "side_m": 0.4},
        {**tag, "id": 5, "side_m": side_m, "position_pad_m": place, "quiet_zone_m": 0.2 * side_m},
    ]
    data = {"name": "p", "width_m": 0.5, "length_m": 0.5, "markers": markers}
    return validate(Pad, data, "p")


def test_what_lies_on_a_code_may_not_make_it_illegible() -> None:
    assert nested(77, 0.05)
    for identity, side_m in ((77, 0.08), (77, 0.2), (2, 0.05)):  # too large, much too large, on black cells
        with pytest.raises(ConfigError, match=r"change too many .*36h11 id \d+ \(\d+; expected 2 or fewer"):
            nested(identity, side_m)
    with pytest.raises(ConfigError, match="markers overlap"):
        nested(77, 0.05, (0.17, 0.0))  # over its border


def test_a_single_marker_is_written_and_printed(tmp_path: Path) -> None:
    words = ("companion", "pad", "single", "--family", "apriltag_36h11", "--id", "3", "--size", "0.4")
    assert exit_code(*words, "-o", tmp_path / "tag.pdf") == 0
    pad = load_pad(tmp_path / "tag.yaml")
    assert [(m.name, m.side_m, m.group) for m in pad.markers] == [("apriltag_36h11 id 3", 0.4, "F")]
    assert pad.width_m == pytest.approx(0.5)  # a cell of white all around
    assert (tmp_path / "tag.pdf").read_bytes().startswith(b"%PDF")
    assert exit_code(*words, "-o", tmp_path / "alone.yaml") == 0
    assert {path.name for path in tmp_path.iterdir()} == {"tag.yaml", "tag.pdf", "alone.yaml"}
    assert yaml.safe_load((tmp_path / "alone.yaml").read_text())["markers"][0]["id"] == 3


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["single", "--family", "apriltag_16h5", "--id", "30"],
            "id 30: expected less than 30 in apriltag_16h5",
        ),
        (["single", "--family", "tag36h12"], "dictionary: expected one of 4x4_100"),
        (["single", "--size", "0"], "side_m: expected greater than 0.005"),
        (["indoor_400", "--id", "1"], "--family, --id and --size: expected with single"),
    ],
)
def test_what_a_user_gets_wrong_is_one_line(words: list[str], said: str, program: ProgramHere) -> None:
    assert said in program("companion", "pad", *words).refusal
