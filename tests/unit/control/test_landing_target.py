"""The pad as each autopilot takes it: frames and signs at every heading and aslant, and what a lead adds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.geometry import (
    Vector3,
    add,
    quat_from_euler,
    quat_rotate_inverse,
    subtract,
    yaw_from_quat,
)
from companion.base.messages import PadState
from companion.control.landing_target import SeenPad, TargetLead, landing_target
from companion.link.codec import Codec, landing_target_message, mavlink

HEADINGS_DEG = (0.0, 90.0, 180.0, 270.0)
SIZE_M = (1.3, 1.3)
# the pad is ahead (north) by 2 m, to the right (east) by 1 m, and 5 m below
AWAY_NED_M: Vector3 = (2.0, 1.0, 5.0)


def pad_state(**changes: object) -> PadState:
    still = PadState(
        time_s=10.0,
        relative_position_ned_m=AWAY_NED_M,
        relative_velocity_ned_m_s=(0.0, 0.0, 0.0),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        acceleration_ned_m_s2=(0.0, 0.0, 0.0),
        heading_rad=math.radians(30.0),
        heading_rate_rad_s=0.0,
        position_std_m=0.01,
        velocity_std_m_s=0.01,
        seen_time_s=10.0,
    )
    return replace(still, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("roll_deg", [0.0, 15.0])
@pytest.mark.parametrize("heading_deg", HEADINGS_DEG)
def test_ardupilot_gets_body_axes_that_make_its_line_of_sight(heading_deg: float, roll_deg: float) -> None:
    attitude = quat_from_euler(math.radians(roll_deg), 0.1, math.radians(heading_deg))
    target = landing_target(SeenPad.by_estimate(pad_state(), attitude), SIZE_M)
    m = landing_target_message(target, 1)
    assert (m.frame, m.position_valid, m.target_num) == (mavlink.MAV_FRAME_BODY_FRD, 1, 0)
    # AC_PrecLand: the position over the distance is a unit vector, turned by its attitude
    sight = np.array((m.x, m.y, m.z)) / m.distance
    assert np.linalg.norm(sight) == pytest.approx(1.0)
    assert m.distance * sight == pytest.approx(quat_rotate_inverse(attitude, AWAY_NED_M))
    # and without a position, by its angles
    by_angles = np.array((-math.tan(m.angle_y), math.tan(m.angle_x), 1.0))
    assert by_angles / np.linalg.norm(by_angles) == pytest.approx(sight)


@pytest.mark.parametrize(
    ("heading_deg", "forward_right_m"),
    [(0.0, (2.0, 1.0)), (90.0, (1.0, -2.0)), (180.0, (-2.0, -1.0)), (270.0, (-1.0, 2.0))],
)
def test_body_signs_by_hand(heading_deg: float, forward_right_m: tuple[float, float]) -> None:
    attitude = quat_from_euler(0.0, 0.0, math.radians(heading_deg))
    m = landing_target_message(landing_target(SeenPad.by_estimate(pad_state(), attitude), SIZE_M), 1)
    assert (m.x, m.y, m.z) == pytest.approx((*forward_right_m, 5.0))
    assert (m.angle_x > 0.0) == (m.y > 0.0)  # to the right
    assert (m.angle_y < 0.0) == (m.x > 0.0)  # backwards


@pytest.mark.parametrize("off_deg", [0.0, 3.6, -20.0])
@pytest.mark.parametrize("heading_deg", HEADINGS_DEG)
def test_px4_gets_a_place_in_its_own_ned_by_its_own_heading(heading_deg: float, off_deg: float) -> None:
    ours = quat_from_euler(0.1, -0.05, math.radians(heading_deg))
    its = quat_from_euler(0.1, -0.05, math.radians(heading_deg + off_deg))
    itself: Vector3 = (-3.0, 7.0, -4.0)
    target = landing_target(SeenPad.by_estimate(pad_state(), ours), SIZE_M, (itself, its))
    m = landing_target_message(target, 1)
    assert (m.frame, m.position_valid) == (mavlink.MAV_FRAME_LOCAL_NED, 1)
    # what it sees of the pad from where it believes to be, by the attitude that it believes, is what we see
    seen = quat_rotate_inverse(its, subtract((m.x, m.y, m.z), itself))
    assert seen == pytest.approx(quat_rotate_inverse(ours, AWAY_NED_M))
    if off_deg == 0.0:
        assert (m.x, m.y, m.z) == pytest.approx(add(itself, AWAY_NED_M))
    heading_deg_told = math.degrees(yaw_from_quat((m.q[0], m.q[1], m.q[2], m.q[3])))
    assert heading_deg_told == pytest.approx(30.0 + off_deg, abs=0.5)


def test_the_message_survives_the_wire() -> None:
    target = landing_target(SeenPad.by_estimate(pad_state(), quat_from_euler(0.0, 0.0, 0.0)), SIZE_M)
    codec = Codec(1, 191)
    (m,) = Codec(9).decode(codec.encode(landing_target_message(target, 12_345_678)))
    assert (m.get_type(), m.time_usec, m.type) == ("LANDING_TARGET", 12_345_678, 2)
    assert m.size_x == pytest.approx(2.0 * math.atan(0.65 / math.sqrt(30.0)))


# ---------------------------------------------------------------- a lead


def test_a_straight_pad_needs_no_lead_from_who_carries_it_on() -> None:
    driving = pad_state(velocity_ned_m_s=(2.0, -1.0, 0.0))
    assert TargetLead(1.0).ned_m(driving, 10.1, PROFILES["ardupilot"]) == (0.0, 0.0, 0.0)


def test_px4_is_told_of_the_place_where_a_straight_pad_will_be() -> None:
    driving = pad_state(velocity_ned_m_s=(2.0, -1.0, 0.3))
    # exposed at 10 s, sent 0.1 s later
    assert TargetLead(1.0).ned_m(driving, 10.1, PROFILES["px4"]) == pytest.approx((2.2, -1.1, 0.0))


def followed(kind: AutopilotKind, lead_s: float | None, response_s: float) -> float:
    """How far (m) one that is as late as `response_s` is off a pad on a circle, in the end.

    With T its lateness, x its place, p the told target's and e = p - x: ArduPilot
    x'' = 2 e / T^2 + 2 e' / T, PX4 x'' = 4 (e - T x') / T^2.
    """
    lead, dt, late = None if lead_s is None else TargetLead(lead_s), 0.01, response_s
    x, speed = np.array([0.0, 0.0]), np.array([1.5, 0.0])
    before, worst = None, 0.0
    for k in range(6000):
        c, s = math.cos(0.3 * dt * k), math.sin(0.3 * dt * k)
        velocity, acceleration = (1.5 * c, 1.5 * s, 0.0), (-0.45 * s, 0.45 * c, 0.0)
        pad = pad_state(time_s=dt * k, velocity_ned_m_s=velocity, acceleration_ned_m_s2=acceleration)
        place = np.array([5.0 * s, 5.0 * (1.0 - c)])
        shift = (0.0, 0.0, 0.0) if lead is None else lead.ned_m(pad, pad.time_s, PROFILES[kind])
        told = place + shift[:2]
        rate = speed if before is None else (told - before) / dt
        before = told
        if kind == "ardupilot":
            pull = 2.0 * (told - x) / late**2 + 2.0 * (rate - speed) / late
        else:
            pull = 4.0 * (told - x - late * speed) / late**2
        speed = speed + dt * pull
        x = x + dt * speed
        worst = max(worst, float(np.linalg.norm(x - place))) if k > 4000 else 0.0
    return worst


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_a_lead_as_long_as_its_lateness_takes_it_round_a_bend(kind: AutopilotKind) -> None:
    assert followed(kind, None, 1.75) > 0.4
    assert followed(kind, 1.75, 1.75) < 0.02
    # one that does not fit leaves a part of it
    assert 0.05 < followed(kind, 1.4, 1.75) < followed(kind, None, 1.75)


def test_a_bend_that_ends_is_forgotten() -> None:
    lead, make = TargetLead(1.0), PROFILES["ardupilot"]
    bend = pad_state(velocity_ned_m_s=(1.5, 0.0, 0.0), acceleration_ned_m_s2=(0.0, 0.45, 0.0))
    assert lead.ned_m(bend, 10.1, make) == pytest.approx((0.0, 0.225, 0.0))
    straight = pad_state(time_s=11.0, velocity_ned_m_s=(1.5, 0.0, 0.0))
    assert lead.ned_m(straight, 11.1, make) == pytest.approx((0.0, 0.225 / math.e, 0.0))


def test_a_pad_that_stands_is_where_it_is() -> None:
    for make in PROFILES.values():
        assert TargetLead(2.0).ned_m(pad_state(), 10.1, make) == (0.0, 0.0, 0.0)
