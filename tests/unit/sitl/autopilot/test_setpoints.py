"""Every type_mask and frame of the streamed setpoints, read as PX4 and as ArduCopter read them."""

import itertools
import math
from math import inf, isnan, nan

import pytest

from companion.base.geometry import IDENTITY, ZERO3, Vector3, quat_from_euler
from sitl.autopilot.ardupilot import setpoints as ardupilot_setpoints
from sitl.autopilot.control.setpoints import (
    STOP,
    AttitudeSetpoint,
    GlobalFrame,
    Ignore,
    IgnoreAttitude,
    LocalFrame,
    MotionSetpoint,
    SetpointRefusal,
    StreamedAttitude,
    StreamedMotion,
)
from sitl.autopilot.px4 import setpoints as px4_setpoints
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight, velocity

HERE: Vector3 = (10.0, 20.0, -5.0)
MASKS = range(1 << 12)
POSITION, VELOCITY, ACCELERATION = 7, 7 << 3, 7 << 6


def fields(frame: int, mask: int, *, is_global: bool = False) -> StreamedMotion:
    place, velocity, acceleration = (1.0, 2.0, -3.0), (0.5, 0.0, 0.1), (0.0, 1.0, 0.2)
    return StreamedMotion(frame, mask, place, velocity, acceleration, 0.2, 0.3, is_global)


def px4(message: StreamedMotion, heading: float = 0.0) -> MotionSetpoint | SetpointRefusal:
    return px4_setpoints.read_motion(message, HERE, quat_from_euler(0.0, 0.0, heading), heading)


def ardupilot(message: StreamedMotion, heading: float = 0.0) -> MotionSetpoint | SetpointRefusal:
    return ardupilot_setpoints.read_motion(message, HERE, quat_from_euler(0.0, 0.0, heading), heading)


def same(a: Vector3, b: Vector3) -> bool:
    return all((isnan(x) and isnan(y)) or x == y for x, y in zip(a, b, strict=True))


# ---------------------------------------------------------------- PX4


def px4_expects(mask: int) -> MotionSetpoint | SetpointRefusal:
    """PX4's rule in other words: each axis with its own kinds, north's as east's."""
    message = fields(LocalFrame.LOCAL_NED, mask)
    kinds = [[not mask >> (3 * kind + axis) & 1 for kind in range(3)] for axis in range(3)]
    if mask & Ignore.FORCE and any(axis[2] for axis in kinds):
        return SetpointRefusal("SET_POSITION_TARGET_LOCAL_NED force not supported")
    if not any(itertools.chain(*kinds)):
        return SetpointRefusal("SET_POSITION_TARGET_LOCAL_NED invalid")
    if kinds[0] != kinds[1] or not all(any(axis) for axis in kinds):
        return STOP
    given = (message.position_m, message.velocity_m_s, message.acceleration_m_s2)
    position, velocity, acceleration = (
        tuple(value if kinds[axis][kind] else nan for axis, value in enumerate(vector))
        for kind, vector in enumerate(given)
    )
    return MotionSetpoint(
        position,  # type: ignore[arg-type]
        velocity,  # type: ignore[arg-type]
        acceleration,  # type: ignore[arg-type]
        nan if mask & Ignore.YAW else 0.2,
        nan if mask & Ignore.YAW_RATE else 0.3,
    )


def agree(read: MotionSetpoint | SetpointRefusal, expected: MotionSetpoint | SetpointRefusal) -> bool:
    if isinstance(read, SetpointRefusal) or isinstance(expected, SetpointRefusal):
        return read == expected
    return (
        same(read.position_ned_m, expected.position_ned_m)
        and same(read.velocity_ned_m_s, expected.velocity_ned_m_s)
        and same(read.acceleration_ned_m_s2, expected.acceleration_ned_m_s2)
        and same((read.yaw_rad, read.yaw_rate_rad_s, 0.0), (expected.yaw_rad, expected.yaw_rate_rad_s, 0.0))
    )


def test_px4_obeys_or_refuses_each_of_the_4096_masks_as_it_should() -> None:
    wrong = [mask for mask in MASKS if not agree(px4(fields(LocalFrame.LOCAL_NED, mask)), px4_expects(mask))]
    assert wrong == []


@pytest.mark.parametrize("frame", [0, 7, 9, 12, 20])
def test_px4_answers_other_frames_with_a_text(frame: int) -> None:
    text = f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported"
    assert {px4(fields(frame, mask)) for mask in MASKS} == {SetpointRefusal(text)}


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0, 270.0])
def test_px4s_body_frame_takes_velocity_and_acceleration_whole_and_no_place(heading_deg: float) -> None:
    heading = math.radians(heading_deg)
    c, s = math.cos(heading), math.sin(heading)
    for mask in MASKS:
        velocity, acceleration = not mask & VELOCITY, not mask & ACCELERATION
        read = px4(fields(LocalFrame.BODY_NED, mask), heading)
        if mask & Ignore.FORCE and acceleration:
            assert read == SetpointRefusal("SET_POSITION_TARGET_LOCAL_NED force not supported")
        elif not velocity and not acceleration:
            assert read == SetpointRefusal("SET_POSITION_TARGET_LOCAL_NED invalid")
        else:
            assert isinstance(read, MotionSetpoint)
            assert all(map(isnan, read.position_ned_m))
            wanted = (0.5 * c, 0.5 * s, 0.1) if velocity else (nan, nan, nan)
            assert read.velocity_ned_m_s == pytest.approx(wanted, nan_ok=True)


def test_px4s_body_acceleration_turns_with_the_whole_attitude() -> None:
    tilt = quat_from_euler(0.0, math.radians(30.0), 0.0)
    message = StreamedMotion(
        LocalFrame.BODY_NED, POSITION | VELOCITY, ZERO3, ZERO3, (1.0, 0.0, 0.0), 0.0, 0.0
    )
    read = px4_setpoints.read_motion(message, HERE, tilt, 0.0)
    assert isinstance(read, MotionSetpoint)
    assert read.acceleration_ned_m_s2 == pytest.approx((math.cos(math.radians(30.0)), 0.0, -0.5))


@pytest.mark.parametrize("frame", [*GlobalFrame, 1, 9])
def test_px4_takes_a_global_place_whole_and_above_sea_or_home_alone(frame: int) -> None:
    with_place = px4(fields(frame, VELOCITY | ACCELERATION, is_global=True))
    if frame in (GlobalFrame.GLOBAL_INT, GlobalFrame.RELATIVE_ALT_INT):
        assert isinstance(with_place, MotionSetpoint)
        assert with_place.position_ned_m == (1.0, 2.0, -3.0)
    elif frame == GlobalFrame.TERRAIN_ALT_INT:
        assert with_place == SetpointRefusal()
    else:
        assert with_place == SetpointRefusal(
            f"SET_POSITION_TARGET_GLOBAL_INT invalid coordinate frame {frame}"
        )
    for part in range(1, 8):
        read = px4(fields(frame, part | ACCELERATION, is_global=True))
        assert isinstance(read, MotionSetpoint)
        assert all(map(isnan, read.position_ned_m))
    assert px4(fields(frame, 0x1FF, is_global=True)) == SetpointRefusal()


# ---------------------------------------------------------------- ArduPilot


@pytest.mark.parametrize("frame", list(LocalFrame))
def test_ardupilot_obeys_or_stops_at_each_of_the_4096_masks_as_it_should(frame: LocalFrame) -> None:
    for mask in MASKS:
        place, velocity, acceleration = (not mask & part for part in (POSITION, VELOCITY, ACCELERATION))
        read = ardupilot(fields(frame, mask))
        kinds = (place, velocity, acceleration)
        lonely_or_none = kinds in ((False, False, False), (True, False, True))
        if lonely_or_none or (mask & Ignore.FORCE and acceleration):
            assert read == STOP, mask
            continue
        assert isinstance(read, MotionSetpoint)
        given = (read.position_ned_m, read.velocity_ned_m_s, read.acceleration_ned_m_s2)
        assert tuple(not isnan(vector[0]) for vector in given) == kinds, mask
        assert isnan(read.yaw_rad) == bool(mask & Ignore.YAW)


@pytest.mark.parametrize("frame", [0, 2, 10, 12, 21])
def test_ardupilot_stops_at_frames_it_does_not_know(frame: int) -> None:
    assert {ardupilot(fields(frame, mask)) for mask in MASKS} == {STOP}


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0, 270.0])
def test_ardupilots_frames_turn_and_shift_as_they_should(heading_deg: float) -> None:
    heading = math.radians(heading_deg)
    c, s = math.cos(heading), math.sin(heading)
    offset = ardupilot(fields(LocalFrame.LOCAL_OFFSET_NED, 0), heading)
    assert isinstance(offset, MotionSetpoint)
    assert offset.position_ned_m == pytest.approx((11.0, 22.0, -8.0))
    assert offset.velocity_ned_m_s == (0.5, 0.0, 0.1)
    for frame in (LocalFrame.BODY_NED, LocalFrame.BODY_OFFSET_NED):
        body = ardupilot(fields(frame, 0), heading)
        assert isinstance(body, MotionSetpoint)
        assert body.position_ned_m == pytest.approx((10.0 + c - 2 * s, 20.0 + s + 2 * c, -8.0))
        assert body.velocity_ned_m_s == pytest.approx((0.5 * c, 0.5 * s, 0.1))
        assert body.acceleration_ned_m_s2 == pytest.approx((-s, c, 0.2))
        assert body.yaw_rad == pytest.approx(0.2 + heading)


@pytest.mark.parametrize("frame", [*GlobalFrame, 1, 9])
def test_ardupilot_takes_global_places_in_every_frame_it_knows(frame: int) -> None:
    place = ardupilot(fields(frame, VELOCITY | ACCELERATION, is_global=True))
    moving = ardupilot(fields(frame, ACCELERATION, is_global=True))
    if frame in (GlobalFrame.TERRAIN_ALT, GlobalFrame.TERRAIN_ALT_INT):
        assert (place, moving) == (SetpointRefusal(), STOP)
    elif frame in set(GlobalFrame):
        assert isinstance(place, MotionSetpoint)
        assert place.position_ned_m == (1.0, 2.0, -3.0)
        assert isinstance(moving, MotionSetpoint)
        assert moving.velocity_ned_m_s == (0.5, 0.0, 0.1)
    else:
        assert (place, moving) == (STOP, STOP)
    velocity = ardupilot(fields(frame, POSITION | ACCELERATION, is_global=True))
    assert isinstance(velocity, MotionSetpoint)
    assert velocity.velocity_ned_m_s == (0.5, 0.0, 0.1)


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_numbers_that_are_none_stop_ardupilot_and_are_not_given_to_px4(bad: float) -> None:
    poisoned = StreamedMotion(1, 0, (0.0, bad, 0.0), ZERO3, ZERO3, bad, bad)
    assert ardupilot(poisoned) == STOP
    assert px4(poisoned) == STOP  # a north without its east
    heights = StreamedMotion(1, 0, (0.0, 0.0, bad), ZERO3, ZERO3, bad, bad)
    read = px4(heights)
    assert isinstance(read, MotionSetpoint)
    assert [isnan(value) for value in read.position_ned_m] == [False, False, True]
    assert isnan(read.yaw_rad)


# ---------------------------------------------------------------- attitudes


def attitude(mask: int, q: tuple[float, float, float, float] = IDENTITY) -> StreamedAttitude:
    return StreamedAttitude(mask, q, (0.1, 0.2, 0.3), 0.6)


def test_px4_reads_each_of_the_256_attitude_masks_as_it_should() -> None:
    for mask in range(256):
        read = px4_setpoints.read_attitude(attitude(mask))
        part = mask & (IgnoreAttitude.ROLL_RATE | IgnoreAttitude.PITCH_RATE)
        if mask & IgnoreAttitude.THRUST_BODY or (mask & IgnoreAttitude.ATTITUDE and part):
            assert read == SetpointRefusal(), mask
            continue
        assert isinstance(read, AttitudeSetpoint)
        yaw = 0.0 if mask & IgnoreAttitude.YAW_RATE else 0.3
        assert read.thrust == (0.0 if mask & IgnoreAttitude.THROTTLE else 0.6)
        if mask & IgnoreAttitude.ATTITUDE:
            assert (read.attitude, read.rate_body_rad_s) == (None, (0.1, 0.2, yaw))
        else:
            assert (read.attitude, read.yaw_rate_rad_s) == (IDENTITY, yaw)


def test_ardupilot_reads_each_of_the_256_attitude_masks_as_it_should() -> None:
    for mask in range(256):
        read = ardupilot_setpoints.read_attitude(attitude(mask))
        if mask & IgnoreAttitude.THROTTLE or mask & 7 not in (0, 7):
            assert read == STOP, mask
            continue
        assert isinstance(read, AttitudeSetpoint)
        assert (read.attitude is None) == bool(mask & IgnoreAttitude.ATTITUDE)
        assert read.rate_body_rad_s == (ZERO3 if mask & 7 else (0.1, 0.2, 0.3))


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (nan, 0.0, 0.0, 0.0), (1.1, 0.0, 0.0, 0.0)])
def test_an_attitude_that_is_none_stops_ardupilot_and_is_nothing_to_px4(
    q: tuple[float, float, float, float],
) -> None:
    assert ardupilot_setpoints.read_attitude(attitude(7, q)) == STOP
    assert px4_setpoints.read_attitude(attitude(7, q)) == SetpointRefusal()


# ---------------------------------------------------------------- age


def test_ardupilots_setpoints_age_into_a_stop_a_place_or_level_flight() -> None:
    place = MotionSetpoint((1.0, 2.0, -3.0), yaw_rate_rad_s=0.5)
    moving = MotionSetpoint((1.0, 2.0, -3.0), (2.0, 0.0, 0.0))
    speed = MotionSetpoint(velocity_ned_m_s=(1.0, 0.0, 0.0))
    tilt = AttitudeSetpoint(quat_from_euler(0.0, 0.1, 0.0), 0.7)

    def aged(setpoint: MotionSetpoint | AttitudeSetpoint, age_s: float) -> MotionSetpoint | AttitudeSetpoint:
        return ardupilot_setpoints.as_aged(setpoint, age_s, 3.0, math.radians(90.0))

    assert aged(place, 2.9) is place
    late = aged(place, 3.1)
    assert isinstance(late, MotionSetpoint)
    assert (late.position_ned_m, isnan(late.yaw_rate_rad_s)) == ((1.0, 2.0, -3.0), True)
    under_way, over = aged(moving, 1.0), aged(moving, 9.0)
    assert isinstance(under_way, MotionSetpoint)
    assert isinstance(over, MotionSetpoint)
    assert under_way.position_ned_m == (3.0, 2.0, -3.0)
    assert over.position_ned_m == (7.0, 2.0, -3.0)
    assert isnan(over.velocity_ned_m_s[0])
    stopped = aged(speed, 3.1)
    assert isinstance(stopped, MotionSetpoint)
    assert stopped.velocity_ned_m_s == ZERO3
    assert aged(tilt, 3.0) is tilt
    level = aged(tilt, 3.1)
    assert isinstance(level, AttitudeSetpoint)
    assert level.attitude == pytest.approx(quat_from_euler(0.0, 0.0, math.radians(90.0)))
    assert level.thrust == 0.5


# ---------------------------------------------------------------- GUIDED_NOGPS


def test_guided_nogps_lifts_off_by_an_attitude_that_climbs_and_then_holds_level() -> None:
    flight, level = AutopilotFlight("ardupilot"), quat_from_euler(0.0, 0.0, 0.0)
    flight.run(6.0)
    assert flight.autopilot.set_mode(20) == 0
    assert flight.autopilot.arm() == 0
    flight.run(2.0, AttitudeSetpoint(level, 0.5))
    assert flight.vehicle.height_m == 0.0
    flight.run(4.0, AttitudeSetpoint(level, 0.7))  # 1 m/s
    assert 1.5 < flight.vehicle.height_m < 4.0
    flight.run(2.0, AttitudeSetpoint(quat_from_euler(0.0, -0.1, 0.0), 0.5))
    north, *_ = flight.vehicle.position
    assert north > 0.5
    # nothing but attitudes moves it, and without a place to hold it coasts on, level
    flight.run(3.0, velocity(-3.0))
    assert flight.vehicle.position[0] > north + 0.5
    assert flight.vehicle.attitude == pytest.approx(level, abs=0.02)
