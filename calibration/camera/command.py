"""`calibrate-camera`: a printed board held before the camera; the camera's file for the app comes out.

Exit codes: as in `calibration.command_line`.
"""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated, Final, Literal

import cv2
import typer

from calibration.camera.board.board import CalibrationBoard, Pattern, read_dictionary
from calibration.camera.board.printing import board_yaml, write_board
from calibration.camera.collect.gathering import (
    BOARD_FILE,
    DEFAULT_BOARD,
    CollectedViews,
    choose_board,
    two_numbers,
    views_of_photos,
)
from calibration.camera.collect.live import LiveOptions, capture_live
from calibration.camera.report.result import Origin, camera_config, camera_yaml, summary_lines
from calibration.camera.solve.adjustment import Model, UnsolvableError
from calibration.camera.solve.quality import Assessment, assess
from calibration.command_line import RefusedError, run
from companion.base.clock import start_unix_s
from companion.base.files import write_atomically
from companion.config import CaptureConfig, ConfigError, validate
from companion.sense.camera.source import is_camera

NAME: Final = "calibrate-camera"
HELP: Final = """Calibrate a camera with a printed board: focal length, principal point, distortion.

SOURCE is a camera (v4l2:0, picamera2:0, socket:/run/companion/frames), or photos and videos: folders
or files. Live, the board is held before the camera until the program stops by itself; it says what to show
next. What is not good enough to fly by is refused, with the reasons.

\b
calibrate-camera --make-board board.pdf
calibrate-camera v4l2:0 --board board.yaml --size 1280x720 --keep frames --serve 8081 -o mine.yaml
calibrate-camera frames -o mine.yaml --plots plots
calibrate-camera photos --board 9x6 --pattern chessboard --square-mm 25 --model rational -o mine.yaml
"""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command(help=HELP)
def calibrate_camera(
    sources: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SOURCE]...", help="A camera, or photos.", show_default=False),
    ] = None,
    *,
    board: Annotated[
        str | None,
        typer.Option(
            "--board",
            help="Its YAML, a name in configs/boards, or COLUMNSxROWS: squares of ChArUco, markers of "
            f"a grid, inner corners of a chessboard. Else board.yaml by the photos, else {DEFAULT_BOARD}.",
        ),
    ] = None,
    pattern: Annotated[
        Pattern | None, typer.Option("--pattern", help="With COLUMNSxROWS; else charuco.")
    ] = None,
    square_mm: Annotated[float | None, typer.Option("--square-mm", help="Side of a square.", min=1.0)] = None,
    marker_mm: Annotated[float | None, typer.Option("--marker-mm", help="Side of a marker.", min=1.0)] = None,
    gap_mm: Annotated[
        float | None, typer.Option("--gap-mm", help="Between the markers of a grid.", min=0.1)
    ] = None,
    dictionary: Annotated[
        str | None, typer.Option("--dictionary", help="Of the markers: 5x5_100, ..., or OpenCV's file.")
    ] = None,
    legacy_pattern: Annotated[
        bool, typer.Option("--legacy-pattern", help="A ChArUco board drawn by OpenCV before 4.6.")
    ] = False,
    make_board: Annotated[
        Path | None,
        typer.Option("--make-board", help="Make the print, and its YAML, and end.", metavar="PDF"),
    ] = None,
    paper: Annotated[Literal["a4", "a3", "letter"], typer.Option("--paper", help="To print on.")] = "a4",
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The camera's file for the app.", metavar="YAML")
    ] = Path("camera.yaml"),
    name: Annotated[str | None, typer.Option("--name", help="The camera's name; else the file's.")] = None,
    size: Annotated[str | None, typer.Option("--size", help="Of a camera's images; else 1280x720.")] = None,
    rate: Annotated[float, typer.Option("--rate", help="Frames a second, for the app too.")] = 30.0,
    exposure_ms: Annotated[float, typer.Option("--exposure-ms", help="Of a frame, for the app too.")] = 4.0,
    readout_ms: Annotated[
        float, typer.Option("--readout-ms", help="First to last row, for the app; 0: a global shutter.")
    ] = 0.0,
    gain: Annotated[
        float | None, typer.Option("--gain", help="Fixed, for the app too; else the camera's own.")
    ] = None,
    focus: Annotated[
        float | None, typer.Option("--focus", help="Of a lens that moves, for the app too.")
    ] = None,
    sensor_mode: Annotated[
        str | None,
        typer.Option("--sensor-mode", help="Of a Raspberry Pi camera, for the app too: 1640x1232, ..."),
    ] = None,
    pixel_format: Annotated[
        str | None, typer.Option("--pixel-format", help="Of a V4L2 camera, for the app too: MJPG, ...")
    ] = None,
    model: Annotated[
        Model,
        typer.Option("--model", help="Of the distortion: k1 k2 p1 p2 k3, or 8 numbers for wide lenses."),
    ] = "brown",
    views: Annotated[int, typer.Option("--views", help="Take at most so many live.", min=4)] = 60,
    keep: Annotated[
        Path | None, typer.Option("--keep", help="Leave the frames used in this folder.", metavar="DIR")
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option("--overlay", help="Write the live picture here every second.", metavar="PNG"),
    ] = None,
    serve: Annotated[
        int | None, typer.Option("--serve", help="Live picture for a browser: the port.", min=0, max=65535)
    ] = None,
    plots: Annotated[Path | None, typer.Option("--plots", help="Draw plots here.", metavar="DIR")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write the file even when it is refused; it says so in it.")
    ] = False,
) -> None:
    """Make a board, or calibrate.

    Raises:
        ConfigError: something the user can mend.
        RefusedError: the calibration is not good enough.
    """
    cv2.setNumThreads(1)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    given = {
        "pattern": pattern,
        "square_m": None if square_mm is None else 1e-3 * square_mm,
        "marker_m": None if marker_mm is None else 1e-3 * marker_mm,
        "gap_m": None if gap_mm is None else 1e-3 * gap_mm,
        "dictionary": None if dictionary is None else read_dictionary(dictionary),
        "legacy_pattern": legacy_pattern or None,
    }
    chosen = choose_board(board, {k: v for k, v in given.items() if v is not None}, sources or [])
    if make_board is not None:
        for path in write_board(chosen, _checked(make_board, "--make-board"), paper):
            typer.echo(f"{path}: {chosen.text}")
        return
    if not sources:
        raise ConfigError("SOURCE: expected a camera (v4l2:0) or photos; or --make-board")
    _checked(output, "--output")
    _make_folder(keep, "--keep")
    width, height = (1280, 720) if size is None else two_numbers(size, "--size")
    capture = validate(
        CaptureConfig,
        {
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
        },
        NAME,
    )
    if any(is_camera(source) for source in sources):
        if len(sources) > 1:
            raise ConfigError(f"{' '.join(sources)}: expected one camera alone, or photos")
        options = LiveOptions(sources[0], capture, views, model, keep, overlay, serve)
        found = _live(chosen, options)
    else:
        if size is not None:
            raise ConfigError("--size: belongs to a live camera; photos have theirs")
        found = views_of_photos(chosen, [Path(s) for s in sources], keep, typer.echo)
        sized = {"width_px": found.size_px[0], "height_px": found.size_px[1]}
        capture = validate(CaptureConfig, {**capture.model_dump(), **sized}, found.source)
    finish(found, chosen, capture, model, output, plots, force=force)


def finish(
    found: CollectedViews,
    board: CalibrationBoard,
    capture: CaptureConfig,
    model: Model,
    output: Path,
    plots: Path | None,
    *,
    force: bool,
) -> None:
    """Calibrate from views, show the result, judge and write it.

    Raises:
        RefusedError: it is not good enough, and force is not used.
        ConfigError: a file cannot be written.
    """
    try:
        result = assess(found.views, found.size_px, board.surface, model)
    except UnsolvableError as error:
        raise RefusedError(f"{found.source}: {error}") from error
    for line in summary_lines(result):
        typer.echo(line)
    if plots is not None:
        from calibration.camera.report.plots import write_plots  # noqa: PLC0415 - matplotlib is slow

        write_plots(plots, result, board)
        typer.echo(f"plots in {plots}")
    if result.reasons and not force:
        raise RefusedError("; ".join(result.reasons))
    camera = camera_config(result, board, capture, _origin(found.source))
    write_atomically(output, camera_yaml(camera))
    for reason in result.reasons:
        typer.echo(f"not good enough: {reason}")
    typer.echo(_verdict(result, output))


def _verdict(result: Assessment, output: Path) -> str:
    if result.reasons:
        return f"{output}: written by force"
    return f"{output}: good; name it in the app's settings: camera: {output}"


def _origin(source: str) -> Origin:
    date = datetime.fromtimestamp(start_unix_s(virtual=True), UTC).isoformat(timespec="seconds")
    try:
        version = metadata.version("companion")
    except metadata.PackageNotFoundError:
        version = "unknown"
    return Origin(f"{NAME} {version}", source, date)


# ---------------------------------------------------------------- where views come from


def _live(board: CalibrationBoard, options: LiveOptions) -> CollectedViews:
    if options.keep is not None:
        write_atomically(options.keep / BOARD_FILE, board_yaml(board))
    typer.echo(f"looking for {board.text}")
    session = asyncio.run(capture_live(board, options, typer.echo))
    return CollectedViews(session.views, session.size_px, options.source)


# ---------------------------------------------------------------- words


def _checked(path: Path, option: str) -> Path:
    """Make sure before the work that its result can be written after it."""
    if path.is_dir() or not path.parent.is_dir():
        raise ConfigError(f"{option} {path}: expected a file in an existing folder")
    return path


def _make_folder(folder: Path | None, option: str) -> None:
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{option} {folder}: cannot be made: {error.strerror}") from error
    # a try that took no picture has left its board there
    if any(path.name != BOARD_FILE for path in folder.iterdir()):
        raise ConfigError(f"{option} {folder}: holds files already; expected a new or empty folder")


def main() -> None:
    """Entry point."""
    run(app, NAME)


if __name__ == "__main__":
    main()
