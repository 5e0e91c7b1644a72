"""Gathers the views of a board from photos and videos, and the board itself from what a user says of it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from calibration.camera.board import Board
from calibration.camera.capture import CaptureSession
from calibration.camera.detection import BoardFinder, View
from calibration.camera.images import Photo, photo_paths, read_photos
from calibration.camera.live import write_image
from calibration.camera.printing import board_yaml
from companion.config import ConfigError, find_file, load_model, validate
from companion.files import write_atomically

DEFAULT_BOARD: Final = "charuco_a4"
# what a folder of kept frames holds beside them
BOARD_FILE: Final = "board.yaml"
# more cost time and tell nothing new
MOST_VIEWS: Final = 120
SAMPLES: Final = 4


@dataclass(frozen=True, slots=True)
class Found:
    """The views that were found, in images of one size, and where they came from."""

    views: list[View]
    size_px: tuple[int, int]
    source: str


# ---------------------------------------------------------------- the board


def choose_board(words: str | None, given: dict[str, Any], sources: Sequence[str]) -> Board:
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
    board: Board, sources: Sequence[Path], keep: Path | None, tell: Callable[[str], None]
) -> Found:
    """The board in photos and videos, of which the moments are used in which it is still.

    `keep` is where the images used are left; `tell` gets a line for whatever is left out.

    Raises:
        ConfigError: an image cannot be read, or the board is in none.
    """
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
        tell(f"no board, or too little of it, in {len(without)} of {count}: {', '.join(without)}")
    return _of_one_size(found, source, tell)


def _why_nothing(board: Board, samples: Sequence[Photo], count: int, *, moving: bool) -> str:
    for words, other in near_misses(board):
        finder = BoardFinder(other)
        if any(finder.find(photo.image) is not None for photo in samples):
            return f"no board as described in {count} images; found it with {words}"
    more = ", sharp and held still for a moment" if moving else ""
    return f"no board found in {count} images; expected {board.text}{more}"


def _of_one_size(
    found: list[tuple[View, tuple[int, int]]], source: str, tell: Callable[[str], None]
) -> Found:
    """The views of the most usual size; a calibration is of one."""
    sizes = Counter(size for _, size in found)
    size, count = sizes.most_common(1)[0]
    for view, other in found:
        if other != size:
            told = f"{other[0]}x{other[1]}, expected the {size[0]}x{size[1]} of {count} others"
            tell(f"{view.name}: left out: images of {told}")
    views = [view for view, other in found if other == size]
    if len(views) > MOST_VIEWS:
        tell(f"{len(views)} views: every {len(views) / MOST_VIEWS:.1f}th is used")
        views = [views[k * len(views) // MOST_VIEWS] for k in range(MOST_VIEWS)]
    return Found(views, size, source)
