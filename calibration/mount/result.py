"""What `calibrate-mount camera` does: a recording in, the mount file and its plots out."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import typer
import yaml

from calibration.command_line import RefusedError, listed, today
from calibration.mount import NAME
from calibration.mount.model import ACCEL_MATRIX, GYRO_BIAS, GYRO_MATRIX, POSITION, MountPrior, log
from calibration.mount.plots import write_mount_plots
from calibration.mount.recording import MountRecording, read_recording
from calibration.mount.solver import WIDEST_OFFSET_S, MountSolution, NoSolutionError, solve
from companion import __version__
from companion.base.files import write_atomically
from companion.base.geometry import (
    BODY_FROM_DOWNWARD_CAMERA,
    FloatArray,
    Vector3,
    euler_from_quat,
    matrix_from_quat,
    quat_conjugate,
    quat_from_matrix,
    quat_multiply,
    vector3,
)
from companion.config import CameraConfig, MountCalibration, MountStd, StrictModel, load_model
from companion.config.calibration import Provenance
from companion.sense.vision.pipeline import body_from_camera


def solve_mount(
    log: Path,
    output: Path,
    lens: Path | None,
    plots: Path | None,
    position_std_m: float,
    max_rotation_deg: float,
    *,
    force: bool,
) -> None:
    """Solve, show, judge and write; `lens` is a camera file to use instead of the recording's."""
    recording = read_recording(log, None if lens is None else load_model(CameraConfig, lens))
    place = np.array(recording.vehicle.camera_position_body_m)
    prior = prior_of(recording, position_std_m)
    try:
        found = solve(recording.inertial, recording.sightings, place, shutter_s(recording), prior)
    except NoSolutionError as error:
        raise RefusedError(f"{log}: {error}") from error
    configured = configured_rotation(recording)
    against = reasons(found, configured, place, max_rotation_deg)
    calibration = mount_calibration(found, recording, against, today())
    for line in mount_lines(calibration, found, recording):
        typer.echo(line)
    if not against or force:  # before its pictures: what they may end in must not cost it
        write_file(output, calibration, "mount: {}")
    if plots is not None:
        pictures = write_mount_plots(plots, found, recording.inertial, configured)
        typer.echo(f"pictures      {', '.join(str(path) for path in pictures)}")
    judge(against, force=force)


def judge(against: tuple[str, ...], *, force: bool) -> None:
    """Say the verdict.

    Raises:
        RefusedError: something speaks against it, and it is not forced.
    """
    if against and not force:
        raise RefusedError("; ".join(against))
    for reason in against:
        typer.echo(f"forced, though: {reason}")
    if not against:
        typer.echo("verdict       good")


def write_file(path: Path, calibration: StrictModel, setting: str) -> None:
    """Write a calibration; `setting` is a format of what the settings say then, for people.

    Raises:
        ConfigError: it cannot be written.
    """
    said = setting.format(path)
    text = yaml.safe_dump(calibration.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=110)
    write_atomically(path, f"# Written by {NAME}; the app reads it by the setting {said}\n{text}")
    typer.echo(f"written       {path}; the settings then say {said}")


# ---------------------------------------------------------------- result


def shutter_s(recording: MountRecording) -> float:
    """The time in which the camera's rolling shutter passes one focal length of the image."""
    camera = recording.camera
    return camera.fy_px * camera.readout_s / camera.height_px


def prior_of(recording: MountRecording, position_std_m: float) -> MountPrior:
    """The prior for this vehicle; a calibrated accelerometer has a smaller one."""
    prior = MountPrior(position_m=position_std_m, lens_rad=recording.config.sense.vision.scale_error)
    if recording.calibrated is None or recording.calibrated.accelerometer is None:
        return prior
    return replace(prior, accel_bias_m_s2=0.03, accel_scale=0.002)


def configured_rotation(recording: MountRecording) -> FloatArray:
    """Body from camera (3, 3) by the settings of the recording."""
    return matrix_from_quat(body_from_camera(recording.vehicle))


def camera_angles_deg(rotation: FloatArray) -> tuple[float, float, float]:
    """Roll, tilt and yaw (deg), as the vehicle's file has them, of a body-from-camera rotation (3, 3)."""
    turn = quat_multiply(quat_from_matrix(rotation), quat_conjugate(BODY_FROM_DOWNWARD_CAMERA))
    roll, tilt, yaw = (math.degrees(angle) for angle in euler_from_quat(turn))
    return roll, tilt, yaw


def provenance(source: str, date: str, used: int, dropped: int) -> Provenance:
    return Provenance(tool=f"{NAME} {__version__}", source=source, date=date, samples=used, dropped=dropped)


def mount_calibration(
    solution: MountSolution, recording: MountRecording, forced: tuple[str, ...], date: str
) -> MountCalibration:
    roll, tilt, yaw = camera_angles_deg(solution.unknowns.body_from_camera)
    rotation_std = np.degrees(np.sqrt(np.diag(solution.rotation_covariance)))
    used = int(solution.kept.sum())
    return MountCalibration(
        camera=recording.camera.name,
        camera_roll_deg=round(roll, 4),
        camera_tilt_deg=round(tilt, 4),
        camera_yaw_deg=round(yaw, 4),
        camera_position_body_m=_rounded(solution.position_m),
        time_offset_s=round(solution.time_offset_s, 5),
        std=MountStd(
            rotation_deg=_rounded(rotation_std),
            position_m=_rounded(solution.std(POSITION)),
            time_offset_s=round(solution.time_offset_std_s, 6),
        ),
        residual=round(solution.scatter, 3),
        forced=forced,
        provenance=provenance(recording.source, date, used, len(solution.kept) - used),
    )


def mount_lines(found: MountCalibration, solution: MountSolution, recording: MountRecording) -> list[str]:
    vehicle, std = recording.vehicle, found.std
    turned = np.degrees(rotation_from(solution, configured_rotation(recording)))
    before = (vehicle.camera_roll_deg, vehicle.camera_tilt_deg, vehicle.camera_yaw_deg)
    rows = [
        f"sightings     {found.provenance.samples} used, {found.provenance.dropped} dropped, in "
        f"{solution.segments} segments; they scatter by {solution.scatter:.2f} of what they say",
        f"roll, tilt, yaw of the camera  {found.camera_roll_deg:+.2f} {found.camera_tilt_deg:+.2f} "
        f"{found.camera_yaw_deg:+.2f} deg (settings: {before[0]:+.2f} {before[1]:+.2f} {before[2]:+.2f})",
        f"turned from the settings  {listed(turned, '+.2f')} deg about forward, right, down "
        f"(standard deviations {listed(std.rotation_deg, '.2f')})",
        f"position      {listed(found.camera_position_body_m, '+.3f')} m "
        f"(standard deviations {listed(std.position_m, '.3f')}; settings "
        f"{listed(vehicle.camera_position_body_m, '+.3f')})",
        f"time offset   {1e3 * found.time_offset_s:+.1f} ms, to be added to frames' stamps "
        f"(standard deviation {1e3 * std.time_offset_s:.1f})",
    ]
    if solution.std(POSITION).max() > 0.8 * solution.prior.position_m:
        rows.append("the position is the settings': the motion says no more of it")
    return [*rows, *(f"note: {note}" for note in recording.notes)]


def _rounded(values: FloatArray) -> Vector3:
    return vector3([round(float(v), 4) for v in values])


# ---------------------------------------------------------------- verdict
# Pure. Limits are in stated standard deviations, or far from what a good recording gives.

FEWEST_SIGHTINGS: Final = 120
FEWEST_SEGMENTS: Final = 6
LEAST_KEPT: Final = 0.5
MOST_ODD: Final = 0.25
MOST_ROTATION_STD_DEG: Final = 0.5
MOST_OFFSET_STD_S: Final = 0.003
MOST_SCATTER: Final = 4.0
MOST_CHANGE_DEG: Final = 0.7
MOST_CHANGE_S: Final = 0.003
MOST_SIGMA: Final = 4.5
LIKELY_BIAS_DEG_S: Final = 10.0
BODY_AXES: Final = ("forward", "right", "down")
WHAT_HELPS: Final = ("dip the nose and turn it", "roll and turn it", "roll it and dip the nose")


def rotation_from(solution: MountSolution, configured: FloatArray) -> FloatArray:
    """Rotation (3,) rad about the body axes from the configured camera rotation (3, 3) to the solution."""
    return log(solution.unknowns.body_from_camera @ configured.T)


def reasons(
    solution: MountSolution,
    configured: FloatArray,
    configured_position_m: FloatArray,
    most_rotation_deg: float,
) -> tuple[str, ...]:
    """Reasons to refuse it; empty if it is good."""
    return (
        *_amount(solution),
        *_certainty(solution),
        *_steadiness(solution),
        *_consistency(solution),
        *_plausible(solution, configured, configured_position_m, most_rotation_deg),
    )


def _amount(solution: MountSolution) -> Iterator[str]:
    used = int(solution.kept.sum())
    if used < FEWEST_SIGHTINGS or solution.segments < FEWEST_SEGMENTS:
        yield (
            f"too little was seen: {used} sightings in {solution.segments} segments of 2 s; expected "
            f"{FEWEST_SIGHTINGS} in {FEWEST_SEGMENTS} at least"
        )
    share = used / len(solution.kept)
    if share < LEAST_KEPT:
        yield (
            f"{100 * (1 - share):.0f} % of the sightings contradict the rest; expected less than "
            f"{100 * (1 - LEAST_KEPT):.0f} % (another pad than the settings', or a picture upside down?)"
        )
    if not solution.converged:
        yield "the fit did not converge; expected a longer recording with more motion"


def _certainty(solution: MountSolution) -> Iterator[str]:
    std_deg = np.degrees(np.sqrt(np.diag(solution.rotation_covariance)))
    worst = int(np.argmax(std_deg))
    if std_deg[worst] > MOST_ROTATION_STD_DEG:
        yield (
            f"too little motion: the rotation about {BODY_AXES[worst]} is known to {std_deg[worst]:.2f}° "
            f"only, expected {MOST_ROTATION_STD_DEG:g}°; {WHAT_HELPS[worst]} more"
        )
    if solution.time_offset_std_s > MOST_OFFSET_STD_S:
        yield (
            f"too slow a motion: the time offset is known to {1e3 * solution.time_offset_std_s:.1f} ms only, "
            f"expected {1e3 * MOST_OFFSET_STD_S:g} ms; turn it more quickly"
        )


def _steadiness(solution: MountSolution) -> Iterator[str]:
    if solution.odd_segments > MOST_ODD * solution.segments:
        yield (
            f"in {solution.odd_segments} of {solution.segments} segments most sightings contradict the "
            f"rest; expected {100 * MOST_ODD:.0f} % at most (did the camera or the pad slip meanwhile?)"
        )
    turned_deg = math.degrees(float(np.linalg.norm(solution.halves[:3])))
    if turned_deg > MOST_CHANGE_DEG:
        yield (
            f"the first half of the recording has the camera turned by {turned_deg:.1f}° from the second; "
            f"expected {MOST_CHANGE_DEG:g}° at most (did the camera or the pad slip meanwhile?)"
        )
    if abs(solution.halves[3]) > MOST_CHANGE_S:
        yield (
            f"the time offset changed by {-1e3 * solution.halves[3]:+.0f} ms meanwhile; expected "
            f"{1e3 * MOST_CHANGE_S:g} ms at most (are the frames stamped by another clock?)"
        )


def _consistency(solution: MountSolution) -> Iterator[str]:
    if solution.scatter > MOST_SCATTER:
        yield (
            f"sightings miss by {solution.scatter:.1f} of their standard deviations; expected at most "
            f"{MOST_SCATTER:g} (is the camera's file this camera's, and the pad's this pad's?)"
        )
    expected = solution.prior.standard_deviations(0.0)
    for name, which in (("gyroscope", GYRO_MATRIX), ("accelerometer", ACCEL_MATRIX)):
        sigmas = np.abs(solution.unknowns.values[which] / expected[which])
        if sigmas.max() > MOST_SIGMA:
            row, column = divmod(int(np.argmax(sigmas)), 3)
            share = 100.0 * solution.unknowns.values[which][3 * row + column]
            yield (
                f"camera and {name} disagree by {share:+.1f} % ({BODY_AXES[column]} felt as "
                f"{BODY_AXES[row]}), {sigmas.max():.0f} standard deviations (wrong size of the pad, focal "
                "length or range of the sensor?)"
            )
    bias_deg_s = np.degrees(np.linalg.norm(solution.unknowns.values[GYRO_BIAS]))
    if bias_deg_s > LIKELY_BIAS_DEG_S:
        yield f"the gyroscope is off by {bias_deg_s:.0f}°/s; expected less than {LIKELY_BIAS_DEG_S:g}°/s"


def _plausible(
    solution: MountSolution, configured: FloatArray, position_m: FloatArray, most_rotation_deg: float
) -> Iterator[str]:
    turned_deg = math.degrees(float(np.linalg.norm(rotation_from(solution, configured))))
    if turned_deg > most_rotation_deg:
        yield (
            f"the camera is turned by {turned_deg:.1f}° from where the settings have it; expected at most "
            f"{most_rotation_deg:g}° (correct camera_yaw_deg and camera_tilt_deg, or allow it with "
            "--max-rotation-deg)"
        )
    if abs(solution.time_offset_s) > WIDEST_OFFSET_S - 0.01:
        yield f"no time offset within {WIDEST_OFFSET_S:g} s fits (are the frames stamped by another clock?)"
    away_m = float(np.linalg.norm(solution.unknowns.values[POSITION] - position_m))
    if away_m > MOST_SIGMA * solution.prior.position_m:
        yield (
            f"the camera is {100 * away_m:.0f} cm from where the settings have it; expected at most "
            f"{100 * MOST_SIGMA * solution.prior.position_m:.0f} cm (correct camera_position_body_m, or say "
            "with --position-std how well it is known)"
        )
