import math
from dataclasses import replace

import pytest

from companion.base.geometry import quat_from_euler
from companion.base.messages import PadState
from companion.plan.landing.relative_state import PadTrack, misaligned_heading
from tests.unit.control.controller_inputs import vehicle_state
from tests.unit.plan.pad_paths import still
from tests.unit.plan.plan_harness import ORIGIN_NED_M, PlanWorld


def pad(time_s: float = 10.0, seen_s: float = 9.9) -> PadState:
    return PadState(
        time_s=time_s,
        relative_position_ned_m=(1.0, -2.0, 5.0),
        relative_velocity_ned_m_s=(0.5, 0.0, -1.0),
        velocity_ned_m_s=(1.5, 0.2, 0.0),
        acceleration_ned_m_s2=(0.0, 0.3, 0.0),
        heading_rad=0.2,
        heading_rate_rad_s=0.1,
        position_std_m=0.02,
        velocity_std_m_s=0.02,
        seen_time_s=seen_s,
    )


def test_a_sight_is_the_vehicle_seen_from_the_pad() -> None:
    sight = pad()
    assert sight.vehicle_from_pad.position_m == (-1.0, 2.0, -5.0)
    assert sight.vehicle_from_pad.velocity_m_s == (-0.5, 0.0, 1.0)
    assert sight.sink_m_s == 1.0
    assert sight.height_m == 5.0
    assert sight.lateral_m == pytest.approx(5.0**0.5)
    assert sight.lateral_speed_m_s == pytest.approx(0.5)
    assert sight.age_s == pytest.approx(0.1)


def test_the_pad_in_our_frame_is_where_it_truly_is() -> None:
    w = PlanWorld(still(10.6, 0.8))
    w.position = (9.0, 1.0, -6.0)
    w._sense()
    track = PadTrack(1)
    track.update(w.inputs().pad, w.inputs().vehicle, 0.0)
    assert track.motion is not None
    truth = [p - o for p, o in zip((10.6, 0.8, -0.3), ORIGIN_NED_M, strict=True)]
    assert track.motion.position_m == pytest.approx(truth)


@pytest.mark.parametrize("period_s", [0.033, 0.25])
def test_steady_means_so_many_sightings_without_a_gap_whatever_time_they_take(period_s: float) -> None:
    s, vehicle = PadTrack(3), vehicle_state(0.0)
    times = [1.0 + k * period_s for k in range(3)]
    for t in times[:2]:
        s.update(pad(t, t), vehicle, t + 0.1)
        s.update(pad(t + 0.03, t), vehicle, t + 0.13)  # the same sighting, predicted on
    assert not s.steady(times[1])
    s.update(pad(times[2], times[2]), vehicle, times[2] + 0.1)
    assert s.sight is not None
    assert s.sight.delay_s == pytest.approx(0.1)
    assert s.steady(times[2])
    assert s.steady(times[2] + 0.49)
    assert not s.steady(times[2] + 0.51)
    s.update(None, vehicle, times[2] + 0.51)
    assert not s.steady(times[2] + 0.51)
    late_s = times[2] + 0.52
    s.update(pad(late_s, late_s), vehicle, late_s)  # after a gap one is one
    assert not s.steady(late_s)


def test_how_long_unseen_does_not_count_what_a_slow_vision_takes() -> None:
    knowledge = PadTrack(1)
    knowledge.update(pad(1.0, 0.7), None, 1.0)
    assert knowledge.sight is not None
    assert knowledge.sight.unseen_s == pytest.approx(0.3)  # it may have come long before
    knowledge.update(pad(1.2, 1.0), None, 1.2)
    knowledge.update(pad(1.35, 1.0), None, 1.35)
    assert knowledge.sight is not None
    assert knowledge.sight.age_s == pytest.approx(0.35)
    assert knowledge.sight.unseen_s == pytest.approx(0.15)


def test_what_is_known_of_the_pad_outlives_a_cycle_without_an_estimate() -> None:
    w = PlanWorld(still())
    w.position = (10.0, 1.0, -6.0)
    w._sense()
    knowledge = PadTrack(1)
    assert not knowledge.steady(0.0)
    knowledge.update(w.inputs().pad, w.inputs().vehicle, 0.0)
    assert knowledge.steady(0.0)
    motion = knowledge.motion
    knowledge.update(w.inputs().pad, None, 0.1)
    assert knowledge.motion == motion


@pytest.mark.parametrize(
    ("off_deg", "rate_deg_s", "words"),
    [
        (10.0, 60.0, ""),
        (-40.0, 0.0, "heading 40 deg off the pad's"),
        (190.0, -50.0, "heading 170 deg off the pad's; the pad turns at 50 deg/s"),
    ],
)
def test_a_heading_that_is_off_the_pad_s_is_told(off_deg: float, rate_deg_s: float, words: str) -> None:
    vehicle = vehicle_state(0.0, attitude=quat_from_euler(0.0, 0.0, 0.5))
    turned = replace(
        pad(), heading_rad=0.5 + math.radians(off_deg), heading_rate_rad_s=math.radians(rate_deg_s)
    )
    assert misaligned_heading(turned, vehicle) == words
    assert misaligned_heading(None, vehicle) == ""
