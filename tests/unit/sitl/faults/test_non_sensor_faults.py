"""Faults of what is no sensor: what is in view, the line's quality, the autopilot and its battery."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from companion.base.geometry import IDENTITY
from companion.pad import DICTIONARIES, load_pad
from sitl.autopilot.flight.modes import CommandResult
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from sitl.camera.frame_line import FrameLine
from sitl.faults import faults
from sitl.faults.faulty_link import LinkChannel, LinkSettings
from sitl.faults.schedule import FaultSchedule
from sitl.mavlink.telemetry import battery_status, local_position, sys_status
from sitl.scenario.scenario import Scenario
from sitl.sensors.sensors import NO_RANGE_ERRORS, RangeSensor
from sitl.world.world import World
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight
from tests.unit.sitl.camera.test_camera import CAMERA, VEHICLE
from tests.unit.sitl.devices.sensor_desk import fly
from tests.unit.sitl.faults.test_schedule import targets

PAD = load_pad("moving_1300")
SHARP = ImagingSettings(exposure_s=0.0, readout_s=0.0, noise_grey=0.0)


class FaultedParts:
    """A schedule over one fault, with the parts that it acts on."""

    def __init__(self, fault: Any, **parts: Any) -> None:
        self.world = World(Scenario(name="x", description="x"), 0)
        self.camera = CameraModel(CAMERA, VEHICLE, PAD, SHARP, np.random.default_rng(0))
        self.restarted = 0
        parts |= {"camera": self.camera, "motion": self.world.pad_motion}
        self.targets = targets(restart_streams=self._restart, **parts)
        self.schedule = FaultSchedule([fault], self.targets)

    def _restart(self) -> None:
        self.restarted += 1

    def codes(self, now_s: float) -> set[int]:
        """Ids in view of the largest dictionary, hovering 4 m over the pad's place."""
        self.schedule.step(now_s)
        pose = ScenePose((10.0, 0.0, -4.0), IDENTITY, (10.0, 0.0, -0.3), 0.0)
        image = self.camera.render(now_s, lambda _time_s: pose)
        found: set[int] = set()
        for name in {marker.dictionary for marker in PAD.markers}:
            detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(DICTIONARIES[name]))
            ids = detector.detectMarkers(image)[1]
            found |= set() if ids is None else {int(code) for code in ids.flatten()}
        return found


def times(**more: Any) -> dict[str, Any]:
    return {"start_s": 1.0, "duration_s": 1.0, **more}


OWN = {marker.id for marker in PAD.markers}


def test_under_a_tarpaulin_no_code_is_seen() -> None:
    desk = FaultedParts(faults.PadCovered(kind="pad_covered", **times()))
    assert desk.codes(0.0) & OWN
    assert desk.codes(1.0) == set()
    assert desk.codes(2.0) & OWN


def test_another_pad_shows_other_codes() -> None:
    desk = FaultedParts(faults.PadWrongIds(kind="pad_wrong_ids", **times()))
    own = desk.codes(0.0)
    assert own
    assert own <= OWN
    others = desk.codes(1.0)
    assert others
    assert not others & own


@pytest.mark.parametrize("moves", [True, False])
def test_a_twin_is_seen_beside_the_pad(moves: bool) -> None:
    desk = FaultedParts(faults.PadTwin(kind="pad_twin", north_m=0.0, east_m=1.6, moves=moves, **times()))
    pose = ScenePose((10.0, 0.8, -6.0), IDENTITY, (10.0, 0.0, -0.3), 0.0)

    def bright(now_s: float) -> int:
        """Pixels as bright as a pad's paper."""
        desk.schedule.step(now_s)
        return int((desk.camera.render(now_s, lambda _t: pose) > 190).sum())

    alone = bright(0.0)
    if moves:
        assert bright(1.0) == pytest.approx(2 * alone, rel=0.1)
    else:  # it rests where the world's pad was, out of this picture or in it
        place = desk.world.pad_motion.beacon_at(1.0).position_ned_m
        desk.schedule.step(1.0)
        assert desk.camera.twin_ned_m is not None
        assert desk.camera.twin_ned_m((50.0, 50.0, -3.0))[1] == pytest.approx(place[1] + 1.6)
    assert bright(2.0) == alone


# ---------------------------------------------------------------- sensors and line


def test_a_saturated_imu_shows_the_end_of_its_range_on_every_axis() -> None:
    heard = fly(3, 4.0, [faults.ImuSaturated(kind="imu_saturated", start_s=2.0, duration_s=1.0)])
    # at its end on every axis each sample is as the last: the driver hands on the first of them alone
    during = [s for s in heard.imu if 2.005 < s.time_s < 2.9]
    after = [s for s in heard.imu if s.time_s > 3.2]
    assert during
    assert {abs(v) > 8.0 for s in during for v in s.rate_body_rad_s} == {True}
    assert max(abs(v) for s in after for v in s.rate_body_rad_s) < 1.0


def test_black_frames_and_garbage_last_as_long_as_the_fault() -> None:
    line = FrameLine(np.random.default_rng(0))
    picture = np.full((40, 60), 120, np.uint8)
    line.black = True
    assert not line.carried(picture).any()
    line.clear_faults()
    line.garbage = True
    garbage = line.carried(picture)
    assert garbage.std() > 60.0
    assert abs(float(garbage.mean()) - 127.5) < 5.0
    line.clear_faults()
    assert (line.carried(picture) == picture).all()


def test_something_nearer_answers_now_and_then_and_nothing_farther_does() -> None:
    sensor = RangeSensor(NO_RANGE_ERRORS, np.random.default_rng(0))
    sensor.other_m, sensor.other_share = 0.4, 0.7
    high = [sensor.sample(2.0) for _ in range(500)]
    assert np.mean([d == pytest.approx(0.4) for d in high]) == pytest.approx(0.7, abs=0.07)
    assert {round(d, 6) for d in high if d is not None} == {0.4, 2.0}
    assert {round(d, 6) for d in (sensor.sample(0.2) for _ in range(50)) if d is not None} == {0.2}


def test_what_is_under_way_is_not_overtaken_when_the_delay_ends() -> None:
    way = LinkChannel(LinkSettings(), np.random.default_rng(0))
    assert way.arrival_s(1.0) == 1.0
    way.extra_delay_s = 0.5
    late = way.arrival_s(2.0)
    assert late == pytest.approx(2.5)
    way.clear_faults()
    following = way.arrival_s(2.1)
    assert late is not None
    assert following is not None
    assert following > late
    assert way.arrival_s(3.0) == 3.0


def test_a_share_is_lost() -> None:
    way = LinkChannel(LinkSettings(), np.random.default_rng(0))
    way.extra_loss = 0.5
    assert np.mean([way.arrival_s(float(k)) is None for k in range(400)]) == pytest.approx(0.5, abs=0.08)


# ---------------------------------------------------------------- the autopilot


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_refused_request_is_denied_for_as_long_as_the_fault(profile: Any) -> None:
    flight = AutopilotFlight(profile)
    flight.run(8.0)
    autopilot = flight.autopilot
    desk = FaultedParts(
        faults.AutopilotRefuses(kind="autopilot_refuses", what="arm", **times()),
        autopilot=autopilot,
    )
    autopilot.set_mode_named(autopilot.profile.take_off_mode if profile == "ardupilot" else "AUTO_LOITER")
    desk.schedule.step(1.0)
    assert autopilot.arm() is autopilot.profile.refused_arming
    assert autopilot.arm(force=True) is autopilot.profile.refused_arming
    desk.schedule.step(2.0)
    assert autopilot.arm() is CommandResult.ACCEPTED
    autopilot.refused = frozenset({"disarm", "land", "offboard", "take_off"})
    assert autopilot.disarm(force=True) is autopilot.profile.refused_disarming
    assert autopilot.set_mode_named(autopilot.profile.land_mode) is autopilot.profile.refused_mode
    assert autopilot.take_off(5.0) is not CommandResult.ACCEPTED


def test_an_autopilot_that_does_not_disarm_by_itself_stays_armed() -> None:
    flights = [AutopilotFlight("px4"), AutopilotFlight("px4")]
    flights[1].autopilot.refused = frozenset({"auto_disarm"})
    for flight in flights:
        flight.run(5.0)
        assert flight.autopilot.arm() is CommandResult.ACCEPTED
        flight.run(12.0)  # PX4 disarms what does not take off within 10 s
    assert [flight.autopilot.armed for flight in flights] == [False, True]


def test_the_pilot_changes_the_mode_once() -> None:
    flight = AutopilotFlight("px4")
    flight.run(5.0)
    desk = FaultedParts(
        faults.PilotMode(kind="pilot_mode", mode="position", **times()), autopilot=flight.autopilot
    )
    desk.schedule.step(1.0)
    assert flight.autopilot.mode == "POSCTL"
    flight.autopilot.set_mode_named("AUTO_LOITER")
    desk.schedule.step(1.5)
    desk.schedule.step(2.0)
    assert flight.autopilot.mode == "AUTO_LOITER"


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_the_motors_stop_in_the_air_as_well(profile: Any) -> None:
    flight = AutopilotFlight(profile)
    flight.run(8.0)
    autopilot = flight.autopilot
    autopilot.set_mode_named(autopilot.profile.take_off_mode)
    assert autopilot.arm() is CommandResult.ACCEPTED
    desk = FaultedParts(faults.AutopilotDisarms(kind="autopilot_disarms", **times()), autopilot=autopilot)
    desk.schedule.step(0.9)
    assert autopilot.armed
    desk.schedule.step(1.0)
    assert not autopilot.armed


def test_a_reboot_is_silent_and_starts_the_clock_and_the_streams_again() -> None:
    flight = AutopilotFlight("px4")
    flight.run(5.0)
    flight.autopilot.set_mode_named("POSCTL")
    reboots = faults.AutopilotReboots(kind="autopilot_reboots", start_s=6.0, silent_s=2.0)
    desk = FaultedParts(reboots, autopilot=flight.autopilot)
    desk.schedule.step(6.0)
    assert (flight.autopilot.booted_s, flight.autopilot.mode, desk.restarted) == (6.0, "AUTO_LOITER", 1)
    assert desk.targets.to_app.arrival_s(7.9) is None
    desk.schedule.step(8.0)
    assert desk.targets.to_app.arrival_s(8.1) == 8.1
    assert desk.restarted == 1


def test_without_its_position_the_autopilot_sends_none() -> None:
    flight = AutopilotFlight("px4")
    flight.run(5.0)
    lost = faults.AutopilotPositionLost(kind="autopilot_position_lost", **times())
    desk = FaultedParts(lost, autopilot=flight.autopilot)
    assert local_position(flight.autopilot, 5.0) is not None
    desk.schedule.step(1.0)
    flight.run(0.1)
    assert local_position(flight.autopilot, 5.1) is None
    assert not flight.autopilot.ready_to_arm
    desk.schedule.step(2.0)
    flight.run(0.1)
    assert local_position(flight.autopilot, 5.2) is not None


def test_the_battery_is_reported_in_both_messages() -> None:
    flight = AutopilotFlight("px4")
    desk = FaultedParts(
        faults.BatteryCharge(kind="battery", remaining_percent=12, **times()),
        autopilot=flight.autopilot,
    )
    desk.schedule.step(1.0)
    assert sys_status(flight.autopilot, 1.0).battery_remaining == 12
    assert battery_status(flight.autopilot, 1.0).battery_remaining == 12
    desk.schedule.step(2.0)
    assert sys_status(flight.autopilot, 2.0).battery_remaining == 100
