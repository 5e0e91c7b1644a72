"""Whole sensors and a pad with a GPS of its own: what the estimator says of a pad that is not seen."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import Vector3, geodetic_from_ned, vector3
from companion.base.messages import PadBeacon
from companion.config import EstimateConfig
from companion.estimate.estimator import StateEstimator
from tests.unit.estimate.estimate_flight import (
    FIELD_NED_UT,
    HOME,
    EstimateFlight,
    feed,
    new_estimator,
    pad_figure_8,
    velocity,
)

OFF: Vector3 = (1.2, -1.0, 1.5)  # the beacon's own GPS
FORGET_S = EstimateConfig(magnetic_field_ned_ut=FIELD_NED_UT).pad.forget_s


def word(flight: EstimateFlight, t: float) -> PadBeacon:
    """A fix that was made 0.2 s ago."""
    then_s = t - 0.2
    place = geodetic_from_ned(vector3(np.array(flight.pad_path(then_s)) + OFF), HOME)
    moves = velocity(flight.pad_path, then_s)
    return PadBeacon(t, *place, moves, 1.5, velocity_std_m_s=0.3, fix_time_s=then_s)


@dataclass
class Looked:
    """What the estimator said at a time."""

    time_s: float
    seen: bool
    carried: bool
    aside_m: float = math.inf
    std_m: float = math.inf


def fly(flight: EstimateFlight, until_s: float) -> tuple[StateEstimator, list[Looked]]:
    """A beacon a second from 6 s on beside the flight's samples; looked at three times a second."""
    estimator, looked, heard_s, next_s = new_estimator(), list[Looked](), 6.0, 1.0 / 3.0
    for arrival_s, sample in flight.samples:
        if arrival_s > until_s:
            break
        feed(estimator, sample)
        if arrival_s >= heard_s:
            heard_s += 1.0
            assert estimator.observe(word(flight, arrival_s))
        if arrival_s >= next_s:
            next_s += 1.0 / 3.0
            looked.append(look(flight, estimator, arrival_s))
    return estimator, looked


def look(flight: EstimateFlight, estimator: StateEstimator, now_s: float) -> Looked:
    pad, carried = estimator.pad(now_s), estimator.carried_pad(now_s)
    said = pad.relative_position_ned_m if pad else carried.relative_position_ned_m if carried else None
    if said is None:
        return Looked(now_s, False, False)
    north, east, _ = np.array(said) - flight.pad_path(now_s) + flight.path(now_s)
    std_m = carried.lateral_std_m if carried else math.nan
    return Looked(now_s, pad is not None, carried is not None, math.hypot(north, east), std_m)


def test_a_pad_that_no_camera_has_seen_is_carried_and_is_none_to_land_on() -> None:
    flight = EstimateFlight(pad_path=pad_figure_8, sensors=frozenset({"imu", "mag", "gps"}))
    estimator, looked = fly(flight, 30.0)
    late = [each for each in looked if each.time_s > 7.5]
    assert all(each.carried and not each.seen for each in late)
    assert all(each.aside_m < 3.0 * math.sqrt(2.0) * each.std_m for each in late)
    # both GPS are off by up to 2.6 m together
    assert float(np.median([each.aside_m for each in late])) < 2.6
    assert estimator.pad_prior(30.0) is not None
    prior = estimator.pad_prior(30.0)
    assert prior is not None
    assert prior.pad_position_body_m is None  # its heading is not known: nothing to expect in a frame


def test_a_pad_hidden_for_long_is_carried_until_it_is_seen_again() -> None:
    hidden_s = (15.0, 15.0 + FORGET_S + 5.0)
    flight = EstimateFlight(pad_path=pad_figure_8, pad_hidden_s=hidden_s, sensors=frozenset(
        {"imu", "mag", "gps", "sighting"}
    ))  # fmt: skip
    _, looked = fly(flight, hidden_s[1] + 2.0)
    forgotten = [each for each in looked if hidden_s[0] + FORGET_S + 0.5 < each.time_s < hidden_s[1]]
    assert forgotten
    assert all(each.carried and not each.seen for each in forgotten)
    assert max(each.aside_m for each in forgotten) < 2.0  # less what it was off by as long as it was seen
    again = [each for each in looked if each.time_s > hidden_s[1] + 0.5]
    assert all(each.seen for each in again)
    assert max(each.aside_m for each in again) < 0.2


def test_without_gps_and_before_the_alignment_a_beacon_says_nothing() -> None:
    flight = EstimateFlight(sensors=frozenset({"imu", "mag"}), duration_s=12.0)
    estimator = new_estimator()
    assert not estimator.observe(word(flight, 0.5))
    for _, sample in flight.samples:
        feed(estimator, sample)
    assert not estimator.observe(word(flight, 11.9))
    assert estimator.carried_pad(11.9) is None
    [use] = [use for use in estimator.tally.uses() if use.name == "beacon"]
    assert (use.used, use.refused, use.reason) == (0, 2, "the vehicle's own position is unknown")


@pytest.mark.parametrize("wrong", [{"latitude_deg": math.nan}, {"velocity_ned_m_s": (math.inf, 0.0, 0.0)}])
def test_a_beacon_that_is_not_finite_is_refused(wrong: dict[str, Any]) -> None:
    flight = EstimateFlight(sensors=frozenset({"imu", "mag", "gps"}), duration_s=10.0)
    estimator = new_estimator()
    for _, sample in flight.samples:
        feed(estimator, sample)
    assert not estimator.observe(replace(word(flight, 9.9), **wrong))
    assert estimator.observe(word(flight, 9.9))


def test_a_beacon_of_now_waits_for_the_imu_and_is_then_taken() -> None:
    flight = EstimateFlight(sensors=frozenset({"imu", "mag", "gps"}), duration_s=12.0)
    estimator = new_estimator()
    asked = False
    for arrival_s, sample in flight.samples:
        if arrival_s > 10.0 and not asked:
            asked = estimator.observe(word(flight, arrival_s + 0.02))
            assert estimator.carried_pad(arrival_s) is None
        feed(estimator, sample)
    assert estimator.carried_pad(11.9) is not None
