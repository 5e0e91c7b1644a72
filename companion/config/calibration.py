"""What the calibration tools write and the app reads."""

from __future__ import annotations

from pydantic import Field

from companion.config.reading import StrictModel


class Provenance(StrictModel):
    """Where a calibration comes from, for whoever wonders in a year; nothing is reckoned with it."""

    tool: str
    """Program and version"""
    source: str
    """Device, connection or file that the samples came from"""
    date: str
    """ISO 8601, UTC, of the calibration"""
    samples: int = Field(ge=0)
    """Samples used"""
    dropped: int = Field(default=0, ge=0)
    """Samples left out as outliers"""


class CameraCalibration(StrictModel):
    """How good a camera's calibration is, and where it comes from; nothing is reckoned with it.

    Reprojection errors are root mean squares of the distances in the image; standard deviations are those
    of the camera's own numbers, in their order.
    """

    provenance: Provenance
    board: str
    """The board that was shown"""
    board_bow_m: float = Field(ge=0.0)
    """Deviation of the board from flat, as found"""
    corners: int = Field(ge=0)
    """Corners used"""
    corners_dropped: int = Field(default=0, ge=0)
    """Corners of the used views that were left out as outliers"""
    rms_px: float = Field(ge=0.0)
    """Reprojection error of the corners used"""
    rms_all_px: float = Field(ge=0.0)
    """Reprojection error of all corners, outliers too"""
    held_out_rms_px: float | None = Field(ge=0.0)
    """Reprojection error of views kept back"""
    fx_std_px: float = Field(ge=0.0)
    """Standard deviation of fx_px"""
    fy_std_px: float = Field(ge=0.0)
    """Standard deviation of fy_px"""
    cx_std_px: float = Field(ge=0.0)
    """Standard deviation of cx_px"""
    cy_std_px: float = Field(ge=0.0)
    """Standard deviation of cy_px"""
    distortion_std: tuple[float, ...]
    """Standard deviation of each distortion coefficient"""
    projection_std_px: float = Field(ge=0.0)
    """Uncertainty of an image point's direction where it is largest in the image"""
    coverage: float = Field(ge=0.0, le=1.0)
    """Share of the image where corners were seen"""
    largest_tilt_deg: float = Field(ge=0.0, le=90.0)
    """Largest tilt of the board"""
    verdict: tuple[str, ...] = Field(default=())
    """Why it would have been refused; it was written with --force"""
