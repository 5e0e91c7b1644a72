"""Every type_mask and frame of the streamed setpoints, read as PX4 and as ArduCopter read them."""

import itertools
import math
from math import inf, isnan, nan
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import IDENTITY, ZERO3, Vector3, quat_from_euler, tilt_from_quat, yaw_from_quat
from sitl.autopilot.ardupilot import control as ardupilot_setpoints
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
from sitl.autopilot.control.shaping import (
    FirstOrderLowPass,
    Path1,
    Path2,
    ShapingLimits,
    root_law,
    signed_root_law,
)
from sitl.autopilot.px4 import control as px4_setpoints
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight, velocity
from tests.unit.sitl.autopilot.missions.mission_desk import Station

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


# ---------------- Jerk-limited paths: they arrive, keep their limits, and stop where they should

LIMITS = ShapingLimits(acceleration=2.5, jerk=5.0)
DT_S = 0.01


def test_the_root_law_joins_smoothly_and_never_asks_for_more_than_can_be_braked() -> None:
    knee = LIMITS.braking / LIMITS.position_gain**2
    below, above = (root_law(knee + d, LIMITS.position_gain, LIMITS.braking, DT_S) for d in (-1e-6, 1e-6))
    assert above == pytest.approx(below, abs=1e-5)
    for distance in (0.1, 1.0, 5.0, 50.0):
        speed = root_law(distance, LIMITS.position_gain, LIMITS.braking, DT_S)
        assert speed * speed <= 2.0 * LIMITS.braking * distance
        assert signed_root_law(-distance, LIMITS.position_gain, LIMITS.braking, DT_S) == -speed


@pytest.mark.parametrize("distance_m", [0.3, 5.0, 40.0])
def test_a_path_to_a_place_keeps_its_limits_and_overshoots_little(distance_m: float) -> None:
    path, last = Path2(), (0.0, 0.0)
    furthest = fastest = hardest = jerkiest = 0.0
    place = (0.6 * distance_m, 0.8 * distance_m)
    for _ in range(4000):
        path.to_place(place, (0.0, 0.0), (0.0, 0.0), 4.0, LIMITS, DT_S)
        furthest = max(furthest, 0.6 * path.position[0] + 0.8 * path.position[1])
        fastest = max(fastest, math.hypot(*path.velocity))
        hardest = max(hardest, math.hypot(*path.acceleration))
        jerkiest = max(jerkiest, math.dist(path.acceleration, last) / DT_S)
        last = path.acceleration
    assert path.position == pytest.approx(place, abs=1e-3)
    assert furthest < 1.05 * distance_m
    assert fastest < 4.1
    assert hardest <= LIMITS.acceleration * 1.001
    assert jerkiest <= LIMITS.jerk * 1.001


def test_one_axis_moves_as_a_plane_does_along_one_of_its_axes_and_an_acceleration_is_flown_on() -> None:
    line, plane = Path1(), Path2()
    for step in range(600):
        wish = 1.0 if step < 300 else -0.5
        line.to_velocity(wish, 0.0, LIMITS, DT_S)
        plane.to_velocity((wish, 0.0), (0.0, 0.0), LIMITS, DT_S)
    assert (line.position, line.velocity) == pytest.approx((plane.position[0], plane.velocity[0]))
    assert line.velocity == pytest.approx(-0.5, abs=1e-2)
    path = Path1()
    for _ in range(200):
        path.to_acceleration(1.0, LIMITS, DT_S)
    # 0.2 s of jerk cost 0.1 m/s
    assert path.velocity == pytest.approx(1.9, abs=0.01)


def test_a_path_waits_where_the_vehicle_cannot_follow_and_goes_on_every_other_way() -> None:
    line, plane = Path1(velocity=1.0), Path2(velocity=(1.0, 1.0))
    line.limit, line.behind_m, line.slower_m_s = 1.0, 0.5, 0.5
    plane.limit, plane.behind_m, plane.slower_m_s = (3.0, 0.0), (0.5, 0.0), (0.5, 0.0)
    for _ in range(100):
        line.to_acceleration(1.0, LIMITS, DT_S)
        plane.to_acceleration((1.0, 1.0), LIMITS, DT_S)
    assert (line.position, line.velocity) == (0.0, 1.0)
    assert (plane.position, plane.velocity) == ((0.0, 0.0), (1.0, 1.0))
    for _ in range(400):  # braking and turning back are free
        line.to_velocity(-1.0, 0.0, LIMITS, DT_S)
        plane.to_velocity((-1.0, 0.0), (0.0, 0.0), LIMITS, DT_S)
    assert line.velocity == pytest.approx(-1.0, abs=1e-2)
    assert plane.velocity == pytest.approx((-1.0, 0.0), abs=1e-2)
    assert line.position < -1.0
    for _ in range(400):  # and it may brake into the limit
        line.to_velocity(1.0, 0.0, LIMITS, DT_S)
    assert line.velocity == pytest.approx(0.0, abs=0.03)


def test_a_vehicle_that_has_caught_up_moves_the_path_on_at_the_limit_too() -> None:
    line, plane = Path1(velocity=1.0), Path2(velocity=(1.0, 0.0))
    line.limit, line.behind_m, line.slower_m_s = 1.0, -0.5, -0.5
    plane.limit, plane.behind_m, plane.slower_m_s = (3.0, 0.0), (-0.5, 0.0), (-0.5, 0.0)
    line.to_acceleration(1.0, LIMITS, DT_S)
    plane.to_acceleration((1.0, 0.0), LIMITS, DT_S)
    assert line.position == pytest.approx(plane.position[0])
    assert line.position > 0.0
    assert line.velocity == pytest.approx(plane.velocity[0])
    assert line.velocity > 1.0


def test_a_low_pass_starts_from_its_first_value_and_lags_by_its_cutoff() -> None:
    low = FirstOrderLowPass(1.0 / (2.0 * math.pi))  # a time constant of 1 s
    assert low.step(3.0, DT_S) == 3.0
    for _ in range(100):
        low.step(4.0, DT_S)
    assert low.value == pytest.approx(4.0 - math.exp(-1.0), abs=0.01)
    low.reset()
    assert low.step(-1.0, DT_S) == -1.0


# ----------------
# Flying by hand: RC override and joystick, in the modes that sticks fly, and when they are lost.

VELOCITY_MODE = {"px4": "POSCTL", "ardupilot": "LOITER"}
ANGLE_MODE = {"px4": "ALTCTL", "ardupilot": "ALT_HOLD"}
THRUST_MODE = {"px4": "STABILIZED", "ardupilot": "STABILIZE"}
RETURN_MODE = {"px4": "AUTO_RTL", "ardupilot": "RTL"}


def joystick(x: int = 0, y: int = 0, z: int = 500, r: int = 0) -> Any:
    return mavlink.MAVLink_manual_control_message(1, x, y, z, r, 0)


def override(*channels: int) -> Any:
    return mavlink.MAVLink_rc_channels_override_message(1, 1, *channels, *(0,) * (8 - len(channels)))


def hold(station: Station, message: Any, seconds: float) -> None:
    """Keep sending, as a ground station does."""
    for _ in range(round(seconds * 10)):
        station.send(message)
        station.run(0.1)


def hovering(autopilot_kind: AutopilotKind, mode: dict[str, str]) -> Station:
    station = Station(autopilot_kind)
    station.flight.take_off(8.0)
    hold(station, joystick(), 0.3)
    assert station.flight.autopilot.set_mode_named(mode[autopilot_kind]) == 0
    return station


def test_sticks_fly_velocities_and_letting_go_holds(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, VELOCITY_MODE)
    hold(station, joystick(x=300, y=-300, z=600), 4.0)
    vx, vy, vz = station.flight.vehicle.velocity
    assert vx > 1.0
    assert vy < -1.0
    assert vz < -0.1
    hold(station, joystick(), 5.0)
    assert math.dist(station.flight.vehicle.velocity, (0.0, 0.0, 0.0)) < 0.15


def test_sticks_tilt_the_vehicle_and_turn_it_while_its_height_is_held(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, ANGLE_MODE)
    height = station.flight.vehicle.height_m
    hold(station, joystick(y=300), 1.5)
    assert tilt_from_quat(station.flight.vehicle.attitude) > math.radians(6.0)
    assert station.flight.vehicle.velocity[1] > 0.5
    hold(station, joystick(r=500), 2.0)
    assert yaw_from_quat(station.flight.vehicle.attitude) > 0.5
    assert station.flight.vehicle.height_m == pytest.approx(height, abs=0.5)


def test_the_throttle_is_thrust_in_the_simplest_mode(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, THRUST_MODE)
    hold(station, joystick(z=700), 1.5)
    assert station.flight.vehicle.velocity[2] < -1.0
    hold(station, joystick(z=300), 3.0)
    assert station.flight.vehicle.velocity[2] > 0.5


def test_channels_fly_as_the_joystick_does_and_are_reported(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, VELOCITY_MODE)
    forward = 1300 if autopilot_kind == "ardupilot" else 1700
    hold(station, override(1500, forward, 1500, 1500), 3.0)
    assert station.flight.vehicle.velocity[0] > 1.0
    told = [m for m in station.run(1.0) if m.get_type() == "RC_CHANNELS"][-1]
    assert (told.chan1_raw, told.chan2_raw, told.chancount) == (1500, forward, 18)


def test_nobody_at_the_sticks_from_the_start_triggers_nothing(station: Station) -> None:
    station.flight.take_off(3.0)
    station.flight.autopilot.set_mode_named(VELOCITY_MODE[station.autopilot_kind])
    station.run(12.0)
    assert station.flight.autopilot.mode == VELOCITY_MODE[station.autopilot_kind]
    assert {m.chancount for m in station.heard if m.get_type() == "RC_CHANNELS"} == {0}
    assert station.flight.vehicle.height_m == pytest.approx(3.0, abs=0.3)


def test_sticks_that_fall_silent_bring_it_home_once(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, VELOCITY_MODE)
    hold(station, override(1500, 1500, 1500, 1500), 1.0)
    station.run(0.4)
    assert station.flight.autopilot.mode == VELOCITY_MODE[autopilot_kind]
    station.run(6.0)
    assert station.flight.autopilot.mode == RETURN_MODE[autopilot_kind]
    assert any("Manual control lost" in t or "Radio Failsafe" in t for t in station.texts)
    # a mode chosen after that is the pilot's own business
    station.flight.autopilot.set_mode_named(station.flight.autopilot.profile.hold_mode)
    station.run(8.0)
    assert station.flight.autopilot.mode == station.flight.autopilot.profile.hold_mode


def test_released_channels_are_no_loss(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, VELOCITY_MODE)
    hold(station, override(1500, 1500, 1500, 1500), 0.5)
    station.send(override(0, 0, 0, 0))
    station.run(8.0)
    assert station.flight.autopilot.mode == VELOCITY_MODE[autopilot_kind]


def test_exceptions_keep_a_mode_without_sticks() -> None:
    station = hovering("px4", {"px4": "AUTO_LOITER"})
    station.flight.autopilot.parameters.set("COM_RCL_EXCEPT", 2)
    station.run(8.0)
    assert station.flight.autopilot.mode == "AUTO_LOITER"
    station.flight.autopilot.parameters.set("COM_RCL_EXCEPT", 0)
    station.run(6.0)
    assert station.flight.autopilot.mode == "AUTO_RTL"


def test_ardupilot_heeds_its_own_ground_station_alone_and_does_not_arm_with_the_throttle_up() -> None:
    station = Station("ardupilot")
    for system, heeded in ((42, False), (255, True)):
        station.us.srcSystem = system
        station.send(joystick(z=900))
        assert (station.flight.autopilot.rc_input.channels is not None) is heeded
    station.run(0.1)
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_FAILED


def test_the_throttle_lifts_it_off_and_a_pushed_down_one_lands_it(station: Station) -> None:
    hold(station, joystick(), 0.3)
    station.flight.autopilot.set_mode_named(VELOCITY_MODE[station.autopilot_kind])
    assert station.flight.autopilot.arm() == 0
    hold(station, joystick(), 1.0)
    assert station.flight.vehicle.height_m == 0.0
    hold(station, joystick(z=900), 4.0)
    assert station.flight.vehicle.height_m > 2.0
    hold(station, joystick(z=200), 12.0)
    assert station.flight.vehicle.height_m == 0.0
