"""The calibrated lens: pixels to rays and back (eqs. 2 and 3).

Camera axes as OpenCV has them: x right in the image, y down, z along the optical axis. A ray is given by
its ideal image coordinates (x/z, y/z), without unit.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from companion.config import CameraConfig
from companion.geometry import FloatArray

# beyond this tangent of the angle to the axis the polynomial of a calibration means nothing
MAXIMUM_TANGENT: Final = 1.2
NEAREST_M: Final = 0.02


class Lens:
    """Undoes and applies one camera's distortion."""

    def __init__(self, camera: CameraConfig) -> None:
        self.focal_px = 0.5 * (camera.fx_px + camera.fy_px)
        self.readout_s = camera.readout_s
        self.size_px = (camera.width_px, camera.height_px)
        self._scale = np.array([camera.fx_px, camera.fy_px])
        self._centre = np.array([camera.cx_px, camera.cy_px])
        self._matrix = np.array(
            [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]]
        )
        self._distortion = np.array(camera.distortion)
        self._criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-9)

    def undistort(self, pixels: FloatArray) -> FloatArray:
        """Rays (n, 2) of pixels (n, 2)."""
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        rays = cv2.undistortPoints(points, self._matrix, self._distortion, criteria=self._criteria)
        return np.asarray(rays, dtype=np.float64).reshape(-1, 2)

    def project(self, points_camera_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (n, 2) of points (n, 3), and depths (n,); pixels are NaN where the lens cannot see.

        That is behind the camera, nearer than 2 cm or far off the axis.
        """
        depth = points_camera_m[:, 2]
        ideal = points_camera_m[:, :2] / np.maximum(depth, NEAREST_M)[:, None]
        seen = (depth > NEAREST_M) & (np.einsum("ij,ij->i", ideal, ideal) < MAXIMUM_TANGENT**2)
        pixels = self._distort(ideal) * self._scale + self._centre
        return np.where(seen[:, None], pixels, np.nan), depth

    def _distort(self, ideal: FloatArray) -> FloatArray:
        k1, k2, p1, p2, k3, *denominator = (float(k) for k in self._distortion)
        x, y = ideal[:, 0], ideal[:, 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if denominator:  # the rational model's
            k4, k5, k6 = denominator
            radial = radial / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return np.column_stack(
            (
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            )
        )
