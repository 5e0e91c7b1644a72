"""Pictures of a calibration board with known truth: any lens, blur of focus and motion, noise.

The board is painted with exact areas (a texel's grey is the share of it that is black), looked up along rays
of a grid finer than the pixels, blurred there, and averaged over each pixel. Edges stay where they are to a
hundredth of a pixel (`test_board_pictures.py`).
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.board import CalibrationBoard
from calibration.camera.views import BoardView
from companion.base.geometry import FloatArray
from companion.config import CameraConfig

FINER: Final = 3  # samples along a pixel's side
MESH_PX: Final = 4
MARGIN_SQUARES: Final = 0.6
WHITE: Final = 215.0
BLACK: Final = 35.0
AROUND: Final = 120.0


@dataclass(frozen=True)
class BoardPose:
    """The board before the camera: rotation vector (3,), and the board's origin (3,) in camera axes (m)."""

    turn: FloatArray
    position_m: FloatArray


class BoardPainter:
    """Takes pictures of one board with one camera."""

    def __init__(self, board: CalibrationBoard, camera: CameraConfig, bow_m: float = 0.0) -> None:
        self.board, self.camera = board, camera
        self.bow_m = bow_m
        self.matrix = np.array(
            [[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]]
        )
        self.distortion = np.array(camera.distortion)
        self._rays = fine_rays(camera)

    def project(self, points_m: FloatArray, pose: BoardPose) -> FloatArray:
        """Where points (n, 3) of the board are in the image (n, 2)."""
        bent = points_m + np.array((0.0, 0.0, 1.0)) * self._bow(points_m)[:, None]
        if self.camera.projection == "fisheye":
            seen = bent.reshape(-1, 1, 3)
            pixels, _ = cv2.fisheye.projectPoints(
                seen, pose.turn, pose.position_m, self.matrix, self.distortion
            )
        else:
            pixels, _ = cv2.projectPoints(bent, pose.turn, pose.position_m, self.matrix, self.distortion)
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)

    def take(
        self,
        pose: BoardPose,
        rng: np.random.Generator,
        *,
        noise_grey: float = 0.0,
        defocus_px: float = 0.0,
        motion_px: tuple[float, float] = (0.0, 0.0),
    ) -> NDArray[np.uint8]:
        """One picture; blur as the standard deviation of a Gauss bell, motion as a straight stroke."""
        width, height = self.camera.width_px, self.camera.height_px
        box = self._box(pose)
        image = np.full((height, width), AROUND, np.float32)
        if box is not None:
            left, top, right, bottom = box
            fine: Any = self._sample(pose, box)
            if defocus_px > 0.0:
                fine = cv2.GaussianBlur(fine, (0, 0), FINER * defocus_px)
            if max(map(abs, motion_px)) > 0.0:
                fine = cv2.filter2D(fine, -1, stroke(*(FINER * d for d in motion_px)))
            size = (right - left, bottom - top)
            image[top:bottom, left:right] = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
        if noise_grey > 0.0:
            image += rng.normal(0.0, noise_grey, image.shape).astype(np.float32)
        return np.asarray(np.rint(image).clip(0, 255), dtype=np.uint8)

    def _box(self, pose: BoardPose) -> tuple[int, int, int, int] | None:
        """The part of the image with the board in it: left, top, right, bottom (px)."""
        (w, h), m = self.board.size_m, self._margin_m() * 1.2
        line = np.linspace(0.0, 1.0, 20)
        x, y = -m + (w + 2 * m) * line, -m + (h + 2 * m) * line
        edge = [(a, -m, 0.0) for a in x] + [(a, h + m, 0.0) for a in x]
        edge += [(-m, b, 0.0) for b in y] + [(w + m, b, 0.0) for b in y]
        rotation, _ = cv2.Rodrigues(pose.turn)
        assert (np.array(edge) @ rotation.T + pose.position_m)[:, 2].min() > 0.0
        pixels = self.project(np.array(edge), pose)
        low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 8, 0)
        high = np.minimum(
            np.ceil(pixels.max(axis=0)).astype(int) + 9, (self.camera.width_px, self.camera.height_px)
        )
        return None if (high <= low).any() else (int(low[0]), int(low[1]), int(high[0]), int(high[1]))

    def _sample(self, pose: BoardPose, box: tuple[int, int, int, int]) -> NDArray[np.float32]:
        left, top, right, bottom = (FINER * edge for edge in box)
        rays = self._rays[top:bottom, left:right]
        rotation = np.asarray(cv2.Rodrigues(pose.turn)[0], dtype=np.float64)
        board_from_ray = np.linalg.inv(np.column_stack((rotation[:, 0], rotation[:, 1], pose.position_m)))
        places: Any = cv2.perspectiveTransform(rays, board_from_ray)
        if self.bow_m:
            places = self._bent(rays, places, rotation, pose.position_m)
        texels_per_m = FINER * self.camera.fx_px / float(pose.position_m[2])
        texels_per_m = 2.0 ** (round(2.0 * math.log2(texels_per_m)) / 2.0)
        texture = board_texture(self.board, texels_per_m, self._margin_m())
        places = (places + self._margin_m()) * texels_per_m - 0.5
        return np.asarray(
            cv2.remap(
                texture,
                places.astype(np.float32),
                None,  # type: ignore[call-overload]
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=(AROUND,),
            ),
            dtype=np.float32,
        )

    def _bent(
        self, rays: NDArray[np.float32], places: FloatArray, rotation: FloatArray, position: FloatArray
    ) -> FloatArray:
        """Where rays meet a board that is bowed: from the flat one's places, by repetition."""
        flat = rays.reshape(-1, 2).astype(np.float64)
        directions = np.column_stack((flat, np.ones(len(flat)))) @ rotation
        origin = -rotation.T @ position
        found = places.reshape(-1, 2).astype(np.float64)
        for _ in range(4):
            depth = self._bow(found)
            along = (depth - origin[2]) / directions[:, 2]
            found = origin[:2] + along[:, None] * directions[:, :2]
        return found.reshape(places.shape)

    def _bow(self, places_m: FloatArray) -> FloatArray:
        """How far the board's surface is from flat: a cylinder, its middle `bow_m` beyond its ends."""
        across = 2.0 * places_m[:, 0] / self.board.size_m[0] - 1.0
        return np.asarray(self.bow_m * (1.0 - across**2))

    def _margin_m(self) -> float:
        return MARGIN_SQUARES * self.board.square_m


@lru_cache(maxsize=4)
def _fine_rays(camera: str) -> NDArray[np.float32]:
    return _make_rays(CameraConfig.model_validate_json(camera))


def fine_rays(camera: CameraConfig) -> NDArray[np.float32]:
    """Rays (rows, columns, 2) of the fine samples; worked out on a mesh and interpolated."""
    return _fine_rays(camera.model_dump_json())


def _make_rays(camera: CameraConfig) -> NDArray[np.float32]:
    columns, rows = (-(-side // MESH_PX) + 2 for side in (camera.width_px, camera.height_px))
    # nodes in the middle of cells, one cell more all around
    u, v = (MESH_PX * (np.arange(n) - 1.0) + 0.5 * (MESH_PX - 1) for n in (columns, rows))
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    matrix = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    undo = cv2.fisheye.undistortPoints if camera.projection == "fisheye" else cv2.undistortPoints
    ideal = undo(pixels, matrix, np.array(camera.distortion), criteria=criteria)
    cell = MESH_PX * FINER
    mesh = np.asarray(ideal).reshape(rows, columns, 2).astype(np.float32)
    full = cv2.resize(mesh, (columns * cell, rows * cell), interpolation=cv2.INTER_LINEAR)
    kept = full[cell : cell + FINER * camera.height_px, cell : cell + FINER * camera.width_px]
    return np.ascontiguousarray(kept, dtype=np.float32)


@lru_cache(maxsize=24)
def _texture(board: str, texels_per_m: float, margin_m: float) -> NDArray[np.float32]:
    made = CalibrationBoard.model_validate_json(board)
    width, height = (math.ceil((side + 2.0 * margin_m) * texels_per_m) for side in made.size_m)
    black = np.zeros((height, width), np.float32)
    for left, top, right, bottom in made.black_rectangles():
        across = covered(left + margin_m, right + margin_m, texels_per_m, width)
        down = covered(top + margin_m, bottom + margin_m, texels_per_m, height)
        black[np.ix_(down[0], across[0])] += np.outer(down[1], across[1]).astype(np.float32)
    return (WHITE + (BLACK - WHITE) * black).astype(np.float32)


def board_texture(board: CalibrationBoard, texels_per_m: float, margin_m: float) -> NDArray[np.float32]:
    """The print in grey, with a white margin."""
    return _texture(board.model_dump_json(), texels_per_m, margin_m)


def covered(
    low_m: float, high_m: float, texels_per_m: float, count: int
) -> tuple[NDArray[np.int64], FloatArray]:
    """Which texels of a row a stretch covers, and how much of each."""
    low, high = low_m * texels_per_m, high_m * texels_per_m
    which = np.arange(max(math.floor(low), 0), min(math.ceil(high), count), dtype=np.int64)
    share = np.minimum(which + 1, high) - np.maximum(which, low)
    return which, share.clip(0.0, 1.0)


def stroke(right: float, down: float) -> NDArray[np.float32]:
    """Kernel of a straight stroke through its middle, centred to the last digit."""
    half = math.ceil(0.5 * max(abs(right), abs(down))) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    for t in (np.arange(33) + 0.5) / 33 - 0.5:
        x, y = half + t * right, half + t * down
        j, i = int(x), int(y)
        for dj, di in ((0, 0), (1, 0), (0, 1), (1, 1)):
            kernel[i + di, j + dj] += (1 - abs(x - j - dj)) * (1 - abs(y - i - di))
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


def hand_held_poses(
    board: CalibrationBoard,
    camera: CameraConfig,
    count: int,
    rng: np.random.Generator,
    tilt_deg: float = 45.0,
) -> list[BoardPose]:
    """A board held by hand: all over the image, tilted to all sides, near and far, turned a little."""
    width_m, height_m = board.size_m
    middle = np.array((0.5 * width_m, 0.5 * height_m, 0.0))
    places = np.array([(x, y) for y in (0.22, 0.5, 0.78) for x in (0.2, 0.4, 0.6, 0.8)])
    poses = []
    for k in range(count):
        share = rng.uniform(0.35, 0.75)
        distance_m = camera.fx_px * width_m / (share * camera.width_px)
        x, y = (places[(5 * k) % len(places)] + rng.uniform(-0.08, 0.08, 2)) * (
            camera.width_px,
            camera.height_px,
        )
        right, down = (x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px
        at = distance_m * np.array((right, down, 1.0))
        if camera.projection == "fisheye":  # these are angles then; as near there as in the middle
            angle = math.hypot(right, down)
            across = math.sin(angle) / angle
            at = distance_m * np.array((right * across, down * across, math.cos(angle)))
        axis, tilt = (
            rng.uniform(0.0, 2.0 * math.pi),
            math.radians(tilt_deg) * math.sqrt(rng.uniform(0.02, 1.0)),
        )
        aslant, _ = cv2.Rodrigues(tilt * np.array((math.cos(axis), math.sin(axis), 0.0)))
        roll, _ = cv2.Rodrigues(np.array((0.0, 0.0, rng.normal(0.0, 0.3))))
        turn = np.asarray(aslant @ roll)
        poses.append(
            BoardPose(np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64).ravel(), at - turn @ middle)
        )
    return poses


def tour_poses(
    board: CalibrationBoard, camera: CameraConfig, tilt_deg: float = 28.0, width_share: float = 0.5
) -> list[BoardPose]:
    """A board that is led all over the image, each time with another edge away: what the hints ask for."""
    tilts = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (0.0, 0.0)]
    places = [(x, y) for x in (0.14, 0.32, 0.5, 0.68, 0.86) for y in (0.16, 0.5, 0.84)]
    width_m, height_m = board.size_m
    middle = np.array((0.5 * width_m, 0.5 * height_m, 0.0))
    poses = []
    for k, (x, y) in enumerate(places):
        distance_m = camera.fx_px * width_m / (width_share * camera.width_px) * (1.0 + 0.25 * (k % 3))
        ray = (
            (x * camera.width_px - camera.cx_px) / camera.fx_px,
            (y * camera.height_px - camera.cy_px) / camera.fy_px,
        )
        tilt = math.radians(tilt_deg) * np.array((*tilts[k % 5], 0.0))
        turn = np.asarray(cv2.Rodrigues(tilt)[0])
        poses.append(BoardPose(tilt, distance_m * np.array((*ray, 1.0)) - turn @ middle))
    return poses


def ideal_view(
    painter: BoardPainter, pose: BoardPose, rng: np.random.Generator, noise_px: float, name: str
) -> BoardView:
    """A view without a picture: where the board's points are, and noise; only what is inside the image."""
    points = painter.board.points_m
    pixels = painter.project(points, pose)
    inside = ((pixels > 2.0) & (pixels < (painter.camera.width_px - 3, painter.camera.height_px - 3))).all(
        axis=1
    )
    ids = np.flatnonzero(inside)
    return BoardView(name, ids, points[ids], pixels[ids] + rng.normal(0.0, noise_px, (len(ids), 2)), 2.2)
