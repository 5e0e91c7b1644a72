"""The pad goes with the vehicle that touches it, and drives on after it."""

import numpy as np
import pytest

from companion.base.geometry import IDENTITY, ZERO3, Vector3
from sitl.external.pose import Pose
from sitl.external.world import TouchedPad
from sitl.pad.motion import build_pad_motion
from sitl.scenario.scenario import Scenario

FRICTION = 0.6
STANDING_M = 0.18


class StoppedVehicle:
    """Over the pad until it is stopped at 10 s, at once or over a while."""

    def __init__(self, speed_m_s: float, stops_in_s: float = 0.0) -> None:
        self.speed_m_s, self.stops_in_s = speed_m_s, stops_in_s
        self.pauses_s = 0.0  # its simulator, at 5 s
        self.sunk_m = self.sinks_m_s = 0.0  # into its simulator's ground

    def simulated_s(self, time_s: float) -> float:
        return time_s - min(max(time_s - 5.0, 0.0), self.pauses_s)

    def at(self, time_s: float) -> Pose:
        since_s = time_s - 10.0
        if since_s <= 0.0:
            east, speed = self.speed_m_s * since_s, self.speed_m_s
        else:
            t = min(since_s, self.stops_in_s)
            share = t / self.stops_in_s if self.stops_in_s else 1.0
            east, speed = self.speed_m_s * t * (1.0 - 0.5 * share), self.speed_m_s * (1.0 - share)
        position, velocity = (0.0, east, self.sunk_m - STANDING_M), (0.0, speed, self.sinks_m_s)
        return Pose(time_s, position, velocity, IDENTITY, ZERO3, self.simulated_s(time_s))


def departed(vehicle: StoppedVehicle, *, touched: bool = True) -> TouchedPad:
    """A pad at 1 m/s, met at 10 s by a vehicle that touches it then."""
    meet = {"point_ned_m": [0.0, 0.0], "time_s": 10.0, "spread_m": 0.0}
    settings = {
        "motion": {"kind": "line", "speed_m_s": 1.0, "course_deg": 90.0, "meet": meet},
        "heading": 0.0,
    }
    pad = Scenario.model_validate({"name": "t", "description": "t", "pad": settings}).pad
    moved = TouchedPad(
        build_pad_motion(pad.motion, 0.0, pad.heading, np.random.default_rng(0)),
        FRICTION,
        STANDING_M,
        vehicle.at,
    )
    moved.depart(0.0)
    if touched:
        moved.touch(vehicle.at(10.0))
    return moved


def away(pad: TouchedPad, vehicle: StoppedVehicle, time_s: float) -> float:
    """How far east of the vehicle the pad is."""
    return pad.at(time_s).position_ned_m[1] - vehicle.at(time_s).position_ned_m[1]


@pytest.mark.parametrize("stops_in_s", [0.0, 0.2])
def test_it_stops_with_the_vehicle_however_that_is_stopped(stops_in_s: float) -> None:
    vehicle = StoppedVehicle(1.0, stops_in_s)
    pad = departed(vehicle)
    for time_s in (9.9, 10.0, 10.05, 10.1, 10.5, 11.0):
        assert away(pad, vehicle, time_s) == pytest.approx(0.0, abs=1e-9)
    assert pad.at(9.9).velocity_ned_m_s == pytest.approx((0.0, 1.0, 0.0))
    assert pad.at(11.0).velocity_ned_m_s == pytest.approx(ZERO3)


def test_what_their_speeds_differed_by_ends_by_friction() -> None:
    vehicle = StoppedVehicle(0.4)
    pad = departed(vehicle)
    slid_m = 0.6**2 / (2.0 * FRICTION * 9.80665)
    assert away(pad, vehicle, 11.0) == pytest.approx(slid_m, rel=1e-3)
    assert pad.at(11.0).velocity_ned_m_s == pytest.approx(ZERO3)


def test_clear_of_the_feet_it_drives_on_from_where_it_is_and_the_past_stays_as_it_was() -> None:
    vehicle = StoppedVehicle(1.0)
    pad = departed(vehicle)
    stood: Vector3 = pad.at(10.9).position_ned_m
    pad.release(11.0)
    assert pad.at(10.9).position_ned_m == pytest.approx(stood)
    assert pad.at(11.5).position_ned_m == pytest.approx((0.0, 0.5, 0.0))
    assert pad.at(11.5).velocity_ned_m_s == pytest.approx((0.0, 1.0, 0.0))


def test_it_stands_still_while_the_vehicle_s_simulator_does() -> None:
    vehicle = StoppedVehicle(1.0)
    vehicle.pauses_s = 0.25
    pad = departed(vehicle, touched=False)
    before, after = pad.at(5.0).position_ned_m, pad.at(5.25).position_ned_m
    assert after == pytest.approx(before)
    assert pad.at(6.25).position_ned_m[1] == pytest.approx(before[1] + 1.0)


def test_it_goes_down_with_a_vehicle_that_its_simulator_lets_into_the_ground_and_no_further_up() -> None:
    vehicle = StoppedVehicle(1.0)
    pad = departed(vehicle)
    for vehicle.sunk_m, vehicle.sinks_m_s, down_m, speed_m_s in (
        (0.11, 0.2, 0.11, 0.2),
        (-0.01, 0.2, 0.0, 0.0),
    ):
        assert pad.sunk_m(vehicle.at(11.0)) == pytest.approx(down_m)
        assert pad.at(11.0).position_ned_m[2] == pytest.approx(down_m)
        assert pad.at(11.0).velocity_ned_m_s[2] == pytest.approx(speed_m_s)
    vehicle.sunk_m = 0.11
    pad.release(11.0)
    assert pad.sunk_m(vehicle.at(11.1)) == 0.0
