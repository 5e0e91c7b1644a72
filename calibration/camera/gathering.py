"""Gathers the views of a board from photos and videos, and the board itself from what a user says of it."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calibration.camera.board import CalibrationBoard, board_yaml
from calibration.camera.capture import CaptureSession, write_image
from calibration.camera.kinds import DEFAULT_BOARD
from calibration.camera.mismatch import hint, what_is_seen
from calibration.camera.solver import FEWEST_VIEWS
from calibration.camera.views import BoardFinder, BoardView
from companion.base.files import write_atomically
from companion.config import ConfigError, find_file, load_model, validate
from companion.sense.camera.photos import Photo, photo_paths, read_photos

# what a folder of kept frames holds beside them
BOARD_FILE: Final = "board.yaml"
# more cost time and tell nothing new
MOST_VIEWS: Final = 120
SAMPLES: Final = 8
# of the photos; where more show no board, it may be another than described
USUAL_MISSES: Final = 0.25


@dataclass(frozen=True, slots=True)
class CollectedViews:
    """The views that were found, in images of one size, and where they came from."""

    views: list[BoardView]
    size_px: tuple[int, int]
    source: str


# ---------------------------------------------------------------- the board


def choose_board(words: str | None, given: dict[str, Any], sources: Sequence[str]) -> CalibrationBoard:
    """The board that is meant.

    Raises:
        ConfigError: there is none of that name, or it cannot be.
    """
    if words is not None and re.fullmatch(r"\d+\s*[xX*]\s*\d+", words):
        columns, rows = two_numbers(words, "--board")
        needed = {"charuco": ("square_m", "marker_m"), "grid": ("marker_m", "gap_m")}
        for key in needed.get(given.get("pattern", "charuco"), ("square_m",)):
            if key not in given:
                option = f"--{key.removesuffix('_m')}-mm"
                raise ConfigError(f"--board {words}: needs {option}, as measured on the print")
        return validate(CalibrationBoard, {"columns": columns, "rows": rows, **given}, f"--board {words}")
    beside = [Path(s) / BOARD_FILE for s in sources if (Path(s) / BOARD_FILE).is_file()]
    alone = words is None and len(beside) == 1
    path = beside[0] if alone else find_file("boards", words or DEFAULT_BOARD)
    board = load_model(CalibrationBoard, path)
    return validate(CalibrationBoard, {**board.model_dump(), **given}, str(path)) if given else board


def two_numbers(words: str, option: str) -> tuple[int, int]:
    """Two whole numbers with an x between.

    Raises:
        ConfigError: they are not.
    """
    form = re.fullmatch(r"(\d{1,5})\s*[xX*]\s*(\d{1,5})", words)
    if form is None:
        raise ConfigError(f"{option} {words}: expected two numbers, as in 1280x720 or 7x5")
    return int(form[1]), int(form[2])


# ---------------------------------------------------------------- photos


def views_of_photos(
    board: CalibrationBoard, sources: Sequence[Path], keep: Path | None, tell: Callable[[str], None]
) -> CollectedViews:
    """The board in photos and videos, of which the moments are used in which it is still.

    `keep` is where the images used are left; `tell` gets a line for whatever is left out.

    Raises:
        ConfigError: an image cannot be read, or the board is in none.
    """
    paths = photo_paths(sources)
    finder = BoardFinder(board)
    sessions: dict[tuple[int, int], CaptureSession] = {}
    found: list[tuple[BoardView, tuple[int, int]]] = []
    missed = _Samples()
    count = 0
    without: list[str] = []
    for photo in read_photos(paths, tell):
        count += 1
        seen = finder.find_or_why(photo.image, photo.name)
        view = seen if isinstance(seen, BoardView) else None
        if view is None:
            missed.add(photo)
        if photo.time_s is None:
            without += [f"{Path(photo.name).name}: left out: {seen}"] if isinstance(seen, str) else []
        else:
            session = sessions.setdefault(photo.size_px, CaptureSession(photo.size_px))
            view = view if session.step(photo.time_s, view).kept else None
        if view is None:
            continue
        found.append((view, photo.size_px))
        if keep is not None:
            write_image(keep / f"view-{len(found):04d}.png", photo.image)
    if keep is not None:
        write_atomically(keep / BOARD_FILE, board_yaml(board))
    source = ", ".join(map(str, sources))
    if len(found) < min(FEWEST_VIEWS, count):  # one of many matches by accident
        why = _why_none(board, missed, count, moving=bool(sessions))
        chance = f"; {found[0][0].name} alone may match by chance" if found else ""
        raise ConfigError(f"{source}: {why}{chance}")
    for line in without:
        tell(line)
    if len(without) > USUAL_MISSES * count and (other := hint(board, missed.images)):
        tell(f"of those that were looked at again: {other}")
    return _of_one_size(found, source, tell)


class _Samples:
    """Some images, evenly from all there are however many come: every so manieth, twice as far each time."""

    def __init__(self) -> None:
        self.images: list[NDArray[np.uint8]] = []
        self.met = 0
        self._stride = 1

    def add(self, photo: Photo) -> None:
        if self.met % self._stride == 0:
            self.images.append(photo.image)
        self.met += 1
        if len(self.images) > SAMPLES:
            self.images, self._stride = self.images[::2], 2 * self._stride


def _why_none(board: CalibrationBoard, missed: _Samples, count: int, *, moving: bool) -> str:
    other = None if board.pattern == "chessboard" else hint(board, missed.images)
    if other is not None:
        return f"no board as described in {count} images; {other}"
    more = ", sharp and held still for a moment" if moving else ""
    return f"no board found in {count} images; {what_is_seen(board, missed.images)}{more}"


def _of_one_size(
    found: list[tuple[BoardView, tuple[int, int]]], source: str, tell: Callable[[str], None]
) -> CollectedViews:
    """The views of the most usual size; a calibration is of one."""
    sizes = Counter(size for _, size in found)
    size, count = sizes.most_common(1)[0]
    for view, other in found:
        if other != size:
            mismatch = f"{other[0]}x{other[1]}, expected the {size[0]}x{size[1]} of {count} others"
            tell(f"{view.name}: left out: images of {mismatch}")
    views = [view for view, other in found if other == size]
    if len(views) > MOST_VIEWS:
        tell(f"{len(views)} views: every {len(views) / MOST_VIEWS:.1f}th is used")
        views = [views[k * len(views) // MOST_VIEWS] for k in range(MOST_VIEWS)]
    return CollectedViews(views, size, source)
