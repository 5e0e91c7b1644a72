"""`calibrate-camera`: its options and help. Images of a printed board in, the camera's file for the app out.

Exit codes: as in `calibration.command_line`.
"""

from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from calibration.camera import DEFAULT_BOARD, NAME, Model, Pattern
from calibration.command_line import ForceOption, PlotsOption, run
from companion.base.command_line import ServeOption, VersionOption, new_app
from companion.base.errors import ConfigError
from companion.base.files import must_exist

LIVE_SIZE_PX: Final = (1280, 720)
HELP: Final = """Calibrate a camera with a printed board: focal length, principal point, distortion.

SOURCE is a camera (v4l2:0, picamera2:0, socket:/run/companion/frames), or photos and videos: folders
or files. Live, hold the board in front of the camera. The program says what to show next and stops by
itself. It refuses a calibration that is not good enough to fly with, and says why.

\b
calibrate-camera --make-board board.pdf
calibrate-camera v4l2:0 --board board.yaml --size 1280x720 --keep frames \\
    --serve 8081 -o mine.yaml
calibrate-camera frames -o mine.yaml --plots plots
calibrate-camera photos --board 9x6 --pattern chessboard --square-mm 25 \\
    --model rational -o mine.yaml
"""

app = new_app()


@app.command(help=HELP)
def command(
    sources: Annotated[
        list[str] | None, typer.Argument(metavar="SOURCE", help="A camera, or photos.", show_default=False)
    ] = None,
    *,
    board: Annotated[
        str | None,
        typer.Option(
            "--board",
            help="The board's YAML file, a name in configs/boards, or COLUMNSxROWS (ChArUco: squares, grid: "
            "markers, chessboard: inner corners). Default: board.yaml beside the photos, else "
            f"{DEFAULT_BOARD}.",
        ),
    ] = None,
    pattern: Annotated[
        Pattern | None, typer.Option("--pattern", help="Kind of board, with COLUMNSxROWS. Default: charuco.")
    ] = None,
    square_mm: Annotated[
        float | None, typer.Option("--square-mm", help="Side of a square, in mm.", min=1.0)
    ] = None,
    marker_mm: Annotated[
        float | None, typer.Option("--marker-mm", help="Side of a marker, in mm.", min=1.0)
    ] = None,
    gap_mm: Annotated[
        float | None, typer.Option("--gap-mm", help="Gap between the markers of a grid, in mm.", min=0.1)
    ] = None,
    dictionary: Annotated[
        str | None,
        typer.Option("--dictionary", help="Marker dictionary: 5x5_100, ..., or a file in OpenCV's format."),
    ] = None,
    legacy_pattern: Annotated[
        bool, typer.Option("--legacy-pattern", help="ChArUco board drawn by OpenCV before 4.6.")
    ] = False,
    make_board: Annotated[
        Path | None,
        typer.Option(
            "--make-board", help="Write the board as a PDF, with its YAML file, and exit.", metavar="PDF"
        ),
    ] = None,
    paper: Annotated[
        Literal["a4", "a3", "letter"], typer.Option("--paper", help="Paper size for --make-board.")
    ] = "a4",
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Camera file to write, for the app.", metavar="YAML")
    ] = Path("camera.yaml"),
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the camera. Default: the file name.")
    ] = None,
    size: Annotated[
        str | None, typer.Option("--size", help="Image size of a live camera. Default: 1280x720.")
    ] = None,
    rate: Annotated[float, typer.Option("--rate", help="Frames per second, also for the app.")] = 30.0,
    exposure_ms: Annotated[
        float, typer.Option("--exposure-ms", help="Exposure time in ms, also for the app.")
    ] = 4.0,
    readout_ms: Annotated[
        float, typer.Option("--readout-ms", help="Readout time, first to last row, in ms. 0: global shutter.")
    ] = 0.0,
    gain: Annotated[
        float | None, typer.Option("--gain", help="Fixed gain, also for the app. Default: automatic gain.")
    ] = None,
    focus: Annotated[
        float | None, typer.Option("--focus", help="Fixed focus of an autofocus lens, also for the app.")
    ] = None,
    sensor_mode: Annotated[
        str | None,
        typer.Option(
            "--sensor-mode", help="Sensor mode of a Raspberry Pi camera, also for the app: 1640x1232, ..."
        ),
    ] = None,
    pixel_format: Annotated[
        str | None,
        typer.Option("--pixel-format", help="Pixel format of a V4L2 camera, also for the app: MJPG, ..."),
    ] = None,
    model: Annotated[
        Model,
        typer.Option(
            "--model",
            help="Distortion model. brown: k1 k2 p1 p2 k3; rational: 8 numbers, for wide lenses; "
            "fisheye: k1 k2 k3 k4.",
        ),
    ] = "brown",
    views: Annotated[int, typer.Option("--views", help="Live: maximum number of views.", min=4)] = 60,
    keep: Annotated[
        Path | None, typer.Option("--keep", help="Save the frames used in this folder.", metavar="DIR")
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option("--overlay", help="Live: write the preview to this file every second.", metavar="PNG"),
    ] = None,
    serve: ServeOption = None,
    plots: PlotsOption = None,
    force: ForceOption = False,
    version: VersionOption = False,
) -> None:
    """Print a board, or calibrate."""
    given = sources or []
    for source in given:
        if ":" not in source:  # which cameras have
            must_exist(Path(source), "expected a camera, a folder of photos, a photo or a video")
    # OpenCV is imported once the photos are there
    from calibration.camera.board import read_dictionary  # noqa: PLC0415
    from calibration.camera.capture import CameraCalibrationJob  # noqa: PLC0415
    from calibration.camera.gathering import choose_board, two_numbers  # noqa: PLC0415
    from calibration.camera.job import calibrate_camera, print_board  # noqa: PLC0415
    from companion.config import CaptureConfig, validate  # noqa: PLC0415
    from companion.sense.vision.opencv import prepare_opencv  # noqa: PLC0415

    prepare_opencv()
    shown = choose_board(
        board,
        given,
        pattern=pattern,
        square_m=_metres(square_mm),
        marker_m=_metres(marker_mm),
        gap_m=_metres(gap_mm),
        dictionary=None if dictionary is None else read_dictionary(dictionary),
        legacy_pattern=legacy_pattern or None,
    )
    if make_board is not None:
        print_board(shown, make_board, paper)
        return
    if not given:
        raise ConfigError("SOURCE: expected a camera (v4l2:0) or photos; or --make-board")
    width, height = LIVE_SIZE_PX if size is None else two_numbers(size, "--size")
    values = {
        "name": name or output.stem,
        "width_px": width,
        "height_px": height,
        "rate_hz": rate,
        "exposure_s": 1e-3 * exposure_ms,
        "readout_s": 1e-3 * readout_ms,
        "gain": gain,
        "focus": focus,
        "sensor_mode_px": None if sensor_mode is None else two_numbers(sensor_mode, "--sensor-mode"),
        "pixel_format": pixel_format,
    }
    capture = validate(CaptureConfig, values, "the options")
    sized = size is not None
    job = CameraCalibrationJob(
        given, capture, sized, model, views, output, keep, overlay, serve, plots, force=force
    )
    calibrate_camera(job, shown)


def _metres(millimetres: float | None) -> float | None:
    return None if millimetres is None else 1e-3 * millimetres


def main() -> None:
    run(app, NAME)


if __name__ == "__main__":
    main()
