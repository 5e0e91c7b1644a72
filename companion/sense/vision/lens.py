"""The calibrated lens: pixels to rays and back (eqs. 2 and 3).

Camera axes as OpenCV has them: x right in the image, y down, z along the optical axis. A ray is given by
its ideal image coordinates (x/z, y/z), without unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.encoding import decoding_table
from companion.base.geometry import FloatArray
from companion.config import CameraConfig
from companion.sense.vision.edges import NEXT

# a lens is trusted up to this tangent of the angle to the axis, and farther where its image is wider, but
# nowhere beyond the angle from which on its polynomial turns back: that would fold the pad into the image
USUAL_TANGENT: Final = 1.2
WIDEST_TANGENT: Final = 4.0
TANGENT_STEP: Final = 0.01
NEAREST_M: Final = 0.02
FISHEYE: Final = 4  # numbers of distortion
NEAR_AXIS: Final = 1e-9
SLOPE_STEP: Final = 1e-5
# codes are read in light to this power. In light itself white blurs into black as far as black into white,
# but a deep shadow is lost; in sRGB (0.45) white blurs so much farther that black cells of 3 px are
LEGIBLE: Final = 0.8


def radial_factor(distortion: Sequence[float], squared: FloatArray) -> FloatArray:
    """By how much the lens stretches rays whose ideal image coordinates have these squared lengths (eq. 3).

    `distortion` is k1 k2 p1 p2 k3, and for the rational model k4 k5 k6; of a fisheye k1 k2 k3 k4.
    """
    if len(distortion) == FISHEYE:
        tangent = np.sqrt(np.maximum(squared, NEAR_AXIS**2))
        return fisheye_radius(distortion, np.arctan(tangent)) / tangent
    k1, k2, _, _, k3, *denominator = distortion
    factor = 1.0 + squared * (k1 + squared * (k2 + squared * k3))
    if denominator:
        k4, k5, k6 = denominator
        factor = factor / (1.0 + squared * (k4 + squared * (k5 + squared * k6)))
    return factor


def fisheye_radius(distortion: Sequence[float], angle_rad: FloatArray) -> FloatArray:
    """How far off the middle (in focal lengths) a fisheye draws what is seen at these angles to the axis.

    t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8): Kannala and Brandt, IEEE PAMI 28 (2006), as OpenCV has it.
    """
    k1, k2, k3, k4 = distortion
    t2 = angle_rad * angle_rad
    return np.asarray(angle_rad * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))))


class Lens:
    """Undoes and applies one camera's distortion, and what it makes of light.

    `light` (256,) is the light of each grey value, 255 at most, and `encoding_error` by which share its
    exponent may be off. `legible` (256,) are the grey values in which codes are read.
    """

    def __init__(self, camera: CameraConfig) -> None:
        self.focal_px = 0.5 * (camera.fx_px + camera.fy_px)
        self.readout_s = camera.readout_s
        self.light = decoding_table(camera.encoding)
        self.encoding_error = camera.encoding_error
        self.legible = np.rint(255.0 * (self.light / 255.0) ** LEGIBLE).astype(np.uint8)
        self.size_px = (camera.width_px, camera.height_px)
        self._scale = np.array([camera.fx_px, camera.fy_px])
        self._centre = np.array([camera.cx_px, camera.cy_px])
        self._matrix = np.array(
            [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]]
        )
        self.fisheye = camera.projection == "fisheye"
        self._distortion = np.array(camera.distortion)
        self._coefficients = self._distortion.tolist()
        self._farthest = self._farthest_tangent()
        self._criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-9)

    def check(self, image: NDArray[np.uint8]) -> None:
        """Is the image of the calibrated camera's size?

        Raises:
            ValueError: it is not.
        """
        height, width = image.shape
        if (width, height) != self.size_px:
            expected = "x".join(str(n) for n in self.size_px)
            raise ValueError(f"frame of {width}x{height}, the calibration is for {expected}")

    def undistort(self, pixels: FloatArray) -> FloatArray:
        """Rays (n, 2) of pixels (n, 2)."""
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        if self.fisheye:
            rays = cv2.fisheye.undistortPoints(
                points, self._matrix, self._distortion, criteria=self._criteria
            )
        else:
            rays = cv2.undistortPoints(points, self._matrix, self._distortion, criteria=self._criteria)
        return np.asarray(rays, dtype=np.float64).reshape(-1, 2)

    def project(self, points_camera_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (n, 2) of points (n, 3), and depths (n,); pixels are NaN where the lens cannot see.

        That is behind the camera, nearer than 2 cm or farther off the axis than the lens is known.
        """
        depth = points_camera_m[:, 2]
        ideal = points_camera_m[:, :2] / np.maximum(depth, NEAREST_M)[:, None]
        seen = (depth > NEAREST_M) & (np.einsum("ij,ij->i", ideal, ideal) < self._farthest**2)
        pixels = self._pixels(ideal)
        pixels[~seen] = np.nan
        return pixels, depth

    def bows(self, quads: FloatArray) -> FloatArray:
        """How far (m, 4) px outwards a straight side's middle is from between its corners (m, 4, 2) px."""
        rays = self.undistort(quads.reshape(-1, 2)).reshape(-1, 4, 2)
        middles = 0.5 * (rays + rays.take(NEXT, axis=1))
        after = quads.take(NEXT, axis=1)
        u, v = (after - quads).reshape(-1, 2).T
        away = self._pixels(middles.reshape(-1, 2)) - 0.5 * (quads + after).reshape(-1, 2)
        cross = away[:, 0] * v - away[:, 1] * u
        return np.asarray(cross / np.maximum(np.sqrt(u * u + v * v), 1.0)).reshape(-1, 4)

    def slopes(self, rays: FloatArray) -> FloatArray:
        """How pixels move with rays (n, 2): (n, 2, 2), d pixel / d ray."""
        steps = SLOPE_STEP * np.eye(2)
        apart = [self._distort(rays + step) - self._distort(rays - step) for step in steps]
        return np.asarray(np.stack(apart, axis=2) * self._scale[:, None] / (2.0 * SLOPE_STEP))

    def _pixels(self, ideal: FloatArray) -> FloatArray:
        """Pixels (n, 2) of ideal image coordinates (n, 2)."""
        pixels = self._distort(ideal)
        pixels *= self._scale
        pixels += self._centre
        return pixels

    def _distort(self, ideal: FloatArray) -> FloatArray:
        x, y = ideal.T
        xx, yy = x * x, y * y
        r2 = xx + yy
        distorted = ideal * radial_factor(self._coefficients, r2)[:, None]
        if not self.fisheye:
            _, _, p1, p2, *_ = self._coefficients
            by_x, by_y = distorted.T
            by_x += 2.0 * p1 * x * y
            by_x += p2 * (r2 + 2.0 * xx)
            by_y += p1 * (r2 + 2.0 * yy)
            by_y += 2.0 * p2 * x * y
        return distorted

    def _farthest_tangent(self) -> float:
        """Up to where the calibration means something."""
        tangents = np.arange(0.0, WIDEST_TANGENT, TANGENT_STEP)
        images = tangents * radial_factor(self._coefficients, tangents**2)
        corners = np.array([(u, v) for u in (0, self.size_px[0]) for v in (0, self.size_px[1])])
        reach = np.linalg.norm((corners - self._centre) / self._scale, axis=1).max()
        turns_back = np.append(np.flatnonzero(np.diff(images) <= 0.0), len(tangents) - 1)[0]
        needed = np.append(np.flatnonzero(images >= reach), len(tangents) - 1)[0]
        return float(min(tangents[turns_back], max(USUAL_TANGENT, tangents[needed])))
