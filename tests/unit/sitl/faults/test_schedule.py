"""When a fault begins and ends: by the clock, by what the app says, by the height over the pad."""

import asyncio
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import IDENTITY, Vector3
from companion.config import ConfigError
from companion.link import codec
from companion.pad import DICTIONARIES, load_pad
from sitl.autopilot.flight.modes import CommandResult
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from sitl.devices.ports import MemoryPort
from sitl.devices.rack import SensorRack
from sitl.faults import faults
from sitl.faults.faults import AutopilotReboots, DiskFull, FrameBlack
from sitl.faults.lines import FrameLine, LinkChannel, LinkSettings
from sitl.faults.schedule import FaultSchedule, Moments, StatusTextMonitor
from sitl.faults.targets import FaultTargets
from sitl.mavlink.telemetry import battery_status, local_position, sys_status
from sitl.scenario.scenario import Scenario
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.sensors.sensors import RangeSensor
from sitl.vehicle.quadrotor import Motors
from sitl.world.world import World
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight
from tests.unit.sitl.camera.test_camera import CAMERA, VEHICLE
from tests.unit.sitl.devices.sensor_desk import FIELD_NED_UT, HOME, STEP_S, fly
from tests.unit.sitl.sensors.flawless import NO_RANGE_ERRORS

ENCODER = codec.mavlink.MAVLink(None, srcSystem=1, srcComponent=191)


def said(text: str, text_id: int = 1) -> bytes:
    return b"".join(bytes(m.pack(ENCODER)) for m in codec.status_texts(text, "info", text_id))


def targets(**parts: Any) -> FaultTargets:
    return asyncio.run(_targets(parts))


async def _targets(parts: dict[str, Any]) -> FaultTargets:
    """In a loop, for the ports want one."""
    rng = np.random.default_rng(0)
    gps, echo = MemoryPort(9600), MemoryPort(9600)
    rack = SensorRack(0, STEP_S, home=HOME, field_ned_ut=FIELD_NED_UT, gps_port=gps, range_port=echo)
    onboard = SimulatedAutopilotSensors(rng, STEP_S, home=HOME, field_ned_ut=FIELD_NED_UT, imu_filter=2)
    ways = (LinkChannel(LinkSettings(), rng), LinkChannel(LinkSettings(), rng))
    unused = {name: Mock() for name in ("camera", "motion", "station")}
    return FaultTargets(rack, onboard, FrameLine(rng), Motors(), *ways, **(unused | parts))


def black(**when: Any) -> FrameBlack:
    return FrameBlack(kind="frame_black", **when)


SAID = {
    10: "search: arrived: 0.6 m from the waypoint",
    20: "approach: pad seen: lateral offset 3.3 m, 7.0 m below, and a long tail of words",
    25: "search: pad lost: unseen for 5 s",
}


def black_from_to(fault: FrameBlack, heights_m: dict[float, float]) -> tuple[float, float]:
    """Between which whole seconds the frames are black; the height is the last one given."""
    words, at, seen = StatusTextMonitor(), targets(), list[float]()
    now_s = 0.0
    moments = Moments(words, lambda: next((heights_m[t] for t in reversed(heights_m) if t <= now_s), None))
    schedule = FaultSchedule([fault], at, moments)
    for second in range(40):
        now_s = float(second)
        if second in SAID:
            words.hear(said(SAID[second]), now_s)
        schedule.step(now_s)
        if at.frames.black:
            seen.append(now_s)
    assert schedule.all_begun == bool(seen)
    assert seen == [float(s) for s in range(int(seen[0]), int(seen[-1]) + 1)] if seen else True
    return (seen[0], seen[-1]) if seen else (-1.0, -1.0)


@pytest.mark.parametrize(
    ("when", "expected"),
    [
        ({"start_s": 7.0, "duration_s": 3.0}, (7.0, 9.0)),
        ({"phase": "search", "duration_s": 2.0}, (10.0, 11.0)),
        ({"phase": "search", "delay_s": 4.0, "duration_s": 2.0}, (14.0, 15.0)),
        ({"phase": "approach"}, (20.0, 39.0)),
        ({"after_sighting_s": 5.0, "duration_s": 1.0}, (25.0, 25.0)),
        ({"below_m": 1.0, "duration_s": 2.0}, (31.0, 32.0)),
        ({"below_m": 0.0, "delay_s": 1.0}, (34.0, 39.0)),
        ({"phase": "touchdown"}, (-1.0, -1.0)),
    ],
)
def test_a_fault_begins_when_its_moment_has_come_and_once(
    when: dict[str, Any], expected: tuple[float, float]
) -> None:
    heights_m = {15.0: 6.0, 30.0: 1.2, 31.0: 0.9, 33.0: 0.0, 35.0: 1.5, 36.0: 0.2}
    assert black_from_to(black(**when), heights_m) == expected
    if "below_m" in when:  # beside the pad there is no height over it
        assert black_from_to(black(**when), {}) == (-1.0, -1.0)


@pytest.mark.parametrize(
    "when", [{}, {"start_s": 1.0, "phase": "search"}, {"delay_s": 1.0}, {"phase": "lunch"}]
)
def test_a_fault_has_one_beginning(when: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=r"expected one of|lunch"):
        black(**when)


def test_overlapping_faults_end_each_for_itself() -> None:
    at = targets()
    short, long = black(start_s=1.0, duration_s=1.0), black(start_s=1.5, duration_s=2.0)
    schedule = FaultSchedule([short, long], at)
    shown = []
    for k in range(9):
        schedule.step(0.5 * k)
        shown.append(at.frames.black)
    assert shown == [False, False, True, True, True, True, True, False, False]


# ---------------------------------------------------------------- what the app says


def test_words_are_put_together_and_only_the_first_of_a_phase_counts() -> None:
    words = StatusTextMonitor()
    long, whole = "approach: pad seen: " + "x" * 80, "y" * 100  # of whole chunks: it ends with an empty one
    words.hear(said("search: arrived") + said(long, 2), 3.0)
    words.hear(said("search: pad lost", 3) + said(whole, 7), 9.0)
    assert [t.text for t in words.texts] == ["search: arrived", long, "search: pad lost", whole]
    assert words.phase_began_s == {"search": 3.0, "approach": 3.0}
    assert words.sighted_s == 3.0


# ---------------------------------------------------------------- what is not there cannot fail


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (DiskFull(kind="disk_full", start_s=1.0), "bench-faults"),
        (AutopilotReboots(kind="autopilot_reboots", start_s=1.0), "bundled autopilot"),
    ],
)
def test_a_fault_of_what_is_not_simulated_is_refused(fault: Any, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        FaultSchedule([fault], targets())


# ----------------
# Faults of what is no sensor: what is in view, the line's quality, the autopilot and its battery.

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

    def picture(self, now_s: float, place: Vector3) -> NDArray[np.uint8]:
        """From a place over a pad that is 10 m north."""
        self.schedule.step(now_s)
        return self.camera.render(now_s, lambda _: ScenePose(place, IDENTITY, (10.0, 0.0, -0.3), 0.0))

    def bright(self, now_s: float, place: Vector3) -> int:
        """Pixels as bright as a pad's paper."""
        return int((self.picture(now_s, place) > 190).sum())

    def codes(self, now_s: float) -> set[int]:
        """Ids in view of the largest dictionary, hovering 4 m over the pad's place."""
        image, found = self.picture(now_s, (10.0, 0.0, -4.0)), set[int]()
        for name in {marker.dictionary for marker in PAD.markers}:
            detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(DICTIONARIES[name]))
            ids = detector.detectMarkers(image)[1]
            found |= set() if ids is None else {int(code) for code in ids.flatten()}
        return found


def times(**more: Any) -> dict[str, Any]:
    return {"start_s": 1.0, "duration_s": 1.0, **more}


OWN = {marker.id for marker in PAD.markers}


def test_under_a_tarpaulin_no_code_is_seen_and_another_pad_shows_others() -> None:
    covered = faults.PadCovered(kind="pad_covered", **times())
    for fault in (covered, faults.PadWrongIds(kind="pad_wrong_ids", **times())):
        desk = FaultedParts(fault)
        before, meanwhile, after = (desk.codes(now_s) for now_s in (0.0, 1.0, 2.0))
        assert before == after
        assert before
        assert before <= OWN
        assert not meanwhile & before
        assert bool(meanwhile) == isinstance(fault, faults.PadWrongIds)


def test_a_pad_that_vanishes_is_in_no_picture_and_comes_back() -> None:
    desk = FaultedParts(faults.PadVanishes(kind="pad_vanishes", **times()))
    shown = [
        (desk.bright(now_s, (10.0, 0.0, -4.0)) > 1000, desk.world.pad_motion.at(now_s).is_there)
        for now_s in (0.0, 1.0, 2.0)
    ]
    assert shown == [(True, True), (False, False), (True, True)]


@pytest.mark.parametrize("moves", [True, False])
def test_a_twin_is_seen_beside_the_pad(moves: bool) -> None:
    desk = FaultedParts(faults.PadTwin(kind="pad_twin", north_m=0.0, east_m=1.6, moves=moves, **times()))
    between = (10.0, 0.8, -6.0)
    alone = desk.bright(0.0, between)
    if moves:
        assert desk.bright(1.0, between) == pytest.approx(2 * alone, rel=0.1)
    else:  # it rests where the world's pad was, out of this picture or in it
        place = desk.world.pad_motion.at(1.0).position_ned_m
        desk.schedule.step(1.0)
        assert desk.camera.twin_ned_m is not None
        assert desk.camera.twin_ned_m((50.0, 50.0, -3.0))[1] == pytest.approx(place[1] + 1.6)
    assert desk.bright(2.0, between) == alone


# ---------------------------------------------------------------- sensors and line


def test_a_saturated_imu_is_at_the_end_of_its_range_on_every_axis_and_no_sample_of_it_counts() -> None:
    heard = fly(3, 4.0, [faults.ImuSaturated(kind="imu_saturated", start_s=2.0, duration_s=1.0)])
    during = [s for s in heard.imu if 2.005 < s.time_s < 2.9]
    after = [s for s in heard.imu if s.time_s > 3.2]
    assert not during
    assert len(after) > 100
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


def test_what_is_under_way_is_not_overtaken_when_the_delay_ends_and_a_share_is_lost() -> None:
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
    way.extra_loss = 0.5
    assert np.mean([way.arrival_s(4.0 + k) is None for k in range(400)]) == pytest.approx(0.5, abs=0.08)


# ---------------------------------------------------------------- the autopilot


@pytest.fixture
def px4() -> AutopilotFlight:
    """Ready to arm."""
    flight = AutopilotFlight("px4")
    flight.run(5.0)
    return flight


def test_a_refused_request_is_denied_for_as_long_as_the_fault_and_the_motors_stop_in_the_air_too(
    flight: AutopilotFlight, autopilot_kind: AutopilotKind
) -> None:
    flight.run(8.0)
    autopilot = flight.autopilot
    refuses = faults.AutopilotRefuses(kind="autopilot_refuses", what="arm", **times())
    desk = FaultedParts(refuses, autopilot=autopilot)
    autopilot.set_mode_named(
        autopilot.profile.take_off_mode if autopilot_kind == "ardupilot" else "AUTO_LOITER"
    )
    desk.schedule.step(1.0)
    assert autopilot.arm() is autopilot.profile.refused
    assert autopilot.arm(force=True) is autopilot.profile.refused
    desk.schedule.step(2.0)
    assert autopilot.arm() is CommandResult.ACCEPTED
    autopilot.refused = frozenset({"disarm", "land", "offboard", "take_off"})
    assert autopilot.disarm(force=True) is autopilot.profile.refused
    assert autopilot.set_mode_named(autopilot.profile.land_mode) is autopilot.profile.refused
    assert autopilot.take_off(5.0) is not CommandResult.ACCEPTED
    autopilot.refused = frozenset()
    autopilot.set_mode_named(autopilot.profile.take_off_mode)
    disarms = faults.AutopilotDisarms(kind="autopilot_disarms", **times())
    desk = FaultedParts(disarms, autopilot=autopilot)
    desk.schedule.step(0.9)
    assert autopilot.armed
    desk.schedule.step(1.0)
    assert not autopilot.armed


def test_an_autopilot_that_does_not_disarm_by_itself_stays_armed() -> None:
    flights = [AutopilotFlight("px4"), AutopilotFlight("px4")]
    flights[1].autopilot.refused = frozenset({"auto_disarm"})
    for flight in flights:
        flight.run(5.0)
        assert flight.autopilot.arm() is CommandResult.ACCEPTED
        flight.run(12.0)  # PX4 disarms what does not take off within 10 s
    assert [flight.autopilot.armed for flight in flights] == [False, True]


def test_the_pilot_changes_the_mode_once(px4: AutopilotFlight) -> None:
    desk = FaultedParts(
        faults.PilotMode(kind="pilot_mode", mode="position", **times()), autopilot=px4.autopilot
    )
    desk.schedule.step(1.0)
    assert px4.autopilot.mode == "POSCTL"
    px4.autopilot.set_mode_named("AUTO_LOITER")
    desk.schedule.step(1.5)
    desk.schedule.step(2.0)
    assert px4.autopilot.mode == "AUTO_LOITER"


def test_a_reboot_is_silent_and_starts_the_clock_and_the_streams_again(px4: AutopilotFlight) -> None:
    px4.autopilot.set_mode_named("POSCTL")
    reboots = faults.AutopilotReboots(kind="autopilot_reboots", start_s=6.0, silent_s=2.0)
    desk = FaultedParts(reboots, autopilot=px4.autopilot)
    desk.schedule.step(6.0)
    assert (px4.autopilot.booted_s, px4.autopilot.mode, desk.restarted) == (6.0, "AUTO_LOITER", 1)
    assert desk.targets.to_app.arrival_s(7.9) is None
    desk.schedule.step(8.0)
    assert desk.targets.to_app.arrival_s(8.1) == 8.1
    assert desk.restarted == 1


def test_without_its_position_the_autopilot_sends_none(px4: AutopilotFlight) -> None:
    lost = faults.AutopilotPositionLost(kind="autopilot_position_lost", **times())
    desk = FaultedParts(lost, autopilot=px4.autopilot)
    assert local_position(px4.autopilot, 5.0) is not None
    desk.schedule.step(1.0)
    px4.run(0.1)
    assert local_position(px4.autopilot, 5.1) is None
    assert not px4.autopilot.ready_to_arm
    desk.schedule.step(2.0)
    px4.run(0.1)
    assert local_position(px4.autopilot, 5.2) is not None


def test_the_battery_is_reported_in_both_messages() -> None:
    charge = faults.BatteryCharge(kind="battery", remaining_percent=12, **times())
    autopilot = AutopilotFlight("px4").autopilot
    schedule = FaultedParts(charge, autopilot=autopilot).schedule
    schedule.step(1.0)
    assert sys_status(autopilot, 1.0).battery_remaining == 12
    assert battery_status(autopilot, 1.0).battery_remaining == 12
    schedule.step(2.0)
    assert sys_status(autopilot, 2.0).battery_remaining == 100
