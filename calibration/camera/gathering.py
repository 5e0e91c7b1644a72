"""Gathers the views of a board from photos and videos, and the board itself from what a user says of it."""

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from calibration.camera import DEFAULT_BOARD
from calibration.camera.board import CalibrationBoard, board_yaml
from calibration.camera.capture import CaptureSession, write_image
from calibration.camera.solver import FEWEST_VIEWS
from calibration.camera.views import BoardFinder, BoardView
from companion.base.files import write_atomically
from companion.config import ConfigError, find_file, load_model, validate
from companion.pad import DICTIONARIES
from companion.sense.camera.photos import Photo, photo_paths, read_photos

# what a folder of kept frames holds beside them
BOARD_FILE: Final = "board.yaml"
# more cost time and tell nothing new
MOST_VIEWS: Final = 120
SAMPLES: Final = 8
# of the photos; where more show no board, it may be another than described
USUAL_MISSES: Final = 0.25
Image = NDArray[np.uint8]
Size = tuple[int, int]


@dataclass(frozen=True, slots=True)
class CollectedViews:
    """The views that were found, in images of one size, and where they came from."""

    views: list[BoardView]
    size_px: Size
    source: str


# ---------------------------------------------------------------- the board


def choose_board(words: str | None, sources: Sequence[str], **described: Any) -> CalibrationBoard:
    """The board that is meant: by its file or size, with what else is `described` (None: as its file says).

    Raises:
        ConfigError: there is none of that name, or it cannot be.
    """
    given = {key: value for key, value in described.items() if value is not None}
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


def two_numbers(words: str, option: str) -> Size:
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
    sessions: dict[Size, CaptureSession] = {}
    found: list[tuple[BoardView, Size]] = []
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
        self.images: list[Image] = []
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
    found: list[tuple[BoardView, Size]], source: str, tell: Callable[[str], None]
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


# ---------------------------------------------------------------- another board
# Why the board that was described is not the one in the pictures: what was seen instead, in words. Pure.

# looking for many boards in large photos takes minutes; to tell them apart, this width is enough
ENOUGH_WIDTH_PX: Final = 1000
# another board that is in one of several images alone may be there by chance
FEWEST_IMAGES: Final = 2
# a less likely board has to show so many times as many points in as many images
LIKELIER: Final = 1.15
# share of the markers seen that a board need not have: misread ones
MOST_UNEXPLAINED: Final = 0.2
# fewer markers than this may be anything
FEWEST_MARKERS: Final = 3
# in each image; a dictionary that explains as many is the right one, or of its kind
PLENTY: Final = 4
MOST_IMAGES: Final = 4
# a longer dictionary holds the shorter ones of its kind: it has to explain so much more
LONGER_DICTIONARY: Final = 1.1


def hint(board: CalibrationBoard, images: Sequence[Image]) -> str | None:
    """What board is in images in which the one described was not found; None if none is.

    A plain chessboard is reported only where it is larger: a part of the one described is no news.
    """
    small = [_reduced(image) for image in images]
    if board.pattern != "chessboard":
        found = _better_board(board, small)
        return None if found is None else f"found it with {found[0]} in {found[1]} of {len(small)}"
    size = _chessboard_seen(small)
    if size is None or size[0] * size[1] <= board.columns * board.rows:
        return None
    return f"{_chessboard(size)} is seen; expected {board.text}"


def _better_board(board: CalibrationBoard, images: Sequence[Image]) -> tuple[str, int] | None:
    """How to ask for a board like this one that is in the images, and in how many; None if there is none.

    Of one image alone nothing follows if there are more.
    """
    most, points, words = min(len(images), FEWEST_IMAGES) - 1, math.inf, ""
    detector = cv2.aruco.ArucoDetector(board.whole_dictionary())
    ids = np.array([int(i) for image in images for i in np.ravel(_ids_of(detector, image))])
    for option, other in near_misses(board):
        if np.count_nonzero(ids >= other.marker_count) > MOST_UNEXPLAINED * len(ids):
            continue  # what it has not says that it is another
        views = [view for view in map(BoardFinder(other).find, images) if view is not None]
        seen = sum(len(view.ids) for view in views)
        if len(views) > most or (len(views) == most and seen > LIKELIER * points):
            most, points, words = len(views), seen, option
    return (words, most) if words else None


def near_misses(board: CalibrationBoard) -> list[tuple[str, CalibrationBoard]]:
    """Boards with markers that are easily taken for this one, and how to ask for them, likeliest first."""
    c, r = board.columns, board.rows
    sizes = [(c, r), (r, c), (c - 1, r - 1), (c + 1, r + 1), (c - 1, r), (c + 1, r), (c, r - 1), (c, r + 1)]
    legacies = (board.legacy_pattern, not board.legacy_pattern)
    others = (
        _option(board, {"columns": columns, "rows": rows, "legacy_pattern": legacy})
        for columns, rows in dict.fromkeys(sizes)
        for legacy in (legacies if board.pattern == "charuco" else legacies[:1])
    )
    return [other for other in others if other is not None and other[1] != board]


def _chessboard_seen(images: Sequence[Image]) -> Size | None:
    """The largest plain chessboard that is seen, or as much of it as is: inner corners."""
    best: Size | None = None
    for image in images:
        there, _, meta = cv2.findChessboardCornersSBWithMeta(
            image, (3, 3), cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
        )
        if there and (best is None or meta.size > best[0] * best[1]):
            best = max(meta.shape), min(meta.shape)
    return best


def _chessboard(size: Size) -> str:
    return f"a chessboard of {size[0]}x{size[1]} inner corners, or more,"


def _option(board: CalibrationBoard, change: dict[str, Any]) -> tuple[str, CalibrationBoard] | None:
    """A board that differs, and how to ask for it; None if there can be none."""
    try:
        other = CalibrationBoard.model_validate({**board.model_dump(), **change})
    except ValidationError:
        return None
    words = []
    if (other.columns, other.rows) != (board.columns, board.rows):
        words.append(f"--board {other.columns}x{other.rows}")
    if other.legacy_pattern != board.legacy_pattern:
        words.append("--legacy-pattern" if other.legacy_pattern else "no --legacy-pattern")
    return " and ".join(words), other


def what_is_seen(board: CalibrationBoard, images: Sequence[Image]) -> str:
    """What the images show where the board was not found, beside what was expected."""
    small = [_reduced(image) for image in images[:MOST_IMAGES]]
    name, ids = _markers_seen(board, small)
    if not ids:
        size = _chessboard_seen(small)
        plain = "neither markers of any dictionary nor a chessboard" if size is None else _chessboard(size)
        return f"{plain} {'are' if size is None else 'is'} seen; expected {board.text}"
    seen = f"markers {min(ids)} to {max(ids)} of {name} are seen"
    if board.pattern == "chessboard":
        return f"{seen}; expected {board.text}, which has none"
    return f"{seen}; expected 0 to {board.marker_count - 1} of {_own_name(board)}, as {board.text}"


def _own_name(board: CalibrationBoard) -> str:
    return board.dictionary if isinstance(board.dictionary, str) else "its own dictionary"


def _markers_seen(board: CalibrationBoard, images: Sequence[Image]) -> tuple[str, set[int]]:
    """The dictionary that explains most of what looks like markers, and the ids that are seen of it.

    Short dictionaries first: where one of them explains plenty, only longer ones of its kind are tried, since
    the longest take a hundred times as long.
    """
    known = {_own_name(board): board.whole_dictionary()}
    known |= {name: cv2.aruco.getPredefinedDictionary(number) for name, number in DICTIONARIES.items()}
    by_length = sorted(known, key=lambda name: (name != _own_name(board), len(known[name].bytesList)))
    best, most, best_ids = "", float(FEWEST_MARKERS), set[int]()
    for name in by_length:
        if len(best_ids) and most >= PLENTY * len(images) and _kind(name) != _kind(best):
            continue
        detector = cv2.aruco.ArucoDetector(known[name])
        found = [int(i) for image in images for i in np.ravel(_ids_of(detector, image))]
        if len(found) >= most:
            best, most, best_ids = name, LONGER_DICTIONARY * len(found), set(found)
    return best, best_ids


def _ids_of(detector: cv2.aruco.ArucoDetector, image: Image) -> Any:
    _, ids, _ = detector.detectMarkers(image)
    return () if ids is None else ids


def _kind(dictionary: str) -> str:
    """4x4_50 and 4x4_1000 are of a kind: the one begins with the other."""
    return dictionary.rsplit("_", 1)[0]


def _reduced(image: Image) -> Image:
    share = ENOUGH_WIDTH_PX / max(image.shape)
    if share >= 1.0:
        return image
    return np.asarray(cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA))
