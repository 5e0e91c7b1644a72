"""What the sensors measured: lately, at a rest, and from one rest to the next. All that the check looks at.

`RecentSamples` stands where the estimator stands in flight (`companion.app.sensing.Estimates`): the check
wants the sensors as they are, not what a filter makes of them. Held still is by the camera: a slow move is
hidden from an accelerometer by the hand's tremor, a pad in the image shows it at once.

A move is a rotation (vector in the body axes before, rad) and a displacement (m) in level axes: forward and
right as the vehicle pointed before, and down. Level is by the pad for the camera, by gravity for the IMU,
which are independent. The IMU's displacement is integrated twice from rest to rest, which is possible because
the speed is zero at both ends: the straight line that brings the speed to zero there takes constant errors of
the accelerometer and of the levelling out (zero-velocity update; P. G. Savage, Strapdown Analytics, 2000).

Body axes are FRD, units SI, field µT; times are of measurement.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeVar

import numpy as np
from scipy.integrate import cumulative_trapezoid

from companion.base.geometry import (
    DOWN,
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    FloatArray,
    Quaternion,
    Vector3,
    cross,
    dot,
    norm,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_integrate,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    quat_rotate_inverse,
    rotation_vector_from_quat,
    scale,
    subtract,
    vector3,
)
from companion.base.messages import (
    AutopilotAttitude,
    GpsFix,
    ImuSample,
    MagSample,
    PadObservation,
    PadPrior,
    PadSighting,
    RangeSample,
)

MEMORY_S: Final = 120.0  # longer than a move may take
Sample = TypeVar("Sample", ImuSample, MagSample, PadSighting, RangeSample)


class RecentSamples:
    """Takes samples, forgets old ones, and hands out those of a time."""

    def __init__(self) -> None:
        self.imu: deque[ImuSample] = deque()
        self.mag: deque[MagSample] = deque()
        self.range: deque[RangeSample] = deque()
        self.sightings: deque[PadSighting] = deque()

    def add_imu(self, sample: ImuSample, received_s: float = math.inf) -> None:
        _keep(self.imu, sample)

    def add_mag(self, sample: MagSample) -> None:
        _keep(self.mag, sample)

    def add_range(self, sample: RangeSample) -> None:
        _keep(self.range, sample)

    def add_sighting(self, sighting: PadSighting) -> None:
        _keep(self.sightings, sighting)

    def add_gps(self, fix: GpsFix) -> None:
        """Says nothing of what is checked here."""

    def add_autopilot_attitude(self, sample: AutopilotAttitude) -> None:
        """Nor does this."""

    def add_autopilot_velocity(self, time_s: float, velocity_ned_m_s: Vector3) -> None:
        """Nor does this."""

    def observe(self, observation: PadObservation) -> None:
        """Nor what is no camera's."""

    def pad_prior(self, time_s: float) -> PadPrior | None:
        """Nothing is expected: gravity by a sensor that may be mounted wrongly must not guide vision."""
        return None


def within(samples: deque[Sample], start_s: float, end_s: float) -> list[Sample]:
    """Those measured from start to end, oldest first."""
    found = []
    for sample in reversed(samples):
        if sample.time_s < start_s:
            break
        if sample.time_s <= end_s:
            found.append(sample)
    return found[::-1]


def _keep(samples: deque[Sample], sample: Sample) -> None:
    samples.append(sample)
    while samples[0].time_s < sample.time_s - MEMORY_S:
        samples.popleft()


# ---------------------------------------------------------------- held still

REST_S: Final = 1.2
LEAST_SIGHTINGS: Final = 6
LEAST_IMU_SAMPLES: Final = 20
OLDEST_SIGHTING_S: Final = 0.4
# a hand's sway is within these, a move of a second or two is not (standard deviations over REST_S)
STILL_M: Final = 0.015
STILL_RAD: Final = math.radians(1.5)
STRAY_RAD: Final = math.radians(8.0)  # a pose that is turned further from the others is a wrong one
MOST_STRAYS: Final = 0.25


@dataclass(frozen=True, slots=True)
class StandstillMeans:
    """Means over a time at rest.

    The pad's pose is by the camera (`body_from_pad` turns pad axes into body axes). `range_m` is the median
    echo, `field_ut` the magnetic field; None where there was none.
    """

    start_s: float
    end_s: float
    pad_position_body_m: Vector3
    body_from_pad: Quaternion
    force_m_s2: Vector3
    rate_rad_s: Vector3
    range_m: float | None
    field_ut: Vector3 | None


def find_rest(samples: RecentSamples, now_s: float) -> StandstillMeans | None:
    """The vehicle at rest over the last REST_S, if it was, in sight of the pad and with its IMU alive."""
    sightings = within(samples.sightings, now_s - REST_S - OLDEST_SIGHTING_S, now_s)
    if not sightings or now_s - sightings[-1].time_s > OLDEST_SIGHTING_S:
        return None
    end_s = sightings[-1].time_s
    pose = still_pose([s for s in sightings if s.time_s >= end_s - REST_S])
    imu = within(samples.imu, end_s - REST_S, end_s)
    if pose is None or len(imu) < LEAST_IMU_SAMPLES:
        return None
    ranges = [s.distance_m for s in within(samples.range, end_s - REST_S, end_s)]
    fields = [s.field_body_ut for s in within(samples.mag, end_s - REST_S, end_s)]
    return StandstillMeans(
        start_s=end_s - REST_S,
        end_s=end_s,
        pad_position_body_m=pose[0],
        body_from_pad=pose[1],
        force_m_s2=vector3(np.mean([s.specific_force_body_m_s2 for s in imu], axis=0)),
        rate_rad_s=vector3(np.mean([s.rate_body_rad_s for s in imu], axis=0)),
        range_m=float(np.median(ranges)) if ranges else None,
        field_ut=vector3(np.mean(fields, axis=0)) if fields else None,
    )


def still_pose(sightings: list[PadSighting]) -> tuple[Vector3, Quaternion] | None:
    """Mean position and rotation of sightings that agree; None when too few do, or they move.

    The mean is taken about the pose that is nearest to all others, so that single flipped poses fall out.
    """
    if len(sightings) < LEAST_SIGHTINGS:
        return None
    middle = _medoid(sightings)
    turns = [
        rotation_vector_from_quat(quat_multiply(quat_conjugate(middle), s.body_from_pad)) for s in sightings
    ]
    kept = [k for k, turn in enumerate(turns) if norm(turn) < STRAY_RAD]
    if len(kept) < max(LEAST_SIGHTINGS, (1.0 - MOST_STRAYS) * len(sightings)):
        return None
    positions = np.array([sightings[k].pad_position_body_m for k in kept])
    rotations = np.array([turns[k] for k in kept])
    if _spread(positions) > STILL_M or _spread(rotations) > STILL_RAD:
        return None
    half = 0.5 * rotations.mean(axis=0)
    mean = quat_multiply(middle, quat_normalise((1.0, float(half[0]), float(half[1]), float(half[2]))))
    return vector3(positions.mean(axis=0)), mean


def _medoid(sightings: list[PadSighting]) -> Quaternion:
    """The rotation with the smallest sum of distances to the others."""
    rotations = np.array([s.body_from_pad for s in sightings])
    angles = np.arccos(np.abs(rotations @ rotations.T).clip(0.0, 1.0))
    return sightings[int(np.argmin(angles.sum(axis=1)))].body_from_pad


def _spread(values: FloatArray) -> float:
    """The largest standard deviation of a component; values (n, 3)."""
    return float(values.std(axis=0).max())


# ---------------------------------------------------------------- from one rest to the next


@dataclass(frozen=True, slots=True)
class Move:
    """Rotation (rad, body axes before) and displacement (m, level axes before: forward, right, down)."""

    rotation_rad: Vector3
    displacement_m: Vector3


def down_by_force(rest: StandstillMeans) -> Vector3:
    """Where down is in body axes, by the accelerometer."""
    return scale(rest.force_m_s2, -1.0 / max(norm(rest.force_m_s2), 1e-6))


def down_by_pad(rest: StandstillMeans) -> Vector3:
    """Where down is in body axes, by a pad that lies level."""
    return quat_rotate(rest.body_from_pad, DOWN)


def carried_along(vector_body: Vector3, rotation_rad: Vector3) -> Vector3:
    """What stands still in the world, in body axes before a rotation, in those after it."""
    return quat_rotate_inverse(quat_from_rotation_vector(rotation_rad), vector_body)


def levelled(down_body: Vector3) -> Quaternion:
    """The shortest rotation of body axes whose down is `down_body` into level ones."""
    x, y, z = cross(down_body, DOWN)
    w = 1.0 + dot(down_body, DOWN)
    return quat_normalise((w, x, y, z)) if w > 1e-6 else (0.0, 1.0, 0.0, 0.0)


def camera_move(before: StandstillMeans, after: StandstillMeans) -> Move:
    """By the pad, which stands still."""
    turned = quat_multiply(before.body_from_pad, quat_conjugate(after.body_from_pad))
    moved_pad = subtract(_place_on_pad(after), _place_on_pad(before))
    moved_body = quat_rotate(before.body_from_pad, moved_pad)
    return Move(rotation_vector_from_quat(turned), quat_rotate(levelled(down_by_pad(before)), moved_body))


def _place_on_pad(rest: StandstillMeans) -> Vector3:
    """Where the vehicle is, in the pad's axes (m)."""
    return quat_rotate_inverse(rest.body_from_pad, scale(rest.pad_position_body_m, -1.0))


def imu_move(
    before: StandstillMeans, after: StandstillMeans, imu: Sequence[ImuSample], rate_bias_rad_s: Vector3
) -> Move:
    """By gyroscope and accelerometer.

    What the gyroscope's zero is off by would tilt the horizon in the course of a move, and gravity would
    pass for acceleration; so for the displacement, not for the rotation, the horizons at both ends are
    made to fit: what is between them is taken as a further bias.

    Args:
        before: the rest that the move begins in.
        after: the rest that it ends in.
        imu: the samples from the start of the one to the end of the other.
        rate_bias_rad_s: the gyroscope's zero.

    Returns:
        The move; none where the samples are too few.
    """
    if len(imu) < LEAST_IMU_SAMPLES:
        return Move(ZERO3, ZERO3)
    turned = _attitudes(imu, rate_bias_rad_s)[-1]
    down = down_by_force(before)
    tilt = cross(quat_rotate(turned, down_by_force(after)), down)
    bias = subtract(rate_bias_rad_s, scale(tilt, 1.0 / (imu[-1].time_s - imu[0].time_s)))
    level = levelled(down)
    forces = [
        quat_rotate(quat_multiply(level, attitude), sample.specific_force_body_m_s2)
        for attitude, sample in zip(_attitudes(imu, bias), imu, strict=True)
    ]
    accelerations = np.array(forces) + np.array((0.0, 0.0, GRAVITY_M_S2))
    displacement = _rest_to_rest(np.array([sample.time_s for sample in imu]), accelerations)
    return Move(rotation_vector_from_quat(turned), vector3(displacement))


def longest_gap_s(imu: Sequence[ImuSample], start_s: float, end_s: float) -> float:
    """The longest time without a sample that is not all before the start or after the end.

    Over a long one no move can be integrated; over a rest, in which nothing changes, it can.
    """
    gaps = (
        new.time_s - old.time_s for old, new in pairwise(imu) if new.time_s > start_s and old.time_s < end_s
    )
    return max(gaps, default=0.0)


def _attitudes(imu: Sequence[ImuSample], rate_bias_rad_s: Vector3) -> list[Quaternion]:
    """The rotation from body axes at each sample into those at the first."""
    attitudes = [IDENTITY]
    for old, new in pairwise(imu):
        rate = subtract(new.rate_body_rad_s, rate_bias_rad_s)
        attitudes.append(quat_integrate(attitudes[-1], rate, new.time_s - old.time_s))
    return attitudes


def _rest_to_rest(times_s: FloatArray, accelerations_m_s2: FloatArray) -> FloatArray:
    """The way (3,) by accelerations (n, 3) at times (n,) whose first and last REST_S are at rest.

    On the mean of such a time a hand stands still, at no instant of it does it quite.
    """
    velocities = cumulative_trapezoid(accelerations_m_s2, times_s, axis=0, initial=0.0)
    first, last = times_s <= times_s[0] + REST_S, times_s >= times_s[-1] - REST_S
    begin_s, end_s = times_s[first].mean(), times_s[last].mean()
    start, end = velocities[first].mean(axis=0), velocities[last].mean(axis=0)
    share = (times_s - begin_s) / max(end_s - begin_s, REST_S)
    level = velocities - start - share[:, None] * (end - start)
    places = cumulative_trapezoid(level, times_s, axis=0, initial=0.0)
    return np.asarray(places[last].mean(axis=0) - places[first].mean(axis=0))
