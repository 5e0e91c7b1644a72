"""What was asked of the hand, held against what camera, IMU, ultrasonic and compass made of it. Pure.

The person is the reference for directions: right is where they moved it. Camera and IMU are judged apart, so
that what is wrong has a name; where the two agree with one another and not with the person, the move was
another one, unless the IMU is known to be wrong. Body axes FRD; level axes forward, right,
down; SI, field µT.
"""

import math
from dataclasses import dataclass, field
from typing import Final, Literal

from companion.base.geometry import GRAVITY_M_S2, Vector3, cross, dot, norm, scale, subtract
from companion.tools.pad_check.moves import Move, StandstillMeans, carried_along, down_by_force, down_by_pad

# what may be to blame for a finding
Part = Literal[
    "camera", "imu", "range", "scale", "compass", "compass axes", "pad", "hand", "sight", "mirror", "loss"
]

ASTRAY_RAD: Final = math.radians(35.0)  # further from what was asked is another direction
LEVEL_RAD: Final = math.radians(10.0)  # held by hand, on an accelerometer from the shop
PAD_LEVEL_RAD: Final = math.radians(8.0)
ALIKE_RAD: Final = math.radians(12.0)  # between the axes that camera and gyroscope turned about
ALIKE_SIZE: Final = (math.radians(3.0), 0.2)  # and between the angles: so much, and a share
HEIGHT: Final = (0.04, 0.07)  # likewise between two heights (m)
# what a compass that nobody has calibrated may be off by without being grossly wrong
FIELD_SHARE: Final = 0.35
EARTH_FIELD_UT: Final = (22.0, 67.0)  # World Magnetic Model, least (South Atlantic) and most
DIP_RAD: Final = math.radians(25.0)
COMPASS_TURN: Final = (math.radians(10.0), 0.3)
GRAVITY_SHARE: Final = 0.15  # 60 mg and 3 % by the data sheet, and a hand
# what gravity and field may be off, by sensors that nobody has calibrated, after a turn by the gyroscope
HORIZON_TILT: Final = (math.radians(5.0), 0.3)
COMPASS_TILT: Final = (math.radians(10.0), 0.5)
LEAST_IMU_WAY_M: Final = 0.08  # a shorter way has no direction, integrated twice


@dataclass(frozen=True, slots=True)
class CheckAnswer:
    """One answer: `detail` is what was measured, `blamed` what may be wrong (nothing: all is well).

    `values` are the numbers, for the record.
    """

    name: str
    detail: str
    blamed: tuple[Part, ...] = ()
    values: dict[str, float] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        return not self.blamed


def angle_between(a: Vector3, b: Vector3) -> float:
    """Angle (rad) between two vectors; a right one where one of them has no length."""
    size = norm(a) * norm(b)
    # no number is no direction either
    return 0.5 * math.pi if not size >= 1e-9 else math.acos(max(-1.0, min(1.0, dot(a, b) / size)))


# ---------------------------------------------------------------- at rest


def judge_level(rest: StandstillMeans) -> CheckAnswer:
    """Level reads level by the accelerometer, and gravity is as large as it is."""
    x, y, z = down_by_force(rest)
    roll, pitch = math.degrees(math.atan2(y, z)), math.degrees(math.atan2(-x, math.hypot(y, z)))
    tilt = angle_between((x, y, z), (0.0, 0.0, 1.0))
    size = norm(rest.force_m_s2)
    detail = f"the accelerometer says roll {roll:+.0f}°, pitch {pitch:+.0f}°, gravity {size:.1f} m/s²"
    values = {"roll_deg": roll, "pitch_deg": pitch, "gravity_m_s2": size}
    good = tilt < LEVEL_RAD and abs(size - GRAVITY_M_S2) < GRAVITY_SHARE * GRAVITY_M_S2
    return CheckAnswer("level is level", detail, () if good else ("imu",), values)


def judge_pad_level(rest: StandstillMeans, *, imu_is_level: bool = True) -> CheckAnswer:
    """Camera and accelerometer agree about down, over a pad that lies level."""
    apart = angle_between(down_by_force(rest), down_by_pad(rest))
    detail = f"down by the pad and by the accelerometer are {math.degrees(apart):.1f}° apart"
    values = {"apart_deg": math.degrees(apart)}
    blamed: tuple[Part, ...] = ("pad",) if imu_is_level else ("imu",)
    return CheckAnswer("camera and horizon agree", detail, () if apart < PAD_LEVEL_RAD else blamed, values)


def judge_height(rest: StandstillMeans, range_position_body_m: Vector3, place: str) -> CheckAnswer:
    """The camera's height over the pad against the ultrasonic's."""
    name = f"height, {place}"
    height_m = height_by_camera(rest, range_position_body_m)
    if rest.range_m is None:
        return CheckAnswer(name, f"camera {height_m:.2f} m, ultrasonic: no echo", ("range",))
    detail = f"camera {height_m:.2f} m, ultrasonic {rest.range_m:.2f} m"
    values = {"camera_m": height_m, "ultrasonic_m": rest.range_m}
    good = _alike(height_m, rest.range_m, HEIGHT)
    return CheckAnswer(name, detail, () if good else ("scale",), values)


def height_by_camera(rest: StandstillMeans, range_position_body_m: Vector3) -> float:
    """Height (m) of the ultrasonic over the pad's plane, by the camera."""
    return dot(down_by_pad(rest), subtract(rest.pad_position_body_m, range_position_body_m))


def judge_compass(rest: StandstillMeans, field_ned_ut: Vector3 | None) -> CheckAnswer:
    """A field of about the earth's strength, that dips about as it does; nothing finer than gross.

    `field_ned_ut` None: nobody says where this is, and anything that the Earth has somewhere will do.
    """
    if rest.field_ut is None:
        return CheckAnswer("compass", "no samples of the magnetometer", ("compass",))
    strength_ut = norm(rest.field_ut)
    dip = 0.5 * math.pi - angle_between(rest.field_ut, down_by_force(rest))
    values = {"field_ut": strength_ut, "dip_deg": math.degrees(dip)}
    if field_ned_ut is None:
        low_ut, high_ut = EARTH_FIELD_UT
        detail = f"{strength_ut:.0f} µT; {low_ut:.0f} to {high_ut:.0f} µT are expected"
        return CheckAnswer("compass", detail, () if low_ut < strength_ut < high_ut else ("compass",), values)
    expected_ut = norm(field_ned_ut)
    expected_dip = math.asin(field_ned_ut[2] / expected_ut)
    detail = (
        f"{strength_ut:.0f} µT, dip {math.degrees(dip):.0f}°; "
        f"{expected_ut:.0f} µT and {math.degrees(expected_dip):.0f}° are expected"
    )
    good = abs(strength_ut - expected_ut) < FIELD_SHARE * expected_ut and abs(dip - expected_dip) < DIP_RAD
    return CheckAnswer("compass", detail, () if good else ("compass",), values)


# ---------------------------------------------------------------- moved


def judge_shift(
    name: str, asked: Vector3, camera: Move, imu: Move, *, imu_is_level: bool = True
) -> CheckAnswer:
    """A way (level axes) that was asked for, by the camera and by the IMU."""
    detail = f"camera: {way_words(camera.displacement_m)}; IMU: {way_words(imu.displacement_m)}"
    values = _values("camera_m", camera.displacement_m) | _values("imu_m", imu.displacement_m)
    astray = [angle_between(move.displacement_m, asked) > ASTRAY_RAD for move in (camera, imu)]
    vague = norm(imu.displacement_m) < LEAST_IMU_WAY_M
    alike = angle_between(camera.displacement_m, imu.displacement_m) < ASTRAY_RAD
    return CheckAnswer(
        name, detail, _blamed(astray[0], astray[1] and not vague, alike=alike and imu_is_level), values
    )


def judge_turn(
    name: str, asked: Vector3, camera: Move, imu: Move, *, imu_is_level: bool = True
) -> CheckAnswer:
    """A rotation (body axes) that was asked for, by the camera and by the gyroscope."""
    detail = f"camera: {turn_words(camera.rotation_rad)}; gyroscope: {turn_words(imu.rotation_rad)}"
    values = _values("camera_rad", camera.rotation_rad) | _values("gyro_rad", imu.rotation_rad)
    astray = [angle_between(move.rotation_rad, asked) > ASTRAY_RAD for move in (camera, imu)]
    apart = angle_between(camera.rotation_rad, imu.rotation_rad)
    blamed = _blamed(*astray, alike=apart < ASTRAY_RAD and imu_is_level)
    if not blamed and apart > ALIKE_RAD:
        return CheckAnswer(
            name, f"{detail}; about axes {math.degrees(apart):.0f}° apart", ("camera",), values
        )
    if not blamed and not _alike(norm(camera.rotation_rad), norm(imu.rotation_rad), ALIKE_SIZE):
        return CheckAnswer(name, f"{detail}; not as far", ("imu",), values)
    return CheckAnswer(name, detail, blamed, values)


def judge_compass_turn(before: StandstillMeans, after: StandstillMeans, imu: Move) -> CheckAnswer:
    """The compass follows a turn of the heading as the gyroscope does."""
    name = "compass turns along"
    if before.field_ut is None or after.field_ut is None:
        return CheckAnswer(name, "no samples of the magnetometer", ("compass",))
    turned = _turned_about_down(before, after)
    about_down = dot(imu.rotation_rad, down_by_force(before))
    detail = f"compass {math.degrees(turned):+.0f}°, gyroscope {math.degrees(about_down):+.0f}°"
    values = {"compass_deg": math.degrees(turned), "gyro_deg": math.degrees(about_down)}
    good = _alike(turned, about_down, COMPASS_TURN)
    return CheckAnswer(name, detail, () if good else ("compass",), values)


def judge_tilt(
    step: str, before: StandstillMeans, after: StandstillMeans, imu: Move, *, compass_is_good: bool = True
) -> list[CheckAnswer]:
    """Gravity and the field turn in body axes as the gyroscope says that the body was tilted.

    A turn about the vertical shows the compass's horizontal part alone, and that in its own axes: one that
    sits turned on its axis turns along all the same, and has every heading wrong. Tilted, it follows another
    axis; so does one that has been found disturbed (not `compass_is_good`), of whose axes nothing can be
    said.
    """
    tilted = norm(imu.rotation_rad)
    off = angle_between(carried_along(down_by_force(before), imu.rotation_rad), down_by_force(after))
    findings = [_tilt_finding("accelerometer", step, off, tilted, HORIZON_TILT, "imu")]
    if before.field_ut is not None and after.field_ut is not None:
        off = angle_between(carried_along(before.field_ut, imu.rotation_rad), after.field_ut)
        part: Part = "compass axes" if compass_is_good else "compass"
        findings.append(_tilt_finding("compass", step, off, tilted, COMPASS_TILT, part))
    return findings


def _tilt_finding(
    sensor: str, step: str, off: float, tilted: float, tolerance: tuple[float, float], blamed: Part
) -> CheckAnswer:
    least, share = tolerance
    off_deg, tilted_deg = math.degrees(off), math.degrees(tilted)
    return CheckAnswer(
        f"{sensor} tilts along, {step}",
        f"{off_deg:.0f}° off what the gyroscope's {tilted_deg:.0f}° make of it",
        () if off <= max(least, share * tilted) else (blamed,),
        {"off_deg": off_deg, "tilted_deg": tilted_deg},
    )


def _turned_about_down(before: StandstillMeans, after: StandstillMeans) -> float:
    """By how much (rad, clockwise seen from above) the body has turned under the field's horizontal part.

    Field and gravity are the same chip's, so its mounting does not matter.
    """
    assert before.field_ut is not None
    assert after.field_ut is not None
    down = down_by_force(before)
    old, new = (
        subtract(field_ut, scale(own, dot(field_ut, own)))
        for field_ut, own in ((before.field_ut, down), (after.field_ut, down_by_force(after)))
    )
    return math.atan2(dot(down, cross(new, old)), dot(new, old))


def _blamed(camera_astray: bool, imu_astray: bool, *, alike: bool) -> tuple[Part, ...]:
    if camera_astray and imu_astray and alike:
        return ("hand",)
    astray: dict[Part, bool] = {"camera": camera_astray, "imu": imu_astray}
    return tuple(part for part, is_astray in astray.items() if is_astray)


def _alike(a: float, b: float, tolerance: tuple[float, float]) -> bool:
    """Within so much, or a share of the larger."""
    least, share = tolerance
    return abs(a - b) <= max(least, share * max(abs(a), abs(b)))


def _values(name: str, vector: Vector3) -> dict[str, float]:
    return {f"{name}_{axis}": value for axis, value in zip("xyz", vector, strict=True)}


# ---------------------------------------------------------------- words

_WAYS: Final = (("forward", "back"), ("right", "left"), ("down", "up"))
_TURNS: Final = (("roll right", "roll left"), ("nose up", "nose down"), ("turn right", "turn left"))


def way_words(displacement_m: Vector3) -> str:
    """The main direction of a way in level axes."""
    return f"{_main(displacement_m, _WAYS)} {norm(displacement_m):.2f} m"


def turn_words(rotation_rad: Vector3) -> str:
    """The main sense of a rotation in body axes."""
    return f"{_main(rotation_rad, _TURNS)} {math.degrees(norm(rotation_rad)):.0f}°"


def _main(vector: Vector3, words: tuple[tuple[str, str], ...]) -> str:
    axis = max(range(3), key=lambda k: abs(vector[k]))
    return words[axis][0 if vector[axis] >= 0.0 else 1]
