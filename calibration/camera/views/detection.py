"""Finds the board's points in an image, to a few hundredths of a pixel, and says how sharp the image is.

Pixels: u right, v down, whole numbers at pixel centres.

Where four squares meet, the grey values are odd about the corner: blur, whatever its shape, moves such a
corner nowhere. The corners of a grid's markers have no such symmetry and blur draws them inwards, which is
why ChArUco and chessboards calibrate better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.board.board import CalibrationBoard
from calibration.camera.views.edges import COLUMNS, edge_pixels
from companion.base.geometry import FloatArray

# a view with fewer says little more than its own pose takes (6 numbers)
FEWEST_POINTS: Final = 6
# refinement sees no farther than this share of the way to the next edge that is not the corner's own
WINDOW_SHARE: Final = 0.85
WINDOW_PX: Final = (2, 12)
CRITERIA: Final = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)
# a corner that no plane can explain to this share of the board's image is one that was misread
MISREAD_SHARE: Final = 0.03
# lenses to see that plane through: by one parameter λ of r_ideal = r / (1 + λ r²), r = 1 at the image's
# corners. Through none at all, the corners that tell most of a wide lens are taken for misread
LENSES: Final = (0.0, -0.15, -0.3, -0.6, -1.0, -1.5, 0.15)
MOST_LENS: Final = 0.1  # the least that 1 + λ r² is let be
# where fewer fit any plane it is another board
FEWEST_FITTING: Final = 0.8
# points on a line fix no pose: the smaller spread, of the larger one
THINNEST: Final = 0.05
EDGE_PATCH_PX: Final = 5
KALIBRS_BORDER: Final = 2  # cells of black about the code in its grids of AprilTags; OpenCV draws one
NO_EDGES: Final = np.empty((0, COLUMNS))


@dataclass(frozen=True, slots=True)
class BoardView:
    """The board in one image: ids (n,), points on the board (n, 3) in m, and corners (n, 2) in px.

    `edges` are the pixels about the edges between corners (`edge_pixels`).
    """

    name: str
    ids: NDArray[np.int64]
    points_m: FloatArray
    corners_px: FloatArray
    edge_px: float = 0.0
    edges: FloatArray = field(default_factory=lambda: NO_EDGES)

    def only(self, kept: NDArray[np.bool_]) -> BoardView:
        """The view with some of its points."""
        return BoardView(
            self.name, self.ids[kept], self.points_m[kept], self.corners_px[kept], self.edge_px, self.edges
        )


class BoardFinder:
    """Finds one board. It keeps no memory of earlier images."""

    def __init__(self, board: CalibrationBoard) -> None:
        self.board = board
        parameters = cv2.aruco.DetectorParameters()
        if board.pattern == "charuco":
            self._charuco = cv2.aruco.CharucoDetector(
                board.charuco, cv2.aruco.CharucoParameters(), parameters
            )
        elif board.pattern == "grid":
            wide = cv2.aruco.DetectorParameters()
            wide.markerBorderBits = KALIBRS_BORDER
            self._markers = [
                cv2.aruco.ArucoDetector(board.grid.getDictionary(), border) for border in (parameters, wide)
            ]

    def find(self, image: NDArray[np.uint8], name: str = "") -> BoardView | None:
        """The board in a grey image (height, width), or None where too little of it is seen."""
        found = self.find_or_why(image, name)
        return found if isinstance(found, BoardView) else None

    def find_or_why(self, image: NDArray[np.uint8], name: str = "") -> BoardView | str:
        """The board in a grey image (height, width), or why it is not usable in it."""
        ids, corners = self._coarse(image)
        if self.board.pattern == "grid":
            ids, corners = self._as_drawn(ids, corners, image.shape[::-1])
        inside = ((corners > 1.0) & (corners < np.array(image.shape[::-1]) - 2.0)).all(axis=1)
        ids, corners = ids[inside], corners[inside]
        if len(ids) < FEWEST_POINTS:
            return self._too_few(len(ids))
        points = self.board.points_m[ids]
        spread = np.linalg.svd(points[:, :2] - points[:, :2].mean(axis=0), compute_uv=False)
        if spread[1] < THINNEST * spread[0]:
            return "the corners seen lie on one line; expected more of the board"
        fits = on_a_plane(points, corners, image.shape[::-1])
        if np.count_nonzero(fits) < max(FEWEST_POINTS, FEWEST_FITTING * len(fits)):
            return "the corners seen fit no flat board: another board, or a misread one"
        corners = _refine(image, corners, self._window_px(points[fits], corners[fits]))
        edges = self._edges(image, points[fits], corners[fits])
        return BoardView(name, ids, points, corners, edge_width_px(image, corners), edges)

    def _edges(self, image: NDArray[np.uint8], points: FloatArray, corners: FloatArray) -> FloatArray:
        """A grid's markers have no corners that stay where they are, whatever the encoding."""
        board = self.board
        if board.pattern == "grid":
            return NO_EDGES
        white_m = 0.5 * (board.square_m - (board.marker_m if board.pattern == "charuco" else 0.0))
        return edge_pixels(image, points, corners, board.square_m, white_m)

    def _as_drawn(
        self, ids: NDArray[np.int64], corners_px: FloatArray, size_px: Sequence[int]
    ) -> tuple[NDArray[np.int64], FloatArray]:
        """A grid's ids (n,) and corners (n, 2) as OpenCV would draw it, whichever way round they are printed.

        AprilRobotics' pictures of AprilTags are half a turn from OpenCV's, and Kalibr counts its markers from
        the lowest row. All markers of a board are alike: of both counts and the four turns the first that
        fits a plane, OpenCV's own before the others.
        """
        if len(ids) < FEWEST_POINTS:
            return ids, corners_px
        row, column = np.divmod(ids // 4, self.board.columns)
        from_below = 4 * ((self.board.rows - 1 - row) * self.board.columns + column) + ids % 4
        most, best = -1, (ids, corners_px)
        for counted in (ids, from_below):
            points = self.board.points_m[counted]
            for turn in range(4):
                turned = np.roll(corners_px.reshape(-1, 4, 2), turn, axis=1).reshape(-1, 2)
                fitting = int(np.count_nonzero(on_a_plane(points, turned, size_px)))
                if fitting > most:
                    most, best = fitting, (counted, turned)
                if fitting >= FEWEST_FITTING * len(ids):
                    return best
        return best

    def _too_few(self, corners: int) -> str:
        if self.board.pattern == "chessboard":
            return "not the whole board"
        if corners == 0:
            return "no board"
        return f"{corners} corners of the board's {self.board.corner_count}; expected {FEWEST_POINTS} or more"

    def _coarse(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.int64], FloatArray]:
        """Ids (n,) and corners (n, 2) as they are found, each id once."""
        board = self.board
        found: Any
        identities: Any
        if board.pattern == "charuco":
            found, identities, _, _ = self._charuco.detectBoard(image)
        elif board.pattern == "grid":
            seen: list[Any] = [detector.detectMarkers(image)[:2] for detector in self._markers]
            quads, markers = max(seen, key=lambda one: 0 if one[1] is None else len(one[1]))
            pairs = {} if markers is None else dict(zip(np.ravel(markers).tolist(), quads, strict=True))
            known = sorted(pairs)
            found = None if not known else np.concatenate([np.reshape(pairs[k], (4, 2)) for k in known])
            identities = (4 * np.array(known, dtype=np.int64)[:, None] + np.arange(4)).ravel()
        else:
            there, found = _chessboard(image, (board.columns, board.rows))
            identities = np.arange(board.corner_count)
            found = found if there else None
        if found is None or identities is None:
            return np.empty(0, dtype=np.int64), np.empty((0, 2))
        return np.asarray(identities, dtype=np.int64).ravel(), np.asarray(found, dtype=np.float64).reshape(
            -1, 2
        )

    def _window_px(self, points_m: FloatArray, corners_px: FloatArray) -> int:
        """Half the side of the window in which a corner is refined."""
        board = self.board
        free_m = {
            "charuco": 0.5 * (board.square_m - board.marker_m),
            # a marker's border is one cell wide
            "grid": min(board.gap_m, board.marker_m / (self._bits() + 2)),
            "chessboard": 0.5 * board.square_m,
        }[board.pattern]
        homography, _ = cv2.findHomography(points_m[:, :2], corners_px)
        steps = points_m[:, None, :2] + free_m * np.array(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
        pixels = cv2.perspectiveTransform(steps, homography)
        free_px = np.linalg.norm(pixels[:, 1:] - pixels[:, :1], axis=2).min()
        return int(np.clip(WINDOW_SHARE * free_px, *WINDOW_PX))

    def _bits(self) -> int:
        return 4 if self.board.pattern == "chessboard" else int(self.board.grid.getDictionary().markerSize)


def on_a_plane(points_m: FloatArray, corners_px: FloatArray, size_px: Sequence[int]) -> NDArray[np.bool_]:
    """Which corners (n, 2) can be those points (n, 3) of a plane, seen through any usual lens: (n,)."""
    middle = 0.5 * np.array(size_px, dtype=np.float64)
    places = (corners_px - middle) / np.linalg.norm(middle)
    squared = np.sum(places**2, axis=1, keepdims=True)
    most = np.zeros(len(points_m), dtype=bool)
    for lens in LENSES:
        ideal = places / np.maximum(1.0 + lens * squared, MOST_LENS)
        limit = MISREAD_SHARE * float(np.linalg.norm(np.ptp(ideal, axis=0)))
        # in pixels or not: RANSAC's own arithmetic is at home with hundreds
        _, fits = cv2.findHomography(points_m[:, :2], 1e3 * ideal, cv2.RANSAC, 1e3 * limit)
        found = most if fits is None else np.asarray(fits, dtype=bool).ravel()
        most = found if np.count_nonzero(found) > np.count_nonzero(most) else most
        if most.all():
            break
    return most


def _chessboard(image: NDArray[np.uint8], size: tuple[int, int]) -> tuple[bool, FloatArray | None]:
    """The library's two ways of finding one; the second sees boards that are blurred or in bad light."""
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    there, found = cv2.findChessboardCorners(image, size, flags=flags)
    if not there:
        there, found = cv2.findChessboardCornersSB(image, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    return bool(there), None if found is None else np.asarray(found, dtype=np.float64)


def _refine(image: NDArray[np.uint8], corners: FloatArray, window: int) -> FloatArray:
    """Corners (n, 2) to sub-pixel places: where the gradients all around point to one spot."""
    points = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    cv2.cornerSubPix(image, points, (window, window), (-1, -1), CRITERIA)
    return points.astype(np.float64).reshape(-1, 2)


def edge_width_px(image: NDArray[np.uint8], corners: FloatArray) -> float:
    """How wide edges are at the corners: their contrast over their steepest slope, median.

    A step between two pixels is 2 px wide by this measure, because of the filter that takes the slope.
    """
    height, width = image.shape
    half = EDGE_PATCH_PX
    widths = []
    for u, v in np.rint(corners).astype(int).tolist():
        if not (half < u < width - half - 1 and half < v < height - half - 1):
            continue
        patch = image[v - half : v + half + 1, u - half : u + half + 1].astype(np.float32)
        slope = np.hypot(
            cv2.Sobel(patch, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(patch, cv2.CV_32F, 0, 1, scale=0.125)
        )
        low, high = np.percentile(patch, (10, 90))
        widths.append(float((high - low) / max(np.percentile(slope[1:-1, 1:-1], 95), 1e-3)))
    return float(np.median(widths)) if widths else float("inf")
