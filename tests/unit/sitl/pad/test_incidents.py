"""What happens to a pad on its way: each motion by its own derivative, and to its stated end."""

import math

import pytest

from sitl.pad.incidents import GONE_M, IncidentMotion
from sitl.pad.motion import PadTruth

SPEED, COURSE = 1.5, math.radians(30.0)


class Straight:
    """1.5 m/s on a course of 30 degrees, at 0.3 m."""

    def at(self, time_s: float) -> PadTruth:
        c, s = SPEED * math.cos(COURSE), SPEED * math.sin(COURSE)
        zero = (0.0, 0.0, 0.0)
        return PadTruth(time_s, (c * time_s, s * time_s, -0.3), (c, s, 0.0), zero, COURSE, 0.0)


class StillPad:
    """Where it is, heading 30 degrees."""

    def at(self, time_s: float) -> PadTruth:
        zero = (0.0, 0.0, 0.0)
        return PadTruth(time_s, (3.0, 4.0, -0.3), zero, zero, COURSE, 0.0)


def along(pad: PadTruth) -> tuple[float, float]:
    """Way and speed along the course."""
    c, s = math.cos(COURSE), math.sin(COURSE)
    return (
        c * pad.position_ned_m[0] + s * pad.position_ned_m[1],
        c * pad.velocity_ned_m_s[0] + s * pad.velocity_ned_m_s[1],
    )


def check_derivatives(motion: IncidentMotion, from_s: float, to_s: float) -> None:
    h = 1e-4
    for k in range(1, 50):
        t = from_s + (to_s - from_s) * k / 50
        before, now, after = motion.at(t - h), motion.at(t), motion.at(t + h)
        for axis in range(3):
            speed = (after.position_ned_m[axis] - before.position_ned_m[axis]) / (2 * h)
            assert now.velocity_ned_m_s[axis] == pytest.approx(speed, abs=1e-3)


def test_without_an_incident_the_motion_is_the_scenarios() -> None:
    assert IncidentMotion(Straight()).at(7.3) == Straight().at(7.3)


def test_it_brakes_at_its_deceleration_and_stands() -> None:
    motion = IncidentMotion(Straight())
    motion.drive(10.0, 0.0, 3.0)
    assert along(motion.at(10.0)) == pytest.approx((15.0, 1.5))
    assert along(motion.at(10.25))[1] == pytest.approx(0.75)
    way, speed = along(motion.at(14.0))
    assert (way, speed) == pytest.approx((15.0 + 1.5**2 / 6.0, 0.0))
    check_derivatives(motion, 10.0, 12.0)


def test_at_once_means_within_a_millimetre() -> None:
    motion = IncidentMotion(Straight())
    motion.drive(10.0, 0.0)
    assert along(motion.at(11.0)) == pytest.approx((15.0, 0.0), abs=1e-3)


def test_it_turns_back_and_drives_as_fast_as_it_came() -> None:
    motion = IncidentMotion(Straight())
    motion.turn_back(10.0, 2.0)
    assert along(motion.at(20.0))[1] == pytest.approx(-1.5)
    assert motion.at(20.0).heading_rad == pytest.approx(COURSE)  # it does not turn round
    check_derivatives(motion, 10.0, 13.0)


def test_it_leaves_and_after_the_fault_it_goes_on_as_before() -> None:
    motion = IncidentMotion(Straight())
    motion.drive(10.0, 6.0, 2.0)
    assert along(motion.at(13.0))[1] == pytest.approx(6.0)
    before = motion.at(13.0)
    motion.drive(13.0, motion.usual_m_s, 3.0)
    assert motion.at(13.0).position_ned_m == pytest.approx(before.position_ned_m)
    assert along(motion.at(20.0))[1] == pytest.approx(1.5)


def test_one_that_stands_leaves_along_its_heading() -> None:
    motion = IncidentMotion(StillPad())
    motion.drive(5.0, 6.0, 2.0)
    assert along(motion.at(10.0))[1] == pytest.approx(6.0)
    vn, ve, _ = motion.at(10.0).velocity_ned_m_s
    assert math.atan2(ve, vn) == pytest.approx(COURSE)


def test_it_tilts_to_its_angle_and_back() -> None:
    motion = IncidentMotion(Straight())
    motion.tilt(10.0, math.radians(15.0), math.radians(30.0))
    assert math.degrees(motion.at(10.25).roll_rad) == pytest.approx(7.5)
    assert math.degrees(motion.at(10.25).roll_rate_rad_s) == pytest.approx(30.0)
    assert math.degrees(motion.at(12.0).roll_rad) == pytest.approx(15.0)
    motion.tilt(12.0, 0.0, math.radians(30.0))
    assert math.degrees(motion.at(12.25).roll_rad) == pytest.approx(7.5)
    assert motion.at(13.0).roll_rad == 0.0


def test_one_that_is_gone_is_out_of_reach_and_its_beacon_stays() -> None:
    motion = IncidentMotion(Straight())
    motion.vanish(10.0)
    assert motion.at(11.0).position_ned_m[0] == GONE_M
    assert motion.beacon_at(11.0).position_ned_m == Straight().at(10.0).position_ned_m
    motion.appear()
    assert motion.at(12.0) == Straight().at(12.0)
