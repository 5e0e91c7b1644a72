"""A correction of the vehicle's attitude is no motion of the pad."""

import math

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, IDENTITY, ZERO3, Vector3, add, cross, scale
from companion.config import PadFilterConfig
from companion.estimate.gating import Timeline
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.frame_correction import frame_rotation_increment
from companion.estimate.pad.pad_filter import PadFilter
from companion.estimate.pad.pad_types import PadInput, PadMeasurement, PadSnapshot

CORRECTED_S = 4.0
CORRECTION_RAD = (0.005, -0.004, 0.02)  # about NED axes: 0.4 deg of tilt and 1.1 deg of heading
PAD_M = (3.0, -1.0, 7.0)
FORCE_M_S2 = (0.0, 0.0, -GRAVITY_M_S2)
NOISE_M = 0.003


def turned(place: Vector3, time_s: float) -> Vector3:
    """What is at `place` as it is measured: with the correction still missing at first."""
    missing = -1.0 if time_s < CORRECTED_S else 0.0
    return add(place, scale(cross(CORRECTION_RAD, place), missing))


def largest_errors(told: bool, order: int = 1) -> tuple[float, float, float]:
    """Hovering above a pad at rest: errors of its velocity (m/s), place (m) and turn rate (rad/s) from the
    correction on; `told`: whether the filter hears of it.
    """
    motion, rng = MotionHistory(20.0), np.random.default_rng(3)
    for k in range(1400):
        if k == round(CORRECTED_S * 200) and told:
            motion.correct(CORRECTION_RAD)
        north, east, down = turned(FORCE_M_S2, k / 200)
        motion.add(k / 200, IDENTITY, (north, east, down + GRAVITY_M_S2))
    pad = PadFilter(PadFilterConfig(), motion, board_half_width_m=0.65)
    timeline: Timeline[PadSnapshot, PadInput] = Timeline(pad, 10.0)
    sights: list[tuple[float, PadMeasurement]] = []
    for k in range(180):
        t = k / 30
        place = np.add(turned(PAD_M, t), NOISE_M * rng.normal(size=3))
        heading = 0.1 - (CORRECTION_RAD[2] if t < CORRECTED_S else 0.0)
        north, east, down = place.tolist()
        sights.append((t, PadMeasurement((north, east, down), NOISE_M**2 * np.eye(3), heading, 0.01)))
    for t, sight in [sights[0], *sights[1:][::order]]:
        timeline.add(t, sight)
    speed = place_m = rate = 0.0
    for k in range(120, 178):
        at_s = k / 30 + 0.01
        snapshot = timeline.as_of(at_s)
        assert snapshot is not None
        estimate = pad.predicted(snapshot, at_s)
        assert estimate is not None
        speed = max(speed, math.hypot(*estimate.x[3:6]))
        place_m = max(place_m, math.dist(estimate.x[0:3], PAD_M))
        rate = max(rate, abs(estimate.heading_rate_rad_s))
    return speed, place_m, rate


def test_a_corrected_attitude_is_no_motion_of_the_pad() -> None:
    untold, told = largest_errors(False), largest_errors(True)
    assert untold[0] > 0.1
    assert untold[1] > 0.02
    assert untold[2] > 0.05
    assert told[0] < 0.04
    assert told[1] < 0.01
    assert told[2] < 0.01


def test_late_sightings_are_turned_as_those_on_time() -> None:
    assert largest_errors(True, order=-1) == pytest.approx(largest_errors(True), rel=1e-6)


def test_a_pad_that_is_not_seen_turns_with_the_frame() -> None:
    motion = MotionHistory(20.0)
    motion.add(0.0, IDENTITY, ZERO3)
    pad = PadFilter(PadFilterConfig(), motion, board_half_width_m=0.65)
    pad.apply(0.0, PadMeasurement(PAD_M, NOISE_M**2 * np.eye(3), 0.1, 0.01))
    motion.correct(CORRECTION_RAD)
    estimate = pad.predicted(pad.snapshot(), 1e-6)
    assert estimate is not None
    assert estimate.x[0:3] == pytest.approx(add(PAD_M, cross(CORRECTION_RAD, PAD_M)), abs=1e-5)
    assert estimate.heading_rad == pytest.approx(0.1 + CORRECTION_RAD[2])


@pytest.mark.parametrize("seen", [True, False])
def test_a_moving_pads_place_and_velocity_turn_as_a_whole_and_its_acceleration_while_it_is_seen(
    seen: bool,
) -> None:
    velocity, dt_s = (1.5, -2.0, 0.4), 2.0
    means = np.zeros((2, 8))
    means[0, :4], means[1, 0], means[1, 2] = (3.0, -1.0, 1.5, -2.0), 7.0, 0.4
    plane, climb = frame_rotation_increment((ZERO3, ZERO3), CORRECTION_RAD, means, dt_s, 0.1 if seen else 0.5)
    by_tilt = cross(CORRECTION_RAD, (0.0, 0.0, -GRAVITY_M_S2)) if seen else ZERO3
    place = add(cross(CORRECTION_RAD, add(PAD_M, scale(velocity, dt_s))), scale(by_tilt, dt_s * dt_s / 6.0))
    speed = add(cross(CORRECTION_RAD, velocity), scale(by_tilt, 0.5 * dt_s))
    assert (plane[0], plane[1], climb[0]) == pytest.approx(
        (*place[:2], cross(CORRECTION_RAD, add(PAD_M, scale(velocity, dt_s)))[2])
    )
    assert (plane[2], plane[3], climb[2]) == pytest.approx((*speed[:2], cross(CORRECTION_RAD, velocity)[2]))
    assert (plane[4], plane[5]) == pytest.approx(by_tilt[:2])
