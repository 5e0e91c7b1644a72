"""The camera in Foxglove's messages: calibration, frames, and the markers where the pose has them."""

import base64
from typing import Final, NamedTuple

import cv2
import numpy as np

from companion.base.geometry import FloatArray, matrix_from_quat
from companion.base.messages import Frame, PadSighting
from companion.config import CameraConfig, VehicleConfig
from companion.flightlog.foxglove.parts import CAMERA, Plain, WellKnown, colour, stamp
from companion.pad import Pad
from companion.sense.vision.lens import Lens
from companion.sense.vision.pipeline import body_from_camera

JPEG_QUALITY: Final = 85
# OpenCV's four coefficients of a fisheye, its five, and its eight
DISTORTION_MODELS: Final = {4: "kannala_brandt", 5: "plumb_bob", 8: "rational_polynomial"}
MARKER_COLOUR: Final = colour(0.18, 0.8, 0.44)
PAD_COLOUR: Final = colour(0.95, 0.61, 0.07)
LINE_PX: Final = 2.0
TEXT_PX: Final = 12.0
LINE_LOOP: Final = 2


def image(frame: Frame, exposure_unix_ns: int) -> WellKnown:
    _, jpeg = cv2.imencode(".jpg", frame.image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    message = {
        "timestamp": stamp(exposure_unix_ns),
        "frame_id": CAMERA,
        "data": base64.b64encode(jpeg.tobytes()).decode("ascii"),
        "format": "jpeg",
    }
    return WellKnown("camera", "foxglove.CompressedImage", message)


def calibration(unix_ns: int, camera: CameraConfig) -> WellKnown:
    fx, fy, cx, cy = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    message = {
        "timestamp": stamp(unix_ns),
        "frame_id": CAMERA,
        "width": camera.width_px,
        "height": camera.height_px,
        "distortion_model": DISTORTION_MODELS[len(camera.distortion)],
        "D": list(camera.distortion),
        "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    return WellKnown("camera/calibration", "foxglove.CameraCalibration", message)


def nothing_seen(exposure_unix_ns: int) -> WellKnown:
    """The annotations of a frame without the pad: none, which takes away those before."""
    message: Plain = {"timestamp": stamp(exposure_unix_ns), "points": [], "texts": []}
    return WellKnown("camera/annotations", "foxglove.ImageAnnotations", message)


class Outline(NamedTuple):
    """Four corners (4, 2) px in the image: a marker's with its id, or the pad's edge without."""

    corners_px: FloatArray
    marker_id: int | None


class CameraAnnotations:
    """Draws a sighting into its frame: the used markers and the pad's edge, by the pose and the lens."""

    def __init__(self, camera: CameraConfig, vehicle: VehicleConfig, pad: Pad) -> None:
        self._lens, self._pad = Lens(camera), pad
        self._rotation = matrix_from_quat(body_from_camera(vehicle))
        self._mount = np.array(vehicle.camera_position_body_m)

    def annotations(self, sighting: PadSighting, exposure_unix_ns: int) -> WellKnown:
        """Outlines and ids for the frame that was exposed then."""
        drawn = nothing_seen(exposure_unix_ns)
        for corners_px, marker_id in self.outlines(sighting):
            tint = PAD_COLOUR if marker_id is None else MARKER_COLOUR
            points = [{"x": float(u), "y": float(v)} for u, v in corners_px]
            drawn.message["points"].append(
                {
                    "timestamp": stamp(exposure_unix_ns),
                    "type": LINE_LOOP,
                    "points": points,
                    "outline_color": tint,
                    "thickness": LINE_PX,
                }
            )
            if marker_id is not None:
                label = {"timestamp": stamp(exposure_unix_ns), "position": points[0], "text": str(marker_id)}
                drawn.message["texts"].append({**label, "font_size": TEXT_PX, "text_color": tint})
        return drawn

    def outlines(self, sighting: PadSighting) -> list[Outline]:
        """The pad's edge and the used markers, where the pose has them; what leaves the lens is left out."""
        used = set(sighting.marker_ids)
        shown = [m for m in self._pad.markers if m.group == sighting.group and m.id in used]
        turn, place = matrix_from_quat(sighting.body_from_pad), np.array(sighting.pad_position_body_m)
        found = [
            Outline(self.pixels(corners_m @ turn.T + place), marker_id)
            for corners_m, marker_id in [
                (self._pad.corners_pad_m(), None),
                *((m.corners_pad_m(), m.id) for m in shown),
            ]
        ]
        return [outline for outline in found if np.isfinite(outline.corners_px).all()]

    def pixels(self, points_body_m: FloatArray) -> FloatArray:
        """Where points (n, 3) in body axes are in the image: (n, 2) px, NaN where the lens cannot see."""
        return self._lens.project(self._in_camera(points_body_m))[0]

    def beyond(self, point_body_m: FloatArray) -> FloatArray:
        """For a point (3,) that the lens cannot see: a place (2,) px outside the image, on the way to it."""
        across = self._in_camera(point_body_m)[:2]
        size = np.array(self._lens.size_px)
        return np.asarray(0.5 * size + size.sum() * across / max(float(np.hypot(*across)), 1e-9))

    def _in_camera(self, points_body_m: FloatArray) -> FloatArray:
        return np.asarray((points_body_m - self._mount) @ self._rotation)
