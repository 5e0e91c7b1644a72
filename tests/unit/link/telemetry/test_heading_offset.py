"""Heading alignment: what is sent is turned from our north to the autopilot's."""

import math

import numpy as np
import pytest

from companion.base.geometry import (
    Quaternion,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    rotate_yaw,
    wrap_angle,
)
from companion.base.messages import Setpoint
from companion.link.telemetry.poses import JUMP_SAMPLES, HeadingOffset

YAWS = [0.0, 90.0, 180.0, 270.0]


def turned(attitude: Quaternion, offset_rad: float) -> Quaternion:
    return quat_multiply(quat_from_euler(0.0, 0.0, offset_rad), attitude)


def feed(
    alignment: HeadingOffset, offset_rad: float, start_s: float, count: int, yaw_rate: float = 0.0
) -> float:
    """Both sides' attitudes at 30 Hz, the autopilot's 13 ms older than ours; the time afterwards."""
    for k in range(count):
        ours_s = start_s + k / 30.0
        theirs_s = ours_s - 0.013
        ours = quat_from_euler(0.1, -0.1, yaw_rate * ours_s)
        theirs = turned(quat_from_euler(0.1, -0.1, yaw_rate * theirs_s), offset_rad)
        alignment.update(theirs, theirs_s, ours, ours_s)
    return start_s + count / 30.0


@pytest.mark.parametrize("yaw_deg", YAWS)
@pytest.mark.parametrize("offset_deg", [-7.0, 3.6, 120.0, 180.0])
@pytest.mark.parametrize("tilt_deg", [0.0, 20.0])
def test_the_offset_is_found_at_any_yaw_and_tilt(yaw_deg: float, offset_deg: float, tilt_deg: float) -> None:
    alignment = HeadingOffset()
    ours = quat_from_euler(math.radians(tilt_deg), math.radians(-tilt_deg), math.radians(yaw_deg))
    offset_rad = math.radians(offset_deg)
    for k in range(3):
        alignment.update(turned(ours, offset_rad), 0.1 * k, ours, 0.1 * k)
    assert wrap_angle(alignment.offset_rad - offset_rad) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("yaw_deg", YAWS)
def test_a_velocity_along_the_nose_stays_along_the_nose_for_the_autopilot(yaw_deg: float) -> None:
    offset_rad, yaw_rad = math.radians(5.0), math.radians(yaw_deg)
    ours = quat_from_euler(0.0, 0.0, yaw_rad)
    alignment = HeadingOffset()
    alignment.update(turned(ours, offset_rad), 1.0, ours, 1.0)
    setpoint = Setpoint(
        1.0,
        velocity_ned_m_s=quat_rotate(ours, (2.0, 0.0, 0.5)),
        acceleration_ned_m_s2=quat_rotate(ours, (0.0, 1.0, -0.2)),
        heading_rad=yaw_rad,
        attitude=quat_from_euler(0.1, 0.2, yaw_rad),
        thrust=0.5,
    )
    sent = alignment.rotate(setpoint)
    theirs = turned(ours, offset_rad)
    assert sent.velocity_ned_m_s == pytest.approx(quat_rotate(theirs, (2.0, 0.0, 0.5)))
    assert sent.acceleration_ned_m_s2 == pytest.approx(quat_rotate(theirs, (0.0, 1.0, -0.2)))
    assert wrap_angle(sent.heading_rad - yaw_rad - offset_rad) == pytest.approx(0.0, abs=1e-12)
    assert -math.pi < sent.heading_rad <= math.pi
    assert sent.attitude is not None
    expected = quat_from_euler(0.1, 0.2, yaw_rad + offset_rad)
    assert abs(sum(a * b for a, b in zip(sent.attitude, expected, strict=True))) == pytest.approx(1.0)
    assert sent.thrust == 0.5


def test_before_any_pair_nothing_is_turned() -> None:
    alignment = HeadingOffset()
    setpoint = Setpoint(1.0, (1.0, 2.0, 3.0), heading_rad=0.5)
    assert alignment.rotate(setpoint).velocity_ned_m_s == (1.0, 2.0, 3.0)


def test_turning_fast_does_not_look_like_an_offset() -> None:
    alignment = HeadingOffset()
    feed(alignment, math.radians(4.0), 0.0, 60, yaw_rate=math.radians(90.0))
    # 13 ms at 90 deg/s would be 1.2 deg
    assert math.degrees(alignment.offset_rad) == pytest.approx(4.0, abs=0.02)


def test_an_autopilot_ahead_of_us_waits_until_we_have_caught_up() -> None:
    alignment = HeadingOffset()
    level = quat_from_euler(0.0, 0.0, 0.0)
    alignment.update(turned(level, 0.1), 1.02, level, 1.0)
    assert alignment.offset_rad == 0.0
    alignment.update(turned(level, 0.1), 1.02, level, 1.04)
    assert alignment.offset_rad == pytest.approx(0.1)


def test_noise_is_averaged() -> None:
    generator = np.random.default_rng(3)
    alignment = HeadingOffset()
    for k in range(150):
        noise = math.radians(1.0) * float(generator.standard_normal())
        ours = quat_from_euler(0.0, 0.0, 1.0)
        alignment.update(turned(ours, 0.05 + noise), k / 30.0, ours, k / 30.0)
    assert math.degrees(alignment.offset_rad) == pytest.approx(math.degrees(0.05), abs=0.4)


def test_a_single_stray_is_dropped() -> None:
    alignment = HeadingOffset()
    now_s = feed(alignment, 0.05, 0.0, 60)
    now_s = feed(alignment, 0.05 + math.radians(40.0), now_s, 2)
    feed(alignment, 0.05, now_s, 10)
    assert alignment.offset_rad == pytest.approx(0.05, abs=1e-6)


@pytest.mark.parametrize("jump_deg", [-170.0, -15.0, 20.0, 175.0])
def test_a_heading_reset_is_followed_after_a_few_samples(jump_deg: float) -> None:
    alignment = HeadingOffset()
    now_s = feed(alignment, 0.05, 0.0, 60)
    target = 0.05 + math.radians(jump_deg)
    feed(alignment, target, now_s, JUMP_SAMPLES + 1)
    assert wrap_angle(alignment.offset_rad - target) == pytest.approx(0.0, abs=1e-3)


def test_a_slow_drift_is_followed() -> None:
    alignment = HeadingOffset()
    now_s = feed(alignment, 0.0, 0.0, 60)
    feed(alignment, math.radians(3.0), now_s, 300)
    assert math.degrees(alignment.offset_rad) == pytest.approx(3.0, abs=0.1)


def test_rotation_keeps_the_vertical() -> None:
    alignment = HeadingOffset()
    level = quat_from_euler(0.0, 0.0, 0.0)
    alignment.update(turned(level, 1.0), 0.0, level, 0.0)
    sent = alignment.rotate(Setpoint(0.0, (1.0, 0.0, 0.7)))
    assert sent.velocity_ned_m_s == pytest.approx(rotate_yaw((1.0, 0.0, 0.7), 1.0))
    assert sent.velocity_ned_m_s[2] == 0.7
