"""The simulation as a whole, without an app: a scenario's settings reach the line and the camera."""

import asyncio
import math
import os
from typing import Any, NamedTuple

import numpy as np
import pymap3d
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.clock import Clock, run_in_virtual_time
from companion.base.geometry import GRAVITY_M_S2, Vector3, geodetic_from_ned, quat_from_euler
from companion.base.messages import Frame, Phase
from companion.config import validate
from sitl.devices.mpu9250 import Ak8963Device, Mpu9250Device
from sitl.devices.ports import MemoryPort
from sitl.run.in_process import MemoryFrames
from sitl.run.process_control import SimulationReport
from sitl.run.simulation import Simulation
from sitl.scenario.scenario import Scenario, load_scenario
from sitl.sensors.inertial import ImuErrors, ImuSensor
from sitl.sensors.sensors import MagErrors, MagSensor
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.world import World
from tests.virtual_time import in_virtual_time

SMALL = {"camera": {"rate_hz": 10.0}}


class OtherEnd:
    """The other end of the line: hears everything, and asks the ground station where the pad is."""

    def __init__(self) -> None:
        self.heard: list[tuple[float, bytes]] = []
        self._clock = Clock()

    async def read(self) -> bytes:
        """A request each half second."""
        await self._clock.sleep_until((int(self._clock.now_s() / 0.5) + 1) * 0.5)
        companion = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
        message = mavlink.MAVLink_command_long_message(255, 0, 512, 0, 144, 0, 0, 0, 0, 0, 0)
        return bytes(message.pack(companion))

    def write(self, data: bytes) -> None:
        """One datagram."""
        self.heard.append((self._clock.now_s(), data))

    def messages(self, kind: str) -> list[tuple[float, Any]]:
        """Those of a kind, with the time they came."""
        found = []
        for time_s, data in self.heard:
            parser = mavlink.MAVLink(None)
            parser.robust_parsing = True
            found += [(time_s, m) for m in parser.parse_buffer(data) or [] if m.get_type() == kind]
        return found


class SentMessages(NamedTuple):
    """What left the vehicle."""

    desk: OtherEnd
    frames: list[Frame]
    report: SimulationReport


@in_virtual_time
async def stand(seconds: float, *, keep_truth: bool = True, **values: Any) -> SentMessages:
    """A vehicle stands at home for a while."""
    desk, frames = OtherEnd(), list[Frame]()
    scenario = validate(Scenario, {"name": "x", "description": "x", **SMALL, **values}, "x")
    made = simulation(desk, frames, scenario, 3, keep_truth=keep_truth)
    task = asyncio.create_task(made.run())
    await Clock().sleep_until(seconds)
    task.cancel()
    await asyncio.wait([task])
    return SentMessages(desk, frames, made.report(Phase.SEARCH))


def simulation(
    link: Any, frames: list[Frame], scenario: Scenario | None = None, seed: int = 0, **options: Any
) -> Simulation:
    ports: dict[str, Any] = {"gps_port": MemoryPort(9600), "range_port": MemoryPort(9600)}
    chosen = scenario or load_scenario("static")
    return Simulation(chosen, seed, link=link, **ports, deliver_frame=frames.append, **options)


def test_a_vehicle_that_is_served_for_days_keeps_no_truth() -> None:
    kept, not_kept = (stand(0.5, keep_truth=keep).report for keep in (True, False))
    assert len(kept.truth) == 25
    assert not not_kept.truth
    assert not_kept.outcome == kept.outcome


@pytest.fixture(scope="module")
def plain() -> SentMessages:
    return stand(3.0)


def test_a_perfect_line_tells_at_once(plain: SentMessages) -> None:
    answers = plain.desk.messages("FOLLOW_TARGET")
    # asked at 0.5, 1.0, ..., answered half a second later
    assert [round(time_s, 1) for time_s, _ in answers] == [1.0, 1.5, 2.0, 2.5]
    assert len(plain.desk.messages("HEARTBEAT")) >= 5


def test_a_line_delays_both_ways_and_repeats_by_its_seed(plain: SentMessages) -> None:
    slow = {"delay_s": 0.1}
    late = stand(3.0, link=slow)
    answers = [time_s for time_s, _ in late.desk.messages("FOLLOW_TARGET")]
    prompt = [time_s for time_s, _ in plain.desk.messages("FOLLOW_TARGET")]
    assert answers == pytest.approx([time_s + 0.2 for time_s in prompt[: len(answers)]], abs=0.015)
    bad = {"loss_share": 0.4, "delay_s": 0.02, "jitter_s": 0.1, "reorder_share": 0.2}
    assert stand(2.0, link=bad).desk.heard == stand(2.0, link=bad).desk.heard


def test_a_lossy_line_loses_and_a_blackout_takes_all() -> None:
    assert stand(3.0, link={"loss_share": 1.0}).desk.heard == []
    black = {"kind": "link_blackout", "start_s": 1.0, "duration_s": 1.0}
    times = [time_s for time_s, _ in stand(3.0, faults=[black]).desk.heard]
    assert not [t for t in times if 1.01 < t < 2.0]
    assert min(times) < 1.0
    assert max(times) > 2.0


@pytest.mark.parametrize(("way", "answered"), [("to_vehicle", 0), ("to_app", 0), (None, 4)])
def test_a_blackout_of_either_way_stops_the_answers(way: str | None, answered: int) -> None:
    faults = [] if way is None else [{"kind": "link_blackout", "start_s": 0.0, "way": way}]
    desk = stand(3.0, faults=faults).desk
    assert len(desk.messages("FOLLOW_TARGET")) == answered
    assert bool(desk.messages("HEARTBEAT")) == (way != "to_app")


def test_the_beacon_is_as_the_scenario_has_it(plain: SentMessages) -> None:
    assert stand(3.0, beacon={"available": False}).desk.messages("FOLLOW_TARGET") == []
    late = stand(3.0, beacon={"delay_s": 1.0}).desk.messages("FOLLOW_TARGET")
    assert [round(time_s, 1) for time_s, _ in late] == [1.5, 2.0, 2.5]
    rare = stand(3.0, beacon={"rate_hz": 0.5, "position_std_m": 0.0}).desk.messages("FOLLOW_TARGET")
    stamps = {m.timestamp for _, m in rare}
    assert len(stamps) == 2
    assert len({m.timestamp for _, m in plain.desk.messages("FOLLOW_TARGET")}) == 4


def test_frames_come_at_the_cameras_rate_after_its_latency(plain: SentMessages) -> None:
    assert len(plain.frames) == pytest.approx(29, abs=1)
    late = [frame.received_s - frame.time_s for frame in plain.frames]
    assert 0.035 < min(late) < max(late) < 0.06


def test_a_camera_may_drop_frames_of_itself() -> None:
    kept = stand(6.0, camera={"rate_hz": 10.0, "lost_share": 0.5, "lost_burst_frames": 3.0}).frames
    missing = np.diff([frame.sequence for frame in kept]) - 1
    assert 15 < len(kept) < 45
    assert missing.max() >= 2


def test_a_stuck_camera_repeats_its_picture_with_new_stamps() -> None:
    stuck = {"kind": "frame_stuck", "start_s": 1.0, "duration_s": 1.0}
    frames = stand(3.0, faults=[stuck]).frames
    held = [frame for frame in frames if 1.1 < frame.time_s < 1.9]
    assert len({frame.time_s for frame in held}) == len(held) > 5
    assert all(np.array_equal(frame.image, held[0].image) for frame in held)
    after = [frame for frame in frames if frame.time_s > 2.1]
    assert not np.array_equal(after[0].image, after[1].image)


def test_light_and_dirt_reach_the_camera(plain: SentMessages) -> None:
    def linear(frame: Frame) -> float:
        """Mean light: the shipped camera encodes about as the square root."""
        return float(np.square(frame.image / 255.0).mean())

    def mean(**values: Any) -> float:
        return linear(stand(0.4, **values).frames[-1])

    usual = linear(plain.frames[2])
    fixed = {"rate_hz": 10.0, "exposure": {"automatic": False}}
    assert mean(light={"illuminance_lux": 500.0}, camera=fixed) < 0.3 * usual
    dirt = {"blobs": 60, "largest_share": 0.4, "opacity": 1.0}
    assert mean(camera={"rate_hz": 10.0, "dirt": dirt}) < 0.8 * usual


@pytest.mark.parametrize(
    "hardship", [{"light": {}}, {"faults": [{"kind": "frame_garbled", "start_s": 0.0, "share": 0.5}]}]
)
def test_pictures_drawn_beside_the_loop_are_the_same(
    hardship: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    # they come later than the next is exposed
    late = {"rate_hz": 10.0, "latency_s": 0.15}
    at_once = stand(1.5, camera=late, **hardship)
    monkeypatch.delenv("OMP_NUM_THREADS")
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    beside = stand(1.5, camera=late, **hardship)
    assert [f.received_s for f in beside.frames] == [f.received_s for f in at_once.frames]
    assert all(np.array_equal(a.image, b.image) for a, b in zip(beside.frames, at_once.frames, strict=True))
    assert len(beside.frames) > 10


# ---------------- The camera hands on the newest frame only


async def test_a_slow_reader_sees_the_newest_frame_only() -> None:
    camera = MemoryFrames()
    first, second, third = (Frame(0.0, 0.0, k, np.zeros((1, 1), np.uint8)) for k in range(3))
    camera.deliver(first)
    camera.deliver(second)
    assert await camera.next() is second
    waiting = asyncio.ensure_future(camera.next())
    await asyncio.sleep(0)
    assert not waiting.done()
    camera.deliver(third)
    assert await waiting is third


# ----------------
# What was made fast is what it was: sleeping chips, surfaces out of reach, geodetic places, ticks.

CHIP = 0x68
STEP_S = 1.0 / 400.0
# longer than a sleeping chip notes, so that it has to forget, and not a multiple of it
SLEPT_STEPS = 9377


def noisy_chip() -> Mpu9250Device:
    rng, mag_rng = np.random.default_rng(3).spawn(2)
    magnetometer = Ak8963Device(MagSensor(MagErrors(), mag_rng, np.eye(3)))
    return Mpu9250Device(ImuSensor(ImuErrors(), rng, STEP_S, np.eye(3)), magnetometer, clock_error=0.0031)


def feel(chip: Mpu9250Device, first: int, last: int) -> None:
    for k in range(first, last):
        t = k * STEP_S
        force = (math.sin(3.0 * t), 0.4 * math.cos(t), -GRAVITY_M_S2)
        chip.step(t, force, (0.1 * math.sin(t), 0.2, -0.1), (20.0, 1.0, 40.0), 0.3 + 0.2 * math.sin(t))


@pytest.mark.parametrize("slept", [7, 400, SLEPT_STEPS])
def test_a_reader_cannot_tell_that_the_chip_has_slept(slept: int) -> None:
    def told(*, awake: bool) -> bytes:
        chip = noisy_chip()
        if awake:
            chip.wake()
        feel(chip, 0, slept)
        told = chip.read(CHIP, 0x3A, 15)
        for register, value in ((0x19, 1), (0x1A, 0x42), (0x23, 0xF8), (0x6A, 0x04), (0x6A, 0x40)):
            chip.write(CHIP, register, value)
        feel(chip, slept, slept + 12)
        return told + chip.read(CHIP, 0x74, 200)

    asleep, awake = told(awake=False), told(awake=True)
    assert any(asleep[1:])
    assert asleep == awake


def test_without_a_fifo_the_newest_sample_is_the_one_of_a_chip_that_keeps_all() -> None:
    chips = noisy_chip(), noisy_chip()
    for chip in chips:
        chip.write(CHIP, 0x1A, 0x02)
    chips[1].write(CHIP, 0x6A, 0x40)
    for k in range(50):
        for chip in chips:
            feel(chip, k, k + 1)
        assert chips[0].read(CHIP, 0x3B, 14) == chips[1].read(CHIP, 0x3B, 14)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (850.0, -1200.0, -75.0), (-3.0, 4.0, 30.0)])
@pytest.mark.parametrize("origin", [(47.0, 8.0, 400.0), (-35.4, 149.2, 584.0), (0.0, -179.9, -20.0)])
def test_places_on_the_ellipsoid_are_the_librarys(place: Vector3, origin: Vector3) -> None:
    latitude, longitude, altitude = geodetic_from_ned(place, origin)
    expected = [float(value) for value in pymap3d.ned2geodetic(*place, *origin)]
    assert (latitude, longitude) == pytest.approx(expected[:2], abs=1e-12)
    assert altitude == pytest.approx(expected[2], abs=1e-7)


def test_what_was_touched_is_forgotten_out_of_reach() -> None:
    world = World(load_scenario("static"), 0)
    for _ in range(40):
        world.step((0.0, 0.0, 0.0, 0.0), STEP_S)
    stood = world.truth().in_contact
    state = world.state
    # as if thrown up within a step: nothing may be left of the contact
    world.state = QuadrotorState((*state.position_ned_m[:2], -5.0), attitude=quat_from_euler(0.0, 0.0, 0.0))
    world.step((0.0, 0.0, 0.0, 0.0), STEP_S)
    assert (stood, world.truth().in_contact) == (True, False)
    assert world.state.specific_force_body_m_s2 == pytest.approx((0.0, 0.0, 0.0), abs=0.05)


# ---------------------------------------------------------------- a vehicle served alone


class DeafLink:
    """A line on which nobody speaks."""

    def __init__(self) -> None:
        self.sent = b""

    async def read(self) -> bytes:
        await asyncio.Event().wait()
        return b""

    def write(self, data: bytes) -> None:
        self.sent += data


@in_virtual_time
async def served(*, camera: bool) -> tuple[bytes, list[Frame]]:
    link, frames = DeafLink(), list[Frame]()
    world = asyncio.create_task(simulation(link, frames, camera_wanted=lambda: camera).run())
    await Clock().sleep_until(0.5)
    world.cancel()
    return link.sent, frames


def test_a_camera_that_nobody_wants_renders_nothing_and_changes_nothing_else() -> None:
    without, no_frames = served(camera=False)
    sent, frames = served(camera=True)
    assert not no_frames
    assert len(frames) > 10
    assert without == sent


def test_a_world_that_fails_ends_the_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: World, *_arguments: object) -> None:
        raise ArithmeticError("no such world")

    async def serve() -> None:
        world = simulation(DeafLink(), [], camera_wanted=lambda: False)
        monkeypatch.setattr(World, "step", fail)
        await world.run()

    with pytest.raises(ExceptionGroup, match="unhandled errors") as caught:
        run_in_virtual_time(serve())
    assert caught.group_contains(ArithmeticError, match="no such world")


@in_virtual_time
async def test_a_cancelled_simulation_ticks_no_more() -> None:
    world = simulation(DeafLink(), [], camera_wanted=lambda: False)
    task = asyncio.create_task(world.run())
    await Clock().sleep_until(0.2)
    task.cancel()
    await Clock().sleep_until(1.0)
    assert world.report(Phase.ABORT).duration_s < 0.25
