"""What is likely to be wrong, with the setting that corrects it: from all findings together. Pure.

A camera that is mounted turned by ψ more than the vehicle's file says shows every level direction turned by
-ψ. A chip that is mounted otherwise shows gravity and all rotations turned alike, by one of the 24 rotations
that take axes to axes. Two heights distinguish an offset from a scale, and the IMU's way up shows whose scale
it is.
"""

import math
from dataclasses import dataclass, field
from itertools import product
from typing import Final

import numpy as np

from companion.base.geometry import (
    DOWN,
    FloatArray,
    Quaternion,
    Vector3,
    euler_from_quat,
    matrix_from_quat,
    norm,
    quat_from_euler,
    quat_from_matrix,
    scale,
    wrap_angle,
)
from companion.tools.pad_check.judge import Part, height_by_camera
from companion.tools.pad_check.moves import Move, StandstillMeans, down_by_force

QUARTERS_DEG: Final = (0.0, 90.0, 180.0, -90.0)
SNAP_DEG: Final = 20.0  # nearer to a quarter turn than this is one
NOTICED_DEG: Final = 8.0
UNANIMOUS: Final = 0.85  # length of the mean of unit vectors that point the same way
FITTING: Final = 0.8  # mean cosine between what a mounting would show and what was asked
SAME_SCALE: Final = 0.08
LEAST_CLIMB_M: Final = 0.1
UNDECIDED: Final = 0.05  # between how far camera and ultrasonic are from the IMU's way, as shares


@dataclass(frozen=True, slots=True)
class Mounting:
    """How the settings say that things sit; `body_from_sensor_deg` None: the autopilot's IMU is used."""

    vehicle: str
    camera: str
    pad: str
    camera_yaw_deg: float
    camera_tilt_deg: float
    body_from_sensor_deg: Vector3 | None
    range_position_body_m: Vector3
    field_ned_ut: Vector3 | None


@dataclass(slots=True)
class Evidence:
    """What has been measured so far: pairs of what was asked (a unit vector) and the moves."""

    low: StandstillMeans | None = None
    high: StandstillMeans | None = None
    lift: tuple[Move, Move] | None = None  # camera, IMU
    shifts: list[tuple[Vector3, Move, Move]] = field(default_factory=list)
    turns: list[tuple[Vector3, Move, Move]] = field(default_factory=list)


# by the part, where all that can be said is what to look at
_ADVICE: Final[dict[Part, str]] = {
    "range": "the ultrasonic does not answer: sense.range.kind, sense.range.port, its wiring, and a hard "
    "surface under it",
    "compass": "the compass is disturbed or not calibrated: run calibrate-magnetometer, keep away from iron; "
    "expected is estimate.magnetic_field_ned_ut, or else what the Earth has",
    "compass axes": "the compass does not sit as the settings say, or is disturbed: its orientation in the "
    "autopilot (COMPASS_ORIENT, CAL_MAG0_ROT), or a calibration file of another sensor",
    "pad": "the pad does not lie level, or camera_tilt_deg ({m.camera_tilt_deg:g}) of the vehicle "
    "'{m.vehicle}' is off: calibrate-mount measures it",
    "sight": "the pad '{m.pad}' or the move was not seen: the settings' pad is the printed one, whole in "
    "view, in good light; each step wants a rest of a second and a half",
    "loss": "samples of the IMU were lost in the middle of the move: too busy a machine, or too slow a bus "
    "(sense.imu.bus, sense.imu.poll_hz)",
    "mirror": "the camera's image is mirrored: switch the flip off in its driver (v4l2-ctl, libcamera)",
    "hand": "camera and IMU agree on another move than was asked: move it along the vehicle's own axes, or "
    "its front is not where you think (then camera_yaw_deg and sense.imu.body_from_sensor_deg are off alike)",
}


def likely_cause(part: Part, evidence: Evidence, mounting: Mounting) -> str:
    """One line: what is likely wrong with a part, and the setting to correct."""
    match part:
        case "camera":
            return camera_cause(evidence, mounting)
        case "imu":
            return imu_cause(evidence, mounting)
        case "scale":
            return scale_cause(evidence, mounting)
        case _:
            return _ADVICE[part].format(m=mounting)


# ---------------------------------------------------------------- the camera's mounting


def camera_cause(evidence: Evidence, mounting: Mounting) -> str:
    """From the level directions in which the camera saw what was asked."""
    pairs = [(asked, camera.displacement_m) for asked, camera, _ in evidence.shifts]
    pairs += [(asked, camera.rotation_rad) for asked, camera, _ in evidence.turns if asked[2] == 0.0]
    errors = [wrap_angle(_azimuth(seen) - _azimuth(asked)) for asked, seen in pairs]
    if not errors:
        return f"how the camera is mounted: camera_yaw_deg, camera_tilt_deg of '{mounting.vehicle}'"
    mean = complex(sum(math.cos(e) for e in errors), sum(math.sin(e) for e in errors)) / len(errors)
    off_deg = math.degrees(math.atan2(mean.imag, mean.real))
    if abs(mean) < UNANIMOUS:
        return (
            "the camera's image is mirrored or turned on its way (a flip in the camera's driver), or the "
            f"moves were not as asked: camera_yaw_deg of '{mounting.vehicle}' alone does not explain it"
        )
    if abs(off_deg) < NOTICED_DEG:
        return f"camera_tilt_deg of '{mounting.vehicle}', or the mounting: calibrate-mount measures it"
    off_deg = _snapped(off_deg)
    right_deg = math.degrees(wrap_angle(math.radians(mounting.camera_yaw_deg - off_deg)))
    return (
        f"camera_yaw_deg of the vehicle '{mounting.vehicle}' is {mounting.camera_yaw_deg:g}; "
        f"{round(right_deg) + 0} would fit ({round(-off_deg):+d})"
    )


def _azimuth(vector: Vector3) -> float:
    return math.atan2(vector[1], vector[0])


def _snapped(angle_deg: float) -> float:
    quarter = 90.0 * round(angle_deg / 90.0)
    return quarter if quarter and abs(angle_deg - quarter) < SNAP_DEG else angle_deg


# ---------------------------------------------------------------- the IMU's mounting


def imu_cause(evidence: Evidence, mounting: Mounting) -> str:
    """The rotation of axes to axes that would make gravity and the rotations right."""
    pairs = [(asked, scale(imu.rotation_rad, 1.0 / max(norm(imu.rotation_rad), 1e-9)))
             for asked, _, imu in evidence.turns]  # fmt: skip
    if evidence.low is not None:
        pairs.append((DOWN, down_by_force(evidence.low)))
    best = max(_axis_rotations(), key=lambda rotation: _fit(rotation, pairs))
    if mounting.body_from_sensor_deg is None:
        return "the autopilot's IMU: its board rotation (SENS_BOARD_ROT, AHRS_ORIENTATION) and calibration"
    if not pairs or _fit(best, pairs) < FITTING:
        return (
            "sense.imu.body_from_sensor_deg, but no turn by quarters makes it right: one of the gyroscope's "
            "axes is wrong, or the moves were not as asked"
        )
    if np.allclose(best, np.eye(3)):
        return "one of the IMU's axes: its scale, sign or zero; calibrate-mount measures scale and zero"
    configured = mounting.body_from_sensor_deg
    fitting = angles_of(best @ matrix_from_quat(_quaternion(configured)))
    shown, right = (", ".join(f"{angle:g}" for angle in angles) for angles in (configured, fitting))
    return f"sense.imu.body_from_sensor_deg is [{shown}]; [{right}] would fit"


def _fit(rotation: FloatArray, pairs: list[tuple[Vector3, Vector3]]) -> float:
    """Mean cosine between what was asked and what was measured, turned."""
    return float(np.mean([np.dot(asked, rotation @ measured) for asked, measured in pairs])) if pairs else 0.0


def _quaternion(angles_deg: Vector3) -> Quaternion:
    roll, pitch, yaw = (math.radians(angle) for angle in angles_deg)
    return quat_from_euler(roll, pitch, yaw)


def _axis_rotations() -> list[FloatArray]:
    """The 24 rotations that take axes to axes (some stand twice), the identity first."""
    return [np.rint(matrix_from_quat(_quaternion(angles))) for angles in _quarter_turns()]


def _quarter_turns() -> list[Vector3]:
    """Roll, pitch and yaw in quarter turns, those with the fewest turns first."""
    return sorted(
        product(QUARTERS_DEG, (0.0, 90.0, -90.0), QUARTERS_DEG),
        key=lambda angles: sum(angle != 0.0 for angle in angles),
    )


def angles_of(rotation: FloatArray) -> Vector3:
    """Roll, pitch, yaw (deg) of a rotation (3, 3): in quarter turns where it is one, with the fewest."""
    for angles in _quarter_turns():
        if np.abs(matrix_from_quat(_quaternion(angles)) - rotation).max() < 0.02:
            return angles
    roll, pitch, yaw = (round(math.degrees(a), 1) for a in euler_from_quat(quat_from_matrix(rotation)))
    return (roll, pitch, yaw)


# ---------------------------------------------------------------- heights


def scale_cause(evidence: Evidence, mounting: Mounting) -> str:
    """An offset of the ultrasonic's place, or a scale: the camera's (the pad's size) or the ultrasonic's."""
    low, high = evidence.low, evidence.high
    place = f"range_position_body_m of the vehicle '{mounting.vehicle}'"
    if low is None or high is None or low.range_m is None or high.range_m is None:
        return f"the ultrasonic's place ({place}), its scale, or the pad's size: a second height would tell"
    heights = [height_by_camera(rest, mounting.range_position_body_m) for rest in (low, high)]
    climb_m, echo_climb_m = heights[1] - heights[0], high.range_m - low.range_m
    more_m = 0.5 * (low.range_m + high.range_m - sum(heights))
    if abs(climb_m) < LEAST_CLIMB_M or abs(echo_climb_m - climb_m) < SAME_SCALE * abs(climb_m):
        return f"the ultrasonic reads {more_m:+.2f} m at every height: {place}, or something in its beam"
    return _whose_scale(climb_m, echo_climb_m, evidence, mounting)


def _whose_scale(climb_m: float, echo_climb_m: float, evidence: Evidence, mounting: Mounting) -> str:
    """The IMU's way up is the third opinion."""
    pad = (
        f"the printed pad's size against '{mounting.pad}' (its markers' side_m), or the focal length of the "
        f"camera '{mounting.camera}'"
    )
    echo = "the ultrasonic's scale (sense.range.kind, sense.range.air_temperature_c), or what it hears"
    if evidence.lift is None or abs(evidence.lift[1].displacement_m[2]) < LEAST_CLIMB_M:
        return f"{pad}; or {echo}"
    up_m = abs(evidence.lift[1].displacement_m[2])
    by_camera, by_echo = abs(abs(climb_m) / up_m - 1.0), abs(abs(echo_climb_m) / up_m - 1.0)
    detail = (
        f"raised by {up_m:.2f} m by the IMU, {abs(climb_m):.2f} m by the camera, "
        f"{abs(echo_climb_m):.2f} m by the ultrasonic"
    )
    if abs(by_camera - by_echo) < UNDECIDED:
        return f"{detail}: {pad}; or {echo}"
    return f"{detail}: {pad if by_camera > by_echo else echo}"
