"""What `calibrate-mount camera` does: a recording in, the mount file and its plots out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

from calibration.command_line import RefusedError
from calibration.mount.record.recording import read_recording
from calibration.mount.report.plots import write_mount_plots
from calibration.mount.report.result import (
    configured_rotation,
    mount_calibration,
    mount_lines,
    prior_of,
    shutter_s,
)
from calibration.mount.shared import judge, now, write_file
from calibration.mount.solve.solve import NoSolutionError, solve
from calibration.mount.solve.verdict import reasons
from companion.config import CameraConfig, load_model


@dataclass(frozen=True, slots=True)
class SolveJob:
    """What is asked for; `lens` is a camera file to use instead of the recording's."""

    log: Path
    output: Path
    lens: Path | None
    plots: Path | None
    position_std_m: float
    max_rotation_deg: float
    force: bool


def solve_mount(job: SolveJob) -> None:
    """Solve, show, judge and write.

    Raises:
        ConfigError: the recording is none, or the file cannot be written.
        RefusedError: it is not good enough.
    """
    lens = None if job.lens is None else load_model(CameraConfig, job.lens)
    recording = read_recording(job.log, lens)
    place = np.array(recording.vehicle.camera_position_body_m)
    prior = prior_of(recording, job.position_std_m)
    try:
        found = solve(recording.inertial, recording.sightings, place, shutter_s(recording), prior)
    except NoSolutionError as error:
        raise RefusedError(f"{job.log}: {error}") from error
    configured = configured_rotation(recording)
    against = reasons(found, configured, place, job.max_rotation_deg)
    calibration = mount_calibration(found, recording, against, now())
    for line in mount_lines(calibration, found, recording):
        typer.echo(line)
    if job.plots is not None:
        pictures = write_mount_plots(job.plots, found, recording.inertial, configured)
        typer.echo(f"pictures      {', '.join(str(path) for path in pictures)}")
    judge(against, force=job.force)
    write_file(job.output, calibration, "mount: {}")
