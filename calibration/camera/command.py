"""`calibrate-camera`: a printed board held before the camera; the camera's file for the app comes out.

Exit codes: as in `calibration.command_line`.
"""

from __future__ import annotations

import asyncio
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import cv2
import typer

from calibration.camera.adjustment import Model, UnsolvableError
from calibration.camera.board import Board, Pattern, read_dictionary
from calibration.camera.capture import CaptureSession
from calibration.camera.detection import BoardFinder, View
from calibration.camera.images import Photo, photo_paths, read_photos
from calibration.camera.live import LiveOptions, capture_live, write_image
from calibration.camera.printing import board_yaml, write_board
from calibration.camera.quality import Assessment, assess
from calibration.camera.result import Origin, camera_config, camera_yaml, summary_lines
from calibration.command_line import RefusedError, run
from companion.clock import start_unix_s
from companion.config import CaptureConfig, ConfigError, find_file, load_model, validate
from companion.files import write_atomically

NAME: Final = "calibrate-camera"
DEFAULT_BOARD: Final = "charuco_a4"
# what a folder of kept frames holds beside them
BOARD_FILE: Final = "board.yaml"
CAMERA: Final = re.compile(r"v4l2:\d+|socket:.+|tcp:.+")
# more cost time and tell nothing new
MOST_VIEWS: Final = 120
SAMPLES: Final = 4
HELP: Final = """Calibrate a camera with a printed board: focal length, principal point, distortion.

SOURCE is a camera (v4l2:0, socket:/run/companion/frames, tcp:127.0.0.1:5600), or photos and videos: folders
or files. Live, the board is held before the camera until the program stops by itself; it says what to show
next. What is not good enough to fly by is refused, with the reasons.

\b
calibrate-camera --make-board board.pdf
calibrate-camera v4l2:0 --board board.yaml --size 1280x720 --keep frames --serve 8081 -o mine.yaml
calibrate-camera frames -o mine.yaml --plots plots
calibrate-camera photos --board 9x6 --pattern chessboard --square-mm 25 --model rational -o mine.yaml
"""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@dataclass(frozen=True, slots=True)
class Found:
    """The views that were found, in images of one size, and where they came from."""

    views: list[View]
    size_px: tuple[int, int]
    source: str


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
    width, height = (1280, 720) if size is None else _two_numbers(size, "--size")
    capture = validate(
        CaptureConfig,
        {
            "name": name or output.stem,
            "width_px": width,
            "height_px": height,
            "rate_hz": rate,
            "exposure_s": 1e-3 * exposure_ms,
            "readout_s": 1e-3 * readout_ms,
        },
        NAME,
    )
    if any(CAMERA.fullmatch(source) for source in sources):
        if len(sources) > 1:
            raise ConfigError(f"{' '.join(sources)}: expected one camera alone, or photos")
        options = LiveOptions(sources[0], capture, views, model, keep, overlay, serve)
        found = _live(chosen, options)
    else:
        if size is not None:
            raise ConfigError("--size: belongs to a live camera; photos have theirs")
        found = _from_photos(chosen, [Path(s) for s in sources], keep)
        sized = {"width_px": found.size_px[0], "height_px": found.size_px[1]}
        capture = validate(CaptureConfig, {**capture.model_dump(), **sized}, found.source)
    finish(found, chosen, capture, model, output, plots, force=force)


def finish(
    found: Found,
    board: Board,
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
        result = assess(found.views, found.size_px, board.size_m, model)
    except UnsolvableError as error:
        raise RefusedError(f"{found.source}: {error}") from error
    for line in summary_lines(result):
        typer.echo(line)
    if plots is not None:
        from calibration.camera.plots import write_plots  # noqa: PLC0415 - matplotlib is slow

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


# ---------------------------------------------------------------- the board


def choose_board(words: str | None, given: dict[str, Any], sources: Sequence[str]) -> Board:
    """The board that is meant.

    Raises:
        ConfigError: there is none of that name, or it cannot be.
    """
    if words is not None and re.fullmatch(r"\d+\s*[xX*]\s*\d+", words):
        columns, rows = _two_numbers(words, "--board")
        needed = {"charuco": ("square_m", "marker_m"), "grid": ("marker_m", "gap_m")}
        for key in needed.get(given.get("pattern", "charuco"), ("square_m",)):
            if key not in given:
                option = f"--{key.removesuffix('_m')}-mm"
                raise ConfigError(f"--board {words}: needs {option}, as measured on the print")
        return validate(Board, {"columns": columns, "rows": rows, **given}, f"--board {words}")
    beside = [Path(s) / BOARD_FILE for s in sources if (Path(s) / BOARD_FILE).is_file()]
    alone = words is None and len(beside) == 1
    path = beside[0] if alone else find_file("boards", words or DEFAULT_BOARD)
    board = load_model(Board, path)
    return validate(Board, {**board.model_dump(), **given}, str(path)) if given else board


def near_misses(board: Board) -> list[tuple[str, Board]]:
    """Boards that are easily taken for this one, and how to ask for them."""
    others: list[tuple[str, dict[str, Any]]] = [
        (f"--board {board.rows}x{board.columns}", {"columns": board.rows, "rows": board.columns})
    ]
    if board.pattern == "charuco":
        legacy = not board.legacy_pattern
        words = "--legacy-pattern" if legacy else "no --legacy-pattern"
        others.append((words, {"legacy_pattern": legacy}))
        others.append((f"{others[0][0]} and {words}", {**others[0][1], "legacy_pattern": legacy}))
    if board.pattern == "chessboard" and min(board.columns, board.rows) > 2:
        less = {"columns": board.columns - 1, "rows": board.rows - 1}
        others.append((f"--board {less['columns']}x{less['rows']} (inner corners)", less))
    return [(words, Board.model_validate({**board.model_dump(), **change})) for words, change in others]


# ---------------------------------------------------------------- where views come from


def _live(board: Board, options: LiveOptions) -> Found:
    if options.keep is not None:
        write_atomically(options.keep / BOARD_FILE, board_yaml(board))
    typer.echo(f"looking for {board.text}")
    session = asyncio.run(capture_live(board, options, typer.echo))
    return Found(session.views, session.size_px, options.source)


def _from_photos(board: Board, sources: Sequence[Path], keep: Path | None) -> Found:
    paths = photo_paths(sources)
    finder = BoardFinder(board)
    sessions: dict[tuple[int, int], CaptureSession] = {}
    found: list[tuple[View, tuple[int, int]]] = []
    samples: list[Photo] = []
    without: list[str] = []
    count = 0
    for photo in read_photos(paths):
        count += 1
        view = finder.find(photo.image, photo.name)
        if photo.time_s is None:
            samples += [photo] if len(samples) < SAMPLES else []
            without += [photo.name] if view is None else []
        else:
            session = sessions.setdefault(photo.size_px, CaptureSession(photo.size_px))
            view = view if session.step(photo.time_s, view).kept else None
            samples += [photo] if len(samples) < SAMPLES and count % 30 == 1 else []
        if view is None:
            continue
        found.append((view, photo.size_px))
        if keep is not None:
            write_image(keep / f"view-{len(found):04d}.png", photo.image)
    if keep is not None:
        write_atomically(keep / BOARD_FILE, board_yaml(board))
    source = ", ".join(map(str, sources))
    if not found:
        raise ConfigError(f"{source}: {_why_nothing(board, samples, count, moving=bool(sessions))}")
    if without:
        typer.echo(f"no board, or too little of it, in {len(without)} of {count}: {', '.join(without)}")
    return _of_one_size(found, source)


def _why_nothing(board: Board, samples: Sequence[Photo], count: int, *, moving: bool) -> str:
    for words, other in near_misses(board):
        finder = BoardFinder(other)
        if any(finder.find(photo.image) is not None for photo in samples):
            return f"no board as described in {count} images; found it with {words}"
    more = ", sharp and held still for a moment" if moving else ""
    return f"no board found in {count} images; expected {board.text}{more}"


def _of_one_size(found: list[tuple[View, tuple[int, int]]], source: str) -> Found:
    """The views of the most usual size; a calibration is of one."""
    sizes = Counter(size for _, size in found)
    size, count = sizes.most_common(1)[0]
    for view, other in found:
        if other != size:
            told = f"{other[0]}x{other[1]}, expected the {size[0]}x{size[1]} of {count} others"
            typer.echo(f"{view.name}: left out: images of {told}")
    views = [view for view, other in found if other == size]
    if len(views) > MOST_VIEWS:
        typer.echo(f"{len(views)} views: every {len(views) / MOST_VIEWS:.1f}th is used")
        views = [views[k * len(views) // MOST_VIEWS] for k in range(MOST_VIEWS)]
    return Found(views, size, source)


# ---------------------------------------------------------------- words


def _two_numbers(words: str, option: str) -> tuple[int, int]:
    form = re.fullmatch(r"(\d{1,5})\s*[xX*]\s*(\d{1,5})", words)
    if form is None:
        raise ConfigError(f"{option} {words}: expected two numbers, as in 1280x720 or 7x5")
    return int(form[1]), int(form[2])


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
    if any(folder.iterdir()):
        raise ConfigError(f"{option} {folder}: holds files already; expected a new or empty folder")


def main() -> None:
    """Entry point."""
    run(app, NAME)


if __name__ == "__main__":
    main()
