"""The mount file and the summary lines, from a solution."""

from __future__ import annotations

import math

import numpy as np

from calibration.mount.record.recording import MountRecording
from calibration.mount.solve.solve import MountSolution
from calibration.mount.solve.unknowns import POSITION, MountPrior
from calibration.mount.solve.verdict import rotation_from
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
from companion.config import MountCalibration, MountStd
from companion.config.calibration import Provenance
from companion.flightlog.version import versions
from companion.sense.vision.pipeline import body_from_camera


def shutter_s(recording: MountRecording) -> float:
    """The time in which the camera's rolling shutter passes one focal length of the image."""
    camera = recording.camera
    return camera.fy_px * camera.readout_s / camera.height_px


def prior_of(recording: MountRecording, position_std_m: float) -> MountPrior:
    """The prior for this vehicle; a calibrated accelerometer has a smaller one."""
    lens_rad = recording.config.sense.vision.scale_error
    if recording.calibrated is None or recording.calibrated.accelerometer is None:
        return MountPrior(position_m=position_std_m, lens_rad=lens_rad)
    return MountPrior(
        position_m=position_std_m,
        lens_rad=lens_rad,
        accel_bias_m_s2=0.03,
        accel_scale=0.002,
    )


def configured_rotation(recording: MountRecording) -> FloatArray:
    """Body from camera (3, 3) by the settings of the recording."""
    return matrix_from_quat(body_from_camera(recording.vehicle))


def camera_angles_deg(rotation: FloatArray) -> tuple[float, float, float]:
    """Roll, tilt and yaw (deg), as the vehicle's file has them, of a body-from-camera rotation (3, 3)."""
    turn = quat_multiply(quat_from_matrix(rotation), quat_conjugate(BODY_FROM_DOWNWARD_CAMERA))
    roll, tilt, yaw = (math.degrees(angle) for angle in euler_from_quat(turn))
    return roll, tilt, yaw


def provenance(source: str, date: str, used: int, dropped: int) -> Provenance:
    """Where a calibration comes from."""
    tool = f"calibrate-mount {versions().get('companion', '')}".strip()
    return Provenance(tool=tool, source=source, date=date, samples=used, dropped=dropped)


def mount_calibration(
    solution: MountSolution, recording: MountRecording, forced: tuple[str, ...], date: str
) -> MountCalibration:
    """The mount file."""
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
    """The summary lines."""
    vehicle, std = recording.vehicle, found.std
    turned = np.degrees(rotation_from(solution, configured_rotation(recording)))
    before = (vehicle.camera_roll_deg, vehicle.camera_tilt_deg, vehicle.camera_yaw_deg)
    rows = [
        f"sightings     {found.provenance.samples} used, {found.provenance.dropped} dropped, in "
        f"{solution.segments} segments; they scatter by {solution.scatter:.2f} of what they say",
        f"roll, tilt, yaw of the camera  {found.camera_roll_deg:+.2f} {found.camera_tilt_deg:+.2f} "
        f"{found.camera_yaw_deg:+.2f} deg (settings: {before[0]:+.2f} {before[1]:+.2f} {before[2]:+.2f})",
        f"turned from the settings  {_list(turned, '+.2f')} deg about forward, right, down "
        f"(standard deviations {_list(std.rotation_deg, '.2f')})",
        f"position      {_list(found.camera_position_body_m, '+.3f')} m "
        f"(standard deviations {_list(std.position_m, '.3f')}; settings "
        f"{_list(vehicle.camera_position_body_m, '+.3f')})",
        f"time offset   {1e3 * found.time_offset_s:+.1f} ms, to be added to frames' stamps "
        f"(standard deviation {1e3 * std.time_offset_s:.1f})",
    ]
    if solution.std(POSITION).max() > 0.8 * solution.prior.position_m:
        rows.append("the position is the settings': the motion says no more of it")
    return [*rows, *(f"note: {note}" for note in recording.notes)]


def _list(values: object, form: str) -> str:
    return " ".join(format(float(v), form) for v in np.asarray(values).tolist())


def _rounded(values: FloatArray) -> Vector3:
    return vector3([round(float(v), 4) for v in values])
