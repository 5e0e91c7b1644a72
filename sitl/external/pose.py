"""The pose of an external vehicle: its simulator's MAVLink messages -> poses, and interpolation. Pure.

    SIM_STATE             ArduPilot's SITL: the truth. Float quaternion and velocity; place in 1e-7 deg
                          (11 mm), altitude in cm. Older ones have the place as float alone (0.4 m). Without
                          a stamp
    HIL_STATE_QUATERNION  PX4's SITL and SIH: the truth. 1e-7 deg, mm, cm/s; PX4 leaves the stamp 0
    LOCAL_POSITION_NED    with ATTITUDE_QUATERNION: the autopilot's estimate, without the truth; its frame is
                          tied to the globe by a GLOBAL_POSITION_INT

A message without a stamp gets its arrival time: on a loopback it is some
milliseconds old. NED, FRD, SI; quaternions (w, x, y, z) body to NED.
"""

import math
from bisect import bisect_right
from typing import Final, NamedTuple

from companion.base.geometry import (
    Quaternion,
    Vector3,
    add,
    between,
    geodetic_from_ned,
    norm,
    quat_between,
    quat_from_euler,
    quat_integrate,
    quat_normalise,
    scale,
    subtract,
)
from companion.link.codec import Message, mavlink

LOCAL_POSITION: Final = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
ATTITUDE: Final = mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
GLOBAL_POSITION: Final = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT

MEMORY_S: Final = 2.0
LONGEST_GUESS_S: Final = 0.1  # how far a pose is carried on beyond the newest message
# the message's place is rounded to a cell: velocity leads, drawn back into it and, slowly, to its middle
CELL_M: Final = 0.006
BACK_S: Final = 0.1
CENTRING_S: Final = 1.0
JUMP_M: Final = 1.0  # a place that is this far from where the velocity led is a new one
GAP_S: Final = 0.5
# limits of plausible values of a multirotor
MOST_ANGLE_RAD: Final = 10.0
MOST_RATE_RAD_S: Final = 100.0
MOST_SPEED_M_S: Final = 500.0
MOST_ALTITUDE_M: Final = 100_000.0
FARTHEST_M: Final = 1e6  # from the local frame's origin
UNIT_TOLERANCE: Final = 0.1  # of a quaternion's squared length


class Sample(NamedTuple):
    """One message: place as latitude (deg), longitude (deg), altitude (m).

    `simulated_s` is the time of the vehicle's simulator then, from any start; NaN: not known.
    """

    time_s: float
    place: Vector3
    velocity_ned_m_s: Vector3
    attitude: Quaternion
    rate_body_rad_s: Vector3
    simulated_s: float = math.nan


class Pose(NamedTuple):
    """The vehicle at one time; position NED from the world's origin, `simulated_s` as of `Sample`."""

    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    attitude: Quaternion
    rate_body_rad_s: Vector3
    simulated_s: float = math.nan


def sim_state(message: Message, time_s: float) -> Sample | None:
    """SIM_STATE that came at time_s; None when it holds no pose."""
    attitude = _unit((message.q1, message.q2, message.q3, message.q4))
    if attitude is None:
        angles = (message.roll, message.pitch, message.yaw)
        if not all(abs(angle) <= MOST_ANGLE_RAD for angle in angles):
            return None
        attitude = quat_from_euler(*angles)
    latitude, longitude = message.lat_int * 1e-7, message.lon_int * 1e-7
    if message.lat_int == 0 and message.lon_int == 0:
        # the float fields; ArduPilot puts 1e-7 deg into them as well
        factor = 1e-7 if max(abs(message.lat), abs(message.lon)) > 360.0 else 1.0
        latitude, longitude = message.lat * factor, message.lon * factor
    return _sample(
        time_s,
        (latitude, longitude, message.alt),
        (message.vn, message.ve, message.vd),
        attitude,
        (message.xgyro, message.ygyro, message.zgyro),
    )


def hil_state(message: Message, time_s: float) -> Sample | None:
    """HIL_STATE_QUATERNION of time_s; None when it holds no pose (PX4 sends zeros before it has one)."""
    attitude = _unit(tuple(message.attitude_quaternion))
    if attitude is None:
        return None
    return _sample(
        time_s,
        (message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3),
        (message.vx * 1e-2, message.vy * 1e-2, message.vz * 1e-2),
        attitude,
        (message.rollspeed, message.pitchspeed, message.yawspeed),
    )


class LocalOrigin(NamedTuple):
    """Where the estimates' local frame lies on the globe: a place, and the local position (m, NED) there."""

    place: Vector3
    local_ned_m: Vector3


def local_origin(local: Message, position: Message) -> LocalOrigin | None:
    """Of a LOCAL_POSITION_NED and the GLOBAL_POSITION_INT of about then; None when either holds no place."""
    place = place_of(position.lat, position.lon, position.alt)
    there = (local.x, local.y, local.z)
    return LocalOrigin(place, there) if place is not None and norm(there) <= FARTHEST_M else None


def estimate(local: Message, attitude: Message, tied: LocalOrigin, time_s: float) -> Sample | None:
    """LOCAL_POSITION_NED and the last ATTITUDE_QUATERNION; None when they hold no pose."""
    unit = _unit((attitude.q1, attitude.q2, attitude.q3, attitude.q4))
    away = subtract((local.x, local.y, local.z), tied.local_ned_m)
    if unit is None or not norm(away) <= FARTHEST_M:  # or no number
        return None
    return _sample(
        time_s,
        geodetic_from_ned(away, tied.place),
        (local.vx, local.vy, local.vz),
        unit,
        (attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed),
    )


def place_of(latitude_e7: int, longitude_e7: int, altitude_mm: int) -> Vector3 | None:
    """Latitude (deg), longitude (deg), altitude (m) of a message in 1e-7 deg and mm; None: it has none."""
    place = (latitude_e7 * 1e-7, longitude_e7 * 1e-7, altitude_mm * 1e-3)
    return place if _on_globe(place) else None


def _on_globe(place: Vector3) -> bool:
    """0/0 is what an autopilot sends before it knows."""
    latitude, longitude, _ = place
    return (latitude != 0.0 or longitude != 0.0) and abs(latitude) <= 90.0 and abs(longitude) <= 180.0


def _sample(
    time_s: float, place: Vector3, velocity: Vector3, attitude: Quaternion, rate: Vector3
) -> Sample | None:
    sample = Sample(time_s, place, velocity, attitude, rate)
    return sample if believable(sample) else None


def believable(sample: Sample) -> bool:
    """Whether these are numbers, and within what a vehicle can do; huge ones would overflow further on."""
    return (
        _on_globe(sample.place)
        and abs(sample.place[2]) <= MOST_ALTITUDE_M
        and all(abs(speed) <= MOST_SPEED_M_S for speed in sample.velocity_ned_m_s)
        and all(abs(rate) <= MOST_RATE_RAD_S for rate in sample.rate_body_rad_s)
        and abs(sum(part * part for part in sample.attitude) - 1.0) <= UNIT_TOLERANCE
    )


def _unit(values: tuple[float, ...]) -> Quaternion | None:
    w, x, y, z = values
    length = w * w + x * x + y * y + z * z
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        return None
    return quat_normalise((w, x, y, z))


class PoseTrack:
    """The poses of the last seconds. `at` may be called from another thread than `put`.

    What it gives has in `simulated_s` how long the vehicle's simulator has gone on: on a busy machine that
    stands still at times, and slower than ours it is always.
    """

    def __init__(self) -> None:
        self._poses: tuple[Pose, ...] = ()
        self._anew = True
        self._stamp_s = math.nan

    @property
    def newest(self) -> Pose | None:
        return self._poses[-1] if self._poses else None

    def put(self, pose: Pose) -> Pose | None:
        """Take the next pose; returns it as it is kept, smoothed, or None when it is no newer than the last.

        A clock that went back by more than the stored span is a restarted simulator.
        """
        last = self.newest
        if self._anew or last is None:
            self._anew = False
            return self._begin(pose, pose.time_s)
        if last.time_s - MEMORY_S < pose.time_s <= last.time_s:
            return None
        if not 0.0 < pose.time_s - last.time_s < GAP_S:
            return self._begin(pose, last.simulated_s + max(0.0, pose.time_s - last.time_s))
        step_s = pose.simulated_s - self._stamp_s
        if not -GAP_S < step_s < GAP_S:  # without stamps, or by a clock that was set
            step_s = pose.time_s - last.time_s
            self._stamp_s = pose.simulated_s
        # one that was read late goes back by a little: the next makes up for it
        self._stamp_s = max(self._stamp_s, pose.simulated_s)
        kept = _smoothed(last, pose._replace(simulated_s=last.simulated_s + max(step_s, 0.0)))
        older = tuple(p for p in self._poses if p.time_s > pose.time_s - MEMORY_S)
        self._poses = (*older, kept)
        return kept

    def _begin(self, pose: Pose, simulated_s: float) -> Pose:
        self._stamp_s = pose.simulated_s
        pose = pose._replace(simulated_s=simulated_s)
        self._poses = (pose,)
        return pose

    def begin_anew(self) -> None:
        """Clear with the next pose, not before: another thread may be reading."""
        self._anew = True

    def at(self, time_s: float) -> Pose:
        """The pose at a time: between two messages, or carried on from the newest for `LONGEST_GUESS_S`.

        Raises:
            ValueError: there is no pose at all.
        """
        poses = self._poses
        if not poses:
            raise ValueError("no pose has come")
        i = bisect_right(poses, time_s, key=lambda pose: pose.time_s)
        if i == 0:
            return poses[0]
        if i == len(poses):
            return _carried_on(poses[-1], min(time_s - poses[-1].time_s, LONGEST_GUESS_S))
        return _between(poses[i - 1], poses[i], time_s)


def _smoothed(last: Pose, pose: Pose) -> Pose:
    """The place that velocity leads to, kept within the cell that the message's is rounded to.

    A vehicle low over a pad sees a step of a centimetre as a pad that jumps. Where the velocity itself jumps,
    as at a contact, it does not describe the motion between two messages, and the position counts at once.
    """
    dt_s = pose.simulated_s - last.simulated_s
    back, centring = -math.expm1(-dt_s / BACK_S), -math.expm1(-dt_s / CENTRING_S)
    led = add(last.position_ned_m, scale(add(last.velocity_ned_m_s, pose.velocity_ned_m_s), 0.5 * dt_s))
    missed = subtract(pose.position_ned_m, led)
    if norm(missed) > JUMP_M:
        return pose

    def drawn(place: float, off: float, jump_m_s: float) -> float:
        if abs(jump_m_s) * dt_s > CELL_M:
            return place + off
        inside = max(-CELL_M, min(CELL_M, off))
        return place + centring * inside + back * (off - inside)

    jumps = subtract(pose.velocity_ned_m_s, last.velocity_ned_m_s)
    x, y, z = map(drawn, led, missed, jumps)
    return pose._replace(position_ned_m=(x, y, z))


def _carried_on(pose: Pose, dt_s: float) -> Pose:
    return pose._replace(
        time_s=pose.time_s + dt_s,
        simulated_s=pose.simulated_s + dt_s,
        position_ned_m=add(pose.position_ned_m, scale(pose.velocity_ned_m_s, dt_s)),
        attitude=quat_integrate(pose.attitude, pose.rate_body_rad_s, dt_s),
    )


def _between(a: Pose, b: Pose, time_s: float) -> Pose:
    """A cubic through both places with both velocities; the attitude straight between."""
    k, dt_s = (time_s - a.time_s) / (b.time_s - a.time_s), b.simulated_s - a.simulated_s
    h = k * k * (3.0 - 2.0 * k)
    from_a, from_b = dt_s * k * (1.0 - k) ** 2, -dt_s * k * k * (1.0 - k)
    position = add(between(a.position_ned_m, b.position_ned_m, h), scale(a.velocity_ned_m_s, from_a))
    return Pose(
        time_s=time_s,
        position_ned_m=add(position, scale(b.velocity_ned_m_s, from_b)),
        velocity_ned_m_s=between(a.velocity_ned_m_s, b.velocity_ned_m_s, k),
        attitude=quat_between(a.attitude, b.attitude, k),
        rate_body_rad_s=between(a.rate_body_rad_s, b.rate_body_rad_s, k),
        simulated_s=a.simulated_s + k * (b.simulated_s - a.simulated_s),
    )
