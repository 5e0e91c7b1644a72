"""What `calibrate-camera` does: print a board, or collect views, calibrate, judge and write."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
import typer
import yaml

from calibration.camera import NAME
from calibration.camera.board import CalibrationBoard, Surface, board_yaml, write_board
from calibration.camera.capture import CameraCalibrationJob, capture_live
from calibration.camera.encoding import MeasuredEncoding, measure_encoding
from calibration.camera.gathering import BOARD_FILE, CollectedViews, views_of_photos
from calibration.camera.quality import Assessment, assess
from calibration.camera.solver import UnsolvableError
from calibration.command_line import RefusedError, today
from companion import __version__
from companion.base.files import make_folder, must_be_writable, write_atomically
from companion.base.printing.paper import PaperName
from companion.base.signals import run_until_stopped
from companion.config import CameraConfig, CaptureConfig, ConfigError, validate, without_password
from companion.config.calibration import CameraCalibration, Provenance
from companion.sense.camera.source import is_camera


def print_board(board: CalibrationBoard, output: Path, paper: PaperName) -> None:
    """Write the board's PDF, PNG and YAML."""
    must_be_writable("--make-board", output)
    for path in write_board(board, output, paper):
        typer.echo(f"{path}: {board.text}")


def calibrate_camera(job: CameraCalibrationJob, board: CalibrationBoard) -> None:
    """Collect views, calibrate, judge and write."""
    must_be_writable("--output", job.output, ".yaml")
    if job.plots is not None:
        must_be_writable("--plots", make_folder("--plots", job.plots) / "errors.png")
    # an earlier attempt that took no picture has left its board there
    if job.keep is not None and any(p.name != BOARD_FILE for p in make_folder("--keep", job.keep).iterdir()):
        raise ConfigError(f"--keep {job.keep}: holds files already; expected a new or empty folder")
    capture = job.capture
    if any(is_camera(source) for source in job.sources):
        if len(job.sources) > 1:
            raise ConfigError(f"{' '.join(job.sources)}: expected one camera alone, or photos")
        found = _live(job, board)
    else:
        if job.sized:
            raise ConfigError("--size: only for a live camera; photos have their own size")
        found = views_of_photos(board, [Path(s) for s in job.sources], job.keep, typer.echo)
        sized = {"width_px": found.size_px[0], "height_px": found.size_px[1]}
        capture = validate(CaptureConfig, {**capture.model_dump(), **sized}, found.source)
    _finish(job, found, board, capture)


def _live(job: CameraCalibrationJob, board: CalibrationBoard) -> CollectedViews:
    if job.keep is not None:
        write_atomically(job.keep / BOARD_FILE, board_yaml(board))
    typer.echo(f"looking for {board.text}")
    session = run_until_stopped(capture_live(board, job, typer.echo))
    return CollectedViews(session.views, session.size_px, without_password(job.sources[0]))


def _finish(
    job: CameraCalibrationJob, found: CollectedViews, board: CalibrationBoard, capture: CaptureConfig
) -> None:
    try:
        result = assess(found.views, found.size_px, board.surface, job.model)
    except UnsolvableError as error:
        raise RefusedError(f"{found.source}: {error}") from error
    for line in summary_lines(result):
        typer.echo(line)
    encoding = measure_encoding([view.edges for view in found.views])
    typer.echo("encoding: not measured, taken for sRGB" if encoding is None else encoding.text)
    refused = result.reasons and not job.force
    if not refused:  # before its pictures: what they may end in must not cost it
        camera = camera_config(result, board, capture, found.source, encoding)
        write_atomically(job.output, camera_yaml(camera))
    if job.plots is not None:
        from calibration.camera.plots import write_plots  # noqa: PLC0415 - matplotlib is slow

        write_plots(job.plots, result, board)
        typer.echo(f"plots in {job.plots}")
    if refused:
        raise RefusedError("; ".join(result.reasons))
    for reason in result.reasons:
        typer.echo(f"not good enough: {reason}")
    good = f"good; name it in the app's settings: camera: {job.output}"
    typer.echo(f"{job.output}: {'written by force' if result.reasons else good}")


# ---------------------------------------------------------------- result

NAMES: Final = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE_NAMES: Final = ("k1", "k2", "k3", "k4")
WORST_VIEWS: Final = 3
# a grid whose markers are as much larger than specified was measured wrongly; less may be ink and light
WRONG_SPREAD: Final = 0.03


def camera_config(
    found: Assessment,
    board: CalibrationBoard,
    capture: CaptureConfig,
    source: str,
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
            tool=f"{NAME} {__version__}",
            source=source,
            date=today(),
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
    if solution.camera.model == "fisheye":
        numbers["projection"] = "fisheye"
    measured = {}
    if encoding is not None:
        measured = {"encoding": encoding.encoding, "encoding_error": float(f"{encoding.error:.2g}")}
    data = {**capture.model_dump(), **numbers, **measured, "calibration": made.model_dump()}
    return validate(CameraConfig, data, "calibration")


def _distortion_names(count: int) -> tuple[str, ...]:
    return FISHEYE_NAMES if count == len(FISHEYE_NAMES) else NAMES[4 : 4 + count]


def camera_yaml(camera: CameraConfig) -> str:
    assert camera.calibration is not None
    words = ", ".join(_distortion_names(len(camera.distortion)))
    forced = (
        "# NOT GOOD ENOUGH, written by force: see calibration.verdict\n" if camera.calibration.verdict else ""
    )
    head = f"# Written by calibrate-camera from {camera.calibration.board}. distortion: {words}\n"
    body: Any = camera.model_dump(mode="json")
    return forced + head + yaml.safe_dump(body, sort_keys=False, default_flow_style=None, allow_unicode=True)


def summary_lines(found: Assessment) -> list[str]:
    solution, std = found.solution, found.uncertainty.std
    camera = solution.camera
    lines = [
        f"{name} = {value:.2f} ± {deviation:.2f} px"
        for name, value, deviation in zip(NAMES[:4], camera.numbers[:4], std[:4], strict=True)
    ]
    lines += [
        f"{name} = {value:.5f} ± {deviation:.5f}"
        for name, value, deviation in zip(
            _distortion_names(len(camera.distortion)), camera.distortion, std[4:], strict=True
        )
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
