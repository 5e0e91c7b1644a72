"""The mesh on which the simulated camera follows rays: a node in the middle of each cell of 8 x 8 pixels.

One more row and column of nodes lies around the image, so that everything in it is between nodes. What is
smooth over a cell (texture coordinates, shade) is worked out at the nodes and interpolated.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.config import CameraConfig

NODE_PX: Final = 8
# a ray this close to the horizon (sine of its angle) or above it shows ground far away
HORIZON: Final = 0.02
WIDEST_RAD: Final = 1.5
TABLE: Final = 100_001  # places in the table of a fisheye: wrong by less than 1e-9
Part = tuple[int, int, int, int]


def node_rays(camera: CameraConfig) -> FloatArray:
    """Rays (rows, columns, 3), z = 1, of the nodes, the lens's distortion undone."""
    columns, rows = -(-camera.width_px // NODE_PX) + 2, -(-camera.height_px // NODE_PX) + 2
    u = NODE_PX * (np.arange(columns) - 1.0) + 0.5 * (NODE_PX - 1)
    v = NODE_PX * (np.arange(rows) - 1.0) + 0.5 * (NODE_PX - 1)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    rays = np.ones((rows, columns, 3))
    if camera.projection == "fisheye":
        centre, focal = np.array([camera.cx_px, camera.cy_px]), np.array([camera.fx_px, camera.fy_px])
        rays[..., :2] = _fisheye_rays((pixels[:, 0] - centre) / focal, camera.distortion).reshape(
            rows, columns, 2
        )
        return rays
    matrix = np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    ideal = cv2.undistortPoints(pixels, matrix, np.array(camera.distortion), criteria=criteria)
    rays[..., :2] = ideal.reshape(rows, columns, 2)
    return rays


def _fisheye_rays(places: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Rays (n, 2) of places (n, 2) in an image of focal length 1: by a table of the lens, angle to radius.

    What is drawn farther out than at `WIDEST_RAD` shows what is there: nearly the horizon.
    """
    angles = np.linspace(0.0, WIDEST_RAD, TABLE)
    terms = [angles ** (2 * power + 3) * k for power, k in enumerate(distortion)]
    radius = np.linalg.norm(places, axis=1)
    angle = np.interp(radius, angles + np.sum(terms, axis=0), angles)
    return np.asarray(places * (np.tan(angle) / np.maximum(radius, 1e-12))[:, None])


def pixels_of(nodes: FloatArray) -> NDArray[np.float32]:
    """Values at nodes (rows, columns, ...) interpolated to the pixels of all cells but the outermost."""
    size = (nodes.shape[1] * NODE_PX, nodes.shape[0] * NODE_PX)
    full = cv2.resize(nodes.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(full[NODE_PX:-NODE_PX, NODE_PX:-NODE_PX])


def nodes_of(part: Part) -> tuple[slice, slice]:
    """The mesh's rows and columns that its cells lie between."""
    top, bottom, left, right = part
    return slice(top, bottom + 2), slice(left, right + 2)


def within_board(nodes: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """How many texels (rows, columns) each of the nodes (2, rows, columns) is within a board's edge.

    Negative outside it; `shape` is the texture's.
    """
    u, v = nodes
    across = np.minimum(u + 0.5, shape[1] - 0.5 - u)
    return np.asarray(np.minimum(across, np.minimum(v + 0.5, shape[0] - 0.5 - v)))


def visible_part(nodes: FloatArray, shape: tuple[int, ...]) -> Part | None:
    """The rectangle of mesh cells (top, bottom, left, right; end exclusive) that may show the board.

    Cell k lies about node k + 1; `nodes` (2, rows, columns) are in texels. None: the board is out of view.
    """
    u, v = nodes
    inside = (u > -1.0) & (u < shape[1]) & (v > -1.0) & (v < shape[0])
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if rows.size == 0:
        return None
    last_row, last_column = nodes.shape[1] - 2, nodes.shape[2] - 2
    return (
        max(0, int(rows[0]) - 2),
        min(last_row, int(rows[-1]) + 1),
        max(0, int(columns[0]) - 2),
        min(last_column, int(columns[-1]) + 1),
    )


def covers(nodes: FloatArray | None, shape: tuple[int, ...]) -> bool:
    """True when the board fills the image (a convex board holds all nodes when it holds the corners)."""
    if nodes is None:
        return False
    u, v = corners = nodes[:, [0, 0, -1, -1], [0, -1, 0, -1]]
    return bool((corners >= 1.0).all() and (u <= shape[1] - 2).all() and (v <= shape[0] - 2).all())
