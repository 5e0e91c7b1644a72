"""Finds the board's points in an image, to a few hundredths of a pixel, and says how sharp the image is.

Pixels: u right, v down, whole numbers at pixel centres.

Where four squares meet, the grey values are odd about the corner: blur, whatever its shape, moves such a
corner nowhere. The corners of a grid's markers have no such symmetry and blur draws them inwards, which is
why ChArUco and chessboards calibrate better.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.board import CalibrationBoard
from companion.base.geometry import FloatArray

# a view with fewer says little more than its own pose takes (6 numbers)
FEWEST_POINTS: Final = 6
# of corners in both of two views, by which these are compared
FEWEST_COMMON: Final = 4
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
EDGE_COLUMNS: Final = 4
NO_EDGES: Final[FloatArray] = np.empty((0, EDGE_COLUMNS))
KALIBRS_BORDER: Final = 2  # cells of black about the code in its grids of AprilTags; OpenCV draws one


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
        return BoardView(
            self.name, self.ids[kept], self.points_m[kept], self.corners_px[kept], self.edge_px, self.edges
        )


def distance_px(one: BoardView, other: BoardView) -> float | None:
    """Root mean square distance of the corners that both have; None where there are hardly any."""
    _, a, b = np.intersect1d(one.ids, other.ids, return_indices=True)
    if len(a) < FEWEST_COMMON:
        return None
    moved = one.corners_px[a] - other.corners_px[b]
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))


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
        bits = 4 if board.pattern == "chessboard" else int(board.grid.getDictionary().markerSize)
        free_m = {
            "charuco": 0.5 * (board.square_m - board.marker_m),
            # a marker's border is one cell wide
            "grid": min(board.gap_m, board.marker_m / (bits + 2)),
            "chessboard": 0.5 * board.square_m,
        }[board.pattern]
        homography, _ = cv2.findHomography(points_m[:, :2], corners_px)
        steps = points_m[:, None, :2] + free_m * np.array(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
        pixels = cv2.perspectiveTransform(steps, homography)
        free_px = np.linalg.norm(pixels[:, 1:] - pixels[:, :1], axis=2).min()
        return int(np.clip(WINDOW_SHARE * free_px, *WINDOW_PX))


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


# ---------------------------------------------------------------- edges
# The board's edges between neighbouring corners, in grey values: what shows how the camera encodes light.

REACH_PX: Final = (2.5, 6.0)
# of an edge's length, and of the width of the white beside it
SPAN: Final = 0.5
REACH_SHARE: Final = 0.8
LEAST_CONTRAST: Final = 40.0
# white that is brighter may be cut off
FULL_GREY: Final = 250.0
# edge, distance as a share of the reach, reach, grey value


def edge_pixels(
    image: NDArray[np.uint8], points_m: FloatArray, corners_px: FloatArray, square_m: float, white_m: float
) -> FloatArray:
    """The pixels about edges between neighbouring corners (n, 4): greys as they are, interpolated nowhere.

    Of each: which edge, how far from it into the white as a share of the reach (-1..1), the reach (px), and
    its grey value. `white_m` is how much white an edge has beside it.
    """
    steps = np.rint(2.0 * points_m[:, :2] / square_m).astype(int)
    places = {(x, y): k for k, (x, y) in enumerate(steps.tolist())}
    pairs = [
        (k, places[other])
        for (x, y), k in places.items()
        for other in ((x + 2, y), (x, y + 2))
        if other in places
    ]
    found = (_about(image, corners_px[a], corners_px[b], white_m / square_m) for a, b in pairs)
    kept = [each for each in found if each is not None]
    if not kept:
        return np.empty((0, EDGE_COLUMNS))
    numbered = (np.column_stack((np.full(len(each), k), each)) for k, each in enumerate(kept))
    return np.concatenate(list(numbered))


def _about(
    image: NDArray[np.uint8], start: FloatArray, end: FloatArray, white_share: float
) -> FloatArray | None:
    """Distances into the white, the reach and grey values (n, 3) of one edge's pixels."""
    along = end - start
    length = float(np.linalg.norm(along))
    reach = min(REACH_SHARE * white_share * length, REACH_PX[1])
    middle, margin = 0.5 * (start + end), 0.5 * SPAN * np.abs(along) + reach + 1.0
    low, high = np.floor(middle - margin).astype(int), np.ceil(middle + margin).astype(int)
    if reach < REACH_PX[0] or low.min() < 0 or (high >= image.shape[::-1]).any():
        return None
    along = along / length
    v, u = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    x, y = u - middle[0], v - middle[1]
    across = (x * along[1] - y * along[0]) / reach
    near = (np.abs(across) < 1.0) & (np.abs(x * along[0] + y * along[1]) < 0.5 * SPAN * length)
    grey, across = image[low[1] : high[1] + 1, low[0] : high[0] + 1][near].astype(np.float64), across[near]
    ends = [float(grey[side].mean()) if side.any() else 0.0 for side in (across < -0.7, across > 0.7)]
    if abs(ends[1] - ends[0]) < LEAST_CONTRAST or max(ends) > FULL_GREY:
        return None
    return np.column_stack((across if ends[1] > ends[0] else -across, np.full(len(grey), reach), grey))


# ---------------------------------------------------------------- coverage
# The image is a mesh of `COLUMNS` x `ROWS` cells; a cell counts once `PER_CELL` corners were seen in it. The
# board's tilt is the angle between its normal and the line of sight along the optical axis, in four
# directions named by the edge of the board, as seen in the image, that is farther away.

COLUMNS: Final = 6
ROWS: Final = 4
PER_CELL: Final = 3
ENOUGH_CELLS: Final = 0.85
TILT_DEG: Final = 20.0
VIEWS_A_TILT: Final = 2
ENOUGH_VIEWS: Final = 15
# before the camera is known its focal length is taken as this many image widths (53 degrees across)
USUAL_FOCAL: Final = 1.0
TILTS: Final = ("top", "bottom", "left", "right")
CORNERS: Final = {
    "upper left": (0, 0),
    "upper right": (0, COLUMNS - 1),
    "lower left": (ROWS - 1, 0),
    "lower right": (ROWS - 1, COLUMNS - 1),
}


@dataclass(frozen=True, slots=True)
class Tilt:
    """A board's tilt: how far off square, and how much of that has its right and its lower edge away."""

    angle_deg: float
    right_away_deg: float
    bottom_away_deg: float

    @property
    def directions(self) -> tuple[str, ...]:
        """The edges that are clearly away."""
        amounts = {
            "top": -self.bottom_away_deg,
            "bottom": self.bottom_away_deg,
            "left": -self.right_away_deg,
            "right": self.right_away_deg,
        }
        return tuple(name for name in TILTS if amounts[name] >= TILT_DEG)


def tilt_of(turn: FloatArray) -> Tilt:
    """The tilt of a board with a rotation vector (3,) from the board's axes to the camera's."""
    rotation, _ = cv2.Rodrigues(turn)
    x, y, z = rotation[:, 2].tolist()
    if z < 0.0:
        x, y, z = -x, -y, -z
    angle = math.acos(min(z, 1.0))
    across = math.hypot(x, y)
    # the normal tilts to where the board comes nearer: that edge's opposite is away
    share = math.degrees(angle) / across if across > 1e-9 else 0.0
    return Tilt(math.degrees(angle), -x * share, -y * share)


def rough_turn(view: BoardView, size_px: tuple[int, int]) -> FloatArray:
    """The board's rotation vector (3,) with a camera of the usual angle: good enough to tell a tilt."""
    focal = USUAL_FOCAL * max(size_px)
    matrix = np.array([[focal, 0.0, 0.5 * size_px[0]], [0.0, focal, 0.5 * size_px[1]], [0.0, 0.0, 1.0]])
    corners = view.corners_px.reshape(-1, 1, 2)
    _, turn, _ = cv2.solvePnP(view.points_m, corners, matrix, np.zeros(5), flags=cv2.SOLVEPNP_IPPE)
    return np.asarray(turn, dtype=np.float64).ravel()


class ImageCoverage:
    """What has been seen so far."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.size_px = size_px
        self.corner_count: NDArray[np.int64] = np.zeros((ROWS, COLUMNS), dtype=np.int64)
        self.tilts: list[Tilt] = []

    def add(self, view: BoardView, turn: FloatArray | None = None) -> None:
        """Take in a view; without its rotation vector that is worked out roughly."""
        np.add.at(self.corner_count, self._cells(view), 1)
        self.tilts.append(tilt_of(rough_turn(view, self.size_px) if turn is None else turn))

    def brings_something(self, view: BoardView) -> bool:
        """Whether a view shows what is still missing: cells, or a tilt."""
        if (self.corner_count[self._cells(view)] < PER_CELL).any():
            return True
        directions = tilt_of(rough_turn(view, self.size_px)).directions
        return any(self.tilt_count(name) < VIEWS_A_TILT for name in directions)

    @property
    def covered(self) -> NDArray[np.bool_]:
        return np.asarray(self.corner_count >= PER_CELL)

    @property
    def share(self) -> float:
        return float(self.covered.mean())

    @property
    def largest_tilt_deg(self) -> float:
        return max((tilt.angle_deg for tilt in self.tilts), default=0.0)

    @property
    def missing_corners(self) -> list[str]:
        """The corners of the image where the board has not been enough."""
        return [name for name, cell in CORNERS.items() if not self.covered[cell]]

    @property
    def unseen_corners(self) -> list[str]:
        """The corners of the image where not one corner of a board has been."""
        return [name for name, cell in CORNERS.items() if not self.corner_count[cell]]

    @property
    def missing_tilts(self) -> list[str]:
        return [name for name in TILTS if self.tilt_count(name) < VIEWS_A_TILT]

    def tilt_count(self, direction: str) -> int:
        return sum(direction in tilt.directions for tilt in self.tilts)

    @property
    def complete(self) -> bool:
        return not self.hints()

    def hints(self) -> list[str]:
        """What to do next, the most useful first; empty when all has been seen."""
        hints = [f"show it at the {name} of the image" for name in self.missing_corners]
        if not hints and self.share < ENOUGH_CELLS:
            hints.append(f"show it {self._emptiest()}")
        hints += [f"tilt its {name} edge away from the camera" for name in self.missing_tilts]
        if not hints and len(self.tilts) < ENOUGH_VIEWS:
            hints.append("show it from nearer, from farther off, and turned")
        return hints

    def _cells(self, view: BoardView) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The cell (rows, columns) of each corner."""
        places = view.corners_px * (COLUMNS, ROWS) / np.array(self.size_px)
        column, row = np.floor(places).astype(np.int64).T
        return row.clip(0, ROWS - 1), column.clip(0, COLUMNS - 1)

    def _emptiest(self) -> str:
        """Where most of what is missing lies, in words."""
        row, column = np.argwhere(~self.covered).mean(axis=0)
        down, right = (row + 0.5) / ROWS - 0.5, (column + 0.5) / COLUMNS - 0.5
        if max(abs(down), abs(right)) < 0.15:
            return "in the middle of the image"
        if abs(down) > abs(right):
            return f"near the {'lower' if down > 0 else 'upper'} edge of the image"
        return f"near the {'right' if right > 0 else 'left'} edge of the image"
