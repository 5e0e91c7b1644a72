"""`calibrate-camera` as a person runs it: from photos, from a live camera, and what it refuses."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from calibration.camera.board import CalibrationBoard, board_yaml
from companion.base.messages import Frame
from companion.config import CONFIG_FOLDER, CameraConfig, ConfigError, find_file, load_model
from companion.sense.camera.source import open_camera
from sitl.devices.socket_servers import FrameServer
from tests.programs import exit_code
from tests.unit.calibration.camera.board_pictures import BoardPainter, hand_held_poses, tour_poses

CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
BOARD = load_model(CalibrationBoard, find_file("boards", "charuco_a4"))
CHESSBOARD = CalibrationBoard(pattern="chessboard", columns=6, rows=4, square_m=0.034)
PHOTOS = CONFIG_FOLDER.parent.parent / "shared" / "data" / "aruco"
FRAMES_A_POSE = 7
ended = partial(exit_code, "calibrate-camera")


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    """The default board, led all over a camera of 640x480."""
    painter, rng = BoardPainter(BOARD, CAMERA), np.random.default_rng(5)
    poses = tour_poses(BOARD, CAMERA, width_share=0.55) + hand_held_poses(BOARD, CAMERA, 5, rng)
    return [painter.take(pose, rng, noise_grey=2.0, defocus_px=0.5) for pose in poses]


@pytest.fixture(scope="module")
def photos(pictures: list[np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for number, image in enumerate(pictures):
        cv2.imwrite(str(folder / f"img_{number}.png"), image)
    return folder


def told(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error."""
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    return text


def test_photos_in_camera_file_and_plots_out(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "mine.yaml"
    assert (
        ended(photos, "-o", output, "--plots", tmp_path / "plots", "--rate", "25", "--readout-ms", "12") == 0
    )
    camera = load_model(CameraConfig, output)
    assert (camera.name, camera.width_px, camera.height_px) == ("mine", 640, 480)
    assert (camera.rate_hz, camera.readout_s) == (25.0, 0.012)
    assert camera.fx_px == pytest.approx(CAMERA.fx_px, rel=2e-3)
    assert camera.cx_px == pytest.approx(CAMERA.cx_px, abs=1.0)
    assert len(camera.distortion) == 5
    stated = camera.calibration
    assert stated is not None
    assert stated.provenance.samples + stated.provenance.dropped == 20
    assert stated.verdict == ()
    assert stated.rms_px < 0.1
    assert abs(camera.fx_px - CAMERA.fx_px) < 4.0 * stated.fx_std_px
    assert {path.name for path in (tmp_path / "plots").iterdir()} == {
        "errors.png",
        "coverage.png",
        "poses.png",
    }
    assert "good; name it in the app's settings" in capsys.readouterr().out


def test_plots_that_cannot_be_drawn_do_not_cost_the_camera_file(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plots" / "poses.png").mkdir(parents=True)
    assert ended(photos, "-o", tmp_path / "mine.yaml", "--plots", tmp_path / "plots") == 2
    assert "poses.png: cannot be written" in told(capsys)
    assert load_model(CameraConfig, tmp_path / "mine.yaml").calibration is not None


def test_the_written_camera_refuses_images_of_another_size(photos: Path, tmp_path: Path) -> None:
    assert ended(photos, "-o", tmp_path / "mine.yaml") == 0
    camera = load_model(CameraConfig, tmp_path / "mine.yaml")

    async def look() -> None:
        async with serving([np.zeros((720, 1280), np.uint8)]) as server:
            source = await open_camera(server.address, camera)
            with pytest.raises(ConfigError, match="images of 1280x720, expected the calibration's 640x480"):
                await asyncio.wait_for(source.next(), 5.0)
            source.close()

    asyncio.run(look())


def test_too_few_photos_are_refused_and_written_by_force_alone(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = [photos / f"img_{k}.png" for k in (0, 4, 8, 10)]
    output = tmp_path / "mine.yaml"
    assert ended(*few, "-o", output) == 1
    assert "refused: too few views: 4, expected 8 or more" in told(capsys)
    assert not output.exists()
    assert ended(*few, "-o", output, "--force") == 0
    camera = load_model(CameraConfig, output)
    assert camera.calibration is not None
    assert "too few views: 4, expected 8 or more" in camera.calibration.verdict
    assert output.read_text().startswith("# NOT GOOD ENOUGH")


def test_a_chessboard_and_a_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    painter, rng = BoardPainter(CHESSBOARD, CAMERA), np.random.default_rng(8)
    video = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (640, 480))
    if not video.isOpened():
        pytest.skip("this OpenCV writes no videos")
    for pose in hand_held_poses(CHESSBOARD, CAMERA, 8, rng, 30.0):
        image = cv2.cvtColor(painter.take(pose, rng, noise_grey=2.0, defocus_px=0.5), cv2.COLOR_GRAY2BGR)
        for _ in range(FRAMES_A_POSE):
            video.write(image)
    video.release()
    words = ("--board", "6x4", "--pattern", "chessboard", "--square-mm", "34", "--force")
    kept = tmp_path / "kept"
    assert ended(tmp_path / "film.avi", *words, "-o", tmp_path / "film.yaml", "--keep", kept) == 0
    capsys.readouterr()
    stated = load_model(CameraConfig, tmp_path / "film.yaml").calibration
    assert stated is not None
    frames = sorted(kept.glob("*.png"))
    # one of each pose at most, and the same again from the frames that were kept
    assert 4 <= len(frames) <= 8
    assert ended(kept, "-o", tmp_path / "again.yaml", "--force") == 0
    again = load_model(CameraConfig, tmp_path / "again.yaml").calibration
    assert again is not None
    assert again.board == stated.board
    assert again.rms_px == pytest.approx(stated.rms_px, abs=1e-3)


# ---------------------------------------------------------------- live


@asynccontextmanager
async def serving(images: list[np.ndarray], rate_hz: float = 30.0) -> AsyncIterator[FrameServer]:
    """A camera that shows each image for a while, over and over."""
    server = FrameServer(0)
    await server.start()

    async def film() -> None:
        loop, number = asyncio.get_running_loop(), 0
        while True:
            image = images[number // FRAMES_A_POSE % len(images)]
            server.deliver(Frame(loop.time(), loop.time(), number, image))
            # nobody watches: the board waits for them
            number += 1 if server.client_count else 0
            await asyncio.sleep(1.0 / rate_hz)

    task = asyncio.create_task(film())
    try:
        yield server
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await server.close()


async def test_live_it_captures_by_itself_and_stops_by_itself(
    pictures: list[np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, kept, overlay = tmp_path / "live.yaml", tmp_path / "kept", tmp_path / "overlay.png"
    async with serving(pictures) as server:
        words = (server.address, "--size", "640x480", "-o", output, "--keep", kept, "--overlay", overlay)
        code = await asyncio.to_thread(ended, *words, "--serve", "0")
    said = capsys.readouterr().out
    assert code == 0
    assert "view 1 kept; show it at the" in said
    assert "picture at http://127.0.0.1:" in said
    camera = load_model(CameraConfig, output)
    assert camera.fx_px == pytest.approx(CAMERA.fx_px, rel=3e-3)
    picture = cv2.imread(str(overlay))
    assert picture is not None
    assert picture.shape == (480, 640, 3)
    frames = sorted(path.name for path in kept.iterdir())
    assert frames[0] == "board.yaml"
    assert 15 <= len(frames) - 1 <= 60
    assert ended(kept, "-o", tmp_path / "again.yaml") == 0
    again = load_model(CameraConfig, tmp_path / "again.yaml")
    assert again.fx_px == camera.fx_px


async def test_live_images_of_another_size_are_reported(
    pictures: list[np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async with serving(pictures) as server:
        code = await asyncio.to_thread(ended, server.address, "-o", tmp_path / "live.yaml")
    assert code == 2
    assert "images of 640x480, expected the size asked for, 1280x720" in told(capsys)


# ---------------------------------------------------------------- what a user can get wrong


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "SOURCE: expected a camera"),
        (("nowhere",), "nowhere: cannot be read: No such file or directory; expected a camera, a folder"),
        (("{empty}",), "holds no photos or videos"),
        (("{text}",), "not a photo that can be read"),
        (
            ("{photos}", "--board", "5x7", "--square-mm", "34", "--marker-mm", "25"),
            "found it with --board 7x5",
        ),
        (("{photos}", "--board", "7x5"), "needs --square-mm"),
        (("{photos}", "--board", "nowhere"), "boards: no 'nowhere'; expected the path"),
        (("{photos}", "--dictionary", "7x7_17"), "--dictionary '7x7_17'"),
        (("{photos}", "--dictionary", "4x4_50"), "no board found in 20 images"),
        (("{photos}", "--size", "640x480"), "--size: only for a live camera"),
        (("v4l2:0", "{photos}"), "expected one camera alone"),
        (("v4l2:77",), "no camera at /dev/video77"),
        (("tcp:127.0.0.1:1",), "expected a program that serves frames"),
        (
            ("{photos}", "-o", "nowhere/x.yaml"),
            "--output nowhere/x.yaml: expected a .yaml file in an existing folder",
        ),
        (("{photos}", "-o", "{text}"), "--output {text}: expected a .yaml file"),
        (("{photos}", "--rate", "1"), "calibrate-camera: the options: rate_hz: expected"),
        (("{photos}", "--plots", "{text}"), "--plots {text}: cannot be made: File exists"),
        (("{photos}", "--keep", "{photos}"), "holds files already"),
        (("{photos}", "--model", "fish"), "'fish' is not one of 'brown', 'rational', 'fisheye'"),
        (("--make-board", "x.pdf", "--square-mm", "60", "--marker-mm", "40"), "does not fit"),
    ],
)
def test_what_is_wrong_is_reported_in_one_line(
    words: tuple[str, ...],
    says: str,
    photos: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.jpg").write_text("a letter")
    places = {"photos": photos, "empty": tmp_path / "empty", "text": tmp_path / "text.jpg"}
    before = sorted(tmp_path.iterdir())
    assert ended(*(word.format(**places) for word in words)) == 2
    assert says.format(**places) in told(capsys)
    assert sorted(tmp_path.iterdir()) == before


def test_photos_of_another_size_are_left_out(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "mixed"
    folder.mkdir()
    for path in photos.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    small = cv2.imread(str(photos / "img_7.png"), cv2.IMREAD_GRAYSCALE)
    assert small is not None
    cv2.imwrite(str(folder / "small.png"), cv2.resize(small, (480, 360), interpolation=cv2.INTER_AREA))
    (folder / "board.yaml").write_text(board_yaml(BOARD))
    assert ended(folder, "-o", tmp_path / "mine.yaml") == 0
    assert (
        "small.png: left out: images of 480x360, expected the 640x480 of 20 others" in capsys.readouterr().out
    )


# ---------------------------------------------------------------- photos that nobody here made


@pytest.mark.parametrize(
    ("names", "board", "rms_px"),
    [
        (
            ("choriginal.jpg", "chocclusion_original.jpg"),
            ("--board", "5x7", "--square-mm", "40", "--marker-mm", "20", "--dictionary", "6x6_250"),
            0.2,
        ),
        (
            ("gboriginal.jpg", "gbocclusion.jpg"),
            ("--pattern", "grid", "--board", "5x7", "--marker-mm", "40", "--gap-mm", "10"),
            4.0,
        ),
    ],
)
def test_two_photos_of_opencv_s_tutorial_are_no_calibration(
    names: tuple[str, ...], board: tuple[str, ...], rms_px: float, tmp_path: Path, capsys: Any
) -> None:
    if not PHOTOS.exists():
        pytest.skip(f"{PHOTOS} is not there: OpenCV's tutorial photos, not part of the project")
    own = () if "--dictionary" in board else ("--dictionary", PHOTOS / "tutorial_dict.yml")
    words = (*(PHOTOS / name for name in names), *board, *own, "-o", tmp_path / "mine.yaml")
    assert ended(*words) == 1
    assert "too few views: 2" in told(capsys)
    assert ended(*words, "--force") == 0
    data = yaml.safe_load((tmp_path / "mine.yaml").read_text())
    assert data["calibration"]["rms_px"] < rms_px
