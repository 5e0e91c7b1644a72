"""Two horizons and two headings: what the attitude check makes of boards that lie askew, or slip."""

import math

import numpy as np
import pytest

from companion.base.geometry import Quaternion, quat_from_euler, quat_multiply
from companion.base.messages import AutopilotAttitude, Quantity, SourceComparison
from companion.base.second_sources import TABLE
from companion.estimate.motion import MotionHistory
from companion.estimate.vehicle.attitude_check import AttitudeCheck

IMU_S, REPORT_S = 0.005, 0.02
KNOWN = np.diag([math.radians(0.5) ** 2] * 2 + [math.radians(2.0) ** 2])


def body(time_s: float) -> Quaternion:
    """A vehicle that sways and turns round."""
    return quat_from_euler(0.15 * math.sin(4.0 * time_s), 0.1 * math.sin(5.0 * time_s), 0.8 * time_s)


def board(time_s: float, askew_deg: tuple[float, float, float], slips_s: float) -> Quaternion:
    """Ours, whose board lies askew from a time on."""
    roll, pitch, yaw = (math.radians(angle) for angle in askew_deg)
    return (
        quat_multiply(body(time_s), quat_from_euler(roll, pitch, yaw)) if time_s >= slips_s else body(time_s)
    )


def compared(
    askew_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    slips_s: float = 0.0,
    until_s: float = 6.0,
    late_s: float = 0.0,
    north_rad: float = 0.0,
) -> dict[Quantity, SourceComparison]:
    """The comparisons at a time; the autopilot's stamps are late, and its north is another."""
    motion = MotionHistory(3.0)
    check = AttitudeCheck(motion)
    for k in range(round(until_s / IMU_S)):
        now_s = k * IMU_S
        motion.add(now_s, board(now_s, askew_deg, slips_s), (0.0, 0.0, 0.0))
        if k % round(REPORT_S / IMU_S) == 0:
            theirs = quat_multiply(quat_from_euler(0.0, 0.0, north_rad), body(now_s - late_s))
            check.compare(AutopilotAttitude(now_s, theirs), board(now_s, askew_deg, slips_s))
    return {found.quantity: found for found in check.comparisons(KNOWN, until_s)}


@pytest.mark.parametrize("late_s", [0.0, 0.05])
@pytest.mark.parametrize("north_deg", [0.0, -8.0])
def test_boards_that_lie_alike_agree_however_the_vehicle_moves(late_s: float, north_deg: float) -> None:
    found = compared(late_s=late_s, north_rad=math.radians(north_deg))
    assert not any(TABLE[quantity].announces(each) for quantity, each in found.items())


@pytest.mark.parametrize("askew_deg", [(12.0, 0.0, 0.0), (0.0, -12.0, 0.0), (6.0, 8.0, 0.0)])
@pytest.mark.parametrize("north_deg", [0.0, 120.0])
def test_a_board_that_lies_askew_is_refused_with_both_figures(
    askew_deg: tuple[float, float, float], north_deg: float
) -> None:
    found = compared(askew_deg, north_rad=math.radians(north_deg))[Quantity.ATTITUDE]
    assert TABLE[Quantity.ATTITUDE].refuses(found)
    assert found.difference == pytest.approx(math.hypot(*askew_deg), abs=1.5)
    assert found.first in TABLE[Quantity.ATTITUDE].words(found)
    assert found.second in TABLE[Quantity.ATTITUDE].words(found)


def test_a_board_that_lies_a_little_askew_is_announced_and_flown_with() -> None:
    found = compared((5.0, 0.0, 0.0))[Quantity.ATTITUDE]
    assert TABLE[Quantity.ATTITUDE].announces(found)
    assert not TABLE[Quantity.ATTITUDE].refuses(found)


def test_a_board_that_slips_is_refused_within_half_a_second() -> None:
    assert not TABLE[Quantity.ATTITUDE].refuses(compared((20.0, 0.0, 0.0), 5.0, 5.0)[Quantity.ATTITUDE])
    assert TABLE[Quantity.ATTITUDE].refuses(compared((20.0, 0.0, 0.0), 5.0, 5.5)[Quantity.ATTITUDE])


@pytest.mark.parametrize(("turned_deg", "refuses"), [(15.0, False), (45.0, True), (-170.0, True)])
def test_headings_may_differ_by_what_two_compasses_do(turned_deg: float, refuses: bool) -> None:
    found = compared((0.0, 0.0, turned_deg))
    assert TABLE[Quantity.HEADING].refuses(found[Quantity.HEADING]) is refuses


@pytest.mark.parametrize("late_s", [0.0, 0.06, 0.16, -0.08])
def test_stamps_that_are_late_show_while_the_vehicle_turns(late_s: float) -> None:
    found = compared(until_s=20.0, late_s=late_s)[Quantity.IMU_DELAY]
    assert found.difference == pytest.approx(1e3 * abs(late_s), rel=0.1, abs=5.0)
    assert TABLE[Quantity.IMU_DELAY].refuses(found) is (late_s == 0.16)


def test_a_few_reports_say_nothing() -> None:
    assert compared((30.0, 0.0, 0.0), until_s=0.9) == {}


def test_after_a_silence_it_begins_again() -> None:
    motion = MotionHistory(3.0)
    check = AttitudeCheck(motion)
    for k in range(round(8.0 / IMU_S)):
        now_s = k * IMU_S
        motion.add(now_s, body(now_s), (0.0, 0.0, 0.0))
        if not 2.0 < now_s < 7.5:
            askew = quat_from_euler(0.5 if now_s < 5.0 else 0.0, 0.0, 0.0)
            check.compare(AutopilotAttitude(now_s, quat_multiply(body(now_s), askew)), body(now_s))
        if now_s == 4.0:
            assert check.comparisons(KNOWN, now_s)
        if 4.5 < now_s < 7.5:  # nothing that was said before the silence outlives it
            assert check.comparisons(KNOWN, now_s) == ()
    assert check.comparisons(KNOWN, 8.0) == ()
