"""`companion detect`: photos and videos through the vision that flies."""

import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import IDENTITY
from companion.config import CameraConfig, VehicleConfig, VisionConfig, find_file, load_model
from companion.pad import load_pad
from companion.tools.detect.run import GROUP_COLOURS, OUTLINE, UNUSED, Found, PadFinder, draw
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from tests.programs import ProgramHere

CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
VEHICLE = load_model(VehicleConfig, find_file("vehicles", "x500"))
PAD = load_pad("moving_1300")
OPTIONS = ("--pad", "moving_1300", "--camera", "sitl_640x480")


def picture(height_m: float, aside_m: float = 0.0, seed: int = 0) -> NDArray[np.uint8]:
    """The pad from a camera so high above it, looking down, and so far to its front."""
    model = CameraModel(CAMERA, VEHICLE, PAD, ImagingSettings(), np.random.default_rng(seed))
    x, y, z = VEHICLE.camera_position_body_m
    scene = ScenePose((aside_m - x, -y, -height_m - z), IDENTITY, (0.0, 0.0, 0.0), 0.0)
    return model.render(0.0, lambda _time_s: scene)


def finder() -> PadFinder:
    return PadFinder(PAD, CAMERA, VisionConfig())


def painted(image: NDArray[np.uint8], colour: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Where a picture has a colour; the edges of lines are blended."""
    return np.asarray((np.abs(image.astype(int) - colour) < 30).all(axis=-1))


@pytest.mark.parametrize(("height_m", "aside_m"), [(0.5, 0.02), (2.0, 0.3), (9.0, -1.0)])
def test_the_pose_is_the_camera_s_within_what_it_states(height_m: float, aside_m: float) -> None:
    found = finder().find(picture(height_m, aside_m))
    view = found.view
    assert view is not None
    assert len(found.markers) >= 1
    truth = math.hypot(height_m, aside_m)
    assert abs(view.distance_m - truth) < 4.0 * view.along_std_m
    # the image's top is forward, so what the camera is ahead of is below its middle
    np.testing.assert_allclose(view.position_m[:2], (0.0, aside_m), atol=4.0 * view.across_std_m)
    slant = math.degrees(math.atan2(abs(aside_m), height_m))
    assert view.slant_deg == pytest.approx(slant, abs=2.0)
    assert 0.0 < view.across_std_m < 0.05 * height_m


def test_a_far_and_a_near_pad_are_both_found_in_the_first_picture() -> None:
    # vision looks for the two in turn: a single photo must not depend on whose turn it is
    for height_m in (10.0, 0.4):
        looking = finder()
        seen = [looking.find(picture(height_m)).view is not None for _ in range(3)]
        assert seen == [True] * 3


def test_the_overlay_marks_the_markers_and_the_board() -> None:
    image = picture(2.0)
    looking = finder()
    found = looking.find(image)
    drawn = draw(image, found, PAD, looking.lens, "text")
    assert drawn.shape[0] > image.shape[0]
    assert drawn.shape[1:] == (image.shape[1], 3)
    for detection in found.markers:
        u, v = np.rint(detection.corners_px.mean(axis=0)).astype(int)
        half = round(0.6 * detection.side_px)
        about = drawn[v - half : v + half + 1, u - half : u + half + 1]
        assert painted(about, GROUP_COLOURS[detection.marker.group]).any()
    rows, columns = np.nonzero(painted(drawn, OUTLINE))
    side_px = CAMERA.fx_px * 1.3 / 2.0
    assert np.ptp(columns) == pytest.approx(side_px, rel=0.04)
    assert np.ptp(rows) == pytest.approx(side_px, rel=0.04)
    without = draw(image, Found(found.markers, None), PAD, looking.lens, "text")
    assert painted(without, UNUSED).any()
    assert not painted(without, OUTLINE).any()


def test_a_folder_of_photos_gives_a_line_and_an_overlay_for_each(
    tmp_path: Path, program: ProgramHere
) -> None:
    folder, out = tmp_path / "photos", tmp_path / "seen"
    folder.mkdir()
    for height_m in (1, 4):
        cv2.imwrite(str(folder / f"from_{height_m}_m.png"), picture(height_m))
    cv2.imwrite(str(folder / "other.png"), np.full((480, 640), 120, np.uint8))
    cv2.imwrite(str(folder / "small.png"), np.full((240, 320), 120, np.uint8))
    ended = program("companion", "detect", folder, *OPTIONS, "--out", out)
    assert ended.code == 0
    near, far, other, *rest = ended.out.splitlines()
    for height_m, line in ((1, near), (4, far)):
        assert line.startswith(f"{folder}/from_{height_m}_m.png: ")
        said = re.search(
            r"[FMC] \d+.*: (\d+\.\d+) m away \(std .* mm along, .* mm across\), .* px, \d+ ms", line
        )
        assert said is not None
        assert float(said[1]) == pytest.approx(height_m, rel=0.02)
    assert "no marker of the pad" in other
    assert rest[0] == "left out: 1 of 320x240; the camera's calibration is for 640x480"
    assert rest[1].startswith("pad seen in 2 of 3, 1.0")
    assert {path.name for path in out.iterdir()} == {"from_1_m.png", "from_4_m.png", "other.png"}


def test_a_video_gives_a_video(tmp_path: Path, program: ProgramHere) -> None:
    flight, out = tmp_path / "flight.avi", tmp_path / "seen"
    video = cv2.VideoWriter(str(flight), cv2.VideoWriter.fourcc(*"MJPG"), 15.0, (640, 480))
    for number in range(4):
        video.write(cv2.cvtColor(picture(2.0 - 0.2 * number, seed=number), cv2.COLOR_GRAY2BGR))
    video.release()
    said = program("companion", "detect", flight, *OPTIONS, "--out", out)
    assert said.code == 0
    lines = said.out.splitlines()
    assert [line.partition(":")[0] for line in lines[:4]] == [f"{flight} frame {k}" for k in range(4)]
    written = cv2.VideoCapture(str(out / "flight.mp4"))
    assert written.get(cv2.CAP_PROP_FRAME_COUNT) == 4
    assert written.get(cv2.CAP_PROP_FPS) == pytest.approx(15.0)
    written.release()


def test_photos_of_one_name_do_not_overwrite_each_other(tmp_path: Path, program: ProgramHere) -> None:
    folders = [tmp_path / name for name in ("a", "b")]
    for folder in folders:
        folder.mkdir()
        cv2.imwrite(str(folder / "photo.png"), picture(1.0))
    assert program("companion", "detect", *folders, *OPTIONS, "--out", tmp_path / "seen").code == 0
    assert {path.name for path in (tmp_path / "seen").iterdir()} == {"photo.png", "photo-2.png"}


def test_no_pad_in_any_picture_is_reported_by_the_exit_code(tmp_path: Path, program: ProgramHere) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((480, 640), 120, np.uint8))
    assert program("companion", "detect", tmp_path / "grey.png", *OPTIONS).code == 1


@pytest.mark.parametrize(
    ("size", "words", "text"),
    [
        ((240, 320), OPTIONS, "left out: 1 of 320x240; the camera's calibration is for 640x480"),
        (None, OPTIONS, "not a photo that can be read"),
        ((480, 640), (*OPTIONS, "--out", "photo.png"), "--out photo.png: a file; expected a folder"),
        ((480, 640), ("--pad", "nope"), "pads: no 'nope'; expected the path of a .yaml file or one of"),
        ((480, 640), ("--camera", "nope.yaml"), "cameras: no file 'nope.yaml'; expected"),
        (
            (480, 640),
            ("nope.jpg",),
            "nope.jpg: cannot be read: No such file or directory; expected a photo, a video or a folder",
        ),
    ],
)
def test_what_the_user_can_correct_is_one_line(
    size: tuple[int, int] | None,
    words: tuple[str, ...],
    text: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    program: ProgramHere,
) -> None:
    monkeypatch.chdir(tmp_path)
    photo = b"not one" if size is None else cv2.imencode(".png", np.zeros(size, np.uint8))[1].tobytes()
    Path("photo.png").write_bytes(photo)
    assert text in program("companion", "detect", "photo.png", *words).refusal
