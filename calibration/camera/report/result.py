"""What a camera's calibration leaves: the YAML that the app reads, and lines for a person. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import yaml

from calibration.camera.board.board import CalibrationBoard
from calibration.camera.board.surface import Surface
from calibration.camera.solve.encoding import MeasuredEncoding
from calibration.camera.solve.quality import Assessment
from companion.config import CameraConfig, CaptureConfig, validate
from companion.config.calibration import CameraCalibration, Provenance

NAMES: Final = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
WORST_VIEWS: Final = 3
# a grid whose markers are as much larger than specified was measured wrongly; less may be ink and light
WRONG_SPREAD: Final = 0.03


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the pictures came from, when, and what worked them out."""

    tool: str
    source: str
    date: str


def camera_config(
    found: Assessment,
    board: CalibrationBoard,
    capture: CaptureConfig,
    origin: Origin,
    encoding: MeasuredEncoding | None = None,
) -> CameraConfig:
    """The camera as the app reads it; without a measured encoding it has the settings' own.

    Raises:
        ConfigError: numbers that no camera has.
    """
    solution = found.solution
    fx, fy, cx, cy, *distortion = (float(f"{x:.8g}") for x in solution.camera.numbers)
    std = [float(f"{x:.3g}") for x in found.uncertainty.std]
    made = CameraCalibration(
        provenance=Provenance(
            tool=origin.tool,
            source=origin.source,
            date=origin.date,
            samples=len(solution.seen),
            dropped=len(solution.dropped_views),
        ),
        board=board.text,
        board_bow_m=round(solution.surface.bow_m, 6),
        corners=len(solution.errors_px),
        corners_dropped=solution.dropped_corners,
        rms_px=round(found.rms_px, 4),
        rms_all_px=round(found.rms_all_px, 4),
        held_out_rms_px=None if found.held_out_rms_px is None else round(found.held_out_rms_px, 4),
        fx_std_px=std[0],
        fy_std_px=std[1],
        cx_std_px=std[2],
        cy_std_px=std[3],
        distortion_std=tuple(std[4:]),
        projection_std_px=float(f"{found.projection_std_px.max():.3g}"),
        coverage=round(found.coverage.share, 3),
        largest_tilt_deg=round(found.coverage.largest_tilt_deg, 1),
        verdict=found.reasons,
    )
    numbers = {"fx_px": fx, "fy_px": fy, "cx_px": cx, "cy_px": cy, "distortion": tuple(distortion)}
    measured = {}
    if encoding is not None:
        measured = {"encoding": encoding.encoding, "encoding_error": float(f"{encoding.error:.2g}")}
    data = {**capture.model_dump(), **numbers, **measured, "calibration": made.model_dump()}
    return validate(CameraConfig, data, "calibration")


def camera_yaml(camera: CameraConfig) -> str:
    """The file's text."""
    assert camera.calibration is not None
    words = ", ".join(NAMES[4 : 4 + len(camera.distortion)])
    forced = (
        "# NOT GOOD ENOUGH, written by force: see calibration.verdict\n" if camera.calibration.verdict else ""
    )
    head = f"# Written by calibrate-camera from {camera.calibration.board}. distortion: {words}\n"
    body: Any = camera.model_dump(mode="json")
    return forced + head + yaml.safe_dump(body, sort_keys=False, default_flow_style=None, allow_unicode=True)


def summary_lines(found: Assessment) -> list[str]:
    """The result for a person, a line each."""
    solution, std = found.solution, found.uncertainty.std
    camera = solution.camera
    lines = [
        f"{name} = {value:.2f} ± {deviation:.2f} px"
        for name, value, deviation in zip(NAMES[:4], camera.numbers[:4], std[:4], strict=True)
    ]
    lines += [
        f"{name} = {value:.5f} ± {deviation:.5f}"
        for name, value, deviation in zip(NAMES[4:], camera.distortion, std[4:], strict=False)
    ]
    held = found.held_out_rms_px
    lines.append(
        f"reprojection error (rms): {found.rms_px:.3f} px of {len(solution.errors_px)} corners in "
        f"{len(solution.seen)} views; {found.rms_all_px:.3f} with outliers"
        + ("" if held is None else f"; {held:.3f} on views held out")
    )
    if solution.dropped_corners:
        lines.append(f"left out as outliers: {solution.dropped_corners} corners")
    lines += [f"{name}: left out: does not fit the others" for name in solution.dropped_views]
    worst = sorted(solution.seen, key=lambda s: -s.rms_px)[:WORST_VIEWS]
    lines.append("largest errors: " + ", ".join(f"{s.view.name} {s.rms_px:.3f} px" for s in worst))
    lines.append(
        f"seen in {100 * found.coverage.share:.0f} % of the image, tilted by up to "
        f"{found.coverage.largest_tilt_deg:.0f}°; the board is bowed by {1e3 * solution.surface.bow_m:.2f} mm"
    )
    lines += _marker_lines(solution.surface)
    lines.append(
        f"what is seen is certain to {np.median(found.projection_std_px):.2f} px (median over the image), "
        f"{found.projection_std_px.max():.2f} px at worst"
    )
    return lines


def _marker_lines(surface: Surface) -> list[str]:
    """How large a grid's markers were found to be, for whoever measured the gap: the camera is right."""
    if surface.spread is None or surface.marker_m is None or not surface.spread:
        return []
    side, pitch = surface.marker_m
    line = f"the markers are {100 * surface.spread:+.1f} % larger than specified"
    if surface.gap_m is not None and abs(surface.spread) > WRONG_SPREAD:
        specified = 1e3 * (pitch - side)
        line += f": {1e3 * surface.gap_m:.1f} mm apart, if they are {1e3 * side:g}; specified {specified:g}"
    return [line]
