"""Tracks, errors by their parts, and the asking at a fixed rate."""

import math

import numpy as np
import pytest

from companion.base.geometry import IDENTITY, Quaternion, quat_from_euler, quat_multiply
from companion.base.messages import ImuSample
from companion.flightlog.errors import RecordedTrack, track_of
from companion.flightlog.replay.compare import attitude_errors_deg
from companion.flightlog.replay.flight_record import Ask, RecordedEvent
from companion.flightlog.replay.run import asked_regularly


def errors_deg(ours: Quaternion, theirs: Quaternion) -> list[float]:
    return [float(value) for value in attitude_errors_deg(np.array([ours]), np.array([theirs]))[0]]


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("tilt_deg", [0.0, 25.0])
def test_a_turn_about_the_vertical_is_heading_alone(yaw_deg: float, tilt_deg: float) -> None:
    truth = quat_from_euler(math.radians(tilt_deg), math.radians(-tilt_deg), math.radians(yaw_deg))
    turned = quat_multiply(quat_from_euler(0.0, 0.0, math.radians(3.0)), truth)
    assert errors_deg(turned, truth) == pytest.approx([3.0, 0.0, -3.0], abs=1e-9)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0])
def test_a_turn_about_a_level_axis_is_inclination_alone(yaw_deg: float) -> None:
    truth = quat_from_euler(0.2, -0.1, math.radians(yaw_deg))
    tilted = quat_multiply(quat_from_euler(math.radians(4.0), 0.0, 0.0), truth)
    assert errors_deg(tilted, truth) == pytest.approx([4.0, 4.0, 0.0], abs=1e-9)


def test_the_sign_of_a_quaternion_means_nothing() -> None:
    one, other = quat_from_euler(0.1, 0.2, 3.0), quat_from_euler(0.1, 0.2, 3.01)
    w, x, y, z = one
    assert errors_deg((-w, -x, -y, -z), other) == pytest.approx(errors_deg(one, other))
    assert errors_deg(IDENTITY, IDENTITY) == [0.0, 0.0, 0.0]


def test_a_track_knows_nothing_within_its_gaps() -> None:
    track = RecordedTrack(
        [0.0, 0.2, 3.0, 3.2], [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [30.0, 0.0, 0.0], [32.0, 0.0, 0.0]]
    )
    times = np.array([-0.1, 0.0, 0.1, 0.2, 1.0, 3.0, 3.1, 3.3])
    assert track.covers(times).tolist() == [False, True, True, True, False, True, True, False]
    assert track.at(np.array([0.1]))[0, 0] == pytest.approx(1.0)


def test_a_track_turns_the_short_way_round() -> None:
    before, after = quat_from_euler(0.0, 0.0, 3.1), quat_from_euler(0.0, 0.0, -3.1)
    track = RecordedTrack([0.0, 0.1], [before, after])
    middle = tuple(track.at(np.array([0.05]))[0].tolist())
    assert errors_deg(middle, quat_from_euler(0.0, 0.0, math.pi))[0] == pytest.approx(0.0, abs=1e-6)


def test_samples_may_repeat_a_time_and_come_in_any_order() -> None:
    track = RecordedTrack([1.0, 0.0, 1.0], [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    assert track.time_s.tolist() == [0.0, 1.0]
    assert track.values[1, 0] == 5.0
    assert track_of([(0.0, (1.0, 2.0, 3.0))]) is None


def test_a_log_is_asked_at_a_fixed_rate_but_not_within_a_gap() -> None:
    times = [*np.arange(0.0, 1.0, 0.005), *np.arange(1000.0, 1001.0, 0.005)]
    samples = [RecordedEvent(float(t), ImuSample(float(t), (0, 0, 0), (0, 0, -9.8), 20.0)) for t in times]
    events = list(asked_regularly(samples, 30.0))
    asks = [event.arrival_s for event in events if isinstance(event.item, Ask)]
    assert len(asks) == pytest.approx(60, abs=2)
    assert [event for event in events if not isinstance(event.item, Ask)] == samples
    assert [event.arrival_s for event in events] == sorted(event.arrival_s for event in events)
