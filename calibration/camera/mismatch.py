"""Why the board that was described is not the one in the pictures: what was seen instead, in words. Pure."""

import math
from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from calibration.camera.board import CalibrationBoard
from calibration.camera.views import BoardFinder
from companion.pad import DICTIONARIES

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
Image = NDArray[np.uint8]
Size = tuple[int, int]


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
