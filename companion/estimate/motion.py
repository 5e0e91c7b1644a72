"""The vehicle's motion in the last seconds: attitude and acceleration at the IMU's rate.

The pad filter needs the attitude at a frame's exposure, and the vehicle's motion between two frames as two
pre-integrated vectors. Velocity and position are running integrals of acceleration only, from an arbitrary
start: only their differences are meaningful. NED, SI units, plain floats.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import (
    EYE3,
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    FloatArray,
    Quaternion,
    Vector3,
    add,
    between,
    norm,
    quat_from_rotation_vector,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    rotation_vector_from_quat,
    scale,
    subtract,
)
from companion.base.messages import IMU_PREDICTED_S

LEVER_STD_M: Final = 0.05  # of the IMU's place as told, an axis: people put boards up to 10 cm off
LONGEST_STEP_S: Final = 0.05  # between two steps of a healthy IMU
UNSEEN_ACCELERATION_M_S2: Final = 4.0  # how hard the vehicle may accelerate in a gap of the IMU's stream
UNSEEN_JERK_M_S3: Final = 6.0  # and how fast that changes
UNSEEN_RATE_RAD_S: Final = 1.0  # how fast it may turn there
UNSEEN_TURN_RAD_S2: Final = 1.5  # and how fast that changes
RATE_SPAN_S: Final = 0.01  # a rate of turn is the mean of so long: two samples at 200 Hz
WRONG_FOR_S: Final = 0.2  # an attitude, before it is corrected: a manoeuvre that is timed wrongly is over


class VehiclePlace(NamedTuple):
    """The vehicle's position (m, NED) from `origin` (latitude deg, longitude deg, altitude m).

    The standard deviations (m, m/s) of position and velocity are axis by axis.
    """

    position_ned_m: Vector3
    position_std_m: Vector3
    velocity_std_m_s: Vector3
    origin: Vector3


class _Gap(NamedTuple):
    """A time whose motion is not known; noise of this density, on an axis, makes in it what may be missed.

    `turn_rad2` is the variance, on an axis, of the turn that it hides; 0 where samples have come.
    """

    start_s: float
    end_s: float
    density_m2_s3: float
    turn_rad2: float = 0.0


# attitude, integrals of acceleration (velocity and position), all corrections of the attitude up to then
_Sample = tuple[Quaternion, Vector3, Vector3, Vector3]


class MotionHistory:
    """Attitudes and acceleration integrals of the last `span_s` to `2 span_s`.

    `noise_density_m2_s3` is the density of the acceleration's noise on an axis, lately, `turn_density_rad2_s`
    that of the rate of turn's. The accelerations are the centre of mass's, as far as the IMU's place from it
    is known: `imu_covariance_m2` (3, 3) is its covariance. What was made of attitudes since `turned_since_s`
    has to be made again; whoever does so sets it back to infinity.
    """

    def __init__(self, span_s: float) -> None:
        self.noise_density_m2_s3 = self.turn_density_rad2_s = 0.0
        self.imu_covariance_m2: FloatArray = LEVER_STD_M**2 * EYE3
        self._span_s = span_s
        self._times_s: list[float] = []
        self._samples: list[_Sample] = []
        self._gaps: list[_Gap] = []
        self._corrected: Vector3 = ZERO3
        self.turned_since_s = math.inf
        self._acceleration = self._lasting = ZERO3

    @property
    def newest_s(self) -> float | None:
        """Time of the newest sample, or None before the first."""
        return self._times_s[-1] if self._times_s else None

    def add(
        self,
        time_s: float,
        attitude: Quaternion,
        acceleration_ned_m_s2: Vector3,
        span_s: float | None = None,
        lasting_ned_m_s2: Vector3 | None = None,
    ) -> None:
        """Append one sample, newer than the last; between samples the acceleration is linear.

        It has acted for `span_s`, when it is given, whatever the times differ by: where they were corrected,
        the velocity goes on for what they differ by, so that its arbitrary start stays without effect.
        `lasting_ned_m_s2`, when given, is what goes on beyond the sample: one of a vehicle that vibrates says
        nothing of the next.
        """
        speed = place = ZERO3
        if self._times_s:
            dt = time_s - self._times_s[-1]
            acts_s = dt if span_s is None else span_s
            if acts_s > LONGEST_STEP_S:
                density_m2_s3 = unseen_velocity_m2_s2(acts_s) / dt
                self._gaps.append(_Gap(self._times_s[-1], time_s, density_m2_s3, unseen_turn_rad2(acts_s)))
            _, (vx, vy, vz), (px, py, pz), _ = self._samples[-1]
            (ax, ay, az), (bx, by, bz) = self._acceleration, acceleration_ned_m_s2
            h, k = 0.5 * acts_s, dt * acts_s / 6.0
            speed = (vx + h * (ax + bx), vy + h * (ay + by), vz + h * (az + bz))
            place = (
                px + vx * dt + k * (2 * ax + bx),
                py + vy * dt + k * (2 * ay + by),
                pz + vz * dt + k * (2 * az + bz),
            )
        self._times_s.append(time_s)
        self._samples.append((attitude, speed, place, self._corrected))
        self._acceleration = acceleration_ned_m_s2
        self._lasting = acceleration_ned_m_s2 if lasting_ned_m_s2 is None else lasting_ned_m_s2
        if time_s - self._times_s[0] > 2.0 * self._span_s:
            self._forget(time_s - self._span_s)

    def attitude(self, time_s: float) -> Quaternion | None:
        """Attitude at a time, interpolated along the shortest turn; the nearest one outside the history.

        None before the first sample.
        """
        times_s, samples = self._times_s, self._samples
        if not times_s:
            return None
        place = bisect_right(times_s, time_s)
        if place == 0 or place == len(times_s):
            return samples[max(place - 1, 0)][0]
        start_s = times_s[place - 1]
        share = (time_s - start_s) / (times_s[place] - start_s)
        return quat_normalise(part_way(samples[place - 1][0], samples[place][0], share))

    def missing_s(self, start_s: float, end_s: float) -> float:
        """How long nothing has come, in the gaps that have ended between two times."""
        return sum(gap.end_s - gap.start_s for gap in self._hidden(start_s, end_s))

    def in_gap(self, time_s: float) -> bool:
        """Whether no sample covers a time that samples have come up to."""
        return any(gap.start_s < time_s < gap.end_s for gap in self._gaps if gap.turn_rad2)

    def _hidden(self, start_s: float, end_s: float) -> list[_Gap]:
        return [gap for gap in self._gaps if gap.turn_rad2 and start_s < gap.end_s <= end_s]

    def turn(self, right_s: float, wrong_s: float, turn: Quaternion) -> None:
        """Turn (about NED axes) what was measured: the attitudes were right at one time, wrong at the next.

        Where gaps have ended between the two, the turn is what they hid: of several each has hidden its share
        of the variance. Else the attitudes were wrong from the first time on and are corrected from then on;
        what they have made of the motion until now is not known.
        """
        hidden = self._hidden(right_s, wrong_s)
        if not hidden:
            newest_s, by = self._times_s[-1], rotation_vector_from_quat(turn)
            density_m2_s3 = misled_velocity_m_s(by) ** 2 / LONGEST_STEP_S
            self._gaps.append(_Gap(newest_s - LONGEST_STEP_S, newest_s, density_m2_s3))
            self._corrected = add(self._corrected, by)
            self._turn_from(right_s, turn, by)
            self.turned_since_s = min(self.turned_since_s, right_s)
            return
        whole = sum(gap.turn_rad2 for gap in hidden)
        for gap in hidden:
            self._turn_from(gap.end_s, part_way(IDENTITY, turn, gap.turn_rad2 / whole), ZERO3)
        self.turned_since_s = min(self.turned_since_s, hidden[0].start_s)

    def _turn_from(self, from_s: float, turn: Quaternion, by: Vector3) -> None:
        """Turn the samples from a time on; `by` (rad, NED axes) is what of that is a correction."""
        first = bisect_left(self._times_s, min(from_s, self._times_s[-1]))
        _, start_speed, start_place, _ = self._samples[first]
        for number, (attitude, speed, place, corrected) in enumerate(self._samples[first:], first):
            dt = self._times_s[number] - self._times_s[first]
            sped = _turned(turn, subtract(speed, start_speed), dt)
            coasted = add(start_place, scale(start_speed, dt))
            moved = _turned(turn, subtract(place, coasted), 0.5 * dt * dt)
            self._samples[number] = (
                quat_multiply(turn, attitude),
                add(start_speed, sped),
                add(coasted, moved),
                add(corrected, by),
            )
        self._acceleration = _turned(turn, self._acceleration, 1.0)
        self._lasting = _turned(turn, self._lasting, 1.0)

    def correct(self, turn_rad: Vector3) -> None:
        """The attitude has been corrected by a small rotation (rad, NED axes): later samples have it."""
        self._corrected = add(self._corrected, turn_rad)

    def corrected(self, start_s: float, end_s: float) -> Vector3:
        """By what small rotation (rad, about NED axes) the attitude has been corrected between two times."""
        return subtract(self._corrected_at(end_s), self._corrected_at(start_s))

    def _corrected_at(self, time_s: float) -> Vector3:
        """All corrections up to a time, between samples as `attitude` has it."""
        place = bisect_right(self._times_s, time_s)
        if not self._times_s or time_s > self._times_s[-1]:
            return self._corrected
        if place == 0 or place == len(self._times_s):
            return self._samples[max(place - 1, 0)][3]
        start_s, end_s = self._times_s[place - 1], self._times_s[place]
        share = (time_s - start_s) / (end_s - start_s)
        return between(self._samples[place - 1][3], self._samples[place][3], share)

    def turned_rad(self, time_s: float, span_s: float) -> float:
        """Angle (rad) through which the vehicle turned in `span_s` at a time; 0 before the first sample."""
        before, after = self.attitude(time_s - span_s), self.attitude(time_s + span_s)
        if before is None or after is None:
            return 0.0
        return 0.5 * norm(turn_between(before, after))

    def rate_body_rad_s(self, time_s: float, span_s: float = RATE_SPAN_S) -> Vector3:
        """Mean rate of turn (rad/s, body axes) over `span_s` about a time, or the last that is known."""
        newest_s = self.newest_s
        end_s = time_s + 0.5 * span_s if newest_s is None else min(time_s + 0.5 * span_s, newest_s)
        before, after = self.attitude(end_s - span_s), self.attitude(end_s)
        if before is None or after is None:
            return ZERO3
        return scale(turn_between(before, after), 1.0 / span_s)

    def moved(self, start_s: float, end_s: float) -> tuple[Vector3, Vector3, FloatArray | None]:
        """Change of position (m) beyond constant velocity's, and of velocity (m/s), between two times.

        The third is the covariance (2, 2) of the two, on each axis, by what no sample has covered; None:
        nothing.
        """
        (vx, vy, vz), (px, py, pz) = self._at(start_s)
        (wx, wy, wz), (qx, qy, qz) = self._at(end_s)
        dt = end_s - start_s
        place, speed = (qx - px - vx * dt, qy - py - vy * dt, qz - pz - vz * dt), (wx - vx, wy - vy, wz - vz)
        if self._gaps or (self._times_s and end_s - self._times_s[-1] > LONGEST_STEP_S):
            return place, speed, self._unseen(start_s, end_s)
        return place, speed, None

    def _unseen(self, start_s: float, end_s: float) -> FloatArray | None:
        """White noise in the gaps, so that a motion in two steps is as uncertain as in one."""
        gaps, silent_s = self._gaps, end_s - self._times_s[-1]
        if silent_s > LONGEST_STEP_S:
            gaps = [*gaps, _Gap(self._times_s[-1], end_s, unseen_velocity_m2_s2(silent_s) / silent_s)]
        place = shared = speed = 0.0
        for gap in reversed(gaps):
            if gap.end_s <= start_s:
                break  # as all before it
            # since its start, and since its end
            long, short = end_s - max(start_s, gap.start_s), end_s - min(end_s, gap.end_s)
            if long > short:
                place += gap.density_m2_s3 * (long**3 - short**3) / 3.0
                shared += gap.density_m2_s3 * (long**2 - short**2) / 2.0
                speed += gap.density_m2_s3 * (long - short)
        return np.array(((place, shared), (shared, speed))) if speed else None

    def _at(self, time_s: float) -> tuple[Vector3, Vector3]:
        """Velocity and position integrals at a time; beyond the newest sample an acceleration goes on."""
        if not self._times_s:
            return ZERO3, ZERO3
        known_s = self._times_s[-1] + IMU_PREDICTED_S
        if time_s > known_s:
            speed, (x, y, z) = self._at(known_s)
            dt = time_s - known_s
            return speed, (x + speed[0] * dt, y + speed[1] * dt, z + speed[2] * dt)
        place = max(bisect_right(self._times_s, time_s) - 1, 0)
        dt = time_s - self._times_s[place]
        _, (vx, vy, vz), (px, py, pz), _ = self._samples[place]
        ax, ay, az = self._lasting
        if place + 1 < len(self._times_s):
            k = 1.0 / (self._times_s[place + 1] - self._times_s[place])
            wx, wy, wz = self._samples[place + 1][1]
            ax, ay, az = (wx - vx) * k, (wy - vy) * k, (wz - vz) * k
        h = 0.5 * dt * dt
        speed = (vx + ax * dt, vy + ay * dt, vz + az * dt)
        return speed, (px + vx * dt + h * ax, py + vy * dt + h * ay, pz + vz * dt + h * az)

    def _forget(self, before_s: float) -> None:
        old = bisect_right(self._times_s, before_s)
        del self._times_s[:old], self._samples[:old]
        self._gaps = [gap for gap in self._gaps if gap.end_s > before_s]


def unseen_velocity_m2_s2(span_s: float) -> float:
    """Variance, on an axis, of what a step of the IMU may have missed of the change of velocity (m²/s²).

    One longer than any in a healthy stream has seen only its ends: what lies between them may differ the more
    the longer it took.
    """
    unseen_s = max(span_s - LONGEST_STEP_S, 0.0)
    return (min(UNSEEN_ACCELERATION_M_S2, UNSEEN_JERK_M_S3 * unseen_s) * unseen_s) ** 2


def unseen_turn_rad2(span_s: float) -> float:
    """The same of the attitude (rad²)."""
    unseen_s = max(span_s - LONGEST_STEP_S, 0.0)
    return (min(UNSEEN_RATE_RAD_S, UNSEEN_TURN_RAD_S2 * unseen_s) * unseen_s) ** 2


def _turned(turn: Quaternion, gained: Vector3, weight: float) -> Vector3:
    """An integral of acceleration, of which gravity's share, which is no force, does not turn with it."""
    x, y, z = gained
    north, east, down = quat_rotate(turn, (x, y, z - GRAVITY_M_S2 * weight))
    return (north, east, down + GRAVITY_M_S2 * weight)


def misled_velocity_m_s(correction_rad: Vector3) -> float:
    """What a wrong attitude has made of gravity before it was corrected (m/s)."""
    return GRAVITY_M_S2 * norm(correction_rad) * WRONG_FOR_S


def turn_between(before: Quaternion, after: Quaternion) -> Vector3:
    """The rotation vector (rad, body) that takes one attitude to another."""
    w, x, y, z = before
    return rotation_vector_from_quat(quat_multiply((w, -x, -y, -z), after))


def part_way(before: Quaternion, after: Quaternion, share: float) -> Quaternion:
    """The attitude at a share of the shortest turn between two."""
    x, y, z = turn_between(before, after)
    return quat_multiply(before, quat_from_rotation_vector((x * share, y * share, z * share)))


def rotation_lever(place: Vector3) -> FloatArray:
    """The matrix (3, 3) that makes of a small rotation what it moves a place by: rotation x place."""
    x, y, z = place
    return np.array((0.0, z, -y, -z, 0.0, x, y, -x, 0.0)).reshape(3, 3)
