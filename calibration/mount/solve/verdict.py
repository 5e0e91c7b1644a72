"""The acceptance test of a mount calibration: each reason to refuse it in one line.

Pure. Limits are in stated standard deviations, or far from what a good recording gives.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from calibration.mount.solve.correlation import WIDEST_OFFSET_S
from calibration.mount.solve.rotations import log
from calibration.mount.solve.solve import MountSolution
from calibration.mount.solve.unknowns import ACCEL_MATRIX, GYRO_BIAS, GYRO_MATRIX, POSITION
from companion.base.geometry import FloatArray

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
        *_agreement(solution),
        *_plausible(solution, configured, configured_position_m, most_rotation_deg),
    )


def _amount(solution: MountSolution) -> list[str]:
    found, used = [], int(solution.kept.sum())
    if used < FEWEST_SIGHTINGS or solution.segments < FEWEST_SEGMENTS:
        found.append(
            f"too little was seen: {used} sightings in {solution.segments} segments of 2 s; expected "
            f"{FEWEST_SIGHTINGS} in {FEWEST_SEGMENTS} at least"
        )
    share = used / len(solution.kept)
    if share < LEAST_KEPT:
        found.append(
            f"{100 * (1 - share):.0f} % of the sightings contradict the rest; expected less than "
            f"{100 * (1 - LEAST_KEPT):.0f} % (another pad than the settings', or a picture upside down?)"
        )
    if not solution.converged:
        found.append("the fit did not converge; expected a longer recording with more motion")
    return found


def _certainty(solution: MountSolution) -> list[str]:
    found = []
    std_deg = np.degrees(np.sqrt(np.diag(solution.rotation_covariance)))
    worst = int(np.argmax(std_deg))
    if std_deg[worst] > MOST_ROTATION_STD_DEG:
        found.append(
            f"too little motion: the rotation about {BODY_AXES[worst]} is known to {std_deg[worst]:.2f}° "
            f"only, expected {MOST_ROTATION_STD_DEG:g}°; {WHAT_HELPS[worst]} more"
        )
    if solution.time_offset_std_s > MOST_OFFSET_STD_S:
        found.append(
            f"too slow a motion: the time offset is known to {1e3 * solution.time_offset_std_s:.1f} ms only, "
            f"expected {1e3 * MOST_OFFSET_STD_S:g} ms; turn it more quickly"
        )
    return found


def _agreement(solution: MountSolution) -> list[str]:
    return [*_steadiness(solution), *_consistency(solution)]


def _steadiness(solution: MountSolution) -> list[str]:
    found = []
    if solution.odd_segments > MOST_ODD * solution.segments:
        found.append(
            f"in {solution.odd_segments} of {solution.segments} segments most sightings contradict the "
            f"rest; expected {100 * MOST_ODD:.0f} % at most (did the camera or the pad slip meanwhile?)"
        )
    turned_deg = math.degrees(float(np.linalg.norm(solution.halves[:3])))
    if turned_deg > MOST_CHANGE_DEG:
        found.append(
            f"the first half of the recording has the camera turned by {turned_deg:.1f}° from the second; "
            f"expected {MOST_CHANGE_DEG:g}° at most (did the camera or the pad slip meanwhile?)"
        )
    if abs(solution.halves[3]) > MOST_CHANGE_S:
        found.append(
            f"the time offset changed by {-1e3 * solution.halves[3]:+.0f} ms meanwhile; expected "
            f"{1e3 * MOST_CHANGE_S:g} ms at most (are the frames stamped by another clock?)"
        )
    return found


def _consistency(solution: MountSolution) -> list[str]:
    found = []
    if solution.scatter > MOST_SCATTER:
        found.append(
            f"sightings miss by {solution.scatter:.1f} of their standard deviations; expected at most "
            f"{MOST_SCATTER:g} (is the camera's file this camera's, and the pad's this pad's?)"
        )
    expected = solution.prior.standard_deviations(0.0)
    for name, which in (("gyroscope", GYRO_MATRIX), ("accelerometer", ACCEL_MATRIX)):
        sigmas = np.abs(solution.unknowns.values[which] / expected[which])
        if sigmas.max() > MOST_SIGMA:
            row, column = divmod(int(np.argmax(sigmas)), 3)
            share = 100.0 * solution.unknowns.values[which][3 * row + column]
            found.append(
                f"camera and {name} disagree by {share:+.1f} % ({BODY_AXES[column]} felt as "
                f"{BODY_AXES[row]}), {sigmas.max():.0f} standard deviations (wrong size of the pad, focal "
                "length or range of the sensor?)"
            )
    bias_deg_s = np.degrees(np.linalg.norm(solution.unknowns.values[GYRO_BIAS]))
    if bias_deg_s > LIKELY_BIAS_DEG_S:
        found.append(
            f"the gyroscope is off by {bias_deg_s:.0f}°/s; expected less than {LIKELY_BIAS_DEG_S:g}°/s"
        )
    return found


def _plausible(
    solution: MountSolution, configured: FloatArray, position_m: FloatArray, most_rotation_deg: float
) -> list[str]:
    found = []
    turned_deg = math.degrees(float(np.linalg.norm(rotation_from(solution, configured))))
    if turned_deg > most_rotation_deg:
        found.append(
            f"the camera is turned by {turned_deg:.1f}° from where the settings have it; expected at most "
            f"{most_rotation_deg:g}° (correct camera_yaw_deg and camera_tilt_deg, or allow it with "
            "--max-rotation-deg)"
        )
    if abs(solution.time_offset_s) > WIDEST_OFFSET_S - 0.01:
        found.append(
            f"no time offset within {WIDEST_OFFSET_S:g} s fits (are the frames stamped by another clock?)"
        )
    away_m = float(np.linalg.norm(solution.unknowns.values[POSITION] - position_m))
    if away_m > MOST_SIGMA * solution.prior.position_m:
        found.append(
            f"the camera is {100 * away_m:.0f} cm from where the settings have it; expected at most "
            f"{100 * MOST_SIGMA * solution.prior.position_m:.0f} cm (correct camera_position_body_m, or say "
            "with --position-std how well it is known)"
        )
    return found
